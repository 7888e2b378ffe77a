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
    /// @param rays  bits of those that are traced, which go one way in this space
    HWY_INLINE PacketTraversal(const Node* nodes, const Leaves& leaves, const Set& set,
                               RayPacket& packet, LocalPacket& space, uint32_t rays)
        : nodes_(nodes),
          packet_(packet),
          rays_(rays),
          boxes_(packet, space, rays),
          beam_(boxes_.beam()),
          children_(beam_),
          leaves_(leaves, set, boxes_, packet, space),
          t_low_(boxes_.t_low()),
          t_cull_(boxes_.t_cull()) {}

    /// @param start  a WideChild
    /// @param alone  (ray, query, child): traces a ray from a child on, and returns whether that
    ///               answered an `any` query
    template <class F>
    HWY_INLINE void run(uint32_t start, const F& alone) {
        if (WideChild::is_leaf(start)) return visit_leaf(start, rays_);
        Open stack[BinaryTree::max_depth * (Node::width - 1) + 1];
        Open* top = stack;
        *top++ = {-std::numeric_limits<float>::infinity(), start, nullptr};
        while (top > stack) {
            const Open open = *--top;
            if (open.t > t_cull_) continue;
            const bool leaf = WideChild::is_leaf(open.child);
            ++packet_.visits;
            if (leaf || --free_visits_ < 0) {
                const uint32_t rays = boxes_.meet(open.planes, Node::width);
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
        for (uint32_t hits = test_children(children_, node, t_low_, t_cull_, t); hits;
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
            t_cull_ = boxes_.t_cull();
    }
    template <class F>
    HWY_NOINLINE void leave_alone(uint32_t child, uint32_t rays, const F& alone) {
        bool nearer = false;
        for (; rays; rays &= rays - 1)
            nearer |=
                leaves_.alone(lowest(rays), [&](const LocalRay& ray, RayQuery& query)
                                                HWY_ATTR { return alone(ray, query, child); });
        if (nearer) t_cull_ = boxes_.t_cull();
    }

    const Node* const nodes_;
    RayPacket& packet_;
    const uint32_t rays_;
    const PacketBoxes boxes_;
    const LocalRay beam_;
    const ChildrenTest<Node> children_;
    PacketLeaves<Q, Set, Leaves> leaves_;
    const float t_low_;
    float t_cull_;
    int free_visits_ = 12;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
