#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "accelerators/box4.h"
#include "accelerators/morton.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 4096;  // fewer references are not worth a task

class MortonBuilder {
  public:
    MortonBuilder(BuildReferences references, size_t leaf_size)
        : refs_(std::move(references)), keys_(morton_keys(refs_)), leaf_size_(leaf_size) {}

    BinaryTree build() {
        BinaryTree tree;
        const size_t n = refs_.size();
        tree.nodes.resize(2 * n - 1);
        tree.order.resize(n);
        nodes_ = tree.nodes.data();
        parallel_for(n, 1 << 14, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) tree.order[i] = refs_[keys_.index(i)].shape;
        });
        build_range(0, n, 0, 0);
        return tree;
    }

  private:
    void build_range(size_t begin, size_t end, size_t node, int depth) {
        BinaryTree::Node& out = nodes_[node];
        if (end - begin <= leaf_size_) {
            Box4 box;
            for (size_t i = begin; i < end; ++i) box.extend(Box4(refs_[keys_.index(i)]));
            out.bounds = box.bounds();
            out.make_leaf(begin, end - begin);
            return;
        }
        const size_t middle = depth < median_depth ? split(begin, end) : begin + (end - begin) / 2;
        const size_t left = node + 1, right = node + 2 * (middle - begin);
        out.make_inner(left, right);
        const auto build_left = [&] { build_range(begin, middle, left, depth + 1); };
        const auto build_right = [&] { build_range(middle, end, right, depth + 1); };
        if (end - begin >= parallel_size) {
            parallel_invoke(build_left, build_right);
        } else {
            build_left();
            build_right();
        }
        out.bounds = merge(nodes_[left].bounds, nodes_[right].bounds);
    }

    /// Where the highest bit that differs goes from 0 to 1; the middle if none does.
    size_t split(size_t begin, size_t end) const {
        const bool differ = keys_.code(begin) != keys_.code(end - 1);
        return differ ? keys_.split(begin, end) : begin + (end - begin) / 2;
    }

    BuildReferences refs_;
    MortonKeys keys_;
    size_t leaf_size_;
    BinaryTree::Node* nodes_ = nullptr;
};

/// Merges clusters that are each other's nearest, in rounds.
class ClusterBuilder {
  public:
    ClusterBuilder(BuildReferences references, int radius)
        : refs_(std::move(references)), radius_(size_t(radius)) {}

    BinaryTree build() {
        const size_t n = refs_.size();
        tree_.nodes.resize(2 * n - 1);
        tree_.order.resize(n);
        next_inner_ = n - 1;
        const MortonKeys keys = morton_keys(refs_);
        clusters_.resize(n);
        for (size_t i = 0; i < n; ++i) {
            const BuildReference& r = refs_[keys.index(i)];
            BinaryTree::Node& leaf = tree_.nodes[n - 1 + i];
            leaf.bounds = r.bounds;
            leaf.make_leaf(i, 1);
            tree_.order[i] = r.shape;
            clusters_[i] = {r.bounds, uint32_t(n - 1 + i), 0};
        }
        set_scale();
        while (clusters_.size() > 1) round();
        return std::move(tree_);
    }

  private:
    /// As BuildReference, for Box4: `shape` is the node.
    using Cluster = BuildReference;

    /// A power of two makes areas of the order of 1: no product of extents overflows.
    void set_scale() {
        Bounds3 all;
        for (const Cluster& c : clusters_) all.extend(c.bounds);
        const float extent = all.extent().maxCoeff();
        const bool sane = extent > 0 && std::isfinite(extent);
        scale_ = std::ldexp(1.0f, sane ? std::clamp(-std::ilogb(extent), -120, 120) : 0);
    }

    void round() {
        const size_t n = clusters_.size();
        nearest_.resize(n);
        parallel_for(n, 512, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) nearest_[i] = uint32_t(find_nearest(i));
        });
        size_t pairs = 0;
        for (size_t i = 0; i < n; ++i) pairs += nearest_[nearest_[i]] == i;
        // In rows of growing gaps hardly any two are each other's nearest: then whoever comes
        // first.
        if (pairs < n / 8) match_greedily();
        size_t kept = 0;
        for (size_t i = 0; i < n; ++i) {
            const size_t j = nearest_[i];
            if (j == i || nearest_[j] != i)
                clusters_[kept++] = clusters_[i];
            else if (i < j)
                clusters_[kept++] = merged(clusters_[i], clusters_[j]);
        }
        clusters_.resize(kept);
    }

    /// Of equally near ones the pair with the lowest i xor j: both partners then choose alike, and
    /// equal clusters pair off at once.
    size_t find_nearest(size_t i) const {
        const size_t begin = i - std::min(i, radius_);
        const size_t end = std::min(clusters_.size(), i + radius_ + 1);
        const Box4 own(clusters_[i]);
        size_t best = i;
        float distance = std::numeric_limits<float>::infinity();
        for (size_t j = begin; j < end; ++j) {
            if (j == i) continue;
            Box4 both(clusters_[j]);
            both.extend(own);
            const float d = area(both);
            if (d < distance || (d == distance && (best == i || (i ^ j) < (i ^ best)))) {
                best = j;
                distance = d;
            }
        }
        return best;
    }
    float area(const Box4& b) const {
        const Box4::D d;
        const auto e = hn::Mul(hn::Sub(b.upper, b.lower), hn::Set(d, scale_));
        alignas(16) float p[4];
        hn::Store(e, d, p);
        return p[0] * p[1] + p[1] * p[2] + p[2] * p[0];
    }

    /// Each with its nearest if both are free, by index; the others with themselves.
    void match_greedily() {
        RawAlignedVector<uint32_t> partner(nearest_.size());
        for (size_t i = 0; i < partner.size(); ++i) partner[i] = uint32_t(i);
        for (size_t i = 0; i < partner.size(); ++i) {
            const uint32_t j = nearest_[i];
            if (partner[i] != i || partner[j] != j) continue;
            partner[i] = j;
            partner[j] = uint32_t(i);
        }
        nearest_.swap(partner);
    }

    /// Inner nodes are taken from the back, so that the last one is the root, 0.
    Cluster merged(const Cluster& a, const Cluster& b) {
        const uint32_t node = uint32_t(--next_inner_);
        BinaryTree::Node& out = tree_.nodes[node];
        out.bounds = merge(a.bounds, b.bounds);
        out.make_inner(a.shape, b.shape);
        return {out.bounds, node, 0};
    }

    BuildReferences refs_;
    size_t radius_;
    BinaryTree tree_;
    size_t next_inner_ = 0;
    float scale_ = 1;
    RawAlignedVector<Cluster> clusters_;  // in Morton order
    RawAlignedVector<uint32_t> nearest_;
};

}  // namespace

std::vector<uint32_t> morton_order(const BuildReferences& references) {
    const MortonKeys keys = morton_keys(references);
    std::vector<uint32_t> order(keys.size());
    for (size_t i = 0; i < keys.size(); ++i) order[i] = keys.index(i);
    return order;
}

BinaryTree build_morton(BuildReferences references, int leaf_size) {
    return MortonBuilder(std::move(references), size_t(leaf_size)).build();
}

BinaryTree build_clustered(BuildReferences references, int radius) {
    return ClusterBuilder(std::move(references), radius).build();
}

}  // namespace crofton
