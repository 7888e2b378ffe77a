#include "accelerators/shape_clusters.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "accelerators/tree_build.h"

namespace crofton {
namespace {

/// Whether each node's shapes form one cluster; children come after their parents in `order`. A
/// node takes in all clusters below it, so that one stray pair does not keep its surroundings
/// apart.
std::vector<uint8_t> merged_nodes(const BinaryTree& tree, const std::vector<uint32_t>& order,
                                  double merge_ratio) {
    std::vector<uint8_t> merged(tree.nodes.size(), 0);
    std::vector<double> clusters(tree.nodes.size(), 0);  // area of all clusters below
    for (size_t k = order.size(); k-- > 0;) {
        const BinaryTree::Node& node = tree.nodes[order[k]];
        const double area = half_area(node.bounds);
        const double apart = node.leaf() ? area : clusters[node.left] + clusters[node.right];
        merged[order[k]] = node.leaf() || area <= merge_ratio * apart;
        clusters[order[k]] = merged[order[k]] ? area : apart;
    }
    return merged;
}

ShapeCluster cluster_below(const BinaryTree& tree, uint32_t root) {
    ShapeCluster cluster;
    cluster.bounds = tree.nodes[root].bounds;
    std::vector<uint32_t> open{root};
    while (!open.empty()) {
        const BinaryTree::Node& node = tree.nodes[open.back()];
        open.pop_back();
        if (node.leaf())
            cluster.shapes.insert(cluster.shapes.end(), tree.order.begin() + node.first,
                                  tree.order.begin() + node.first + node.count);
        else
            open.insert(open.end(), {node.left, node.right});
    }
    std::sort(cluster.shapes.begin(), cluster.shapes.end());
    return cluster;
}

class UnionFind {
  public:
    explicit UnionFind(size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0u); }
    uint32_t find(uint32_t i) {
        while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
        return i;
    }
    /// The lower one represents both, so that the result does not depend on the order.
    void unite(uint32_t a, uint32_t b) {
        a = find(a), b = find(b);
        parent_[std::max(a, b)] = std::min(a, b);
    }

  private:
    std::vector<uint32_t> parent_;
};

/// Appends the connected components of `members`, which are indices of references.
void connect(const BuildReferences& references, const std::vector<uint32_t>& members,
             const Vec3d& lower, double edge, uint32_t size_class,
             std::vector<ShapeCluster>& clusters) {
    std::unordered_map<uint64_t, uint32_t> owner;
    UnionFind sets(members.size());
    for (uint32_t m = 0; m < members.size(); ++m) {
        const Bounds3& b = references[members[m]].bounds;
        uint64_t first[3], last[3];
        for (int a = 0; a < 3; ++a) {
            first[a] = uint64_t(std::max(0.0, (b.lower[a] - lower[a]) / edge));
            last[a] = uint64_t(std::max(0.0, (b.upper[a] - lower[a]) / edge));
        }
        for (uint64_t z = first[2]; z <= last[2]; ++z)
            for (uint64_t y = first[1]; y <= last[1]; ++y)
                for (uint64_t x = first[0]; x <= last[0]; ++x) {
                    const auto [it, fresh] = owner.try_emplace((z << 42) | (y << 21) | x, m);
                    if (!fresh) sets.unite(m, it->second);
                }
    }
    std::unordered_map<uint32_t, size_t> place;
    for (uint32_t m = 0; m < members.size(); ++m) {
        const auto [it, fresh] = place.try_emplace(sets.find(m), clusters.size());
        if (fresh) clusters.emplace_back().size_class = size_class;
        ShapeCluster& cluster = clusters[it->second];
        cluster.bounds.extend(references[members[m]].bounds);
        cluster.shapes.push_back(references[members[m]].shape);
    }
}

}  // namespace

std::vector<ShapeCluster> clusters_by_place(BuildReferences references, double merge_ratio) {
    const BinaryTree tree = build_binned(std::move(references), TreeCosts{}, 16, 4);
    std::vector<uint32_t> order{0};
    for (size_t k = 0; k < order.size(); ++k)
        if (const BinaryTree::Node& node = tree.nodes[order[k]]; !node.leaf())
            order.insert(order.end(), {node.left, node.right});
    const std::vector<uint8_t> merged = merged_nodes(tree, order, merge_ratio);

    std::vector<ShapeCluster> clusters;
    std::vector<uint32_t> open{0};
    while (!open.empty()) {
        const uint32_t i = open.back();
        open.pop_back();
        if (merged[i])
            clusters.push_back(cluster_below(tree, i));
        else
            open.insert(open.end(), {tree.nodes[i].right, tree.nodes[i].left});
    }
    return clusters;
}

std::vector<ShapeCluster> clusters_by_size(const BuildReferences& references, int classes) {
    Bounds3 all;
    for (const BuildReference& r : references) all.extend(r.bounds);
    // Buckets are no finer than 2^-20 of the scene, so that three indices fit a key.
    const double scene =
        std::max<double>((all.upper.cast<double>() - all.lower.cast<double>()).maxCoeff(),
                         std::numeric_limits<float>::min());
    std::vector<double> size(references.size());
    for (size_t i = 0; i < references.size(); ++i) {
        const Bounds3& b = references[i].bounds;
        size[i] =
            std::max((b.upper.cast<double>() - b.lower.cast<double>()).maxCoeff(), 0x1p-20 * scene);
    }
    std::vector<double> sorted = size;
    std::sort(sorted.begin(), sorted.end());
    const double least = sorted[sorted.size() / 20], octaves = std::log2(sorted.back() / least);
    const int n = std::clamp(1 + int(octaves / 2), 1, classes);

    std::vector<std::vector<uint32_t>> members(n);
    std::vector<double> edge(n, 0);
    for (uint32_t i = 0; i < references.size(); ++i) {
        const double octave = std::max(0.0, std::log2(size[i] / least));
        const int k = octaves > 0 ? std::min(n - 1, int(octave / octaves * n)) : 0;
        members[k].push_back(i);
        edge[k] = std::max(edge[k], size[i]);
    }
    std::vector<ShapeCluster> clusters;
    for (int k = 0; k < n; ++k)
        connect(references, members[k], all.lower.cast<double>(), edge[k], uint32_t(k), clusters);
    return clusters;
}

}  // namespace crofton
