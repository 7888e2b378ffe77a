#pragma once

#include <cstdint>
#include <vector>

#include "framework/exact_number.h"
#include "framework/ray.h"
#include "framework/transform.h"

namespace crofton::exact {

/// Box in world space, in double.
struct Box {
    double lower[3] = {INFINITY, INFINITY, INFINITY};
    double upper[3] = {-INFINITY, -INFINITY, -INFINITY};
    /// What the coordinates inside were made of: see Placed::size. A leaf test can stray by a share
    /// of it.
    double size = 0;

    void extend(const double (&p)[3], double radius);
    void extend(const Box& b);
};

/// t of a triangle, relative: rounded to float once from double, where the corners' errors are far
/// below triangle_bound (solve_lanes in framework/simd.h).
inline constexpr double t_bound = 0x1p-23;
/// And absolute: t may be no normal float.
inline constexpr double least_t_bound = 0x1p-125;
/// The same in Mode::fast: the products and sums of the float test err by 14u·t.
inline constexpr double fast_t_bound = 0x1p-19;

/// The ray for the filter.
struct DoubleRay {
    double o[3], d[3];
    int kx, ky, kz;  ///< kz: the largest |d|
    double sx, sy;   ///< d[kx]/d[kz], d[ky]/d[kz], rounded; |s| <= 1
    double t_min, t_max;
    double t_bound;  ///< of triangles, for candidates of a scale above 0

    explicit DoubleRay(const Ray& ray, double t_bound = exact::t_bound);
};

/// The ray for the exact stage.
struct ExactRay {
    Triple<Dyadic> o, d;
    int kx, ky, kz;

    explicit ExactRay(const Ray& ray);
};

/// A possible hit, as the filter sees it: t lies within [lo, hi] if there is one.
struct Candidate {
    double lo = -INFINITY, hi = INFINITY;
    bool sure = false;  ///< there is one

    /// By a share of t.
    void widen(double relative) {
        lo -= relative * std::abs(lo);
        hi += relative * std::abs(hi);
    }
};
/// At most two of a shape, in ascending order if both are sure.
struct Candidates {
    int count = 0;
    Candidate at[2];
    void add(const Candidate& c) { at[count++] = c; }
};

/// A chain of affine maps composed without rounding: p ↦ linear·p + translation.
struct ExactMap {
    Triple<Dyadic> row[3];  ///< of the linear part
    Triple<Dyadic> translation;

    ExactMap();  ///< the identity
    explicit ExactMap(const Transform& t);
    Triple<Dyadic> point(const Triple<Dyadic>& p) const;
};
ExactMap operator*(const ExactMap& a, const ExactMap& b);

/// Where shapes stand: world_from_object, exactly and in double.
struct Placed {
    /// @param maps  the chain, world side first
    explicit Placed(const std::vector<Transform>& maps);

    bool identity;
    ExactMap exact;
    Triple<Interval> row[3];  ///< contains the exact map
    Triple<Interval> translation;
    /// Products of the absolute values of the chain's entries: |world point| computed in any order
    /// is wrong by at most its roundings times absolute·(|p|, 1).
    double absolute[3][4];
    double maps;       ///< length of the chain, at least 1
    double condition;  ///< of the linear part, an upper estimate

    /// Image of an object point. @param size  see above, its largest component
    void point(const Vec3f& p, double (&center)[3], double& radius, double& size) const;
    Triple<Dyadic> exact_point(const Vec3f& p) const {
        return identity ? triple<Dyadic>(p) : exact.point(triple<Dyadic>(p));
    }
    /// The map in either kind of number.
    template <class N>
    const Triple<N>* rows() const {
        if constexpr (std::is_same_v<N, Dyadic>)
            return exact.row;
        else
            return row;
    }
    template <class N>
    const Triple<N>& offset() const {
        if constexpr (std::is_same_v<N, Dyadic>)
            return exact.translation;
        else
            return translation;
    }
};

/// Shapes of one kind in one place, as the oracle sees them. A new kind derives from this and is
/// given to Oracle::add.
class Shapes {
  public:
    virtual ~Shapes() = default;

    virtual uint32_t size() const = 0;
    /// Inactive shapes are never hit.
    virtual bool active(uint32_t i) const = 0;
    /// Contains shape i. World space.
    virtual Box bounds(uint32_t i) const = 0;
    /// Where the ray may hit shape i, by double arithmetic with error bounds: every hit lies in a
    /// candidate, and a sure candidate holds a hit.
    /// @param scale  0: of the shape as given. Else of all shapes that `scale` times the stated
    ///               bound of the library's leaf test can make of it: a sure candidate is then one
    ///               that the leaf test must find, and what is in no candidate it must not find.
    virtual void candidates(const DoubleRay& ray, uint32_t i, double scale,
                            Candidates& out) const = 0;
    /// Adds every t at which the ray hits shape i, exactly, in ascending order.
    virtual void solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const = 0;
};

/// Stated bounds of the leaf tests, relative. `reach` is the largest component of v - o over a
/// shape, `size` see Placed::point.
///
/// Triangles. The watertight test decides by exact signs on the sheared corners that it rounded.
/// u = 2^-24, s = d[kx]/d[kz], X = v.x - o.x, Z = v.z - o.z; fl(X) and fl(Z) are wrong by u
/// relatively, the shear factor fl(d.x·fl(1/d.z)) by 2u, its product with Z by 4u in all, and the
/// difference x by u|x| <= u(|X| + |Z|): together at most 2u|X| + 5u|Z| <= 7u·reach, to first
/// order. A mapped corner is wrong by 4u·size per coordinate before that (its matrix rounded once,
/// a product, two sums), which shear at most doubles: 8u·size. So x and y are displaced by at most
///     8u·(reach + size),  8u = 2^-21,
/// and the test is right for the displaced triangle. What no such displacement can change it must
/// get right; where one can, it is "inside the margin".
inline constexpr double triangle_bound = 0x1p-21;
/// Polygons and quadrics are tested in double on the object-space ray: roundings of at most 2^-50
/// of the numbers involved, 16 of them, and as many times the condition of the map that inverting
/// it costs.
inline constexpr double double_bound = 0x1p-46;
/// Their t is rounded to float once.
inline constexpr double double_t_bound = 0x1p-23;

/// Least displacement, so that underflow is within every margin.
inline constexpr double least_bound = 0x1p-140;

}  // namespace crofton::exact
