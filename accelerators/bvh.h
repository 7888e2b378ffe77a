#pragma once

#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

struct BvhParameters : TreeParameters {
    template <class V>
    void fields(V& v) {
        TreeParameters::fields(v, 64);
    }
};

/// Both children of an inner node.
///
///   byte  0  x: lower of child 0, lower of child 1, upper of child 0, upper of child 1
///        16  y likewise      32  z likewise
///        48  index[2]: an inner node, or where a leaf's shapes begin
///        56  count[2]: 0 for an inner node, else shapes in the leaf
struct BvhNode {
    float bounds[3][4];
    uint32_t index[2];
    uint32_t count[2];
};
static_assert(sizeof(BvhNode) == 64);

/// Binary bounding volume hierarchy of boxes over any set. See build_tree.
template <class Set>
struct Bvh {
    static constexpr const char* name = "bvh";
    static constexpr bool reads_set = Leaves<Set>::keeps_set;
    static constexpr int max_depth = BinaryTree::max_depth;

    AlignedVector<BvhNode> nodes;  ///< the root first, then depth first; empty: no shapes
    Leaves<Set> leaves;
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static Bvh build(const Set& set, const BvhParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, leaves, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
