// Vector code of one instruction set; included once per target (see hwy/foreach_target.h), so it
// has a guard per target instead of `#pragma once`.
#if defined(CROFTON_FRAMEWORK_SIMD_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_SIMD_H_
#undef CROFTON_FRAMEWORK_SIMD_H_
#else
#define CROFTON_FRAMEWORK_SIMD_H_
#endif

#include <hwy/highway.h>

#include <cstring>
#include <limits>

#include "framework/counters.h"
#include "framework/exact_leaf.h"
#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/ray_query.h"
#include "framework/triangle_set.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Index of the lowest of bits, which are not all 0.
HWY_INLINE uint32_t lowest(uint32_t bits) {
    return uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(bits));
}

/// W floats, or as many as the target has.
template <int W>
using Lanes = hn::CappedTag<float, W>;

/// Three corners of N triangles in world space, sheared so that the ray is the z axis.
template <class D>
struct ShearedCorners {
    using V = hn::Vec<D>;
    V x[3], y[3], z[3];  // z in units of direction[kz], not yet of t
};

/// World-space coordinate `axis` of N points: as stored, or mapped in the order of `apply`.
/// @param v  x, y and z of S points, of which those from `lane` on
template <bool Framed, int S, class D>
HWY_INLINE hn::Vec<D> world_coordinate(D d, const float (&v)[3][S], size_t lane, int axis,
                                       const InstanceFrame* frame) {
    if constexpr (!Framed) {
        return hn::LoadU(d, v[axis] + lane);
    } else {
        const float* m = frame->world_from_object_f.m[axis];
        const auto x = hn::LoadU(d, v[0] + lane);
        const auto y = hn::LoadU(d, v[1] + lane);
        const auto z = hn::LoadU(d, v[2] + lane);
        return hn::Add(hn::Add(hn::Mul(hn::Set(d, m[0]), x), hn::Mul(hn::Set(d, m[1]), y)),
                       hn::Add(hn::Mul(hn::Set(d, m[2]), z), hn::Set(d, m[3])));
    }
}

/// The same of one point.
template <bool Framed, int S>
HWY_INLINE float world_coordinate(const float (&v)[3][S], size_t i, int axis,
                                  const InstanceFrame* frame) {
    if constexpr (!Framed)
        return v[axis][i];
    else
        return apply(frame->world_from_object_f, {v[0][i], v[1][i], v[2][i]})[axis];
}

template <bool Framed, int W, class D>
HWY_INLINE ShearedCorners<D> shear(D d, const TriangleBlock<W>& block, size_t lane,
                                   const RayQuery& q, const InstanceFrame* frame) {
    ShearedCorners<D> c;
    const auto ox = hn::Set(d, q.origin[q.kx]), oy = hn::Set(d, q.origin[q.ky]),
               oz = hn::Set(d, q.origin[q.kz]);
    const auto sx = hn::Set(d, q.shear_x), sy = hn::Set(d, q.shear_y);
    for (int k = 0; k < 3; ++k) {
        c.z[k] = hn::Sub(world_coordinate<Framed>(d, block.v[k], lane, q.kz, frame), oz);
        c.x[k] = hn::Sub(hn::Sub(world_coordinate<Framed>(d, block.v[k], lane, q.kx, frame), ox),
                         hn::Mul(sx, c.z[k]));
        c.y[k] = hn::Sub(hn::Sub(world_coordinate<Framed>(d, block.v[k], lane, q.ky, frame), oy),
                         hn::Mul(sy, c.z[k]));
    }
    return c;
}

/// Where one triangle is hit.
struct SolvedLane {
    float t, u, v;
    bool known;  ///< else the others mean nothing
};

/// One lane again, in double: see refine_triangle, and Mode::double_precision.
/// @param corner  of a triangle, in object space
/// @return        not known: no hit
template <bool Framed>
HWY_NOINLINE SolvedLane refine_corners(const Vec3f (&corner)[3], const RayQuery& q,
                                       const InstanceFrame* frame) {
    float corners[3][3];
    for (int k = 0; k < 3; ++k) {
        Vec3f p = corner[k];
        if constexpr (Framed) p = apply(frame->world_from_object_f, p);
        for (int a = 0; a < 3; ++a) corners[k][a] = p[a];
    }
    SolvedLane at{};
    at.known = refine_triangle(corners, q, at.t, at.u, at.v);
    if (at.known && q.mode == Mode::double_precision) at.t = exact::refined_t(corners, q, at.t);
    return at;
}

template <bool Framed, int W>
HWY_NOINLINE SolvedLane refine_lane(const TriangleBlock<W>& block, size_t lane, const RayQuery& q,
                                    const InstanceFrame* frame) {
    const Vec3f corner[3] = {block.corner(lane, 0), block.corner(lane, 1), block.corner(lane, 2)};
    return refine_corners<Framed>(corner, q, frame);
}

/// Mode::exact: every triangle of the block by the oracle's filter, and where that is unsure, by
/// exact arithmetic.
template <Query Q, int W>
HWY_NOINLINE bool test_block_exactly(const TriangleBlock<W>& block, const LocalRay& ray,
                                     RayQuery& q, const IdTable& ids) {
    for (int lane = 0; lane < W; ++lane) {
        Vec3f v[3];
        for (int k = 0; k < 3; ++k) {
            v[k] = apply(ray.frame->world_from_object_f, block.corner(lane, k));
        }
        // A spare lane holds NaN.
        if (block.id[lane] != no_id && exact::test_triangle(Q, v, ids, block.id[lane], q))
            return true;
    }
    return false;
}

/// @return bit i: lane i
template <class D, class M>
HWY_INLINE uint32_t mask_bits(D d, M mask) {
    uint8_t bytes[8];
    hn::StoreMaskBits(d, mask, bytes);
    // No more than was written, which the compiler then keeps in a register.
    if constexpr (hn::MaxLanes(D()) <= 8) return bytes[0];
    uint16_t bits;
    static_assert(hn::MaxLanes(D()) <= 16);
    std::memcpy(&bits, bytes, sizeof bits);
    return bits;
}
/// The same backwards; further bits do not matter.
template <class D>
HWY_INLINE hn::Mask<D> bits_mask(D d, uint32_t bits) {
    uint8_t bytes[8] = {};
    std::memcpy(bytes, &bits, sizeof bits);
    return hn::LoadMaskBits(d, bytes);
}

/// Mode::fast: t, u, v from the float edge functions, unless these overflow.
/// @param open  lanes that may be hit
template <Query Q, class D, class Source>
HWY_INLINE bool record_fast(D d, const hn::Vec<D> (&edge)[3], const hn::Vec<D> (&z)[3],
                            uint32_t open, const Source& source, RayQuery& q, const IdTable& ids) {
    const auto det = hn::Add(hn::Add(edge[0], edge[1]), edge[2]);
    const auto per_det = hn::Div(hn::Set(d, 1.0f), det);
    const auto u = hn::Mul(edge[1], per_det), v = hn::Mul(edge[2], per_det);
    auto t = hn::Add(hn::Add(hn::Mul(hn::Mul(edge[0], per_det), z[0]), hn::Mul(u, z[1])),
                     hn::Mul(v, z[2]));
    t = hn::Min(hn::Max(t, hn::Min(hn::Min(z[0], z[1]), z[2])), hn::Max(hn::Max(z[0], z[1]), z[2]));
    // Written so that NaN (an area of zero) is no area.
    const auto has_area = hn::Gt(hn::Abs(det), hn::Set(d, 0x1p-100f));
    const auto within = hn::And(hn::Ge(t, hn::Set(d, q.t_min)), hn::Le(t, hn::Set(d, q.t_best)));
    open &= mask_bits(d, hn::And(has_area, within));
    // Weights of an area that overflowed are zero or NaN.
    const uint32_t known = mask_bits(d, hn::Gt(hn::Add(u, v), hn::Zero(d)));
    alignas(64) float at[3][hn::MaxLanes(D())];
    hn::Store(t, d, at[0]);
    hn::Store(u, d, at[1]);
    hn::Store(v, d, at[2]);
    for (; open; open &= open - 1) {
        const uint32_t i = lowest(open);
        SolvedLane hit{at[0][i], at[1][i], at[2][i], bool(known >> i & 1)};
        if (HWY_UNLIKELY(!hit.known)) hit = source.refine(i, q);
        if (!hit.known || !(hit.t >= q.t_min && hit.t <= q.t_best)) continue;
        if constexpr (Q == Query::any) return true;
        q.record(hit.t, hit.u, hit.v, ids, source.id(i));
    }
    return false;
}

/// A triangle and a ray in every lane, in double.
template <class DD>
struct DoubleHits {
    using V = hn::Vec<DD>;
    hn::Mask<DD> known;  ///< others need refine_triangle
    hn::Vec<hn::Rebind<float, DD>> t, u, v;
};

/// t, u, v as refine_triangle has them inside of a triangle. Not known are lanes that pass outside
/// in double, or have too little area for it.
///
/// How far off t may be, with u = 2^-53, `reach` the largest sheared coordinate, z the largest
/// depth and distance = reach + |z|, all times the direction's main component where that is
/// cheaper: a sheared coordinate errs by 3u·reach + 8u·|z| at most (its products and sums, |X| <=
/// reach + 2|Z|), so an edge function by 4·reach·10u·distance, and with its own roundings by
/// 44u·reach·distance. Weights are three of them over their sum, det, and what they weigh lies
/// within the spread of depths: t errs by 132u·steep·spread to first order, steep =
/// reach·distance/|det|; with the roundings of depths and of the sum by less than
/// 2^8·u·steep·spread + 8u·|t|. Where that is above 2^-27·|t|, Mode::double_precision asks the
/// oracle.
///
/// @param corner     of the triangles; of each kx, ky, kz
/// @param o, dir     of the rays, likewise
/// @param to_an_ulp  as Mode::double_precision asks
template <class DD, class V>
HWY_INLINE DoubleHits<DD> solve_lanes(DD dd, const V (&corner)[3][3], const V (&o)[3],
                                      const V (&dir)[3], bool to_an_ulp) {
    V x[3], y[3], z[3], reach = hn::Zero(dd);
    for (int k = 0; k < 3; ++k) {
        z[k] = hn::Sub(corner[k][2], o[2]);
        x[k] = hn::Sub(hn::Mul(hn::Sub(corner[k][0], o[0]), dir[2]), hn::Mul(dir[0], z[k]));
        y[k] = hn::Sub(hn::Mul(hn::Sub(corner[k][1], o[1]), dir[2]), hn::Mul(dir[1], z[k]));
        reach = hn::Max(reach, hn::Max(hn::Abs(x[k]), hn::Abs(y[k])));
    }
    const V a = hn::Sub(hn::Mul(x[2], y[1]), hn::Mul(y[2], x[1]));
    const V b = hn::Sub(hn::Mul(x[0], y[2]), hn::Mul(y[0], x[2]));
    const V c = hn::Sub(hn::Mul(x[1], y[0]), hn::Mul(y[1], x[0]));
    const V det = hn::Add(hn::Add(a, b), c);
    const V per = hn::Div(hn::Set(dd, 1.0), hn::Mul(det, dir[2]));
    const V depth = hn::Add(hn::Add(hn::Mul(a, z[0]), hn::Mul(b, z[1])), hn::Mul(c, z[2]));
    const V zero = hn::Zero(dd);
    const auto inside =
        hn::Or(hn::Ge(hn::Min(hn::Min(a, b), c), zero), hn::Le(hn::Max(hn::Max(a, b), c), zero));
    auto known =
        hn::And(inside, hn::Gt(hn::Abs(det), hn::Mul(hn::Mul(reach, reach), hn::Set(dd, 0x1p-31))));
    if (HWY_UNLIKELY(to_an_ulp)) {
        const V low = hn::Min(hn::Min(z[0], z[1]), z[2]), high = hn::Max(hn::Max(z[0], z[1]), z[2]);
        const V distance = hn::Add(reach, hn::Max(hn::Abs(low), hn::Abs(high)));
        const V error =
            hn::Mul(hn::Mul(reach, distance), hn::Mul(hn::Sub(high, low), hn::Set(dd, 0x1p-18)));
        known = hn::And(known, hn::Le(error, hn::Abs(depth)));
    }
    const hn::Rebind<float, DD> df;
    const V per_det = hn::Mul(per, dir[2]);
    return {known, hn::DemoteTo(df, hn::Mul(depth, per)), hn::DemoteTo(df, hn::Mul(b, per_det)),
            hn::DemoteTo(df, hn::Mul(c, per_det))};
}

/// One triangle's t, u, v: see solve_lanes.
template <class Source>
HWY_INLINE SolvedLane solve_lane(const Source& source, uint32_t lane, const RayQuery& q) {
    const hn::CappedTag<double, 1> dd;
    const hn::Rebind<float, decltype(dd)> df;
    using V = hn::Vec<decltype(dd)>;
    const auto promote = [&](const float& x)
                             HWY_ATTR { return hn::PromoteTo(dd, hn::LoadU(df, &x)); };
    V corner[3][3], o[3], dir[3];
    const int axes[3] = {q.kx, q.ky, q.kz};
    for (int a = 0; a < 3; ++a) {
        o[a] = promote(q.origin[axes[a]]);
        dir[a] = promote(q.direction[axes[a]]);
        for (int k = 0; k < 3; ++k) corner[k][a] = promote(source.world(lane, k, axes[a]));
    }
    const auto found = solve_lanes(dd, corner, o, dir, q.mode == Mode::double_precision);
    return {hn::GetLane(found.t), hn::GetLane(found.u), hn::GetLane(found.v),
            !hn::AllFalse(dd, found.known)};
}

/// Where a ray that passes through the inside of a triangle hits it in [t_min, t_max] for certain:
/// wherever t is found, it is between the depths of the corners.
/// @param near, far  least and largest of these depths, in float
template <class D, class V>
HWY_INLINE hn::Mask<D> surely_within(D d, V near, V far, V t_min, V t_max) {
    const auto slack = hn::Set(d, cull_slack);
    return hn::And(hn::Ge(hn::NegMulAdd(hn::Abs(near), slack, near), t_min),
                   hn::Le(hn::MulAdd(hn::Abs(far), slack, far), t_max));
}

/// Which of N triangles are hit in [t_min, t_max], as far as float can tell.
template <class D>
struct FloatVerdict {
    hn::Mask<D> hit, missed;  ///< for certain; the rest has to be solved in double
};

/// As t is a mean of three depths whose weights are the edge functions, its side of an end tau is
/// the sign of sum(edge·(z - tau))·det. With u = 2^-24, and reach and distance as for solve_lanes,
/// an edge function errs by 44u·reach·distance: where all are twice as large and more, double has
/// the same signs, and solves there. The sum errs by three times that and the spread of depths
/// (tau outside of these is on the side that the sum says in any case), and by 16u·|det·z|: errors
/// of depths, of sums and products, and of t as a float.
/// @param low, high  least and largest of `edge`; near, far: of z
template <class D, class V>
HWY_INLINE FloatVerdict<D> judge(D d, const V (&x)[3], const V (&y)[3], const V (&edge)[3],
                                 const V (&z)[3], V low, V high, V near, V far, V t_min, V t_max) {
    const auto larger = [](V a, V b) HWY_ATTR { return hn::Max(hn::Abs(a), hn::Abs(b)); };
    const V reach = hn::Max(hn::Max(larger(x[0], y[0]), larger(x[1], y[1])), larger(x[2], y[2]));
    const V depth = larger(near, far);
    const V area = hn::Mul(reach, hn::MulAdd(depth, hn::Set(d, 2.0f), reach));
    const V edge_error = hn::Max(hn::Mul(area, hn::Set(d, 0x1p-17f)), hn::Set(d, 0x1p-100f));
    const auto inside = hn::Or(hn::Gt(low, edge_error), hn::Lt(high, hn::Neg(edge_error)));

    const V det = hn::Add(hn::Add(edge[0], edge[1]), edge[2]);
    const V spread = hn::MulAdd(depth, hn::Set(d, 0x1p-13f), hn::Sub(far, near));
    const V error = hn::MulAdd(
        hn::Mul(area, hn::Set(d, 0x1.2p-17f)), spread,
        hn::MulAdd(hn::Mul(hn::Abs(det), hn::Set(d, 0x1.8p-20f)), depth, hn::Set(d, 0x1p-120f)));
    const V sum = hn::MulAdd(edge[0], z[0], hn::MulAdd(edge[1], z[1], hn::Mul(edge[2], z[2])));
    const V sign = hn::And(det, hn::SignBit(d));
    const V from_min = hn::Xor(hn::NegMulAdd(t_min, det, sum), sign),
            to_max = hn::Xor(hn::MulSub(t_max, det, sum), sign);
    const V least = hn::Min(from_min, to_max);
    return {hn::And(inside, hn::Gt(least, error)), hn::And(inside, hn::Lt(least, hn::Neg(error)))};
}

/// Tests N triangles by their sheared corners (Woop, Benthin, Wald 2013).
///
/// An edge function is the difference of two rounded products of rounded, shared coordinates.
/// Rounding is monotone, so a nonzero sign is right; a zero is decided in double, where the
/// products are exact. Neighbours thus agree on every edge, and no ray passes between them. What
/// remains (one lane in most leaves that come this far) is solved in double: that costs less than
/// to find out whether float would do.
///
/// @param depth   of corner k, its third sheared coordinate
/// @param source  of lane i, world(i, k, axis): a coordinate of corner k in world space; refine(i,
///                q): see refine_triangle; id(i). And used(lanes): those that hold a triangle, of
///                the bits in `lanes`
template <Query Q, class D, class Depth, class Source>
HWY_INLINE bool test_corners(D d, const hn::Vec<D> (&x)[3], const hn::Vec<D> (&y)[3],
                             const Depth& depth, const Source& source, RayQuery& q,
                             const IdTable& ids) {
    const auto zero = hn::Zero(d);
    const hn::Vec<D> edge[3] = {hn::Sub(hn::Mul(x[2], y[1]), hn::Mul(y[2], x[1])),
                                hn::Sub(hn::Mul(x[0], y[2]), hn::Mul(y[0], x[2])),
                                hn::Sub(hn::Mul(x[1], y[0]), hn::Mul(y[1], x[0]))};
    const auto low = hn::Min(hn::Min(edge[0], edge[1]), edge[2]),
               high = hn::Max(hn::Max(edge[0], edge[1]), edge[2]);
    // Both comparisons are false for a lane of NaN.
    uint32_t open = source.used(mask_bits(d, hn::Or(hn::Ge(low, zero), hn::Le(high, zero))));
    if (HWY_LIKELY(!open)) return false;

    const auto sz = hn::Set(d, q.shear_z);
    const hn::Vec<D> z[3] = {hn::Mul(depth(0), sz), hn::Mul(depth(1), sz), hn::Mul(depth(2), sz)};
    const auto near = hn::Min(hn::Min(z[0], z[1]), z[2]), far = hn::Max(hn::Max(z[0], z[1]), z[2]);
    open &=
        mask_bits(d, hn::And(hn::Le(near, hn::Set(d, q.t_cull)), hn::Ge(far, hn::Set(d, q.t_low))));
    if (!open) return false;
    if (HWY_UNLIKELY(q.mode == Mode::fast)) return record_fast<Q>(d, edge, z, open, source, q, ids);

    const auto inside = hn::And(hn::Ne(low, zero), hn::Ne(high, zero));
    if constexpr (Q == Query::any) {
        const auto within = surely_within(d, near, far, hn::Set(d, q.t_min), hn::Set(d, q.t_best));
        if (open & mask_bits(d, hn::And(inside, within))) return true;
        // Shadow rays begin on a surface, and are near its triangles: most of these end here.
        // Closest hits are mostly found where they are looked for, and that is not worth it.
        const auto verdict = judge(d, x, y, edge, z, low, high, near, far, hn::Set(d, q.t_min),
                                   hn::Set(d, q.t_best));
        if (open & mask_bits(d, verdict.hit)) return true;
        open &= ~mask_bits(d, verdict.missed);
    }
    const uint32_t plain = mask_bits(d, inside);
    for (; open; open &= open - 1) {
        const uint32_t i = lowest(open);
        SolvedLane at;
        if (HWY_LIKELY(plain >> i & 1)) at = solve_lane(source, i, q);
        if (HWY_UNLIKELY(!(plain >> i & 1) || !at.known)) at = source.refine(i, q);
        if (!at.known || !(at.t >= q.t_min && at.t <= q.t_best)) continue;
        if constexpr (Q == Query::any) return true;
        q.record(at.t, at.u, at.v, ids, source.id(i));
    }
    return false;
}

/// N lanes of a block, for test_corners.
template <bool Framed, int W, class D>
struct BlockLanes {
    const TriangleBlock<W>& block;
    size_t lane;
    const InstanceFrame* frame;

    HWY_INLINE float world(uint32_t i, int k, int axis) const {
        return world_coordinate<Framed>(block.v[k], lane + i, axis, frame);
    }
    HWY_INLINE uint32_t used(uint32_t lanes) const { return lanes; }
    HWY_INLINE SolvedLane refine(uint32_t i, const RayQuery& q) const {
        return refine_lane<Framed>(block, lane + i, q, frame);
    }
    HWY_INLINE uint32_t id(uint32_t i) const { return block.id[lane + i]; }
};

/// Tests the triangles of one block, in world space.
template <Query Q, bool Framed, int W>
HWY_INLINE bool test_block(const TriangleBlock<W>& block, const LocalRay& ray, RayQuery& q,
                           const IdTable& ids) {
    const Lanes<W> d;
    for (size_t lane = 0; lane < W; lane += hn::MaxLanes(Lanes<W>())) {
        const auto c = shear<Framed>(d, block, lane, q, ray.frame);
        const auto depth = [&](int k) HWY_ATTR { return c.z[k]; };
        const BlockLanes<Framed, W, Lanes<W>> source{block, lane, ray.frame};
        if (test_corners<Q>(d, c.x, c.y, depth, source, q, ids)) return true;
    }
    return false;
}

/// Under a map, out of line: a second copy of the test in every traversal would only push the
/// common one out of the instruction cache. In mode `exact` all of space has a frame, so that the
/// common test need not ask for that mode.
template <Query Q, int W>
HWY_NOINLINE bool test_framed_block(const TriangleBlock<W>& block, const LocalRay& ray, RayQuery& q,
                                    const IdTable& ids) {
    if (HWY_UNLIKELY(q.mode == Mode::exact)) return test_block_exactly<Q>(block, ray, q, ids);
    return test_block<Q, true>(block, ray, q, ids);
}

template <Query Q, int W>
HWY_INLINE bool test_blocks(const TriangleSet& set, const TriangleBlock<W>* block, uint32_t count,
                            const LocalRay& ray, RayQuery& q) {
    for (uint32_t i = 0; i < count; i += W, ++block) {
        const bool found = ray.frame ? test_framed_block<Q>(*block, ray, q, set.ids())
                                     : test_block<Q, false>(*block, ray, q, set.ids());
        if (Q == Query::any && found) return true;
    }
    return false;
}

/// @name Leaf tests: every set has both
/// test_leaf: `count` shapes from `first` on, as TriangleLeaves or ReferenceLeaves stored them.
/// test_references: shapes named by indices. Return whether an `any` query is answered.
/// @{
template <Query Q, class C>
HWY_INLINE bool test_leaf(const TriangleSet& set, const TriangleLeaves& leaves, uint32_t first,
                          uint32_t count, const LocalRay& ray, RayQuery& q, C& counters) {
    counters.test(count);
    return test_blocks<Q>(set, leaves.blocks() + first, count, ray, q);
}

/// The corner of a spare lane: no test accepts NaN.
alignas(16) inline constexpr float no_corner[4] = {
    std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::quiet_NaN(),
    std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::quiet_NaN()};

/// Gathers up to four triangles into a block: per corner four loads and a transpose. A triangle in
/// two lanes would be refined and recorded twice where it is hit.
HWY_INLINE void gather_block(const TriangleSet& set, const uint32_t* references, uint32_t count,
                             TriangleBlock<4>& block) {
    static constexpr TriangleSet::Indices first_corner{};
    const hn::FixedTag<float, 4> d;
    const hn::FixedTag<double, 2> d2;
    const float* corners[4];
    const TriangleSet::Indices* tri[4];
    for (uint32_t i = 0; i < 4; ++i) {
        const bool used = i < count;
        block.id[i] = used ? references[i] : no_id;
        corners[i] = used ? set.coordinates() : no_corner;
        tri[i] = used ? set.triangles() + references[i] : &first_corner;
    }
    const auto load = [&](int i, int k) HWY_ATTR {
        return hn::LoadU(d, corners[i] + 3 * size_t((*tri[i])[size_t(k)]));
    };
    for (int k = 0; k < 3; ++k) {
        const auto p = load(0, k), q = load(1, k), r = load(2, k), s = load(3, k);
        const auto pq_low = hn::InterleaveLower(d, p, q), rs_low = hn::InterleaveLower(d, r, s);
        const auto pq_high = hn::InterleaveUpper(d, p, q), rs_high = hn::InterleaveUpper(d, r, s);
        const auto x = hn::InterleaveLower(d2, hn::BitCast(d2, pq_low), hn::BitCast(d2, rs_low));
        const auto y = hn::InterleaveUpper(d2, hn::BitCast(d2, pq_low), hn::BitCast(d2, rs_low));
        const auto z = hn::InterleaveLower(d2, hn::BitCast(d2, pq_high), hn::BitCast(d2, rs_high));
        hn::Store(hn::BitCast(d, x), d, block.v[k][0]);
        hn::Store(hn::BitCast(d, y), d, block.v[k][1]);
        hn::Store(hn::BitCast(d, z), d, block.v[k][2]);
    }
}

template <Query Q, class C>
HWY_INLINE bool test_references(const TriangleSet& set, const uint32_t* references, uint32_t count,
                                const LocalRay& ray, RayQuery& q, C& counters) {
    counters.test(count);
    TriangleBlock<4> block;
    for (uint32_t i = 0; i < count; i += 4) {
        gather_block(set, references + i, count - i, block);
        if (test_blocks<Q>(set, &block, 1, ray, q)) return true;
    }
    return false;
}

template <Query Q, class Set, class C>
HWY_INLINE bool test_shapes(const Set& set, const uint32_t* references, uint32_t count,
                            const LocalRay& ray, RayQuery& q, C& counters) {
    counters.test(count);
    // Kinds that the oracle knows have a stricter test for the stricter modes.
    if constexpr (requires { exact::test_shapes(Q, set, references, count, ray, q); })
        if (HWY_UNLIKELY(q.mode > Mode::robust))
            return exact::test_shapes(Q, set, references, count, ray, q);
    for (uint32_t i = 0; i < count; ++i) {
        float t;
        if (!set.intersect(references[i], ray, q, t)) continue;
        if constexpr (Q == Query::any) return true;
        q.record(t, 0, 0, set.ids(), references[i]);
    }
    return false;
}

template <Query Q, class C>
HWY_INLINE bool test_references(const QuadricSet& set, const uint32_t* references, uint32_t count,
                                const LocalRay& ray, RayQuery& q, C& counters) {
    return test_shapes<Q>(set, references, count, ray, q, counters);
}

template <Query Q, class C>
HWY_INLINE bool test_references(const PolygonSet& set, const uint32_t* references, uint32_t count,
                                const LocalRay& ray, RayQuery& q, C& counters) {
    return test_shapes<Q>(set, references, count, ray, q, counters);
}

/// Conservative box test. @return whether the thick ray may meet `b` within [t_low, t_cull]
HWY_INLINE bool meets_box(const Bounds3& b, const LocalRay& ray, const RayQuery& q, float& t_near,
                          float& t_far) {
    float near = q.t_low, far = q.t_cull;
    for (int a = 0; a < 3; ++a) {
        const bool down = std::signbit(ray.rcp[a]);
        const float lo = down ? b.upper[a] : b.lower[a], hi = down ? b.lower[a] : b.upper[a];
        near = std::max(near, (lo - ray.near_origin[a]) * ray.rcp[a]);
        far = std::min(far, (hi - ray.far_origin[a]) * ray.far_rcp[a]);
    }
    t_near = near;
    t_far = far;
    return near <= far;
}

/// Traces a ray in an object whose box it meets.
template <Query Q, class C>
HWY_INLINE bool trace_object(const ObjectSet::Entry& entry, const LocalRay& ray, RayQuery& q,
                             C& counters) {
    const uint32_t outer = q.instance;
    q.instance = outer + entry.instance;
    bool found = false;
    if constexpr (std::is_same_v<C, NoCounters>) {
        if constexpr (Q == Query::any)
            found = entry.primitive->any_local(ray, q);
        else
            entry.primitive->closest_local(ray, q);
    } else {
        if constexpr (Q == Query::any)
            found = entry.primitive->any_local(ray, q, counters);
        else
            entry.primitive->closest_local(ray, q, counters);
    }
    q.instance = outer;
    return found;
}

template <Query Q, class C>
HWY_INLINE bool enter_object(const ObjectSet& set, uint32_t i, const LocalRay& ray, RayQuery& q,
                             C& counters) {
    const ObjectSet::Entry& entry = set.entry(i);
    float t_near, t_far;
    return meets_box(entry.bounds, ray, q, t_near, t_far) &&
           trace_object<Q>(entry, ray, q, counters);
}

template <Query Q, class C>
HWY_INLINE bool test_references(const ObjectSet& set, const uint32_t* references, uint32_t count,
                                const LocalRay& ray, RayQuery& q, C& counters) {
    for (uint32_t i = 0; i < count; ++i)
        if (enter_object<Q>(set, references[i], ray, q, counters)) return true;
    return false;
}

template <Query Q, class Set, class C>
HWY_INLINE bool test_leaf(const Set& set, const ReferenceLeaves& leaves, uint32_t first,
                          uint32_t count, const LocalRay& ray, RayQuery& q, C& counters) {
    return test_references<Q>(set, leaves.references() + first, count, ray, q, counters);
}
/// @}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
