#include "accelerators/wide_collapse.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/wide_collapse.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Plans a subtree after its children, the two at once near the root of a large tree. Recursion is
/// as deep as the tree, which is bounded. The same sums in every lane: the same plans for all
/// instruction sets.
template <int W>
class WidePlanner {
    using D = hn::CappedTag<double, W>;
    using V = hn::Vec<D>;
    static constexpr size_t N = hn::MaxLanes(D()), parts = W / N;

  public:
    using Plan = typename WideCollapse<W>::Plan;
    /// Costs times area of a subtree by slots of the wide node above it.
    struct SlotCosts {
        /// [W + k - 1]: for k slots at most; in front of that, infinite.
        alignas(64) double least[2 * W];
        int leaves;  ///< of the subtree, but W at most: more slots are of no use
    };

    explicit WidePlanner(const WidePlanTask<W>& task)
        : task_(task),
          tree_(task.tree),
          parallel_levels_(parallel_levels(task.tree.nodes.size())) {}

    void plan(uint32_t n, int depth, SlotCosts& c) {
        const D d;
        const BinaryTree::Node& node = tree_.nodes[n];
        const double area = half_area(node.bounds);
        for (size_t p = 0; p < parts; ++p) hn::Store(hn::Inf(d), d, c.least + p * N);
        if (node.leaf()) {
            const auto cost = hn::Set(d, area * leaf(node));
            for (size_t p = 0; p < parts; ++p) hn::Store(cost, d, c.least + W + p * N);
            c.leaves = 1;
            return;
        }
        SlotCosts left, right;
        invoke_both(
            depth < parallel_levels_, [&] { plan(node.left, depth + 1, left); },
            [&] { plan(node.right, depth + 1, right); });
        c.leaves = std::min(W, left.leaves + right.leaves);
        share(left, right, area * task_.wide_node, c, task_.plans[n]);
    }

  private:
    /// The best share of each number of slots.
    /// @param own  of the node itself as a wide node
    HWY_INLINE void share(const SlotCosts& left, const SlotCosts& right, double own, SlotCosts& c,
                          Plan& plan) const {
        const D d;
        V shared[parts], share[parts];
        for (size_t p = 0; p < parts; ++p) shared[p] = hn::Inf(d), share[p] = hn::Set(d, 1.0);
        const int most = std::min(left.leaves, W - 1);
        for (int i = 1; i <= most; ++i) {
            const auto l = hn::Set(d, left.least[W + i - 1]), slots = hn::Set(d, double(i));
            for (size_t p = 0; p < parts; ++p) {
                const auto sum = hn::Add(l, behind(right, i, p));
                const auto better = hn::Lt(sum, shared[p]);
                shared[p] = hn::IfThenElse(better, sum, shared[p]);
                share[p] = hn::IfThenElse(better, slots, share[p]);
            }
        }
        for (size_t p = 0; p < parts; ++p) hn::Store(shared[p], d, c.least + W + p * N);
        const auto alone = hn::Set(d, own + c.least[2 * W - 1]);
        const hn::Rebind<uint8_t, D> d8;
        for (size_t p = 0; p < parts; ++p) {
            hn::Store(hn::Min(shared[p], alone), d, c.least + W + p * N);
            const auto flag = hn::IfThenElseZero(hn::Lt(alone, shared[p]),
                                                 hn::Set(d, double(WideCollapse<W>::own_node)));
            // Whole numbers in double: the lowest byte of the sum with 2^52.
            const auto bits = hn::BitCast(hn::RebindToUnsigned<D>(),
                                          hn::Add(hn::Add(share[p], flag), hn::Set(d, 0x1p52)));
            hn::StoreU(hn::TruncateTo(d8, bits), d8, plan.data() + p * N);
        }
    }
    /// Part p of the costs for i slots less; infinite where that is none.
    static HWY_INLINE V behind(const SlotCosts& costs, int i, size_t p) {
        const D d;
        if constexpr (parts == 1) {
            // As it was stored: a load that reaches into what is in front of it would have to wait.
            const hn::RebindToSigned<D> di;
            const auto lane = hn::Sub(hn::Iota(di, 0), hn::Set(di, i));
            const auto moved =
                hn::TableLookupLanes(hn::Load(d, costs.least + W),
                                     hn::IndicesFromVec(d, hn::And(lane, hn::Set(di, W - 1))));
            return hn::IfThenElse(hn::FirstN(d, size_t(i)), hn::Inf(d), moved);
        } else {
            return hn::LoadU(d, costs.least + W + p * N - i);
        }
    }
    double leaf(const BinaryTree::Node& node) const {
        double shapes = 0;
        if (task_.costs.leaf_width == 1)
            for (uint32_t i = 0; i < node.count; ++i)
                shapes += task_.cost_of_shape[tree_.order[node.first + i]];
        return task_.costs.finished_leaf(shapes, node);
    }

    const WidePlanTask<W>& task_;
    const BinaryTree& tree_;
    int parallel_levels_;
};

/// @return  cost of the root times its area
template <int W>
double plan_nodes(const WidePlanTask<W>& task) {
    typename WidePlanner<W>::SlotCosts root;
    WidePlanner<W>(task).plan(0, 0, root);
    return root.least[W];
}
double plan_4(const WidePlanTask<4>& task) { return plan_nodes(task); }
double plan_8(const WidePlanTask<8>& task) { return plan_nodes(task); }
double plan_16(const WidePlanTask<16>& task) { return plan_nodes(task); }

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
namespace {
HWY_EXPORT(plan_4);
HWY_EXPORT(plan_8);
HWY_EXPORT(plan_16);

double plan_nodes(const WidePlanTask<4>& task) { return HWY_DYNAMIC_DISPATCH(plan_4)(task); }
double plan_nodes(const WidePlanTask<8>& task) { return HWY_DYNAMIC_DISPATCH(plan_8)(task); }
double plan_nodes(const WidePlanTask<16>& task) { return HWY_DYNAMIC_DISPATCH(plan_16)(task); }

}  // namespace

template <int W>
WideCollapse<W>::WideCollapse(const BinaryTree& tree, const TreeCosts& costs, double wide_node,
                              std::span<const float> cost_of_shape)
    : tree_(tree), plans_(tree.nodes.size()) {
    const double cost =
        plan_nodes(WidePlanTask<W>{tree, costs, wide_node, cost_of_shape, plans_.data()});
    const double area = half_area(tree.nodes[0].bounds);
    if (area > 0) expected_cost_ = cost / area;
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
        const uint8_t plan = plans_[n][size_t(slots - 1)];
        if (n != root && (slots == 1 || node.leaf() || (plan & own_node))) {
            list.node[list.count++] = n;
            continue;
        }
        const int left = plan & ~own_node;
        open[left_open++] = {node.right, slots - left};
        open[left_open++] = {node.left, left};
    }
    return list;
}

template class WideCollapse<4>;
template class WideCollapse<8>;
template class WideCollapse<16>;

}  // namespace crofton
#endif
