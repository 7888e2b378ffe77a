#include "accelerators/wide_collapse.h"

#include <algorithm>

namespace crofton {
namespace {

/// Of a subtree, by slots of the wide node above it.
template <int W>
struct SlotCosts {
    std::array<double, W + 1> least;  // cost times area, for 1 to `leaves` slots
    int leaves;                       // of the subtree, but W at most: more slots are of no use
};

/// Best share of k slots for the left child; of equal ones, the most even.
template <int W>
uint8_t best_share(const SlotCosts<W>& left, const SlotCosts<W>& right, int k, double& cost) {
    const int first = std::max(1, k - right.leaves), last = std::min(k - 1, left.leaves);
    const auto of = [&](int i) { return left.least[size_t(i)] + right.least[size_t(k - i)]; };
    int best = std::clamp(k / 2, first, last);
    cost = of(best);
    for (int i = first; i <= last; ++i)
        if (of(i) < cost) cost = of(i), best = i;
    return uint8_t(best);
}

}  // namespace

/// Plans a subtree after its children, the two at once near the root of a large tree. Recursion is
/// as deep as the tree, which is bounded.
template <int W>
class WidePlanner {
  public:
    WidePlanner(WideCollapse<W>& collapse, const TreeCosts& costs, double wide_node,
                std::span<const float> cost_of_shape)
        : tree_(collapse.tree_),
          plans_(collapse.plans_),
          costs_(costs),
          wide_node_(wide_node),
          cost_of_shape_(cost_of_shape),
          parallel_levels_(parallel_levels(tree_.nodes.size())) {}

    void plan(uint32_t n, int depth, SlotCosts<W>& c) {
        const BinaryTree::Node& node = tree_.nodes[n];
        const double area = half_area(node.bounds);
        if (node.leaf()) {
            c.least[1] = area * leaf(node);
            c.leaves = 1;
            return;
        }
        SlotCosts<W> left, right;
        invoke_both(
            depth < parallel_levels_, [&] { plan(node.left, depth + 1, left); },
            [&] { plan(node.right, depth + 1, right); });
        c.leaves = std::min(W, left.leaves + right.leaves);
        typename WideCollapse<W>::Plan& p = plans_[n];
        for (int k = c.leaves; k >= 2; --k) {
            double shared;
            p[size_t(k)] = best_share(left, right, k, shared);
            if (k == c.leaves) c.least[1] = area * wide_node_ + shared;
            c.least[size_t(k)] = shared;
            if (c.least[1] < shared) {
                c.least[size_t(k)] = c.least[1];
                p[size_t(k)] |= WideCollapse<W>::own_node;
            }
        }
        std::fill(p.begin() + c.leaves + 1, p.end(), p[size_t(c.leaves)]);
    }

  private:
    double leaf(const BinaryTree::Node& node) const {
        double shapes = 0;
        if (costs_.leaf_width == 1)
            for (uint32_t i = 0; i < node.count; ++i)
                shapes += cost_of_shape_[tree_.order[node.first + i]];
        return costs_.finished_leaf(shapes, node);
    }

    const BinaryTree& tree_;
    RawAlignedVector<typename WideCollapse<W>::Plan>& plans_;
    const TreeCosts& costs_;
    double wide_node_;
    std::span<const float> cost_of_shape_;
    int parallel_levels_;
};

template <int W>
WideCollapse<W>::WideCollapse(const BinaryTree& tree, const TreeCosts& costs, double wide_node,
                              std::span<const float> cost_of_shape)
    : tree_(tree), plans_(tree.nodes.size()) {
    SlotCosts<W> root;
    WidePlanner<W>(*this, costs, wide_node, cost_of_shape).plan(0, 0, root);
    const double area = half_area(tree.nodes[0].bounds);
    if (area > 0) expected_cost_ = root.least[1] / area;
}

template <int W>
typename WideCollapse<W>::Children WideCollapse<W>::children(uint32_t root) const {
    Children list;
    if (tree_.nodes[root].leaf()) {
        list.node[list.count++] = root;
        return list;
    }
    struct Open {
        uint32_t node;
        int slots;
    };
    std::array<Open, width> open;
    size_t left_open = 0;
    open[left_open++] = {root, width};
    while (left_open > 0) {
        const auto [n, slots] = open[--left_open];
        const BinaryTree::Node& node = tree_.nodes[n];
        if (n != root && (slots == 1 || node.leaf() || (plans_[n][size_t(slots)] & own_node))) {
            list.node[list.count++] = n;
            continue;
        }
        const int left = plans_[n][size_t(slots)] & ~own_node;
        open[left_open++] = {node.right, slots - left};
        open[left_open++] = {node.left, left};
    }
    return list;
}

template class WideCollapse<4>;
template class WideCollapse<8>;
template class WideCollapse<16>;

}  // namespace crofton
