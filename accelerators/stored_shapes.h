// Tests of the shapes that a structure's references mean; included once per target, after
// framework/simd.h.
#if defined(CROFTON_ACCELERATORS_STORED_SHAPES_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_STORED_SHAPES_H_
#undef CROFTON_ACCELERATORS_STORED_SHAPES_H_
#else
#define CROFTON_ACCELERATORS_STORED_SHAPES_H_
#endif

#include <limits>

#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// What fills spare lanes: no test accepts NaN.
inline constexpr TriangleRecord no_triangle = [] {
    TriangleRecord r{};
    for (auto& corner : r.v)
        for (auto& x : corner) x[0] = std::numeric_limits<float>::quiet_NaN();
    r.id[0] = no_id;
    return r;
}();

/// Up to four triangles into a block: per corner four loads and a transpose, which brings the
/// indices along with the last. A triangle in two lanes would be recorded twice where it is hit.
HWY_INLINE void load_records(const TriangleRecord* records, const uint32_t* references,
                             uint32_t count, TriangleBlock<4>& block) {
    const hn::FixedTag<float, 4> d;
    const hn::FixedTag<double, 2> d2;
    const hn::FixedTag<uint32_t, 4> du;
    const TriangleRecord* r[4];
    for (uint32_t i = 0; i < 4; ++i) r[i] = i < count ? records + references[i] : &no_triangle;
    for (int k = 0; k < 3; ++k) {
        const auto a = hn::LoadU(d, r[0]->v[k][0]), b = hn::LoadU(d, r[1]->v[k][0]);
        const auto e = hn::LoadU(d, r[2]->v[k][0]), f = hn::LoadU(d, r[3]->v[k][0]);
        const auto ab_low = hn::BitCast(d2, hn::InterleaveLower(d, a, b));
        const auto ef_low = hn::BitCast(d2, hn::InterleaveLower(d, e, f));
        const auto ab_high = hn::BitCast(d2, hn::InterleaveUpper(d, a, b));
        const auto ef_high = hn::BitCast(d2, hn::InterleaveUpper(d, e, f));
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d2, ab_low, ef_low)), d, block.v[k][0]);
        hn::Store(hn::BitCast(d, hn::InterleaveUpper(d2, ab_low, ef_low)), d, block.v[k][1]);
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d2, ab_high, ef_high)), d, block.v[k][2]);
        if (k == 2)
            hn::Store(hn::BitCast(du, hn::InterleaveUpper(d2, ab_high, ef_high)), du, block.id);
    }
}

/// Tests what references mean. @return whether an `any` query is answered
template <Query Q, class Set, class C>
HWY_INLINE bool test_stored(const ShapeStore<Set>& store, const Set& set,
                            const uint32_t* references, uint32_t count, const LocalRay& ray,
                            RayQuery& q, C& counters) {
    if constexpr (ShapeStore<Set>::keeps_set) {
        return test_references<Q>(set, references, count, ray, q, counters);
    } else {
        counters.test(count);
        // To gather one or two, as most cells of a tree have, takes longer than to test them.
        if (count <= 2) {
            for (uint32_t i = 0; i < count; ++i)
                if (test_blocks<Q>(set, store.records() + references[i], 1, ray, q)) return true;
            return false;
        }
        TriangleBlock<4> block;
        for (uint32_t i = 0; i < count; i += 4) {
            load_records(store.records(), references + i, count - i, block);
            if (test_blocks<Q>(set, &block, 1, ray, q)) return true;
        }
        return false;
    }
}

/// Calls follow(test) for a traversal that hands every list of references that it meets to
/// test(references, their number) -> bool: stop, the query is answered.
/// @param mailbox  each shape is tested once, as a rule
template <Query Q, class Set, class C, class Follow>
HWY_INLINE bool test_lists(bool mailbox, const ShapeStore<Set>& store, const Set& set,
                           const LocalRay& ray, RayQuery& q, C& counters, const Follow& follow) {
    const auto with = [&](auto box) HWY_ATTR {
        return follow([&](const uint32_t* references, uint32_t count) HWY_ATTR {
            return box.test_fresh(references, count,
                                  [&](const uint32_t* fresh, uint32_t n) HWY_ATTR {
                                      return test_stored<Q>(store, set, fresh, n, ray, q, counters);
                                  });
        });
    };
    return HWY_UNLIKELY(mailbox) ? with(Mailbox()) : with(NoMailbox());
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
