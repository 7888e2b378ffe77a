#include "accelerators/wide_bvh.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/wide_bvh.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/wide_crowd.h"
#include "accelerators/wide_packet.h"
#include "framework/accelerator.h"
#include "framework/compact_patch_test.h"
#include "framework/patch_test.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct WideBvhTraversal {
    template <Query Q, class Set, class C>
    static bool run(const WideBvh<Set>& bvh, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters, TraversalStart start = {}) {
        return with_leaves(bvh, [&](const auto& leaves) HWY_ATTR {
            return bvh.nodes.visit([&](const auto* nodes) HWY_ATTR {
                return run_nodes<Q>(nodes, leaves, set, ray, q, counters, start.index);
            });
        });
    }

    template <class Set>
    static bool takes_packets(const WideBvh<Set>& bvh) {
        return bvh.nodes.format() == WideFormat::full;
    }
    template <Query Q, class Set>
    static void run_packet(const WideBvh<Set>& bvh, const Set& set, RayPacket& packet,
                           LocalPacket& space, uint32_t rays, TraversalStart start = {}) {
        if (bvh.box.empty()) return;
        const auto alone = [&](const LocalRay& ray, RayQuery& query, uint32_t child) HWY_ATTR {
            NoCounters none;
            return run<Q>(bvh, set, ray, query, none, {child, 0});
        };
        with_leaves(bvh, [&](const auto& leaves) HWY_ATTR {
            bvh.nodes.visit_full([&](const auto* nodes) HWY_ATTR {
                PacketTraversal<Q, std::remove_cvref_t<decltype(*nodes)>, Set,
                                std::remove_cvref_t<decltype(leaves)>>(nodes, leaves, set, packet,
                                                                       space, rays)
                    .run(start.index, alone);
            });
        });
    }

    template <Query Q, GoesInCrowds Set>
    static void run_crowd(const WideBvh<Set>& bvh, const Set& set, RayCrowd& crowd,
                          TraversalStart start = {}) {
        if (bvh.box.empty()) return;
        const auto alone = [&](const LocalRay& ray, RayQuery& query) HWY_ATTR {
            NoCounters none;
            return run<Q>(bvh, set, ray, query, none, start);
        };
        with_leaves(bvh, [&](const auto& leaves) HWY_ATTR {
            bvh.nodes.visit([&](const auto* nodes) HWY_ATTR {
                CrowdTraversal<Q, std::remove_cvref_t<decltype(*nodes)>, Set,
                               std::remove_cvref_t<decltype(leaves)>>(nodes, leaves, set, crowd,
                                                                      start.index)
                    .run(alone);
            });
        });
    }

  private:
    template <class Set, class F>
    static HWY_INLINE auto with_leaves(const WideBvh<Set>& bvh, const F& f) {
        if constexpr (std::is_same_v<Set, TriangleSet>)
            if (bvh.compact) return f(bvh.compact_leaves);
        return f(bvh.leaves);
    }

    /// A child on the stack: where it is entered in the upper half, so that entries sort as
    /// integers (for t >= 0; below zero the order is merely not the best).
    using Entry = uint64_t;
    static HWY_INLINE Entry entry(uint32_t child, float t) {
        uint32_t bits;
        std::memcpy(&bits, &t, 4);
        return uint64_t(bits) << 32 | child;
    }
    static HWY_INLINE float t_near(Entry e) {
        const uint32_t bits = uint32_t(e >> 32);
        float t;
        std::memcpy(&t, &bits, 4);
        return t;
    }
    static HWY_INLINE void order(Entry& far, Entry& near) {
        // A branch, which lets the next node be loaded before the order is known.
        if (HWY_UNLIKELY(far < near)) std::swap(far, near);
    }

    /// A function by itself, whose arguments come in registers.
    template <Query Q, class Node, class Set, class Leaves, class C>
    static HWY_NOINLINE bool run_nodes(const Node* nodes, const Leaves& leaves, const Set& set,
                                       const LocalRay& ray, RayQuery& q, C& counters,
                                       uint32_t current) {
        if (HWY_UNLIKELY(!nodes)) return false;  // nothing was built
        const ChildrenTest<Node> boxes(ray);
        Entry stack[WideBvh<Set>::max_depth * (Node::width - 1) + 1];
        Entry* top = stack;
        while (true) {
            while (!WideChild::is_leaf(current)) {
                const Node& node = node_at(nodes, current);
                counters.step();
                alignas(4 * Node::width) float t[Node::width];
                uint32_t hits = test_children(boxes, node, q.t_low, q.t_cull, t);
                if (hits == 0) goto pop;
                const uint32_t first = lowest(hits);
                hits &= hits - 1;
                if (hits == 0) {
                    current = node.child[first];
                    continue;
                }
                // Two children, the common case, never leave registers; of more, all go on the
                // stack, far to near, and the nearest comes off again. What stays there is needed
                // some steps later: time enough to come from a further cache.
                const uint32_t second = lowest(hits);
                hits &= hits - 1;
                Entry e0 = entry(node.child[first], t[first]);
                Entry e1 = entry(node.child[second], t[second]);
                if constexpr (Q == Query::closest) order(e0, e1);
                if (HWY_LIKELY(hits == 0)) {
                    prefetch_child(nodes, leaves, uint32_t(e0));
                    *top++ = e0;
                    current = uint32_t(e1);
                    continue;
                }
                prefetch_child(nodes, leaves, uint32_t(e0));
                Entry* const base = top;
                *top++ = e0;
                *top++ = e1;
                do {
                    const uint32_t i = lowest(hits);
                    const Entry e = entry(node.child[i], t[i]);
                    prefetch_child(nodes, leaves, uint32_t(e));
                    hits &= hits - 1;
                    if constexpr (Q == Query::closest)
                        insert(base, top++, e);
                    else
                        *top++ = e;
                } while (hits);
                current = uint32_t(*--top);
            }
            counters.step();
            counters.cell(false);
            if (visit_leaf<Q>(set, leaves, current, ray, q, counters)) return true;
        pop:
            do {
                if (top == stack) return false;
                --top;
            } while (t_near(*top) > q.t_cull);
            current = uint32_t(*top);
        }
    }

    template <Query Q, class Set, class Leaves, class C>
    static HWY_INLINE bool visit_leaf(const Set& set, const Leaves& leaves, uint32_t leaf,
                                      const LocalRay& ray, RayQuery& q, C& counters) {
        const uint32_t first = WideChild::first(leaf), count = WideChild::count(leaf);
        if constexpr (std::is_same_v<Set, ObjectSet>)
            if (HWY_LIKELY(count == 1))  // its box is the leaf's
                return trace_object<Q>(set.entry(leaves.references()[first]), ray, q, counters);
        return test_leaf<Q>(set, leaves, first, count, ray, q, counters);
    }

    /// Puts e into [base, top), far to near.
    static HWY_INLINE void insert(Entry* base, Entry* top, Entry e) {
        for (; top > base && top[-1] < e; --top) *top = top[-1];
        *top = e;
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(WideBvh, WideBvhTraversal, WideBvhParameters)

#if HWY_ONCE
#include "accelerators/wide_writer.h"

namespace crofton {
namespace {

template <class Set, class Node>
void walk_nodes(const WideBvh<Set>& bvh, const Node* nodes, const BoxVisitor& visit) {
    struct Open {
        uint32_t node, depth;
    };
    std::vector<Open> open{{0, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        for (int i = 0; i < Node::width; ++i) {
            const Node& node = node_at(nodes, o.node);
            const Bounds3 b = child_bounds(node, i);
            if (b.empty()) continue;
            const uint32_t child = node.child[i];
            const bool leaf = WideChild::is_leaf(child);
            visit(b, o.depth + 1, leaf, leaf ? bvh.leaf_size(child) : 0);
            if (!leaf) open.push_back({child, o.depth + 1});
        }
    }
}

}  // namespace

template <class Set>
WideBvh<Set> WideBvh<Set>::build(const Set& set, const WideBvhParameters& p) {
    WideBvh bvh;
    bvh.nodes = WideNodes(p.nodes, width_of(p.width));
    TreeCosts costs = tree_costs<Set>(cost_constants.wide_node);
    const bool is_quick =
        std::is_same_v<Set, TriangleSet> && p.builder == TreeBuilder::lbvh && p.reinsertion == 0;
    const PackedFrom<Set> corners = packed_from(set, is_quick);
    QuickTree quick;
    if constexpr (std::is_same_v<Set, TriangleSet>) {
        costs.blocks = [&](std::span<const uint32_t> shapes) {
            return corners.count_patches(shapes);
        };
        // A patch has room for two triangles that share nothing.
        const double corners_each = double(corners.distinct()) / std::max(1u, set.size());
        costs.leaf_width =
            int(std::clamp(TrianglePatch::width / corners_each, 2.0, double(costs.leaf_width)));
        costs.blocks_vary = corners_each > 0.75;
        if (is_quick) quick = build_quick_tree(set, corners, costs, p.max_leaf_size);
    }
    const BinaryTree other = is_quick ? BinaryTree() : build_tree(set, p, costs);
    const BinaryTree& tree = is_quick ? quick.tree : other;
    if (tree.empty()) return bvh;
    bvh.box = tree.nodes[0].bounds;
    bvh.nodes.visit([&](const auto* nodes) {
        using Node = std::remove_cvref_t<decltype(*nodes)>;
        // A node of any width costs about as much as four binary ones: most of it is the way to the
        // next.
        const WideCollapse<Node::width> collapse(tree, costs, 4 * cost_constants.wide_node,
                                                 shape_costs(set, costs));
        bvh.cost = collapse.expected_cost();
        WideWriter<Set, Node> writer(bvh, tree, collapse);
        if constexpr (std::is_same_v<Set, TriangleSet>)
            if (is_quick) return writer.write(quick);
        writer.write(corners);
    });
    if constexpr (std::is_same_v<Set, TriangleSet>)
        if (p.leaves == WideLeafForm::compact) {
            bvh.compact = true;
            bvh.compact_leaves = CompactPatches(bvh.leaves);
            bvh.leaves = {};
        }
    bvh.stats.bytes = bvh.nodes.bytes() + bvh.leaves.bytes() + bvh.compact_leaves.bytes();
    return bvh;
}

template <class Set>
void WideBvh<Set>::walk(const BoxVisitor& visit) const {
    if (box.empty()) return;
    visit(box, 0, false, 0);
    nodes.visit([&](const auto* first) { walk_nodes(*this, first, visit); });
}

CROFTON_REGISTER_ACCELERATOR(
    WideBvh, WideBvhParameters, "wide_bvh",
    "bounding volume hierarchy with 4, 8 or 16 children a node, tested at once",
    "Wald, Benthin, Boulos 2008; quantised nodes: Ylitie, Karras, Laine 2017");

}  // namespace crofton
#endif
