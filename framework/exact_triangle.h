#pragma once

#include <array>
#include <memory>
#include <span>

#include "framework/exact_shapes.h"

namespace crofton::exact {

/// Corners of triangles and polygons in world space, each with a radius that holds the exact one.
class Corners {
  public:
    struct World {
        double p[3], radius, size;
    };
    Corners(std::span<const Vec3f> object, std::shared_ptr<const Placed> placed);

    /// A corner relative to the ray's origin and sheared along the ray, which becomes the z axis.
    struct Sheared {
        double x, y, z;  ///< z in units of length along axis kz
        double radius;   ///< of x and y
        double z_radius;
    };
    /// @param bound, size_bound  how far a leaf test may displace x and y: times the reach, times
    ///                           the size
    Sheared shear(const DoubleRay& ray, uint32_t corner, double bound, double size_bound) const {
        return shear(ray, at(corner), bound, size_bound);
    }
    static Sheared shear(const DoubleRay& ray, const World& corner, double bound,
                         double size_bound);
    /// The same exactly, x and y times d[kz]; z times 1.
    Triple<Dyadic> shear(const ExactRay& ray, uint32_t corner) const {
        return shear(ray, exact_world(corner));
    }
    static Triple<Dyadic> shear(const ExactRay& ray, const Triple<Dyadic>& corner);

    const Vec3f& object(uint32_t corner) const { return object_[corner]; }
    bool finite(uint32_t corner) const { return object_[corner].allFinite(); }
    void extend(Box& box, uint32_t corner) const;
    const Placed& placed() const { return *placed_; }
    /// World coordinates that hold the exact ones.
    Triple<Interval> world(uint32_t corner) const;
    Triple<Dyadic> exact_world(uint32_t corner) const {
        return placed_->exact_point(object_[corner]);
    }

  private:
    World at(uint32_t corner) const;

    std::vector<Vec3f> object_;
    std::vector<World> world_;  ///< empty for the identity
    std::shared_ptr<const Placed> placed_;
};

/// One triangle of world-space corners, for who has no set of them: as Triangles.
void triangle_candidates(const DoubleRay& ray, const Vec3f (&v)[3], Candidates& out);
void solve_triangle(const ExactRay& ray, const Vec3f (&v)[3], std::vector<Root>& out);

/// Triangles, hit from both sides; edges and corners belong to them. One that the ray lies in the
/// plane of, or without area, is not hit.
class Triangles final : public Shapes {
  public:
    Triangles(std::span<const Vec3f> positions, std::span<const std::array<uint32_t, 3>> triangles,
              std::shared_ptr<const Placed> placed);

    uint32_t size() const override { return uint32_t(triangles_.size()); }
    bool active(uint32_t i) const override;
    Box bounds(uint32_t i) const override;
    void candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const override;
    void solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const override;

  private:
    Corners corners_;
    std::vector<std::array<uint32_t, 3>> triangles_;
};

}  // namespace crofton::exact
