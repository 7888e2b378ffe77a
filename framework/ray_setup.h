// What a ray needs before it is traced; included once per target.
#if defined(CROFTON_FRAMEWORK_RAY_SETUP_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_RAY_SETUP_H_
#undef CROFTON_FRAMEWORK_RAY_SETUP_H_
#else
#define CROFTON_FRAMEWORK_RAY_SETUP_H_
#endif

#include <hwy/highway.h>

#include <cmath>
#include <cstddef>

#include "framework/ray_query.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace ray_setup {
namespace hn = hwy::HWY_NAMESPACE;

constexpr hn::FixedTag<float, 4> f4;
constexpr hn::RebindToUnsigned<decltype(f4)> u4;
constexpr hn::RebindToSigned<decltype(f4)> i4;
using Float4 = hn::Vec<decltype(f4)>;

/// What t_min, t_low, t_best and t_cull differ by from the ends, in shares of these.
alignas(16) constexpr float slack_of_lane[4] = {0, -cull_slack, 0, cull_slack};
alignas(16) constexpr uint32_t slack_lanes[4] = {0, ~0u, 0, ~0u};

/// Bits of lanes 0 to 2.
HWY_INLINE uint32_t lanes3(hn::Mask<decltype(f4)> mask) {
    uint8_t bits[8];
    hn::StoreMaskBits(f4, mask, bits);
    return bits[0] & 7;
}

/// Whether lanes 0 to 2 of both are neither NaN nor infinite.
HWY_INLINE bool finite3(Float4 v, Float4 w) {
    const auto zero = hn::Zero(f4);
    return lanes3(hn::Eq(hn::Add(hn::Mul(v, zero), hn::Mul(w, zero)), zero)) == 7;
}

/// The order of axes for a ray whose main axis is z, in the forms in which it is needed.
struct alignas(64) AxisOrder {
    int32_t axis[4];     ///< kx, ky, kz, and 0
    uint8_t order[16];   ///< bytes of components x, y, z, z in a vector
    uint8_t spread[16];  ///< bytes of component z four times
};
constexpr AxisOrder axis_order(int z) {
    AxisOrder a{{(z + 1) % 3, (z + 2) % 3, z, 0}, {}, {}};
    for (int i = 0; i < 16; ++i) {
        a.order[i] = uint8_t(4 * a.axis[i / 4 < 2 ? i / 4 : 2] + i % 4);
        a.spread[i] = uint8_t(4 * z + i % 4);
    }
    return a;
}
/// By the set of axes (bit a) along which a direction is longest; of several, the last is the main.
constexpr AxisOrder axis_orders[8] = {axis_order(0), axis_order(0), axis_order(1), axis_order(1),
                                      axis_order(2), axis_order(2), axis_order(2), axis_order(2)};

/// Axis order and shear; and the instance is none.
/// @param d        direction as the query has it
/// @param inverse  1/d
/// @param longest  bits 0 to 2: axes along which it is longest
HWY_INLINE void set_axes(RayQuery& q, Float4 d, Float4 inverse, uint32_t longest) {
    static_assert(offsetof(RayQuery, instance) == offsetof(RayQuery, kx) + 12 &&
                  offsetof(RayQuery, shear_z) == offsetof(RayQuery, shear_x) + 8);
    const AxisOrder& axes = axis_orders[longest];
    const hn::Repartition<uint8_t, decltype(f4)> u8;
    const auto pick = [&](Float4 v, const uint8_t* bytes) HWY_ATTR {
        return hn::BitCast(f4, hn::TableLookupBytes(hn::BitCast(u8, v), hn::Load(u8, bytes)));
    };
    const auto shear_z = pick(inverse, axes.spread);
    hn::StoreU(hn::Load(i4, axes.axis), i4, &q.kx);  // the fourth is q.instance
    hn::StoreU(hn::Mul(pick(d, axes.order), shear_z), f4, &q.shear_x);
    q.shear_z = hn::GetLane(shear_z);
}

/// Where scaling rounds the ends of the interval, nothing outside of it may be let in.
HWY_NOINLINE HWY_MAYBE_UNUSED static void keep_inside(const Ray& ray, float up, float down,
                                                      RayQuery& q) {
    float t_min = ray.t_min * up, t_max = ray.t_max * up;
    while (t_min * down < ray.t_min) t_min = std::nextafter(t_min, INFINITY);
    while (t_max * down > ray.t_max) t_max = std::nextafter(t_max, -INFINITY);
    q.set_min(t_min);
    q.set_best(t_max);
}

/// @param o, d  the ray, whose fourth lanes are t_min and t_max
HWY_INLINE void set_interval(const Ray& ray, Float4 o, Float4 d, Float4 up, Float4 down,
                             RayQuery& q) {
    static_assert(offsetof(RayQuery, t_cull) == offsetof(RayQuery, t_min) + 12);
    const auto ends = hn::ConcatUpperUpper(f4, hn::Broadcast<3>(d), hn::Broadcast<3>(o));
    const auto size = hn::Abs(ends);
    // An end that may be no normal float once it is scaled.
    const auto tiny = hn::And(hn::Lt(size, hn::Set(f4, 0x1p-100f)), hn::Ne(ends, hn::Zero(f4)));
    if (HWY_UNLIKELY(!hn::AllFalse(f4, tiny)))
        return keep_inside(ray, hn::GetLane(up), hn::GetLane(down), q);
    // Also where an end is infinite: that gets no slack, and its product with 0 is masked.
    const auto slack = hn::And(hn::Mul(hn::Mul(size, up), hn::Load(f4, slack_of_lane)),
                               hn::BitCast(f4, hn::Load(u4, slack_lanes)));
    hn::StoreU(hn::Add(hn::Mul(ends, up), slack), f4, &q.t_min);
}

/// Everything of a LocalRay that follows from origin, direction and pad.
/// @param inverse  1/d
/// @param limit  of |rcp|: a direction component below 1/limit moves the ray by less than the least
///               pad over any distance within the object, and may be replaced by that bound
HWY_INLINE void complete(LocalRay& ray, Float4 o, Float4 d, Float4 inverse, Float4 pad, float t_min,
                         float magnitude, float limit) {
    const auto size = hn::Abs(o);
    pad = hn::Add(hn::Add(pad, hn::Set(f4, magnitude_pad * magnitude)),
                  hn::Mul(size, hn::Set(f4, origin_pad)));
    if (HWY_UNLIKELY(t_min < 0))
        pad = hn::Add(pad,
                      hn::Mul(hn::Set(f4, 4 * box_slack), hn::Add(size, hn::Set(f4, magnitude))));
    auto most = hn::Set(f4, limit);
    // Far beyond the range that is promised, the product of origin and rcp has to remain a float.
    const auto product = hn::Mul(hn::Add(size, pad), most);
    if (HWY_UNLIKELY(!hn::AllFalse(f4, hn::Gt(product, hn::Set(f4, 0x1p124f)))))
        most = hn::Min(most, hn::Div(hn::Set(f4, 0x1p124f), hn::Add(size, pad)));
    const auto rcp = hn::CopySign(hn::Min(hn::Abs(inverse), most), d);
    const auto shift = hn::CopySign(pad, rcp);
    hn::StoreU(o, f4, ray.origin);
    hn::StoreU(d, f4, ray.direction);
    hn::StoreU(pad, f4, ray.pad);
    hn::StoreU(rcp, f4, ray.rcp);
    const auto far_rcp = hn::Mul(rcp, hn::Set(f4, 1 + box_slack));
    const auto near_origin = hn::Add(o, shift), far_origin = hn::Sub(o, shift);
    hn::StoreU(far_rcp, f4, ray.far_rcp);
    hn::StoreU(near_origin, f4, ray.near_origin);
    hn::StoreU(far_origin, f4, ray.far_origin);
    hn::StoreU(hn::Mul(near_origin, rcp), f4, ray.near_base);
    hn::StoreU(hn::Mul(far_origin, far_rcp), f4, ray.far_base);
}

/// See crofton::prepare. The operations are the same on every target, and so are their results.
HWY_NOINLINE HWY_MAYBE_UNUSED static bool prepare(const Ray& ray, float magnitude, RayQuery& q,
                                                  LocalRay& local, float& scale) {
    static_assert(offsetof(Ray, direction) == 16, "the fourth lanes are t_min and t_max");
    const auto o = hn::LoadU(f4, ray.origin.data());
    const auto d = hn::LoadU(f4, ray.direction.data());
    const auto length = hn::Abs(d);
    const auto longest = hn::Max(hn::Max(hn::Broadcast<0>(length), hn::Broadcast<1>(length)),
                                 hn::Broadcast<2>(length));
    // Of a denormal or nearly infinite direction, the power of two itself is no float.
    const auto exponent = hn::And(hn::BitCast(u4, longest), hn::Set(u4, 0x7f800000u));
    const uint32_t exponent_bits = hn::GetLane(exponent);
    if (HWY_UNLIKELY(exponent_bits - 0x00800000u > 0x7e000000u)) return false;
    if (HWY_UNLIKELY(!(ray.t_min <= ray.t_max) || !finite3(o, d))) return false;
    const auto up = hn::BitCast(f4, exponent);
    const auto down = hn::BitCast(f4, hn::Sub(hn::Set(u4, 0x7f000000u), exponent));

    const auto scaled = hn::Mul(d, down);
    // The quotient does not wait for the power of two. It would be infinite too early for
    // components below 2^-128, which `complete` replaces if they are so much less than the largest.
    auto inverse = hn::Mul(hn::Div(hn::Set(f4, 1.0f), d), up);
    constexpr uint32_t least = (127 - 60) << 23;
    if (HWY_UNLIKELY(exponent_bits < least)) inverse = hn::Div(hn::Set(f4, 1.0f), scaled);
    hn::StoreU(o, f4, q.origin);
    hn::StoreU(scaled, f4, q.direction);
    set_axes(q, scaled, inverse, lanes3(hn::Eq(length, longest)));
    set_interval(ray, o, d, up, down, q);
    scale = hn::GetLane(down);
    q.hit_ids = nullptr;
    q.mode = Mode::robust;

    local.frame = nullptr;
    complete(local, o, scaled, inverse, hn::Zero(f4), q.t_min, magnitude, rcp_limit);
    return true;
}

}  // namespace ray_setup
}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
