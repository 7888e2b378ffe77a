#include "experiments/camera.h"

#include <Eigen/Geometry>
#include <cmath>

#include "experiments/random.h"

namespace crofton {

BoundingSphere bounding_sphere(const Vec3d& bounds_min, const Vec3d& bounds_max) {
    if (!(bounds_min.array() <= bounds_max.array()).all()) return {};
    const double radius = 0.5 * (bounds_max - bounds_min).norm();
    return {0.5 * bounds_min + 0.5 * bounds_max, radius > 0 ? radius : 1.0};
}

Camera fitted_camera(const BoundingSphere& sphere, const Vec3d& up, double fov_y) {
    Vec3d side, front;
    const Vec3d u = up.normalized();
    // For up = y this is x to the right and z to the viewer.
    perpendicular(u, side, front);
    if (std::abs(u.y()) > 0.99) side = Vec3d::UnitX(), front = Vec3d::UnitZ();
    const Vec3d towards = (front * 0.75 + side * 0.5 + u * 0.42).normalized();
    Camera camera;
    camera.eye = sphere.center + towards * (sphere.radius / std::sin(fov_y / 2));
    camera.at = sphere.center;
    camera.up = u;
    camera.fov_y = fov_y;
    return camera;
}

Camera choose_camera(const CameraSpec& spec, const Scene& scene, const BoundingSphere& sphere,
                     size_t index) {
    const double fov_y = spec.fov_deg.value_or(45) * pi / 180;
    Camera camera;
    if (spec.eye) {
        camera.eye = *spec.eye;
        camera.at = *spec.at;
        camera.up = spec.up;
    } else if (index < scene.cameras.size()) {
        camera = scene.cameras[index];
        if (spec.fov_deg) camera.fov_y = fov_y;
        return camera;
    } else {
        camera = fitted_camera(sphere, spec.up.isZero(0) ? Vec3d(0, 1, 0) : spec.up, fov_y);
    }
    camera.fov_y = fov_y;
    camera.aspect = 4.0 / 3.0;
    return camera;
}

double pixel_angle(const Camera& camera, int height) {
    return 2 * std::tan(camera.fov_y / 2) / height;
}

std::vector<Ray> camera_rays(const Camera& camera, int width, int height) {
    const Vec3d forward = (camera.at - camera.eye).normalized();
    Vec3d right = forward.cross(camera.up);
    Vec3d other;
    // A view along `up` has no right of its own: take any.
    if (right.norm() > 1e-9 * camera.up.norm())
        right.normalize();
    else
        perpendicular(forward, right, other);
    const Vec3d up = right.cross(forward);
    const double half = std::tan(camera.fov_y / 2);
    std::vector<Ray> rays;
    rays.reserve(size_t(width) * size_t(height));
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
            // Square pixels: the width follows from the height.
            const double u = (2 * (x + 0.5) - width) / height * half;
            const double v = (height - 2 * (y + 0.5)) / height * half;
            const Vec3d direction = (forward + u * right + v * up).normalized();
            Ray ray;
            ray.origin = camera.eye.cast<float>();
            ray.direction = direction.cast<float>();
            rays.push_back(ray);
        }
    }
    return rays;
}

}  // namespace crofton
