#include "framework/transform.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>

namespace crofton {

Transform rotation(const Vec3d& axis, double angle) {
    return {Eigen::AngleAxisd(angle, axis).toRotationMatrix(), Vec3d::Zero()};
}

std::optional<Transform> inverse(const Transform& t) {
    if (!t.finite()) return std::nullopt;
    const Eigen::FullPivLU<Eigen::Matrix3d> lu(t.linear);
    if (!lu.isInvertible()) return std::nullopt;
    const Eigen::Matrix3d inv = lu.inverse();
    const Transform result{inv, -(inv * t.translation)};
    if (!result.finite()) return std::nullopt;
    // The kernels hold both maps in float: one that leaves its range is as useless as a singular
    // one.
    if (!result.linear.cast<float>().allFinite() || !t.linear.cast<float>().allFinite())
        return std::nullopt;
    if (!t.translation.cast<float>().allFinite()) return std::nullopt;
    return result;
}

FloatTransform rounded(const Transform& t) {
    FloatTransform f;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) f.m[i][j] = static_cast<float>(t.linear(i, j));
        f.m[i][3] = static_cast<float>(t.translation[i]);
    }
    return f;
}

Bounds3 transformed(const FloatTransform& f, const Bounds3& b) {
    Bounds3 out;
    if (b.empty()) return out;
    for (int i = 0; i < 3; ++i) {
        // Interval arithmetic per row in double (Arvo 1990), then outwards by the error of `apply`,
        // at most 4u times the sum of the magnitudes.
        double lo = f.m[i][3], hi = f.m[i][3], size = std::abs(double(f.m[i][3]));
        for (int j = 0; j < 3; ++j) {
            const double p = double(f.m[i][j]) * b.lower[j];
            const double q = double(f.m[i][j]) * b.upper[j];
            lo += std::min(p, q);
            hi += std::max(p, q);
            size += std::max(std::abs(p), std::abs(q));
        }
        const double pad = 0x1p-21 * size;
        out.lower[i] = static_cast<float>(lo - pad);
        out.upper[i] = static_cast<float>(hi + pad);
    }
    return out;
}

}  // namespace crofton
