// Box tests of packets; included once per target, after simd.h.
#if defined(CROFTON_ACCELERATORS_PACKET_BOXES_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_PACKET_BOXES_H_
#undef CROFTON_ACCELERATORS_PACKET_BOXES_H_
#else
#define CROFTON_ACCELERATORS_PACKET_BOXES_H_
#endif

#include "framework/ray_packet.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Some of a packet's rays, one a lane.
using RayLanes = hn::CappedTag<float, RayPacket::most>;

/// Rays of a packet that go one way in a space, and the boxes there.
class PacketBoxes {
  public:
    /// @param rays  bits
    HWY_INLINE PacketBoxes(const RayPacket& packet, const LocalPacket& space, uint32_t rays)
        : packet_(packet), space_(space), rays_(rays) {
        for (int a = 0; a < 3; ++a) down_[a] = std::signbit(space.rcp[a][lowest(rays)]);
    }

    /// Which of the rays may meet a box.
    /// @param planes  of the box: lower x, y, z, upper x, y, z, every `stride`-th float
    /// @return bit r: ray r may, see LocalRay
    HWY_INLINE uint32_t meet(const float* planes, size_t stride) const {
        const RayLanes d;
        uint32_t hits = 0;
        for (size_t r = 0; r < RayPacket::most; r += hn::MaxLanes(d)) {
            auto enter = hn::Load(d, packet_.t_low + r), leave = hn::Load(d, packet_.t_cull + r);
            for (size_t a = 0; a < 3; ++a) {
                const auto in = hn::Set(d, planes[stride * (down_[a] ? a + 3 : a)]);
                const auto out = hn::Set(d, planes[stride * (down_[a] ? a : a + 3)]);
                enter = hn::Max(enter, hn::Mul(hn::Sub(in, hn::Load(d, space_.near_origin[a] + r)),
                                               hn::Load(d, space_.rcp[a] + r)));
                leave = hn::Min(leave, hn::Mul(hn::Sub(out, hn::Load(d, space_.far_origin[a] + r)),
                                               hn::Load(d, space_.far_rcp[a] + r)));
            }
            hits |= mask_bits(d, hn::Le(enter, leave)) << r;
        }
        return hits & rays_;
    }

    /// A ray that enters any box no later than the first of the rays, and leaves it no earlier than
    /// the last (interval arithmetic: Boulos, Wald, Shirley 2006, "Geometric and arithmetic culling
    /// methods for entire ray packets").
    ///
    /// It starts from the ends of all near and far origins, is the fastest to enter and the slowest
    /// to leave. That is enough since no ray begins before t = 0: a plane behind an origin is left
    /// alone where it is one to enter by, and ends the matter for all rays where it is one to leave
    /// by. The rounding of `ChildrenTest` moves an origin by u·|o|, for which the pad that is in
    /// the end of the origins has room as it has for a single ray.
    HWY_INLINE LocalRay beam() const {
        LocalRay beam{};
        for (int a = 0; a < 3; ++a) {
            const float low = least(space_.rcp[a]), high = largest(space_.rcp[a]);
            const auto& near = space_.near_origin[a];
            const auto& far = space_.far_origin[a];
            beam.near_origin[a] = down_[a] ? least(near) : largest(near);
            beam.far_origin[a] = down_[a] ? largest(far) : least(far);
            beam.rcp[a] = down_[a] ? high : low;
            beam.far_rcp[a] = (down_[a] ? low : high) * (1 + box_slack);
            beam.near_base[a] = beam.near_origin[a] * beam.rcp[a];
            beam.far_base[a] = beam.far_origin[a] * beam.far_rcp[a];
        }
        return beam;
    }
    /// Where the first of the rays begins, and the last looks for nothing any more.
    HWY_INLINE float t_low() const { return least(packet_.t_low); }
    HWY_INLINE float t_cull() const { return largest(packet_.t_cull); }

  private:
    static constexpr size_t N = hn::MaxLanes(RayLanes());

    HWY_INLINE float least(const RayPacket::Row& row) const {
        const RayLanes d;
        auto all = hn::Set(d, std::numeric_limits<float>::infinity());
        for (size_t r = 0; r < RayPacket::most; r += N)
            all = hn::Min(all, hn::IfThenElse(bits_mask(d, rays_ >> r), hn::Load(d, row + r), all));
        return hn::GetLane(hn::MinOfLanes(d, all));
    }
    HWY_INLINE float largest(const RayPacket::Row& row) const {
        const RayLanes d;
        auto all = hn::Set(d, -std::numeric_limits<float>::infinity());
        for (size_t r = 0; r < RayPacket::most; r += N)
            all = hn::Max(all, hn::IfThenElse(bits_mask(d, rays_ >> r), hn::Load(d, row + r), all));
        return hn::GetLane(hn::MaxOfLanes(d, all));
    }

    const RayPacket& packet_;
    const LocalPacket& space_;
    const uint32_t rays_;
    bool down_[3];
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
