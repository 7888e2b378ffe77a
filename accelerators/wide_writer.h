#pragma once

#include <array>

#include "accelerators/wide_bvh.h"
#include "accelerators/wide_collapse.h"
#include "framework/parallel.h"

namespace crofton {

/// The children of a wide node in the making.
struct WideChildren {
    std::array<Bounds3, max_wide_width> bounds;
    std::array<uint32_t, max_wide_width> child;  ///< WideChild
    size_t count = 0;
};

template <int W>
void set_node(WideNode<W>& node, const WideChildren& children) {
    for (int i = 0; i < W; ++i) {
        const bool used = size_t(i) < children.count;
        const Bounds3 b = used ? children.bounds[size_t(i)] : Bounds3();
        for (int a = 0; a < 3; ++a) {
            node.planes[0][a][i] = b.lower[a];
            node.planes[1][a][i] = b.upper[a];
        }
        node.child[i] = used ? children.child[size_t(i)] : WideChild::leaf_bit;
    }
}

/// Bytes that contain each child with a hundredth of a step to spare, for the rounding of
/// traversal.
template <int W>
void set_node(QuantisedNode<W>& node, const WideChildren& children) {
    Bounds3 whole;
    for (size_t i = 0; i < children.count; ++i) whole.extend(children.bounds[i]);
    node = {};
    node.children = uint32_t(children.count);
    std::copy_n(children.child.begin(), children.count, node.child);
    for (int a = 0; a < 3; ++a) {
        const double extent = double(whole.upper[a]) - whole.lower[a];
        // One step to spare at each end; at least the spacing of floats there.
        const double scale = std::max({extent / 253, double(std::abs(whole.lower[a])) * 0x1p-22,
                                       double(std::numeric_limits<float>::min())});
        node.scale[a] = float(scale * (1 + 1e-6));
        node.origin[a] = float(double(whole.lower[a]) - node.scale[a]);
        for (size_t i = 0; i < children.count; ++i) {
            const Bounds3& b = children.bounds[i];
            const double lo = (double(b.lower[a]) - node.origin[a]) / node.scale[a] - 0.01;
            const double hi = (double(b.upper[a]) - node.origin[a]) / node.scale[a] + 0.01;
            node.planes[0][a][i] = uint8_t(std::clamp(std::floor(lo), 0.0, 255.0));
            node.planes[1][a][i] = uint8_t(std::clamp(std::ceil(hi), 0.0, 255.0));
        }
    }
}

/// What leaves are written from.
template <class Set>
using PackedFrom = std::conditional_t<std::is_same_v<Set, TriangleSet>, PatchCorners, const Set&>;

/// Writes a binary tree as wide nodes: first it is measured what every subtree takes, then each is
/// written where it belongs, near the root of a large tree those of one node at once.
template <class Set, class Node>
class WideWriter {
    using Collapse = WideCollapse<Node::width>;

  public:
    WideWriter(WideBvh<Set>& bvh, const BinaryTree& tree, const Collapse& collapse,
               const PackedFrom<Set>& corners)
        : leaves_(bvh.leaves),
          stats_(bvh.stats),
          nodes_(bvh.nodes),
          tree_(tree),
          collapse_(collapse),
          corners_(corners),
          parallel_levels_(parallel_levels(tree.nodes.size()) / 2),
          sizes_(tree.nodes.size()) {}

    void write() {
        const Size all = measure(0, 0);
        if (all.blocks >= WideChild::max_first)
            throw InputError("wide_bvh: more leaves than 2^26; use bvh");
        stats_.N_IN = all.nodes + 1;
        stats_.N_V = all.leaves;
        stats_.N_OIV = all.shapes;
        stats_.depth = all.height;
        written_ = nodes_.template resize<Node>(all.nodes + 1);
        if constexpr (triangles)
            leaves_.resize(all.blocks, all.ids);
        else
            leaves_.resize(all.shapes);
        write(0, 0, {1, 0, 0}, 0);
    }

  private:
    static constexpr bool triangles = std::is_same_v<Set, TriangleSet>;
    /// Below a wide node. Blocks are patches or references; ids those that patches list.
    struct Size {
        uint32_t nodes, blocks, ids, shapes, leaves, height;
    };
    /// Where the next node, block and id go.
    struct Place {
        uint32_t node, block, id;
        void skip(const Size& s) {
            node += s.nodes;
            block += s.blocks;
            id += s.ids;
        }
    };

    static uint32_t blocks(const BinaryTree::Node& leaf) {
        return triangles ? leaf.blocks() : leaf.count;
    }
    std::span<const uint32_t> shapes(const BinaryTree::Node& leaf) const {
        return {tree_.order.data() + leaf.first, leaf.count};
    }
    template <class Body>
    void for_each(size_t n, int depth, const Body& body) const {
        if (depth < parallel_levels_)
            return parallel_for(n, 1, [&](size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) body(i);
            });
        for (size_t i = 0; i < n; ++i) body(i);
    }

    /// Recursion is as deep as the tree, which is bounded.
    Size measure(uint32_t n, int depth) {
        const typename Collapse::Children children = collapse_.children(n);
        std::array<Size, Node::width> sizes;
        for_each(children.count, depth, [&](size_t i) {
            const BinaryTree::Node& node = tree_.nodes[children.node[i]];
            if (node.leaf()) {
                sizes[i] = {0, blocks(node), TrianglePatches::listed_ids(node.count), node.count, 1,
                            1};
            } else {
                sizes[i] = measure(children.node[i], depth + 1);
                ++sizes[i].nodes;
                ++sizes[i].height;
            }
        });
        Size sum{};
        for (size_t i = 0; i < children.count; ++i) {
            sum.nodes += sizes[i].nodes;
            sum.blocks += sizes[i].blocks;
            sum.ids += sizes[i].ids;
            sum.shapes += sizes[i].shapes;
            sum.leaves += sizes[i].leaves;
            sum.height = std::max(sum.height, sizes[i].height);
        }
        return sizes_[n] = sum;
    }

    /// A node's leaves come first and its children side by side, then their subtrees.
    /// @param to     of the node itself
    /// @param place  of all below it
    void write(uint32_t n, uint32_t to, Place place, int depth) {
        const typename Collapse::Children children = collapse_.children(n);
        WideChildren list;
        struct Subtree {
            uint32_t from, to;
            Place place;
        };
        std::array<Subtree, Node::width> subtrees;
        size_t inner = 0;
        for (const uint32_t c : children) {
            const BinaryTree::Node& node = tree_.nodes[c];
            list.bounds[list.count] = node.bounds;
            uint32_t& child = list.child[list.count++];
            if (node.leaf()) {
                child = WideChild::leaf(place.block, blocks(node));
                if constexpr (triangles)
                    leaves_.put(corners_, shapes(node), place.block, place.id);
                else
                    leaves_.put(shapes(node), place.block);
                place.block += blocks(node);
                place.id += TrianglePatches::listed_ids(node.count);
            } else {
                child = place_of<Node>(place.node);
                subtrees[inner++] = {c, place.node++, {}};
            }
        }
        set_node(written_[to], list);
        for (size_t i = 0; i < inner; ++i) {
            subtrees[i].place = place;
            place.skip(sizes_[subtrees[i].from]);
        }
        for_each(inner, depth, [&](size_t i) {
            write(subtrees[i].from, subtrees[i].to, subtrees[i].place, depth + 1);
        });
    }

    WideLeaves<Set>& leaves_;
    StructureStatistics& stats_;
    WideNodes& nodes_;
    std::span<Node> written_;  // nodes_, once there is room
    const BinaryTree& tree_;
    const Collapse& collapse_;
    const PackedFrom<Set>& corners_;
    int parallel_levels_;
    RawAlignedVector<Size> sizes_;  // of what becomes a wide node
};

}  // namespace crofton
