#pragma once

#include <span>
#include <vector>

#include "framework/bounds.h"
#include "framework/ray_query.h"

namespace crofton {

enum class QuadricKind : uint32_t { sphere, cone, disc };

/// One quadric, in object space: {center, radius}; {base, base_radius, apex, apex_radius} (a
/// cylinder if the radii are equal; no caps); {center, radius, normal, inner_radius}.
struct QuadricShape {
    QuadricKind kind;
    Vec3f p;
    float p_radius;
    Vec3f q;
    float q_radius;

    template <class A>
    void archive(A& a) {
        a(kind, p, p_radius, q, q_radius);
    }
};

/// Spheres, cones, cylinders and discs. Both sides of every surface are hit. Tests run in double on
/// the object-space ray; u = v = 0. A ray that lies in a surface does not hit it, and nothing of
/// radius 0 is ever hit (a cone has a radius if one of its ends does). Shapes that are not finite
/// or have a negative radius are inactive.
class QuadricSet {
  public:
    explicit QuadricSet(std::vector<QuadricShape> shapes, IdTable ids = {});
    QuadricSet() = default;
    /// The shapes named, with their ids in this set.
    QuadricSet subset(std::span<const uint32_t> shapes) const;
    template <class A>
    void archive(A& a) {
        a(shapes_, ids_);
    }

    uint32_t size() const { return uint32_t(shapes_.size()); }
    bool active(uint32_t i) const;
    Bounds3 bounds(uint32_t i) const;
    /// bounds(i) cut to `box`: no tighter.
    Bounds3 clipped_bounds(uint32_t i, const Bounds3& box) const {
        return intersection(bounds(i), box);
    }
    double cost(uint32_t i) const;
    const IdTable& ids() const { return ids_; }
    ShapeGroups groups() const { return ids_.groups(size()); }
    uint64_t bytes() const { return shapes_.size() * sizeof(QuadricShape) + ids_.bytes(); }
    const QuadricShape& shape(uint32_t i) const { return shapes_[i]; }

    /// Smallest t in [query.t_min, query.t_best] at which shape i is hit.
    bool intersect(uint32_t i, const LocalRay& ray, const RayQuery& query, float& t) const;

  private:
    std::vector<QuadricShape> shapes_;
    IdTable ids_;
};

}  // namespace crofton
