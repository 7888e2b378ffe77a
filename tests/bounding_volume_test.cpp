// What the volumes of a hierarchy's nodes promise: they hold what is in them, and fit it.

#include "accelerators/bounding_volume.h"

#include "framework/registry.h"
#include "framework/transform.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

/// A box's corners and points inside, turned and moved.
std::vector<Vec3f> turned_box(const Vec3f& half, int inside, uint64_t seed) {
    test::Random random(seed);
    const Transform turn = translation({5, -3, 2}) * rotation(Vec3d(1, 2, -0.5).normalized(), 0.7);
    std::vector<Vec3f> points;
    for (int i = 0; i < 8 + inside; ++i) {
        Vec3f p = random.point(1);
        if (i < 8) p = Vec3f(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
        points.push_back(turn.point(p.cwiseProduct(half).cast<double>()).cast<float>());
    }
    return points;
}

double box_half_area(const std::vector<Vec3f>& points) {
    Bounds3 b;
    for (const Vec3f& p : points) b.extend(p);
    return half_area(b);
}

}  // namespace

TEST_CASE("bounding volumes hold all of their points, on both sides of a node") {
    for (int n : {1, 2, 3, 30, 5000})
        for (int side = 0; side < 2; ++side) {
            std::vector<Vec3f> points = turned_box({1, 0.2f, 3}, n, uint64_t(n));
            points.erase(points.begin(), points.begin() + 8);
            SpherePair sphere;
            ObbPair obb;
            KdopPair kdop;
            fit(points, side, sphere);
            fit(points, side, obb);
            fit(points, side, kdop);
            size_t outside = 0;
            for (const Vec3f& p : points) {
                Vec3d c;
                for (int a = 0; a < 3; ++a) c[a] = sphere.center[a][side];
                outside += (p.cast<double>() - c).norm() > sphere.radius[side];
                for (int k = 0; k < 3; ++k) {
                    double x = 0;
                    for (int a = 0; a < 3; ++a) x += double(obb.child[side].direction[a][k]) * p[a];
                    outside += x < obb.child[side].lower[k] || x > obb.child[side].upper[k];
                }
                for (int k = 0; k < 7; ++k) {
                    double x = 0;
                    for (int a = 0; a < 3; ++a) x += double(KdopPair::directions[k][a]) * p[a];
                    outside += x < kdop.child[side].lower[k] || x > kdop.child[side].upper[k];
                }
            }
            INFO(n << " points, side " << side);
            CHECK(outside == 0);
        }
}

TEST_CASE("bounding volumes fit: an oriented box finds the turn, a ball the middle") {
    const Vec3f half(1, 0.1f, 2);
    const std::vector<Vec3f> points = turned_box(half, 3000, 8);
    const double exact = 4 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0]);
    SpherePair sphere;
    ObbPair obb;
    KdopPair kdop;
    CHECK(fit(points, 0, obb) < 1.1 * exact);
    CHECK(exact < 0.7 * box_half_area(points));
    CHECK(fit(points, 0, kdop) < box_half_area(points));
    fit(points, 0, sphere);
    CHECK(sphere.radius[0] < 1.06f * half.norm());
    // An axis-aligned cube is its own 14-dop but for rounding, and no worse as an oriented box.
    std::vector<Vec3f> cube;
    for (int i = 0; i < 8; ++i) cube.emplace_back(i & 1, i >> 1 & 1, i >> 2 & 1);
    CHECK(fit(cube, 0, kdop) == Approx(3.0).epsilon(1e-5));
    CHECK(fit(cube, 0, obb) == Approx(3.0).epsilon(1e-5));
}

TEST_CASE("an oriented box spares slanted sticks most of the tests that boxes need") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::Random random(4);
    for (uint32_t i = 0; i < 2000; ++i) {
        const Vec3f base = random.point(1), tip = base + random.direction() * 0.5f;
        p.insert(p.end(), {base, tip, tip + random.point(0.002f)});
        t.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const auto set = std::make_shared<const TriangleSet>(p, t);
    const auto tests = [&](const char* volume) {
        const auto bvh = accelerator("bvh").build(
            set, {{"volume", std::string(volume)}, {"max_leaf_size", int64_t(1)}});
        test::Random lines(6);
        Counters counters;
        for (int i = 0; i < 2000; ++i) {
            Ray ray;
            ray.origin = lines.direction() * 4;
            ray.direction = lines.point(1) - ray.origin;
            bvh->intersect(ray, counters);
        }
        return double(counters.N_IT);
    };
    const double boxes = tests("box");
    CHECK(tests("obb") < 0.35 * boxes);
    CHECK(tests("kdop") < 0.8 * boxes);
}

}  // namespace crofton
