#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include "accelerators/box4.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 4096;  // fewer references are not worth a task

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

BinaryTree build_sweep(BuildReferences references, const TreeCosts& costs) {
    if (references.empty()) return {};
    return SweepBuilder(std::move(references), costs).build();
}

}  // namespace crofton
