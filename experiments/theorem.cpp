#include "experiments/theorem.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>

#include "experiments/plan.h"
#include "experiments/random.h"
#include "experiments/workload.h"
#include "framework/error.h"

namespace crofton {
namespace {

/// Sum and sum of squares.
struct Sums {
    double sum = 0, squares = 0;
    int64_t count = 0;
    void add(double x) { sum += x, squares += x * x, ++count; }
    LineMean mean(double factor, double truth) const {
        const double n = double(count), m = sum / n;
        const double variance = std::max(0.0, squares / n - m * m);
        return {truth, factor * m, factor * std::sqrt(variance / n)};
    }
};

struct QuadricArea {
    double operator()(const Sphere& s) const { return 4 * pi * s.radius * s.radius; }
    double operator()(const Cone& c) const {
        const double slope = c.base_radius - c.apex_radius;
        return pi * (double(c.base_radius) + c.apex_radius) *
               std::hypot((c.base - c.apex).cast<double>().norm(), slope);
    }
    double operator()(const Disc& d) const {
        return pi * (double(d.radius) * d.radius - double(d.inner_radius) * d.inner_radius);
    }
};

double fan_area(const std::vector<Vec3d>& corners) {
    Vec3d sum = Vec3d::Zero();
    for (size_t i = 1; i + 1 < corners.size(); ++i)
        sum += (corners[i] - corners[0]).cross(corners[i + 1] - corners[0]);
    return 0.5 * sum.norm();
}

double area_of(const Geometry& geometry, const Transform& t, const std::string& source) {
    const auto world = [&](const Vec3f& p) { return t.point(p.cast<double>()); };
    double area = 0;
    if (const auto* mesh = std::get_if<TriangleMesh>(&geometry.shapes)) {
        for (const auto& c : mesh->triangles)
            area += fan_area({world(mesh->positions[c[0]]), world(mesh->positions[c[1]]),
                              world(mesh->positions[c[2]])});
    } else if (const auto* polygons = std::get_if<Polygons>(&geometry.shapes)) {
        for (uint32_t i = 0; i < polygons->size(); ++i) {
            std::vector<Vec3d> corners;
            for (uint32_t c = polygons->first[i]; c < polygons->first[i + 1]; ++c)
                corners.push_back(world(polygons->positions[c]));
            area += fan_area(corners);
        }
    } else if (const auto* quadrics = std::get_if<Quadrics>(&geometry.shapes)) {
        if (!t.is_identity() && !quadrics->shapes.empty())
            throw InputError(source + ": the area of transformed quadrics is not known here");
        for (const Quadric& q : quadrics->shapes) area += std::visit(QuadricArea{}, q);
    } else {
        throw InputError(source + ": points have no area of their own");
    }
    return area;
}

double scene_area(const Scene& scene) {
    double area = 0;
    for (const MeshInstance& i : mesh_instances(scene))
        for (const uint32_t g : scene.meshes[i.mesh].geometries)
            area += area_of(scene.geometries[g], i.world_from_object, scene.source);
    if (!(area > 0)) throw InputError(scene.source + ": has no surface");
    return area;
}

/// Surfaces that a line meets, each through a query of its own. Those at one t count once, which
/// happens on edges: with probability 0.
int crossings(const Primitive& root, Ray line) {
    int count = 0;
    for (constexpr int most = 1 << 20; count < most; ++count) {
        const Hit hit = root.intersect(line);
        if (!hit.is_hit()) break;
        line.t_min = std::nextafter(hit.t, std::numeric_limits<float>::infinity());
    }
    return count;
}

bool meets(const Ray& line, const Bounds3& box) {
    double near = line.t_min, far = line.t_max;
    for (int a = 0; a < 3; ++a) {
        const double o = line.origin[a], d = line.direction[a];
        const double t0 = (box.lower[a] - o) / d, t1 = (box.upper[a] - o) / d;
        near = std::max(near, std::min(t0, t1));
        far = std::min(far, std::max(t0, t1));
    }
    return near <= far;
}

/// The uppermost boxes of a structure, the root first.
std::vector<Bounds3> upper_boxes(const Primitive& root) {
    constexpr uint32_t deepest = 6;
    std::vector<Bounds3> boxes;
    root.walk([&](const Bounds3& box, uint32_t depth, bool, uint32_t) {
        if (depth <= deepest) boxes.push_back(box);
    });
    return boxes;
}

std::string cell(const LineMean& m) {
    return fmt::format("{:>12.6g} {:>8.3f} % {:>6.2f}", m.mean, 100 * (m.mean / m.truth - 1),
                       m.standard_error > 0 ? (m.mean - m.truth) / m.standard_error : 0.0);
}

}  // namespace

std::vector<TheoremRow> crofton_theorem(const Scene& scene, int64_t lines, uint64_t seed) {
    const double area = scene_area(scene);
    const SceneStatistics stats = statistics(scene);
    const BoundingSphere sphere = bounding_sphere(stats.bounds_min, stats.bounds_max);
    AssemblyPlan plan = uniform_plan("bvh");
    plan.flatten = true;
    const Assembly assembly = assemble(scene, plan);
    const Primitive& root = *assembly.root;
    const std::vector<Bounds3> boxes = upper_boxes(root);
    const double sphere_area = 4 * pi * sphere.radius * sphere.radius;
    const double root_area = half_area(boxes.front());
    double box_areas = 0;
    for (const Bounds3& b : boxes) box_areas += half_area(b);

    std::vector<TheoremRow> rows;
    Sums met, in_box, in_boxes;
    int64_t next = 1000;
    for (const Ray& line : random_lines(sphere, lines, seed)) {
        met.add(crossings(root, line));
        const bool inside = meets(line, boxes.front());
        in_box.add(inside);
        if (inside) {
            int count = 0;
            for (const Bounds3& b : boxes) count += meets(line, b);
            in_boxes.add(count);
        }
        if (met.count != next && met.count != lines) continue;
        next *= 4;
        if (in_boxes.count == 0) continue;
        rows.push_back({met.count, met.mean(sphere_area / 2, area),
                        in_box.mean(1, 2 * root_area / sphere_area),
                        in_boxes.mean(1, box_areas / root_area)});
    }
    return rows;
}

std::string theorem_text(const std::vector<TheoremRow>& rows) {
    if (rows.empty()) return "too few lines\n";
    const TheoremRow& last = rows.back();
    std::string text = fmt::format(
        "Crofton: isotropic lines, uniform over the bounding sphere\n"
        "  area of all surfaces {:.6g} = 4 x mean projected area (each crossing counts half)\n"
        "  box area over sphere area {:.6g} = share of the lines that meet the box\n"
        "  areas of a bvh's boxes over the root's {:.6g} = boxes that a line through the root "
        "meets\n\n"
        "  {:>9}   {:>12} {:>10} {:>6}   {:>12} {:>10} {:>6}   {:>12} {:>10} {:>6}\n",
        last.area.truth, last.box.truth, last.boxes.truth, "lines", "area", "error", "sigma",
        "share in box", "error", "sigma", "boxes met", "error", "sigma");
    for (const TheoremRow& r : rows)
        text += fmt::format("  {:>9}   {}   {}   {}\n", r.lines, cell(r.area), cell(r.box),
                            cell(r.boxes));
    return text +
           fmt::format(
               "\n  sigma: error in standard errors; a standard error of the area is {:.4g} % "
               "at {} lines and {:.4g} % at {}\n",
               100 * rows.front().area.standard_error / rows.front().area.truth, rows.front().lines,
               100 * last.area.standard_error / last.area.truth, last.lines);
}

}  // namespace crofton
