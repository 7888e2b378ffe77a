#pragma once

#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "framework/aligned.h"
#include "framework/compact_patches.h"
#include "framework/parts.h"
#include "framework/primitive.h"
#include "framework/triangle_patches.h"

namespace crofton {

enum class WideNodes { full, quantised };
enum class WideLeafForm { full, compact };

struct WideBvhParameters : TreeParameters {
    WideNodes nodes = WideNodes::full;
    WideLeafForm leaves = WideLeafForm::full;

    WideBvhParameters() { max_leaf_size = 16; }

    template <class V>
    void fields(V& v) {
        v.choice("nodes", nodes, {"full", "quantised"},
                 "child boxes as floats, or as bytes relative to their node");
        v.choice("leaves", leaves, {"full", "compact"},
                 "corners of triangles in every leaf, or shared by many; other shapes: no matter");
        TreeParameters::fields(v, 32);
    }
};

/// How the leaves are stored: patches of triangles, or references.
template <class Set>
using WideLeaves =
    std::conditional_t<std::is_same_v<Set, TriangleSet>, TrianglePatches, ReferenceLeaves>;

/// A child: where an inner node is, see node_at; or, with bit 31, a leaf: count - 1 in bits 26 …
/// 30, where its patches or references begin in bits 0 … 25.
struct WideChild {
    static constexpr uint32_t leaf_bit = 1u << 31, first_bits = 26;
    static constexpr uint32_t max_first = (1u << first_bits) - 1, max_count = 32;
    static uint32_t leaf(uint32_t first, uint32_t count) {
        return leaf_bit | (count - 1) << first_bits | first;
    }
    static bool is_leaf(uint32_t child) { return child & leaf_bit; }
    static uint32_t first(uint32_t child) { return child & max_first; }
    static uint32_t count(uint32_t child) { return (child >> first_bits & 31) + 1; }
};

/// Eight children side by side.
///
///   byte   0  planes[0]: lower x, y, z of all children, 8 floats each
///         96  planes[1]: upper x, y, z likewise
///        192  child[8]
/// Unused children have lower = +inf, upper = -inf, which no ray meets.
struct alignas(32) WideNode {
    float planes[2][3][8];
    uint32_t child[8];
};
static_assert(sizeof(WideNode) == 224);

/// The same with bytes: plane = origin + scale·byte, rounded outwards (after Ylitie, Karras, Laine
/// 2017).
///
///   byte   0  origin x, y, z     12  scale x, y, z (floats)
///         24  planes[0]: lower x, y, z of all children, 8 bytes each     48  planes[1]: upper
///         72  child[8]          104  count of children
struct alignas(8) QuantisedNode {
    float origin[3];
    float scale[3];
    uint8_t planes[2][3][8];
    uint32_t child[8];
    uint32_t children;
    uint32_t unused;
};
static_assert(sizeof(QuantisedNode) == 112);

/// Places of nodes are counted in steps of their alignment, which makes an address of a place by a
/// shift.
template <class Node>
uint32_t place_of(size_t index) {
    return uint32_t(index * (sizeof(Node) / alignof(Node)));
}
template <class Node>
const Node& node_at(const Node* nodes, uint32_t place) {
    return *reinterpret_cast<const Node*>(reinterpret_cast<const char*>(nodes) +
                                          size_t(place) * alignof(Node));
}

/// Box of child i as traversal sees it; empty if there is none.
Bounds3 child_bounds(const WideNode& node, int i);
Bounds3 child_bounds(const QuantisedNode& node, int i);

/// Bounding volume hierarchy with eight children a node, all tested at once. Made from a
/// binary tree by leaving out the nodes whose absence costs least: see WideCollapse.
template <class Set>
struct WideBvh {
    static constexpr const char* name = "wide_bvh";
    static constexpr bool reads_set = WideLeaves<Set>::keeps_set;
    static constexpr int width = 8;
    static constexpr int max_depth = BinaryTree::max_depth;  ///< of the binary tree, and so of this

    WideNodes format = WideNodes::full;
    RawAlignedVector<WideNode> nodes;           ///< format full: the root first
    RawAlignedVector<QuantisedNode> quantised;  ///< format quantised
    bool compact = false;
    WideLeaves<Set> leaves;         ///< not compact
    CompactPatches compact_leaves;  ///< compact: the same patches, of triangles
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static WideBvh build(const Set& set, const WideBvhParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(format, nodes, quantised, compact, leaves, compact_leaves, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
    const WideNode* begin(const WideNode*) const { return nodes.data(); }
    const QuantisedNode* begin(const QuantisedNode*) const { return quantised.data(); }

    /// @name Opening, see framework/parts.h: `index` is a WideChild
    /// @{
    static bool is_leaf(TraversalStart at) { return WideChild::is_leaf(at.index); }
    template <class F>
    void visit_children(TraversalStart at, F&& f) const {
        if (box.empty()) return;
        const auto visit = [&](const auto& node) {
            for (int i = 0; i < width; ++i)
                if (const Bounds3 b = child_bounds(node, i); !b.empty())
                    f(b, TraversalStart{node.child[i], 0});
        };
        if (format == WideNodes::full)
            visit(node_at(nodes.data(), at.index));
        else
            visit(node_at(quantised.data(), at.index));
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
