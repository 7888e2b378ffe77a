#pragma once

#include "framework/exact_triangle.h"

namespace crofton::exact {

/// Polygons as PolygonSet defines them: the plane through the first corner with Newell's normal is
/// hit where an odd number of edges, as the ray sees them, lie on one side of it, or where the ray
/// passes through an edge. Corners off the plane count by their image along the ray.
class Polygons final : public Shapes {
  public:
    /// @param first  first corner of each polygon, then the number of corners
    Polygons(std::span<const Vec3f> corners, std::span<const uint32_t> first,
             std::shared_ptr<const Placed> placed);

    uint32_t size() const override { return uint32_t(first_.size() - 1); }
    bool active(uint32_t i) const override;
    Box bounds(uint32_t i) const override;
    void candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const override;
    void solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const override;

  private:
    Corners corners_;
    std::vector<uint32_t> first_;
};

}  // namespace crofton::exact
