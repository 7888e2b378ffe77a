#include "accelerators/wide_collapse.h"

#include <limits>

namespace crofton {
namespace {

/// Least cost of a subtree, times area, given up to k slots of the wide node above it.
using Costs = std::array<double, WideCollapse::width + 1>;

/// Best share of k slots for the left child; of equal ones, the most even.
uint8_t best_share(const Costs& left, const Costs& right, int k, double& cost) {
    int best = k / 2;
    cost = left[size_t(best)] + right[size_t(k - best)];
    for (int i = 1; i < k; ++i) {
        const double c = left[size_t(i)] + right[size_t(k - i)];
        if (c < cost) cost = c, best = i;
    }
    return uint8_t(best);
}

}  // namespace

WideCollapse::WideCollapse(const BinaryTree& tree, const TreeCosts& costs, double wide_node,
                           std::span<const float> cost_of_shape)
    : tree_(tree), plans_(tree.nodes.size()) {
    std::vector<Costs> least(tree.nodes.size());
    for (size_t n = tree.nodes.size(); n-- > 0;) {
        const BinaryTree::Node& node = tree.nodes[n];
        const double area = half_area(node.bounds);
        Costs& c = least[n];
        if (node.leaf()) {
            double shapes = 0;
            if (costs.leaf_width == 1)
                for (uint32_t i = 0; i < node.count; ++i)
                    shapes += cost_of_shape[tree.order[node.first + i]];
            c.fill(area *
                   costs.leaf(shapes, std::span(tree.order).subspan(node.first, node.count)));
            continue;
        }
        const Costs &left = least[node.left], &right = least[node.right];
        for (int k = width; k >= 2; --k) {
            double shared;
            plans_[n][size_t(k)] = best_share(left, right, k, shared);
            if (k == width) c[1] = area * wide_node + shared;
            c[size_t(k)] = shared;
            if (c[1] < shared) {
                c[size_t(k)] = c[1];
                plans_[n][size_t(k)] |= own_node;
            }
        }
    }
    const double area = half_area(tree.nodes[0].bounds);
    if (area > 0) expected_cost_ = least[0][1] / area;
}

std::vector<uint32_t> WideCollapse::children(uint32_t root) const {
    if (tree_.nodes[root].leaf()) return {root};
    struct Open {
        uint32_t node;
        int slots;
    };
    std::vector<uint32_t> list;
    std::vector<Open> open{{root, width}};
    while (!open.empty()) {
        const auto [n, slots] = open.back();
        open.pop_back();
        const BinaryTree::Node& node = tree_.nodes[n];
        const uint8_t plan = plans_[n][size_t(slots)];
        if (n != root && (node.leaf() || slots == 1 || (plan & own_node))) {
            list.push_back(n);
            continue;
        }
        const int left = plan & ~own_node;
        open.push_back({node.right, slots - left});
        open.push_back({node.left, left});
    }
    return list;
}

}  // namespace crofton
