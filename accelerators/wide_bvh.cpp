#include "accelerators/wide_bvh.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/wide_bvh.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Where a ray enters and leaves all children of a node.
class EightBoxTest {
  public:
    using D = hn::CappedTag<float, 8>;
    static constexpr size_t N = hn::MaxLanes(D());

    explicit EightBoxTest(const LocalRay& ray) : ray_(ray) {
        for (int a = 0; a < 3; ++a) down_[a] = std::signbit(ray.rcp[a]) ? 1 : 0;
    }
    /// @param t_near  8 floats: where the ray enters each child
    /// @return bit i: child i may be hit within [t_low, t_cull]
    HWY_INLINE uint32_t test(const WideNode& node, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        const D d;
        uint32_t hits = 0;
        for (size_t i = 0; i < 8; i += N) {
            auto enter = hn::Set(d, t_low), leave = hn::Set(d, t_cull);
            for (int a = 0; a < 3; ++a) {
                const auto lo = hn::Load(d, node.planes[down_[a]][a] + i);
                const auto hi = hn::Load(d, node.planes[down_[a] ^ 1][a] + i);
                enter = hn::Max(enter, hn::Mul(hn::Sub(lo, hn::Set(d, ray_.near_origin[a])),
                                               hn::Set(d, ray_.rcp[a])));
                leave = hn::Min(leave, hn::Mul(hn::Sub(hi, hn::Set(d, ray_.far_origin[a])),
                                               hn::Set(d, ray_.far_rcp[a])));
            }
            hn::Store(enter, d, t_near + i);
            hits |= bits(hn::Le(enter, leave)) << i;
        }
        return hits;
    }
    /// One multiplication and addition a plane: the node's grid is moved to the ray first. The
    /// error of that, some u of the node's extent, is what `quantise` leaves room for.
    HWY_INLINE uint32_t test(const QuantisedNode& node, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        const D d;
        const hn::Rebind<uint8_t, D> d8;
        const hn::Rebind<int32_t, D> d32;
        uint32_t hits = 0;
        for (size_t i = 0; i < 8; i += N) {
            auto enter = hn::Set(d, t_low), leave = hn::Set(d, t_cull);
            for (int a = 0; a < 3; ++a) {
                const auto lo = hn::LoadU(d8, node.planes[down_[a]][a] + i);
                const auto hi = hn::LoadU(d8, node.planes[down_[a] ^ 1][a] + i);
                const float near_base = (node.origin[a] - ray_.near_origin[a]) * ray_.rcp[a];
                const float far_base = (node.origin[a] - ray_.far_origin[a]) * ray_.far_rcp[a];
                enter = hn::Max(enter, hn::MulAdd(hn::ConvertTo(d, hn::PromoteTo(d32, lo)),
                                                  hn::Set(d, node.scale[a] * ray_.rcp[a]),
                                                  hn::Set(d, near_base)));
                leave = hn::Min(leave, hn::MulAdd(hn::ConvertTo(d, hn::PromoteTo(d32, hi)),
                                                  hn::Set(d, node.scale[a] * ray_.far_rcp[a]),
                                                  hn::Set(d, far_base)));
            }
            hn::Store(enter, d, t_near + i);
            hits |= bits(hn::Le(enter, leave)) << i;
        }
        return hits & ((1u << node.children) - 1);
    }

  private:
    template <class M>
    static HWY_INLINE uint32_t bits(const M& mask) {
        uint8_t b[8];
        hn::StoreMaskBits(D(), mask, b);
        return b[0];
    }
    const LocalRay& ray_;
    uint32_t down_[3];
};

struct WideBvhTraversal {
    template <Query Q, class Set, class C>
    static bool run(const WideBvh<Set>& bvh, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters, TraversalStart start = {}) {
        if (bvh.format == WideNodes::full)
            return run_nodes<Q, WideNode>(bvh, set, ray, q, counters, start);
        return run_nodes<Q, QuantisedNode>(bvh, set, ray, q, counters, start);
    }

  private:
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
        const Entry a = std::max(far, near), b = std::min(far, near);
        far = a, near = b;
    }

    template <Query Q, class Node, class Set, class C>
    static HWY_INLINE bool run_nodes(const WideBvh<Set>& bvh, const Set& set, const LocalRay& ray,
                                     RayQuery& q, C& counters, TraversalStart start) {
        const Node* nodes = bvh.begin(static_cast<const Node*>(nullptr));
        if (bvh.box.empty()) return false;
        const EightBoxTest boxes(ray);
        Entry stack[WideBvh<Set>::max_depth * (WideBvh<Set>::width - 1) + 1];
        Entry* top = stack;
        uint32_t current = start.index;
        const float t_low = q.t_low;
        while (true) {
            while (!WideChild::is_leaf(current)) {
                const Node& node = nodes[current];
                counters.step();
                alignas(32) float t[8];
                uint32_t hits = boxes.test(node, t_low, q.t_cull, t);
                if (hits == 0) goto pop;
                const uint32_t first = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                hits &= hits - 1;
                if (hits == 0) {
                    current = node.child[first];
                    continue;
                }
                // Two children, the common case, never leave registers; of more, all go on the
                // stack, far to near, and the nearest comes off again.
                const uint32_t second = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                hits &= hits - 1;
                Entry e0 = entry(node.child[first], t[first]);
                Entry e1 = entry(node.child[second], t[second]);
                if constexpr (Q == Query::closest) order(e0, e1);
                if (HWY_LIKELY(hits == 0)) {
                    *top++ = e0;
                    current = uint32_t(e1);
                    continue;
                }
                Entry* const base = top;
                *top++ = e0;
                *top++ = e1;
                do {
                    const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                    const Entry e = entry(node.child[i], t[i]);
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
            if (test_leaf<Q>(set, bvh.leaves, WideChild::first(current), WideChild::count(current),
                             ray, q, counters))
                return true;
        pop:
            do {
                if (top == stack) return false;
                --top;
            } while (t_near(*top) > q.t_cull);
            current = uint32_t(*top);
        }
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
#include "accelerators/wide_collapse.h"

namespace crofton {
namespace {

void set_child(WideNode& node, int i, const Bounds3& b) {
    for (int a = 0; a < 3; ++a) {
        node.planes[0][a][i] = b.lower[a];
        node.planes[1][a][i] = b.upper[a];
    }
}

void clear(WideNode& node) {
    for (int i = 0; i < 8; ++i) {
        set_child(node, i, Bounds3());
        node.child[i] = WideChild::leaf_bit;
    }
}

/// Bytes that contain each child with a hundredth of a step to spare, for the rounding of
/// traversal.
void quantise(QuantisedNode& node, const std::vector<Bounds3>& children) {
    Bounds3 whole;
    for (const Bounds3& b : children) whole.extend(b);
    node = {};
    node.children = uint32_t(children.size());
    for (int a = 0; a < 3; ++a) {
        const double extent = double(whole.upper[a]) - whole.lower[a];
        // One step to spare at each end; at least the spacing of floats there.
        const double scale = std::max({extent / 253, double(std::abs(whole.lower[a])) * 0x1p-22,
                                       double(std::numeric_limits<float>::min())});
        node.scale[a] = float(scale * (1 + 1e-6));
        node.origin[a] = float(double(whole.lower[a]) - node.scale[a]);
        for (size_t i = 0; i < children.size(); ++i) {
            const double lo =
                (double(children[i].lower[a]) - node.origin[a]) / node.scale[a] - 0.01;
            const double hi =
                (double(children[i].upper[a]) - node.origin[a]) / node.scale[a] + 0.01;
            node.planes[0][a][i] = uint8_t(std::clamp(std::floor(lo), 0.0, 255.0));
            node.planes[1][a][i] = uint8_t(std::clamp(std::ceil(hi), 0.0, 255.0));
        }
    }
}

/// Writes a binary tree as wide nodes, depth first.
template <class Set>
class WideWriter {
  public:
    WideWriter(WideBvh<Set>& bvh, const BinaryTree& tree, const WideCollapse& collapse,
               const Set& set)
        : bvh_(bvh), tree_(tree), collapse_(collapse), set_(set) {}

    void write() {
        struct Open {
            uint32_t from, to, depth;
        };
        std::vector<Open> open{{0, add_node(), 0}};
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            ++bvh_.stats.N_IN;
            const std::vector<uint32_t> children = collapse_.children(o.from);
            std::vector<Bounds3> bounds;
            uint32_t child[8];
            for (size_t i = 0; i < children.size(); ++i) {
                const BinaryTree::Node& node = tree_.nodes[children[i]];
                bounds.push_back(node.bounds);
                if (node.leaf()) {
                    child[i] = add_leaf(node, o.depth + 1);
                } else {
                    child[i] = add_node();
                    open.push_back({children[i], child[i], o.depth + 1});
                }
            }
            set_node(o.to, bounds, child);
        }
    }

  private:
    uint32_t add_node() {
        if (bvh_.format == WideNodes::full) {
            bvh_.nodes.emplace_back();
            return uint32_t(bvh_.nodes.size() - 1);
        }
        bvh_.quantised.emplace_back();
        return uint32_t(bvh_.quantised.size() - 1);
    }
    uint32_t add_leaf(const BinaryTree::Node& node, uint32_t depth) {
        const uint32_t first = bvh_.leaves.add(
            set_, std::span<const uint32_t>(tree_.order.data() + node.first, node.count));
        if (first > WideChild::max_first)
            throw InputError("wide_bvh: more leaves than 2^26; use bvh");
        ++bvh_.stats.N_V;
        bvh_.stats.N_OIV += node.count;
        bvh_.stats.depth = std::max(bvh_.stats.depth, depth);
        return WideChild::leaf(first, node.count);
    }
    void set_node(uint32_t index, const std::vector<Bounds3>& bounds, const uint32_t* child) {
        if (bvh_.format == WideNodes::full) {
            WideNode& node = bvh_.nodes[index];
            clear(node);
            for (size_t i = 0; i < bounds.size(); ++i) set_child(node, int(i), bounds[i]);
            std::copy(child, child + bounds.size(), node.child);
        } else {
            quantise(bvh_.quantised[index], bounds);
            std::copy(child, child + bounds.size(), bvh_.quantised[index].child);
        }
    }

    WideBvh<Set>& bvh_;
    const BinaryTree& tree_;
    const WideCollapse& collapse_;
    const Set& set_;
};

template <class Node>
void walk_nodes(const Node* nodes, const BoxVisitor& visit) {
    struct Open {
        uint32_t node, depth;
    };
    std::vector<Open> open{{0, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        for (int i = 0; i < 8; ++i) {
            const Bounds3 b = child_bounds(nodes[o.node], i);
            if (b.empty()) continue;
            const uint32_t child = nodes[o.node].child[i];
            const bool leaf = WideChild::is_leaf(child);
            visit(b, o.depth + 1, leaf, leaf ? WideChild::count(child) : 0);
            if (!leaf) open.push_back({child, o.depth + 1});
        }
    }
}

}  // namespace

Bounds3 child_bounds(const WideNode& node, int i) {
    Bounds3 b;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = node.planes[0][a][i];
        b.upper[a] = node.planes[1][a][i];
    }
    return b;
}

Bounds3 child_bounds(const QuantisedNode& node, int i) {
    Bounds3 b;
    if (i >= int(node.children)) return b;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = float(node.origin[a] + double(node.scale[a]) * node.planes[0][a][i]);
        b.upper[a] = float(node.origin[a] + double(node.scale[a]) * node.planes[1][a][i]);
    }
    return b;
}

template <class Set>
WideBvh<Set> WideBvh<Set>::build(const Set& set, const WideBvhParameters& p) {
    WideBvh bvh;
    bvh.format = p.nodes;
    const TreeCosts costs = tree_costs<Set>(cost_constants.wide_node);
    const BinaryTree tree = build_tree(set, p, costs);
    if (tree.empty()) return bvh;
    bvh.box = tree.nodes[0].bounds;
    // A wide node costs about as much as four of its binary nodes: it has up to seven.
    const WideCollapse collapse(tree, costs, 4 * cost_constants.wide_node, shape_costs(set, costs));
    bvh.cost = collapse.expected_cost();
    WideWriter<Set>(bvh, tree, collapse, set).write();
    bvh.nodes.shrink_to_fit();
    bvh.quantised.shrink_to_fit();
    bvh.stats.bytes = bvh.nodes.size() * sizeof(WideNode) +
                      bvh.quantised.size() * sizeof(QuantisedNode) + bvh.leaves.bytes();
    return bvh;
}

template <class Set>
void WideBvh<Set>::walk(const BoxVisitor& visit) const {
    if (box.empty()) return;
    visit(box, 0, false, 0);
    if (format == WideNodes::full)
        walk_nodes(nodes.data(), visit);
    else
        walk_nodes(quantised.data(), visit);
}

CROFTON_REGISTER_ACCELERATOR(
    WideBvh, WideBvhParameters, "wide_bvh",
    "bounding volume hierarchy with eight children a node, tested at once",
    "Wald, Benthin, Boulos 2008; quantised nodes: Ylitie, Karras, Laine 2017");

}  // namespace crofton
#endif
