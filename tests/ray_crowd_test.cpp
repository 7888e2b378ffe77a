#include "framework/ray_crowd.h"

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "framework/crowds.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/primitive.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
#include "tests/isas.h"

namespace crofton {
namespace {

struct Prepared {
    const Ray* ray;
    LocalRay local;
    RayQuery query;
    float scale;
};

/// How many rays have another closest hit, or another answer to whether there is one, in crowds of
/// up to `most` than alone.
size_t different_in_crowds(const Primitive& object, const std::vector<Ray>& rays, Mode mode,
                           size_t most) {
    size_t different = 0;
    const auto trace = [&](std::vector<Prepared>& some, bool any) {
        RayCrowd crowd;
        for (Prepared& p : some) crowd.add(p.local, p.query);
        any ? object.any_crowd(crowd) : object.closest_crowd(crowd);
        for (size_t i = 0; i < some.size(); ++i) {
            const Prepared& p = some[i];
            if (any)
                different += (crowd.found >> i & 1) != object.occluded(*p.ray, mode);
            else
                different += p.query.hit(p.scale) != object.intersect(*p.ray, mode);
        }
        some.clear();
    };
    for (const bool any : {false, true}) {
        std::vector<Prepared> some;
        for (const Ray& ray : rays) {
            Prepared p;
            p.ray = &ray;
            if (!prepare(ray, object.magnitudes().maxCoeff(), p.query, p.local, p.scale)) continue;
            p.query.mode = mode;
            some.push_back(p);
            if (some.size() == most) trace(some, any);
        }
        trace(some, any);
    }
    return different;
}

TEST_CASE("ray crowd: every ray has the bits of a ray alone, in every form of wide nodes") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        if (!std::holds_alternative<std::shared_ptr<const TriangleSet>>(scene.set) &&
            !std::holds_alternative<std::shared_ptr<const ObjectSet>>(scene.set))
            continue;
        INFO(scene.name);
        for (const char* width : {"4", "8", "16"})
            for (const char* nodes : {"full", "quantised"})
                for (const char* leaves : {"full", "compact"})
                    for_each_isa([&] {
                        INFO(width << " " << nodes << " " << leaves);
                        const auto object =
                            accelerator("wide_bvh")
                                .build(scene.set, {{"width", std::string(width)},
                                                   {"nodes", std::string(nodes)},
                                                   {"leaves", std::string(leaves)}});
                        REQUIRE(object->takes_crowds());
                        CHECK(different_in_crowds(*object, scene.rays, Mode::robust,
                                                  RayCrowd::most) == 0);
                    });
    }
}

TEST_CASE("ray crowd: other modes, and crowds of other sizes") {
    const auto scenes = test::hard_scenes();
    const auto simple = accelerator("wide_bvh").build(scenes.front().set, {});
    size_t crowded = 0;
    for (const test::HardScene& scene : scenes) {
        const auto object = accelerator("wide_bvh").build(scene.set, {});
        if (!object->takes_crowds()) continue;
        INFO(scene.name);
        ++crowded;
        for (const size_t most : {size_t(1), size_t(3), size_t(17)}) {
            CHECK(different_in_crowds(*simple, scenes.front().rays, Mode::fast, most) == 0);
            for (const Mode mode : {Mode::robust, Mode::double_precision})
                CHECK(different_in_crowds(*object, scene.rays, mode, most) == 0);
        }
        // In mode fast spans must not go in crowds: the order of visits matters there.
        std::vector<Hit> hits(scene.rays.size());
        for (int again = 0; again < 3; ++again) {
            object->intersect(scene.rays, hits, Mode::fast);
            size_t different = 0;
            for (size_t i = 0; i < hits.size(); ++i)
                different += hits[i] != object->intersect(scene.rays[i], Mode::fast);
            CHECK(different == 0);
        }
    }
    CHECK(crowded >= 2);
}

std::shared_ptr<const Primitive> wide_bvh_of(std::vector<PlacedPrimitive> objects) {
    return accelerator("wide_bvh").build(std::make_shared<const ObjectSet>(std::move(objects)), {});
}

TEST_CASE("ray crowd: objects receive crowds, at any depth, and give the bits of rays alone") {
    for_each_isa([] {
        std::vector<Vec3f> positions;
        std::vector<std::array<uint32_t, 3>> triangles;
        test::icosphere(2, positions, triangles);
        const auto set = std::make_shared<const TriangleSet>(positions, triangles);
        const ParameterValues lazy = {{"lazy", true}, {"lazy_size", int64_t(32)}};
        const std::shared_ptr<const Primitive> balls[] = {
            accelerator("wide_bvh").build(set, {}), accelerator("kdtree").build(set, {}),
            accelerator("wide_bvh").build(set, lazy), accelerator("kdtree").build(set, lazy)};
        test::Random random(5);
        // Turned balls that overlap, of which some are no wide_bvh or lazy; and worlds of such
        // worlds.
        std::shared_ptr<const Primitive> world = balls[0];
        for (int level = 0; level < 7; ++level) {
            std::vector<PlacedPrimitive> objects;
            for (uint32_t i = 0; i < (level < 2 ? 30u : 3u); ++i) {
                Transform place;
                const Eigen::AngleAxisd turn(random.uniform(0, 6),
                                             random.direction().cast<double>());
                place.linear = (level == 0 ? 0.4 : 0.7) * turn.toRotationMatrix();
                place.translation = random.point(1).cast<double>();
                const auto& inside = level == 0 && i % 5 > 1 ? balls[i % 5 - 1] : world;
                objects.push_back({std::make_shared<const Instance>(inside, place), 1000 * i});
            }
            world = wide_bvh_of(objects);
            INFO("level " << level);
            REQUIRE(world->takes_crowds());
            std::vector<Ray> rays(500);
            for (Ray& ray : rays) {
                ray.origin = random.point(2);
                ray.direction = random.point(1) - ray.origin;
            }
            size_t hits = 0;
            for (const Ray& ray : rays) hits += world->intersect(ray).is_hit();
            CHECK(hits > 100);
            CHECK(different_in_crowds(*world, rays, Mode::robust, RayCrowd::most) == 0);
            CHECK(different_in_crowds(*world, rays, Mode::double_precision, 20) == 0);
        }
        // A single instance as the root, and rays of which none is one.
        const Instance root(world, {});
        std::vector<Ray> nowhere(200);
        for (Ray& ray : nowhere) ray.direction = Vec3f(0, 0, 0);
        std::vector<Hit> hits(nowhere.size());
        root.intersect(nowhere, hits);
        for (const Hit& hit : hits) CHECK(!hit.is_hit());
    });
}

TEST_CASE("ray crowd: a ray with more before it than its stack holds goes on alone") {
    // Each triangle is a fifth larger than the one before it, so a tree puts the few largest of any
    // of them aside, and a ray that begins at the smallest passes these by all the way down.
    constexpr uint32_t count = 300;
    std::vector<Vec3f> corners;
    std::vector<std::array<uint32_t, 3>> triangles;
    for (uint32_t i = 0; i < count; ++i) {
        const float size = 1e-6f * std::pow(1.2f, float(i));
        corners.insert(corners.end(),
                       {Vec3f(-size, -size, size), Vec3f(size, -size, size), Vec3f(0, size, size)});
        triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const auto set = std::make_shared<const TriangleSet>(corners, triangles);
    std::vector<Ray> rays;
    for (uint32_t i = 0; i < 40; ++i) {
        Ray ray;
        ray.direction = Vec3f(1e-3f * float(i) - 0.02f, 0.01f, 1);
        ray.t_min = i % 2 ? 0 : 1e-6f * std::pow(1.2f, float(7 * i));
        rays.push_back(ray);
    }
    for_each_isa([&] {
        const auto object = accelerator("wide_bvh").build(set, {{"max_leaf_size", int64_t(1)}});
        CHECK(different_in_crowds(*object, rays, Mode::robust, RayCrowd::most) == 0);
    });
}

TEST_CASE("ray crowd: short spans through two structures in turns") {
    size_t different = 0, short_ones = 0;
    const auto check = [&](const Primitive& object, std::span<const Ray> rays) {
        std::vector<Hit> hits(rays.size());
        std::vector<uint8_t> occluded(rays.size());
        object.intersect(rays, hits);
        object.occluded(rays, occluded);
        for (size_t i = 0; i < rays.size(); ++i)
            different += hits[i] != object.intersect(rays[i]) ||
                         bool(occluded[i]) != object.occluded(rays[i]);
        ++short_ones;
    };
    struct Crowded {
        std::shared_ptr<const Primitive> object;
        std::vector<Ray> rays;
    };
    std::vector<Crowded> all;
    for (const test::HardScene& scene : test::hard_scenes()) {
        const Crowded c{accelerator("wide_bvh").build(scene.set, {}), scene.rays};
        if (c.object->takes_crowds()) all.push_back(c);
    }
    REQUIRE(all.size() >= 2);
    const Crowded &a = all.front(), &b = all.back();
    for (size_t i = 0; i < 40; ++i) {
        const size_t size = 60 + 5 * i;
        for (const Crowded* c : {&a, &b})
            if (7 * i + size <= c->rays.size() && (c == &a || i % 3 == 0))
                check(*c->object, std::span(c->rays).subspan(7 * i, size));
    }
    CHECK(different == 0);
    CHECK(short_ones > 30);
}

TEST_CASE("ray crowd: of two ways the faster one is taken, until it is the slower one") {
    FasterWay way;
    const auto second_of = [&](int turns, double first_takes, double second_takes) {
        int second = 0;
        for (int i = 0; i < turns; ++i) {
            second += way.second();
            way.took(way.second() ? second_takes : first_takes);
        }
        return second;
    };
    CHECK(second_of(1024, 1.0, 0.9) > 900);
    // What has stayed for long is asked more seldom, but it is asked.
    CHECK(second_of(8192, 0.9, 1.0) < 4096);
    CHECK(second_of(8192, 0.9, 1.0) < 100);
    CHECK(second_of(8192, 1.0, 0.9) > 4096);
    CHECK(second_of(8192, 1.0, 0.9) > 8000);
}

TEST_CASE("ray crowd: pairs that tell nothing hardly change the way, and cost little") {
    test::Random random(5);
    FasterWay way;
    // The second takes a fifth longer, and times differ by more than that.
    int second = 0;
    constexpr int turns = 1 << 18;
    for (int i = 0; i < turns; ++i) {
        second += way.second();
        way.took((way.second() ? 1.2f : 1.0f) * random.uniform(0.7f, 1.3f));
    }
    CHECK(second < turns / 50);
}

}  // namespace
}  // namespace crofton
