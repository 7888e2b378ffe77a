#include "experiments/calibration_scenes.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>

#include "experiments/camera.h"
#include "experiments/random.h"
#include "experiments/workload.h"
#include "scenegraph/assemble.h"
#include "scenegraph/procedural/procedural.h"

namespace crofton {
namespace {

/// Two triangles with corners of their own.
void add_quad(TriangleMesh& mesh, const std::array<Vec3f, 4>& corners) {
    const auto first = uint32_t(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), corners.begin(), corners.end());
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
}

/// Adds a sheet of 2·n·n triangles, point(u, v) for u, v in [0, 1].
/// @param faceted  with a normal for each face, and so corners
template <class Point>
void add_sheet(TriangleMesh& mesh, int n, bool faceted, const Point& point) {
    const auto first = uint32_t(mesh.positions.size());
    const auto place = [&](int i, int j) {
        return Vec3f(point(double(i) / n, double(j) / n).template cast<float>());
    };
    const auto at = [&](int i, int j) { return first + uint32_t(i * (n + 1) + j); };
    if (!faceted)
        for (int i = 0; i <= n; ++i)
            for (int j = 0; j <= n; ++j) mesh.positions.push_back(place(i, j));
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
            if (faceted) {
                add_quad(mesh,
                         {place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)});
                continue;
            }
            mesh.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
            mesh.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
        }
}

void add_ball(TriangleMesh& mesh, const Vec3d& center, double radius, int n, Pcg32& rng) {
    const double waves = std::floor(2 + 6 * rng.uniform()), depth = 0.2 * rng.uniform();
    const bool faceted = rng.uniform() < 0.25;
    add_sheet(mesh, n, faceted, [&](double u, double v) {
        const double a = 2 * pi * u, b = pi * v;
        const double r = radius * (1 + depth * std::sin(waves * a) * std::sin(b));
        return Vec3d(center +
                     r * Vec3d(std::cos(a) * std::sin(b), std::cos(b), std::sin(a) * std::sin(b)));
    });
}

/// Most of what is built stands upright and along the axes.
void choose_frame(Vec3d& x, Vec3d& y, Vec3d& z, Pcg32& rng) {
    constexpr double along_axes = 0.75;
    x = rng.uniform() < along_axes ? Vec3d(Vec3d::Unit(int(3 * rng.uniform())))
                                   : uniform_direction(rng);
    perpendicular(x, y, z);
}

/// Twelve triangles on corners of their faces' own, as where a model has a normal for each; half of
/// the boxes are long and thin.
void add_box(TriangleMesh& mesh, const Vec3d& center, double size, Pcg32& rng) {
    Vec3d x, y, z;
    choose_frame(x, y, z, rng);
    const double thin = rng.uniform() < 0.5 ? 0.03 : 0.5;
    x *= size, y *= size * thin, z *= size * thin * (0.5 + rng.uniform());
    static constexpr uint32_t faces[6][4] = {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4},
                                             {2, 3, 7, 6}, {0, 2, 6, 4}, {1, 3, 7, 5}};
    const auto corner = [&](uint32_t i) {
        return Vec3f((center + (i & 1 ? 1 : -1) * x + (i & 2 ? 1 : -1) * y + (i & 4 ? 1 : -1) * z)
                         .cast<float>());
    };
    for (const auto& f : faces)
        add_quad(mesh, {corner(f[0]), corner(f[1]), corner(f[2]), corner(f[3])});
}

/// A cylinder as machines are made of: long triangles around it, and fans of slivers as its ends,
/// on corners of their own; 4·n - 4 triangles.
void add_cylinder(TriangleMesh& mesh, const Vec3d& center, double size, int n, Pcg32& rng) {
    Vec3d x, y, z;
    choose_frame(x, y, z, rng);
    const double radius = size * (0.1 + 0.9 * rng.uniform());
    const auto add_rings = [&] {
        const auto first = uint32_t(mesh.positions.size());
        for (int end = 0; end < 2; ++end)
            for (int i = 0; i < n; ++i) {
                const double a = 2 * pi * i / n;
                mesh.positions.push_back((center + (end ? size : -size) * x +
                                          radius * (std::cos(a) * y + std::sin(a) * z))
                                             .cast<float>());
            }
        return [first, n](int end, int i) { return first + uint32_t(end * n + i % n); };
    };
    const auto side = add_rings(), cap = add_rings();
    for (int i = 0; i < n; ++i) {
        mesh.triangles.push_back({side(0, i), side(0, i + 1), side(1, i + 1)});
        mesh.triangles.push_back({side(0, i), side(1, i + 1), side(1, i)});
    }
    for (int end = 0; end < 2; ++end)
        for (int i = 1; i + 1 < n; ++i)
            mesh.triangles.push_back({cap(end, 0), cap(end, i), cap(end, i + 1)});
}

/// One object of a clutter.
struct Piece {
    enum class Kind { box, cylinder, ball } kind;
    Vec3d center;
    double size;
    int n;  ///< how fine it is

    size_t triangles() const {
        return size_t(kind == Kind::box ? 12 : kind == Kind::cylinder ? 4 * n - 4 : 2 * n * n);
    }
};

/// Objects over a floor, from one to a hundred in size, many small ones for each that is large. So
/// large that all together they have the same area, however many there are.
/// @param straight  share of the objects that are boxes or cylinders
TriangleMesh clutter(size_t triangles, double straight, uint64_t seed) {
    constexpr double all_sizes = 3, largest = 0.5;  // squares of sizes, summed
    TriangleMesh mesh;
    Pcg32 rng(seed, 9);
    add_sheet(mesh, 1, false, [](double u, double v) { return Vec3d(2 * u - 1, -0.5, 2 * v - 1); });
    std::vector<Piece> pieces;
    double sum = 0;
    for (size_t count = mesh.triangles.size(); count < triangles;
         count += pieces.back().triangles()) {
        const auto left = double(triangles - count);
        const double kind = rng.uniform(), fine = std::pow(12.0, rng.uniform());
        Piece piece{Piece::Kind::box, Vec3d::Zero(), 1 / (1 - 0.99 * rng.uniform()), 0};
        piece.center =
            Vec3d(1.6 * rng.uniform() - 0.8, 0.8 * rng.uniform() - 0.4, 1.6 * rng.uniform() - 0.8);
        if (kind < straight || left < 48) {
            if (kind > 0.5 * straight && left >= 48)
                piece.kind = Piece::Kind::cylinder, piece.n = int(std::min(left / 4, 6 * fine));
        } else {
            piece.kind = Piece::Kind::ball;
            piece.n = int(std::min(std::sqrt(left / 2), 4 * fine));
        }
        sum += piece.size * piece.size;
        pieces.push_back(piece);
    }
    for (const Piece& piece : pieces) {
        const double size = std::min(largest, piece.size * std::sqrt(all_sizes / sum));
        if (piece.kind == Piece::Kind::box) add_box(mesh, piece.center, size, rng);
        if (piece.kind == Piece::Kind::cylinder)
            add_cylinder(mesh, piece.center, size, piece.n, rng);
        if (piece.kind == Piece::Kind::ball) add_ball(mesh, piece.center, size, piece.n, rng);
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

/// Of a picture so many pixels, whole lines of them, evenly spread: as near each other as in
/// pictures that are traced, since that is what neighbours gain by.
std::vector<Ray> lines_of(const std::vector<Ray>& picture, size_t width, size_t most) {
    const size_t step = std::max<size_t>(1, picture.size() / most);
    std::vector<Ray> out;
    for (size_t line = step / 2; line < picture.size() / width; line += step) {
        const auto first = picture.begin() + long(line * width);
        out.insert(out.end(), first, first + long(width));
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
    constexpr size_t most = 8192;
    constexpr int edge = 256;
    Pcg32 rng(3);
    BoundingSphere sphere = bounding_sphere(stats.bounds_min, stats.bounds_max);
    sphere.radius *= 0.7;  // of lines through all of it, many would pass by what is in it
    for (Ray line : random_lines(sphere, most, 1)) {
        line.origin -= line.direction * float(sphere.radius);
        line.t_max = std::numeric_limits<float>::infinity();
        s.lines.push_back(line);
    }
    s.view = lines_of(camera_rays(choose_camera({}, s.scene, sphere), edge, edge), edge, most);
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
