// Vector code of one instruction set; included once per target (see hwy/foreach_target.h), so it
// has a guard per target instead of `#pragma once`.
#if defined(CROFTON_FRAMEWORK_SIMD_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_SIMD_H_
#undef CROFTON_FRAMEWORK_SIMD_H_
#else
#define CROFTON_FRAMEWORK_SIMD_H_
#endif

#include <hwy/highway.h>

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

/// W floats, or as many as the target has.
template <int W>
using Lanes = hn::CappedTag<float, W>;

/// Three corners of N triangles in world space, sheared so that the ray is the z axis.
template <class D>
struct ShearedCorners {
    using V = hn::Vec<D>;
    V x[3], y[3], z[3];  // z in units of direction[kz], not yet of t
};

/// World-space coordinate `axis` of corner k: as stored, or mapped in the order of `apply`.
template <bool Framed, int W, class D>
HWY_INLINE hn::Vec<D> world_coordinate(D d, const TriangleBlock<W>& block, size_t lane, int k,
                                       int axis, const InstanceFrame* frame) {
    if constexpr (!Framed) {
        return hn::LoadU(d, block.v[k][axis] + lane);
    } else {
        const float* m = frame->world_from_object_f.m[axis];
        const auto x = hn::LoadU(d, block.v[k][0] + lane);
        const auto y = hn::LoadU(d, block.v[k][1] + lane);
        const auto z = hn::LoadU(d, block.v[k][2] + lane);
        return hn::Add(hn::Add(hn::Mul(hn::Set(d, m[0]), x), hn::Mul(hn::Set(d, m[1]), y)),
                       hn::Add(hn::Mul(hn::Set(d, m[2]), z), hn::Set(d, m[3])));
    }
}

template <bool Framed, int W, class D>
HWY_INLINE ShearedCorners<D> shear(D d, const TriangleBlock<W>& block, size_t lane,
                                   const RayQuery& q, const InstanceFrame* frame) {
    ShearedCorners<D> c;
    const auto ox = hn::Set(d, q.origin[q.kx]), oy = hn::Set(d, q.origin[q.ky]),
               oz = hn::Set(d, q.origin[q.kz]);
    const auto sx = hn::Set(d, q.shear_x), sy = hn::Set(d, q.shear_y);
    for (int k = 0; k < 3; ++k) {
        c.z[k] = hn::Sub(world_coordinate<Framed>(d, block, lane, k, q.kz, frame), oz);
        c.x[k] = hn::Sub(hn::Sub(world_coordinate<Framed>(d, block, lane, k, q.kx, frame), ox),
                         hn::Mul(sx, c.z[k]));
        c.y[k] = hn::Sub(hn::Sub(world_coordinate<Framed>(d, block, lane, k, q.ky, frame), oy),
                         hn::Mul(sy, c.z[k]));
    }
    return c;
}

/// One lane again, in double: see refine_triangle, and Mode::double_precision.
/// @param corner  of a triangle, in object space
template <bool Framed>
HWY_NOINLINE bool refine_corners(const Vec3f (&corner)[3], const RayQuery& q,
                                 const InstanceFrame* frame, float& t, float& u, float& v) {
    float corners[3][3];
    for (int k = 0; k < 3; ++k) {
        Vec3f p = corner[k];
        if constexpr (Framed) p = apply(frame->world_from_object_f, p);
        for (int a = 0; a < 3; ++a) corners[k][a] = p[a];
    }
    if (!refine_triangle(corners, q, t, u, v)) return false;
    if (q.mode == Mode::double_precision) t = exact::refined_t(corners, q, t);
    return true;
}

template <bool Framed, int W>
HWY_NOINLINE bool refine_lane(const TriangleBlock<W>& block, size_t lane, const RayQuery& q,
                              const InstanceFrame* frame, float& t, float& u, float& v) {
    const Vec3f corner[3] = {block.corner(lane, 0), block.corner(lane, 1), block.corner(lane, 2)};
    return refine_corners<Framed>(corner, q, frame, t, u, v);
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

/// Tests N triangles by their sheared corners (Woop, Benthin, Wald 2013).
///
/// An edge function is the difference of two rounded products of rounded, shared coordinates.
/// Rounding is monotone, so a nonzero sign is right; a zero is decided in double, where the
/// products are exact. Neighbours thus agree on every edge, and no ray passes between them. Lanes
/// whose t might be off by more than 2^-19 are recomputed in double. In mode `fast` nothing is
/// recomputed, and in `double` every hit is.
///
/// How far off t may be, with u = 2^-24, `reach` the largest sheared coordinate, zt the largest
/// depth in units of t, and distance = reach + zt: since |v_z - o_z| <= 2·zt, a sheared coordinate
/// errs by 2u·reach + 10u·zt at most (see LocalRay), so an edge function by 4·reach·10u·distance,
/// and with its own roundings by 44u·reach·distance. Weights are three of them over their sum, det,
/// and what they weigh lies within the spread of depths: t errs by k·(z_high - z_low) to first
/// order, k = 132u·`steep`, steep = reach·distance/|det|, and by k/(1 - k) of it in all, which is
/// at most 152u·steep where steep < 2^14. The depths' own roundings and those of the sum are
/// 8u·(|t| + z_high - z_low), and 1 <= 4·steep, as |det| <= 4·reach². If
/// in double the ray turns out to pass outside, the hit is the nearest point of the edges, which is
/// 20u·spread away in depth. In sum 216u·spread + 8u·|t|, spread = steep·(z_high - z_low); and less
/// than 32u·|t| where 8·spread < |t|.
///
/// @param source  z(k): the third coordinate of corner k; used(mask): the lanes that hold a
///                triangle, of those in mask; refine(i, q, t, u, v): see refine_triangle; id(i)
template <Query Q, class D, class Source>
HWY_INLINE bool test_corners(D d, const hn::Vec<D> (&x)[3], const hn::Vec<D> (&y)[3],
                             const Source& source, RayQuery& q, const IdTable& ids) {
    constexpr size_t N = hn::MaxLanes(D());
    const auto zero = hn::Zero(d);
    const auto a = hn::Sub(hn::Mul(x[2], y[1]), hn::Mul(y[2], x[1]));
    const auto b = hn::Sub(hn::Mul(x[0], y[2]), hn::Mul(y[0], x[2]));
    const auto e = hn::Sub(hn::Mul(x[1], y[0]), hn::Mul(y[1], x[0]));
    const auto low = hn::Min(hn::Min(a, b), e), high = hn::Max(hn::Max(a, b), e);
    // Both comparisons are false for a lane of NaN.
    auto hit = source.used(hn::Or(hn::Ge(low, zero), hn::Le(high, zero)));
    if (HWY_LIKELY(hn::AllFalse(d, hit))) return false;

    const auto det = hn::Add(hn::Add(a, b), e);
    const auto rdet = hn::Div(hn::Set(d, 1.0f), det);
    const auto sz = hn::Set(d, q.shear_z);
    const auto za = hn::Mul(source.z(0), sz), zb = hn::Mul(source.z(1), sz),
               zc = hn::Mul(source.z(2), sz);
    const auto z_low = hn::Min(hn::Min(za, zb), zc), z_high = hn::Max(hn::Max(za, zb), zc);
    hit = hn::And(
        hit, hn::And(hn::Le(z_low, hn::Set(d, q.t_cull)), hn::Ge(z_high, hn::Set(d, q.t_low))));
    if (hn::AllFalse(d, hit)) return false;
    const auto wb = hn::Mul(b, rdet), wc = hn::Mul(e, rdet);
    auto t = hn::Add(hn::Add(hn::Mul(hn::Mul(a, rdet), za), hn::Mul(wb, zb)), hn::Mul(wc, zc));
    t = hn::Min(hn::Max(t, z_low), z_high);

    // Written so that NaN (an area of zero) is no area.
    const auto has_area = hn::Gt(hn::Abs(det), hn::Set(d, 0x1p-100f));
    auto sure = hit;
    if (HWY_UNLIKELY(q.mode == Mode::fast)) {
        const auto inside =
            hn::And(hn::Ge(t, hn::Set(d, q.t_min)), hn::Le(t, hn::Set(d, q.t_best)));
        hit = hn::And(hit, hn::And(has_area, inside));
    } else {
        const auto reach = hn::Max(
            hn::Max(hn::Max(hn::Abs(x[0]), hn::Abs(y[0])), hn::Max(hn::Abs(x[1]), hn::Abs(y[1]))),
            hn::Max(hn::Abs(x[2]), hn::Abs(y[2])));
        const auto distance = hn::Add(reach, hn::Max(hn::Abs(z_low), hn::Abs(z_high)));
        const auto steep = hn::Mul(hn::Mul(reach, hn::Abs(rdet)), distance);
        const auto spread = hn::Mul(steep, hn::Sub(z_high, z_low));
        sure = hn::And(hn::And(hn::Lt(hn::Mul(spread, hn::Set(d, 8.0f)), hn::Abs(t)), has_area),
                       hn::And(hn::Ne(low, zero), hn::Ne(high, zero)));
        // Where even the largest error, with the roundings of t itself, leaves t outside the
        // interval, nothing needs to be sure.
        const auto error =
            hn::MulAdd(spread, hn::Set(d, 0x1.bp-17f), hn::Mul(hn::Abs(t), hn::Set(d, 0x1p-20f)));
        const auto outside = hn::Or(hn::Lt(hn::Add(t, error), hn::Set(d, q.t_min)),
                                    hn::Gt(hn::Sub(t, error), hn::Set(d, q.t_best)));
        hit = hn::AndNot(hn::And(outside, hn::Lt(steep, hn::Set(d, 0x1p14f))), hit);
    }
    if (hn::AllFalse(d, hit)) return false;

    alignas(64) float ts[N], us[N], vs[N];
    hn::Store(t, d, ts);
    hn::Store(wb, d, us);
    hn::Store(wc, d, vs);
    uint8_t hit_bits[8] = {}, sure_bits[8] = {};
    hn::StoreMaskBits(d, hit, hit_bits);
    hn::StoreMaskBits(d, sure, sure_bits);
    uint32_t open = hit_bits[0], exact = sure_bits[0];
    if (HWY_UNLIKELY(q.mode == Mode::double_precision)) exact = 0;
    for (; open; open &= open - 1) {
        const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(open));
        // Weights of an area that overflowed are zero or NaN.
        const bool weighted = us[i] + vs[i] > 0;
        if (HWY_UNLIKELY(!(exact >> i & 1) || !weighted) &&
            !source.refine(i, q, ts[i], us[i], vs[i]))
            continue;
        if (!(ts[i] >= q.t_min && ts[i] <= q.t_best)) continue;
        if constexpr (Q == Query::any) return true;
        q.record(ts[i], us[i], vs[i], ids, source.id(i));
    }
    return false;
}

/// N lanes of a block, for test_corners.
template <bool Framed, int W, class D>
struct BlockLanes {
    const TriangleBlock<W>& block;
    size_t lane;
    const InstanceFrame* frame;
    const ShearedCorners<D>& corners;

    HWY_INLINE hn::Vec<D> z(int k) const { return corners.z[k]; }
    template <class M>
    HWY_INLINE M used(M mask) const {
        return mask;
    }
    HWY_INLINE bool refine(uint32_t i, const RayQuery& q, float& t, float& u, float& v) const {
        return refine_lane<Framed>(block, lane + i, q, frame, t, u, v);
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
        const BlockLanes<Framed, W, Lanes<W>> source{block, lane, ray.frame, c};
        if (test_corners<Q>(d, c.x, c.y, source, q, ids)) return true;
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

template <Query Q, class C>
HWY_INLINE bool enter_object(const ObjectSet& set, uint32_t i, const LocalRay& ray, RayQuery& q,
                             C& counters) {
    const ObjectSet::Entry& entry = set.entry(i);
    float t_near, t_far;
    if (!meets_box(entry.bounds, ray, q, t_near, t_far)) return false;
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
