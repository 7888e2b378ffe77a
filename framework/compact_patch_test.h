// The leaf test of CompactPatches; included once per target, after simd.h.
#if defined(CROFTON_FRAMEWORK_COMPACT_PATCH_TEST_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_COMPACT_PATCH_TEST_H_
#undef CROFTON_FRAMEWORK_COMPACT_PATCH_TEST_H_
#else
#define CROFTON_FRAMEWORK_COMPACT_PATCH_TEST_H_
#endif

#include "framework/compact_patches.h"
#include "framework/patch_test.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// A compact patch with its corners fetched, for test_patch.
struct FetchedPatch {
    alignas(64) float v[3][CompactPatch::width];
    alignas(8) uint8_t corner[3][CompactPatch::width];
    uint32_t count;
    const CompactPatch& source;

    HWY_INLINE FetchedPatch(const CompactPatch& patch, const float* vertices)
        : count(patch.count()), source(patch) {
        fetch(vertices + size_t{3} * patch.base);
        const hn::FixedTag<int16_t, 8> d;
        const hn::FixedTag<uint8_t, 8> d8;
        const auto packed = hn::LoadU(d, reinterpret_cast<const int16_t*>(patch.corner));
        const auto index = hn::Set(d, 7);
        hn::Store(hn::DemoteTo(d8, hn::And(packed, index)), d8, corner[0]);
        hn::Store(hn::DemoteTo(d8, hn::And(hn::ShiftRight<4>(packed), index)), d8, corner[1]);
        hn::Store(hn::DemoteTo(d8, hn::And(hn::ShiftRight<8>(packed), index)), d8, corner[2]);
    }
    uint32_t id(uint32_t triangle, const uint32_t* list) const { return source.id(triangle, list); }
    Vec3f vertex(uint32_t triangle, int k) const {
        const uint8_t i = corner[k][triangle];
        return {v[0][i], v[1][i], v[2][i]};
    }

  private:
    /// x, y, z and something of one vertex; in eight lanes, of the fourth from there as well.
    template <class D>
    static HWY_INLINE hn::Vec<D> load(D d, const float* base, const uint8_t* offset) {
        const hn::FixedTag<float, 4> d4;
        const auto low = hn::LoadU(d4, base + size_t{3} * offset[0]);
        if constexpr (hn::MaxLanes(D()) == 4)
            return low;
        else
            return hn::Combine(d, hn::LoadU(d4, base + size_t{3} * offset[4]), low);
    }
    /// A load of four floats for each corner, the fourth unused, and a transpose.
    HWY_INLINE void fetch(const float* base) {
        const Lanes<8> d;
        constexpr size_t N = hn::MaxLanes(Lanes<8>());
        const hn::Repartition<double, Lanes<8>> d2;
        for (size_t first = 0; first < CompactPatch::width; first += N) {
            const uint8_t* const offset = source.offset + first;
            const auto p = load(d, base, offset), q = load(d, base, offset + 1),
                       r = load(d, base, offset + 2), s = load(d, base, offset + 3);
            const auto pq_low = hn::InterleaveLower(d, p, q), rs_low = hn::InterleaveLower(d, r, s);
            const auto pq_high = hn::InterleaveUpper(d, p, q),
                       rs_high = hn::InterleaveUpper(d, r, s);
            const auto x =
                hn::InterleaveLower(d2, hn::BitCast(d2, pq_low), hn::BitCast(d2, rs_low));
            const auto y =
                hn::InterleaveUpper(d2, hn::BitCast(d2, pq_low), hn::BitCast(d2, rs_low));
            const auto z =
                hn::InterleaveLower(d2, hn::BitCast(d2, pq_high), hn::BitCast(d2, rs_high));
            hn::Store(hn::BitCast(d, x), d, v[0] + first);
            hn::Store(hn::BitCast(d, y), d, v[1] + first);
            hn::Store(hn::BitCast(d, z), d, v[2] + first);
        }
    }
};

HWY_INLINE FetchedPatch patch_at(const CompactPatches& leaves, uint32_t i) {
    return FetchedPatch(leaves.patches()[i], leaves.vertices());
}

template <Query Q, class C>
HWY_INLINE bool test_leaf(const TriangleSet& set, const CompactPatches& leaves, uint32_t first,
                          uint32_t count, const LocalRay& ray, RayQuery& q, C& counters) {
    const auto at = [&](uint32_t i) HWY_ATTR { return patch_at(leaves, i); };
    return test_patches<Q>(set, at, leaves.ids(), first, count, ray, q, counters);
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
