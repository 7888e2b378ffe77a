#include "framework/ray_packet.h"

#include <hwy/highway.h>

#include <bit>

namespace crofton {

namespace hn = hwy::HWY_NAMESPACE;

namespace {
uint32_t exponent(float x) { return std::bit_cast<uint32_t>(x) >> 23u & 255u; }
}  // namespace

bool RayPacket::suits(std::span<const Ray> rays, const Bounds3& box) {
    constexpr hn::FixedTag<float, 4> f4;
    static_assert(offsetof(Ray, direction) == 16, "the fourth lanes are t_min and t_max");
    const auto load = [&](const Vec3f& v) { return hn::LoadU(f4, v.data()); };
    const auto xyz = hn::FirstN(f4, 3);
    auto o_low = load(rays[0].origin), o_high = o_low;
    auto d_low = load(rays[0].direction), d_high = d_low;
    const auto one_way = [&] {
        const auto a = hn::IfThenElseZero(xyz, hn::Abs(d_low)),
                   b = hn::IfThenElseZero(xyz, hn::Abs(d_high));
        // Each ray's largest component is between these: they are scaled alike.
        const auto least = hn::MaxOfLanes(f4, hn::Min(a, b)),
                   largest = hn::MaxOfLanes(f4, hn::Max(a, b));
        if (exponent(hn::GetLane(least)) != exponent(hn::GetLane(largest))) return false;
        const auto spread = hn::Le(hn::Mul(hn::Sub(d_high, d_low), hn::Set(f4, 8.0f)), largest);
        const auto sign = hn::Gt(hn::Mul(d_low, d_high), hn::Zero(f4));
        // A NaN may get lost in minima; `prepare` leaves its ray out.
        return hn::AllTrue(f4, hn::Or(hn::And(spread, sign), hn::Not(xyz)));
    };
    // Of rays that go anywhere, the first and the last tell already.
    const auto last = load(rays.back().direction);
    d_low = hn::Min(d_low, last);
    d_high = hn::Max(d_high, last);
    if (!one_way()) return false;
    for (const Ray& ray : rays.subspan(1)) {
        const auto o = load(ray.origin), d = load(ray.direction);
        o_low = hn::Min(o_low, o);
        o_high = hn::Max(o_high, o);
        d_low = hn::Min(d_low, d);
        d_high = hn::Max(d_high, d);
    }
    const float near = (box.upper - box.lower).maxCoeff() * 0x1p-6f;
    const auto close = hn::Le(hn::Sub(o_high, o_low), hn::Set(f4, near));
    return one_way() && hn::AllTrue(f4, hn::Or(close, hn::Not(xyz)));
}

void RayPacket::prepare(std::span<const Ray> rays, size_t first, float magnitude, Mode mode) {
    count = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
        if (!crofton::prepare(rays[i], magnitude, query[count], local[count], scale[count]))
            continue;
        query[count].mode = mode;
        found[count] = false;
        index[count++] = uint32_t(first + i);
    }
}

}  // namespace crofton
