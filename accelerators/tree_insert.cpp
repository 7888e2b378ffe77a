#include <algorithm>
#include <cmath>

#include "accelerators/box4.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

// Steps down the tree: shapes in a bad order would make a list, and what is deeper is rebuilt
// anyway.
constexpr int most_steps = BinaryTree::max_depth;

/// A permutation that is the same on every platform (PCG32, O'Neill 2014; Fisher & Yates).
std::vector<uint32_t> shuffled(size_t n) {
    std::vector<uint32_t> order(n);
    for (size_t i = 0; i < n; ++i) order[i] = uint32_t(i);
    uint64_t state = 0x853c49e6748fea9bull;
    for (size_t i = n; i > 1; --i) {
        state = state * 6364136223846793005ull + 1442695040888963407ull;
        const uint32_t x = uint32_t(((state >> 18) ^ state) >> 27), r = uint32_t(state >> 59);
        const uint64_t random = (x >> r) | (x << ((32 - r) & 31));
        std::swap(order[i - 1], order[size_t(random * i >> 32)]);
    }
    return order;
}

class Inserter {
  public:
    explicit Inserter(std::span<const BuildReference> references) : refs_(references) {
        const size_t n = refs_.size();
        tree_.nodes.reserve(2 * n - 1);
        tree_.order.resize(n);
        for (size_t i = 0; i < n; ++i) tree_.order[i] = refs_[i].shape;
    }

    void insert(uint32_t reference) {
        const uint32_t leaf = add_node(refs_[reference].bounds);
        tree_.nodes[leaf].make_leaf(reference, 1);
        if (leaf == 0) return;
        // The node that the new leaf becomes the sibling of keeps its place in its parent: it is
        // moved to a new index, and its old one becomes the parent of both.
        const uint32_t at = descend(refs_[reference].bounds);
        const uint32_t old = uint32_t(tree_.nodes.size());
        tree_.nodes.push_back(tree_.nodes[at]);
        BinaryTree::Node& parent = tree_.nodes[at];
        parent.bounds.extend(refs_[reference].bounds);
        parent.make_inner(old, leaf);
    }
    BinaryTree take() { return std::move(tree_); }

  private:
    uint32_t add_node(const Bounds3& bounds) {
        tree_.nodes.emplace_back();
        tree_.nodes.back().bounds = bounds;
        return uint32_t(tree_.nodes.size() - 1);
    }

    /// Where the sum of areas grows least, going down greedily; extends the boxes passed.
    uint32_t descend(const Bounds3& box) {
        uint32_t i = 0;
        for (int step = 0; step < most_steps; ++step) {
            BinaryTree::Node& node = tree_.nodes[i];
            if (node.leaf()) break;
            const double merged = half_area(merge(node.bounds, box));
            const double growth = merged - half_area(node.bounds);
            const double left = child_cost(node.left, box), right = child_cost(node.right, box);
            if (merged < growth + std::min(left, right)) break;
            node.bounds.extend(box);
            i = left <= right ? node.left : node.right;
        }
        return i;
    }
    double child_cost(uint32_t i, const Bounds3& box) const {
        const BinaryTree::Node& node = tree_.nodes[i];
        const double merged = half_area(merge(node.bounds, box));
        return node.leaf() ? merged : merged - half_area(node.bounds);
    }

    std::span<const BuildReference> refs_;
    BinaryTree tree_;
};

}  // namespace

BinaryTree build_inserted(BuildReferences references, InsertionOrder order) {
    Inserter inserter(references);
    std::vector<uint32_t> list;
    if (order == InsertionOrder::shuffled) list = shuffled(references.size());
    if (order == InsertionOrder::morton) list = morton_order(references);
    for (uint32_t i = 0; i < references.size(); ++i) inserter.insert(list.empty() ? i : list[i]);
    return inserter.take();
}

}  // namespace crofton
