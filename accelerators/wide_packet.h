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

/// A row's end.
HWY_INLINE float least(const RayPacket::Row& row) {
    auto all = hn::Load(RayLanes(), row);
    for (size_t r = hn::MaxLanes(RayLanes()); r < RayPacket::most; r += hn::MaxLanes(RayLanes()))
        all = hn::Min(all, hn::Load(RayLanes(), row + r));
    return hn::GetLane(hn::MinOfLanes(RayLanes(), all));
}
HWY_INLINE float largest(const RayPacket::Row& row) {
    auto all = hn::Load(RayLanes(), row);
    for (size_t r = hn::MaxLanes(RayLanes()); r < RayPacket::most; r += hn::MaxLanes(RayLanes()))
        all = hn::Max(all, hn::Load(RayLanes(), row + r));
    return hn::GetLane(hn::MaxOfLanes(RayLanes(), all));
}

/// Which of a packet's rays may meet a box.
/// @param planes  of the box: lower x, y, z, upper x, y, z, every `stride`-th float
/// @param down    whether directions are negative, by axis
/// @return bit r: ray r may, see LocalRay
HWY_INLINE uint32_t meet(const RayPacket& packet, const float* planes, size_t stride,
                         const bool (&down)[3]) {
    const RayLanes d;
    uint32_t hits = 0;
    for (size_t r = 0; r < RayPacket::most; r += hn::MaxLanes(d)) {
        auto enter = hn::Load(d, packet.t_low + r), leave = hn::Load(d, packet.t_cull + r);
        for (size_t a = 0; a < 3; ++a) {
            const auto in = hn::Set(d, planes[stride * (down[a] ? a + 3 : a)]);
            const auto out = hn::Set(d, planes[stride * (down[a] ? a : a + 3)]);
            enter = hn::Max(enter, hn::Mul(hn::Sub(in, hn::Load(d, packet.near_origin[a] + r)),
                                           hn::Load(d, packet.rcp[a] + r)));
            leave = hn::Min(leave, hn::Mul(hn::Sub(out, hn::Load(d, packet.far_origin[a] + r)),
                                           hn::Load(d, packet.far_rcp[a] + r)));
        }
        hits |= mask_bits(d, hn::Le(enter, leave)) << r;
    }
    return hits;
}

/// A ray that enters any box no later than the first of a packet's rays, and leaves it no earlier
/// than the last (interval arithmetic: Boulos, Wald, Shirley 2006, "Geometric and arithmetic
/// culling methods for entire ray packets").
///
/// It starts from the ends of all near and far origins, is the fastest to enter and the slowest to
/// leave. That is enough since no ray begins before t = 0: a plane behind an origin is left
/// alone where it is one to enter by, and ends the matter for all rays where it is one to leave by.
/// The rounding of `ChildrenTest` moves an origin by u·|o|, for which the pad that is in the end of
/// the origins has room as it has for a single ray.
HWY_INLINE LocalRay beam_of(const RayPacket& packet) {
    LocalRay beam{};
    for (int a = 0; a < 3; ++a) {
        const bool down = std::signbit(packet.rcp[a][0]);
        const float low = least(packet.rcp[a]), high = largest(packet.rcp[a]);
        beam.near_origin[a] = down ? least(packet.near_origin[a]) : largest(packet.near_origin[a]);
        beam.far_origin[a] = down ? largest(packet.far_origin[a]) : least(packet.far_origin[a]);
        beam.rcp[a] = down ? high : low;
        beam.far_rcp[a] = (down ? low : high) * (1 + box_slack);
        beam.near_base[a] = beam.near_origin[a] * beam.rcp[a];
        beam.far_base[a] = beam.far_origin[a] * beam.far_rcp[a];
    }
    return beam;
}

/// A packet goes down the tree as one; at a leaf all its rays are tested against the box at once,
/// and those that meet it test what is inside: see PacketLeaves. Hits do not depend on which
/// further leaves are visited, so they are those of single rays.
///
/// A packet goes as far as the last of its rays, and where those go different ways, or one of them
/// to the horizon, most of what it passes is met by few or none. So after `free_visits`, and two
/// for every ray that has met a leaf, it looks which rays meet a node, too, and a few go on from
/// there alone.
///
/// The closest hit is found soonest from near to far. Something in the way is found sooner from far
/// to near: shadow rays begin on a surface, and pass what is around it, which is hardly ever in
/// their way, but in every box near their origin.
template <Query Q, class Node, class Set, class Leaves>
class PacketTraversal {
  public:
    HWY_INLINE PacketTraversal(const Node* nodes, const Leaves& leaves, const Set& set,
                               RayPacket& packet)
        : nodes_(nodes),
          packet_(packet),
          beam_(beam_of(packet)),
          boxes_(beam_),
          leaves_(leaves, set, packet),
          t_low_(least(packet.t_low)),
          t_cull_(largest(packet.t_cull)) {
        for (int a = 0; a < 3; ++a) down_[a] = std::signbit(beam_.rcp[a]);
    }

    /// @param alone  (ray, query, child): traces a ray from a child on, and returns whether that
    ///               answered an `any` query
    template <class F>
    HWY_INLINE void run(const F& alone) {
        Open stack[BinaryTree::max_depth * (Node::width - 1) + 1];
        Open* top = stack;
        *top++ = {-std::numeric_limits<float>::infinity(), 0, nullptr};
        while (top > stack) {
            const Open open = *--top;
            if (open.t > t_cull_) continue;
            const bool leaf = WideChild::is_leaf(open.child);
            ++packet_.visits;
            if (leaf || --free_visits_ < 0) {
                const uint32_t rays = meet(packet_, open.planes, Node::width, down_);
                if (!rays) continue;
                if (leaf) {
                    visit_leaf(open.child, rays);
                    continue;
                }
                if (hwy::PopCount(rays) <= few) {
                    leave_alone(open.child, rays, alone);
                    continue;
                }
            }
            top = push_children(node_at(nodes_, open.child), top);
        }
    }

  private:
    static constexpr uint32_t few = 2;
    struct Open {
        float t;
        uint32_t child;
        const float* planes;  ///< of the child, every Node::width-th float
    };

    HWY_INLINE Open* push_children(const Node& node, Open* top) const {
        alignas(4 * Node::width) float t[Node::width];
        Open* const base = top;
        for (uint32_t hits = test_children(boxes_, node, t_low_, t_cull_, t); hits;
             hits &= hits - 1) {
            const uint32_t i = lowest(hits);
            const Open child{t[i], node.child[i], &node.planes[0][0][i]};
            Open* at = top++;
            for (; at > base && goes_first(at[-1].t, child.t); --at) *at = at[-1];
            *at = child;
        }
        return top;
    }
    /// Whether what is entered at `other` is visited before what is entered at t, which is
    /// to go below it.
    static HWY_INLINE bool goes_first(float other, float t) {
        return Q == Query::closest ? other < t : other > t;
    }

    HWY_INLINE void visit_leaf(uint32_t child, uint32_t rays) {
        packet_.encounters += uint32_t(hwy::PopCount(rays));
        free_visits_ += 2 * int(hwy::PopCount(rays));
        if (leaves_.test(WideChild::first(child), WideChild::count(child), rays))
            t_cull_ = largest(packet_.t_cull);
    }
    template <class F>
    HWY_NOINLINE void leave_alone(uint32_t child, uint32_t rays, const F& alone) {
        bool nearer = false;
        for (; rays; rays &= rays - 1)
            nearer |=
                leaves_.alone(lowest(rays), [&](const LocalRay& ray, RayQuery& query)
                                                HWY_ATTR { return alone(ray, query, child); });
        if (nearer) t_cull_ = largest(packet_.t_cull);
    }

    const Node* const nodes_;
    RayPacket& packet_;
    const LocalRay beam_;
    const ChildrenTest<Node> boxes_;
    PacketLeaves<Q, Set, Leaves> leaves_;
    bool down_[3];
    const float t_low_;
    float t_cull_;
    int free_visits_ = 12;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
