#pragma once

#include <memory>
#include <span>

#include "framework/exact_shapes.h"
#include "framework/quadric_set.h"

namespace crofton::exact {

/// Spheres, cones, cylinders and discs as QuadricSet defines them: both sides of every surface are
/// hit, cones have no caps and include their ends, a ray that touches hits, one that lies in the
/// surface does not, and nothing of radius 0 is hit.
class QuadricShapes final : public Shapes {
  public:
    QuadricShapes(std::span<const QuadricShape> shapes, std::shared_ptr<const Placed> placed);

    uint32_t size() const override { return uint32_t(shapes_.size()); }
    bool active(uint32_t i) const override;
    Box bounds(uint32_t i) const override;
    void candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const override;
    void solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const override;

  private:
    void find(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const;
    template <class N>
    struct Local;
    template <class N, class R>
    Local<N> local(const R& ray, const QuadricShape& s, double t0, double scale) const;

    std::vector<QuadricShape> shapes_;
    std::shared_ptr<const Placed> placed_;
};

}  // namespace crofton::exact
