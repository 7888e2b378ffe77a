#include <algorithm>
#include <array>
#include <limits>

#include "accelerators/object_split.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 4096;  // fewer references are not worth a task

class BinnedBuilder {
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
        build_range(0, refs_.size(), 0, 0, bounds_of(refs_));
        tree.order.resize(refs_.size());
        parallel_for(refs_.size(), 1 << 14, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) tree.order[i] = refs_[i].shape;
        });
        return tree;
    }

  private:
    /// A subtree of n references uses at most 2n - 1 nodes from `node` on: a fixed place, whichever
    /// thread builds it.
    void build_range(size_t begin, size_t end, size_t node, int depth,
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
        const size_t middle = begin + n_left, left = node + 1, right = node + 2 * n_left;
        nodes_[node].make_inner(left, right);
        const auto build_left = [&] {
            build_range(begin, middle, left, depth + 1, halves.side[0]);
        };
        const auto build_right = [&] {
            build_range(middle, end, right, depth + 1, halves.side[1]);
        };
        if (n >= parallel_size) {
            parallel_invoke(build_left, build_right);
        } else {
            build_left();
            build_right();
        }
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
        if (may_be_leaf && is_surely_leaf(references, range)) return {};
        const int bins = bins_for(n, bins_);
        const Binning binning(range.centroids, bins);
        const ObjectSplit split = find_object_split(references, range, binning, bins, costs_);
        if (split.axis < 0) return halve();
        if (may_be_leaf && leaf_cost(references) <= split.cost) return {};
        return divide(references, binning, split);
    }

    /// Whether no split of what is tested at once anyway can pay: its children are at least as
    /// large as the largest and the smallest reference. Spares half of all evaluations.
    bool is_surely_leaf(std::span<const BuildReference> references,
                        const ReferenceBounds& range) const {
        if (costs_.leaf_width == 1 || references.size() > size_t(costs_.leaf_width)) return false;
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

/// Twice the shapes' places on each axis, sorted once and kept sorted.
class SweepBuilder {
  public:
    SweepBuilder(BuildReferences references, const TreeCosts& costs)
        : refs_(std::move(references)), costs_(costs), n_(refs_.size()) {}

    BinaryTree build() {
        parallel_for(3, 1, [&](size_t begin, size_t end) {
            for (size_t a = begin; a < end; ++a) sort_axis(int(a));
        });
        scratch_.resize(n_);
        areas_.resize(n_);
        goes_left_.resize(n_);
        BinaryTree tree;
        tree.nodes.resize(2 * n_ - 1);
        nodes_ = tree.nodes.data();
        build_range(0, n_, 0, 0);
        tree.order.resize(n_);
        for (size_t i = 0; i < n_; ++i) tree.order[i] = refs_[sorted_[0][i]].shape;
        return tree;
    }

  private:
    struct Split {
        double cost = std::numeric_limits<double>::infinity();
        int axis = 0;
        size_t left = 0;  // how many go left
    };

    void sort_axis(int axis) {
        std::vector<std::pair<float, uint32_t>> keys(n_);
        for (size_t i = 0; i < n_; ++i) keys[i] = {centroid2(refs_[i].bounds, axis), uint32_t(i)};
        std::sort(keys.begin(), keys.end());
        sorted_[axis].resize(n_);
        for (size_t i = 0; i < n_; ++i) sorted_[axis][i] = keys[i].second;
    }

    void build_range(size_t begin, size_t end, size_t node, int depth) {
        const size_t n = end - begin;
        Box4 box;
        for (size_t i = begin; i < end; ++i) box.extend(Box4(refs_[sorted_[0][i]]));
        nodes_[node].bounds = box.bounds();
        if (n == 1) {
            nodes_[node].make_leaf(begin, 1);
            return;
        }
        const Split split = depth < median_depth ? best_split(begin, end) : halve(begin, end);
        partition(begin, end, split);
        const size_t middle = begin + split.left;
        const size_t left = node + 1, right = node + 2 * split.left;
        nodes_[node].make_inner(left, right);
        const auto build_left = [&] { build_range(begin, middle, left, depth + 1); };
        const auto build_right = [&] { build_range(middle, end, right, depth + 1); };
        if (n >= parallel_size) {
            parallel_invoke(build_left, build_right);
        } else {
            build_left();
            build_right();
        }
    }

    /// Of equal costs the split nearest to the middle: many equal shapes make no list.
    Split best_split(size_t begin, size_t end) {
        const size_t n = end - begin;
        Split best;
        const auto off = [n](size_t left) { return left > n / 2 ? left - n / 2 : n / 2 - left; };
        for (int axis = 0; axis < 3; ++axis) {
            const uint32_t* sorted = sorted_[axis].data() + begin;
            double* right_cost = areas_.data() + begin;
            Box4 right;
            double sum = 0;
            for (size_t i = n - 1; i > 0; --i) {
                const BuildReference& r = refs_[sorted[i]];
                right.extend(Box4(r));
                sum += r.cost;
                right_cost[i] = right.half_area() * costs_.leaf(sum, uint32_t(n - i));
            }
            Box4 left;
            sum = 0;
            for (size_t i = 1; i < n; ++i) {
                const BuildReference& r = refs_[sorted[i - 1]];
                left.extend(Box4(r));
                sum += r.cost;
                const double cost =
                    left.half_area() * costs_.leaf(sum, uint32_t(i)) + right_cost[i];
                if (cost < best.cost || (cost == best.cost && off(i) < off(best.left)))
                    best = {cost, axis, i};
            }
        }
        return best;
    }

    Split halve(size_t begin, size_t end) const {
        Split split;
        split.left = (end - begin) / 2;
        float widest = -1;
        for (int a = 0; a < 3; ++a) {
            const float extent = centroid2(refs_[sorted_[a][end - 1]].bounds, a) -
                                 centroid2(refs_[sorted_[a][begin]].bounds, a);
            if (extent > widest) split.axis = a, widest = extent;
        }
        return split;
    }

    /// Keeps the order on every axis.
    void partition(size_t begin, size_t end, const Split& split) {
        const std::vector<uint32_t>& by = sorted_[split.axis];
        for (size_t i = begin; i < end; ++i) goes_left_[by[i]] = i < begin + split.left;
        for (int a = 0; a < 3; ++a) {
            if (a == split.axis) continue;
            uint32_t* sorted = sorted_[a].data();
            size_t left = begin, right = begin;
            for (size_t i = begin; i < end; ++i) {
                const uint32_t r = sorted[i];
                sorted[left] = r;
                scratch_[right] = r;
                left += goes_left_[r];
                right += !goes_left_[r];
            }
            std::copy(scratch_.begin() + ptrdiff_t(begin), scratch_.begin() + ptrdiff_t(right),
                      sorted + left);
        }
    }

    BuildReferences refs_;
    TreeCosts costs_;
    size_t n_;
    std::array<std::vector<uint32_t>, 3> sorted_;  // indices of references, by centroid
    std::vector<uint32_t> scratch_;
    std::vector<double> areas_;
    std::vector<uint8_t> goes_left_;
    BinaryTree::Node* nodes_ = nullptr;
};

}  // namespace

BinaryTree build_binned(BuildReferences references, const TreeCosts& costs, int bins,
                        int max_leaf_size) {
    if (references.empty()) return {};
    return BinnedBuilder(std::move(references), costs, bins, max_leaf_size).build();
}

BinaryTree build_median(BuildReferences references) {
    if (references.empty()) return {};
    return BinnedBuilder(std::move(references), TreeCosts{}, 0, 1).build();
}

BinaryTree build_sweep(BuildReferences references, const TreeCosts& costs) {
    if (references.empty()) return {};
    return SweepBuilder(std::move(references), costs).build();
}

}  // namespace crofton
