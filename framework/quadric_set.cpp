#include "framework/quadric_set.h"

#include <Eigen/Geometry>
#include <cmath>

#include "framework/cost.h"

namespace crofton {
namespace {

bool in_range(double t, const RayQuery& query, float& result) {
    result = float(t);
    return result >= query.t_min && result <= query.t_best;
}

/// Roots of a·t² + 2·b·t + c, ascending, without cancellation (Press et al. 2007, 5.6).
/// @param discriminant  b² - a·c
int half_quadratic(double a, double b, double c, double discriminant, double (&roots)[2]) {
    if (a == 0) {
        if (b == 0) return 0;
        roots[0] = -c / (2 * b);
        return 1;
    }
    if (!(discriminant >= 0)) return 0;
    const double q = -(b + std::copysign(std::sqrt(discriminant), b));
    roots[0] = q / a;
    roots[1] = q != 0 ? c / q : roots[0];
    if (roots[0] > roots[1]) std::swap(roots[0], roots[1]);
    return 2;
}

bool intersect_sphere(const QuadricShape& s, const ObjectRay& ray, const RayQuery& query,
                      float& t) {
    const double r = s.p_radius;
    if (!(r > 0)) return false;
    // From the point of the ray nearest to the centre, so that a far origin costs no digits
    // (Haines, Günther, Akenine-Möller 2019).
    const Vec3d f = ray.origin - s.p.cast<double>();
    const double a = ray.direction.squaredNorm();
    const double t0 = -f.dot(ray.direction) / a;
    const double h2 = r * r - (f + t0 * ray.direction).squaredNorm();
    if (!(h2 >= 0)) return false;
    const double half = std::sqrt(h2 / a);
    return in_range(t0 - half, query, t) || in_range(t0 + half, query, t);
}

bool intersect_cone(const QuadricShape& s, const ObjectRay& ray, const RayQuery& query, float& t) {
    const Vec3d base = s.p.cast<double>();
    Vec3d axis = s.q.cast<double>() - base;
    const double height = axis.norm();
    if (!(height > 0) || !(s.p_radius > 0 || s.q_radius > 0)) return false;
    axis /= height;
    const double r0 = s.p_radius, k = (double(s.q_radius) - r0) / height;

    const double dd = ray.direction.squaredNorm();
    Vec3d f = ray.origin - base;
    const double t0 = -f.dot(ray.direction) / dd;
    f += t0 * ray.direction;
    // Across the axis, x + t·dx from it, where the radius is r + t·dr: |x + t·dx|² = (r + t·dr)².
    // The discriminant by Lagrange's identity, as a difference of squares of what is small near the
    // surface: a point near an apex has few digits to lose.
    const double da = ray.direction.dot(axis), fa = f.dot(axis);
    const Vec3d x = f - fa * axis, dx = ray.direction - da * axis;
    const double r = r0 + k * fa, dr = k * da;
    const double a = dx.squaredNorm() - dr * dr, b = x.dot(dx) - r * dr,
                 c = x.squaredNorm() - r * r;
    const double discriminant = (r * dx - dr * x).squaredNorm() - x.cross(dx).squaredNorm();
    double roots[2];
    const int n = half_quadratic(std::abs(a) < 1e-15 * dd ? 0 : a, b, c, discriminant, roots);
    for (int i = 0; i < n; ++i) {
        const double y = fa + roots[i] * da;
        // The other nappe of a full cone has a negative radius and lies beyond its apex.
        if (y >= 0 && y <= height && in_range(t0 + roots[i], query, t)) return true;
    }
    return false;
}

bool intersect_disc(const QuadricShape& s, const ObjectRay& ray, const RayQuery& query, float& t) {
    const Vec3d n = s.q.cast<double>(), to_center = s.p.cast<double>() - ray.origin;
    const double dn = ray.direction.dot(n);
    if (dn == 0 || !(s.p_radius > 0)) return false;
    const double hit = to_center.dot(n) / dn;
    const double r2 = (hit * ray.direction - to_center).squaredNorm();
    const double outer = s.p_radius, inner = s.q_radius;
    return r2 <= outer * outer && r2 >= inner * inner && in_range(hit, query, t);
}

/// Box of a disc of radius r around c with unit normal n.
void extend_by_disc(Bounds3& b, const Vec3d& c, double r, const Vec3d& n) {
    for (int a = 0; a < 3; ++a) {
        const double e = r * std::sqrt(std::max(0.0, 1 - n[a] * n[a]));
        b.lower[a] = std::min(b.lower[a], float(c[a] - e));
        b.upper[a] = std::max(b.upper[a], float(c[a] + e));
    }
}

}  // namespace

QuadricSet::QuadricSet(std::vector<QuadricShape> shapes, IdTable ids)
    : shapes_(std::move(shapes)), ids_(std::move(ids)) {}

QuadricSet QuadricSet::subset(std::span<const uint32_t> shapes) const {
    QuadricSet part;
    part.shapes_.reserve(shapes.size());
    for (uint32_t i : shapes) part.shapes_.push_back(shapes_[i]);
    part.ids_ = ids_.subset(shapes);
    return part;
}

bool QuadricSet::active(uint32_t i) const {
    const QuadricShape& s = shapes_[i];
    const bool finite = s.p.allFinite() && std::isfinite(s.p_radius) && s.p_radius >= 0;
    if (s.kind == QuadricKind::sphere) return finite;
    const bool second = s.q.allFinite() && std::isfinite(s.q_radius) && s.q_radius >= 0;
    return finite && second && (s.kind == QuadricKind::cone || !s.q.isZero(0));
}

Bounds3 QuadricSet::bounds(uint32_t i) const {
    const QuadricShape& s = shapes_[i];
    Bounds3 b;
    const Vec3d p = s.p.cast<double>(), q = s.q.cast<double>();
    switch (s.kind) {
        case QuadricKind::sphere:
            b.lower = (p.array() - double(s.p_radius)).cast<float>();
            b.upper = (p.array() + double(s.p_radius)).cast<float>();
            break;
        case QuadricKind::cone: {
            const Vec3d axis = (q - p).stableNormalized();
            extend_by_disc(b, p, s.p_radius, axis);
            extend_by_disc(b, q, s.q_radius, axis);
            break;
        }
        case QuadricKind::disc:
            extend_by_disc(b, p, s.p_radius, q.stableNormalized());
            break;
    }
    return widened(b, 0x1p-22f);
}

double QuadricSet::cost(uint32_t i) const {
    switch (shapes_[i].kind) {
        case QuadricKind::sphere:
            return cost_constants.sphere;
        case QuadricKind::cone:
            return cost_constants.cone;
        case QuadricKind::disc:
            return cost_constants.disc;
    }
    return 0;
}

bool QuadricSet::intersect(uint32_t i, const LocalRay& ray, const RayQuery& query, float& t) const {
    const QuadricShape& s = shapes_[i];
    const ObjectRay r(ray, query);
    switch (s.kind) {
        case QuadricKind::sphere:
            return intersect_sphere(s, r, query, t);
        case QuadricKind::cone:
            return intersect_cone(s, r, query, t);
        case QuadricKind::disc:
            return intersect_disc(s, r, query, t);
    }
    return false;
}

}  // namespace crofton
