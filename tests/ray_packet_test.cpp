#include "framework/ray_packet.h"

#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <random>

#include "accelerators/opening.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/primitive.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
#include "tests/height_field.h"
#include "tests/isas.h"

namespace crofton {
namespace {

constexpr uint32_t width = 256, height = 96;

/// Pixels of a camera above the unit square, row by row; among them defined misses, and rays that
/// end early or begin late.
std::vector<Ray> picture(float directions_times) {
    std::vector<Ray> rays(size_t{width} * height);
    for (uint32_t y = 0; y < height; ++y)
        for (uint32_t x = 0; x < width; ++x) {
            Ray& ray = rays[y * width + x];
            ray.origin = Vec3f(0.1f, 0.2f, 1.5f);
            ray.direction = Vec3f(0.003f * float(x) - 0.1f, 0.007f * float(y) - 0.05f, -1.0f);
            ray.direction *= directions_times;
            const uint32_t i = y * width + x;
            if (i % 61 == 1) ray.direction = Vec3f(0, 0, 0);
            if (i % 67 == 2) ray.origin[0] = NAN;
            if (i % 71 == 3) ray.t_max = 0.9f / directions_times;
            if (i % 73 == 4) ray.t_min = 1.05f / directions_times;
            if (i % 79 == 5) ray.t_min = -2;
        }
    return rays;
}

std::shared_ptr<const Primitive> bumpy_ground(const char* accelerator_name, uint32_t n = 60,
                                              const ParameterValues& values = {}) {
    const HeightField mesh(n, [n](float x, float y) {
        const float height = 0.5f + 0.1f * std::sin(0.9f * x) * std::cos(0.7f * y);
        return Vec3f(x / float(n), y / float(n), height);
    });
    return accelerator(accelerator_name)
        .build(std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles), values);
}

/// Checks that spans give what single calls give. @return how many rays hit
size_t check_span(const Primitive& object, const std::vector<Ray>& rays, Mode mode) {
    std::vector<Hit> hits(rays.size(), Hit{1, 1, 1, 1, 1, 1});
    std::vector<uint8_t> occluded(rays.size(), 2);
    object.intersect(rays, hits, mode);
    object.occluded(rays, occluded, mode);
    size_t wrong = 0, found = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
        const bool right = hits[i] == object.intersect(rays[i], mode) &&
                           occluded[i] == uint8_t(object.occluded(rays[i], mode));
        if (!right && ++wrong <= 3) UNSCOPED_INFO("ray " << i);
        found += hits[i].is_hit();
    }
    CHECK(wrong == 0);
    return found;
}

Bounds3 unit_box() {
    Bounds3 box;
    box.extend(Vec3f(0, 0, 0));
    box.extend(Vec3f(1, 1, 1));
    return box;
}

using Sixteen = std::array<Ray, RayPacket::most>;

/// Pixels side by side.
Sixteen plain_rays() {
    Sixteen group;
    for (size_t i = 0; i < group.size(); ++i) {
        group[i].origin = Vec3f(0.1f, 0.2f, 1.5f);
        group[i].direction = Vec3f(0.003f * float(i) + 0.4f, 0.3f, -1.1f);
    }
    return group;
}

uint32_t companions(const Sixteen& rays, uint32_t among = RayPacket::everyone) {
    RayPacket packet(unit_box(), 1, Mode::robust);
    packet.load(rays.data());
    return packet.companions(among);
}

TEST_CASE("ray packet: rays that start together and go one way go together, others stay out") {
    const Sixteen plain = plain_rays();
    const std::function<void(Ray&)> changes[] = {
        [](Ray& r) { r.direction[0] = -r.direction[0]; },
        [](Ray& r) { r.direction[0] += 0.3f; },
        [](Ray& r) { r.direction *= 2; },
        [](Ray& r) { r.direction[0] = 1.5f; },  // another main axis
        [](Ray& r) { r.direction[1] = INFINITY; },
        [](Ray& r) { r.direction[2] = NAN; },
        [](Ray& r) { r.direction = Vec3f(0, 0, 0); },
        [](Ray& r) { r.origin[1] += 0.1f; },
        [](Ray& r) { r.origin[2] = NAN; },
        [](Ray& r) { r.origin[0] = -INFINITY; },
        [](Ray& r) { r.t_min = -2; },
        [](Ray& r) { r.t_min = 1e-35f; },
        [](Ray& r) { r.t_min = NAN; },
        [](Ray& r) { r.t_min = 2, r.t_max = 1; },
        [](Ray& r) { r.t_max = 1e-35f; },
        [](Ray& r) { r.t_max = NAN; },
    };
    for_each_isa([&] {
        CHECK(RayPacket::promising(plain.data()));
        CHECK(companions(plain) == RayPacket::everyone);
        CHECK(companions(plain, 0xf0f0) == 0xf0f0);
        for (size_t c = 0; c < std::size(changes); ++c) {
            INFO("change " << c);
            Sixteen changed = plain;
            changes[c](changed[7]);
            CHECK(companions(changed) == (RayPacket::everyone & ~(1u << 7)));
            changed = plain;
            changes[c](changed[0]);
            CHECK((companions(changed) & ~1u) == 0);
            CHECK(companions(changed, 0xfffe) == 0xfffe);
        }
    });
    Sixteen far = plain;
    for (Ray& ray : far) ray.origin *= 1e20f;
    CHECK(companions(far) == 0);
}

/// Rays about one, which all differ a little, and of which some are out of the ordinary.
Sixteen rays_about(const Ray& one, std::mt19937& random) {
    std::uniform_real_distribution<float> turn(-0.03f, 0.03f);
    Sixteen rays;
    for (Ray& ray : rays) {
        ray = one;
        const float largest = one.direction.cwiseAbs().maxCoeff();
        for (int a = 0; a < 3; ++a) {
            // Zeros and what is tiny stay so.
            const float size = std::abs(one.direction[a]) < 1e-3f * largest ? 0 : largest;
            ray.direction[a] += turn(random) * size;
            ray.origin[a] += turn(random) * 0.1f * std::abs(one.origin[a]);
        }
    }
    if (random() % 2) rays[random() % 16].direction[random() % 3] = NAN;
    if (random() % 2) rays[random() % 16].t_min = -1;
    if (random() % 2) rays[random() % 16].t_max = 0;
    return rays;
}

template <class A, class B>
bool same_bits(const A& a, const B& b) {
    return std::bit_cast<uint32_t>(a) == std::bit_cast<uint32_t>(b);
}

/// Whether ray r of the packet has what `prepare` sets up.
bool is_prepared(const RayPacket& packet, uint32_t r, const Ray& ray) {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, packet.magnitude, query, local, scale)) return false;
    bool same = same_bits(packet.scale, scale) && packet.axis[0] == query.kx &&
                packet.axis[1] == query.ky && packet.axis[2] == query.kz;
    const auto compare = [&](const RayPacket::Row& row, float x) {
        same = same && same_bits(row[r], x);
    };
    for (int a = 0; a < 3; ++a) {
        compare(packet.origin[a], query.origin[a]);
        compare(packet.origin[a], local.origin[a]);
        compare(packet.direction[a], query.direction[a]);
        compare(packet.direction[a], local.direction[a]);
        compare(packet.world.near_origin[a], local.near_origin[a]);
        compare(packet.world.far_origin[a], local.far_origin[a]);
        compare(packet.world.rcp[a], local.rcp[a]);
        compare(packet.world.far_rcp[a], local.far_rcp[a]);
    }
    compare(packet.shear[0], query.shear_x);
    compare(packet.shear[1], query.shear_y);
    compare(packet.shear[2], query.shear_z);
    compare(packet.t_min, query.t_min);
    compare(packet.t_low, query.t_low);
    compare(packet.t_best, query.t_best);
    compare(packet.t_cull, query.t_cull);
    return same;
}

TEST_CASE("ray packet: sixteen rays set up side by side have the bits of rays set up alone") {
    const float directions[][3] = {{0.3f, 0.4f, -0.9f}, {1, 1, 1},           {-0.9f, 0.1f, 0.2f},
                                   {0, 0, 1},           {-0.0f, 1, 0},       {1e-30f, -0.7f, 0.2f},
                                   {0.1f, -0.0f, -1},   {1e-12f, 1e-19f, 1}, {-1, 1, 0}};
    const float origins[][3] = {{0, 0, 0}, {-0.0f, 1, -3}, {1e-40f, 1e4f, 5e16f}, {1e30f, 0, 0}};
    const float intervals[][2] = {{0, INFINITY}, {-0.0f, 5}, {0x1p-100f, 0x1p-99f},
                                  {3, 1e30f},    {0, 3e38f}, {1e30f, 2e30f}};
    Bounds3 box;
    box.extend(Vec3f(-1e18f, -1e18f, -1e18f));
    box.extend(Vec3f(1e18f, 1e18f, 1e18f));
    std::mt19937 random(11);
    for_each_isa([&] {
        size_t together = 0, wrong = 0;
        for (const float times : {1.0f, 0.011f, 0x1p-59f, 1e-30f, 1e17f, 0x1p126f})
            for (const float magnitude : {1.0f, 3e7f, 1e26f, 1e30f})
                for (const auto& d : directions)
                    for (const auto& o : origins)
                        for (const auto& [t_min, t_max] : intervals) {
                            const Ray one{Vec3f(o), t_min, Vec3f(times * Vec3f(d)), t_max};
                            const Sixteen rays = rays_about(one, random);
                            RayPacket packet(box, magnitude, Mode::robust);
                            packet.load(rays.data());
                            for (uint32_t left = RayPacket::everyone; left;) {
                                const uint32_t companions = packet.companions(left);
                                left &= ~companions & (left - 1);
                                if (companions == 0) continue;
                                packet.prepare(companions);
                                for (uint32_t r = 0; r < RayPacket::most; ++r)
                                    if (companions >> r & 1)
                                        ++together, wrong += !is_prepared(packet, r, rays[r]);
                                    else
                                        wrong += !(packet.t_low[r] > packet.t_cull[r]);
                            }
                        }
        CHECK(wrong == 0);
        CHECK(together > 20000);
    });
}

TEST_CASE("ray packet: pictures as spans give the single calls' hits, in every mode") {
    const std::pair<const char*, const char*> forms[] = {
        {"full", "16"}, {"compact", "16"}, {"full", "8"}, {"full", "4"}};
    for (const auto& [leaves, children] : forms) {
        const auto ground = bumpy_ground(
            "wide_bvh", 60, {{"leaves", std::string(leaves)}, {"width", std::string(children)}});
        REQUIRE(ground->takes_packets());
        for (const float times : {1.0f, 1e-20f, 3e15f})
            for (const Mode mode :
                 {Mode::fast, Mode::robust, Mode::double_precision, Mode::exact}) {
                INFO(leaves << ", " << children << ", " << name_of(mode) << ", directions times "
                            << times);
                CHECK(check_span(*ground, picture(times), mode) > size_t{width} * height / 2);
            }
    }
}

TEST_CASE(
    "ray packet: instances under a structure that takes packets, and structures that do not") {
    const auto ground = bumpy_ground("bvh");
    CHECK_FALSE(ground->takes_packets());
    check_span(*ground, picture(1), Mode::robust);
    std::vector<PlacedPrimitive> objects;
    for (int i = 0; i < 20; ++i)
        objects.push_back({std::make_shared<const Instance>(
                               ground, translation(Vec3d(0.2 * (i % 5), 0.3 * (i / 5), 0.05 * i))),
                           uint32_t(i)});
    const auto top =
        accelerator("wide_bvh").build(std::make_shared<const ObjectSet>(std::move(objects)), {});
    REQUIRE(top->takes_packets());
    CHECK(check_span(*top, picture(1), Mode::robust) > size_t{width} * height / 2);
}

std::shared_ptr<const Primitive> placed(std::shared_ptr<const Primitive> object,
                                        const Transform& where) {
    return std::make_shared<const Instance>(std::move(object), where);
}

std::shared_ptr<const Primitive> over(const char* accelerator_name,
                                      std::vector<PlacedPrimitive> objects) {
    return accelerator(accelerator_name)
        .build(std::make_shared<const ObjectSet>(std::move(objects)), {});
}

/// The ground many times: where it is, twice at one place, turned, mirrored, flattened to almost
/// nothing, and in instances of instances deeper than packets go.
std::vector<PlacedPrimitive> placed_grounds(const std::shared_ptr<const Primitive>& ground) {
    std::vector<PlacedPrimitive> objects{{ground, 7}, {ground, 3}};
    uint32_t instance = 10;
    for (const double angle : {0.02, 0.5, 1.6, 3.1})
        objects.push_back({placed(ground, translation(Vec3d(0.3, 0.1 * angle, 0.02 * angle)) *
                                              rotation(Vec3d(0.6, 0, 0.8), angle)),
                           instance++});
    objects.push_back({placed(ground, scaling(Vec3d(-0.7, 1, 1))), instance++});
    objects.push_back({placed(ground, scaling(Vec3d(1, 1, 1e-6))), instance++});
    std::shared_ptr<const Primitive> deep = ground;
    for (int level = 0; level < 7; ++level) {
        std::vector<PlacedPrimitive> both{
            {deep, 0}, {placed(deep, translation(Vec3d(0.1, 0, 0))), 1u << level}};
        deep = over("wide_bvh", std::move(both));
        if (level % 2) deep = placed(deep, rotation(Vec3d(0, 0, 1), 0.1));
    }
    objects.push_back({deep, 100});
    return objects;
}

TEST_CASE("ray packet: in objects and instances, however they are turned and nested") {
    for (const char* leaves : {"full", "compact"}) {
        const auto ground = bumpy_ground("wide_bvh", 20, {{"leaves", std::string(leaves)}});
        const auto top = over("wide_bvh", placed_grounds(ground));
        for (const Mode mode : {Mode::fast, Mode::robust, Mode::double_precision, Mode::exact}) {
            CAPTURE(leaves, name_of(mode));
            CHECK(check_span(*top, picture(1), mode) > size_t{width} * height / 2);
        }
        CHECK(check_span(*over("bvh", placed_grounds(ground)), picture(1), Mode::robust) > 0);
    }
}

TEST_CASE("ray packet: in lazy structures, of what takes packets and of what does not") {
    for (const char* name : {"wide_bvh", "bvh"}) {
        CAPTURE(name);
        const auto ground = bumpy_ground(name, 60, {{"lazy", true}, {"lazy_size", int64_t(256)}});
        REQUIRE(ground->takes_packets());
        CHECK(check_span(*ground, picture(1), Mode::robust) > size_t{width} * height / 2);
        CHECK(check_span(*over("wide_bvh", placed_grounds(ground)), picture(1), Mode::robust) > 0);
    }
}

TEST_CASE("ray packet: in parts of opened objects") {
    const auto ground = bumpy_ground("wide_bvh", 40);
    OpenedObjects opened = open_overlapping(placed_grounds(ground), 4, OpeningRule::always);
    REQUIRE(opened.opened > 0);
    const auto top = over("wide_bvh", std::move(opened.objects));
    const auto whole = over("wide_bvh", placed_grounds(ground));
    const std::vector<Ray> rays = picture(1);
    CHECK(check_span(*top, rays, Mode::robust) > size_t{width} * height / 2);
    size_t wrong = 0;
    for (const Ray& ray : rays) wrong += top->intersect(ray) != whole->intersect(ray);
    CHECK(wrong == 0);
}

TEST_CASE("ray packet: rays stay together in what they enter together") {
    const auto ground = bumpy_ground("wide_bvh", 20);
    const auto deeper =
        placed(over("wide_bvh", {{placed(ground, translation(Vec3d(0.1, 0, 0))), 1},
                                 {placed(ground, translation(Vec3d(0, 0, -9))), 2}}),
               rotation(Vec3d(1, 0, 0), 0.01));
    const auto top =
        over("wide_bvh", {{deeper, 5}, {placed(ground, translation(Vec3d(5, 5, 0))), 9}});
    std::vector<Ray> rays(RayPacket::most);
    for (uint32_t r = 0; r < RayPacket::most; ++r) {
        rays[r].origin = Vec3f(0.3f, 0.4f, 1.5f);
        rays[r].direction = Vec3f(0.1f + 0.003f * float(r % 4), 0.1f + 0.003f * float(r / 4), -1);
    }
    RayPacket packet(top->bounds(), 10, Mode::robust);
    packet.load(rays.data());
    REQUIRE(packet.companions(RayPacket::everyone) == RayPacket::everyone);
    packet.prepare(RayPacket::everyone);
    top->closest_packet(packet, packet.world, packet.rays);
    CHECK(packet.are_single == 0);
    for (uint32_t r = 0; r < RayPacket::most; ++r) {
        CHECK(packet.hit(r).instance == 6);
        CHECK(packet.hit(r) == top->intersect(rays[r]));
    }
}

TEST_CASE("ray packet: sixteen nearly equal rays at every hard place") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        if (!std::holds_alternative<std::shared_ptr<const TriangleSet>>(scene.set)) continue;
        INFO(scene.name);
        const auto object = accelerator("wide_bvh").build(scene.set, {});
        std::vector<Ray> rays;
        for (const Ray& ray : scene.rays)
            for (int i = 0; i < int(RayPacket::most); ++i) {
                rays.push_back(ray);
                // Some the same, some turned by a float or two, some by more.
                const float turn = i < 4    ? 0.0f
                                   : i < 10 ? 0x1p-23f * float(i - 7)
                                            : 1e-3f * float(i);
                rays.back().direction[i % 3] *= 1 + turn;
            }
        check_span(*object, rays, Mode::robust);
    }
}

TEST_CASE("what ends just before or behind an interval is no occluder, also behind the origin") {
    const HeightField mesh(8, [](float x, float y) { return Vec3f(x / 8, y / 8, 0.5f); });
    const auto set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    for (const char* name : {"bvh", "wide_bvh"}) {
        const auto ground = accelerator(name).build(set, {});
        // The ground is at t = -1; ends are off by less than a leaf test's slack, and by more.
        for (const float off : {1e-6f, 2e-5f, 5e-5f, 1e-3f})
            for (const int side : {-1, 1}) {
                std::vector<Ray> rays(64);
                for (size_t i = 0; i < rays.size(); ++i) {
                    rays[i].origin = Vec3f(0.4f, 0.4f, 1.5f);
                    rays[i].direction =
                        Vec3f(0.01f * float(i % 8) - 0.041f, 0.01f * float(i / 8) - 0.042f, 1);
                    rays[i].t_min = i % 2 ? -1 + float(side) * off : -5;
                    rays[i].t_max = i % 2 ? 5 : -1 + float(side) * off;
                }
                CAPTURE(name, off, side);
                CHECK(check_span(*ground, rays, Mode::robust) == 32);
                size_t wrong = 0;
                for (const Ray& ray : rays)
                    wrong += ground->occluded(ray) != ground->intersect(ray).is_hit();
                CHECK(wrong == 0);
            }
    }
}

TEST_CASE("ray packet: it was futile where rays are far apart for the triangles they pass") {
    const auto was_futile = [](uint32_t cells, float apart) {
        const auto ground = bumpy_ground("wide_bvh", cells);
        std::vector<Ray> rays(RayPacket::most);
        for (uint32_t r = 0; r < RayPacket::most; ++r) {
            rays[r].origin = Vec3f(0.3f, 0.4f, 1.5f);
            rays[r].direction = Vec3f(0.1f + apart * float(r % 4), 0.1f + apart * float(r / 4), -1);
        }
        RayPacket packet(ground->bounds(), 2, Mode::robust);
        packet.load(rays.data());
        REQUIRE(packet.companions(RayPacket::everyone) == RayPacket::everyone);
        packet.prepare(RayPacket::everyone);
        ground->closest_packet(packet, packet.world, packet.rays);
        return packet.was_futile(RayPacket::most);
    };
    CHECK_FALSE(was_futile(20, 0.03f));
    CHECK_FALSE(was_futile(300, 0.0003f));
    CHECK(was_futile(300, 0.03f));
}

TEST_CASE("ray packet: where it passes what few rays meet these go on alone, and nothing is lost") {
    // Along the ground to the horizon, over the last of which some rays go.
    const auto ground = bumpy_ground("wide_bvh", 300);
    std::vector<Ray> rays(RayPacket::most * size_t{40});
    for (size_t i = 0; i < rays.size(); ++i) {
        rays[i].origin = Vec3f(-0.2f, 0.02f, 0.56f);
        rays[i].direction = Vec3f(1, 0.01f + 0.004f * float(i % 16) + 0.02f * float(i / 16),
                                  1e-4f * float(i % 16 + 1));
    }
    RayPacket packet(ground->bounds(), 2, Mode::robust);
    packet.load(rays.data());
    REQUIRE(packet.companions(RayPacket::everyone) == RayPacket::everyone);
    packet.prepare(RayPacket::everyone);
    ground->closest_packet(packet, packet.world, packet.rays);
    CHECK(packet.are_single != 0);
    CHECK(check_span(*ground, rays, Mode::robust) > 0);
}

}  // namespace
}  // namespace crofton
