#include "framework/exact_shapes.h"

#include <Eigen/LU>

namespace crofton::exact {
namespace {

/// Axis with the largest |d|; of equals the one that the leaf test takes, as its bound is stated in
/// terms of its shear.
int main_axis(const Vec3f& d) {
    const float x = std::abs(d[0]), y = std::abs(d[1]), z = std::abs(d[2]);
    return x > y ? (x > z ? 0 : 2) : (y > z ? 1 : 2);
}

}  // namespace

void Box::extend(const double (&p)[3], double radius) {
    for (int a = 0; a < 3; ++a) {
        lower[a] = std::min(lower[a], Interval::down(p[a] - radius));
        upper[a] = std::max(upper[a], Interval::up(p[a] + radius));
    }
}

void Box::extend(const Box& b) {
    for (int a = 0; a < 3; ++a) {
        lower[a] = std::min(lower[a], b.lower[a]);
        upper[a] = std::max(upper[a], b.upper[a]);
    }
    size = std::max(size, b.size);
}

DoubleRay::DoubleRay(const Ray& ray, double bound)
    : t_min(ray.t_min), t_max(ray.t_max), t_bound(bound) {
    for (int a = 0; a < 3; ++a) o[a] = ray.origin[a], d[a] = ray.direction[a];
    kz = main_axis(ray.direction);
    kx = (kz + 1) % 3;
    ky = (kz + 2) % 3;
    sx = d[kx] / d[kz];
    sy = d[ky] / d[kz];
}

ExactRay::ExactRay(const Ray& ray)
    : o(triple<Dyadic>(ray.origin)), d(triple<Dyadic>(ray.direction)) {
    kz = main_axis(ray.direction);
    kx = (kz + 1) % 3;
    ky = (kz + 2) % 3;
}

ExactMap::ExactMap() {
    for (int a = 0; a < 3; ++a) row[a][a] = Dyadic(1);
}

ExactMap::ExactMap(const Transform& t) : translation(triple<Dyadic>(t.translation)) {
    for (int a = 0; a < 3; ++a) row[a] = triple<Dyadic>(t.linear.row(a));
}

Triple<Dyadic> ExactMap::point(const Triple<Dyadic>& p) const {
    return Triple<Dyadic>{{dot(row[0], p), dot(row[1], p), dot(row[2], p)}} + translation;
}

ExactMap operator*(const ExactMap& a, const ExactMap& b) {
    ExactMap r;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            r.row[i][j] = dot(a.row[i], Triple<Dyadic>{{b.row[0][j], b.row[1][j], b.row[2][j]}});
    r.translation = a.point(b.translation);
    return r;
}

Placed::Placed(const std::vector<Transform>& chain) : maps(std::max<double>(1, chain.size())) {
    // Absolute values compose as the maps do.
    Transform sizes;
    Eigen::Matrix3d inverses = Eigen::Matrix3d::Identity();
    for (const Transform& t : chain) {
        exact = exact * ExactMap(t);
        sizes = sizes * Transform{t.linear.cwiseAbs(), t.translation.cwiseAbs()};
        inverses = Eigen::Matrix3d(t.linear.inverse().cwiseAbs() * inverses);
    }
    for (int i = 0; i < 3; ++i) {
        const auto enclose = [](const Dyadic& x) {
            const double d = x.to_double();
            return Interval::outward(d, d);
        };
        for (int j = 0; j < 3; ++j) {
            row[i][j] = enclose(exact.row[i][j]);
            absolute[i][j] = sizes.linear(i, j);
        }
        translation[i] = enclose(exact.translation[i]);
        absolute[i][3] = sizes.translation[i];
    }
    identity = chain.empty();
    condition = (sizes.linear * inverses).rowwise().sum().maxCoeff() * maps;
}

void Placed::point(const Vec3f& p, double (&center)[3], double& radius, double& size) const {
    radius = size = 0;
    for (int i = 0; i < 3; ++i) {
        center[i] = p[i];
        if (identity) continue;
        Interval x = translation[i];
        double reach = absolute[i][3];
        for (int j = 0; j < 3; ++j) {
            x = x + row[i][j] * Interval(p[j]);
            reach += absolute[i][j] * std::abs(double(p[j]));
        }
        center[i] = x.lo / 2 + x.hi / 2;
        radius = std::max(radius, Interval::up(x.hi - x.lo));
        // The product of the chain is rounded in double, a share of each map's own size; and a
        // little for terms of second order.
        size = std::max(size, reach * (1 + 0x1p-20 * maps));
    }
}

}  // namespace crofton::exact
