#pragma once

#include <span>
#include <vector>

#include "framework/bounds.h"
#include "framework/ray_query.h"

namespace crofton {

/// Simple polygons with any number of corners, convex or not, planar up to rounding. Both sides are
/// hit; u = v = 0. Tested whole (as the standard databases count them), in double on the
/// object-space ray: corners are sheared to the ray, and the parity of crossings of the x axis
/// decides; a ray through an edge is inside. The hit is on the line between the nearest crossing on
/// either side. For a flat polygon that is where its plane is met. But corners are rounded, and the
/// plane of a polygon that is seen edge-on is met anywhere; the mean of two points of its edges is
/// always a point of it, which every structure has where it looks for it. Polygons with a corner
/// that is not finite, or without area, are inactive.
class PolygonSet {
  public:
    /// @param first  index of each polygon's first corner in `corners`, then corners.size()
    PolygonSet(std::vector<Vec3f> corners, std::vector<uint32_t> first, IdTable ids = {});
    PolygonSet() : PolygonSet({}, {0}) {}
    /// The polygons named, with their ids in this set.
    PolygonSet subset(std::span<const uint32_t> shapes) const;
    template <class A>
    void archive(A& a) {
        a(corners_, first_, planes_, ids_);
    }

    uint32_t size() const { return uint32_t(first_.size() - 1); }
    bool active(uint32_t i) const { return !planes_[i].normal.isZero(0); }
    Bounds3 bounds(uint32_t i) const;
    Bounds3 clipped_bounds(uint32_t i, const Bounds3& box) const {
        return intersection(bounds(i), box);
    }
    double cost(uint32_t i) const;
    std::span<const Vec3f> corners(uint32_t i) const {
        return {corners_.data() + first_[i], first_[i + 1] - first_[i]};
    }
    const IdTable& ids() const { return ids_; }
    ShapeGroups groups() const { return ids_.groups(size()); }
    uint64_t bytes() const;

    /// t in [query.t_min, query.t_best] at which polygon i is hit.
    bool intersect(uint32_t i, const LocalRay& ray, const RayQuery& query, float& t) const;

  private:
    /// Through a polygon's first corner.
    struct Plane {
        Vec3d normal;  ///< Newell's, not normalised; zero: inactive
        double off;    ///< no less than |normal·(corner - first corner)|

        template <class A>
        void archive(A& a) {
            a(normal, off);
        }
    };

    std::vector<Vec3f> corners_;
    std::vector<uint32_t> first_;
    std::vector<Plane> planes_;
    IdTable ids_;
};

}  // namespace crofton
