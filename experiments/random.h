#pragma once

#include <cmath>
#include <cstdint>

#include "framework/vec.h"

namespace crofton {

/// PCG32 (O'Neill 2014, PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms
/// for Random Number Generation): the same numbers on every machine, unlike the standard's
/// distributions.
class Pcg32 {
  public:
    explicit Pcg32(uint64_t seed, uint64_t stream = 0) : increment_((stream << 1) | 1) {
        next();
        state_ += seed;
        next();
    }
    uint32_t next() {
        const uint64_t old = state_;
        state_ = old * 6364136223846793005ull + increment_;
        const auto shifted = static_cast<uint32_t>(((old >> 18) ^ old) >> 27);
        const auto turn = static_cast<uint32_t>(old >> 59);
        return (shifted >> turn) | (shifted << ((32 - turn) & 31));
    }
    /// Uniform in [0, 1), a multiple of 2^-32.
    double uniform() { return next() * 0x1p-32; }
    /// Uniform in 0 … n - 1, for n of at most 2^32; the bias is below n·2^-64.
    uint64_t below(uint64_t n) {
        const uint64_t high = next();
        return static_cast<uint64_t>((static_cast<unsigned __int128>((high << 32) | next()) * n) >>
                                     64);
    }

  private:
    uint64_t state_ = 0;
    uint64_t increment_;
};

inline constexpr double pi = 3.14159265358979323846;

/// Uniform on the unit sphere (Archimedes: z is uniform).
inline Vec3d uniform_direction(Pcg32& rng) {
    const double z = 1 - 2 * rng.uniform();
    const double angle = 2 * pi * rng.uniform();
    const double r = std::sqrt(std::max(0.0, 1 - z * z));
    return {r * std::cos(angle), r * std::sin(angle), z};
}

/// Two unit vectors perpendicular to the unit vector n and to each other (Duff et al. 2017,
/// Building an Orthonormal Basis, Revisited).
inline void perpendicular(const Vec3d& n, Vec3d& s, Vec3d& t) {
    const double sign = std::copysign(1.0, n.z());
    const double a = -1.0 / (sign + n.z());
    const double b = n.x() * n.y() * a;
    s = {1 + sign * n.x() * n.x() * a, sign * b, -sign * n.x()};
    t = {b, sign + n.y() * n.y() * a, -n.y()};
}

/// Over the hemisphere about the unit vector n, density cos/π (Malley: a disc, projected up).
inline Vec3d cosine_direction(const Vec3d& n, Pcg32& rng) {
    const double r2 = rng.uniform();
    const double angle = 2 * pi * rng.uniform();
    const double r = std::sqrt(r2);
    Vec3d s, t;
    perpendicular(n, s, t);
    return s * (r * std::cos(angle)) + t * (r * std::sin(angle)) + n * std::sqrt(1 - r2);
}

}  // namespace crofton
