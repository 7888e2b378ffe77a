#include "accelerators/binary_tree.h"

#include <algorithm>

#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr int rebuild_depth = 40;  // + 32 for halves of up to 2^32 leaves = BinaryTree::max_depth
static_assert(rebuild_depth + 32 == BinaryTree::max_depth);

/// Levels below each node, and depths; without recursion, for trees of any depth.
struct Levels {
    std::vector<uint32_t> parents_first;
    std::vector<uint32_t> depth, height;

    explicit Levels(const BinaryTree& tree) : depth(tree.nodes.size()), height(tree.nodes.size()) {
        parents_first.reserve(tree.nodes.size());
        std::vector<uint32_t> open{0};
        while (!open.empty()) {
            const uint32_t i = open.back();
            open.pop_back();
            parents_first.push_back(i);
            const BinaryTree::Node& node = tree.nodes[i];
            if (node.leaf()) continue;
            for (const uint32_t child : {node.right, node.left}) {
                depth[child] = depth[i] + 1;
                open.push_back(child);
            }
        }
        for (auto i = parents_first.rbegin(); i != parents_first.rend(); ++i) {
            const BinaryTree::Node& node = tree.nodes[*i];
            if (!node.leaf()) height[*i] = 1 + std::max(height[node.left], height[node.right]);
        }
    }
};

bool is_too_deep(const BinaryTree& tree) {
    std::vector<std::pair<uint32_t, int>> open{{0, 0}};
    while (!open.empty()) {
        const auto [i, depth] = open.back();
        open.pop_back();
        if (depth > BinaryTree::max_depth) return true;
        const BinaryTree::Node& node = tree.nodes[i];
        if (node.leaf()) continue;
        open.emplace_back(node.right, depth + 1);
        open.emplace_back(node.left, depth + 1);
    }
    return false;
}

/// Rebuilds one subtree as halves, from the same leaves and inner nodes.
class Rebalance {
  public:
    Rebalance(BinaryTree& tree, uint32_t root) : nodes_(tree.nodes) {
        std::vector<uint32_t> open{root};
        while (!open.empty()) {
            const uint32_t i = open.back();
            open.pop_back();
            (nodes_[i].leaf() ? leaves_ : inner_).push_back(i);
            if (nodes_[i].leaf()) continue;
            open.push_back(nodes_[i].right);
            open.push_back(nodes_[i].left);
        }
        // The root is the first inner node taken, so it stays where its parent looks for it.
        next_inner_ = 0;
        halve(0, leaves_.size());
    }

  private:
    uint32_t halve(size_t begin, size_t end) {
        if (end - begin == 1) return leaves_[begin];
        const uint32_t node = inner_[next_inner_++];
        Bounds3 centroids;
        for (size_t i = begin; i < end; ++i) {
            const Bounds3& b = nodes_[leaves_[i]].bounds;
            centroids.extend(Vec3f(b.lower + b.upper));
        }
        int axis;
        (centroids.upper - centroids.lower).maxCoeff(&axis);
        const size_t middle = begin + (end - begin) / 2;
        const auto at = [&](size_t i) { return leaves_.begin() + ptrdiff_t(i); };
        std::nth_element(at(begin), at(middle), at(end), [&](uint32_t a, uint32_t b) {
            const float ca = centroid2(nodes_[a].bounds, axis),
                        cb = centroid2(nodes_[b].bounds, axis);
            return ca != cb ? ca < cb : nodes_[a].first < nodes_[b].first;
        });
        const uint32_t left = halve(begin, middle), right = halve(middle, end);
        nodes_[node].make_inner(left, right);
        nodes_[node].bounds = merge(nodes_[left].bounds, nodes_[right].bounds);
        return node;
    }

    RawAlignedVector<BinaryTree::Node>& nodes_;
    std::vector<uint32_t> leaves_, inner_;
    size_t next_inner_ = 0;
};

/// See collapse_leaves. Recursion is as deep as the tree, which is bounded.
class Collapse {
  public:
    Collapse(const BinaryTree& tree, const TreeCosts& costs, std::span<const float> cost_of_shape,
             uint32_t max_leaf_size)
        : tree_(tree),
          costs_(costs),
          cost_of_shape_(cost_of_shape),
          max_leaf_size_(max_leaf_size),
          parallel_levels_(parallel_levels(tree.nodes.size())),
          sizes_(tree.nodes.size()) {}

    BinaryTree run() {
        Shapes shapes;
        const Subtree all = weigh(0, 0, shapes.data());
        BinaryTree out;
        out.nodes.resize(all.size.nodes);
        out.order.resize(all.size.references);
        out_ = &out;
        emit(0, 0, 0, 0);
        return out;
    }

  private:
    /// Of a subtree after collapsing.
    struct Size {
        uint32_t nodes;  // 1: a leaf
        uint32_t references;
        bool one_block;  // of a leaf
    };
    struct Subtree {
        double cost;    // times area
        double leaf;    // of all its references, were they one leaf
        double shapes;  // sum of the costs of their shapes
        Size size;
    };
    /// Of two small subtrees, side by side.
    using Shapes = std::array<uint32_t, size_t{2} * TreeCosts::most_counted>;

    /// @param list  receives the shapes, with repeats, of a subtree of TreeCosts::most_counted
    ///              references at most
    Subtree weigh(uint32_t i, int depth, uint32_t* list) {
        const BinaryTree::Node& node = tree_.nodes[i];
        const Subtree s = node.leaf() ? weigh_leaf(node, list) : weigh_inner(node, depth, list);
        sizes_[i] = s.size;
        sizes_[i].one_block = s.leaf == costs_.leaf_block;
        return s;
    }

    Subtree weigh_leaf(const BinaryTree::Node& node, uint32_t* list) const {
        Subtree s{0, 0, 0, {1, node.count, false}};
        const std::span shapes = std::span(tree_.order).subspan(node.first, node.count);
        if (costs_.leaf_width == 1)
            for (const uint32_t shape : shapes) s.shapes += cost_of_shape_[shape];
        if (shapes.size() <= TreeCosts::most_counted) std::copy(shapes.begin(), shapes.end(), list);
        s.leaf = costs_.leaf(s.shapes, shapes);
        s.cost = half_area(node.bounds) * s.leaf;
        return s;
    }

    Subtree weigh_inner(const BinaryTree::Node& node, int depth, uint32_t* list) {
        Shapes beside;
        Subtree l, r;
        invoke_both(
            depth < parallel_levels_, [&] { l = weigh(node.left, depth + 1, list); },
            [&] { r = weigh(node.right, depth + 1, beside.data()); });
        const double area = half_area(node.bounds);
        const Size size{1 + l.size.nodes + r.size.nodes, l.size.references + r.size.references,
                        false};
        Subtree s{area * costs_.node + l.cost + r.cost, 0, l.shapes + r.shapes, size};
        if (size.references > max_leaf_size_) return s;
        if (costs_.blocks && size.references > TreeCosts::most_counted) {
            s.leaf = l.leaf + r.leaf;
        } else {
            if (size.references <= TreeCosts::most_counted)
                std::copy_n(beside.data(), r.size.references, list + l.size.references);
            s.leaf = costs_.blocks ? costs_.leaf(s.shapes, std::span(list, size.references))
                                   : costs_.leaf(s.shapes, size.references);
        }
        if (area * s.leaf <= s.cost) s.cost = area * s.leaf, s.size.nodes = 1;
        return s;
    }

    void emit(uint32_t i, uint32_t to, uint32_t first, int depth) {
        const BinaryTree::Node& node = tree_.nodes[i];
        BinaryTree::Node& out = out_->nodes[to];
        out.bounds = node.bounds;
        if (sizes_[i].nodes == 1) {
            uint32_t* const begin = out_->order.data() + first;
            uint32_t* end = gather(i, begin);
            // Ascending ids: what a leaf finds does not depend on how it was made. Parts of one
            // shape that meet again in a leaf are one.
            std::sort(begin, end);
            end = std::unique(begin, end);
            out.make_leaf(first, size_t(end - begin));
            // How many blocks shapes fill may depend on their order, but not whether one is enough.
            if (costs_.blocks) out.blocks() = sizes_[i].one_block ? 1 : costs_.blocks({begin, end});
            return;
        }
        out.make_inner(to + 1, to + 1 + sizes_[node.left].nodes);
        const uint32_t right_first = first + sizes_[node.left].references;
        invoke_both(
            depth < parallel_levels_, [&] { emit(node.left, out.left, first, depth + 1); },
            [&] { emit(node.right, out.right, right_first, depth + 1); });
    }

    /// Shapes of a subtree, with repeats. @return behind the last
    uint32_t* gather(uint32_t i, uint32_t* to) const {
        const BinaryTree::Node& node = tree_.nodes[i];
        if (!node.leaf()) return gather(node.right, gather(node.left, to));
        return std::copy_n(tree_.order.data() + node.first, node.count, to);
    }

    const BinaryTree& tree_;
    const TreeCosts& costs_;
    std::span<const float> cost_of_shape_;
    uint32_t max_leaf_size_;
    int parallel_levels_;
    RawAlignedVector<Size> sizes_;
    BinaryTree* out_ = nullptr;
};

BinaryTree run_builder(BuildReferences references, const ShapeClipper& clipper,
                       const TreeParameters& p, const TreeCosts& costs) {
    switch (p.builder) {
        case TreeBuilder::median:
            return build_median(std::move(references));
        case TreeBuilder::sweep_sah:
            return build_sweep(std::move(references), costs);
        case TreeBuilder::sbvh:
            return build_split(std::move(references), clipper, p, costs);
        case TreeBuilder::ploc:
            return build_clustered(std::move(references), p.ploc_radius);
        case TreeBuilder::lbvh:
            // What is tested at once anyway.
            return build_morton(
                std::move(references),
                p.reinsertion > 0 ? 1 : std::min(p.max_leaf_size, std::max(1, costs.leaf_width)));
        case TreeBuilder::insertion:
            return build_inserted(std::move(references), p.insertion_order);
        case TreeBuilder::binned_sah:
            break;
    }
    // Moving subtrees gains most where every shape can move by itself.
    const int leaf_size = p.reinsertion > 0 ? 1 : p.max_leaf_size;
    return build_binned(std::move(references), costs, p.bins, leaf_size);
}

}  // namespace

bool limit_depth(BinaryTree& tree) {
    if (tree.empty() || !is_too_deep(tree)) return false;
    const Levels levels(tree);
    for (const uint32_t i : levels.parents_first)
        if (levels.depth[i] == uint32_t(rebuild_depth) &&
            levels.height[i] > uint32_t(BinaryTree::max_depth - rebuild_depth))
            Rebalance(tree, i);
    return true;
}

void collapse_leaves(BinaryTree& tree, const TreeCosts& costs, std::span<const float> cost_of_shape,
                     int max_leaf_size) {
    if (tree.empty()) return;
    tree = Collapse(tree, costs, cost_of_shape, uint32_t(max_leaf_size)).run();
}

BinaryTree build_tree(BuildReferences references, const ShapeClipper& clipper,
                      const TreeParameters& p, const TreeCosts& costs) {
    if (references.empty()) return {};
    std::vector<float> cost_of_shape;
    if (costs.leaf_width == 1) {
        cost_of_shape.resize(references.back().shape + 1);
        for (const BuildReference& r : references) cost_of_shape[r.shape] = r.cost;
    }
    BinaryTree tree = run_builder(std::move(references), clipper, p, costs);
    // The others count their levels.
    if (p.builder == TreeBuilder::ploc || p.builder == TreeBuilder::insertion) limit_depth(tree);
    reinsert(tree, p.reinsertion);
    collapse_leaves(tree, costs, cost_of_shape, p.max_leaf_size);
    return tree;
}

double inner_area(const BinaryTree& tree) {
    double sum = 0;
    std::vector<uint32_t> open;
    if (!tree.empty()) open.push_back(0);
    while (!open.empty()) {
        const BinaryTree::Node& node = tree.nodes[open.back()];
        open.pop_back();
        if (node.leaf()) continue;
        sum += half_area(node.bounds);
        open.push_back(node.left);
        open.push_back(node.right);
    }
    return sum;
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
            if (costs.leaf_width == 1)
                for (uint32_t i = 0; i < node.count; ++i)
                    shapes += cost_of_shape[tree.order[node.first + i]];
            sum += probability *
                   costs.leaf(shapes, std::span(tree.order).subspan(node.first, node.count));
        } else {
            sum += probability * costs.node;
            open.push_back(node.left);
            open.push_back(node.right);
        }
    }
    return sum;
}

}  // namespace crofton
