#pragma once

#include <array>

#include "accelerators/quick_tree.h"
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
/// @param quick  see PatchCorners
template <class Set>
PackedFrom<Set> packed_from(const Set& set, bool quick) {
    if constexpr (std::is_same_v<Set, TriangleSet>)
        return PatchCorners(set, quick);
    else
        return set;
}

/// Writes a binary tree as wide nodes: first it is found where everything goes, then all nodes are
/// written at once. The children of a node lie side by side and its leaves before theirs; then come
/// their subtrees.
template <class Set, class Node>
class WideWriter {
    using Collapse = WideCollapse<Node::width>;

  public:
    WideWriter(WideBvh<Set>& bvh, const BinaryTree& tree, const Collapse& collapse)
        : bvh_(bvh), tree_(tree), collapse_(collapse) {}

    /// With leaves written from `corners`.
    void write(const PackedFrom<Set>& corners) {
        find_places([](Place& place, const BinaryTree::Node& leaf) {
            place.block += blocks(leaf);
            place.id += listed_ids(leaf);
            return uint64_t(leaf.count);
        });
        if constexpr (triangles)
            bvh_.leaves.resize(end_.block, end_.id);
        else
            bvh_.leaves.resize(end_.block);
        write_nodes([&](Place& place, const BinaryTree::Node& leaf) {
            const std::span shapes(tree_.order.data() + leaf.first, leaf.count);
            const Place at = place;
            place.block += blocks(leaf);
            place.id += listed_ids(leaf);
            if constexpr (triangles)
                bvh_.leaves.put(corners, shapes, at.block, at.id);
            else
                bvh_.leaves.put(shapes, at.block);
            return WideChild::leaf(at.block, blocks(leaf));
        });
    }
    /// With the patches of a quick build, which are where they belong.
    void write(QuickTree& quick) {
        find_places([](Place& place, const BinaryTree::Node& leaf) {
            ++place.block;
            return uint64_t(leaf.count);
        });
        write_nodes(
            [](Place&, const BinaryTree::Node& leaf) { return WideChild::leaf(leaf.first, 1); });
        bvh_.leaves = TrianglePatches(std::move(quick.patches), std::move(quick.ids));
    }

  private:
    static constexpr bool triangles = std::is_same_v<Set, TriangleSet>;
    /// Where the next block and id go. Blocks are patches or references; ids those that patches
    /// list.
    struct Place {
        uint32_t block = 0, id = 0;
    };
    struct Wide {
        Place leaves;
        uint32_t children;  ///< where they begin in the list of all
        uint32_t count;     ///< of them
        uint32_t inner;     ///< index of the first that is an inner node; the others follow
    };

    static uint32_t blocks(const BinaryTree::Node& leaf) {
        return triangles ? leaf.blocks() : leaf.count;
    }
    static uint32_t listed_ids(const BinaryTree::Node& leaf) {
        return triangles ? TrianglePatches::listed_ids(leaf.count) : 0;
    }

    /// @param skip  of (Place&, leaf): moves the place behind a leaf. @return shapes in it
    template <class Skip>
    void find_places(const Skip& skip) {
        struct Open {
            uint32_t node, wide, depth;
        };
        StructureStatistics& stats = bvh_.stats;
        std::vector<Open> open{{0, 0, 1}};
        wide_.resize(1);
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            stats.depth = std::max<uint64_t>(stats.depth, o.depth);
            const auto list = collapse_.children(o.node);
            wide_[o.wide] = {end_, uint32_t(children_.size()), list.count, uint32_t(wide_.size())};
            children_.insert(children_.end(), list.begin(), list.end());
            const auto begin = ptrdiff_t(open.size());
            for (const uint32_t c : list) {
                const BinaryTree::Node& child = tree_.nodes[c];
                if (child.leaf()) {
                    stats.N_OIV += skip(end_, child);
                    ++stats.N_V;
                    continue;
                }
                open.push_back({c, uint32_t(wide_.size()), o.depth + 1});
                wide_.emplace_back();
            }
            // The first child's subtree comes first.
            std::reverse(open.begin() + begin, open.end());
        }
        if (end_.block >= WideChild::max_first)
            throw InputError("wide_bvh: more leaves than 2^26; use bvh");
        stats.N_IN = wide_.size();
    }

    /// @param put  of (Place&, leaf): writes a leaf, and moves the place behind it. @return its
    /// WideChild
    template <class Put>
    void write_nodes(const Put& put) {
        const std::span<Node> nodes = bvh_.nodes.template resize<Node>(wide_.size());
        parallel_for(wide_.size(), 64, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) {
                const Wide& wide = wide_[i];
                WideChildren list;
                Place place = wide.leaves;
                uint32_t inner = wide.inner;
                for (uint32_t k = 0; k < wide.count; ++k) {
                    const BinaryTree::Node& child = tree_.nodes[children_[wide.children + k]];
                    list.bounds[k] = child.bounds;
                    list.child[k] = child.leaf() ? put(place, child) : place_of<Node>(inner++);
                }
                list.count = wide.count;
                set_node(nodes[i], list);
            }
        });
    }

    WideBvh<Set>& bvh_;
    const BinaryTree& tree_;
    const Collapse& collapse_;
    std::vector<Wide> wide_;
    std::vector<uint32_t> children_;  ///< of all wide nodes: nodes of the binary tree
    Place end_;                       ///< of all leaves
};

}  // namespace crofton
