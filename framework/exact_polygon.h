#pragma once

#include "framework/exact_triangle.h"

namespace crofton::exact {

/// Polygons as PolygonSet defines them. As the ray sees them, it is inside if an odd number of
/// edges crosses the x axis at x > 0, or if it passes through an edge; then the hit is on the line
/// between the nearest crossing on either side, or on that edge. A ray that is parallel to the
/// plane of Newell's normal misses.
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
