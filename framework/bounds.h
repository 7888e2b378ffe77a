#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "framework/vec.h"

namespace crofton {

/// Axis-aligned box, closed on all sides. The default is empty: lower = +inf, upper = -inf, the
/// neutral element of `extend`.
struct Bounds3 {
    Vec3f lower = Vec3f::Constant(std::numeric_limits<float>::infinity());
    Vec3f upper = Vec3f::Constant(-std::numeric_limits<float>::infinity());

    bool empty() const { return !(lower.array() <= upper.array()).all(); }
    bool finite() const { return lower.allFinite() && upper.allFinite(); }

    void extend(const Vec3f& p) {
        lower = lower.cwiseMin(p);
        upper = upper.cwiseMax(p);
    }
    void extend(const Bounds3& b) {
        lower = lower.cwiseMin(b.lower);
        upper = upper.cwiseMax(b.upper);
    }
    Vec3f extent() const { return upper - lower; }
    /// Halves before adding, so that the sum of two large coordinates cannot overflow.
    Vec3f center() const { return lower * 0.5f + upper * 0.5f; }
    /// Largest absolute coordinate; 0 if empty.
    float magnitude() const {
        return empty() ? 0.0f : std::max(lower.cwiseAbs().maxCoeff(), upper.cwiseAbs().maxCoeff());
    }
    bool contains(const Bounds3& b) const {
        return (lower.array() <= b.lower.array()).all() && (upper.array() >= b.upper.array()).all();
    }
    bool overlaps(const Bounds3& b) const {
        return (lower.array() <= b.upper.array()).all() && (upper.array() >= b.lower.array()).all();
    }
    bool operator==(const Bounds3& b) const { return lower == b.lower && upper == b.upper; }
};

inline Bounds3 merge(Bounds3 a, const Bounds3& b) {
    a.extend(b);
    return a;
}

inline Bounds3 intersection(const Bounds3& a, const Bounds3& b) {
    return {a.lower.cwiseMax(b.lower), a.upper.cwiseMin(b.upper)};
}

/// Half the surface area, in double so that 1e30-sized boxes do not overflow; 0 if empty.
/// @return units of length squared
inline double half_area(const Bounds3& b) {
    if (b.empty()) return 0.0;
    const double x = double(b.upper.x()) - double(b.lower.x());
    const double y = double(b.upper.y()) - double(b.lower.y());
    const double z = double(b.upper.z()) - double(b.lower.z());
    return x * y + y * z + z * x;
}

inline double surface_area(const Bounds3& b) { return 2.0 * half_area(b); }

inline double volume(const Bounds3& b) {
    return b.empty() ? 0.0 : (b.upper.cast<double>() - b.lower.cast<double>()).prod();
}

/// A finite box that reaches at least `distance` further on every side.
inline Bounds3 grown(const Bounds3& b, const Vec3f& distance) {
    constexpr float most = std::numeric_limits<float>::max();
    Bounds3 out;
    // The share of the coordinate covers the rounding of the sum.
    out.lower =
        (b.lower.array() - (b.lower.array().abs() * 0x1p-23f + distance.array())).max(-most);
    out.upper = (b.upper.array() + (b.upper.array().abs() * 0x1p-23f + distance.array())).min(most);
    return out;
}

/// Next representable box outwards by `ulps` steps of each bound's magnitude (at least the smallest
/// normal float), used where a bound comes from rounded arithmetic.
inline Bounds3 widened(const Bounds3& b, float relative) {
    if (b.empty()) return b;
    Bounds3 out = b;
    for (int a = 0; a < 3; ++a) {
        const float scale = std::max(std::abs(b.lower[a]), std::abs(b.upper[a]));
        const float pad = std::max(scale * relative, std::numeric_limits<float>::min());
        out.lower[a] = b.lower[a] - pad;
        out.upper[a] = b.upper[a] + pad;
    }
    return out;
}

}  // namespace crofton
