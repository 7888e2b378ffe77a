#include "framework/ray_packet.h"

#include <algorithm>
#include <bit>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "framework/ray_packet.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "framework/primitive.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

constexpr hn::CappedTag<float, RayPacket::most> d;
constexpr hn::RebindToSigned<decltype(d)> i;
constexpr size_t N = hn::MaxLanes(d);
using V = hn::Vec<decltype(d)>;

/// Transposes.
/// @param rows  8
void load_packet(const Ray* rays, RayPacket::Row* rows) {
    for (size_t r = 0; r < RayPacket::most; r += N) {
        const float* const from = rays[r].origin.data();
        // Origins and directions, of half of the rays and of the others, in turns.
        V a[4], b[4];
        hn::LoadInterleaved4(d, from, a[0], a[1], a[2], a[3]);
        hn::LoadInterleaved4(d, from + 4 * N, b[0], b[1], b[2], b[3]);
        for (int k = 0; k < 4; ++k) {
            hn::Store(hn::ConcatEven(d, b[k], a[k]), d, rows[k] + r);
            hn::Store(hn::ConcatOdd(d, b[k], a[k]), d, rows[4 + k] + r);
        }
    }
}

/// Bits of all rays that start and go as ray `first`, whose axes and scale the packet has, and are
/// as ordinary.
uint32_t alike(const RayPacket& p, uint32_t first) {
    const int main = p.axis[2];
    const float up = 1 / p.scale;
    uint32_t alike = 0;
    for (size_t r = 0; r < RayPacket::most; r += N) {
        const auto zero = hn::Zero(d);
        const auto length = hn::Abs(hn::Load(d, p.given[4 + main] + r));
        const auto spread = hn::Set(d, std::abs(p.given[4 + main][first]) * 0.125f);
        const auto t_min = hn::Load(d, p.given[3] + r), t_max = hn::Load(d, p.given[7] + r);
        // Ends of the interval that scaling keeps as they are, but for a power of two.
        const auto least = hn::Set(d, 0x1p-100f);
        auto same = hn::And(hn::Or(hn::Ge(t_min, least), hn::Eq(t_min, zero)),
                            hn::And(hn::Ge(t_max, least), hn::Le(t_min, t_max)));
        // One exponent, so that all are scaled alike.
        same = hn::And(same,
                       hn::And(hn::Ge(length, hn::Set(d, up)), hn::Lt(length, hn::Set(d, 2 * up))));
        auto signs = zero;  // less than 0 where one differs
        for (int a = 0; a < 3; ++a) {
            const auto way = hn::Load(d, p.given[4 + a] + r), o = hn::Load(d, p.given[a] + r);
            const auto first_way = hn::Set(d, p.given[4 + a][first]);
            const auto turn = hn::Abs(hn::Sub(way, first_way));
            const auto apart = hn::Abs(hn::Sub(o, hn::Set(d, p.given[a][first])));
            // False for NaN.
            same = hn::And(same, hn::And(hn::Le(turn, spread), hn::Le(apart, hn::Set(d, p.near))));
            signs = hn::Or(signs, hn::Xor(way, first_way));
            // Of equal ones the last axis is the main: see `prepare`.
            if (a > main) same = hn::And(same, hn::Lt(hn::Abs(way), length));
            if (a < main) same = hn::And(same, hn::Le(hn::Abs(way), length));
        }
        const auto one_way = hn::Gt(hn::BitCast(i, signs), hn::Set(i, -1));
        alike |= mask_bits(d, hn::And(same, hn::RebindMask(d, one_way))) << r;
    }
    return alike;
}

/// Operation by operation what `prepare` does for one ray, of those without its special cases.
void prepare_packet(RayPacket& p, uint32_t first) {
    const auto down = hn::Set(d, p.scale), up = hn::Set(d, 1 / p.scale), zero = hn::Zero(d);
    for (size_t r = 0; r < RayPacket::most; r += N) {
        const auto used = bits_mask(d, p.rays >> r);
        const auto given = [&](int row) HWY_ATTR {
            return hn::IfThenElse(used, hn::Load(d, p.given[row] + r),
                                  hn::Set(d, p.given[row][first]));
        };
        V way[3], inverse[3];
        for (int a = 0; a < 3; ++a) {
            const auto o = given(a), unscaled = given(4 + a);
            way[a] = hn::Mul(unscaled, down);
            inverse[a] = hn::Mul(hn::Div(hn::Set(d, 1.0f), unscaled), up);
            const auto pad = hn::Add(hn::Set(d, magnitude_pad * p.magnitude),
                                     hn::Mul(hn::Abs(o), hn::Set(d, origin_pad)));
            const auto rcp =
                hn::CopySign(hn::Min(hn::Abs(inverse[a]), hn::Set(d, rcp_limit)), way[a]);
            const auto shift = hn::CopySign(pad, rcp);
            hn::Store(o, d, p.origin[a] + r);
            hn::Store(way[a], d, p.direction[a] + r);
            hn::Store(rcp, d, p.world.rcp[a] + r);
            hn::Store(hn::Mul(rcp, hn::Set(d, 1 + box_slack)), d, p.world.far_rcp[a] + r);
            hn::Store(hn::Add(o, shift), d, p.world.near_origin[a] + r);
            hn::Store(hn::Sub(o, shift), d, p.world.far_origin[a] + r);
        }
        const auto per_main = inverse[p.axis[2]];
        hn::Store(hn::Mul(way[p.axis[0]], per_main), d, p.shear[0] + r);
        hn::Store(hn::Mul(way[p.axis[1]], per_main), d, p.shear[1] + r);
        hn::Store(per_main, d, p.shear[2] + r);

        const auto t_min = hn::Mul(given(3), up), t_max = hn::Mul(given(7), up);
        const auto t_low = hn::Add(t_min, hn::Mul(hn::Abs(t_min), hn::Set(d, -cull_slack)));
        const auto t_cull = hn::Add(t_max, hn::Mul(t_max, hn::Set(d, cull_slack)));
        const auto infinity = hn::Set(d, std::numeric_limits<float>::infinity());
        hn::Store(hn::Add(t_min, zero), d, p.t_min + r);  // no -0
        hn::Store(t_max, d, p.t_best + r);
        hn::Store(hn::IfThenElse(used, t_low, infinity), d, p.t_low + r);
        hn::Store(hn::IfThenElse(used, t_cull, hn::Neg(infinity)), d, p.t_cull + r);
    }
}

/// Operation by operation what crofton::enter does for one ray, as far as boxes need it.
uint32_t enter_packet(LocalPacket& local, const InstanceFrame& frame, const RayPacket& p) {
    uint32_t images = 0;
    std::fill_n(local.down, 3, 0);
    for (size_t r = 0; r < RayPacket::most; r += N) {
        V o[3], d_in[3], way[3];
        auto largest = hn::Zero(d);
        for (int a = 0; a < 3; ++a) {
            o[a] = hn::Load(d, p.origin[a] + r);
            d_in[a] = hn::Load(d, p.direction[a] + r);
        }
        const auto column = [&](int k, int a) HWY_ATTR { return hn::Set(d, frame.column[k][a]); };
        for (int a = 0; a < 3; ++a) {
            way[a] =
                hn::Add(hn::Add(hn::Mul(column(0, a), d_in[0]), hn::Mul(column(1, a), d_in[1])),
                        hn::Mul(column(2, a), d_in[2]));
            largest = hn::Max(largest, hn::Abs(way[a]));
        }
        const auto zero = hn::Zero(d), limit = hn::Div(hn::Set(d, rcp_limit), largest);
        auto ordinary = hn::Gt(largest, zero);
        for (int a = 0; a < 3; ++a) {
            const auto x = hn::Mul(column(0, a), o[0]), y = hn::Mul(column(1, a), o[1]),
                       z = hn::Mul(column(2, a), o[2]);
            const auto from = hn::Add(hn::Add(x, y), hn::Add(z, column(3, a)));
            const auto reach = hn::Add(hn::Add(hn::Abs(x), hn::Abs(y)), hn::Abs(z));
            const auto size = hn::Abs(from);
            const auto pad =
                hn::Add(hn::Add(hn::MulAdd(reach, hn::Set(d, frame_pad), hn::Set(d, frame.pad[a])),
                                hn::Set(d, magnitude_pad * frame.magnitude)),
                        hn::Mul(size, hn::Set(d, origin_pad)));
            // Finite, and so is the product of the origin and any rcp.
            ordinary = hn::And(ordinary, hn::Eq(hn::Mul(way[a], zero), zero));
            ordinary =
                hn::And(ordinary, hn::Le(hn::Mul(hn::Add(size, pad), limit), hn::Set(d, 0x1p124f)));
            const auto inverse = hn::Div(hn::Set(d, 1.0f), way[a]);
            const auto rcp = hn::CopySign(hn::Min(hn::Abs(inverse), limit), way[a]);
            const auto shift = hn::CopySign(pad, rcp);
            const auto down = hn::Lt(hn::BitCast(i, rcp), hn::Zero(i));
            local.down[a] |= mask_bits(d, hn::RebindMask(d, down)) << r;
            hn::Store(rcp, d, local.rcp[a] + r);
            hn::Store(hn::Mul(rcp, hn::Set(d, 1 + box_slack)), d, local.far_rcp[a] + r);
            hn::Store(hn::Add(from, shift), d, local.near_origin[a] + r);
            hn::Store(hn::Sub(from, shift), d, local.far_origin[a] + r);
        }
        images |= mask_bits(d, ordinary) << r;
    }
    return images;
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
namespace {
HWY_EXPORT(load_packet);
HWY_EXPORT(alike);
HWY_EXPORT(prepare_packet);
HWY_EXPORT(enter_packet);

uint32_t lowest(uint32_t bits) { return uint32_t(std::countr_zero(bits)); }
/// The power of two in |x|.
float power_of_two(float x) {
    return std::bit_cast<float>(std::bit_cast<uint32_t>(x) & 0x7f800000u);
}
/// Whether two rays may be alike: a cheap look.
bool may_go_together(const Ray& a, const Ray& b) {
    const Vec3f turn = (a.direction - b.direction).cwiseAbs();
    return turn.maxCoeff() <= 0.125f * a.direction.cwiseAbs().maxCoeff();
}
}  // namespace

RayPacket::RayPacket(const Bounds3& box, float m, Mode how) : mode(how), magnitude(m) {
    near = std::min((box.upper - box.lower).maxCoeff() * 0x1p-6f, 0x1p58f);
    // Beyond that `prepare` minds the product of origin and rcp.
    if (!(magnitude < 0x1p90f)) near = -1;
}

bool RayPacket::promising(const Ray* rays) {
    // One of the halves, where a line of a picture ends in the other.
    constexpr uint32_t half = most / 2;
    return may_go_together(rays[0], rays[half - 1]) || may_go_together(rays[half], rays[most - 1]);
}

void RayPacket::load(const Ray* rays) {
    source = rays;
    visits = encounters = 0;
    HWY_DYNAMIC_DISPATCH(load_packet)(rays, given);
}

uint32_t RayPacket::companions(uint32_t among) {
    const Ray& ray = source[lowest(among)];
    const Vec3f length = ray.direction.cwiseAbs();
    const int main = length[2] >= length[1] && length[2] >= length[0] ? 2 : length[1] >= length[0];
    const float up = power_of_two(length[main]);
    if (!(up >= 0x1p-60f && up <= 0x1p126f) || !(ray.origin.cwiseAbs().maxCoeff() < 0x1p58f))
        return 0;
    scale = 1 / up;
    for (int a = 0; a < 3; ++a) axis[a] = (main + 1 + a) % 3;
    const uint32_t alike = among & HWY_DYNAMIC_DISPATCH(alike)(*this, lowest(among));
    return alike & (among & -among) ? alike : 0;
}

void RayPacket::prepare(uint32_t companions) {
    rays = companions;
    found = hit_in_row = fresh = are_single = world.are_single_ = instance = depth = 0;
    HWY_DYNAMIC_DISPATCH(prepare_packet)(*this, lowest(companions));
}

void RayPacket::make_single(uint32_t r) {
    float same_scale;
    crofton::prepare(source[r], magnitude, queries[r], world.single_[r], same_scale);
    queries[r].mode = mode;
    are_single |= 1u << r;
    world.are_single_ |= 1u << r;
}

template <Query Q>
bool RayPacket::enter(const Primitive& object, LocalPacket& space, uint32_t some) {
    constexpr int least_together = 4;
    if (std::popcount(some) >= least_together && depth < deepest && object.takes_packets()) {
        ++depth;
        Q == Query::any ? object.any_packet(*this, space, some)
                        : object.closest_packet(*this, space, some);
        --depth;
        return true;
    }
    bool nearer = false;
    for (; some; some &= some - 1)
        nearer |= alone(lowest(some), space, [&](const LocalRay& ray, RayQuery& query) {
            if constexpr (Q == Query::any) return object.any_local(ray, query);
            object.closest_local(ray, query);
            return false;
        });
    return nearer;
}
template bool RayPacket::enter<Query::closest>(const Primitive&, LocalPacket&, uint32_t);
template bool RayPacket::enter<Query::any>(const Primitive&, LocalPacket&, uint32_t);

uint32_t LocalPacket::enter(const InstanceFrame& where, const RayPacket& packet, uint32_t rays) {
    frame = &where;
    are_single_ = 0;
    return rays & HWY_DYNAMIC_DISPATCH(enter_packet)(*this, where, packet);
}

uint32_t LocalPacket::one_way(uint32_t rays) const {
    const uint32_t first = rays & -rays;
    for (const uint32_t bits : down) rays &= bits & first ? bits : ~bits;
    return rays;
}

const LocalRay& LocalPacket::single(uint32_t r, const RayQuery& query) {
    if (!(are_single_ >> r & 1)) {
        crofton::enter(*frame, query, single_[r]);
        are_single_ |= 1u << r;
    }
    return single_[r];
}

}  // namespace crofton
#endif
