#include "scenegraph/shape_sets.h"

#include <algorithm>

#include "framework/error.h"
#include "framework/polygon_set.h"
#include "scenegraph/splats.h"

namespace crofton {

QuadricShape quadric_shape(const Quadric& quadric) {
    if (const Sphere* s = std::get_if<Sphere>(&quadric))
        return {QuadricKind::sphere, s->center, s->radius, Vec3f::Zero(), 0};
    if (const Cone* c = std::get_if<Cone>(&quadric))
        return {QuadricKind::cone, c->base, c->base_radius, c->apex, c->apex_radius};
    const Disc& d = std::get<Disc>(quadric);
    return {QuadricKind::disc, d.center, d.radius, d.normal, d.inner_radius};
}

void ShapeSetBuilder::reserve(std::span<const MeshInstance> placed) {
    size_t positions = 0, triangles = 0;
    for (const MeshInstance& p : placed)
        for (const uint32_t g : scene_.meshes[p.mesh].geometries)
            if (const auto* m = std::get_if<TriangleMesh>(&scene_.geometries[g].shapes))
                positions += m->positions.size(), triangles += m->triangles.size();
    reserve_triangles(positions, triangles);
}

/// One position more: sets end with a dummy.
void ShapeSetBuilder::reserve_triangles(size_t positions, size_t triangles) {
    positions_.reserve(positions + 1);
    triangles_.reserve(triangles);
}

bool ShapeSetBuilder::add_mesh(uint32_t mesh, const Transform* world_from_object, uint32_t instance,
                               Kinds kinds) {
    FloatTransform map;
    if (world_from_object) map = rounded(*world_from_object);
    bool complete = true;
    for (uint32_t g : scene_.meshes[mesh].geometries) {
        const auto& shapes = scene_.geometries[g].shapes;
        if (const auto* triangles = std::get_if<TriangleMesh>(&shapes)) {
            if (kinds == all_but_triangles || triangles->triangles.empty()) continue;
            triangle_runs_.push_back({uint32_t(triangles_.size()), g, 0, instance});
            add(*triangles, world_from_object ? &map : nullptr);
        } else if (world_from_object) {
            complete = false;
        } else if (const auto* quadrics = std::get_if<Quadrics>(&shapes)) {
            quadric_runs_.push_back({uint32_t(quadrics_.size()), g, 0, instance});
            add(*quadrics);
        } else if (const auto* polygons = std::get_if<Polygons>(&shapes)) {
            polygon_runs_.push_back({uint32_t(first_corner_.size()), g, 0, instance});
            add(*polygons);
        } else if (const auto* points = std::get_if<Points>(&shapes)) {
            quadric_runs_.push_back({uint32_t(quadrics_.size()), g, 0, instance});
            add(*points);
        }
    }
    return complete;
}

void ShapeSetBuilder::add(const TriangleMesh& mesh, const FloatTransform* map) {
    const size_t base = positions_.size();
    if (base + mesh.positions.size() > UINT32_MAX ||
        triangles_.size() + mesh.triangles.size() >= no_id)
        throw InputError(scene_.source + ": more than 2^32 vertices or triangles in one set");
    if (positions_.empty()) reserve_triangles(mesh.positions.size(), mesh.triangles.size());
    positions_.resize(base + mesh.positions.size());
    const auto placed = positions_.begin() + ptrdiff_t(base);
    if (map)
        std::transform(mesh.positions.begin(), mesh.positions.end(), placed,
                       [m = *map](const Vec3f& p) { return apply(m, p); });
    else
        std::copy(mesh.positions.begin(), mesh.positions.end(), placed);
    const size_t first = triangles_.size();
    triangles_.resize(first + mesh.triangles.size());
    std::transform(mesh.triangles.begin(), mesh.triangles.end(),
                   triangles_.begin() + ptrdiff_t(first),
                   [b = uint32_t(base)](const std::array<uint32_t, 3>& t) {
                       return std::array<uint32_t, 3>{b + t[0], b + t[1], b + t[2]};
                   });
    shapes_ += mesh.triangles.size();
}

void ShapeSetBuilder::add(const Quadrics& quadrics) {
    for (const Quadric& q : quadrics.shapes) quadrics_.push_back(quadric_shape(q));
    shapes_ += quadrics.shapes.size();
}

void ShapeSetBuilder::add(const Points& points) {
    const std::vector<QuadricShape> shapes = splats(points);
    quadrics_.insert(quadrics_.end(), shapes.begin(), shapes.end());
    shapes_ += shapes.size();
}

void ShapeSetBuilder::add(const Polygons& polygons) {
    const uint32_t base = uint32_t(corners_.size());
    corners_.insert(corners_.end(), polygons.positions.begin(), polygons.positions.end());
    for (uint32_t i = 0; i < polygons.size(); ++i)
        first_corner_.push_back(base + polygons.first[i]);
    shapes_ += polygons.size();
}

/// None if there are only the geometries': the set knows those.
ShapeGroups ShapeSetBuilder::triangle_groups() const {
    if (groups_.empty()) return {};
    const ShapeGroups geometries = IdTable(triangle_runs_).groups(uint32_t(triangles_.size()));
    ShapeGroups all = groups_;
    all.insert(all.end(), geometries.begin(), geometries.end());
    // Into preorder: those that begin first, then those that hold others.
    std::stable_sort(all.begin(), all.end(), [](const ShapeGroup& a, const ShapeGroup& b) {
        return a.first != b.first ? a.first < b.first : a.end > b.end;
    });
    std::erase_if(all, [](const ShapeGroup& g) { return g.first == g.end; });
    return all;
}

std::vector<PrimitiveSet> ShapeSetBuilder::take() {
    std::vector<PrimitiveSet> sets;
    if (!quadrics_.empty())
        sets.push_back(std::make_shared<const QuadricSet>(std::move(quadrics_),
                                                          IdTable(std::move(quadric_runs_))));
    if (!first_corner_.empty()) {
        first_corner_.push_back(uint32_t(corners_.size()));
        sets.push_back(std::make_shared<const PolygonSet>(
            std::move(corners_), std::move(first_corner_), IdTable(std::move(polygon_runs_))));
    }
    if (!triangles_.empty() || sets.empty()) {
        ShapeGroups groups = triangle_groups();
        IdTable ids = triangle_runs_.empty() ? IdTable() : IdTable(std::move(triangle_runs_));
        sets.push_back(std::make_shared<const TriangleSet>(
            std::move(positions_), std::move(triangles_), std::move(ids), std::move(groups)));
    }
    return sets;
}

}  // namespace crofton
