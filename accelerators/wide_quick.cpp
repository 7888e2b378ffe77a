#include "accelerators/wide_quick.h"

#include <algorithm>

#include "accelerators/morton.h"

namespace crofton {
namespace {
/// Boxes of the triangles' corners; none of those that have corners at infinity or nowhere.
MortonKeys keys_of(const TriangleSet& set) {
    return MortonKeys(set.size(), [&set](size_t i, Box4& box) {
        const Box4::D d;
        const TriangleSet::Indices& t = set.triangles()[i];
        const auto at = [&](size_t k) {
            return hn::LoadU(d, set.coordinates() + size_t{3} * t[k]);
        };
        const auto a = at(0), b = at(1), c = at(2);
        box = Box4(hn::Min(hn::Min(a, b), c), hn::Max(hn::Max(a, b), c));
        const auto zero = hn::Zero(d);
        const auto nothing = hn::Add(hn::Add(hn::Mul(a, zero), hn::Mul(b, zero)), hn::Mul(c, zero));
        return hn::AllTrue(d, hn::Or(hn::Eq(nothing, zero), hn::Not(hn::FirstN(d, 3))));
    });
}

}  // namespace

QuickTree build_quick_tree(const TriangleSet& set, const PatchCorners& corners,
                           const TreeCosts& costs, int max_leaf_size) {
    const MortonKeys keys = keys_of(set);
    return build_quick_tree(keys.sorted(), corners, costs, max_leaf_size);
}

}  // namespace crofton
