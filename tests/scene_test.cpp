#include "scenegraph/scene.h"

#include <filesystem>

#include "framework/error.h"
#include "scenegraph/append.h"
#include "tests/catch.h"
#include "tests/scratch_file.h"

using namespace crofton;

namespace {

using Catch::Matchers::ContainsSubstring;

/// One right triangle in the plane z = 0.
TriangleMesh unit_triangle() {
    return {{Vec3f(0, 0, 0), Vec3f(1, 0, 0), Vec3f(0, 1, 0)}, {{{0, 1, 2}}}};
}

Scene one_triangle() {
    Scene scene;
    scene.add_object("triangle", {"triangle", 0, unit_triangle()});
    return scene;
}

void check_near(const Vec3d& a, const Vec3d& b, double tolerance = 1e-12) {
    INFO(a.transpose() << " and " << b.transpose());
    CHECK((a - b).cwiseAbs().maxCoeff() <= tolerance);
}

}  // namespace

TEST_CASE("scene: add_object makes a geometry, a mesh and a node under its parent") {
    Scene scene = one_triangle();
    const uint32_t child = scene.add_object("child", {"child", 0, unit_triangle()},
                                            translation({5, 0, 0}), uint32_t{0});
    CHECK(scene.roots == std::vector<uint32_t>{0});
    CHECK(scene.nodes[0].children == std::vector<uint32_t>{child});
    CHECK(scene.nodes[child].mesh == 1u);
    CHECK(scene.meshes[1].geometries == std::vector<uint32_t>{1});
}

TEST_CASE("scene: instances are listed depth first, parents before children, in order") {
    Scene scene;
    scene.meshes.resize(1);
    const uint32_t a = scene.add_node("a", 0u);
    const uint32_t b = scene.add_node("b", 0u, {}, a);
    const uint32_t c = scene.add_node("c", 0u, {}, b);
    const uint32_t d = scene.add_node("d", 0u, {}, a);
    const uint32_t e = scene.add_node("e", 0u);
    std::vector<uint32_t> order;
    for (const MeshInstance& i : mesh_instances(scene)) order.push_back(i.node);
    CHECK(order == std::vector<uint32_t>{a, b, c, d, e});
}

TEST_CASE("scene: transforms of a path are composed from the root, instances last") {
    Scene scene = one_triangle();
    const uint32_t parent = scene.add_node("parent", {}, translation({10, 0, 0}));
    const uint32_t child = scene.add_node("child", 0u, scaling({2, 2, 2}), parent);
    scene.nodes[child].node_from_instance = {translation({1, 0, 0}), translation({3, 0, 0})};
    const std::vector<MeshInstance> instances = mesh_instances(scene);
    REQUIRE(instances.size() == 3);
    check_near(instances[1].world_from_object.point(Vec3d::Zero()), {12, 0, 0});
    check_near(instances[2].world_from_object.point(Vec3d::Zero()), {16, 0, 0});
    const SceneStatistics s = statistics(scene);
    CHECK(s.mesh_instances == 3);
    CHECK(s.triangles_unique == 1);
    CHECK(s.triangles_instanced == 3);
    CHECK(s.depth == 2);
    check_near(s.bounds_min, {0, 0, 0});
    check_near(s.bounds_max, {18, 2, 0});
}

TEST_CASE("scene: a chain of a million nodes does not exhaust the stack") {
    Scene scene = one_triangle();
    scene.nodes[0].mesh.reset();
    for (uint32_t i = 0; i < 1000000; ++i)
        scene.add_node("", i == 999999 ? std::optional<uint32_t>(0) : std::nullopt, {}, i);
    CHECK(mesh_instances(scene).size() == 1);
    CHECK(statistics(scene).depth == 1000001);
}

TEST_CASE("scene: shared nodes that multiply beyond the limit are refused at once") {
    // Each of 60 levels has the next as a child twice: 2^60 paths.
    Scene scene;
    scene.meshes.resize(1);
    for (uint32_t i = 0; i < 60; ++i) scene.nodes.push_back({"", {}, {i + 1, i + 1}, {}, {}});
    scene.nodes.push_back({"", {}, {}, 0u, {}});
    scene.roots = {0};
    CHECK_THROWS_WITH(mesh_instances(scene),
                      ContainsSubstring("more than 16777216 mesh instances"));
    CHECK_THROWS_AS(statistics(scene), InputError);
    SECTION("and cost nothing if they lead to no mesh") {
        scene.nodes.back().mesh.reset();
        CHECK(mesh_instances(scene).empty());
        CHECK(statistics(scene).depth == 61);
    }
}

TEST_CASE("scene: the bounds of quadrics under a transform are exact") {
    Scene scene;
    Transform stretch = scaling({2, 1, 1});
    Quadrics shapes;
    SECTION("sphere, sheared") {
        shapes.shapes = {Sphere{Vec3f(1, 0, 0), 1.0f}};
        stretch.linear << 1, 1, 0, 0, 1, 0, 0, 0, 1;
        scene.add_object("s", {"s", 0, shapes}, stretch);
        check_near(statistics(scene).bounds_max, {1 + std::sqrt(2.0), 1, 1});
        check_near(statistics(scene).bounds_min, {1 - std::sqrt(2.0), -1, -1});
    }
    SECTION("cylinder along x") {
        shapes.shapes = {Cone{Vec3f(0, 0, 0), 0.5f, Vec3f(4, 0, 0), 0.5f}};
        scene.add_object("c", {"c", 0, shapes}, stretch);
        check_near(statistics(scene).bounds_min, {0, -0.5, -0.5});
        check_near(statistics(scene).bounds_max, {8, 0.5, 0.5});
    }
    SECTION("disc facing (1, 1, 0)") {
        shapes.shapes = {Disc{Vec3f(0, 0, 0), 1.0f, Vec3f(1, 1, 0)}};
        scene.add_object("d", {"d", 0, shapes}, stretch);
        check_near(statistics(scene).bounds_max, {2 * std::sqrt(0.5), std::sqrt(0.5), 1});
    }
}

TEST_CASE("scene: a triangle with a vertex that is not finite counts and has no bounds") {
    TriangleMesh mesh = unit_triangle();
    mesh.positions.push_back(Vec3f(7, std::numeric_limits<float>::quiet_NaN(), 9));
    mesh.positions.push_back(Vec3f(9, 9, 9));
    mesh.triangles.push_back({0, 3, 4});
    Scene scene;
    scene.add_object("m", {"m", 0, mesh});
    const SceneStatistics s = statistics(scene);
    CHECK(s.triangles_unique == 2);
    CHECK(s.zero_area_triangles_object_space == 0);
    check_near(s.bounds_max, {1, 1, 0});
}

TEST_CASE("scene: zero-area triangles are counted in object space, once per mesh") {
    TriangleMesh mesh = unit_triangle();
    mesh.triangles.push_back({1, 1, 2});
    Scene scene;
    scene.add_object("m", {"m", 0, mesh}, scaling({1, 0, 1}));
    scene.add_node("again", 0u, scaling({-1, 1, 1}));
    const SceneStatistics s = statistics(scene);
    CHECK(s.zero_area_triangles_object_space == 1);
    CHECK(s.triangles_instanced == 4);
    CHECK(s.mirrored_instances == 1);
}

TEST_CASE("scene: an empty scene has empty bounds and depth 0") {
    const SceneStatistics s = statistics(Scene{});
    CHECK(s.depth == 0);
    CHECK(s.bounds_min.x() > s.bounds_max.x());
}

TEST_CASE("scene: append places a scene under one new root and keeps materials apart") {
    Scene scene = one_triangle();  // no materials: index 0 means none
    Scene other = one_triangle();
    other.materials.push_back({"red", {1, 0, 0}});
    other.cameras.emplace_back();
    other.lights.push_back({{1, 1, 1}});
    const uint32_t root = append(scene, other, translation({0, 0, 5}), "other");
    CHECK(scene.nodes[root].name == "other");
    CHECK(scene.roots == std::vector<uint32_t>{0, root});
    CHECK(scene.geometries[0].material >= scene.materials.size());
    CHECK(scene.geometries[1].material == 0);
    check_near(scene.cameras[0].eye, {0, 0, 5});
    check_near(scene.lights[0].position, {1, 1, 6});
    const std::vector<MeshInstance> instances = mesh_instances(scene);
    REQUIRE(instances.size() == 2);
    CHECK(instances[1].mesh == 1);
    check_near(instances[1].world_from_object.translation, {0, 0, 5});
}

TEST_CASE("load_scene: what cannot be loaded is named with the reason") {
    CHECK_THROWS_WITH(load_scene("no/such/file.obj"),
                      ContainsSubstring("no/such/file.obj: no such file"));
    CHECK_THROWS_WITH(load_scene(std::filesystem::temp_directory_path().string()),
                      ContainsSubstring("directory"));
    const ScratchFile typing_error("mesh.plyy", "");
    CHECK_THROWS_WITH(
        load_scene(typing_error.path()),
        ContainsSubstring("did you mean 'ply'?") && ContainsSubstring("gltf glb obj ply nff"));
    const ScratchFile unknown("mesh.blender", "");
    CHECK_THROWS_WITH(load_scene(unknown.path()),
                      ContainsSubstring("valid: gltf, glb, obj, ply, nff"));
}

TEST_CASE("load_scene: endings do not depend on case; the name is the stem") {
    const ScratchFile file("My Mesh.OBJ", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    const Scene scene = load_scene(file.path());
    CHECK(scene.name == "My Mesh");
    CHECK(scene.source == file.path());
}
