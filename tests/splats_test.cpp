// Clouds of points: how wide a point is, and that every accelerator traces it.

#include "scenegraph/splats.h"

#include <cmath>
#include <limits>

#include "framework/registry.h"
#include "scenegraph/assemble.h"
#include "scenegraph/shading.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

/// n × n points in z = 0, `step` apart, the first at the origin.
std::vector<Vec3f> grid(int n, float step) {
    std::vector<Vec3f> p;
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) p.emplace_back(float(x) * step, float(y) * step, 0);
    return p;
}

AssemblyPlan plan(const std::string& type) {
    const auto choice =
        std::make_shared<const AcceleratorChoice>(AcceleratorChoice{type, type, {}, nullptr});
    AssemblyPlan p;
    p.top = p.objects = choice;
    return p;
}

Ray down(float x, float y) {
    Ray ray;
    ray.origin = Vec3f(x, y, 10);
    ray.direction = Vec3f(0, 0, -1);
    return ray;
}

Hit shoot(const Assembly& a, float x, float y) { return a.root->intersect(down(x, y)); }

}  // namespace

TEST_CASE("splats: a radius is the distance to the fourth nearest other place") {
    std::vector<Vec3f> p = grid(20, 0.5f);
    const size_t inner = 20 * 10 + 10, corner = 0;
    CHECK(splat_radii(p)[inner] == 0.5f);
    CHECK(splat_radii(p)[corner] == 1.0f);  // neighbours at 0.5, 0.5, 0.71 and 1
    // Points at one place count once, and all get its radius.
    p.insert(p.end(), {p[inner], p[inner], p[inner], p[inner], p[inner]});
    CHECK(splat_radii(p)[inner] == 0.5f);
    CHECK(splat_radii(p).back() == 0.5f);
}

TEST_CASE("splats: radii equal those of comparing all pairs, in any order of the points") {
    std::vector<Vec3f> p;
    test::Random random(8);
    for (int i = 0; i < 700; ++i) p.push_back(random.point(1).cwiseProduct(Vec3f(1, 3, 0.1f)));
    std::vector<double> spacing;
    std::vector<std::vector<std::pair<double, size_t>>> order(p.size());
    for (size_t i = 0; i < p.size(); ++i) {
        for (size_t j = 0; j < p.size(); ++j)
            if (j != i) order[i].push_back({(p[i].cast<double>() - p[j].cast<double>()).norm(), j});
        std::sort(order[i].begin(), order[i].end());
        spacing.push_back(order[i][3].first);
    }
    const std::vector<float> radii = splat_radii(p);
    for (size_t i = 0; i < p.size(); ++i) {
        double widest = 0;
        for (int k = 0; k < 4; ++k) widest = std::max(widest, spacing[order[i][k].second]);
        CHECK(radii[i] == float(std::min(spacing[i], 2 * widest)));
    }
    std::vector<Vec3f> reversed(p.rbegin(), p.rend());
    const std::vector<float> again = splat_radii(reversed);
    CHECK(std::vector<float>(again.rbegin(), again.rend()) == radii);
}

TEST_CASE("splats: a stray point does not swallow the scene, and odd clouds are harmless") {
    std::vector<Vec3f> p = grid(10, 1);
    p.emplace_back(1000, 0, 0);
    CHECK(splat_radii(p).back() <= 4);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    p.emplace_back(nan, 0, 0);
    CHECK(splat_radii(p).back() == 0);
    CHECK(splat_radii({}).empty());
    CHECK(splat_radii({Vec3f(1, 2, 3)}) == std::vector<float>{0});
    CHECK(splat_radii({Vec3f(1, 2, 3), Vec3f(1, 2, 3)}) == std::vector<float>{0, 0});
    CHECK(splat_radii({Vec3f(0, 0, 0), Vec3f(0, 2, 0)}) == std::vector<float>{2, 2});
    CHECK(std::isinf(splat_radii({Vec3f(-3e38f, 0, 0), Vec3f(3e38f, 0, 0)})[0]));
    CHECK(splat_radii(std::vector<Vec3f>(5000, Vec3f(1, 1, 1)))[7] == 0);
}

TEST_CASE(
    "splats: points trace as spheres, or discs where they have a normal, in every structure") {
    Scene scene;
    Points cloud{grid(9, 1)};
    // A triangle mesh before it, so that ids are not those of the set.
    scene.add_object(
        "corner", {"corner", 0, TriangleMesh{{{50, 0, 0}, {51, 0, 0}, {50, 1, 0}}, {{0, 1, 2}}}});
    scene.add_object("cloud", {"cloud", 0, cloud}, translation({0, 0, 0}));
    Points discs{grid(3, 10)};
    discs.normals.assign(9, Vec3f(0, 0, 3));
    discs.normals[4] = Vec3f::Zero();
    discs.radii.assign(9, 0.25f);
    scene.add_object("discs", {"discs", 0, discs}, translation({100, 0, 1}) * scaling({2, 1, 1}));
    for (const auto& [name, info] : accelerators())
        for (const bool flatten : {false, true}) {
            INFO(name << (flatten ? " flattened" : ""));
            AssemblyPlan p = plan(name);
            p.flatten = flatten;
            const Assembly a = assemble(scene, p);
            // On top of a sphere of radius 1 about (4, 3, 0).
            CHECK(shoot(a, 4, 3) == Hit{9, 0, 0, 3 * 9 + 4, 1, 1});
            CHECK(shoot(a, 4.125f, 3).primitive == 3 * 9 + 4);
            CHECK(shoot(a, 104, 30).is_hit() == false);
            CHECK(shoot(a, 100, 10) == Hit{9, 0, 0, 3, 2, 2});
            CHECK(shoot(a, 100.45f, 10).t == 9);  // the map makes an ellipse
            CHECK_FALSE(shoot(a, 100.55f, 10).is_hit());
            CHECK(shoot(a, 120, 10) == Hit{8.75f, 0, 0, 4, 2, 2});
            CHECK(shoot(a, 50.25f, 0.25f).geometry == 0);
        }
}

TEST_CASE("splats: a point is shaded as the sphere or the disc that it is") {
    Scene scene;
    Points cloud{{{0, 0, 0}, {5, 0, 0}}, {{0, 0, 0}, {0, 0.6f, 0.8f}}, {1, 1}};
    scene.add_object("cloud", {"cloud", 0, cloud});
    const Assembly a = assemble(scene, plan("bvh"));
    const std::vector<MeshInstance> instances = mesh_instances(scene);
    const auto normal = [&](float x) {
        const Ray ray = down(x, 0);
        return surface_normal(scene, instances, a.root->intersect(ray), ray);
    };
    REQUIRE(normal(0.6f));
    CHECK((*normal(0.6f) - Vec3d(0.6, 0, 0.8)).norm() < 1e-6);
    REQUIRE(normal(5));
    CHECK((*normal(5) - Vec3d(0, 0.6, 0.8)).norm() < 1e-6);
}

}  // namespace crofton
