#include "accelerators/tree_build.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/tree_binned.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/object_split.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

class BinnedBuilder {
    static constexpr int median_depth = 40;        // from here on, halves by count
    static constexpr size_t parallel_size = 4096;  // fewer references are not worth a task

  public:
    /// @param bins  0: halves by count
    BinnedBuilder(BuildReferences references, const TreeCosts& costs, int bins, int max_leaf_size)
        : refs_(std::move(references)),
          costs_(costs),
          bins_(bins),
          max_leaf_size_(uint32_t(max_leaf_size)) {}

    BinaryTree build() {
        BinaryTree tree;
        tree.nodes.resize(2 * refs_.size() - 1);
        nodes_ = tree.nodes.data();
        size_t next = 1;
        build_range(0, refs_.size(), 0, next, 0, bounds_of(refs_));
        tree.order.resize(refs_.size());
        parallel_for(refs_.size(), 1 << 14, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) tree.order[i] = refs_[i].shape;
        });
        return tree;
    }

  private:
    /// A subtree of n references uses at most 2n - 1 nodes. A large one has so many from `node` on:
    /// a fixed place, whichever thread builds it. In it, small ones lie side by side.
    /// @param next  the first that is free, if it is small
    void build_range(size_t begin, size_t end, size_t node, size_t& next, int depth,
                     const ReferenceBounds& range) {
        const size_t n = end - begin;
        const std::span<BuildReference> references(refs_.data() + begin, n);
        nodes_[node].bounds = range.boxes.bounds();
        Halves halves;
        if (n > 1) halves = partition(references, range, depth);
        const size_t n_left = halves.left;
        if (n_left == 0) {
            nodes_[node].make_leaf(begin, n);
            return;
        }
        const size_t middle = begin + n_left;
        if (n < parallel_size) {
            const size_t left = next, right = next + 1;
            next += 2;
            nodes_[node].make_inner(left, right);
            build_range(begin, middle, left, next, depth + 1, halves.side[0]);
            build_range(middle, end, right, next, depth + 1, halves.side[1]);
            return;
        }
        const size_t left = node + 1, right = node + 2 * n_left;
        nodes_[node].make_inner(left, right);
        parallel_invoke(
            [&] {
                size_t free = left + 1;
                build_range(begin, middle, left, free, depth + 1, halves.side[0]);
            },
            [&] {
                size_t free = right + 1;
                build_range(middle, end, right, free, depth + 1, halves.side[1]);
            });
    }

    /// Reorders the references so that the left child's come first; none do for a leaf.
    Halves partition(std::span<BuildReference> references, const ReferenceBounds& range,
                     int depth) const {
        const size_t n = references.size();
        const bool may_be_leaf = n <= max_leaf_size_;
        const auto halve = [&] {
            return may_be_leaf ? Halves() : halve_references(references, range);
        };
        if (bins_ == 0 || depth >= median_depth) return halve();
        const double as_leaf = may_be_leaf ? leaf_cost(references) : 0;
        if (may_be_leaf && is_surely_leaf(references, range, as_leaf)) return {};
        const int bins = bins_for(n, bins_);
        const Binning binning(range.centroids, bins);
        const ObjectSplit split = find_object_split(references, range, binning, bins, costs_);
        if (split.axis < 0) return halve();
        if (may_be_leaf && as_leaf <= split.cost) return {};
        return divide(references, binning, split);
    }

    /// Whether no split of what is tested at once anyway can pay: its children are at least as
    /// large as the largest and the smallest reference. Spares half of all evaluations.
    /// @param as_leaf  what a leaf of them costs
    bool is_surely_leaf(std::span<const BuildReference> references, const ReferenceBounds& range,
                        double as_leaf) const {
        if (costs_.leaf_width == 1 || as_leaf > costs_.leaf_block) return false;
        double least = std::numeric_limits<double>::infinity(), most = 0;
        for (const BuildReference& r : references) {
            const double area = half_area(r.bounds);
            least = std::min(least, area);
            most = std::max(most, area);
        }
        const double area = range.boxes.half_area();
        return costs_.node * area + costs_.leaf_block * (least + most) >= costs_.leaf_block * area;
    }

    double leaf_cost(std::span<const BuildReference> references) const {
        if (costs_.blocks_vary && references.size() <= TreeCosts::most_counted) {
            uint32_t shapes[TreeCosts::most_counted];
            for (size_t i = 0; i < references.size(); ++i) shapes[i] = references[i].shape;
            return costs_.leaf(0, std::span(shapes, references.size()));
        }
        double sum = 0;
        for (const BuildReference& r : references) sum += r.cost;
        return costs_.leaf(sum, uint32_t(references.size()));
    }

    BuildReferences refs_;
    TreeCosts costs_;
    int bins_;
    size_t max_leaf_size_;
    BinaryTree::Node* nodes_ = nullptr;
};

/// @param bins  0: halves by count
BinaryTree build_binned(BuildReferences references, const TreeCosts& costs, int bins,
                        int max_leaf_size) {
    return BinnedBuilder(std::move(references), costs, bins, max_leaf_size).build();
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
HWY_EXPORT(build_binned);

BinaryTree build_binned(BuildReferences references, const TreeCosts& costs, int bins,
                        int max_leaf_size) {
    if (references.empty()) return {};
    return HWY_DYNAMIC_DISPATCH(build_binned)(std::move(references), costs, bins, max_leaf_size);
}

BinaryTree build_median(BuildReferences references) {
    return build_binned(std::move(references), TreeCosts{}, 0, 1);
}

}  // namespace crofton
#endif
