// What conformance does not see: that every quantised sphere contains its shapes, and what a ray
// gets that ends at one.

#include "accelerators/sphere_hierarchy.h"

#include <cmath>
#include <cstring>

#include "accelerators/enclosing_sphere.h"
#include "framework/instance.h"
#include "framework/registry.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

constexpr double angle = 0.01;  ///< radians of a pixel in these tests: a coarse picture

std::shared_ptr<const TriangleSet> ball(int level, float scale = 1) {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(level, p, t);
    for (Vec3f& v : p) v *= scale;
    return std::make_shared<const TriangleSet>(p, t);
}

/// A flat square of 2·n² triangles in z = 0, from -1 to 1.
std::shared_ptr<const TriangleSet> square(int n) {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    for (int y = 0; y <= n; ++y)
        for (int x = 0; x <= n; ++x) p.emplace_back(2.0f * x / n - 1, 2.0f * y / n - 1, 0);
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            const uint32_t i = uint32_t(y * (n + 1) + x), j = i + uint32_t(n) + 1;
            t.push_back({i, i + 1, j + 1});
            t.push_back({i, j + 1, j});
        }
    return std::make_shared<const TriangleSet>(p, t);
}

std::unique_ptr<Primitive> with_lod(const PrimitiveSet& set, double lod, double pixel_angle = angle,
                                    double pixel_width = 0) {
    return accelerator("sphere_hierarchy")
        .build(set, {{"lod", lod}, {"pixel_angle", pixel_angle}, {"pixel_width", pixel_width}});
}

/// Rays from a sphere of radius `distance` towards the unit cube, with directions of any length.
std::vector<Ray> rays_towards(float distance, int n) {
    std::vector<Ray> rays;
    test::Random random(5);
    for (int i = 0; i < n; ++i) {
        Ray ray;
        ray.origin = random.direction() * distance;
        ray.direction = (random.point(1) - ray.origin) * random.uniform(0.25f, 4.0f);
        rays.push_back(ray);
    }
    return rays;
}

struct Containment {
    uint64_t spheres = 0;
    double worst = 0;   ///< radius needed over the radius there is
    double growth = 0;  ///< radius over the parent's
};

/// Looks at every sphere with the shapes below it.
template <class Set>
Containment containment(const SphereHierarchy<Set>& h, const Set& set) {
    Containment result;
    const auto check = [&](const NodeSphere& s, const std::vector<uint32_t>& shapes) {
        ++result.spheres;
        const Vec3d c = h.center + h.unit * Vec3d(s.c[0], s.c[1], s.c[2]);
        std::vector<Ball> balls;
        for (const uint32_t shape : shapes) add_balls(set, shape, balls);
        for (const Ball& b : balls)
            result.worst =
                std::max(result.worst, ((b.center.cast<double>() - c).norm() + b.radius) /
                                           (h.unit * double(s.r)));
    };
    // Depth first by recursion: hard scenes are small.
    const auto visit = [&](const auto& self, uint32_t index,
                           const NodeSphere& sphere) -> std::vector<uint32_t> {
        const SphereNode& node = h.nodes[index];
        std::vector<uint32_t> all;
        uint32_t child = node.child, first = node.first;
        for (int i = 0; i < 4 && node.r[i] > 0; ++i) {
            const NodeSphere s = decoded(node, i, sphere);
            result.growth = std::max(result.growth, double(s.r) / sphere.r);
            const std::vector<uint32_t> shapes =
                node.count[i] == 0
                    ? self(self, child++, s)
                    : std::vector<uint32_t>(h.references.begin() + first,
                                            h.references.begin() + first + node.count[i]);
            first += node.count[i];
            check(s, shapes);
            all.insert(all.end(), shapes.begin(), shapes.end());
        }
        return all;
    };
    if (!h.nodes.empty()) check(h.root, visit(visit, 0, h.root));
    return result;
}

}  // namespace

TEST_CASE("sphere_hierarchy: every decoded sphere contains every shape below it") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        INFO(scene.name);
        const Containment c = std::visit(
            []<class Set>(const std::shared_ptr<const Set>& set) {
                return containment(SphereHierarchy<Set>::build(*set, {}), *set);
            },
            scene.set);
        if (test::bounds_of(scene.set).empty()) continue;
        CHECK(c.spheres > 0);
        CHECK(c.worst > 0.5);  // and is not much too large
        // Doubles here round differently from those of the builder.
        CHECK(c.worst <= 1 + 1e-12);
        CHECK(c.growth <= 1 + 1e-6);
    }
}

TEST_CASE("sphere_hierarchy: a sphere takes less than eight bytes") {
    const auto set = ball(5);
    const auto h = SphereHierarchy<TriangleSet>::build(*set, {});
    const Containment c = containment(h, *set);
    CHECK(double(h.nodes.size() * sizeof(SphereNode)) / double(c.spheres) < 8);
}

TEST_CASE("sphere_hierarchy: with lod no hit gets lost, and none ends more than a footprint away") {
    const auto set = ball(6);
    const auto exact = accelerator("bvh").build(PrimitiveSet(set), {});
    for (const double lod : {1.0, 2.0, 8.0, 64.0}) {
        const auto coarse = with_lod(set, lod);
        size_t hits = 0, ended = 0, lost = 0, late = 0, stray = 0, not_occluded = 0;
        for (const Ray& ray : rays_towards(6, 4000)) {
            const Hit e = exact->intersect(ray), c = coarse->intersect(ray);
            const double length = ray.direction.cast<double>().norm();
            const double width = lod * angle * double(c.t) * length;
            hits += e.is_hit();
            lost += e.is_hit() && !c.is_hit();
            if (!c.is_hit()) continue;
            ended += c.u == 0 && c.v == 0;
            not_occluded += !coarse->occluded(ray);
            // A sphere is as wide as a footprint at most: 1e-5 of it is for the slack of rays.
            late += e.is_hit() && (c.t - e.t) * length > 0.5 * width * (1 + 1e-5) + 1e-4;
            const Vec3d p = ray.origin.cast<double>() + c.t * ray.direction.cast<double>();
            stray += (p - set->vertex(c.primitive, 0).cast<double>()).norm() >
                     width * (1 + 1e-5) + 1e-4 + (c.u != 0 || c.v != 0 ? 0.1 : 0);
        }
        INFO("lod " << lod);
        CHECK(hits > 1000);
        CHECK(ended > 1000);
        CHECK(lost == 0);
        CHECK(late == 0);
        CHECK(stray == 0);
        CHECK(not_occluded == 0);
    }
}

TEST_CASE("sphere_hierarchy: before a plane, depth is right within half a footprint") {
    const auto set = square(64);
    const auto exact = accelerator("brute_force").build(PrimitiveSet(set), {});
    for (const double lod : {0.5, 1.0, 2.0, 4.0, 8.0}) {
        const auto coarse = with_lod(set, lod);
        double worst = 0, sum = 0;
        size_t hits = 0;
        for (int i = 0; i < 1600; ++i) {
            Ray ray;
            ray.origin = Vec3f(0.3f, 0.2f, 5);
            ray.direction =
                Vec3f(float(i % 40) / 20 - 0.97f, float(i / 40) / 20 - 0.97f, 0) - ray.origin;
            const Hit e = exact->intersect(ray), c = coarse->intersect(ray);
            REQUIRE(e.is_hit());
            REQUIRE(c.is_hit());
            const double length = ray.direction.cast<double>().norm();
            const double width = lod * angle * double(c.t) * length;
            worst = std::max(worst, std::abs(double(c.t) - e.t) * length / width);
            sum += std::abs(double(c.t) - e.t);
            ++hits;
        }
        INFO("lod " << lod);
        CHECK(worst <= 0.5 + 1e-4);
        if (lod >= 2) CHECK(sum > 0);
    }
}

TEST_CASE("sphere_hierarchy: as lod goes to 0, hits become those of brute force, bit for bit") {
    const auto set = ball(4);
    const auto exact = accelerator("brute_force").build(PrimitiveSet(set), {});
    const std::vector<Ray> rays = rays_towards(6, 3000);
    size_t last = rays.size() + 1;
    for (const double lod : {8.0, 2.0, 0.5, 0.01}) {
        const auto coarse = with_lod(set, lod);
        size_t differ = 0;
        for (const Ray& ray : rays) {
            const Hit e = exact->intersect(ray), c = coarse->intersect(ray);
            differ += std::memcmp(&e, &c, sizeof(Hit)) != 0;
        }
        INFO("lod " << lod);
        CHECK(differ <= last);
        last = differ;
    }
    CHECK(last == 0);
}

TEST_CASE("sphere_hierarchy: a coarser picture takes fewer steps and tests") {
    const auto set = ball(6);
    uint64_t last = UINT64_MAX;
    for (const double lod : {0.0, 1.0, 4.0, 16.0}) {
        const auto coarse = with_lod(set, lod);
        Counters counters;
        for (const Ray& ray : rays_towards(6, 2000)) coarse->intersect(ray, counters);
        INFO("lod " << lod);
        CHECK(counters.N_TS + counters.N_IT < last);
        last = counters.N_TS + counters.N_IT;
    }
}

TEST_CASE("sphere_hierarchy: footprints are compared in world units through an instance's map") {
    // A power of two, so that the baked tree is the instanced one in every bit.
    const auto small = ball(5), large = ball(5, 4);
    const auto baked = with_lod(large, 2);
    const Instance placed(std::shared_ptr<const Primitive>(with_lod(small, 2)), scaling({4, 4, 4}));
    const Instance twice(
        std::make_shared<Instance>(std::shared_ptr<const Primitive>(with_lod(small, 2)),
                                   scaling({0.5, 0.5, 0.5}) * rotation(Vec3d(0, 0, 1), 0)),
        scaling({8, 8, 8}));
    size_t hits = 0, differ = 0;
    for (Ray ray : rays_towards(24, 3000)) {
        const Hit a = baked->intersect(ray);
        for (const Instance* instance : {&placed, &twice}) {
            const Hit b = instance->intersect(ray);
            hits += a.is_hit();
            // Where a ray just grazes a sphere, its thickness decides.
            differ += a.is_hit() != b.is_hit() || a.primitive != b.primitive ||
                      (a.is_hit() && std::abs(a.t - b.t) > 1e-5f * a.t);
        }
    }
    CHECK(hits > 1000);
    CHECK(differ <= hits / 500);
}

TEST_CASE("sphere_hierarchy: a far object is one sphere, and a footprint has a width of its own") {
    const auto set = ball(3);
    Ray ray;
    ray.origin = Vec3f(0, 0, 1000);
    ray.direction = Vec3f(0, 0, -2);
    const Hit far = with_lod(set, 1)->intersect(ray);
    CHECK(far.is_hit());
    CHECK(far.t == Approx(500));
    CHECK(with_lod(set, 1, 1e-9)->intersect(ray).t == Approx(499.5).epsilon(1e-5));
    CHECK(with_lod(set, 1, 1e-9, 3)->intersect(ray).t == Approx(500));
    ray.t_max = 499.9f;
    CHECK_FALSE(with_lod(set, 1)->intersect(ray).is_hit());
    CHECK_FALSE(with_lod(set, 1)->occluded(ray));
    ray.t_max = 600;
    ray.t_min = 500.1f;
    CHECK_FALSE(with_lod(set, 1)->intersect(ray).is_hit());
}

TEST_CASE("sphere_hierarchy: every instruction set ends rays at the same spheres") {
    const std::string before = active_isa();
    const auto set = ball(5);
    set_isa("sse4");
    const auto reference = with_lod(set, 2);
    for (const std::string& isa : available_isas()) {
        set_isa(isa);
        const auto tested = with_lod(set, 2);
        size_t differ = 0;
        for (const Ray& ray : rays_towards(6, 2000)) {
            const Hit a = reference->intersect(ray), b = tested->intersect(ray);
            differ += std::memcmp(&a, &b, sizeof(Hit)) != 0;
        }
        INFO(isa);
        CHECK(differ == 0);
    }
    set_isa(before);
}

TEST_CASE(
    "sphere_hierarchy: objects are entered whatever the lod, and their own spheres end rays") {
    const auto inner = std::shared_ptr<const Primitive>(with_lod(ball(4), 4));
    std::vector<ObjectSet::Object> objects;
    for (uint32_t i = 0; i < 5; ++i)
        objects.push_back({std::make_shared<Instance>(inner, translation({3.0 * i - 6, 0, 0})), i});
    const PrimitiveSet set = std::make_shared<const ObjectSet>(objects);
    const auto coarse = with_lod(set, 4);
    const auto reference = accelerator("brute_force").build(set, {});
    size_t hits = 0, differ = 0;
    for (const Ray& ray : rays_towards(40, 2000)) {
        const Hit a = reference->intersect(ray), b = coarse->intersect(ray);
        hits += a.is_hit();
        differ += std::memcmp(&a, &b, sizeof(Hit)) != 0;
    }
    CHECK(hits > 100);
    CHECK(differ == 0);
}

}  // namespace crofton
