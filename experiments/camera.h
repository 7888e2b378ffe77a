#pragma once

#include <vector>

#include "experiments/scene_source.h"
#include "framework/ray.h"
#include "scenegraph/scene.h"

namespace crofton {

/// Sphere about the middle of the scene's bounds; radius 1 about 0 for an empty scene. World units.
struct BoundingSphere {
    Vec3d center = Vec3d::Zero();
    double radius = 1;
};
BoundingSphere bounding_sphere(const Vec3d& bounds_min, const Vec3d& bounds_max);

/// A camera that sees the whole sphere from the front, the right and above.
Camera fitted_camera(const BoundingSphere& sphere, const Vec3d& up, double fov_y);

/// The camera of the config, else the scene's of that index, else a fitted one.
Camera choose_camera(const CameraSpec& spec, const Scene& scene, const BoundingSphere& sphere,
                     size_t index = 0);

/// What a pixel in the middle of an image of `height` rows sees, across. Radians.
double pixel_angle(const Camera& camera, int height);

/// One ray through each pixel's centre, rows from the top, pixels from the left. Directions have
/// unit length before they are rounded to float.
std::vector<Ray> camera_rays(const Camera& camera, int width, int height);

}  // namespace crofton
