// Traversal of wide nodes by crowds of rays; included once per target.
#if defined(CROFTON_ACCELERATORS_WIDE_CROWD_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_WIDE_CROWD_H_
#undef CROFTON_ACCELERATORS_WIDE_CROWD_H_
#else
#define CROFTON_ACCELERATORS_WIDE_CROWD_H_
#endif

#include <algorithm>
#include <cstddef>
#include <new>
#include <span>

#include "accelerators/packed_lanes.h"
#include "accelerators/wide_children_test.h"
#include "framework/compact_patch_test.h"
#include "framework/patch_test.h"
#include "framework/ray_crowd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Triangles, whose structures may be too large for caches, and objects, to bring rays that enter
/// one of them there together.
template <class Set>
concept GoesInCrowds = std::is_same_v<Set, TriangleSet> || std::is_same_v<Set, ObjectSet>;

/// Traces a crowd: `slots` rays are under way, each goes a step in turn, and where one is done the
/// next takes its place.
///
/// A ray asks for what it needs next and comes back when fifteen others have gone a step, so that
/// as many requests to memory are on their way at a time. A step through a node has no branch that
/// depends on what is hit: all that is left of its children goes on the stack in one piece, the
/// nearest, found as a minimum, is next, and where nothing is hit the stack's topmost that is near
/// enough. Leaves are kept until few rays are at nodes.
///
/// Hits do not depend on which further leaves are visited, so they are those of single rays.
template <Query Q, class Node, class Set, class Leaves>
class CrowdTraversal {
  public:
    /// @param first  a WideChild, where rays start
    HWY_INLINE CrowdTraversal(const Node* nodes, const Leaves& leaves, const Set& set,
                              RayCrowd& crowd, uint32_t first)
        : nodes_(nodes), leaves_(leaves), set_(set), crowd_(crowd), first_(first) {}

    /// @param alone  (ray, query): traces a ray from the first child on, and returns whether that
    /// answered an
    ///               `any` query
    template <class F>
    HWY_INLINE void run(const F& alone) {
        for (uint32_t s = 0; s < slots && next_ < crowd_.size; ++s) start(slot_[s]);
        while (at_nodes_.size + at_leaves_.size > 0) {
            const Waiting down = at_nodes_.take();
            for (Slot* slot : down) go_down(*slot);
            if (at_nodes_.size > few) continue;
            const Waiting here = at_leaves_.take();
            if constexpr (over_objects) visit_objects(here);
            for (Slot* slot : here) visit_leaf(*slot, alone);
        }
    }

  private:
    static constexpr bool over_objects = std::is_same_v<Set, ObjectSet>;
    /// Rays on their way. Over objects as many as there are, so that those in one object are many.
    static constexpr uint32_t slots = over_objects ? RayCrowd::most : 16;
    static constexpr uint32_t few = 4;
    static constexpr NodeLanes<Node> d{};
    static constexpr uint32_t N = hn::MaxLanes(d), W = Node::width;
    using D32 = hn::RebindToUnsigned<NodeLanes<Node>>;
    /// Children on a stack; a ray with more goes on alone.
    static constexpr uint32_t room = 96;
    static constexpr float infinity = std::numeric_limits<float>::infinity();

    /// A ray on its way. Its stack begins with N places that are never near enough, for a vector to
    /// reach below the first, and with the end, which always is.
    struct Slot {
        alignas(alignof(ChildrenTest<Node>)) std::byte boxes_memory[sizeof(ChildrenTest<Node>)];
        const LocalRay* ray;
        RayQuery* query;
        float t_low;
        uint32_t index;    ///< in the crowd
        uint32_t current;  ///< a WideChild
        uint32_t top;
        float t[N + 1 + room + W];
        uint32_t child[N + 1 + room + W];

        HWY_INLINE const ChildrenTest<Node>& boxes() const {
            return *reinterpret_cast<const ChildrenTest<Node>*>(boxes_memory);
        }
    };
    struct Waiting {
        Slot* slot[slots];
        uint32_t size = 0;

        HWY_INLINE Waiting take() {
            const Waiting all = *this;
            size = 0;
            return all;
        }
        Slot* const* begin() const { return slot; }
        Slot* const* end() const { return slot + size; }
    };

    HWY_INLINE void start(Slot& slot) {
        slot.index = next_++;
        slot.ray = crowd_.local[slot.index];
        slot.query = crowd_.query[slot.index];
        new (slot.boxes_memory) ChildrenTest<Node>(*slot.ray);
        slot.t_low = slot.query->t_low;
        hn::StoreU(hn::Set(d, infinity), d, slot.t);
        slot.t[N] = -infinity;
        slot.child[N] = WideChild::end;
        slot.top = N + 1;
        go_to(slot, first_);
    }
    HWY_INLINE void go_to(Slot& slot, uint32_t child) {
        slot.current = child;
        const bool leaf = WideChild::is_leaf(child);
        at_nodes_.slot[at_nodes_.size] = &slot;
        at_leaves_.slot[at_leaves_.size] = &slot;
        at_nodes_.size += !leaf;
        at_leaves_.size += leaf;
        prefetch_child(nodes_, leaves_, child);
    }
    /// Where the stack's topmost child is that begins no further than t_cull.
    HWY_INLINE uint32_t nearer_than(const Slot& slot, float t_cull) const {
        for (uint32_t top = slot.top;; top -= N) {
            const auto t = hn::LoadU(d, slot.t + (top - N));
            const uint32_t beyond = mask_bits(d, hn::Gt(t, hn::Set(d, t_cull)));
            const uint32_t near = ~beyond & ((1u << N) - 1);
            if (HWY_LIKELY(near)) return top - N + highest(near);
        }
    }
    static HWY_INLINE uint32_t highest(uint32_t bits) {
        return 31 - uint32_t(hwy::Num0BitsAboveMS1Bit_Nonzero32(bits));
    }
    static HWY_INLINE uint32_t select(bool first, uint32_t a, uint32_t b) {
        return b ^ ((a ^ b) & (0u - uint32_t(first)));  // never a branch
    }

    HWY_INLINE void go_down(Slot& slot) {
        const Node& node = node_at(nodes_, slot.current);
        const float t_cull = slot.query->t_cull;
        const hn::RebindToSigned<NodeLanes<Node>> di;
        const auto none = hn::Set(di, std::numeric_limits<int32_t>::max());
        auto nearest = none;
        const ChildrenMet<Node> children = slot.boxes()(node, slot.t_low, t_cull);
        const uint32_t hits = children.bits();
        for (uint32_t p = 0; p < W / N; ++p) {
            // As integers distances are in their order (below zero not the best one), and the last
            // bits, which do not matter for it, say whose they are.
            if constexpr (Q == Query::closest) {
                const auto key = hn::Or(
                    hn::AndNot(hn::Set(di, int32_t(W) - 1), hn::BitCast(di, children.enter[p])),
                    hn::Iota(di, int32_t(p * N)));
                nearest = hn::Min(nearest,
                                  hn::IfThenElse(hn::RebindMask(di, children.met[p]), key, none));
            }
        }
        const uint32_t first = Q == Query::closest
                                   ? uint32_t(hn::GetLane(hn::MinOfLanes(di, nearest))) % W
                                   : lowest(hits | 1u << (W - 1));
        const uint32_t back = nearer_than(slot, t_cull), from_stack = slot.child[back];
        const uint32_t rest = hits & ~(1u << first);
        uint32_t top = slot.top;
        for (uint32_t p = 0; p < W / N; ++p) {
            const uint32_t part = rest >> p * N & ((1u << N) - 1);
            const PackedLanes<NodeLanes<Node>> pack(part);
            hn::StoreU(pack(children.enter[p]), d, slot.t + top);
            hn::StoreU(pack(hn::LoadU(D32(), node.child + p * N)), D32(), slot.child + top);
            top += uint32_t(hwy::PopCount(part));
        }
        slot.top = select(hits != 0, top, back);
        const uint32_t child = select(hits != 0, node.child[first], from_stack);
        go_to(slot, HWY_UNLIKELY(slot.top > room) ? WideChild::overflow : child);
    }

    template <class F>
    HWY_INLINE void visit_leaf(Slot& slot, const F& alone) {
        if (slot.current != WideChild::end) {
            bool found = is_found(slot);
            const bool overflow = slot.current == WideChild::overflow;
            if (overflow)
                found = alone(*slot.ray, *slot.query);
            else if constexpr (!over_objects)
                found = test(slot);
            if (Q == Query::any && found) set_found(slot);
            if (!found && !overflow) {
                slot.top = nearer_than(slot, slot.query->t_cull);
                return go_to(slot, slot.child[slot.top]);
            }
        }
        if (next_ < crowd_.size) start(slot);
    }
    HWY_INLINE bool test(const Slot& slot) const {
        NoCounters none;
        return test_leaf<Q>(set_, leaves_, WideChild::first(slot.current),
                            WideChild::count(slot.current), *slot.ray, *slot.query, none);
    }
    HWY_INLINE bool is_found(const Slot& slot) const { return crowd_.found >> slot.index & 1; }
    HWY_INLINE void set_found(const Slot& slot) { crowd_.found |= uint64_t(1) << slot.index; }

    struct Visit {
        uint32_t object;
        Slot* slot;
    };
    /// Brings the rays at leaves into the objects there: those that enter one object together.
    HWY_NOINLINE void visit_objects(const Waiting& here) {
        uint32_t most = 0;
        const auto count = [](const Slot& slot) {
            return WideChild::is_none(slot.current) ? 0 : WideChild::count(slot.current);
        };
        for (const Slot* slot : here) most = std::max(most, count(*slot));
        for (uint32_t i = 0; i < most; ++i) {
            Visit visits[slots];
            uint32_t size = 0;
            for (Slot* slot : here) {
                if (i >= count(*slot) || is_found(*slot)) continue;
                const uint32_t object = leaves_.references()[WideChild::first(slot->current) + i];
                float t_near, t_far;
                // The box of one object alone is the leaf's.
                if (count(*slot) == 1 ||
                    meets_box(set_.entry(object).bounds, *slot->ray, *slot->query, t_near, t_far))
                    visits[size++] = {object, slot};
            }
            std::sort(visits, visits + size,
                      [](const Visit& a, const Visit& b) { return a.object < b.object; });
            for (uint32_t begin = 0, end; begin < size; begin = end) {
                for (end = begin + 1; end < size && visits[end].object == visits[begin].object;)
                    ++end;
                enter(visits[begin].object, {visits + begin, visits + end});
            }
        }
    }
    void enter(uint32_t object, std::span<const Visit> visits) {
        constexpr size_t least_together = 3;
        const ObjectSet::Entry& entry = set_.entry(object);
        if (visits.size() < least_together || crowd_.depth == RayCrowd::deepest ||
            !entry.primitive->takes_crowds()) {
            NoCounters none;
            for (const Visit& visit : visits)
                if (trace_object<Q>(entry, *visit.slot->ray, *visit.slot->query, none))
                    set_found(*visit.slot);
            return;
        }
        RayCrowd inside;
        inside.depth = crowd_.depth + 1;
        for (const Visit& visit : visits) {
            visit.slot->query->instance += entry.instance;
            inside.add(*visit.slot->ray, *visit.slot->query);
        }
        Q == Query::any ? entry.primitive->any_crowd(inside)
                        : entry.primitive->closest_crowd(inside);
        for (size_t k = 0; k < visits.size(); ++k) {
            visits[k].slot->query->instance -= entry.instance;
            if (inside.found >> k & 1) set_found(*visits[k].slot);
        }
    }

    const Node* const nodes_;
    const Leaves& leaves_;
    const Set& set_;
    RayCrowd& crowd_;
    const uint32_t first_;
    uint32_t next_ = 0;  ///< of the crowd
    Waiting at_nodes_, at_leaves_;
    Slot slot_[slots];
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
