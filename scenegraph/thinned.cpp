#include "scenegraph/thinned.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

namespace crofton {
namespace {

constexpr size_t least_shapes = 64;  ///< meshes with fewer are kept whole

/// Which shapes stay, and how each is scaled.
struct Kept {
    uint32_t shape;
    float scale;
    uint32_t first = 0, end = 0;  ///< the stride that it stands for; none if it is kept as it is
};

/// How many shapes become one, and every how many'th of them is looked at.
struct Thinning {
    double factor, step;
};

/// @param area  area of shape i, in any unit; not finite: never kept
template <class Area>
std::vector<Kept> choose(size_t n, const Thinning& t, const Area& area) {
    std::vector<std::pair<uint32_t, double>> looked;
    looked.reserve(size_t(double(n) / t.step) + 1);
    double sum = 0;
    for (double i = 0; i < double(n); i += t.step) {
        const double a = area(uint32_t(i));
        if (!std::isfinite(a)) continue;
        looked.emplace_back(uint32_t(i), a);
        sum += a;
    }
    const double large = t.factor * sum / std::max(1.0, double(looked.size()));
    std::vector<Kept> kept;
    auto next = looked.begin();
    for (double begin = 0; begin < double(n); begin += t.factor) {
        const auto first = uint32_t(begin), end = uint32_t(std::min(double(n), begin + t.factor));
        double stride = 0;
        std::pair<uint32_t, double> pick{end, 0};
        for (; next != looked.end() && next->first < end; ++next) {
            if (next->second > large) {
                kept.push_back({next->first, 1.0f});
                continue;
            }
            stride += next->second;
            if (next->second > pick.second) pick = *next;
        }
        if (pick.second > 0)
            kept.push_back(
                {pick.first, float(std::sqrt(t.step * stride / pick.second)), first, end});
    }
    return kept;
}

/// Where a stride's triangles lie: their box, but nowhere less thick than a quarter of its
/// diagonal.
Bounds3 region_of(const TriangleMesh& mesh, uint32_t first, uint32_t end, double step) {
    Bounds3 box;
    for (double i = first; i < double(end); i += step)
        for (const uint32_t corner : mesh.triangles[size_t(i)])
            if (mesh.positions[corner].allFinite()) box.extend(mesh.positions[corner]);
    if (box.empty()) return box;
    const float least = 0.25f * box.extent().norm();
    const Vec3f half = (box.extent() * 0.5f).cwiseMax(least), middle = box.center();
    return {middle - half, middle + half};
}

/// A sliver that stands for many stays where these are.
TriangleMesh thin(const TriangleMesh& mesh, const Thinning& t) {
    const auto corner = [&](uint32_t i, int k) {
        return mesh.positions[mesh.triangles[i][size_t(k)]];
    };
    TriangleMesh out;
    for (const Kept& k : choose(mesh.triangles.size(), t, [&](uint32_t i) {
             return double((corner(i, 1) - corner(i, 0)).cross(corner(i, 2) - corner(i, 0)).norm());
         })) {
        const Vec3f middle =
            (corner(k.shape, 0) + corner(k.shape, 1) + corner(k.shape, 2)) * (1.0f / 3);
        const auto first = uint32_t(out.positions.size());
        const Bounds3 region = region_of(mesh, k.first, k.end, t.step);
        for (int c = 0; c < 3; ++c) {
            Vec3f p = middle + (corner(k.shape, c) - middle) * k.scale;
            if (!region.empty()) p = p.cwiseMax(region.lower).cwiseMin(region.upper);
            out.positions.push_back(p);
        }
        out.triangles.push_back({first, first + 1, first + 2});
    }
    return out;
}

Quadric scaled(const Sphere& s, float scale) { return Sphere{s.center, s.radius * scale}; }
Quadric scaled(const Cone& c, float scale) {
    const Vec3f middle = c.base * 0.5f + c.apex * 0.5f;
    return Cone{middle + (c.base - middle) * scale, c.base_radius * scale,
                middle + (c.apex - middle) * scale, c.apex_radius * scale};
}
Quadric scaled(const Disc& d, float scale) {
    Disc out = d;
    out.radius *= scale, out.inner_radius *= scale;
    return out;
}

double area_of(const Sphere& s) { return 4.0 * s.radius * s.radius; }
double area_of(const Cone& c) {
    return (double(c.base_radius) + c.apex_radius) * (c.base - c.apex).norm();
}
double area_of(const Disc& d) { return double(d.radius) * d.radius; }

Quadrics thin(const Quadrics& quadrics, const Thinning& t) {
    Quadrics out;
    for (const Kept& k : choose(quadrics.shapes.size(), t, [&](uint32_t i) {
             return std::visit([](const auto& q) { return area_of(q); }, quadrics.shapes[i]);
         }))
        out.shapes.push_back(std::visit([&](const auto& q) { return scaled(q, k.scale); },
                                        quadrics.shapes[k.shape]));
    return out;
}

Polygons thin(const Polygons& polygons, const Thinning& t) {
    const auto first = [&](uint32_t i) { return polygons.positions[polygons.first[i]]; };
    const auto area = [&](uint32_t i) {
        Vec3f sum = Vec3f::Zero();
        for (uint32_t c = polygons.first[i] + 1; c + 1 < polygons.first[i + 1]; ++c)
            sum += (polygons.positions[c] - first(i)).cross(polygons.positions[c + 1] - first(i));
        return double(sum.norm());
    };
    Polygons out;
    out.first.push_back(0);
    for (const Kept& k : choose(polygons.size(), t, area)) {
        const uint32_t begin = polygons.first[k.shape], end = polygons.first[k.shape + 1];
        Vec3f middle = Vec3f::Zero();
        for (uint32_t c = begin; c < end; ++c) middle += polygons.positions[c] / float(end - begin);
        for (uint32_t c = begin; c < end; ++c)
            out.positions.push_back(middle + (polygons.positions[c] - middle) * k.scale);
        out.first.push_back(uint32_t(out.positions.size()));
    }
    return out;
}

/// Radii that come from the spacing grow by themselves where points are fewer.
Points thin(const Points& points, const Thinning& t) {
    Points out;
    for (const Kept& k : choose(points.positions.size(), t, [](uint32_t) { return 1.0; })) {
        out.positions.push_back(points.positions[k.shape]);
        if (!points.normals.empty()) out.normals.push_back(points.normals[k.shape]);
        if (!points.radii.empty()) out.radii.push_back(points.radii[k.shape] * k.scale);
    }
    return out;
}

size_t size_of(const TriangleMesh& m) { return m.triangles.size(); }
size_t size_of(const Quadrics& q) { return q.shapes.size(); }
size_t size_of(const Polygons& p) { return p.size(); }
size_t size_of(const Points& p) { return p.positions.size(); }

}  // namespace

Scene thinned(const Scene& scene, double factor, size_t looked_at) {
    const Thinning thinning{factor, std::max(1.0, factor / double(looked_at))};
    Scene out;
    out.name = scene.name;
    out.source = scene.source;
    out.meshes = scene.meshes;
    out.nodes = scene.nodes;
    out.roots = scene.roots;
    for (size_t g = 0; g < scene.geometries.size(); ++g) {
        Geometry geometry{scene.geometries[g].name, scene.geometries[g].material, {}};
        std::visit(
            [&](const auto& shapes) {
                if (size_of(shapes) < least_shapes || factor <= 1)
                    geometry.shapes = shapes;
                else
                    geometry.shapes = thin(shapes, thinning);
            },
            scene.geometries[g].shapes);
        out.geometries.push_back(std::move(geometry));
    }
    return out;
}

}  // namespace crofton
