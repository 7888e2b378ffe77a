#include "experiments/calibration_scenes.h"

#include <Eigen/Geometry>
#include <cmath>

#include "experiments/camera.h"
#include "experiments/random.h"
#include "experiments/workload.h"
#include "scenegraph/assemble.h"
#include "scenegraph/procedural/procedural.h"

namespace crofton {
namespace {

/// Adds a sheet of 2·n·n triangles, point(u, v) for u, v in [0, 1].
template <class Point>
void add_sheet(TriangleMesh& mesh, int n, const Point& point) {
    const auto first = uint32_t(mesh.positions.size());
    for (int i = 0; i <= n; ++i)
        for (int j = 0; j <= n; ++j)
            mesh.positions.push_back(point(double(i) / n, double(j) / n).template cast<float>());
    const auto at = [&](int i, int j) { return first + uint32_t(i * (n + 1) + j); };
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
            mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
            mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
        }
}

void add_ball(TriangleMesh& mesh, const Vec3d& center, double radius, int n, Pcg32& rng) {
    const double waves = std::floor(2 + 6 * rng.uniform()), depth = 0.2 * rng.uniform();
    add_sheet(mesh, n, [&](double u, double v) {
        const double a = 2 * pi * u, b = pi * v;
        const double r = radius * (1 + depth * std::sin(waves * a) * std::sin(b));
        return Vec3d(center +
                     r * Vec3d(std::cos(a) * std::sin(b), std::cos(b), std::sin(a) * std::sin(b)));
    });
}

/// Twelve triangles, turned at random; half of the boxes are long and thin.
void add_box(TriangleMesh& mesh, const Vec3d& center, double size, Pcg32& rng) {
    Vec3d x = uniform_direction(rng), y, z;
    perpendicular(x, y, z);
    const double thin = rng.uniform() < 0.5 ? 0.03 : 0.5;
    x *= size, y *= size * thin, z *= size * thin * (0.5 + rng.uniform());
    const auto first = uint32_t(mesh.positions.size());
    for (int i = 0; i < 8; ++i)
        mesh.positions.push_back(
            (center + (i & 1 ? 1 : -1) * x + (i & 2 ? 1 : -1) * y + (i & 4 ? 1 : -1) * z)
                .cast<float>());
    static constexpr uint32_t faces[6][4] = {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4},
                                             {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}};
    for (const auto& f : faces) {
        mesh.triangles.push_back({first + f[0], first + f[1], first + f[2]});
        mesh.triangles.push_back({first + f[0], first + f[2], first + f[3]});
    }
}

/// @param boxes  share of the objects that are boxes
TriangleMesh clutter(size_t triangles, double boxes, uint64_t seed) {
    TriangleMesh mesh;
    Pcg32 rng(seed, 9);
    add_sheet(mesh, 1, [](double u, double v) { return Vec3d(2 * u - 1, -0.5, 2 * v - 1); });
    while (mesh.triangles.size() < triangles) {
        const size_t left = triangles - mesh.triangles.size();
        const Vec3d center(1.6 * rng.uniform() - 0.8, 0.8 * rng.uniform() - 0.4,
                           1.6 * rng.uniform() - 0.8);
        const double size = 0.005 * std::pow(100.0, rng.uniform());
        if (rng.uniform() < boxes || left < 32) {
            add_box(mesh, center, size, rng);
        } else {
            const double most = std::sqrt(double(left) / 2);
            add_ball(mesh, center, size, int(std::min(most, 4 * std::pow(12.0, rng.uniform()))),
                     rng);
        }
    }
    return mesh;
}

Scene scene_of(Geometry geometry) {
    Scene scene;
    scene.name = scene.source = geometry.name = "calibration";
    scene.add_object("calibration", std::move(geometry));
    return scene;
}

/// Parallelograms: b + c - a closes each triangle a, b, c.
Polygons polygons_of(const TriangleMesh& mesh) {
    Polygons out;
    out.first.push_back(0);
    for (const auto& t : mesh.triangles) {
        const Vec3f &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
        for (const Vec3f& p : {a, b, Vec3f(b + c - a), c}) out.positions.push_back(p);
        out.first.push_back(uint32_t(out.positions.size()));
    }
    return out;
}

/// A sphere, or a thin cone along an edge, in place of each triangle.
Quadrics quadrics_of(const TriangleMesh& mesh) {
    Quadrics out;
    for (size_t i = 0; i < mesh.triangles.size(); ++i) {
        const auto& t = mesh.triangles[i];
        const Vec3f &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
        const float edge = std::sqrt((b - a).cross(c - a).norm());
        if (i % 2)
            out.shapes.push_back(Sphere{(a + b + c) / 3, 0.4f * edge});
        else
            out.shapes.push_back(Cone{a, 0.15f * edge, b, 0.1f * edge});
    }
    return out;
}

CalibrationScene with_rays(const std::string& shapes, double size, Scene scene) {
    CalibrationScene s{shapes, size, std::move(scene), 0, {}, {}, {}};
    const SceneStatistics stats = statistics(s.scene);
    s.count = stats.shapes_instanced;
    AcceleratorChoice quick{"quick", "bvh", {{"builder", std::string("lbvh")}}, nullptr};
    AssemblyPlan plan;
    plan.top = plan.objects = std::make_shared<const AcceleratorChoice>(quick);
    const Assembly reference = assemble(s.scene, plan);
    // So many that each needs to be traced only once: caches and branch predictors learn fast.
    constexpr size_t most = 4096;
    constexpr int edge = 64;
    Pcg32 rng(3);
    BoundingSphere sphere = bounding_sphere(stats.bounds_min, stats.bounds_max);
    sphere.radius *= 0.7;  // of lines through all of it, many would pass by what is in it
    for (Ray line : random_lines(sphere, most, 1)) {
        line.origin -= line.direction * float(sphere.radius);
        line.t_max = std::numeric_limits<float>::infinity();
        s.lines.push_back(line);
    }
    s.view = camera_rays(choose_camera({}, s.scene, sphere), edge, edge);
    for (const Ray& seen : s.view) {
        const Hit hit = reference.root->intersect(seen);
        if (!hit.is_hit()) continue;
        Ray ray;
        ray.origin = seen.origin + seen.direction * (hit.t * 0.999f);
        ray.direction = uniform_direction(rng).cast<float>();
        s.inside.push_back(ray);
    }
    return s;
}

}  // namespace

std::vector<CalibrationScene> calibration_scenes() {
    std::vector<CalibrationScene> out;
    for (const double n : {16.0, 256.0, 4096.0, 16384.0, 65536.0}) {
        const TriangleMesh balls = clutter(size_t(n), 0.2, 1), boxes = clutter(size_t(n), 0.95, 2);
        if (n != 16384) {
            const double edge = std::round(std::sqrt(n / 2));
            out.push_back(with_rays("triangles", n, make_scene("terrain", {{"n", edge}})));
            out.push_back(with_rays("triangles", n, scene_of({"", 0, balls})));
            out.push_back(with_rays("triangles", n, scene_of({"", 0, boxes})));
        }
        // Of these there are fewer sizes: a calibration is to take less than half a minute.
        if (n == 4096 || n == 65536) continue;
        out.push_back(with_rays("polygons", n, scene_of({"", 0, polygons_of(balls)})));
        out.push_back(with_rays("polygons", n, scene_of({"", 0, polygons_of(boxes)})));
        out.push_back(with_rays("quadrics", n, scene_of({"", 0, quadrics_of(balls)})));
        out.push_back(with_rays("quadrics", n, scene_of({"", 0, quadrics_of(boxes)})));
    }
    return out;
}

}  // namespace crofton
