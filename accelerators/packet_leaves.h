// Leaf tests of packets; included once per target, after patch_test.h.
#if defined(CROFTON_ACCELERATORS_PACKET_LEAVES_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#undef CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#else
#define CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#endif

#include "framework/compact_patch_test.h"
#include "framework/patch_test.h"
#include "framework/ray_packet.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Some of a packet's rays, one a lane.
using RayLanes = hn::CappedTag<float, RayPacket::most>;

HWY_INLINE uint32_t bits(hn::Mask<RayLanes> mask) {
    uint8_t b[8] = {};
    hn::StoreMaskBits(RayLanes(), mask, b);
    return uint32_t(b[0]) | uint32_t(b[1]) << 8;
}

/// A packet's rays side by side.
class PacketRays {
  public:
    explicit HWY_INLINE PacketRays(const RayPacket& packet) {
        for (uint32_t r = 0; r < RayPacket::most; ++r) {
            const bool used = r < packet.count;
            const LocalRay& ray = packet.local[used ? r : 0];
            for (int a = 0; a < 3; ++a) {
                near_origin_[a][r] = ray.near_origin[a];
                far_origin_[a][r] = ray.far_origin[a];
                rcp_[a][r] = ray.rcp[a];
                far_rcp_[a][r] = ray.far_rcp[a];
            }
            t_low_[r] = used ? packet.query[r].t_low : INFINITY;
            t_cull_[r] = used ? packet.query[r].t_cull : -INFINITY;
        }
    }
    /// Ray r goes no further than this; -inf: it looks for nothing any more.
    void set_cull(uint32_t r, float t) { t_cull_[r] = t; }
    const float* t_low() const { return t_low_; }
    const float* t_cull() const { return t_cull_; }

    float least_t_low() const { return reduce(t_low_, false); }
    float most_t_cull() const { return reduce(t_cull_, true); }

    /// @param planes  of the box: lower x, y, z, upper x, y, z, every `stride`-th float
    /// @param down    whether directions are negative, by axis
    /// @return bit r: ray r may meet the box, see LocalRay
    HWY_INLINE uint32_t meet(const float* planes, size_t stride, const bool (&down)[3]) const {
        uint32_t hits = 0;
        for (size_t r = 0; r < RayPacket::most; r += N) {
            auto enter = hn::Load(d, t_low_ + r), leave = hn::Load(d, t_cull_ + r);
            for (size_t a = 0; a < 3; ++a) {
                const auto in = hn::Set(d, planes[stride * (down[a] ? a + 3 : a)]);
                const auto out = hn::Set(d, planes[stride * (down[a] ? a : a + 3)]);
                enter = hn::Max(enter, hn::Mul(hn::Sub(in, hn::Load(d, near_origin_[a] + r)),
                                               hn::Load(d, rcp_[a] + r)));
                leave = hn::Min(leave, hn::Mul(hn::Sub(out, hn::Load(d, far_origin_[a] + r)),
                                               hn::Load(d, far_rcp_[a] + r)));
            }
            hits |= bits(hn::Le(enter, leave)) << r;
        }
        return hits;
    }

    /// Over all rays, of near_origin and so on.
    struct Ends {
        float low[3], high[3];
    };
    Ends near_origin() const { return ends(near_origin_); }
    Ends far_origin() const { return ends(far_origin_); }
    Ends rcp() const { return ends(rcp_); }
    Ends far_rcp() const { return ends(far_rcp_); }

  private:
    static constexpr RayLanes d{};
    static constexpr size_t N = hn::MaxLanes(d);
    using Row = float[RayPacket::most];

    static HWY_INLINE float reduce(const Row& row, bool largest) {
        auto all = hn::Load(d, row);
        for (size_t r = N; r < RayPacket::most; r += N) {
            const auto next = hn::Load(d, row + r);
            all = largest ? hn::Max(all, next) : hn::Min(all, next);
        }
        return hn::GetLane(largest ? hn::MaxOfLanes(d, all) : hn::MinOfLanes(d, all));
    }
    static HWY_INLINE Ends ends(const Row (&rows)[3]) {
        Ends e;
        for (int a = 0; a < 3; ++a) {
            e.low[a] = reduce(rows[a], false);
            e.high[a] = reduce(rows[a], true);
        }
        return e;
    }

    alignas(64) Row near_origin_[3], far_origin_[3], rcp_[3], far_rcp_[3];
    alignas(64) Row t_low_, t_cull_;
};

/// What a packet does at a leaf.
///
/// Of triangles, few rays each find a few: so every triangle is tested against all rays at once,
/// by the float test of test_corners. A ray that passes does not look for t yet. The triangle
/// is its *candidate*: the float t and its error are enough to cull by, and most often to tell what
/// is nearer. `finish` then solves the candidates of all rays in double together. Where depths do
/// not tell, or a ray passes an edge at zero or starts among a triangle's depths, it tests the
/// patches in question alone.
///
/// Both give the bits of single calls: the float test has the same operations in the same order,
/// what is nearest is decided by t alone or by what is strictly in front, and candidates are solved
/// by the function that single rays use. A candidate that is none on a second look (see
/// DoubleHits::known) may have hidden others, and the ray is traced again by itself.
template <Query Q, class Set, class Leaves>
class PacketLeaves {
  public:
    PacketLeaves(const Leaves& leaves, const Set& set, RayPacket& packet, PacketRays& rays)
        : leaves_(leaves), set_(set), packet_(packet), rays_(rays) {}

    /// @param rays  that meet the leaf's box
    /// @return      whether one of them goes less far now
    HWY_INLINE bool test(uint32_t first, uint32_t count, uint32_t rays) {
        nearer_ = false;
        if constexpr (triangles)
            if (hwy::PopCount(rays) >= least_together && go_together()) {
                for (uint32_t i = first; i < first + count; ++i)
                    test_patch_together(i, patch_at(leaves_, i), rays);
                return nearer_;
            }
        for (uint32_t left = rays; left; left &= left - 1) test_alone(lowest(left), first, count);
        return nearer_;
    }

    /// @param again  (r): traces ray r alone, from the root, with what it found so far
    template <class F>
    HWY_INLINE void finish(const F& again) {
        if constexpr (triangles) {
            if (!candidates_ && !again_) return;
            const hn::CappedTag<double, 8> dd;
            for (uint32_t r = 0; r < RayPacket::most; r += uint32_t(hn::MaxLanes(dd))) solve(dd, r);
            for (; again_; again_ &= again_ - 1) again(lowest(again_));
        }
    }

  private:
    static constexpr bool triangles = std::is_same_v<Set, TriangleSet>;
    static constexpr uint32_t least_together = 8;
    static constexpr RayLanes d{};
    static constexpr size_t N = hn::MaxLanes(d);
    using V = hn::Vec<decltype(d)>;
    using Row = float[RayPacket::most];

    static HWY_INLINE uint32_t lowest(uint32_t bits) {
        return uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(bits));
    }

    /// Whether rays have the mode and one main axis; then, when first asked, puts them side by
    /// side.
    bool go_together() {
        if (looked_) return together_;
        looked_ = true;
        const RayQuery& first = packet_.query[0];
        together_ = first.mode == Mode::robust;
        for (uint32_t r = 0; r < packet_.count; ++r)
            together_ = together_ && packet_.query[r].kz == first.kz;
        if (!together_) return false;
        const int axis[3] = {first.kx, first.ky, first.kz};
        std::copy_n(axis, 3, axis_);
        for (uint32_t r = 0; r < RayPacket::most; ++r) {
            const RayQuery& q = packet_.query[r < packet_.count ? r : 0];
            for (int a = 0; a < 3; ++a) {
                origin_[a][r] = q.origin[axis[a]];
                direction_[a][r] = q.direction[axis[a]];
            }
            shear_[0][r] = q.shear_x, shear_[1][r] = q.shear_y, shear_[2][r] = q.shear_z;
        }
        for (auto& corner : corner_)
            for (Row& row : corner) std::fill_n(row, RayPacket::most, 0.0f);
        return true;
    }

    void test_alone(uint32_t r, uint32_t first, uint32_t count) {
        RayQuery& q = packet_.query[r];
        const float before = q.t_cull;
        NoCounters none;
        const bool found = test_leaf<Q>(set_, leaves_, first, count, packet_.local[r], q, none);
        if (Q == Query::any && found) packet_.found[r] = true;
        if (found || q.t_cull != before) {
            rays_.set_cull(r, found ? -INFINITY : q.t_cull);
            nearer_ = true;
        }
    }

    /// A patch's corners as N rays see them: sheared, the third in units of t.
    struct Corners {
        alignas(64) float x[TrianglePatch::width][N], y[TrianglePatch::width][N],
            z[TrianglePatch::width][N];
    };
    template <class Patch>
    HWY_INLINE void shear(const Patch& patch, size_t r, Corners& corners) const {
        const auto ox = hn::Load(d, origin_[0] + r), oy = hn::Load(d, origin_[1] + r),
                   oz = hn::Load(d, origin_[2] + r);
        const auto sx = hn::Load(d, shear_[0] + r), sy = hn::Load(d, shear_[1] + r),
                   sz = hn::Load(d, shear_[2] + r);
        const uint32_t count = std::min(3 * patch.count, TrianglePatch::width);
        for (uint32_t i = 0; i < count; ++i) {
            const auto x = hn::Sub(hn::Set(d, patch.v[axis_[0]][i]), ox),
                       y = hn::Sub(hn::Set(d, patch.v[axis_[1]][i]), oy),
                       z = hn::Sub(hn::Set(d, patch.v[axis_[2]][i]), oz);
            hn::Store(hn::Sub(x, hn::Mul(sx, z)), d, corners.x[i]);
            hn::Store(hn::Sub(y, hn::Mul(sy, z)), d, corners.y[i]);
            hn::Store(hn::Mul(z, sz), d, corners.z[i]);
        }
    }

    template <class Patch>
    HWY_INLINE void test_patch_together(uint32_t index, const Patch& patch, uint32_t rays) {
        uint32_t alone = 0;  // rays that have to test this patch by themselves
        for (size_t r = 0; r < RayPacket::most; r += N) {
            const uint32_t active = rays >> r & ((1u << N) - 1);
            if (!active) continue;
            Corners corners;
            shear(patch, r, corners);
            for (uint32_t i = 0; i < patch.count; ++i)
                alone |= test_triangle(index, patch, i, corners, r, active) << r;
        }
        for (uint32_t left = alone; left; left &= left - 1) {
            const uint32_t r = lowest(left);
            settle(r);
            test_alone(r, index, 1);
        }
    }

    /// Tests a triangle against rays r to r + N - 1, of which those in `active`.
    /// @return  bit k: ray r + k may hit it, but has to find out alone
    template <class Patch>
    HWY_INLINE uint32_t test_triangle(uint32_t index, const Patch& patch, uint32_t triangle,
                                      const Corners& corners, size_t r, uint32_t active) {
        const uint32_t a = patch.corner[0][triangle], b = patch.corner[1][triangle],
                       c = patch.corner[2][triangle];
        const auto edge = [&](uint32_t p, uint32_t q) HWY_ATTR {
            return hn::Sub(hn::Mul(hn::Load(d, corners.x[p]), hn::Load(d, corners.y[q])),
                           hn::Mul(hn::Load(d, corners.y[p]), hn::Load(d, corners.x[q])));
        };
        const auto e0 = edge(c, b), e1 = edge(a, c), e2 = edge(b, a);
        const auto low = hn::Min(hn::Min(e0, e1), e2), high = hn::Max(hn::Max(e0, e1), e2);
        const auto zero = hn::Zero(d);
        const uint32_t in = active & bits(hn::Or(hn::Ge(low, zero), hn::Le(high, zero)));
        if (!in) return 0;
        const auto z0 = hn::Load(d, corners.z[a]), z1 = hn::Load(d, corners.z[b]),
                   z2 = hn::Load(d, corners.z[c]);
        const auto near = hn::Min(hn::Min(z0, z1), z2), far = hn::Max(hn::Max(z0, z1), z2);
        const uint32_t open = in & bits(hn::And(hn::Le(near, hn::Load(d, rays_.t_cull() + r)),
                                                hn::Ge(far, hn::Load(d, rays_.t_low() + r))));
        if (!open) return 0;
        const uint32_t plain = open & bits(hn::And(hn::Ne(low, zero), hn::Ne(high, zero)));
        uint32_t alone = open & ~plain;
        if (!plain) return alone;
        const auto size = [&](const float(&v)[TrianglePatch::width][N]) HWY_ATTR {
            return hn::Max(hn::Max(hn::Abs(hn::Load(d, v[a])), hn::Abs(hn::Load(d, v[b]))),
                           hn::Abs(hn::Load(d, v[c])));
        };
        const auto det = hn::Add(hn::Add(e0, e1), e2);
        const auto per_det = hn::Div(hn::Set(d, 1.0f), det);
        const auto t =
            hn::Add(hn::Add(hn::Mul(hn::Mul(e0, per_det), z0), hn::Mul(hn::Mul(e1, per_det), z1)),
                    hn::Mul(hn::Mul(e2, per_det), z2));
        const auto error =
            error_of_t(hn::Max(size(corners.x), size(corners.y)), hn::Abs(det), near, far);
        alignas(64) float first[N], last[N];
        hn::Store(hn::Max(near, hn::Sub(t, error)), d, first);
        hn::Store(hn::Min(far, hn::Add(t, error)), d, last);
        for (uint32_t left = plain; left; left &= left - 1) {
            const uint32_t k = lowest(left);
            if (!propose(uint32_t(r) + k, index, patch, triangle, first[k], last[k]))
                alone |= 1u << k;
        }
        return alone;
    }

    /// How far off the float t may be: as solve_lanes has it, with u = 2^-24. Where that is no
    /// small part of the triangle, or products under- or overflow, all of it.
    static HWY_INLINE V error_of_t(V reach, V det, V near, V far) {
        const auto depth = hn::Max(hn::Abs(near), hn::Abs(far));  // |direction[kz]| < 2
        const auto steep = hn::Mul(reach, hn::Div(hn::Add(reach, hn::Add(depth, depth)), det));
        const auto spread = hn::Sub(far, near);
        const auto error = hn::Add(hn::Mul(hn::Mul(steep, hn::Set(d, 0x1p-16f)), spread),
                                   hn::Mul(depth, hn::Set(d, 0x1p-20f)));
        const auto valid =
            hn::And(hn::Lt(steep, hn::Set(d, 0x1p12f)),
                    hn::And(hn::Gt(det, hn::Set(d, 0x1p-100f)), hn::Lt(det, hn::Set(d, 0x1p120f))));
        return hn::IfThenElse(valid, error, hn::Set(d, std::numeric_limits<float>::infinity()));
    }

    /// Makes a triangle the candidate of a ray if it is met, from near to far, right in front of
    /// what the ray has; of an `any` query, if it is met within the interval.
    template <class Patch>
    HWY_INLINE bool propose(uint32_t r, uint32_t index, const Patch& patch, uint32_t triangle,
                            float near, float far) {
        const RayQuery& q = packet_.query[r];
        const bool has = candidates_ >> r & 1;
        if (Q == Query::any && has) return true;
        const float reach = far + std::abs(far) * cull_slack;
        if (!(near > q.t_min + std::abs(q.t_min) * cull_slack &&
              reach < (has ? near_[r] : q.t_best)))
            return false;
        candidates_ |= 1u << r;
        near_[r] = near;
        patch_[r] = index;
        id_[r] = patch.id(triangle, leaves_.ids());
        for (int k = 0; k < 3; ++k)
            for (int a = 0; a < 3; ++a)
                corner_[k][a][r] = patch.v[axis_[a]][patch.corner[k][triangle]];
        rays_.set_cull(r, Q == Query::any ? -INFINITY : reach);
        nearer_ = true;
        return true;
    }
    /// Ray r has no candidate any more: it tested that patch alone.
    void settle(uint32_t r) {
        if (!(candidates_ >> r & 1)) return;
        candidates_ &= ~(1u << r);
        const RayQuery& q = packet_.query[r];
        const float before = q.t_best;
        test_alone(r, patch_[r], 1);
        if (Q == Query::any ? packet_.found[r] : q.t_best != before) return;
        again_ |= 1u << r;
        rays_.set_cull(r, q.t_cull);
        nearer_ = true;
    }

    /// Solves the candidates of as many rays as a vector has lanes.
    template <class DD>
    HWY_INLINE void solve(DD dd, uint32_t first) {
        constexpr size_t n = hn::MaxLanes(DD());
        const uint32_t lanes = candidates_ >> first & ((1u << n) - 1);
        if (!lanes) return;
        using VD = hn::Vec<DD>;
        const hn::Rebind<float, DD> df;
        const auto load = [&](const Row& row)
                              HWY_ATTR { return hn::PromoteTo(dd, hn::Load(df, row + first)); };
        VD corner[3][3], o[3], dir[3];
        for (int a = 0; a < 3; ++a) {
            for (int k = 0; k < 3; ++k) corner[k][a] = load(corner_[k][a]);
            o[a] = load(origin_[a]);
            dir[a] = load(direction_[a]);
        }
        const auto found = solve_lanes(dd, corner, o, dir, false);
        alignas(32) float t[n], u[n], v[n];
        hn::Store(found.t, df, t);
        hn::Store(found.u, df, u);
        hn::Store(found.v, df, v);
        const uint32_t known = mask_bits(dd, found.known);
        for (uint32_t left = lanes; left; left &= left - 1) {
            const uint32_t i = lowest(left), r = first + i;
            RayQuery& q = packet_.query[r];
            if (known >> i & 1 && t[i] >= q.t_min && t[i] <= q.t_best)
                Q == Query::any ? void(packet_.found[r] = true)
                                : q.record(t[i], u[i], v[i], set_.ids(), id_[r]);
            else
                settle(r);
        }
    }

    const Leaves& leaves_;
    const Set& set_;
    RayPacket& packet_;
    PacketRays& rays_;
    bool looked_ = false, together_ = false;
    bool nearer_ = false;
    uint32_t candidates_ = 0;  ///< bit r: ray r has one
    uint32_t again_ = 0;       ///< bit r: its candidate was none
    int axis_[3];              ///< kx, ky, kz
    alignas(64) Row origin_[3], direction_[3], shear_[3];
    Row near_, corner_[3][3];
    uint32_t patch_[RayPacket::most], id_[RayPacket::most];
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
