// Traversal of WideNodes by packets; included once per target, after ChildrenTest.
#if defined(CROFTON_ACCELERATORS_WIDE_PACKET_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_WIDE_PACKET_H_
#undef CROFTON_ACCELERATORS_WIDE_PACKET_H_
#else
#define CROFTON_ACCELERATORS_WIDE_PACKET_H_
#endif

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// A packet's rays side by side.
class PacketRays {
  public:
    explicit HWY_INLINE PacketRays(const RayPacket& packet) {
        for (uint32_t r = 0; r < RayPacket::most; ++r) {
            const bool used = r < packet.count;
            const LocalRay& ray = packet.local[used ? r : 0];
            for (int a = 0; a < 3; ++a) {
                near_origin_[a][r] = ray.near_origin[a];
                far_origin_[a][r] = ray.far_origin[a];
                rcp_[a][r] = ray.rcp[a];
                far_rcp_[a][r] = ray.far_rcp[a];
            }
            t_low_[r] = used ? packet.query[r].t_low : INFINITY;
            t_cull_[r] = used ? packet.query[r].t_cull : -INFINITY;
        }
    }
    /// Ray r goes no further than this; -inf: it looks for nothing any more.
    void set_cull(uint32_t r, float t) { t_cull_[r] = t; }

    float least_t_low() const { return reduce(t_low_, false); }
    float most_t_cull() const { return reduce(t_cull_, true); }

    /// @param planes  of the box: lower x, y, z, upper x, y, z, every eighth float
    /// @param down    whether directions are negative, by axis
    /// @return bit r: ray r may meet the box, see LocalRay
    HWY_INLINE uint32_t meet(const float* planes, const bool (&down)[3]) const {
        uint32_t hits = 0;
        for (size_t r = 0; r < RayPacket::most; r += N) {
            auto enter = hn::Load(d, t_low_ + r), leave = hn::Load(d, t_cull_ + r);
            for (size_t a = 0; a < 3; ++a) {
                const auto in = hn::Set(d, planes[8 * (down[a] ? a + 3 : a)]);
                const auto out = hn::Set(d, planes[8 * (down[a] ? a : a + 3)]);
                enter = hn::Max(enter, hn::Mul(hn::Sub(in, hn::Load(d, near_origin_[a] + r)),
                                               hn::Load(d, rcp_[a] + r)));
                leave = hn::Min(leave, hn::Mul(hn::Sub(out, hn::Load(d, far_origin_[a] + r)),
                                               hn::Load(d, far_rcp_[a] + r)));
            }
            uint8_t bits[8] = {};
            hn::StoreMaskBits(d, hn::Le(enter, leave), bits);
            hits |= (uint32_t(bits[0]) | uint32_t(bits[1]) << 8) << r;
        }
        return hits;
    }

    /// Over all rays, of near_origin and so on.
    struct Ends {
        float low[3], high[3];
    };
    Ends near_origin() const { return ends(near_origin_); }
    Ends far_origin() const { return ends(far_origin_); }
    Ends rcp() const { return ends(rcp_); }
    Ends far_rcp() const { return ends(far_rcp_); }

  private:
    static constexpr hn::CappedTag<float, RayPacket::most> d{};
    static constexpr size_t N = hn::MaxLanes(d);
    using Row = float[RayPacket::most];

    static HWY_INLINE float reduce(const Row& row, bool largest) {
        auto all = hn::Load(d, row);
        for (size_t r = N; r < RayPacket::most; r += N) {
            const auto next = hn::Load(d, row + r);
            all = largest ? hn::Max(all, next) : hn::Min(all, next);
        }
        return hn::GetLane(largest ? hn::MaxOfLanes(d, all) : hn::MinOfLanes(d, all));
    }
    static HWY_INLINE Ends ends(const Row (&rows)[3]) {
        Ends e;
        for (int a = 0; a < 3; ++a) {
            e.low[a] = reduce(rows[a], false);
            e.high[a] = reduce(rows[a], true);
        }
        return e;
    }

    alignas(64) Row near_origin_[3], far_origin_[3], rcp_[3], far_rcp_[3];
    alignas(64) Row t_low_, t_cull_;
};

/// Where the first of a packet's rays may enter, and the last may leave, some children of a node
/// (interval arithmetic: Boulos, Wald, Shirley 2006, "Geometric and arithmetic culling methods for
/// entire ray packets"). Rounding is monotone: no ray's meet() finds what this one misses.
class PacketChildrenTest {
  public:
    explicit HWY_INLINE PacketChildrenTest(const RayPacket& packet, const PacketRays& rays)
        : offsets_(packet.local[0], offsetof(WideNode, planes), 8 * sizeof(float)),
          rcp_(rays.rcp()),
          far_rcp_(rays.far_rcp()) {
        const PacketRays::Ends near = rays.near_origin(), far = rays.far_origin();
        for (int a = 0; a < 3; ++a) {
            const bool down = rcp_.low[a] < 0;
            enter_origin_[a] = down ? near.low[a] : near.high[a];
            leave_origin_[a] = down ? far.high[a] : far.low[a];
        }
    }

    /// See ChildrenTest; t_near is that of the first.
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
        return lane_bits(hn::Le(enter, leave)) << first;
    }

    PlaneOffsets offsets_;
    PacketRays::Ends rcp_, far_rcp_;
    float enter_origin_[3], leave_origin_[3];
};

/// A packet goes down the tree as one; at a leaf all its rays are tested against the box at once,
/// and those that meet it test what is inside as they would have alone. Hits do not depend on which
/// further leaves are visited, so they are those of single rays.
///
/// A packet goes as far as the last of its rays, and where those go different ways, or one of them
/// to the horizon, most of what it passes is met by few or none. So it may take `free_visits`, and
/// two for every ray that has met a leaf.
/// @return  false: it took more than that and gave up; its rays have still to be traced, from the
///          root, with what they found so far
template <Query Q, class Set, class Leaves>
bool trace_packet(const WideBvh<Set>& bvh, const Leaves& leaves, const Set& set,
                  RayPacket& packet) {
    constexpr int free_visits = 32;
    if (bvh.box.empty() || packet.count == 0) return true;
    int visits_left = free_visits;
    struct Open {
        float t;
        uint32_t child;
        const float* planes;  ///< of the child, every eighth float
    };
    const WideNode* nodes = bvh.nodes.data();
    PacketRays rays(packet);
    const PacketChildrenTest boxes(packet, rays);
    bool down[3];
    for (int a = 0; a < 3; ++a) down[a] = std::signbit(packet.local[0].rcp[a]);
    const float t_low = rays.least_t_low();
    float t_cull = rays.most_t_cull();
    NoCounters none;
    Open stack[WideBvh<Set>::max_depth * (WideBvh<Set>::width - 1) + 1];
    Open* top = stack;
    *top++ = {-INFINITY, 0, nullptr};
    while (top > stack) {
        const Open open = *--top;
        if (open.t > t_cull) continue;
        if (--visits_left < 0) return false;
        if (!WideChild::is_leaf(open.child)) {
            const WideNode& node = node_at(nodes, open.child);
            alignas(32) float t[8];
            Open* const base = top;
            for (uint32_t hits = boxes.test(node, t_low, t_cull, t); hits; hits &= hits - 1) {
                const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                const Open child{t[i], node.child[i], &node.planes[0][0][i]};
                Open* at = top++;
                for (; at > base && at[-1].t < child.t; --at) *at = at[-1];
                *at = child;
            }
            continue;
        }
        bool nearer = false;
        for (uint32_t hits = rays.meet(open.planes, down); hits; hits &= hits - 1) {
            const uint32_t r = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
            visits_left += 2;
            RayQuery& q = packet.query[r];
            const float before = q.t_cull;
            const bool found = test_leaf<Q>(set, leaves, WideChild::first(open.child),
                                            WideChild::count(open.child), packet.local[r], q, none);
            if (Q == Query::any && found) packet.found[r] = true;
            if (found || q.t_cull != before) {
                rays.set_cull(r, found ? -INFINITY : q.t_cull);
                nearer = true;
            }
        }
        if (nearer) t_cull = rays.most_t_cull();
    }
    return true;
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
