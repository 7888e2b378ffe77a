#include "framework/polygon_set.h"

#include <Eigen/Geometry>
#include <cmath>
#include <limits>

#include "framework/cost.h"

namespace crofton {

PolygonSet::PolygonSet(std::vector<Vec3f> corners, std::vector<uint32_t> first, IdTable ids)
    : corners_(std::move(corners)), first_(std::move(first)), ids_(std::move(ids)) {
    if (first_.empty()) first_.push_back(0);
    planes_.reserve(size());
    for (uint32_t i = 0; i < size(); ++i) {
        // Newell's normal about the first corner: exact differences where corners are close.
        Vec3d n = Vec3d::Zero();
        const Vec3d o = corners_[first_[i]].cast<double>();
        for (uint32_t k = first_[i]; k + 1 < first_[i + 1]; ++k)
            n += (corners_[k].cast<double>() - o).cross(corners_[k + 1].cast<double>() - o);
        if (!n.allFinite()) n.setZero();
        // Dot products are rounded by less than 2^-50 of the sum of absolute products.
        double off = 0;
        for (uint32_t k = first_[i]; k < first_[i + 1]; ++k) {
            const Vec3d v = corners_[k].cast<double>() - o;
            off = std::max(off, std::abs(n.dot(v)) + 0x1p-48 * n.cwiseAbs().dot(v.cwiseAbs()));
        }
        planes_.push_back({n, off});
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
    // The roundings of intersect are in double; this is room for them.
    return widened(b, 0x1p-20f);
}

double PolygonSet::cost(uint32_t i) const {
    return cost_constants.polygon + cost_constants.polygon_corner * (first_[i + 1] - first_[i]);
}

uint64_t PolygonSet::bytes() const {
    return corners_.size() * sizeof(Vec3f) + first_.size() * sizeof(uint32_t) +
           planes_.size() * sizeof(Plane) + ids_.bytes();
}

bool PolygonSet::intersect(uint32_t i, const LocalRay& ray, const RayQuery& query, float& t) const {
    const ObjectRay along(ray, query);
    const Vec3d &o = along.origin, &d = along.direction;
    const Vec3d& n = planes_[i].normal;
    const double dn = d.dot(n);
    if (dn == 0) return false;
    const uint32_t begin = first_[i], end = first_[i + 1];
    // Seen edge-on, the plane tells nothing of t.
    const bool edge_on = std::abs(dn) < 0x1p-20 * d.cwiseAbs().dot(n.cwiseAbs());
    if (!edge_on) {
        const Vec3d v = corners_[begin].cast<double>() - o;
        const double middle = v.dot(n) / dn;
        const double error =
            (planes_[i].off + 0x1p-48 * v.cwiseAbs().dot(n.cwiseAbs())) / std::abs(dn) +
            0x1p-20 * std::abs(middle);
        if (middle + error < query.t_min || middle - error > query.t_best) return false;
    }

    int kz;
    d.cwiseAbs().maxCoeff(&kz);
    const int kx = kz == 2 ? 0 : kz + 1, ky = kx == 2 ? 0 : kx + 1;
    const double sx = d[kx] / d[kz], sy = d[ky] / d[kz];
    struct Sheared {
        double x, y;
        uint32_t corner;
    };
    const auto sheared = [&](uint32_t k) -> Sheared {
        const double z = corners_[k][kz] - o[kz];
        return {(corners_[k][kx] - o[kx]) - sx * z, (corners_[k][ky] - o[ky]) - sy * z, k};
    };
    // t of a point between two corners that the ray passes through.
    const auto depth = [&](const Sheared& a, const Sheared& b, double part) {
        const Vec3d u = corners_[a.corner].cast<double>() - o,
                    v = corners_[b.corner].cast<double>() - o;
        const double from = edge_on ? u[kz] / d[kz] : u.dot(n) / dn;
        const double to = edge_on ? v[kz] / d[kz] : v.dot(n) / dn;
        return from + part * (to - from);
    };
    const auto hit_at = [&](double depth) {
        t = float(depth);
        return t >= query.t_min && t <= query.t_best;
    };
    // Crossings of the x axis, half-open in y so that a corner counts once; the ray is inside if an
    // odd number of them has x > 0. Corners and edges through the ray need a look of their own.
    constexpr double infinity = std::numeric_limits<double>::infinity();
    bool inside = false;
    double left = -infinity, left_depth = 0, right = infinity, right_depth = 0;
    Sheared a = sheared(end - 1), b;
    for (uint32_t k = begin; k < end; ++k, a = b) {
        b = sheared(k);
        if (a.y == 0 && b.y == 0 && a.x * b.x <= 0)
            return hit_at(depth(a, b, a.x == b.x ? 0 : a.x / (a.x - b.x)));
        if (b.x == 0 && b.y == 0) return hit_at(depth(b, b, 0));
        if ((a.y > 0) == (b.y > 0)) continue;
        // The edge is taken upwards, so that both polygons at it compute the same numbers.
        const Sheared &low = b.y > a.y ? a : b, &high = b.y > a.y ? b : a;
        const double side = low.x * high.y - high.x * low.y;
        const double part = low.y / (low.y - high.y), x = low.x + part * (high.x - low.x);
        if (side == 0) return hit_at(depth(low, high, part));
        inside ^= side > 0;
        if (side > 0 && x < right) right = x, right_depth = depth(low, high, part);
        if (side < 0 && x > left) left = x, left_depth = depth(low, high, part);
    }
    if (!inside) return false;
    // On the line between the two nearest crossings.
    left = std::min(left, 0.0), right = std::max(right, 0.0);
    const double part = left < right ? left / (left - right) : 0;
    return hit_at(left_depth + part * (right_depth - left_depth));
}

}  // namespace crofton
