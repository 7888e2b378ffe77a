#pragma once

#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "accelerators/wide_nodes.h"
#include "framework/compact_patches.h"
#include "framework/parts.h"
#include "framework/primitive.h"
#include "framework/triangle_patches.h"

namespace crofton {

enum class WideLeafForm { full, compact };
/// Children a node.
enum class WideWidth { four, eight, sixteen };
inline int width_of(WideWidth width) { return 4 << int(width); }

struct WideBvhParameters : TreeParameters {
    WideFormat nodes = WideFormat::full;
    WideWidth width = WideWidth::sixteen;
    WideLeafForm leaves = WideLeafForm::full;

    WideBvhParameters() { max_leaf_size = 16; }

    template <class V>
    void fields(V& v) {
        v.choice("nodes", nodes, {"full", "quantised"},
                 "child boxes as floats, or as bytes relative to their node");
        v.choice("width", width, {"4", "8", "16"}, "children a node, at most");
        v.choice("leaves", leaves, {"full", "compact"},
                 "corners of triangles in every leaf, or shared by many; other shapes: no matter");
        TreeParameters::fields(v, 32);
    }
};

/// How the leaves are stored: patches of triangles, or references.
template <class Set>
using WideLeaves =
    std::conditional_t<std::is_same_v<Set, TriangleSet>, TrianglePatches, ReferenceLeaves>;

/// Bounding volume hierarchy with 4, 8 or 16 children a node, all tested at once. Made from a
/// binary tree by leaving out the nodes whose absence costs least: see WideCollapse.
template <class Set>
struct WideBvh {
    static constexpr const char* name = "wide_bvh";
    static constexpr bool reads_set = WideLeaves<Set>::keeps_set;
    static constexpr int max_depth = BinaryTree::max_depth;  ///< of the binary tree, and so of this

    WideNodes nodes;
    bool compact = false;
    WideLeaves<Set> leaves;         ///< not compact
    CompactPatches compact_leaves;  ///< compact: the same patches, of triangles
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static WideBvh build(const Set& set, const WideBvhParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, compact, leaves, compact_leaves, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;

    /// @name Opening, see framework/parts.h: `index` is a WideChild
    /// @{
    static bool is_leaf(TraversalStart at) { return WideChild::is_leaf(at.index); }
    template <class F>
    void visit_children(TraversalStart at, F&& f) const {
        if (box.empty()) return;
        nodes.visit([&](const auto* first) {
            const auto& node = node_at(first, at.index);
            for (int i = 0; i < node.width; ++i)
                if (const Bounds3 b = child_bounds(node, i); !b.empty())
                    f(b, TraversalStart{node.child[i], 0});
        });
    }
    double cost_of(const Set& set, TraversalStart at) const {
        if (is_leaf(at)) {
            const uint32_t count = WideChild::count(at.index);
            if constexpr (std::is_same_v<Set, TriangleSet>)
                return count * cost_constants.triangle_block;
            else
                return leaf_cost(set, leaves, WideChild::first(at.index), count);
        }
        int children = 0;
        visit_children(at, [&](const Bounds3&, TraversalStart) { ++children; });
        return cost_constants.wide_node * (children - 1);
    }
    /// Shapes in a leaf.
    uint32_t leaf_size(uint32_t child) const {
        uint32_t count = WideChild::count(child);
        if constexpr (std::is_same_v<Set, TriangleSet>) {
            const uint32_t first = WideChild::first(child), end = first + count;
            count = 0;
            for (uint32_t i = first; i < end; ++i)
                count += compact ? compact_leaves.count(i) : leaves.count(i);
        }
        return count;
    }
    std::span<const uint32_t> references(TraversalStart leaf) const {
        return {leaves.references() + WideChild::first(leaf.index), WideChild::count(leaf.index)};
    }
    /// @}
};

}  // namespace crofton
