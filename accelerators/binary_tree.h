#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "framework/bounds.h"

namespace crofton {

/// One shape as a builder sees it.
struct BuildReference {
    Bounds3 bounds;  ///< not empty, finite
    uint32_t shape;  ///< index in the set
    float cost;      ///< nominal ns of one test
};

/// A binary hierarchy in the making; structures copy what they need from it.
struct BinaryTree {
    struct Node {
        Bounds3 bounds;
        uint32_t left = 0, right = 0;   ///< children, if count = 0
        uint32_t first = 0, count = 0;  ///< leaf: a range of `order`
        bool leaf() const { return count > 0; }
    };
    std::vector<Node> nodes;      ///< the root first; may have unused entries
    std::vector<uint32_t> order;  ///< shapes, leaf by leaf
    bool empty() const { return nodes.empty(); }
};

/// What leaves and nodes cost, in nominal nanoseconds.
struct TreeCosts {
    double node = 3.0;   ///< testing both children
    int leaf_width = 1;  ///< shapes tested at once; 1: a leaf costs the sum of its shapes' costs
    double leaf_block = 0.0;  ///< of leaf_width shapes at once
    double leaf(double sum, uint32_t count) const {
        return leaf_width > 1 ? leaf_block * ((count + leaf_width - 1) / leaf_width) : sum;
    }
};

/// References of all active shapes of a set. @param clip  what to leave out of every bound
template <class Set>
std::vector<BuildReference> build_references(const Set& set) {
    std::vector<BuildReference> references;
    references.reserve(set.size());
    for (uint32_t i = 0; i < set.size(); ++i)
        if (set.active(i)) references.push_back({set.bounds(i), i, float(set.cost(i))});
    return references;
}

/// Area heuristic (MacDonald & Booth 1990) evaluated at bins of centroids (Wald 2007: "On fast
/// construction of SAH-based bounding volume hierarchies"), top down, in parallel, O(N log N).
/// Deterministic for any number of threads. Where no split is possible (equal centroids) or the
/// tree gets deeper than 40 levels, references are halved by count, so that no tree is deeper
/// than 72.
BinaryTree build_binned(std::vector<BuildReference> references, const TreeCosts& costs, int bins,
                        int max_leaf_size);

/// Nominal ns of a random line that meets the root, by the area heuristic.
double expected_cost(const BinaryTree& tree, const TreeCosts& costs,
                     std::span<const float> cost_of_shape);

}  // namespace crofton
