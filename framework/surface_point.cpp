#include "framework/surface_point.h"

#include <Eigen/Geometry>
#include <algorithm>

namespace crofton {
namespace {

/// Weights with at least `least[k]` each, changed no more than that asks for; sums are 1.
void keep_off_edges(const double (&least)[3], double (&weights)[3]) {
    const double sum = least[0] + least[1] + least[2];
    if (!(sum < 1)) {
        // No room: the centre of the inscribed circle is as far from the edges as can be.
        for (int k = 0; k < 3; ++k) weights[k] = least[k] / sum;
        return;
    }
    double above = 0;
    for (int k = 0; k < 3; ++k) above += std::max(0.0, weights[k] - least[k]);
    for (int k = 0; k < 3; ++k)
        weights[k] = least[k] + std::max(0.0, weights[k] - least[k]) * ((1 - sum) / above);
}

}  // namespace

SurfacePoint triangle_point(const Vec3f (&corners)[3], const Hit& hit, const Vec3f& direction) {
    Vec3d v[3];
    for (int k = 0; k < 3; ++k) v[k] = corners[k].cast<double>();
    SurfacePoint point;
    const Vec3d cross = (v[1] - v[0]).cross(v[2] - v[0]);
    const double twice_area = cross.stableNorm();
    double weights[3] = {std::max(0.0, 1.0 - hit.u - hit.v), hit.u, hit.v};
    const auto place = [&] {
        // From the nearest corner, so that differences are small.
        point.position = v[0] + (weights[1] * (v[1] - v[0]) + weights[2] * (v[2] - v[0]));
        double reach = 0;
        for (const Vec3d& corner : v)
            reach = std::max(reach, (corner - point.position).cwiseAbs().maxCoeff());
        point.error = 0x1p-18 * reach + 0x1p-22 * point.position.cwiseAbs().maxCoeff();
    };
    place();
    if (!(twice_area > 0)) return point;
    point.normal = cross / twice_area;
    if (point.normal.dot(direction.cast<double>()) > 0) point.normal = -point.normal;
    double least[3];
    for (int k = 0; k < 3; ++k)
        least[k] = 8 * point.error * (v[(k + 1) % 3] - v[(k + 2) % 3]).norm() / twice_area;
    keep_off_edges(least, weights);
    place();
    return point;
}

Ray spawn_ray(const SurfacePoint& from, const Vec3d& direction, float t_max) {
    const double side = from.normal.dot(direction) < 0 ? -from.error : from.error;
    Ray ray;
    ray.origin = (from.position + side * from.normal).cast<float>();
    ray.direction = direction.cast<float>();
    ray.t_max = t_max;
    return ray;
}

Ray spawn_ray_to(const SurfacePoint& from, const Vec3d& target) {
    Ray ray = spawn_ray(from, target - from.position, 1 - 0x1p-12f);
    ray.direction = (target - ray.origin.cast<double>()).cast<float>();
    return ray;
}

}  // namespace crofton
