#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "framework/aligned.h"
#include "framework/bounds.h"
#include "framework/parallel.h"

namespace crofton {

/// One shape, or after spatial splits a part of one, as a builder sees it.
struct BuildReference {
    Bounds3 bounds;  ///< not empty, finite
    uint32_t shape;  ///< index in the set
    float cost;      ///< nominal ns of one test
};
static_assert(sizeof(BuildReference) == 32);
/// Elements are not initialised.
using BuildReferences = RawAlignedVector<BuildReference>;

/// Box of the part of a shape inside a box, rounded outwards; empty if there is none.
using ClipShape = std::function<Bounds3(uint32_t shape, const Bounds3& box)>;

/// A binary hierarchy in the making; structures copy what they need from it.
struct BinaryTree {
    /// Edges from the root to a leaf at most, in any finished tree: what a stack must hold.
    static constexpr int max_depth = 72;

    struct Node {
        Bounds3 bounds;
        uint32_t left = 0, right = 0;   ///< children, if count = 0
        uint32_t first = 0, count = 0;  ///< leaf: a range of `order`
        bool leaf() const { return count > 0; }
        void make_leaf(size_t from, size_t n) {
            left = right = 0;
            first = uint32_t(from), count = uint32_t(n);
        }
        void make_inner(size_t l, size_t r) {
            left = uint32_t(l), right = uint32_t(r);
            first = count = 0;
        }
        /// Of a leaf of a finished tree, where TreeCosts::blocks tells: how many it fills.
        uint32_t& blocks() { return left; }
        uint32_t blocks() const { return left; }
    };
    RawAlignedVector<Node> nodes;      ///< the root first; may have unused, undefined entries
    RawAlignedVector<uint32_t> order;  ///< shapes, leaf by leaf; may have unused entries
    bool empty() const { return nodes.empty(); }
};

/// What leaves and nodes cost, in nominal nanoseconds.
struct TreeCosts {
    double node = 3.0;   ///< testing both children
    int leaf_width = 1;  ///< shapes tested at once; 1: a leaf costs the sum of its shapes' costs
    double leaf_block = 0.0;  ///< of leaf_width shapes at once
    double leaf_shape = 0.0;  ///< and of each of them, before that: fetching it
    /// How many blocks given shapes fill, where that depends on which; null: leaf_width tells.
    std::function<uint32_t(std::span<const uint32_t>)> blocks = {};
    static constexpr uint32_t most_counted = 8;  ///< shapes that `blocks` is asked about
    /// Whether builders ask it, too, before they make a leaf, which takes them longer: shapes
    /// differ in how many fill a block.
    bool blocks_vary = false;
    double leaf(double sum, uint32_t count) const {
        return leaf_width > 1
                   ? leaf_block * ((count + leaf_width - 1) / leaf_width) + leaf_shape * count
                   : sum;
    }
    /// Of a leaf of given shapes.
    double leaf(double sum, std::span<const uint32_t> shapes) const {
        return blocks && shapes.size() <= most_counted ? leaf_block * blocks(shapes)
                                                       : leaf(sum, uint32_t(shapes.size()));
    }
    /// Of a leaf of a finished tree.
    template <class Node>
    double finished_leaf(double sum, const Node& node) const {
        return blocks ? leaf_block * node.blocks() : leaf(sum, node.count);
    }
};

/// Levels of a tree of n nodes whose nodes have their children worked on at once.
inline int parallel_levels(size_t n) { return n < 8192 ? 0 : 6; }

/// Runs both, at once if that is worth while.
template <class A, class B>
void invoke_both(bool at_once, const A& a, const B& b) {
    if (at_once) {
        parallel_invoke(a, b);
    } else {
        a();
        b();
    }
}

/// Size of the chunks that n references are worked on in: it does not depend on the threads.
inline size_t chunk_size(size_t n) {
    constexpr size_t chunks = 16, least = 8192;
    return n < 2 * least ? std::max<size_t>(n, 1) : (n + chunks - 1) / chunks;
}

/// Sums chunks of [begin, end) with `body(begin, end) -> T` and T::add, in order of the chunks,
/// which do not depend on the number of threads: the same bits always.
template <class T, class Body>
T sum_chunks(size_t begin, size_t end, const Body& body) {
    const size_t n = end - begin, size = chunk_size(n);
    if (n <= size) return body(begin, end);
    const size_t chunks = (n + size - 1) / size;
    std::vector<T> parts(chunks);
    parallel_for(chunks, 1, [&](size_t from, size_t to) {
        for (size_t i = from; i < to; ++i)
            parts[i] = body(std::min(end, begin + i * size), std::min(end, begin + (i + 1) * size));
    });
    for (size_t i = 1; i < chunks; ++i) parts[0].add(parts[i]);
    return parts[0];
}

/// References of all active shapes of a set, ascending.
template <class Set>
BuildReferences build_references(const Set& set) {
    BuildReferences references(set.size());
    std::atomic<bool> some_empty = false;
    parallel_for(set.size(), 1 << 11, [&](size_t begin, size_t end) {
        bool empty = false;
        for (size_t i = begin; i < end; ++i) {
            const uint32_t shape = uint32_t(i);
            references[i] = set.active(shape)
                                ? BuildReference{set.bounds(shape), shape, float(set.cost(shape))}
                                : BuildReference{};
            empty = empty || references[i].bounds.empty();
        }
        if (empty) some_empty = true;
    });
    if (some_empty)
        std::erase_if(references, [](const BuildReference& r) { return r.bounds.empty(); });
    return references;
}

/// Costs of all shapes, by index in the set; empty where leaves are not costed by shape.
template <class Set>
std::vector<float> shape_costs(const Set& set, const TreeCosts& costs) {
    std::vector<float> list;
    if (costs.leaf_width > 1) return list;
    for (uint32_t i = 0; i < set.size(); ++i)
        list.push_back(set.active(i) ? float(set.cost(i)) : 0.0f);
    return list;
}

/// Nominal ns of a random line that meets the root, by the area heuristic.
/// @param cost_of_shape  by index in the set; read where costs.leaf_width is 1
double expected_cost(const BinaryTree& tree, const TreeCosts& costs,
                     std::span<const float> cost_of_shape);

}  // namespace crofton
