#include "accelerators/binary_tree.h"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>

#include "framework/parallel.h"

namespace crofton {
namespace {

constexpr int max_bins = 64;
constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 4096;  // fewer references are not worth a task

struct Bin {
    Bounds3 bounds;
    uint32_t count = 0;
    double cost = 0;

    void add(const BuildReference& r) {
        bounds.extend(r.bounds);
        ++count;
        cost += r.cost;
    }
    void add(const Bin& b) {
        bounds.extend(b.bounds);
        count += b.count;
        cost += b.cost;
    }
};

struct Split {
    double cost = std::numeric_limits<double>::infinity();
    int axis = -1;
    int bin = 0;  // references in bins < bin go left
};

/// Twice the centre of a box, on one axis; finite for all finite boxes up to FLT_MAX / 2.
float centroid2(const BuildReference& r, int axis) {
    return r.bounds.lower[axis] + r.bounds.upper[axis];
}

/// Bins of one range, on all three axes.
struct Binning {
    int bins;
    Vec3f lower, scale;

    Binning(const Bounds3& centroids, int n) : bins(n), lower(centroids.lower) {
        for (int a = 0; a < 3; ++a) {
            const float extent = centroids.upper[a] - centroids.lower[a];
            const float s = float(n) * 0.999999f / extent;
            scale[a] = extent > 0 && std::isfinite(s) ? s : 0.0f;
        }
    }
    int of(const BuildReference& r, int axis) const {
        const int bin = int((centroid2(r, axis) - lower[axis]) * scale[axis]);
        return std::clamp(bin, 0, bins - 1);
    }
};

using BinTable = std::array<std::array<Bin, max_bins>, 3>;

class BinnedBuilder {
  public:
    BinnedBuilder(std::vector<BuildReference> references, const TreeCosts& costs, int bins,
                  int max_leaf_size)
        : refs_(std::move(references)),
          costs_(costs),
          bins_(std::min(bins, max_bins)),
          max_leaf_size_(uint32_t(max_leaf_size)) {}

    BinaryTree build() {
        BinaryTree tree;
        if (refs_.empty()) return tree;
        tree.nodes.resize(2 * refs_.size() - 1);
        nodes_ = tree.nodes.data();
        build_range(0, refs_.size(), 0, 0);
        tree.order.reserve(refs_.size());
        for (const BuildReference& r : refs_) tree.order.push_back(r.shape);
        return tree;
    }

  private:
    /// A subtree of n references uses at most 2n - 1 nodes from `node` on: a fixed place, whichever
    /// thread builds it.
    void build_range(size_t begin, size_t end, size_t node, int depth) {
        const size_t n = end - begin;
        Bounds3 bounds, centroids;
        double cost_sum = 0;
        measure(begin, end, bounds, centroids, cost_sum);
        nodes_[node].bounds = bounds;

        size_t middle = begin;
        if (n > 1) middle = partition(begin, end, bounds, centroids, cost_sum, depth);
        if (middle == begin) {
            nodes_[node].first = uint32_t(begin);
            nodes_[node].count = uint32_t(n);
            // Ascending ids: what a leaf finds does not depend on the order of partitions.
            std::sort(refs_.begin() + begin, refs_.begin() + end,
                      [](const auto& a, const auto& b) { return a.shape < b.shape; });
            return;
        }
        const size_t left = node + 1, right = node + 2 * (middle - begin);
        nodes_[node].left = uint32_t(left);
        nodes_[node].right = uint32_t(right);
        const auto build_left = [&] { build_range(begin, middle, left, depth + 1); };
        const auto build_right = [&] { build_range(middle, end, right, depth + 1); };
        if (n >= parallel_size) {
            parallel_invoke(build_left, build_right);
        } else {
            build_left();
            build_right();
        }
    }

    void measure(size_t begin, size_t end, Bounds3& bounds, Bounds3& centroids,
                 double& cost_sum) const {
        for (size_t i = begin; i < end; ++i) {
            const BuildReference& r = refs_[i];
            bounds.extend(r.bounds);
            centroids.extend(Vec3f(r.bounds.lower + r.bounds.upper));
            cost_sum += r.cost;
        }
    }

    /// Reorders the range so that the left child's references come first.
    /// @return the first of the right child's, or `begin` for a leaf
    size_t partition(size_t begin, size_t end, const Bounds3& bounds, const Bounds3& centroids,
                     double cost_sum, int depth) {
        const uint32_t n = uint32_t(end - begin);
        const double leaf_cost = n <= max_leaf_size_ ? costs_.leaf(cost_sum, n)
                                                     : std::numeric_limits<double>::infinity();
        Split split;
        const Binning binning(centroids, std::min<int>(bins_, std::max<int>(4, int(n))));
        if (depth < median_depth) split = best_split(begin, end, bounds, binning);
        if (split.axis < 0) return n <= max_leaf_size_ ? begin : halve(begin, end, centroids);
        if (leaf_cost <= split.cost) return begin;
        const auto middle = std::partition(
            refs_.begin() + begin, refs_.begin() + end,
            [&](const BuildReference& r) { return binning.of(r, split.axis) < split.bin; });
        return size_t(middle - refs_.begin());
    }

    Split best_split(size_t begin, size_t end, const Bounds3& bounds,
                     const Binning& binning) const {
        BinTable table;
        for (int a = 0; a < 3; ++a) std::fill_n(table[a].begin(), binning.bins, Bin());
        for (size_t i = begin; i < end; ++i)
            for (int a = 0; a < 3; ++a) table[a][binning.of(refs_[i], a)].add(refs_[i]);

        Split best;
        const double area = half_area(bounds);
        for (int a = 0; a < 3; ++a)
            if (binning.scale[a] > 0) sweep(table[a], a, area, binning.bins, best);
        return best;
    }

    void sweep(const std::array<Bin, max_bins>& bins, int axis, double area, int n,
               Split& best) const {
        std::array<double, max_bins> right_cost;
        Bin right;
        for (int b = n - 1; b > 0; --b) {
            right.add(bins[b]);
            right_cost[b] = half_area(right.bounds) * costs_.leaf(right.cost, right.count);
            if (right.count == 0) right_cost[b] = -1;
        }
        Bin left;
        for (int b = 1; b < n; ++b) {
            left.add(bins[b - 1]);
            if (left.count == 0 || right_cost[b] < 0) continue;
            const double children =
                half_area(left.bounds) * costs_.leaf(left.cost, left.count) + right_cost[b];
            // A flat box of no area is met by no line: any split of it is as good.
            const double cost = costs_.node + (area > 0 ? children / area : 0.0);
            if (cost < best.cost) best = {cost, axis, b};
        }
    }

    size_t halve(size_t begin, size_t end, const Bounds3& centroids) {
        int axis;
        (centroids.upper - centroids.lower).maxCoeff(&axis);
        const size_t middle = begin + (end - begin) / 2;
        std::nth_element(refs_.begin() + begin, refs_.begin() + middle, refs_.begin() + end,
                         [axis](const BuildReference& a, const BuildReference& b) {
                             const float ca = centroid2(a, axis), cb = centroid2(b, axis);
                             return ca != cb ? ca < cb : a.shape < b.shape;
                         });
        return middle;
    }

    std::vector<BuildReference> refs_;
    TreeCosts costs_;
    int bins_;
    uint32_t max_leaf_size_;
    BinaryTree::Node* nodes_ = nullptr;
};

}  // namespace

BinaryTree build_binned(std::vector<BuildReference> references, const TreeCosts& costs, int bins,
                        int max_leaf_size) {
    return BinnedBuilder(std::move(references), costs, bins, max_leaf_size).build();
}

double expected_cost(const BinaryTree& tree, const TreeCosts& costs,
                     std::span<const float> cost_of_shape) {
    if (tree.empty()) return 0;
    const double root_area = half_area(tree.nodes[0].bounds);
    double sum = 0;
    std::vector<uint32_t> open{0};
    while (!open.empty()) {
        const BinaryTree::Node& node = tree.nodes[open.back()];
        open.pop_back();
        const double probability = root_area > 0 ? half_area(node.bounds) / root_area : 1.0;
        if (node.leaf()) {
            double shapes = 0;
            for (uint32_t i = 0; i < node.count; ++i)
                shapes += cost_of_shape[tree.order[node.first + i]];
            sum += probability * costs.leaf(shapes, node.count);
        } else {
            sum += probability * costs.node;
            open.push_back(node.left);
            open.push_back(node.right);
        }
    }
    return sum;
}

}  // namespace crofton
