#pragma once

#include "accelerators/bounding_volume.h"
#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "framework/aligned.h"
#include "framework/parts.h"
#include "framework/primitive.h"

namespace crofton {

struct BvhParameters : TreeParameters {
    BoundingVolume volume = BoundingVolume::box;

    template <class V>
    void fields(V& v) {
        v.choice("volume", volume, {"box", "sphere", "obb", "kdop"},
                 "what bounds a node: axis-aligned box, sphere, oriented box, 14 planes");
        TreeParameters::fields(v, 64);
    }
};

/// Both children of an inner node.
///
///   byte  0  x: lower of child 0, lower of child 1, upper of child 0, upper of child 1
///        16  y likewise      32  z likewise
///        48  links
struct BvhNode {
    float bounds[3][4];
    PairLinks links;
};
static_assert(sizeof(BvhNode) == 64);

/// Box around what a child holds.
Bounds3 child_box(const BvhNode& node, int side);
Bounds3 child_box(const SpherePair& node, int side);
Bounds3 child_box(const ObbPair& node, int side);
Bounds3 child_box(const KdopPair& node, int side);

/// Binary bounding volume hierarchy over any set. See build_tree and BoundingVolume.
template <class Set>
struct Bvh {
    static constexpr const char* name = "bvh";
    static constexpr bool reads_set = Leaves<Set>::keeps_set;
    static constexpr int max_depth = BinaryTree::max_depth;

    BoundingVolume volume = BoundingVolume::box;
    /// The root first, then depth first; all empty: no shapes. Those of one volume are filled.
    AlignedVector<BvhNode> nodes;
    AlignedVector<SpherePair> spheres;
    AlignedVector<ObbPair> obbs;
    AlignedVector<KdopPair> kdops;
    Leaves<Set> leaves;
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static Bvh build(const Set& set, const BvhParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(volume, nodes, spheres, obbs, kdops, leaves, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;

    /// @name Opening, see framework/parts.h: `index` and `count` as in a node
    /// @{
    static bool is_leaf(TraversalStart at) { return at.count > 0; }
    template <class F>
    void visit_children(TraversalStart at, F&& f) const {
        if (box.empty()) return;
        const auto visit_pair = [&](const auto& pair) {
            for (int side = 0; side < 2; ++side) {
                const Bounds3 b = intersection(child_box(pair, side), box);
                if (!b.empty())
                    f(b, TraversalStart{pair.links.index[side], pair.links.count[side]});
            }
        };
        if (volume == BoundingVolume::box) visit_pair(nodes[at.index]);
        if (volume == BoundingVolume::sphere) visit_pair(spheres[at.index]);
        if (volume == BoundingVolume::obb) visit_pair(obbs[at.index]);
        if (volume == BoundingVolume::kdop) visit_pair(kdops[at.index]);
    }
    double cost_of(const Set& set, TraversalStart at) const {
        return is_leaf(at) ? leaf_cost(set, leaves, at.index, at.count) : pair_cost(volume);
    }
    std::span<const uint32_t> references(TraversalStart leaf) const {
        return {leaves.references() + leaf.index, leaf.count};
    }
    /// @}
};

}  // namespace crofton
