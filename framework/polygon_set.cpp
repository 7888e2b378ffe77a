#include "framework/polygon_set.h"

#include <Eigen/Geometry>
#include <cmath>

#include "framework/cost.h"

namespace crofton {

PolygonSet::PolygonSet(std::vector<Vec3f> corners, std::vector<uint32_t> first, IdTable ids)
    : corners_(std::move(corners)), first_(std::move(first)), ids_(std::move(ids)) {
    if (first_.empty()) first_.push_back(0);
    normals_.reserve(size());
    for (uint32_t i = 0; i < size(); ++i) {
        // Newell's normal about the first corner: exact differences where corners are close.
        Vec3d n = Vec3d::Zero();
        const Vec3d o = corners_[first_[i]].cast<double>();
        for (uint32_t k = first_[i]; k + 1 < first_[i + 1]; ++k)
            n += (corners_[k].cast<double>() - o).cross(corners_[k + 1].cast<double>() - o);
        normals_.push_back(n.allFinite() ? n : Vec3d::Zero());
    }
}

PolygonSet PolygonSet::subset(std::span<const uint32_t> shapes) const {
    std::vector<Vec3f> corners;
    std::vector<uint32_t> first{0};
    for (uint32_t i : shapes) {
        corners.insert(corners.end(), corners_.begin() + first_[i],
                       corners_.begin() + first_[i + 1]);
        first.push_back(uint32_t(corners.size()));
    }
    return PolygonSet(std::move(corners), std::move(first), ids_.subset(shapes));
}

Bounds3 PolygonSet::bounds(uint32_t i) const {
    Bounds3 b;
    for (uint32_t k = first_[i]; k < first_[i + 1]; ++k) b.extend(corners_[k]);
    // Corners may stand off the plane that is hit by their own rounding.
    return widened(b, 0x1p-20f);
}

double PolygonSet::cost(uint32_t i) const {
    return cost_constants.polygon + cost_constants.polygon_corner * (first_[i + 1] - first_[i]);
}

uint64_t PolygonSet::bytes() const {
    return corners_.size() * sizeof(Vec3f) + first_.size() * sizeof(uint32_t) +
           normals_.size() * sizeof(Vec3d) + ids_.bytes();
}

bool PolygonSet::intersect(uint32_t i, const LocalRay& ray, const RayQuery& query, float& t) const {
    const Vec3d o =
        ray.frame ? ray.frame->origin : Vec3d(ray.origin[0], ray.origin[1], ray.origin[2]);
    const Vec3d d = ray.frame ? ray.frame->direction
                              : Vec3d(ray.direction[0], ray.direction[1], ray.direction[2]);
    const Vec3d& n = normals_[i];
    const double dn = d.dot(n);
    if (dn == 0) return false;
    const uint32_t begin = first_[i], end = first_[i + 1];
    t = float((corners_[begin].cast<double>() - o).dot(n) / dn);
    if (!(t >= query.t_min && t <= query.t_best)) return false;

    int kz;
    d.cwiseAbs().maxCoeff(&kz);
    const int kx = kz == 2 ? 0 : kz + 1, ky = kx == 2 ? 0 : kx + 1;
    const double sx = d[kx] / d[kz], sy = d[ky] / d[kz];
    const auto sheared = [&](uint32_t k, double& x, double& y) {
        const double z = corners_[k][kz] - o[kz];
        x = (corners_[k][kx] - o[kx]) - sx * z;
        y = (corners_[k][ky] - o[ky]) - sy * z;
    };
    // Crossings of the positive x axis, half-open in y so that a corner counts once. Corners and
    // edges on the axis are not crossed, and need a look of their own.
    bool inside = false;
    double ax, ay, bx, by;
    sheared(end - 1, ax, ay);
    for (uint32_t k = begin; k < end; ++k, ax = bx, ay = by) {
        sheared(k, bx, by);
        if (ay == 0 && by == 0 && ax * bx <= 0) return true;
        if (bx == 0 && by == 0) return true;
        if ((ay > 0) == (by > 0)) continue;
        // The edge is taken upwards, so that both polygons at it compute the same number.
        const double side = by > ay ? ax * by - bx * ay : bx * ay - ax * by;
        if (side == 0) return true;
        inside ^= side > 0;
    }
    return inside;
}

}  // namespace crofton
