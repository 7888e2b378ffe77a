#include "accelerators/bvh.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/bvh.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Tests both children of a node at once: lanes 0 and 1 hold where the ray enters each child, lanes
/// 2 and 3 minus where it leaves, so that one maximum serves both.
class ChildPairTest {
  public:
    using D = hn::FixedTag<float, 4>;
    using V = hn::Vec<D>;

    ChildPairTest(const LocalRay& ray, const RayQuery& q) {
        const D d;
        alignas(16) static constexpr int32_t orders[2][4] = {{0, 1, 2, 3}, {2, 3, 0, 1}};
        for (int a = 0; a < 3; ++a) {
            origin_[a] = hn::ConcatLowerLower(d, hn::Set(d, ray.far_origin[a]),
                                              hn::Set(d, ray.near_origin[a]));
            rcp_[a] = hn::ConcatLowerLower(d, hn::Set(d, -ray.far_rcp[a]), hn::Set(d, ray.rcp[a]));
            // A ray that goes down an axis meets uppers first: swap the halves.
            order_[a] = hn::SetTableIndices(d, orders[std::signbit(ray.rcp[a])]);
        }
        shrink(q);
    }
    void shrink(const RayQuery& q) {
        limits_ = hn::ConcatLowerLower(D(), hn::Set(D(), -q.t_cull), hn::Set(D(), q.t_low));
    }
    /// @param t_near  lanes 0 and 1: where the ray enters each child
    /// @return bit i: child i may be hit
    HWY_INLINE uint32_t test(const BvhNode& node, float* HWY_RESTRICT t_near) const {
        const D d;
        V t = limits_;
        for (int a = 0; a < 3; ++a) {
            const V planes = hn::TableLookupLanes(hn::Load(d, node.bounds[a]), order_[a]);
            t = hn::Max(hn::Mul(hn::Sub(planes, origin_[a]), rcp_[a]), t);
        }
        const V leave = hn::Neg(hn::Shuffle1032(t));
        hn::Store(t, d, t_near);
        uint8_t bits[8];
        hn::StoreMaskBits(d, hn::Le(t, leave), bits);
        return bits[0] & 3u;
    }

  private:
    V origin_[3], rcp_[3], limits_;
    decltype(hn::IndicesFromVec(D(), hn::Zero(hn::RebindToSigned<D>()))) order_[3];
};

struct BvhTraversal {
    struct Entry {
        uint32_t index, count;
        float t_near;
    };

    /// Front to back with an explicit stack; a child that begins beyond the best hit is dropped.
    template <Query Q, class Set, class C>
    static bool run(const Bvh<Set>& bvh, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (bvh.nodes.empty()) return false;
        const BvhNode* nodes = bvh.nodes.data();
        ChildPairTest pair(ray, q);
        Entry stack[Bvh<Set>::max_depth + 1];
        Entry* top = stack;
        Entry current{0, 0, 0};
        while (true) {
            // Down, to the nearer child first, until a leaf or a miss.
            while (current.count == 0) {
                const BvhNode& node = nodes[current.index];
                counters.step();
                alignas(16) float t_near[4];
                const uint32_t hits = pair.test(node, t_near);
                if (hits == 0) goto pop;
                // Branches rather than arithmetic: a predicted branch lets the next node load
                // before this one's test is through.
                if (hits == 1) {
                    current = {node.index[0], node.count[0], t_near[0]};
                } else if (hits == 2) {
                    current = {node.index[1], node.count[1], t_near[1]};
                } else if (t_near[1] < t_near[0]) {
                    *top++ = {node.index[0], node.count[0], t_near[0]};
                    current = {node.index[1], node.count[1], t_near[1]};
                } else {
                    *top++ = {node.index[1], node.count[1], t_near[1]};
                    current = {node.index[0], node.count[0], t_near[0]};
                }
            }
            counters.step();
            counters.cell(false);
            if (test_leaf<Q>(set, bvh.leaves, current.index, current.count, ray, q, counters))
                return true;
            pair.shrink(q);
        pop:
            do {
                if (top == stack) return false;
                current = *--top;
            } while (current.t_near > q.t_cull);
        }
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(Bvh, BvhTraversal, BvhParameters)

#if HWY_ONCE
namespace crofton {
namespace {

/// Copies a tree into pairs of children, depth first, with the leaves in the same order.
template <class Set>
class PairWriter {
  public:
    PairWriter(Bvh<Set>& bvh, const BinaryTree& tree, const Set& set)
        : bvh_(bvh), tree_(tree), set_(set) {}

    void write() {
        struct Open {
            uint32_t from, to, depth;
        };
        const BinaryTree::Node& root = tree_.nodes[0];
        bvh_.nodes.emplace_back();
        if (root.leaf()) {
            // A lone leaf still needs a node to stand in; its sibling is a box that no ray meets.
            set_child(0, 0, 0, 0);
            set_empty(0, 1);
            return;
        }
        std::vector<Open> open{{0, 0, 0}};
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            ++bvh_.stats.N_IN;
            const uint32_t children[2] = {tree_.nodes[o.from].left, tree_.nodes[o.from].right};
            for (int side = 0; side < 2; ++side)
                if (const uint32_t to = set_child(o.to, side, children[side], o.depth + 1))
                    open.push_back({children[side], to, o.depth + 1});
        }
    }

  private:
    /// @return the node to fill for an inner child, 0 for a leaf
    uint32_t set_child(uint32_t parent, int side, uint32_t from, uint32_t depth) {
        const BinaryTree::Node& child = tree_.nodes[from];
        set_bounds(parent, side, child.bounds);
        if (!child.leaf()) {
            const uint32_t to = uint32_t(bvh_.nodes.size());
            bvh_.nodes[parent].index[side] = to;
            bvh_.nodes[parent].count[side] = 0;
            bvh_.nodes.emplace_back();
            return to;
        }
        const std::span<const uint32_t> shapes(tree_.order.data() + child.first, child.count);
        bvh_.nodes[parent].index[side] = bvh_.leaves.add(set_, shapes);
        bvh_.nodes[parent].count[side] = child.count;
        ++bvh_.stats.N_V;
        bvh_.stats.N_OIV += child.count;
        bvh_.stats.depth = std::max(bvh_.stats.depth, depth);
        return 0;
    }
    void set_empty(uint32_t parent, int side) {
        set_bounds(parent, side, Bounds3());
        bvh_.nodes[parent].index[side] = 0;
        bvh_.nodes[parent].count[side] = 0;
    }
    void set_bounds(uint32_t parent, int side, const Bounds3& b) {
        for (int a = 0; a < 3; ++a) {
            bvh_.nodes[parent].bounds[a][side] = b.lower[a];
            bvh_.nodes[parent].bounds[a][2 + side] = b.upper[a];
        }
    }

    Bvh<Set>& bvh_;
    const BinaryTree& tree_;
    const Set& set_;
};

}  // namespace

template <class Set>
Bvh<Set> Bvh<Set>::build(const Set& set, const BvhParameters& p) {
    Bvh bvh;
    const TreeCosts costs = tree_costs<Set>(cost_constants.node);
    const BinaryTree tree = build_tree(set, p, costs);
    if (tree.empty()) return bvh;
    bvh.box = tree.nodes[0].bounds;
    bvh.cost = crofton::expected_cost(tree, costs, shape_costs(set, costs));
    PairWriter<Set>(bvh, tree, set).write();
    bvh.nodes.shrink_to_fit();
    bvh.stats.bytes = bvh.nodes.size() * sizeof(BvhNode) + bvh.leaves.bytes();
    return bvh;
}

template <class Set>
void Bvh<Set>::walk(const BoxVisitor& visit) const {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
    };
    visit(box, 0, false, 0);
    std::vector<Open> open{{0, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const BvhNode& n = nodes[o.node];
        for (int side = 0; side < 2; ++side) {
            Bounds3 b;
            for (int a = 0; a < 3; ++a) {
                b.lower[a] = n.bounds[a][side];
                b.upper[a] = n.bounds[a][2 + side];
            }
            if (b.empty()) continue;
            visit(b, o.depth + 1, n.count[side] > 0, n.count[side]);
            if (n.count[side] == 0) open.push_back({n.index[side], o.depth + 1});
        }
    }
}

CROFTON_REGISTER_ACCELERATOR(
    Bvh, BvhParameters, "bvh",
    "binary bounding volume hierarchy of boxes, split by the surface area heuristic",
    "Rubin & Whitted 1980; MacDonald & Booth 1990; binning: Wald 2007");

}  // namespace crofton
#endif
