#include "accelerators/wide_bvh.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/wide_bvh.cpp"
#include <hwy/foreach_target.h>

#include <hwy/cache_control.h>

#include "framework/accelerator.h"
#include "framework/compact_patch_test.h"
#include "framework/patch_test.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

using NodeLanes = hn::CappedTag<float, 8>;
constexpr size_t node_lanes = hn::MaxLanes(NodeLanes());

template <class M>
HWY_INLINE uint32_t lane_bits(const M& mask) {
    uint8_t b[8];
    hn::StoreMaskBits(NodeLanes(), mask, b);
    return b[0];
}

/// Which planes a ray meets first is an offset into the node.
/// @param size  bytes of the planes of an axis
struct PlaneOffsets {
    size_t enter[3], leave[3];
    HWY_INLINE PlaneOffsets(const LocalRay& ray, size_t begin, size_t size) {
        for (size_t a = 0; a < 3; ++a) {
            const size_t upper = std::signbit(ray.rcp[a]) ? 3 * size : 0;
            enter[a] = begin + a * size + upper;
            leave[a] = begin + (a + 3) * size - upper;
        }
    }
};

/// Where a ray enters and leaves some children of a node, as many as a vector has lanes, by one
/// fused operation a plane: see LocalRay for its error. The ray's numbers come from memory each
/// time: they are operands of the arithmetic, and leaf tests would have emptied the registers.
template <class Node>
class ChildrenTest;

template <>
class ChildrenTest<WideNode> {
  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(ray, offsetof(WideNode, planes), 8 * sizeof(float)) {
        const hn::FixedTag<float, 4> f4;
        hn::Store(hn::Mul(hn::LoadU(f4, ray.near_origin), hn::LoadU(f4, ray.rcp)), f4, enter_);
        hn::Store(hn::Mul(hn::LoadU(f4, ray.far_origin), hn::LoadU(f4, ray.far_rcp)), f4, leave_);
    }

    /// @param t_near  8 floats: where the ray enters each child
    /// @return bit i: child i may be hit within [t_low, t_cull]
    HWY_INLINE uint32_t test(const WideNode& node, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        uint32_t hits = 0;
        for (size_t i = 0; i < 8; i += node_lanes) hits |= test(node, i, t_low, t_cull, t_near);
        return hits;
    }

  private:
    HWY_INLINE uint32_t test(const WideNode& node, size_t first, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        const NodeLanes d;
        const auto* const bytes = reinterpret_cast<const char*>(&node);
        const auto at = [&](size_t offset, const float& base, const float& rcp) HWY_ATTR {
            const auto plane = hn::Load(d, reinterpret_cast<const float*>(bytes + offset) + first);
            return hn::MulSub(plane, hn::Set(d, rcp), hn::Set(d, base));
        };
        const auto x0 = at(offsets_.enter[0], enter_[0], ray_.rcp[0]);
        const auto y0 = at(offsets_.enter[1], enter_[1], ray_.rcp[1]);
        const auto z0 = at(offsets_.enter[2], enter_[2], ray_.rcp[2]);
        const auto x1 = at(offsets_.leave[0], leave_[0], ray_.far_rcp[0]);
        const auto y1 = at(offsets_.leave[1], leave_[1], ray_.far_rcp[1]);
        const auto z1 = at(offsets_.leave[2], leave_[2], ray_.far_rcp[2]);
        const auto enter = hn::Max(hn::Max(x0, y0), hn::Max(z0, hn::Set(d, t_low)));
        const auto leave = hn::Min(hn::Min(x1, y1), hn::Min(z1, hn::Set(d, t_cull)));
        hn::Store(enter, d, t_near + first);
        return lane_bits(hn::Le(enter, leave)) << first;
    }

    const LocalRay& ray_;
    PlaneOffsets offsets_;
    alignas(16) float enter_[4], leave_[4];  ///< near_origin·rcp, far_origin·far_rcp
};

/// One multiplication and addition a plane: the node's grid is moved to the ray first. The error of
/// that, some u of the node's extent, is what `quantise` leaves room for.
template <>
class ChildrenTest<QuantisedNode> {
  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(ray, offsetof(QuantisedNode, planes), 8) {}

    HWY_INLINE uint32_t test(const QuantisedNode& node, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        uint32_t hits = 0;
        for (size_t i = 0; i < 8; i += node_lanes) hits |= test(node, i, t_low, t_cull, t_near);
        return hits & ((1u << node.children) - 1);
    }

  private:
    HWY_INLINE uint32_t test(const QuantisedNode& node, size_t first, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        const NodeLanes d;
        const hn::Rebind<uint8_t, NodeLanes> d8;
        const hn::Rebind<int32_t, NodeLanes> d32;
        const auto* const bytes = reinterpret_cast<const uint8_t*>(&node) + first;
        const auto at = [&](size_t offset, int a, const float* origin, const float* rcp) HWY_ATTR {
            const auto plane = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d8, bytes + offset)));
            return hn::MulAdd(plane, hn::Set(d, node.scale[a] * rcp[a]),
                              hn::Set(d, (node.origin[a] - origin[a]) * rcp[a]));
        };
        auto enter = hn::Set(d, t_low), leave = hn::Set(d, t_cull);
        for (int a = 0; a < 3; ++a) {
            enter = hn::Max(enter, at(offsets_.enter[a], a, ray_.near_origin, ray_.rcp));
            leave = hn::Min(leave, at(offsets_.leave[a], a, ray_.far_origin, ray_.far_rcp));
        }
        hn::Store(enter, d, t_near + first);
        return lane_bits(hn::Le(enter, leave)) << first;
    }

    const LocalRay& ray_;
    PlaneOffsets offsets_;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#include "accelerators/wide_packet.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct WideBvhTraversal {
    template <Query Q, class Set, class C>
    static bool run(const WideBvh<Set>& bvh, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters, TraversalStart start = {}) {
        return with_leaves(bvh, [&](const auto& leaves) HWY_ATTR {
            if (bvh.format == WideNodes::full)
                return run_nodes<Q, WideNode>(bvh, leaves, set, ray, q, counters, start);
            return run_nodes<Q, QuantisedNode>(bvh, leaves, set, ray, q, counters, start);
        });
    }

    template <class Set>
    static bool takes_packets(const WideBvh<Set>& bvh) {
        return bvh.format == WideNodes::full;
    }
    template <Query Q, class Set>
    static bool run_packet(const WideBvh<Set>& bvh, const Set& set, RayPacket& packet) {
        NoCounters none;
        const auto alone = [&](uint32_t r) HWY_ATTR {
            packet.found[r] =
                run<Q>(bvh, set, packet.local[r], packet.query[r], none) || packet.found[r];
        };
        const auto trace = [&](const auto& leaves) HWY_ATTR {
            return trace_packet<Q>(bvh, leaves, set, packet, alone);
        };
        if (with_leaves(bvh, trace)) return true;
        for (uint32_t r = 0; r < packet.count; ++r)
            if (!packet.found[r]) alone(r);
        return false;
    }

  private:
    template <class Set, class F>
    static HWY_INLINE bool with_leaves(const WideBvh<Set>& bvh, const F& f) {
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
    /// What goes on the stack is needed some steps later: time enough to come from a further cache.
    template <class Set, class Node>
    static HWY_INLINE void prefetch(const WideBvh<Set>& bvh, const Node* nodes, uint32_t child) {
        const auto lines = [](const auto* first, size_t bytes) {
            const auto* const begin = reinterpret_cast<const char*>(first);
            for (size_t i = 0; i < bytes; i += 64) hwy::Prefetch(begin + i);
        };
        if (!WideChild::is_leaf(child))
            lines(&node_at(nodes, child), sizeof(Node));
        else if constexpr (std::is_same_v<Set, TriangleSet>)
            lines(bvh.leaves.patches() + WideChild::first(child), sizeof(TrianglePatch));
    }
    static HWY_INLINE void order(Entry& far, Entry& near) {
        // A branch, which lets the next node be loaded before the order is known.
        if (HWY_UNLIKELY(far < near)) std::swap(far, near);
    }

    template <Query Q, class Node, class Set, class Leaves, class C>
    static HWY_INLINE bool run_nodes(const WideBvh<Set>& bvh, const Leaves& leaves, const Set& set,
                                     const LocalRay& ray, RayQuery& q, C& counters,
                                     TraversalStart start) {
        const Node* nodes = bvh.begin(static_cast<const Node*>(nullptr));
        if (bvh.box.empty()) return false;
        const ChildrenTest<Node> boxes(ray);
        Entry stack[WideBvh<Set>::max_depth * (WideBvh<Set>::width - 1) + 1];
        Entry* top = stack;
        uint32_t current = start.index;
        const float t_low = q.t_low;
        while (true) {
            while (!WideChild::is_leaf(current)) {
                const Node& node = node_at(nodes, current);
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
                    prefetch(bvh, nodes, uint32_t(e0));
                    *top++ = e0;
                    current = uint32_t(e1);
                    continue;
                }
                prefetch(bvh, nodes, uint32_t(e0));
                Entry* const base = top;
                *top++ = e0;
                *top++ = e1;
                do {
                    const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                    const Entry e = entry(node.child[i], t[i]);
                    prefetch(bvh, nodes, uint32_t(e));
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
            if (test_leaf<Q>(set, leaves, WideChild::first(current), WideChild::count(current), ray,
                             q, counters))
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

/// The children of a wide node in the making.
struct WideChildren {
    std::array<Bounds3, 8> bounds;
    std::array<uint32_t, 8> child;  ///< WideChild
    size_t count = 0;
};

void set_node(WideNode& node, const WideChildren& children) {
    clear(node);
    for (size_t i = 0; i < children.count; ++i) set_child(node, int(i), children.bounds[i]);
    std::copy_n(children.child.begin(), children.count, node.child);
}

/// Bytes that contain each child with a hundredth of a step to spare, for the rounding of
/// traversal.
void set_node(QuantisedNode& node, const WideChildren& children) {
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
  public:
    WideWriter(WideBvh<Set>& bvh, RawAlignedVector<Node>& nodes, const BinaryTree& tree,
               const WideCollapse& collapse, const PackedFrom<Set>& corners)
        : leaves_(bvh.leaves),
          stats_(bvh.stats),
          nodes_(nodes),
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
        nodes_.resize(all.nodes + 1);
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
        const WideCollapse::Children children = collapse_.children(n);
        std::array<Size, 8> sizes;
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
        const WideCollapse::Children children = collapse_.children(n);
        WideChildren list;
        struct Subtree {
            uint32_t from, to;
            Place place;
        };
        std::array<Subtree, 8> subtrees;
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
        set_node(nodes_[to], list);
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
    RawAlignedVector<Node>& nodes_;
    const BinaryTree& tree_;
    const WideCollapse& collapse_;
    const PackedFrom<Set>& corners_;
    int parallel_levels_;
    RawAlignedVector<Size> sizes_;  // of what becomes a wide node
};

template <class Set, class Node>
void walk_nodes(const WideBvh<Set>& bvh, const Node* nodes, const BoxVisitor& visit) {
    struct Open {
        uint32_t node, depth;
    };
    std::vector<Open> open{{0, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        for (int i = 0; i < 8; ++i) {
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
    TreeCosts costs = tree_costs<Set>(cost_constants.wide_node);
    const PackedFrom<Set> corners(set);
    if constexpr (std::is_same_v<Set, TriangleSet>)
        costs.blocks = [&](std::span<const uint32_t> shapes) {
            return corners.count_patches(shapes);
        };
    const BinaryTree tree = build_tree(set, p, costs);
    if (tree.empty()) return bvh;
    bvh.box = tree.nodes[0].bounds;
    // A wide node costs about as much as four of its binary nodes: it has up to seven.
    const WideCollapse collapse(tree, costs, 4 * cost_constants.wide_node, shape_costs(set, costs));
    bvh.cost = collapse.expected_cost();
    if (bvh.format == WideNodes::full)
        WideWriter(bvh, bvh.nodes, tree, collapse, corners).write();
    else
        WideWriter(bvh, bvh.quantised, tree, collapse, corners).write();
    if constexpr (std::is_same_v<Set, TriangleSet>)
        if (p.leaves == WideLeafForm::compact) {
            bvh.compact = true;
            bvh.compact_leaves = CompactPatches(bvh.leaves);
            bvh.leaves = {};
        }
    bvh.stats.bytes = bvh.nodes.size() * sizeof(WideNode) +
                      bvh.quantised.size() * sizeof(QuantisedNode) + bvh.leaves.bytes() +
                      bvh.compact_leaves.bytes();
    return bvh;
}

template <class Set>
void WideBvh<Set>::walk(const BoxVisitor& visit) const {
    if (box.empty()) return;
    visit(box, 0, false, 0);
    if (format == WideNodes::full)
        walk_nodes(*this, nodes.data(), visit);
    else
        walk_nodes(*this, quantised.data(), visit);
}

CROFTON_REGISTER_ACCELERATOR(
    WideBvh, WideBvhParameters, "wide_bvh",
    "bounding volume hierarchy with eight children a node, tested at once",
    "Wald, Benthin, Boulos 2008; quantised nodes: Ylitie, Karras, Laine 2017");

}  // namespace crofton
#endif
