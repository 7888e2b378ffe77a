#pragma once

#include <array>

#include "accelerators/binary_tree.h"

namespace crofton {

/// Which nodes of a binary tree are left out when it becomes one with up to W children a node, so
/// that the area heuristic's cost is least (dynamic programming: Wald, Benthin, Boulos 2008,
/// "Getting rid of packets"; Ylitie, Karras, Laine 2017, "Efficient incoherent ray traversal on
/// GPUs through compressed wide BVHs"). O(N) time and memory. Leaves stay as they are.
template <int W>
class WideCollapse {
  public:
    static constexpr int width = W;

    /// Nodes of the binary tree.
    struct Children {
        std::array<uint32_t, width> node;
        uint32_t count = 0;
        const uint32_t* begin() const { return node.data(); }
        const uint32_t* end() const { return node.data() + count; }
    };

    /// @param tree       leaves as collapse_leaves leaves them; not empty; must outlive this
    /// @param wide_node  nominal ns of testing all children of a wide node
    WideCollapse(const BinaryTree& tree, const TreeCosts& costs, double wide_node,
                 std::span<const float> cost_of_shape);

    /// Children of the wide node that stands for an inner node: 2 to W. Of a leaf, itself.
    Children children(uint32_t node) const;

    /// Nominal ns of a random line that meets the root.
    double expected_cost() const { return expected_cost_; }

    /// For k slots, from 1 to W, at k - 1: how many the left child gets; with own_node, the node
    /// costs less as a wide node of its own in one slot.
    using Plan = std::array<uint8_t, width>;
    static constexpr uint8_t own_node = 0x80;

  private:
    const BinaryTree& tree_;
    RawAlignedVector<Plan> plans_;
    double expected_cost_ = 0;
};

/// What is planned, and where the plans of inner nodes go.
template <int W>
struct WidePlanTask {
    const BinaryTree& tree;
    const TreeCosts& costs;
    double wide_node;
    std::span<const float> cost_of_shape;
    typename WideCollapse<W>::Plan* plans;
};

extern template class WideCollapse<4>;
extern template class WideCollapse<8>;
extern template class WideCollapse<16>;

}  // namespace crofton
