#pragma once

#include "accelerators/leaves.h"
#include "framework/aligned.h"
#include "framework/parts.h"
#include "framework/primitive.h"

namespace crofton {

enum class OrderSplit { area, halves };

struct ModelHierarchyParameters {
    int max_leaf_size = 4;
    OrderSplit split = OrderSplit::area;
    bool merge = true;

    template <class V>
    void fields(V& v) {
        v.integer("max_leaf_size", max_leaf_size, 1, 64,
                  "consecutive shapes in a leaf; nested objects always stand alone");
        v.choice("split", split, {"area", "halves"},
                 "where a list of more than eight is cut, in its order: by the area heuristic, or "
                 "into equal halves");
        v.boolean("merge", merge,
                  "members of a small group take free places beside it instead of its box");
    }
};

/// Eight children side by side.
///
///   byte   0  planes[0]: lower x, y, z of all children, 8 floats each
///         96  planes[1]: upper x, y, z likewise
///        192  index[8]: a node, or where a leaf's shapes begin
///        224  count[8]: 0 for a node, else shapes in the leaf
/// Unused children have lower = +inf, upper = -inf, which no ray meets.
struct alignas(32) ModelNode {
    float planes[2][3][8];
    uint32_t index[8];
    uint32_t count[8];

    Bounds3 bounds(int i) const {
        return {{planes[0][0][i], planes[0][1][i], planes[0][2][i]},
                {planes[1][0][i], planes[1][1][i], planes[1][2][i]}};
    }
};
static_assert(sizeof(ModelNode) == 256);

/// The hierarchy that the model itself has: a box around each group of a set (see ShapeGroups),
/// without any clustering (Rubin & Whitted 1980, "A 3-dimensional representation for fast rendering
/// of complex scenes"; Clark 1976, "Hierarchical geometric models for visible surface algorithms").
/// Shapes keep their order. Where the model has no groups, or a group has more than eight members,
/// a tree over the order stands in: modellers and their files put what is near together.
///
/// Departs from the model where its tree does no good: a group with one member is that member, and
/// 32 levels down, groups are left out and their shapes become one list, so that no chain of a
/// scene graph makes a ray walk it link by link, and the stack is bounded.
template <class Set>
struct ModelHierarchy {
    static constexpr const char* name = "model_hierarchy";
    static constexpr bool reads_set = Leaves<Set>::keeps_set;
    /// 32 levels of groups or cuts by area, 11 of cuts to an eighth to finish the list in progress,
    /// 11 more for the longest group in it.
    static constexpr int group_levels = 32, max_depth = group_levels + 2 * 11;

    RawAlignedVector<ModelNode> nodes;  ///< the root first; empty: no shapes
    Leaves<Set> leaves;
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static ModelHierarchy build(const Set& set, const ModelHierarchyParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, leaves, box, cost, stats);
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
        if (nodes.empty()) return;
        const ModelNode& node = nodes[at.index];
        for (int i = 0; i < 8; ++i)
            if (const Bounds3 b = node.bounds(i); !b.empty())
                f(b, TraversalStart{node.index[i], node.count[i]});
    }
    double cost_of(const Set& set, TraversalStart at) const {
        if (is_leaf(at)) return leaf_cost(set, leaves, at.index, at.count);
        // As for wide_bvh: a share for each binary node that these children stand for.
        int children = 0;
        visit_children(at, [&](const Bounds3&, TraversalStart) { ++children; });
        return node_cost(children);
    }
    static double node_cost(int children) {
        return cost_constants.wide_node * std::max(children - 1, 1);
    }
    std::span<const uint32_t> references(TraversalStart leaf) const {
        return {leaves.references() + leaf.index, leaf.count};
    }
    /// @}
};

}  // namespace crofton
