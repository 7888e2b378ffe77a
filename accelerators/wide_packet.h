// Traversal of WideNodes by packets; included once per target.
#if defined(CROFTON_ACCELERATORS_WIDE_PACKET_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_WIDE_PACKET_H_
#undef CROFTON_ACCELERATORS_WIDE_PACKET_H_
#else
#define CROFTON_ACCELERATORS_WIDE_PACKET_H_
#endif

#include "accelerators/packet_leaves.h"
#include "accelerators/wide_children_test.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Where the first of a packet's rays may enter, and the last may leave, some children of a node
/// (interval arithmetic: Boulos, Wald, Shirley 2006, "Geometric and arithmetic culling methods for
/// entire ray packets"). Rounding is monotone: no ray's meet() finds what this one misses.
template <class Node>
class PacketChildrenTest {
  public:
    explicit HWY_INLINE PacketChildrenTest(const RayPacket& packet, const PacketRays& rays)
        : offsets_(packet.local[0], offsetof(Node, planes), Node::width * sizeof(float)),
          rcp_(rays.rcp()),
          far_rcp_(rays.far_rcp()) {
        const PacketRays::Ends near = rays.near_origin(), far = rays.far_origin();
        for (int a = 0; a < 3; ++a) {
            const bool down = rcp_.low[a] < 0;
            enter_origin_[a] = down ? near.low[a] : near.high[a];
            leave_origin_[a] = down ? far.high[a] : far.low[a];
        }
    }

    /// See test_children; t_near is that of the first ray.
    HWY_INLINE uint32_t part(const Node& node, size_t first, float t_low, float t_cull,
                             float* HWY_RESTRICT t_near) const {
        const NodeLanes<Node> d;
        const auto* const bytes = reinterpret_cast<const char*>(&node);
        auto enter = hn::Set(d, t_low), leave = hn::Set(d, t_cull);
        for (size_t a = 0; a < 3; ++a) {
            const auto plane = [&](size_t offset, float origin) HWY_ATTR {
                const auto at = reinterpret_cast<const float*>(bytes + offset) + first;
                return hn::Sub(hn::Load(d, at), hn::Set(d, origin));
            };
            const auto in = plane(offsets_.enter[a], enter_origin_[a]);
            const auto out = plane(offsets_.leave[a], leave_origin_[a]);
            enter = hn::Max(enter, hn::Min(hn::Mul(in, hn::Set(d, rcp_.low[a])),
                                           hn::Mul(in, hn::Set(d, rcp_.high[a]))));
            leave = hn::Min(leave, hn::Max(hn::Mul(out, hn::Set(d, far_rcp_.low[a])),
                                           hn::Mul(out, hn::Set(d, far_rcp_.high[a]))));
        }
        hn::Store(enter, d, t_near + first);
        return lane_bits(d, hn::Le(enter, leave));
    }

  private:
    PlaneOffsets offsets_;
    PacketRays::Ends rcp_, far_rcp_;
    float enter_origin_[3], leave_origin_[3];
};

/// A packet goes down the tree as one; at a leaf all its rays are tested against the box at once,
/// and those that meet it test what is inside: see PacketLeaves. Hits do not depend on which
/// further leaves are visited, so they are those of single rays.
///
/// A packet goes as far as the last of its rays, and where those go different ways, or one of them
/// to the horizon, most of what it passes is met by few or none. So it may take `free_visits`, and
/// two for every ray that has met a leaf.
/// @param alone  (r): traces ray r by itself, from the root, with what it found so far
/// @return  false: it took more than that and gave up; its rays have still to be traced, from the
///          root, with what they found so far
template <Query Q, class Node, class Set, class Leaves, class F>
bool trace_packet(const WideBvh<Set>& bvh, const Node* nodes, const Leaves& leaves, const Set& set,
                  RayPacket& packet, const F& alone) {
    constexpr int free_visits = 32;
    if (bvh.box.empty() || packet.count == 0) return true;
    int visits_left = free_visits;
    struct Open {
        float t;
        uint32_t child;
        const float* planes;  ///< of the child, every Node::width-th float
    };
    PacketRays rays(packet);
    const PacketChildrenTest<Node> boxes(packet, rays);
    bool down[3];
    for (int a = 0; a < 3; ++a) down[a] = std::signbit(packet.local[0].rcp[a]);
    const float t_low = rays.least_t_low();
    float t_cull = rays.most_t_cull();
    PacketLeaves<Q, Set, Leaves> at_leaves(leaves, set, packet, rays);
    Open stack[WideBvh<Set>::max_depth * (Node::width - 1) + 1];
    Open* top = stack;
    *top++ = {-INFINITY, 0, nullptr};
    while (top > stack) {
        const Open open = *--top;
        if (open.t > t_cull) continue;
        if (--visits_left < 0) {
            at_leaves.finish(alone);
            return false;
        }
        if (!WideChild::is_leaf(open.child)) {
            const Node& node = node_at(nodes, open.child);
            alignas(4 * Node::width) float t[Node::width];
            Open* const base = top;
            for (uint32_t hits = test_children(boxes, node, t_low, t_cull, t); hits;
                 hits &= hits - 1) {
                const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                const Open child{t[i], node.child[i], &node.planes[0][0][i]};
                Open* at = top++;
                for (; at > base && at[-1].t < child.t; --at) *at = at[-1];
                *at = child;
            }
            continue;
        }
        const uint32_t hits = rays.meet(open.planes, Node::width, down);
        if (!hits) continue;
        visits_left += 2 * int(hwy::PopCount(hits));
        if (at_leaves.test(WideChild::first(open.child), WideChild::count(open.child), hits))
            t_cull = rays.most_t_cull();
    }
    at_leaves.finish(alone);
    return true;
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
