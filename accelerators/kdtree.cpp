#include "accelerators/kdtree.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/kdtree.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/stored_shapes.h"
#include "accelerators/thick_ray.h"
#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct KdTreeTraversal {
    struct Entry {
        const KdNode* node;
        float t_enter, t_leave;
    };

    template <Query Q, class Set, class C>
    static bool run(const KdTree<Set>& tree, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (tree.nodes.empty()) return false;
        return test_lists<Q>(tree.mailbox, tree.shapes, set, ray, q, counters,
                             [&](const auto& test)
                                 HWY_ATTR { return follow(tree, ray, q, counters, test); });
    }

  private:
    /// Front to back with an explicit stack (Ericson & Havran's sequential traversal); where the
    /// thick ray meets a plane within the cell, both sides are visited, their intervals
    /// overlapping.
    ///
    /// Of a plane's three cases only one has a branch, to the second side alone: else the first
    /// side is next, whatever becomes of the second, and its node can load before the test is
    /// through. From node to node this is the longest chain, so which side is first takes two
    /// instructions.
    template <class Set, class C, class Test>
    static HWY_INLINE bool follow(const KdTree<Set>& tree, const LocalRay& ray, RayQuery& q,
                                  C& counters, const Test& test) {
        const ThickRay thick(tree.box, tree.magnitude, ray, q);
        if (!(thick.t_enter <= thick.t_leave)) return false;
        // Shifted by all bits of a node, that is by the axis alone.
        static_assert(KdNode::axis_bits == 2);
        const uint32_t down = thick.down * 0x11111111u;
        const KdNode* nodes = tree.nodes.data();
        const KdNode* node = nodes;
        Entry stack[KdTree<Set>::max_depth];
        Entry* top = stack;
        float t_enter = thick.t_enter, t_leave = thick.t_leave;
        while (true) {
            while (!node->is_leaf()) {
                counters.step();
                const float enter_second = thick.enter(node->axis(), node->split());
                const float leave_first = thick.leave(node->axis(), node->split());
                const uint32_t first = down >> (node->bits & 31) & 1;
                const KdNode* pair = nodes + node->child();
                const KdNode* second = pair + (first ^ 1);
                if (leave_first < t_enter) {
                    node = second;
                    continue;
                }
                *top = {second, std::max(t_enter, enter_second), t_leave};
                top += !(enter_second > t_leave);
                node = pair + first;
                t_leave = std::min(t_leave, leave_first);
            }
            counters.step();
            const uint32_t count = node->count();
            counters.cell(count == 0);
            if (count > 0) {
                const uint32_t* references =
                    count == 1 ? &node->value : tree.references.data() + node->value;
                if (test(references, count)) return true;
            }
            // Overlapping intervals do not begin in strict order, so each is looked at.
            do {
                if (top == stack) return false;
                --top;
            } while (top->t_enter > q.t_cull);
            node = top->node;
            t_enter = top->t_enter;
            t_leave = std::min(top->t_leave, q.t_cull);
        }
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(KdTree, KdTreeTraversal, KdTreeParameters)

#if HWY_ONCE
#include "accelerators/leaves.h"

namespace crofton {
template <class Set>
KdTree<Set> KdTree<Set>::build(const Set& set, const KdTreeParameters& p) {
    KdTree tree;
    BuildReferences shapes = build_references(set);
    if (shapes.empty()) return tree;
    const double n = double(shapes.size());
    double cost_sum = 0;
    for (const BuildReference& r : shapes) cost_sum += r.cost;
    const ClipShape clip = [&](uint32_t i, const Bounds3& box) {
        return set.clipped_bounds(i, box);
    };
    const KdTreeData data =
        build_kd_tree(std::move(shapes), clip,
                      {p.builder, p.max_depth, p.max_leaf_size, p.bins, p.empty_bonus,
                       reference_costs<Set>(cost_constants.plane)});

    tree.nodes.assign(data.nodes.begin(), data.nodes.end());
    tree.references.assign(data.references.begin(), data.references.end());
    tree.shapes = ShapeStore<Set>(set);
    for (KdNode& n : tree.nodes)
        if (n.is_leaf()) place_leaf(set, n.value, n.count(), tree.references, tree.shapes);
    tree.shapes.finish();
    tree.box = data.box;
    tree.magnitude = data.box.magnitude();
    tree.cost = data.cost;
    tree.walk([&](const Bounds3&, uint32_t depth, bool leaf, uint32_t references) {
        tree.stats.N_IN += !leaf;
        tree.stats.N_V += leaf;
        tree.stats.N_EV += leaf && references == 0;
        tree.stats.N_OIV += references;
        tree.stats.depth = std::max(tree.stats.depth, depth);
    });
    tree.stats.bytes = tree.nodes.size() * sizeof(KdNode) +
                       tree.references.size() * sizeof(uint32_t) + tree.shapes.bytes();
    tree.mailbox = wants_mailbox(p.mailbox, std::is_same_v<Set, ObjectSet>,
                                 double(tree.stats.N_OIV), n, cost_sum / n);
    return tree;
}

template <class Set>
void KdTree<Set>::walk(const BoxVisitor& visit) const {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
        Bounds3 cell;
    };
    std::vector<Open> open{{0, 0, box}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const KdNode& n = nodes[o.node];
        visit(o.cell, o.depth, n.is_leaf(), n.is_leaf() ? n.count() : 0);
        if (n.is_leaf()) continue;
        Open below{n.child(), o.depth + 1, o.cell}, above{n.child() + 1, o.depth + 1, o.cell};
        below.cell.upper[n.axis()] = above.cell.lower[n.axis()] = n.split();
        open.push_back(above);
        open.push_back(below);
    }
}

CROFTON_REGISTER_ACCELERATOR(
    KdTree, KdTreeParameters, "kdtree",
    "axis-aligned planes placed by the area heuristic, shapes clipped to their cells",
    "Kaplan 1985; MacDonald & Booth 1990; Havran 2000; Wald & Havran 2006");

}  // namespace crofton
#endif
