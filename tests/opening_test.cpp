// Opening of objects into parts: the same bits at every budget, for every structure above and
// below.

#include "accelerators/opening.h"

#include <cstring>

#include "framework/instance.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

constexpr OpeningRule always = OpeningRule::always;

struct Mesh {
    std::vector<Vec3f> positions;
    std::vector<std::array<uint32_t, 3>> triangles;
};

Mesh ball(int level) {
    Mesh m;
    test::icosphere(level, m.positions, m.triangles);
    return m;
}

std::shared_ptr<const Primitive> build(const std::string& name, const PrimitiveSet& set,
                                       const ParameterValues& values = {}) {
    return accelerator(name).build(set, values);
}

Transform turned(double angle, const Vec3d& at, const Vec3d& scale) {
    return translation(at) * rotation(Vec3d(1, 2, 3).normalized(), angle) * scaling(scale);
}

/// Long balls that cross one another.
std::vector<Transform> crossing(int n) {
    std::vector<Transform> maps{{}};
    for (int i = 1; i < n; ++i)
        maps.push_back(
            turned(0.7 * i, {0.25 * i, 0.125 * (i % 3), -0.25 * (i % 5)}, {0.25, 4, 0.5}));
    return maps;
}

/// Meshes placed one by one, and their vertices.
struct World {
    std::vector<ObjectSet::Object> objects;
    std::vector<Vec3f> vertices;
    Bounds3 bounds;
};

World placed(const std::shared_ptr<const Primitive>& object, const Mesh& mesh,
             const std::vector<Transform>& maps, uint32_t step = 1) {
    World w;
    for (uint32_t i = 0; i < maps.size(); ++i) {
        if (maps[i].is_identity())
            w.objects.push_back({object, i * step});
        else
            w.objects.push_back({std::make_shared<Instance>(object, maps[i]), i * step});
        w.bounds.extend(w.objects.back().primitive->bounds());
        const FloatTransform f = rounded(maps[i]);
        for (const Vec3f& v : mesh.positions) w.vertices.push_back(apply(f, v));
    }
    return w;
}

size_t differences(const Primitive& a, const Primitive& b, const std::vector<Ray>& rays) {
    size_t wrong = 0;
    for (const Ray& ray : rays) {
        const Hit x = a.intersect(ray), y = b.intersect(ray);
        Counters counters;
        const Hit z = b.intersect(ray, counters);
        wrong += std::memcmp(&x, &y, sizeof(Hit)) != 0 || std::memcmp(&x, &z, sizeof(Hit)) != 0 ||
                 b.occluded(ray) != x.is_hit() || b.occluded(ray, counters) != x.is_hit();
    }
    return wrong;
}

std::shared_ptr<const ObjectSet> set_of(std::vector<ObjectSet::Object> objects) {
    return std::make_shared<const ObjectSet>(std::move(objects));
}

}  // namespace

TEST_CASE("opened at every budget, every structure in every other returns the same bits") {
    const Mesh mesh = ball(2);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    const std::vector<Transform> maps = crossing(7);
    const World flat = placed(build("brute_force", triangles), mesh, maps);
    const auto reference = build("brute_force", set_of(flat.objects));
    const std::vector<Ray> rays = test::hard_rays(flat.bounds, flat.vertices, 71);
    for (const auto& [inner, inner_info] : accelerators()) {
        const World w = placed(build(inner, triangles), mesh, maps);
        for (const double growth : {1.0, 1.5, 2.0, 5.0, 30.0, 1000.0}) {
            const OpenedObjects opened = open_overlapping(w.objects, growth, always);
            CHECK(opened.objects.size() <= size_t(growth * double(w.objects.size())));
            if (growth > 1 && opened.objects.size() == w.objects.size()) continue;
            // With the reference's own bits in between, one growth for each structure above will
            // do.
            for (const auto& [top, top_info] : accelerators()) {
                if (growth != 5.0 && top != "bvh" && top != inner) continue;
                INFO(top << " over " << inner << " opened to " << opened.objects.size());
                CHECK(differences(*reference, *build(top, set_of(opened.objects)), rays) == 0);
            }
        }
    }
}

TEST_CASE("every choice of the structures that can be opened keeps its bits when opened") {
    const Mesh mesh = ball(2);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    const std::vector<Transform> maps = crossing(5);
    const World flat = placed(build("brute_force", triangles), mesh, maps);
    const auto reference = build("brute_force", set_of(flat.objects));
    const std::vector<Ray> rays = test::hard_rays(flat.bounds, flat.vertices, 72);
    size_t openable = 0;
    for (const auto& [name, info] : accelerators())
        for (const ParameterInfo& p : info.parameters)
            for (const std::string& choice : p.choices) {
                const World w = placed(build(name, triangles, {{p.name, choice}}), mesh, maps);
                const OpenedObjects opened = open_overlapping(w.objects, 60, always);
                if (opened.opened == 0) continue;
                ++openable;
                INFO(name << " " << p.name << " = " << choice);
                CHECK(differences(*reference, *build("bvh", set_of(opened.objects)), rays) == 0);
            }
    CHECK(openable >= 4);
}

TEST_CASE("groups of instances open into instances of parts, and dissolve into their objects") {
    const Mesh mesh = ball(1);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    const std::vector<Transform> maps = crossing(5);
    const auto count = uint32_t(maps.size());
    const auto nested = [&](const std::string& leaf, const std::string& middle) {
        const World low = placed(build(leaf, triangles), mesh, maps);
        Mesh all;
        all.positions = low.vertices;
        return placed(build(middle, set_of(low.objects)), all, maps, count);
    };
    const World flat = nested("brute_force", "brute_force");
    const auto reference = build("brute_force", set_of(flat.objects));
    const std::vector<Ray> rays = test::hard_rays(flat.bounds, flat.vertices, 73);
    for (const auto& [middle, info] : accelerators())
        for (const double growth : {5.0, 200.0}) {
            const World w = nested("bvh", middle);
            const OpenedObjects opened = open_overlapping(w.objects, growth, always);
            INFO(middle << " opened to " << opened.objects.size());
            CHECK(opened.opened > 0);
            CHECK(differences(*reference, *build("bvh", set_of(opened.objects)), rays) == 0);
        }
}

TEST_CASE("objects that do not overlap are left alone, and parts keep the order") {
    const Mesh mesh = ball(2);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    const auto object = build("bvh", triangles);
    std::vector<Transform> maps;
    for (int i = 0; i < 20; ++i) maps.push_back(translation({3.0 * i, 0, 0}));
    CHECK(open_overlapping(placed(object, mesh, maps).objects, 100, always).objects.size() == 20);

    // Two of them meet.
    maps[7] = translation({3.0 * 8 + 0.5, 0.5, 0});
    const OpenedObjects opened = open_overlapping(placed(object, mesh, maps).objects, 2, always);
    CHECK(opened.opened == 2);
    CHECK(opened.objects.size() > 22);
    CHECK(opened.objects.size() <= 40);
    CHECK(std::is_sorted(opened.origin.begin(), opened.origin.end()));
    for (size_t i = 0; i < opened.objects.size(); ++i)
        CHECK(opened.objects[i].instance == opened.origin[i]);

    const ShapeGroups moved = moved_groups({{0, 20}, {6, 8}, {8, 10}}, opened);
    CHECK(moved[0].end == opened.objects.size());
    CHECK(opened.origin[moved[1].first] == 6);
    CHECK(opened.origin[moved[1].end - 1] == 7);
    CHECK(moved[2].first == moved[1].end);
}

TEST_CASE("boxes that overlap are not opened where a tree over the parts would cost more") {
    // Each fills its box with a few large triangles, and the boxes are all in one place: parts are
    // hardly smaller, and each has to be entered.
    const Mesh mesh = ball(0);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    std::vector<Transform> maps;
    for (int i = 0; i < 12; ++i) maps.push_back(turned(0.5 * i, {0.05 * i, 0, 0}, {1, 1, 1}));
    const World w = placed(build("bvh", triangles, {{"max_leaf_size", int64_t(4)}}), mesh, maps);
    CHECK(open_overlapping(w.objects, 8, always).opened == 12);
    CHECK(open_overlapping(w.objects, 8).opened == 0);
}

TEST_CASE("over crossing balls opening saves tests, and parts hold no data of their own") {
    const Mesh mesh = ball(4);
    const auto triangles = std::make_shared<const TriangleSet>(mesh.positions, mesh.triangles);
    const World w = placed(build("bvh", triangles), mesh, crossing(40));
    const auto closed = build("bvh", set_of(w.objects));
    const OpenedObjects opened = open_overlapping(w.objects, 8);
    const auto open = build("bvh", set_of(opened.objects));
    Counters before, after;
    test::Random random(5);
    for (int i = 0; i < 2000; ++i) {
        Ray ray;
        ray.origin = w.bounds.center() + random.direction() * w.bounds.extent().norm();
        ray.direction =
            w.bounds.center() + random.point(0.5f).cwiseProduct(w.bounds.extent()) - ray.origin;
        closed->intersect(ray, before);
        open->intersect(ray, after);
    }
    CHECK(after.N_IT < before.N_IT);
    // The object's own structure is there once.
    CHECK(total_statistics(*open).N_OIV <
          total_statistics(*closed).N_OIV + 2 * opened.objects.size());
}

}  // namespace crofton
