#pragma once

#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "framework/aligned.h"
#include "framework/parts.h"
#include "framework/primitive.h"

namespace crofton {

enum class WideNodes { full, quantised };

struct WideBvhParameters : TreeParameters {
    WideNodes nodes = WideNodes::full;

    WideBvhParameters() { max_leaf_size = 16; }

    template <class V>
    void fields(V& v) {
        v.choice("nodes", nodes, {"full", "quantised"},
                 "child boxes as floats, or as bytes relative to their node");
        TreeParameters::fields(v, 32);
    }
};

/// A child: an inner node's index; or, with bit 31, a leaf: count - 1 in bits 26 … 30, where its
/// shapes begin in bits 0 … 25.
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

/// Box of child i as traversal sees it.
Bounds3 child_bounds(const WideNode& node, int i);
Bounds3 child_bounds(const QuantisedNode& node, int i);

/// Bounding volume hierarchy with eight children a node, all tested at once. Made from a
/// binary tree by leaving out the nodes whose absence costs least: see WideCollapse.
template <class Set>
struct WideBvh {
    static constexpr const char* name = "wide_bvh";
    static constexpr bool reads_set = Leaves<Set>::keeps_set;
    static constexpr int width = 8;
    static constexpr int max_depth = BinaryTree::max_depth;  ///< of the binary tree, and so of this

    WideNodes format = WideNodes::full;
    AlignedVector<WideNode> nodes;           ///< format full: the root first
    AlignedVector<QuantisedNode> quantised;  ///< format quantised
    Leaves<Set> leaves;
    Bounds3 box;
    double cost = 0;
    StructureStatistics stats;

    static WideBvh build(const Set& set, const WideBvhParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(format, nodes, quantised, leaves, box, cost, stats);
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
        const bool full = format == WideNodes::full;
        for (int i = 0; i < width; ++i) {
            const Bounds3 b =
                full ? child_bounds(nodes[at.index], i) : child_bounds(quantised[at.index], i);
            const uint32_t child = full ? nodes[at.index].child[i] : quantised[at.index].child[i];
            if (!b.empty()) f(b, TraversalStart{child, 0});
        }
    }
    double cost_of(const Set& set, TraversalStart at) const {
        if (is_leaf(at))
            return leaf_cost(set, leaves, WideChild::first(at.index), WideChild::count(at.index));
        int children = 0;
        visit_children(at, [&](const Bounds3&, TraversalStart) { ++children; });
        return cost_constants.wide_node * (children - 1);
    }
    std::span<const uint32_t> references(TraversalStart leaf) const {
        return {leaves.references() + WideChild::first(leaf.index), WideChild::count(leaf.index)};
    }
    /// @}
};

}  // namespace crofton
