// Leaf tests of packets; included once per target, after patch_test.h.
#if defined(CROFTON_ACCELERATORS_PACKET_LEAVES_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#undef CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#else
#define CROFTON_ACCELERATORS_PACKET_LEAVES_H_
#endif

#include "accelerators/packet_boxes.h"
#include "framework/compact_patch_test.h"
#include "framework/patch_test.h"
#include "framework/ray_packet.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// What a packet does at a leaf.
///
/// Of triangles, few rays each find a few: so every triangle is tested against all rays at once, by
/// the float test of test_corners, and what passes that is solved in double, also side by side.
/// These are the operations of single calls in the same order, so their bits. Where they do not
/// tell (a ray passes an edge at zero, or outside in double), it tests the patch alone.
template <Query Q, class Set, class Leaves>
class PacketLeaves {
  public:
    /// @param boxes  of the rays that are traced
    PacketLeaves(const Leaves& leaves, const Set& set, const PacketBoxes& boxes, RayPacket& packet,
                 LocalPacket& space)
        : leaves_(leaves), set_(set), boxes_(boxes), packet_(packet), space_(space) {
        if constexpr (std::is_same_v<Set, TriangleSet>) packet.hits_are_of(set.ids());
    }

    /// @param rays  that meet the leaf's box
    /// @return      whether one of them goes less far now
    HWY_INLINE bool test(uint32_t first, uint32_t count, uint32_t rays) {
        nearer_ = false;
        if constexpr (std::is_same_v<Set, ObjectSet>) {
            for (uint32_t i = first; i < first + count; ++i) {
                const ObjectSet::Entry& entry = set_.entry(leaves_.references()[i]);
                static_assert(offsetof(Bounds3, upper) == 3 * sizeof(float));
                // The box of one object alone is the leaf's.
                enter_object(entry,
                             count == 1 ? rays : rays & boxes_.meet(entry.bounds.lower.data(), 1));
            }
            return nearer_;
        }
        if constexpr (std::is_same_v<Set, TriangleSet>)
            if (hwy::PopCount(rays) >= least_together && packet_.mode == Mode::robust) {
                for (uint32_t i = first; i < first + count; ++i)
                    test_together(i, patch_at(leaves_, i), rays);
                return nearer_;
            }
        for (uint32_t left = rays; left; left &= left - 1) test_alone(lowest(left), first, count);
        return nearer_;
    }

    /// @param trace  (ray, query): traces ray r by itself, and returns whether it answered an `any`
    ///               query
    /// @return       whether the ray goes less far now
    template <class F>
    HWY_INLINE bool alone(uint32_t r, const F& trace) {
        const bool nearer = packet_.alone(r, space_, trace);
        nearer_ |= nearer;
        return nearer;
    }

  private:
    static constexpr uint32_t least_together = 4;
    static constexpr RayLanes d{};
    static constexpr size_t N = hn::MaxLanes(d);
    using V = hn::Vec<decltype(d)>;

    void test_alone(uint32_t r, uint32_t first, uint32_t count) {
        alone(r, [&](const LocalRay& ray, RayQuery& query) HWY_ATTR {
            NoCounters none;
            return test_leaf<Q>(set_, leaves_, first, count, ray, query, none);
        });
    }

    /// Brings rays that meet an object's box into it.
    HWY_INLINE void enter_object(const ObjectSet::Entry& entry, uint32_t rays) {
        if (!rays) return;
        packet_.instance += entry.instance;
        nearer_ |= packet_.enter<Q>(*entry.primitive, space_, rays);
        packet_.instance -= entry.instance;
    }

    /// A patch's corners as N rays see them: sheared, the third in units of t.
    struct Corners {
        alignas(64) float x[TrianglePatch::width][N], y[TrianglePatch::width][N],
            z[TrianglePatch::width][N];
    };
    /// x, y and z of a patch's corners in the world.
    using Vertices = float[3][TrianglePatch::width];
    template <class Patch>
    HWY_NOINLINE void map(const Patch& patch, Vertices& world) const {
        const PatchTable::D d8;
        for (int a = 0; a < 3; ++a)
            for (size_t i = 0; i < TrianglePatch::width; i += hn::MaxLanes(d8))
                hn::StoreU(world_coordinate<true>(d8, patch.v, i, a, space_.frame), d8,
                           world[a] + i);
    }
    HWY_INLINE void shear(const Vertices& v, uint32_t count, size_t r, Corners& corners) const {
        const auto& [kx, ky, kz] = packet_.axis;
        const auto ox = hn::Load(d, packet_.origin[kx] + r),
                   oy = hn::Load(d, packet_.origin[ky] + r),
                   oz = hn::Load(d, packet_.origin[kz] + r);
        const auto sx = hn::Load(d, packet_.shear[0] + r), sy = hn::Load(d, packet_.shear[1] + r),
                   sz = hn::Load(d, packet_.shear[2] + r);
        for (uint32_t i = 0; i < count; ++i) {
            const auto x = hn::Sub(hn::Set(d, v[kx][i]), ox), y = hn::Sub(hn::Set(d, v[ky][i]), oy),
                       z = hn::Sub(hn::Set(d, v[kz][i]), oz);
            hn::Store(hn::Sub(x, hn::Mul(sx, z)), d, corners.x[i]);
            hn::Store(hn::Sub(y, hn::Mul(sy, z)), d, corners.y[i]);
            hn::Store(hn::Mul(z, sz), d, corners.z[i]);
        }
    }

    template <class Patch>
    HWY_INLINE void test_together(uint32_t index, const Patch& patch, uint32_t rays) {
        uint32_t alone = 0;  // rays that have to test this patch by themselves
        Vertices mapped;
        if (HWY_UNLIKELY(space_.frame != nullptr)) map(patch, mapped);
        const Vertices& v = space_.frame ? mapped : patch.v;
        const uint32_t count = std::min(3 * patch.count, TrianglePatch::width);
        for (size_t r = 0; r < RayPacket::most; r += N) {
            const uint32_t active = rays >> r & ((1u << N) - 1);
            if (!active) continue;
            Corners corners;
            shear(v, count, r, corners);
            for (uint32_t i = 0; i < patch.count; ++i)
                alone |= test_triangle(patch, v, i, corners, r, active) << r;
        }
        for (uint32_t left = alone; left; left &= left - 1) test_alone(lowest(left), index, 1);
    }

    /// Tests a triangle against rays r to r + N - 1, of which those in `active`.
    /// @return  bit k: ray r + k may hit it, but has to find out alone
    template <class Patch>
    HWY_INLINE uint32_t test_triangle(const Patch& patch, const Vertices& v, uint32_t triangle,
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
        const uint32_t in = active & mask_bits(d, hn::Or(hn::Ge(low, zero), hn::Le(high, zero)));
        if (!in) return 0;
        const auto z0 = hn::Load(d, corners.z[a]), z1 = hn::Load(d, corners.z[b]),
                   z2 = hn::Load(d, corners.z[c]);
        const auto near = hn::Min(hn::Min(z0, z1), z2), far = hn::Max(hn::Max(z0, z1), z2);
        const uint32_t open =
            in & mask_bits(d, hn::And(hn::Le(near, hn::Load(d, packet_.t_cull + r)),
                                      hn::Ge(far, hn::Load(d, packet_.t_low + r))));
        if (!open) return 0;
        const uint32_t plain = open & mask_bits(d, hn::And(hn::Ne(low, zero), hn::Ne(high, zero)));
        uint32_t left = plain;
        if constexpr (Q == Query::any) left &= ~answer_surely(near, far, r, plain);
        return (open & ~plain) | solve(patch, v, triangle, r, left);
    }

    /// Of rays that pass through the inside of a triangle, answers those that hit it for certain.
    HWY_INLINE uint32_t answer_surely(V near, V far, size_t r, uint32_t rays) {
        const uint32_t sure =
            rays & mask_bits(d, surely_within(d, near, far, hn::Load(d, packet_.t_min + r),
                                              hn::Load(d, packet_.t_best + r)));
        answer(d, r, sure);
        return sure;
    }
    /// Solves for t, u and v where rays pass through the inside of a triangle, and keeps the nearer
    /// hits. @return  as test_triangle
    template <class Patch>
    HWY_INLINE uint32_t solve(const Patch& patch, const Vertices& v, uint32_t triangle, size_t r,
                              uint32_t rays) {
        const hn::CappedTag<double, std::min<size_t>(N, 8)> dd;
        constexpr size_t n = hn::MaxLanes(decltype(dd)());
        uint32_t alone = 0;
        for (size_t part = 0; part < N; part += n) {
            const uint32_t some = rays >> part & ((1u << n) - 1);
            if (some) alone |= solve_part(dd, patch, v, triangle, r + part, some) << part;
        }
        return alone;
    }
    template <class DD, class Patch>
    HWY_INLINE uint32_t solve_part(DD dd, const Patch& patch, const Vertices& v, uint32_t triangle,
                                   size_t r, uint32_t rays) {
        using VD = hn::Vec<DD>;
        const hn::Rebind<float, DD> df;
        VD corner[3][3], o[3], dir[3];
        for (int a = 0; a < 3; ++a) {
            const int axis = packet_.axis[a];
            for (int k = 0; k < 3; ++k)
                corner[k][a] = hn::Set(dd, double(v[axis][patch.corner[k][triangle]]));
            o[a] = hn::PromoteTo(dd, hn::Load(df, packet_.origin[axis] + r));
            dir[a] = hn::PromoteTo(dd, hn::Load(df, packet_.direction[axis] + r));
        }
        const auto found = solve_lanes(dd, corner, o, dir, false);
        const uint32_t known = rays & mask_bits(dd, found.known);
        const auto t_best = hn::Load(df, packet_.t_best + r);
        const uint32_t within =
            known & mask_bits(df, hn::And(hn::Ge(found.t, hn::Load(df, packet_.t_min + r)),
                                          hn::Le(found.t, t_best)));
        uint32_t alone = rays & ~known;
        if constexpr (Q == Query::any) {
            answer(df, r, within);
        } else {
            const uint32_t id = patch.id(triangle, leaves_.ids());
            uint32_t nearer = within & mask_bits(df, hn::Lt(found.t, t_best));
            for (uint32_t left = within & ~nearer; left; left &= left - 1) {
                const uint32_t bit = left & -left, other = lowest(left) + uint32_t(r);
                if (!(packet_.hit_in_row >> other & 1))
                    alone |= bit;
                else if (comes_first(id, other))
                    nearer |= bit;
            }
            record(df, r, nearer, found.t, found.u, found.v, id);
        }
        return alone;
    }
    /// Whether of two shapes hit at one t the first is the closest, the other being what ray r has
    /// hit.
    HWY_NOINLINE bool comes_first(uint32_t shape, uint32_t r) const {
        const RayPacket::Owner& other = packet_.owner_of(r);
        Hit a, b;
        set_.ids().resolve(shape, packet_.instance, a);
        other.ids->resolve(packet_.shape[r], other.instance, b);
        return id_less(a, b);
    }

    /// Answers an `any` query of rays r + k, bit k of `rays`.
    template <class D>
    HWY_INLINE void answer(D d, size_t r, uint32_t rays) {
        if (!rays) return;
        nearer_ = true;
        packet_.found |= rays << r;
        hn::BlendedStore(hn::Set(d, -std::numeric_limits<float>::infinity()), bits_mask(d, rays), d,
                         packet_.t_cull + r);
    }
    /// Records what is nearer than the hits of rays r + k, bit k of `rays`.
    template <class D, class T>
    HWY_INLINE void record(D d, size_t r, uint32_t rays, T t, T u, T v, uint32_t shape) {
        if (!rays) return;
        nearer_ = true;
        packet_.hit_in_row |= rays << r;
        packet_.fresh |= rays << r;
        const auto mask = bits_mask(d, rays);
        const hn::RebindToUnsigned<D> d32;
        hn::BlendedStore(t, mask, d, packet_.t_best + r);
        hn::BlendedStore(hn::Add(t, hn::Mul(hn::Abs(t), hn::Set(d, cull_slack))), mask, d,
                         packet_.t_cull + r);
        hn::BlendedStore(u, mask, d, packet_.u + r);
        hn::BlendedStore(v, mask, d, packet_.v + r);
        hn::BlendedStore(hn::Set(d32, shape), hn::RebindMask(d32, mask), d32, packet_.shape + r);
    }

    const Leaves& leaves_;
    const Set& set_;
    const PacketBoxes& boxes_;
    RayPacket& packet_;
    LocalPacket& space_;
    bool nearer_ = false;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
