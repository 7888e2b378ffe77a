#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "framework/vec.h"

/// Random numbers and trigonometry with the same bits on every platform, which the standard
/// library does not promise.
namespace crofton::procedural {

/// Mixes 64 bits. Source: the finalizer of SplitMix64, Steele, Lea, Flood 2014.
inline uint64_t mixed(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/// SplitMix64: a sequence of mixed counters.
class Random {
  public:
    explicit Random(uint64_t seed) : state_(mixed(seed + 1)) {}

    uint64_t bits() { return mixed(state_ += 0x9e3779b97f4a7c15u); }
    double unit() { return double(bits() >> 11) * 0x1p-53; }  ///< in [0, 1)
    double between(double low, double high) { return low + (high - low) * unit(); }
    Vec3d in_unit_cube() {
        const double x = unit(), y = unit(), z = unit();
        return {x, y, z};
    }
    /// Uniform on the unit sphere, by rejection from the cube.
    Vec3d direction() {
        for (;;) {
            const Vec3d p = 2.0 * in_unit_cube() - Vec3d::Ones();
            const double square = p.squaredNorm();
            if (square > 1e-4 && square <= 1.0) return p / std::sqrt(square);
        }
    }

  private:
    uint64_t state_;
};

struct CosSin {
    double cos, sin;
};

/// Cosine and sine of an angle in turns (1 = 360°), within 1e-15.
inline CosSin cos_sin(double turns) {
    const double quarter = std::floor(4 * turns + 0.5);
    const double x = (turns - 0.25 * quarter) * (2 * std::numbers::pi);
    // Taylor series, good to the last bits for |x| <= π/4.
    double cosine = 1, sine = x, cosine_term = 1, sine_term = x;
    for (int k = 1; k <= 9; ++k) {
        cosine_term *= -x * x / ((2 * k - 1) * (2 * k));
        sine_term *= -x * x / ((2 * k) * (2 * k + 1));
        cosine += cosine_term;
        sine += sine_term;
    }
    switch (int64_t(quarter) & 3) {
        case 0:
            return {cosine, sine};
        case 1:
            return {-sine, cosine};
        case 2:
            return {-cosine, -sine};
        default:
            return {sine, -cosine};
    }
}

/// `v` turned about a unit `axis` (Rodrigues).
inline Vec3d turned(const Vec3d& v, const Vec3d& axis, CosSin angle) {
    return v * angle.cos + axis.cross(v) * angle.sin + axis * (axis.dot(v) * (1 - angle.cos));
}

}  // namespace crofton::procedural
