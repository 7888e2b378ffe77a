#pragma once

#include <optional>
#include <span>

#include "framework/ray.h"
#include "scenegraph/scene.h"

namespace crofton {

/// Unit geometric normal in world space of the surface at a hit, on the side that the ray comes
/// from. Computed from the scene's shapes in double, so that it needs nothing of an accelerator.
/// @param instances  mesh_instances(scene), which the hit's ids index
/// @return          nothing for a miss, or where a shape has no normal (zero area, apex of a cone)
std::optional<Vec3d> surface_normal(const Scene& scene, std::span<const MeshInstance> instances,
                                    const Hit& hit, const Ray& ray);

/// o + t·d in double.
inline Vec3d point_at(const Ray& ray, double t) {
    return ray.origin.cast<double>() + t * ray.direction.cast<double>();
}

}  // namespace crofton
