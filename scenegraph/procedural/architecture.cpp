#include <array>

#include "scenegraph/procedural/generators.h"
#include "scenegraph/procedural/mesh_builder.h"

namespace crofton::procedural {
namespace {

/// Two vertices per segment boundary, one ring at each (radius, height), joined by quads.
void add_ring(MeshBuilder& mesh, uint32_t segments, double radius_a, double height_a,
              double radius_b, double height_b) {
    std::vector<uint32_t> first;
    for (uint32_t i = 0; i < segments; ++i) {
        const CosSin angle = cos_sin(double(i) / segments);
        first.push_back(mesh.vertex({radius_a * angle.cos, height_a, -radius_a * angle.sin}));
        mesh.vertex({radius_b * angle.cos, height_b, -radius_b * angle.sin});
    }
    for (uint32_t i = 0; i < segments; ++i) {
        const uint32_t a = first[i], b = first[(i + 1) % segments];
        mesh.quad(a, a + 1, b + 1, b);
    }
}

/// Radii and heights of the stadium, from its size.
struct StadiumPlan {
    double inner, outer, top, floor;
    uint32_t rows, segments;
};

Geometry stadium_steps(const StadiumPlan& plan) {
    MeshBuilder mesh;
    const double depth = (plan.outer - plan.inner) / plan.rows;
    const double rise = (plan.top - plan.floor) / plan.rows;
    for (uint32_t row = 0; row < plan.rows; ++row) {
        const double radius = plan.inner + row * depth, height = plan.floor + row * rise;
        add_ring(mesh, plan.segments, radius, height, radius, height + rise);
        add_ring(mesh, plan.segments, radius, height + rise, radius + depth, height + rise);
    }
    return mesh.geometry("steps");
}

Geometry stadium_shell(const StadiumPlan& plan) {
    MeshBuilder mesh;
    const double roof = plan.floor + 1.5 * (plan.top - plan.floor);
    add_ring(mesh, plan.segments, plan.outer, plan.top, plan.outer, plan.floor);
    add_ring(mesh, plan.segments, 0.8 * plan.outer, roof, 1.05 * plan.outer, roof);
    const uint32_t center = mesh.vertex({0, plan.floor, 0});
    for (uint32_t i = 0; i < plan.segments; ++i) {
        const CosSin a = cos_sin(double(i) / plan.segments);
        mesh.vertex(Vec3d(1.05 * plan.outer * a.cos, plan.floor, -1.05 * plan.outer * a.sin));
    }
    for (uint32_t i = 0; i < plan.segments; ++i)
        mesh.triangle(center, center + 1 + i, center + 1 + (i + 1) % plan.segments);
    return mesh.geometry("shell");
}

void add_columns_and_masts(Scene& scene, const StadiumPlan& plan) {
    const double height = plan.top - plan.floor;
    MeshBuilder column;
    column.column(Vec3d::Zero(), 0.01 * plan.outer, 1.5 * height, 8);
    std::vector<Transform> columns;
    const uint32_t count = plan.segments / 4;
    for (uint32_t i = 0; i < count; ++i) {
        const CosSin a = cos_sin((i + 0.5) / count);
        columns.push_back(
            translation({1.02 * plan.outer * a.cos, plan.floor, -1.02 * plan.outer * a.sin}));
    }
    const uint32_t node = scene.add_object("columns", column.geometry("column"));
    scene.nodes[node].node_from_instance = std::move(columns);

    MeshBuilder mast;
    const double lamp = 0.03 * plan.outer;
    mast.column(Vec3d::Zero(), 0.005 * plan.outer, 3 * height, 6);
    mast.box(Vec3d(-lamp, 3 * height, -lamp), Vec3d(lamp, 3 * height + lamp, lamp));
    std::vector<Transform> masts;
    for (uint32_t i = 0; i < 4; ++i) {
        const CosSin a = cos_sin((i + 0.5) / 4);
        const Vec3d foot(1.1 * plan.outer * a.cos, plan.floor, -1.1 * plan.outer * a.sin);
        masts.push_back(translation(foot));
        scene.lights.push_back({foot + Vec3d(0, 2.9 * height, 0)});
    }
    const uint32_t masts_node = scene.add_object("masts", mast.geometry("mast"));
    scene.nodes[masts_node].node_from_instance = std::move(masts);
}

struct Corner2 {
    double x, z;
};

/// Block over a footprint, without its bottom: five quads.
Geometry block(const char* name, const std::array<Corner2, 4>& footprint, double height) {
    MeshBuilder mesh;
    const auto at = [&](size_t i, double y) {
        return Vec3d(footprint[i % 4].x, y, footprint[i % 4].z);
    };
    mesh.quad(at(0, height), at(1, height), at(2, height), at(3, height));
    for (size_t i = 0; i < 4; ++i)
        mesh.quad(at(i + 1, 0), at(i + 1, height), at(i, height), at(i, 0));
    return mesh.geometry(name);
}

Geometry wall(const char* name, uint32_t material, const Vec3d& a, const Vec3d& b, const Vec3d& c,
              const Vec3d& d) {
    MeshBuilder mesh;
    mesh.quad(a, b, c, d);
    return mesh.geometry(name, material);
}

}  // namespace

// Teapot in a stadium: Eric Haines, "Spline Surface Rendering, and What's Wrong with Octrees",
// Ray Tracing News 1(2), 1988.
Scene stadium(const ProceduralValues& values) {
    const double radius = 0.5 * values.at("size"), pedestal = values.at("pedestal");
    // Masts stand at 1.1 times the outer radius and their lamps reach 0.03 further.
    const double outer = radius / 1.14;
    const StadiumPlan plan{0.5 * outer,
                           outer,
                           0.3 * outer - pedestal,
                           -pedestal,
                           uint32_t(values.at("rows")),
                           uint32_t(values.at("segments"))};
    Scene scene;
    scene.add_object("steps", stadium_steps(plan));
    scene.add_object("shell", stadium_shell(plan));
    add_columns_and_masts(scene, plan);
    MeshBuilder block;
    block.box(Vec3d(-0.5, -1, -0.5) * pedestal, Vec3d(0.5, 0, 0.5) * pedestal);
    scene.add_object("pedestal", block.geometry("pedestal"));
    scene.cameras.push_back(
        camera(Vec3d(1.5, 1.5, 2.5) * pedestal, Vec3d(0, 0.4, 0) * pedestal, Vec3d::UnitY()));
    return scene;
}

// Measured by the Program of Computer Graphics, Cornell University, in millimetres. The light is
// lowered by 0.05 so that it does not coincide with the ceiling.
Scene cornell_box(const ProceduralValues&) {
    Scene scene;
    scene.materials = {{"white", {0.75f, 0.75f, 0.75f}},
                       {"red", {0.65f, 0.05f, 0.05f}},
                       {"green", {0.12f, 0.45f, 0.15f}}};
    scene.add_object("floor",
                     wall("floor", 0, {552.8, 0, 0}, {0, 0, 0}, {0, 0, 559.2}, {549.6, 0, 559.2}));
    scene.add_object("ceiling", wall("ceiling", 0, {556, 548.8, 0}, {556, 548.8, 559.2},
                                     {0, 548.8, 559.2}, {0, 548.8, 0}));
    scene.add_object("back", wall("back", 0, {549.6, 0, 559.2}, {0, 0, 559.2}, {0, 548.8, 559.2},
                                  {556, 548.8, 559.2}));
    scene.add_object("right",
                     wall("right", 2, {0, 0, 559.2}, {0, 0, 0}, {0, 548.8, 0}, {0, 548.8, 559.2}));
    scene.add_object("left", wall("left", 1, {552.8, 0, 0}, {549.6, 0, 559.2}, {556, 548.8, 559.2},
                                  {556, 548.8, 0}));
    scene.add_object("light", wall("light", 0, {343, 548.75, 227}, {343, 548.75, 332},
                                   {213, 548.75, 332}, {213, 548.75, 227}));
    scene.add_object("short block",
                     block("short block", {{{130, 65}, {82, 225}, {240, 272}, {290, 114}}}, 165));
    scene.add_object("tall block",
                     block("tall block", {{{423, 247}, {265, 296}, {314, 456}, {472, 406}}}, 330));
    Camera view = camera({278, 273, -800}, {278, 273, 0}, Vec3d::UnitY());
    view.fov_y = 0.6860511529107446;  // 2 atan(0.0125 / 0.035)
    scene.cameras.push_back(view);
    scene.lights.push_back({{278, 548, 279.5}});
    return scene;
}

Scene menger(const ProceduralValues& values) {
    Scene scene;
    MeshBuilder cube;
    cube.box(Vec3d::Zero(), Vec3d::Ones());
    uint32_t inner = scene.add_object("cube", cube.geometry("cube"));
    for (int level = 1; level <= int(values.at("depth")); ++level) {
        const uint32_t sponge = scene.add_node("level " + std::to_string(level), {});
        for (int cell = 0; cell < 27; ++cell) {
            const int x = cell % 3, y = cell / 3 % 3, z = cell / 9;
            if ((x == 1) + (y == 1) + (z == 1) >= 2) continue;
            Transform place = scaling(Vec3d::Constant(1.0 / 3));
            place.translation = Vec3d(x, y, z) / 3;
            const uint32_t child = scene.add_node("", {}, place, sponge);
            scene.nodes[child].children = {inner};
        }
        inner = sponge;
    }
    scene.roots = {inner};
    scene.cameras.push_back(camera({2.2, 1.7, 2.6}, Vec3d::Constant(0.5), Vec3d::UnitY()));
    scene.lights.push_back({{4, 6, 5}});
    return scene;
}

}  // namespace crofton::procedural
