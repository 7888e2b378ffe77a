#pragma once

#include <span>
#include <vector>

#include "framework/primitive_sets.h"
#include "framework/quadric_set.h"
#include "framework/ray_query.h"
#include "framework/triangle_set.h"
#include "scenegraph/scene.h"

namespace crofton {

/// A scene's quadric as sets hold it.
QuadricShape quadric_shape(const Quadric& quadric);

/// Collects the geometries of meshes into one primitive set of each kind, with the ids that hits
/// name.
class ShapeSetBuilder {
  public:
    explicit ShapeSetBuilder(const Scene& scene) : scene_(scene) {}

    enum Kinds { all, all_but_triangles };

    /// Room for the triangles of all of these.
    void reserve(std::span<const MeshInstance> placed);

    /// Adds a mesh. With a transform, triangles are baked (mapped as an Instance would map them, to
    /// the same bits) and other shapes are not added.
    /// @param instance  offset of the ids
    /// @return whether all of the mesh was added
    bool add_mesh(uint32_t mesh, const Transform* world_from_object, uint32_t instance,
                  Kinds kinds = all);

    /// Groups of the triangles added so far, beside those of their geometries.
    void group_triangles(ShapeGroups groups) { groups_ = std::move(groups); }

    uint64_t triangles() const { return triangles_.size(); }
    uint64_t shapes() const { return shapes_; }
    /// The sets that are not empty, or an empty triangle set if all are.
    std::vector<PrimitiveSet> take();

  private:
    void reserve_triangles(size_t positions, size_t triangles);
    void add(const TriangleMesh& mesh, const FloatTransform* map);
    void add(const Quadrics& quadrics);
    void add(const Polygons& polygons);
    void add(const Points& points);
    ShapeGroups triangle_groups() const;

    const Scene& scene_;
    uint64_t shapes_ = 0;
    TriangleSet::Positions positions_;
    TriangleSet::Triangles triangles_;
    std::vector<QuadricShape> quadrics_;
    std::vector<Vec3f> corners_;
    std::vector<uint32_t> first_corner_;
    ShapeGroups groups_;
    std::vector<IdTable::Run> triangle_runs_, quadric_runs_, polygon_runs_;
};

}  // namespace crofton
