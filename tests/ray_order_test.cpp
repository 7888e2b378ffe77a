#include "framework/ray_order.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "framework/primitive.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/height_field.h"

namespace crofton {
namespace {

Bounds3 unit_box() {
    Bounds3 box;
    box.extend(Vec3f(0, 0, 0));
    box.extend(Vec3f(1, 1, 1));
    return box;
}

/// Rays from everywhere in and around the unit box to everywhere; every sixteenth is a special one.
std::vector<Ray> scattered_rays(size_t n) {
    std::mt19937 random(7);
    std::uniform_real_distribution<float> place(-0.5f, 1.5f), way(-1, 1);
    std::vector<Ray> rays(n);
    for (size_t i = 0; i < n; ++i) {
        Ray& ray = rays[i];
        for (int a = 0; a < 3; ++a) ray.origin[a] = place(random);
        for (int a = 0; a < 3; ++a) ray.direction[a] = way(random);
        if (i % 16 == 1) ray.direction[int(i / 16 % 3)] = 0;
        if (i % 16 == 2) ray.direction = Vec3f(0, 0, 0);
        if (i % 16 == 3) ray.origin[0] = NAN;
        if (i % 16 == 4) ray.direction[1] = INFINITY;
        if (i % 16 == 5) ray.t_max = 0.1f;
    }
    return rays;
}

TEST_CASE("ray order: a permutation that brings neighbours together") {
    const Bounds3 box = unit_box();
    const std::vector<Ray> rays = scattered_rays(20000);
    CHECK(RayOrder::are_scattered(rays, box));
    RayOrder order;
    std::vector<uint32_t> sorted;
    for (int twice = 0; twice < 2; ++twice) {
        const auto span = order.sort(rays, box);
        sorted.assign(span.begin(), span.end());
    }
    std::vector<Ray> in_order;
    for (const uint32_t i : sorted) in_order.push_back(rays.at(i));
    CHECK_FALSE(RayOrder::are_scattered(in_order, box));
    std::sort(sorted.begin(), sorted.end());
    for (uint32_t i = 0; i < sorted.size(); ++i) REQUIRE(sorted[i] == i);
}

TEST_CASE("ray order: many scattered rays through a large structure give the single calls' hits") {
    // More than 16 MiB of structure: where the order of rays is changed.
    constexpr uint32_t n = 480;
    const HeightField mesh(n, [](float x, float y) {
        return Vec3f(x / n, y / n, 0.5f + 0.2f * std::sin(0.05f * x) * std::cos(0.07f * y));
    });
    const PrimitiveSet set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    const auto object = accelerator("wide_bvh").build(set, {});
    REQUIRE(object->statistics().bytes > RayOrder::large_structure);
    const std::vector<Ray> rays = scattered_rays(20000);
    std::vector<Hit> hits(rays.size());
    std::vector<uint8_t> occluded(rays.size());
    object->intersect(rays, hits);
    object->occluded(rays, occluded);
    size_t found = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
        INFO("ray " << i);
        REQUIRE(hits[i] == object->intersect(rays[i]));
        REQUIRE(bool(occluded[i]) == object->occluded(rays[i]));
        found += hits[i].is_hit();
    }
    CHECK(found > rays.size() / 20);
}

}  // namespace
}  // namespace crofton
