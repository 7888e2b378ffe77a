#include <vector>

#include "scenegraph/procedural/generators.h"
#include "scenegraph/procedural/mesh_builder.h"

/// Scenes of spheres, among them those of the Standard Procedural Databases: Eric Haines, "A
/// Proposal for Standard Graphics Environments", IEEE CG&A 7(11), 1987; geometry as in version 3.
namespace crofton::procedural {
namespace {

struct Ball {
    Vec3d center;
    double radius;
};

Sphere sphere_of(const Ball& ball) { return {ball.center.cast<float>(), float(ball.radius)}; }

/// Spheres as one geometry of quadrics, or as instances of one icosphere of 20·4^(tessellation − 1)
/// triangles.
void add_balls(Scene& scene, const std::string& name, const std::vector<Ball>& balls,
               uint32_t tessellation) {
    if (tessellation == 0) {
        Quadrics quadrics;
        for (const Ball& ball : balls) quadrics.shapes.push_back(sphere_of(ball));
        scene.add_object(name, {name, 0, std::move(quadrics)});
        return;
    }
    const uint32_t node = scene.add_object(name, {"icosphere", 0, icosphere(tessellation - 1)});
    for (const Ball& ball : balls) {
        Transform place = scaling(Vec3d::Constant(ball.radius));
        place.translation = ball.center;
        scene.nodes[node].node_from_instance.push_back(place);
    }
}

void add_lights(Scene& scene, std::initializer_list<Vec3d> positions) {
    for (const Vec3d& p : positions) scene.lights.push_back({p});
}

// --- Sphereflake ----------------------------------------------------------------------------

/// Directions of the nine children of a sphere whose own direction is +z.
std::vector<Vec3d> flake_directions() {
    const double half = 1 / std::sqrt(2.0);
    // The angle is asin(2/√6).
    const CosSin tilt{std::sqrt(1.0 / 3), std::sqrt(2.0 / 3)};
    std::vector<Vec3d> directions;
    for (int third = 0; third < 3; ++third)
        for (const Vec3d& d : {Vec3d(1, 1, 0), Vec3d(1, 0, -1), Vec3d(0, 1, -1)})
            directions.push_back(turned(turned(half * d, Vec3d(half, -half, 0), tilt),
                                        Vec3d::UnitZ(), cos_sin(third / 3.0)));
    return directions;
}

/// `v` under the shortest turn that takes +z to the unit vector `direction`; half a turn about y if
/// that is -z. (The SPD program leaves this case to rounding, and turns one of its three
/// otherwise.)
Vec3d turned_from_z(const Vec3d& v, const Vec3d& direction) {
    const Vec3d axis(-direction.y(), direction.x(), 0);
    const double sine = std::sqrt(axis.squaredNorm());
    if (sine < 1e-9) return direction.z() > 0 ? v : Vec3d(-v.x(), v.y(), -v.z());
    return turned(v, axis / sine, {direction.z(), sine});
}

/// Spheres of all levels, parents before children.
std::vector<Ball> flake(uint32_t depth) {
    const std::vector<Vec3d> nine = flake_directions();
    std::vector<Ball> balls = {{Vec3d::Zero(), 0.5}};
    std::vector<Vec3d> directions = {Vec3d::UnitZ()};
    size_t first = 0;
    for (uint32_t level = 0; level < depth; ++level) {
        const size_t end = balls.size();
        for (size_t parent = first; parent < end; ++parent)
            for (const Vec3d& d : nine) {
                const Vec3d direction = turned_from_z(d, directions[parent]);
                const double radius = balls[parent].radius;
                balls.push_back({balls[parent].center + direction * (radius * 4 / 3), radius / 3});
                directions.push_back(direction);
            }
        first = end;
    }
    return balls;
}

/// A rectangle as one polygon, and as two triangles where no polygon is wanted.
Geometry floor_square(double half, double z, bool as_triangles) {
    const Vec3f corners[] = {
        Vec3d(half, half, z).cast<float>(), Vec3d(-half, half, z).cast<float>(),
        Vec3d(-half, -half, z).cast<float>(), Vec3d(half, -half, z).cast<float>()};
    std::vector<Vec3f> positions(std::begin(corners), std::end(corners));
    if (as_triangles)
        return {"floor", 0, TriangleMesh{std::move(positions), {{{0, 1, 2}}, {{0, 2, 3}}}}};
    return {"floor", 0, Polygons{std::move(positions), {0, 4}}};
}

// --- Jacks ----------------------------------------------------------------------------------

void add_jack(Quadrics& quadrics, const Vec3d& center, double scale, const Eigen::Matrix3d& axes) {
    for (int axis = 0; axis < 3; ++axis) {
        const Vec3d arm = axes.row(axis).transpose() * (0.75 * scale);
        quadrics.shapes.push_back(Cone{(center - arm).cast<float>(), float(0.075 * scale),
                                       (center + arm).cast<float>(), float(0.075 * scale)});
    }
    for (int sign : {1, -1})
        for (int axis = 0; axis < 3; ++axis) {
            const Vec3d arm = axes.row(axis).transpose() * (0.75 * scale * sign);
            quadrics.shapes.push_back(sphere_of({center + arm, 0.15 * scale}));
        }
}

}  // namespace

Scene grid_of_spheres(const ProceduralValues& values) {
    const uint32_t n = uint32_t(values.at("n"));
    std::vector<Ball> balls;
    for (uint32_t k = 0; k < n; ++k)
        for (uint32_t j = 0; j < n; ++j)
            for (uint32_t i = 0; i < n; ++i)
                balls.push_back(
                    {Vec3d(i + 0.5, j + 0.5, k + 0.5) / n, 0.5 * values.at("fill") / n});
    Scene scene;
    add_balls(scene, "spheres", balls, uint32_t(values.at("tessellation")));
    scene.cameras.push_back(camera({1.9, 1.6, 2.4}, Vec3d::Constant(0.5), Vec3d::UnitY()));
    add_lights(scene, {{3, 5, 4}});
    return scene;
}

Scene sphereflake(const ProceduralValues& values) {
    const uint32_t tessellation = uint32_t(values.at("tessellation"));
    Scene scene;
    add_balls(scene, "balls", flake(uint32_t(values.at("depth"))), tessellation);
    scene.add_object("floor", floor_square(12, -0.5, tessellation > 0));
    scene.cameras.push_back(camera({2.1, 1.3, 1.7}, Vec3d::Zero(), Vec3d::UnitZ()));
    add_lights(scene, {{4, 3, 2}, {1, -4, 4}, {-3, 1, 5}});
    return scene;
}

Scene jacks(const ProceduralValues& values) {
    // Turned by 20° about y and 30° about x.
    const CosSin a = cos_sin(20.0 / 360), b = cos_sin(30.0 / 360);
    Eigen::Matrix3d axes;
    axes << a.cos, a.sin * b.sin, a.sin * b.cos,  //
        0, b.cos, -b.sin,                         //
        -a.sin, a.cos * b.sin, a.cos * b.cos;
    Quadrics quadrics;
    std::vector<Vec3d> centers = {Vec3d::Zero()};
    double scale = 1;
    for (uint32_t level = 0; level < uint32_t(values.at("depth")); ++level, scale *= 0.5) {
        std::vector<Vec3d> children;
        for (const Vec3d& center : centers) {
            add_jack(quadrics, center, scale, axes);
            for (int corner = 0; corner < 8; ++corner)
                children.push_back(center + axes.transpose() *
                                                Vec3d(corner & 1 ? 0.5 : -0.5,
                                                      corner & 2 ? 0.5 : -0.5,
                                                      corner & 4 ? 0.5 : -0.5) *
                                                scale);
        }
        centers = std::move(children);
    }
    Scene scene;
    scene.add_object("jacks", {"jacks", 0, std::move(quadrics)});
    Camera view = camera({0, 0, -8}, Vec3d::Zero(), Vec3d::UnitY());
    view.fov_y = 25 * std::numbers::pi / 180;
    scene.cameras.push_back(view);
    add_lights(scene, {{-10, 3, -20}});
    return scene;
}

Scene lattice(const ProceduralValues& values) {
    const uint32_t n = uint32_t(values.at("n"));
    Quadrics quadrics;
    for (uint32_t i = 0; i <= n; ++i)
        for (uint32_t j = 0; j <= n; ++j)
            for (uint32_t k = 0; k <= n; ++k) {
                const Vec3d center(i, j, k);
                quadrics.shapes.push_back(sphere_of({center / n, 0.25 / n}));
                for (int axis = 0; axis < 3; ++axis) {
                    if (center[axis] == n) continue;
                    // Bars start a little inside the spheres.
                    Vec3d base = center, apex = center;
                    base[axis] += 0.12375;
                    apex[axis] += 1 - 0.12375;
                    const float radius = float(0.0625 / n);
                    quadrics.shapes.push_back(
                        Cone{(base / n).cast<float>(), radius, (apex / n).cast<float>(), radius});
                }
            }
    Scene scene;
    scene.add_object("lattice", {"lattice", 0, std::move(quadrics)});
    const double off = 0.5 / n;
    Camera view = camera({0.5 + off, 1, 1 - off}, {0.5 + off, -1, -1 - off}, {0.2, 1, 0});
    view.fov_y = std::numbers::pi / 3;
    scene.cameras.push_back(view);
    add_lights(scene, {{2, 0.5, 0.5},
                       {-1, 0.5, 0.5},
                       {0.5, 2, 0.5},
                       {0.5, -1, 0.5},
                       {0.5, 0.5, 2},
                       {0.5, 0.5, -1}});
    return scene;
}

Scene tetra(const ProceduralValues& values) {
    const Vec3d corners[] = {{1, 1, 1}, {-1, -1, 1}, {1, -1, -1}, {-1, 1, -1}};
    std::vector<Vec3d> centers = {Vec3d::Zero()};
    double scale = 1;
    for (uint32_t level = 1; level < uint32_t(values.at("depth")); ++level) {
        scale *= 0.5;
        std::vector<Vec3d> children;
        for (const Vec3d& center : centers)
            for (const Vec3d& corner : corners) children.push_back(center + scale * corner);
        centers = std::move(children);
    }
    MeshBuilder mesh;
    for (const Vec3d& center : centers) {
        uint32_t v = 0;
        for (const Vec3d& corner : corners) v = mesh.vertex(center + scale * corner);
        v -= 3;
        mesh.triangle(v, v + 2, v + 3);
        mesh.triangle(v + 2, v, v + 1);
        mesh.triangle(v + 3, v + 1, v);
        mesh.triangle(v + 1, v + 3, v + 2);
    }
    Scene scene;
    scene.add_object("tetra", mesh.geometry("tetra"));
    scene.cameras.push_back(
        camera({1.02285, -3.17715, -2.17451}, {-0.004103, -0.004103, 0.216539}, Vec3d(-1, -1, 1)));
    add_lights(scene, {{2, -18, -5}});
    return scene;
}

}  // namespace crofton::procedural
