#pragma once

#include <limits>

#include "framework/ray.h"
#include "framework/vec.h"

namespace crofton {

/// Where a ray met a surface, with the error bound that a ray needs to leave it. World space.
///
/// A spawned ray starts `error` off the surface, on the side that it goes to. It then hits nothing
/// that it leaves, whatever the sizes of scene, shape and distance: the bound follows from the
/// shape's own coordinates, and no constant is tuned to a scene. (Wächter & Binder 2019, Pharr et
/// al. 2023 offset rays, too; the bound here is that of Crofton's own leaf tests.)
struct SurfacePoint {
    Vec3d position = Vec3d::Zero();  ///< on the surface, up to roundings in double
    Vec3d normal = Vec3d::Zero();    ///< unit, geometric, on the side that the ray came from
    double error = 0;                ///< distance within which nothing is sure of the surface
};

/// The point of a triangle at a hit's u and v.
///
/// The weights (1-u-v, u, v) may err along the triangle, but their point is in its plane up to
/// 2^-50 of its coordinates. A ray that leaves it is safe if its float origin stands off the plane
/// by more than the leaf test may displace it. That test is right for a triangle whose corners are
/// displaced by 8u·reach along two axes (exact::triangle_bound, u = 2^-24; the reach of a ray that
/// starts at p is at most L = max|v - p|), so by at most h = √2·8u·L off the plane. At 4h the ray
/// is beyond all such triangles, also with the depth that the nearest point of an edge has where
/// the ray passes outside. Rounding the origin moves it by √3·u·|p|. So
///     error = 4·√2·2^-21·L + √3·2^-24·|p| < 2^-18·L + 2^-22·|p|.
///
/// Near an edge the rounded origin could end up behind a neighbour that rises there. So the point
/// keeps 8·error from every edge (or as much as there is room for): with `error` of height that
/// clears neighbours that rise by up to 173°, at the price of moving by less than 2^-14 of the
/// triangle's size.
/// @param v          corners as placed, finite
/// @param direction  of the ray that hit
/// @return           normal (0, 0, 0) if the triangle has no area
SurfacePoint triangle_point(const Vec3f (&v)[3], const Hit& hit, const Vec3f& direction);

/// A ray that leaves a surface: origin p + n·error on the side of `direction`, t_min 0.
/// @param direction  any length; not zero
Ray spawn_ray(const SurfacePoint& from, const Vec3d& direction,
              float t_max = std::numeric_limits<float>::infinity());
/// A ray to a point in space: t_max ends it just short of the target, at t = 1 - 2^-12.
Ray spawn_ray_to(const SurfacePoint& from, const Vec3d& target);

}  // namespace crofton
