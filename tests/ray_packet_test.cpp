#include "framework/ray_packet.h"

#include <cmath>
#include <random>

#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/primitive.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
#include "tests/height_field.h"

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

TEST_CASE("ray packet: rays that start together and go one way suit") {
    const std::vector<Ray> rays = picture(1);
    Bounds3 box;
    box.extend(Vec3f(0, 0, 0));
    box.extend(Vec3f(1, 1, 1));
    const auto group = [&](size_t first) {
        return std::vector<Ray>(rays.begin() + long(first), rays.begin() + long(first) + 16);
    };
    const size_t plain = 50 * width + 160;  // no special ray among these
    CHECK(RayPacket::suits(group(plain), box));
    auto turned = group(plain);
    turned[7].direction[0] = -turned[7].direction[0];
    CHECK_FALSE(RayPacket::suits(turned, box));
    auto spread = group(plain);
    spread[7].direction[0] += 0.3f;
    CHECK_FALSE(RayPacket::suits(spread, box));
    auto apart = group(plain);
    apart[7].origin[1] += 0.1f;
    CHECK_FALSE(RayPacket::suits(apart, box));
    auto longer = group(plain);
    longer[7].direction *= 2;
    CHECK_FALSE(RayPacket::suits(longer, box));
    for (const float bad : {INFINITY, 0.0f}) {
        auto broken = group(plain);
        broken[7].direction[1] = bad;
        CHECK_FALSE(RayPacket::suits(broken, box));
    }
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

TEST_CASE("ray packet: one that passes what its rays do not meet gives up, and nothing is lost") {
    // Along the ground to the horizon, over the last of which some rays go.
    const auto ground = bumpy_ground("wide_bvh", 300);
    std::vector<Ray> rays(RayPacket::most * size_t{40});
    for (size_t i = 0; i < rays.size(); ++i) {
        rays[i].origin = Vec3f(-0.2f, 0.02f, 0.56f);
        rays[i].direction = Vec3f(1, 0.01f + 0.004f * float(i % 16) + 0.02f * float(i / 16),
                                  1e-4f * float(i % 16 + 1));
    }
    const auto first = std::span<const Ray>(rays).first(RayPacket::most);
    REQUIRE(RayPacket::suits(first, ground->bounds()));
    RayPacket packet;
    packet.prepare(first, 0, 2, Mode::robust);
    REQUIRE(packet.count == RayPacket::most);
    CHECK_FALSE(ground->closest_packet(packet));
    CHECK(check_span(*ground, rays, Mode::robust) > 0);
}

}  // namespace
}  // namespace crofton
