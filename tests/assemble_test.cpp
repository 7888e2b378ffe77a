// From a scene and a plan to one Primitive: which node gets which structure, and with which ids.

#include "scenegraph/assemble.h"
#include "framework/error.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

using Choice = std::shared_ptr<const AcceleratorChoice>;

Choice choice(const std::string& type, Choice inside = nullptr) {
    return std::make_shared<AcceleratorChoice>(
        AcceleratorChoice{type, type, {}, std::move(inside)});
}

Geometry ball() {
    TriangleMesh mesh;
    test::icosphere(1, mesh.positions, mesh.triangles);
    return {"ball", 0, mesh};
}

/// root ─ left ─ a, b;  root ─ right ─ c; the three share one mesh.
Scene family() {
    Scene scene;
    scene.name = "family";
    const uint32_t mesh = uint32_t(scene.meshes.size());
    scene.meshes.push_back({"ball", {scene.add_geometry(ball())}});
    const uint32_t root = scene.add_node("root", {});
    const uint32_t left = scene.add_node("left", {}, translation({-4, 0, 0}), root);
    const uint32_t right = scene.add_node("right", {}, translation({4, 0, 0}), root);
    scene.add_node("a", mesh, translation({0, -2, 0}), left);
    scene.add_node("b", mesh, translation({0, 2, 0}), left);
    scene.add_node("c", mesh, scaling({1, 2, 1}), right);
    return scene;
}

Hit shoot(const Primitive& p, float x, float y) {
    Ray ray;
    ray.origin = Vec3f(x, y, 10);
    ray.direction = Vec3f(0, 0, -1);
    return p.intersect(ray);
}

AssemblyPlan plan() {
    AssemblyPlan p;
    p.top = choice("bvh");
    p.objects = choice("bvh");
    return p;
}

const Assembly::Entry* find(const Assembly& assembly, const std::string& path) {
    for (const Assembly::Entry& e : assembly.entries)
        if (e.path == path) return &e;
    return nullptr;
}

std::string error_of(const Scene& scene, const AssemblyPlan& p) {
    try {
        assemble(scene, p);
    } catch (const InputError& e) {
        return e.what();
    }
    return "";
}

}  // namespace

TEST_CASE("instances are numbered depth first, and share the structure of their mesh") {
    const Assembly a = assemble(family(), plan());
    CHECK(a.triangles == 80);
    CHECK(a.instances == 3);
    CHECK(shoot(*a.root, -4, -2).instance == 0);
    CHECK(shoot(*a.root, -4, 2).instance == 1);
    CHECK(shoot(*a.root, 4, 0).instance == 2);
    CHECK_FALSE(shoot(*a.root, 0, 0).is_hit());
    REQUIRE(find(a, "root/left/a"));
    CHECK(find(a, "root/left/a")->placements == 3);
}

TEST_CASE("flattening changes no bit of any hit") {
    AssemblyPlan flat = plan();
    flat.flatten = true;
    const Assembly a = assemble(family(), plan()), b = assemble(family(), flat);
    CHECK(b.triangles == 240);
    for (int i = 0; i < 2000; ++i) {
        const float x = -6 + 12 * float(i % 50) / 50, y = -4 + 8 * float(i / 50) / 40;
        CHECK(shoot(*a.root, x, y) == shoot(*b.root, x, y));
    }
}

TEST_CASE(
    "a rule on a mesh node gives that mesh its structure, on a group a structure of its own") {
    AssemblyPlan p = plan();
    p.rules = {{"root/left", choice("uniform_grid", choice("brute_force")), ""},
               {"c", choice("uniform_grid"), ""}};
    const Assembly a = assemble(family(), p);
    REQUIRE(find(a, "root/left"));
    CHECK(find(a, "root/left")->type == "uniform_grid");
    CHECK(find(a, "root/left/a")->type == "brute_force");
    CHECK(find(a, "root/right/c")->type == "uniform_grid");
    CHECK(find(a, "(top)")->type == "bvh");
    CHECK(shoot(*a.root, -4, 2).instance == 1);
    CHECK(shoot(*a.root, 4, 0).instance == 2);
}

TEST_CASE("patterns match names, paths and globs") {
    CHECK(matches("a", "a", "root/left/a"));
    CHECK(matches("root/left/a", "a", "root/left/a"));
    CHECK(matches("root/*/a", "a", "root/left/a"));
    CHECK(matches("**/a", "a", "root/left/a"));
    CHECK(matches("root/**", "a", "root/left/a"));
    CHECK(matches("le?t", "left", "root/left"));
    CHECK_FALSE(matches("root/*", "a", "root/left/a"));
    CHECK_FALSE(matches("left", "a", "root/left/a"));
    CHECK_FALSE(matches("A", "a", "a"));
}

TEST_CASE("a rule that matches no node is refused with its place and the nearest name") {
    AssemblyPlan p = plan();
    p.rules = {{"lefft", choice("bvh"), "x.toml:3:9"}};
    const std::string e = error_of(family(), p);
    CHECK(e.find("x.toml:3:9") == 0);
    CHECK(e.find("did you mean 'left'?") != std::string::npos);
}

TEST_CASE("what cannot be placed is left out and reported") {
    Scene scene = family();
    scene.nodes[5].parent_from_node = scaling({1, 0, 1});
    const Assembly a = assemble(scene, plan());
    CHECK(a.inactive_instances == 1);
    CHECK(a.warnings.size() == 1);
    CHECK(shoot(*a.root, -4, 2).instance == 1);
    CHECK_FALSE(shoot(*a.root, 4, 0).is_hit());
}

TEST_CASE("an empty scene is a miss, and a single object needs no structure above it") {
    const Assembly empty = assemble(Scene{}, plan());
    CHECK_FALSE(shoot(*empty.root, 0, 0).is_hit());
    CHECK(empty.root->bounds().empty());
    Scene one;
    one.add_object("ball", ball());
    AssemblyPlan p = plan();
    p.objects = choice("uniform_grid");
    CHECK(assemble(one, p).root->type_name() == "uniform_grid");
}

TEST_CASE("triangles, quadrics and polygons of one mesh live under one structure") {
    Scene scene;
    Polygons square;
    square.positions = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}};
    square.first = {0, 4};
    const uint32_t g0 = scene.add_geometry(ball());
    const uint32_t g1 = scene.add_geometry({"s", 0, Quadrics{{Sphere{{4, 0, 0}, 1}}}});
    const uint32_t g2 = scene.add_geometry({"p", 0, square});
    for (Vec3f& v : std::get<Polygons>(scene.geometries[g2].shapes).positions) v += Vec3f(-4, 0, 0);
    scene.meshes.push_back({"mixed", {g0, g1, g2}});
    scene.add_node("mixed", 0, scaling({2, 2, 2}));
    for (const bool flatten : {false, true}) {
        AssemblyPlan p = plan();
        p.flatten = flatten;
        const Assembly a = assemble(scene, p);
        CHECK(shoot(*a.root, 0.1f, 0.2f).geometry == g0);
        CHECK(shoot(*a.root, 8, 0).geometry == g1);
        CHECK(shoot(*a.root, 8, 0).t == 8.0f);
        CHECK(shoot(*a.root, -8, 0).geometry == g2);
    }
}

}  // namespace crofton
