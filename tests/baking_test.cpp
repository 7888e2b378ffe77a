// Which meshes stand in one place, and get their structure there.

#include "scenegraph/baking.h"

#include <random>

#include "scenegraph/assemble.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

Geometry ball() {
    TriangleMesh mesh;
    test::icosphere(2, mesh.positions, mesh.triangles);
    return {"ball", 0, mesh};
}

/// The sides of a box whose edges are 4, 4 and 0.01 long.
Geometry wall() {
    TriangleMesh mesh;
    for (int i = 0; i < 8; ++i)
        mesh.positions.emplace_back(i & 1 ? 2 : -2, i & 2 ? 2 : -2, i & 4 ? 0.005f : -0.005f);
    for (const auto& [a, b, c, d] : std::array<std::array<uint32_t, 4>, 6>{
             {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}}})
        mesh.triangles.push_back({a, b, c}), mesh.triangles.push_back({a, c, d});
    return {"wall", 0, mesh};
}

uint32_t add_mesh(Scene& scene, Geometry geometry) {
    scene.meshes.push_back({geometry.name, {scene.add_geometry(geometry)}});
    return uint32_t(scene.meshes.size() - 1);
}

Transform turned(double angle) { return rotation(Vec3d(0.36, 0.48, 0.8), angle); }

/// What a plan's root holds, down to the leaves.
std::vector<std::string> inside(const Primitive& root) {
    std::vector<std::string> names;
    const auto visit = [&](const auto& self, const Primitive& p) -> void {
        names.push_back(p.type_name());
        p.children([&](const Primitive& child) { self(self, child); });
    };
    visit(visit, root);
    return names;
}
size_t instances_in(const Primitive& root) {
    const std::vector<std::string> names = inside(root);
    return size_t(std::count(names.begin(), names.end(), "instance"));
}

AssemblyPlan plan(bool bake) {
    AssemblyPlan p;
    p.top = p.objects =
        std::make_shared<AcceleratorChoice>(AcceleratorChoice{"wide_bvh", "wide_bvh", {}, nullptr});
    p.bake = bake;
    return p;
}

TEST_CASE("baking: what stands in one place has one path to it, and its mesh to itself") {
    Scene scene;
    const uint32_t own = add_mesh(scene, ball()), shared = add_mesh(scene, ball()),
                   many = add_mesh(scene, ball()), twice = add_mesh(scene, ball()),
                   lost = add_mesh(scene, ball());
    const uint32_t root = scene.add_node("root", {}), left = scene.add_node("left", {}, {}, root),
                   right = scene.add_node("right", {}, {}, root);
    const uint32_t a = scene.add_node("a", own, {}, left),
                   b = scene.add_node("b", shared, {}, left),
                   c = scene.add_node("c", shared, {}, right),
                   d = scene.add_node("d", many, {}, right),
                   group = scene.add_node("group", {}, {}, left),
                   e = scene.add_node("e", twice, {}, group),
                   f = scene.add_node("f", lost, {}, left);
    scene.nodes[right].children.push_back(group);
    scene.nodes[d].node_from_instance = {{}, translation({1, 0, 0})};
    // One that no root leads to does not count.
    scene.nodes.push_back({"nowhere", {}, {}, lost, {}});
    const std::vector<bool> standing = standing_nodes(scene);
    REQUIRE(standing.size() == scene.nodes.size());
    for (const uint32_t n : {root, left, right, a, f}) CHECK(standing[n]);
    for (const uint32_t n : {b, c, d, group, e}) CHECK_FALSE(standing[n]);
    scene.roots.push_back(root);
    CHECK_FALSE(standing_nodes(scene)[a]);
}

TEST_CASE("baking: a turned wall has a thick box, a ball has not") {
    Scene scene;
    const uint32_t round = add_mesh(scene, ball()), flat = add_mesh(scene, wall());
    const Transform stretched = scaling({3, 0.2, -1});
    for (const uint32_t mesh : {round, flat}) {
        CHECK(area_ratio(scene, mesh, {}) == 1);
        CHECK(area_ratio(scene, mesh, translation({5, 6, 7}) * stretched) == Approx(1));
        CHECK(area_ratio(scene, mesh, rotation(Vec3d(0, 0, 1), M_PI / 2)) == Approx(1));
    }
    CHECK(area_ratio(scene, round, turned(0.7)) < 1.1);
    CHECK(area_ratio(scene, flat, turned(0.7)) > 1.5);
    Quadrics one;
    one.shapes.push_back(Sphere{Vec3f(0, 0, 0), 1});
    CHECK(std::isinf(area_ratio(scene, add_mesh(scene, {"sphere", 0, one}), {})));
    TriangleMesh none;
    CHECK(area_ratio(scene, add_mesh(scene, {"none", 0, none}), turned(1)) == 1);
}

/// Balls and walls in groups that are turned, some alone, some of one mesh; one without an inverse.
Scene turned_scene() {
    Scene scene;
    const uint32_t group = scene.add_node("group", {}, translation({1, 2, 3}) * turned(0.4));
    const uint32_t deep = scene.add_node("deep", {}, turned(-0.7) * scaling({1, 1, 2}), group);
    for (int i = 0; i < 4; ++i) {
        const Transform where = translation({1.1 * i, -0.3 * i, 0}) * turned(0.3 * i);
        scene.add_node("ball", add_mesh(scene, ball()), where, i % 2 ? group : deep);
        scene.add_node("wall", add_mesh(scene, wall()), where * scaling({0.3, 0.3, 1}),
                       i % 2 ? deep : group);
    }
    const uint32_t shared = add_mesh(scene, ball());
    scene.add_node("one", shared, translation({0, 3, 0}), deep);
    scene.add_node("other", shared, translation({0, -3, 1}), group);
    scene.add_node("nothing", add_mesh(scene, ball()), scaling({1, 0, 1}), group);
    return scene;
}

TEST_CASE("baking: changes no bit of any hit, whatever groups the nodes are put in") {
    const Scene scene = turned_scene();
    AssemblyPlan flat = plan(true), own = plan(false), standing = plan(true), grouped = plan(true);
    flat.flatten = true;
    for (const char* node : {"deep", "group"}) grouped.rules.push_back({node, standing.top, node});
    const Assembly whole = assemble(scene, flat);
    const Assembly others[] = {assemble(scene, own), assemble(scene, standing),
                               assemble(scene, grouped)};
    // Walls that are turned, and the ball that stands twice.
    CHECK(instances_in(*others[0].root) == 10);
    CHECK(instances_in(*others[1].root) < 8);
    CHECK(instances_in(*others[1].root) >= 3);
    CHECK(instances_in(*others[2].root) == instances_in(*others[1].root));
    for (const Assembly& other : others) CHECK(other.inactive_instances == 1);
    std::mt19937 random(5);
    std::uniform_real_distribution<float> number(-1, 1);
    std::vector<Ray> rays(4000);
    for (Ray& ray : rays) {
        ray.origin = Vec3f(1, 2, 3) + 9 * Vec3f(number(random), number(random), number(random));
        ray.direction =
            Vec3f(1, 2, 3) + 2 * Vec3f(number(random), number(random), number(random)) - ray.origin;
    }
    size_t hits = 0, wrong = 0;
    for (const Ray& ray : rays) {
        const Hit hit = whole.root->intersect(ray);
        hits += hit.is_hit();
        for (const Assembly& other : others) wrong += other.root->intersect(ray) != hit;
    }
    CHECK(hits > 1000);
    CHECK(wrong == 0);
}

TEST_CASE("baking: one mesh that is moved needs no structure above it, and no instance") {
    Scene scene;
    scene.add_node("ball", add_mesh(scene, ball()), translation({1, 2, 3}));
    CHECK(inside(*assemble(scene, plan(true)).root) == std::vector<std::string>{"wide_bvh"});
    CHECK(instances_in(*assemble(scene, plan(false)).root) == 1);
}

}  // namespace
}  // namespace crofton
