#pragma once

#include <optional>
#include <span>

#include "framework/ray.h"
#include "framework/surface_point.h"
#include "scenegraph/scene.h"

namespace crofton {

/// Unit geometric normal in world space of the surface at a hit, on the side that the ray comes
/// from. Computed from the scene's shapes in double, so that it needs nothing of an accelerator.
/// @param instances  mesh_instances(scene), which the hit's ids index
/// @return          nothing for a miss, or where a shape has no normal (zero area, apex of a cone)
std::optional<Vec3d> surface_normal(const Scene& scene, std::span<const MeshInstance> instances,
                                    const Hit& hit, const Ray& ray);

/// Where a ray met the scene, to leave from: see SurfacePoint.
///
/// Triangles: triangle_point of the corners as placed, and 2^-22 of the coordinates that a map made
/// them from, as the map may be composed in another order than the structure's. Other shapes, which
/// are tested in double: the ray's point moved onto the surface in object space (t is a rounded
/// number), and an error of 2^-22 of the coordinates for rounding the origin and 2^-36 of those of
/// shape and map for the test's roundings.
/// @return  nothing where surface_normal says nothing
std::optional<SurfacePoint> surface_point(const Scene& scene,
                                          std::span<const MeshInstance> instances, const Hit& hit,
                                          const Ray& ray);

/// o + t·d in double.
inline Vec3d point_at(const Ray& ray, double t) {
    return ray.origin.cast<double>() + t * ray.direction.cast<double>();
}

}  // namespace crofton
