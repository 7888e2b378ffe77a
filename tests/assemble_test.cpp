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

TEST_CASE("opening changes no bit of any hit, and says what it opened") {
    Scene crowd = family();
    // Sticks across each other, so that their boxes are large and mostly empty.
    crowd.nodes[1].parent_from_node = translation({4, 0, 0});
    for (uint32_t i = 3; i < 6; ++i)
        crowd.nodes[i].parent_from_node =
            rotation(Vec3d(0, 0, 1), 0.8 * i) * scaling({0.1, 4, 0.1});
    AssemblyPlan open = plan(), flat = plan();
    open.opening = 8;
    flat.flatten = true;
    const Assembly a = assemble(crowd, flat), b = assemble(crowd, open);
    CHECK(b.opened >= 2);
    CHECK(b.parts > b.opened);
    CHECK(assemble(crowd, plan()).opened == 0);
    CHECK(assemble(family(), open).opened == 0);  // nothing overlaps
    for (const char* top : {"bvh", "model_hierarchy"}) {
        open.top = choice(top);
        const Assembly c = assemble(crowd, open);
        for (int i = 0; i < 2000; ++i) {
            const float x = 10 * float(i % 50) / 50, y = -4 + 8 * float(i / 50) / 40;
            CHECK(shoot(*a.root, x, y) == shoot(*c.root, x, y));
        }
    }
}

TEST_CASE("model_hierarchy over a scene has a box for every node with more than one object") {
    const auto tree = std::make_shared<AcceleratorChoice>(
        AcceleratorChoice{"model", "model_hierarchy", {{"merge", false}}, nullptr});
    AssemblyPlan p = plan();
    p.top = tree;
    std::vector<Bounds3> boxes;
    assemble(family(), p).root->walk([&](const Bounds3& b, uint32_t, bool leaf, uint32_t) {
        if (!leaf) boxes.push_back(b);
    });
    // The scene's, and that of `left`; `right` has one object.
    REQUIRE(boxes.size() == 2);
    CHECK(boxes[1].upper.x() < -2);
    CHECK(boxes[1].lower.y() < -2.5f);
    CHECK(boxes[1].upper.y() > 2.5f);

    p.flatten = true;
    p.top = p.objects = tree;
    std::vector<Bounds3> baked;
    assemble(family(), p).root->walk([&](const Bounds3& b, uint32_t, bool, uint32_t) {
        baked.push_back(b);
    });
    CHECK(std::any_of(baked.begin(), baked.end(), [&](const Bounds3& b) {
        return (b.lower - boxes[1].lower).norm() < 1e-5f &&
               (b.upper - boxes[1].upper).norm() < 1e-5f;
    }));
}

TEST_CASE("placement groups are the nodes with more than one placement, chains once") {
    const ShapeGroups groups = placement_groups(family());
    REQUIRE(groups.size() == 2);
    CHECK(groups[0].first == 0);
    CHECK(groups[0].end == 3);
    CHECK(groups[1].first == 0);
    CHECK(groups[1].end == 2);

    Scene chain = family();
    uint32_t below = 0;
    for (int i = 0; i < 100000; ++i) {
        const uint32_t link = chain.add_node("", {});
        chain.nodes[link].children = {below};
        below = link;
    }
    chain.roots = {below};
    CHECK(placement_groups(chain).size() == 2);
    AssemblyPlan p = plan();
    p.top = choice("model_hierarchy");
    CHECK(shoot(*assemble(chain, p).root, 4, 0).instance == 2);
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
