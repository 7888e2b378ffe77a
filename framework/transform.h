#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <optional>

#include "framework/bounds.h"
#include "framework/vec.h"

namespace crofton {

/// Affine map p ↦ linear·p + translation, in double. Names at the use say both spaces:
/// `world_from_object` maps object points to the world. Chains are composed in double and rounded
/// to float once, where a kernel needs them.
struct Transform {
    Eigen::Matrix3d linear = Eigen::Matrix3d::Identity();
    Vec3d translation = Vec3d::Zero();

    bool operator==(const Transform&) const = default;

    Vec3d point(const Vec3d& p) const { return linear * p + translation; }
    Vec3d vector(const Vec3d& v) const { return linear * v; }
    bool is_identity() const { return linear.isIdentity(0) && translation.isZero(0); }
    bool finite() const { return linear.allFinite() && translation.allFinite(); }
    bool mirrored() const { return linear.determinant() < 0; }
};

/// (a·b)(p) = a(b(p)).
inline Transform operator*(const Transform& a, const Transform& b) {
    return {a.linear * b.linear, a.linear * b.translation + a.translation};
}

inline Transform translation(const Vec3d& t) { return {Eigen::Matrix3d::Identity(), t}; }
inline Transform scaling(const Vec3d& s) {
    return {Eigen::Matrix3d(s.asDiagonal()), Vec3d::Zero()};
}
/// Rotation by `angle` radians about a unit `axis`.
Transform rotation(const Vec3d& axis, double angle);

/// The inverse, or nothing if the map is singular, not finite, or its inverse is not finite.
std::optional<Transform> inverse(const Transform& t);

/// Twelve floats, row-major [linear | translation]: a Transform rounded once, as kernels read it.
struct FloatTransform {
    float m[3][4];
};
FloatTransform rounded(const Transform& t);

/// The image of a vertex under a rounded map, in the one order of operations that every kernel
/// uses, so that a baked vertex and one transformed on the fly have the same bits.
inline Vec3f apply(const FloatTransform& f, const Vec3f& p) {
    Vec3f r;
    for (int i = 0; i < 3; ++i)
        r[i] = (f.m[i][0] * p.x() + f.m[i][1] * p.y()) + (f.m[i][2] * p.z() + f.m[i][3]);
    return r;
}

/// Box that contains the images, rounded as by `apply`, of all points of `b`.
Bounds3 transformed(const FloatTransform& f, const Bounds3& b);

}  // namespace crofton
