#include "framework/ray_query.h"

#include <hwy/highway.h>

#include <bit>
#include <cmath>

namespace crofton {
namespace {

// Set-up is the same for every ray and compiled once, for the baseline.
namespace hn = hwy::HWY_NAMESPACE;
constexpr hn::FixedTag<float, 4> f4;
using Float4 = hn::Vec<decltype(f4)>;

constexpr float pad_share = 0x1p-19f;
alignas(16) constexpr float last_lane[4] = {0, 0, 0, 1};

float pow2(int exponent) { return std::bit_cast<float>(uint32_t(exponent + 127) << 23); }

/// Whether lanes 0 to 2 of both are neither NaN nor infinite.
bool finite3(Float4 v, Float4 w) {
    const auto zero = hn::Zero(f4);
    uint8_t bits[8];
    hn::StoreMaskBits(f4, hn::Eq(hn::Add(hn::Mul(v, zero), hn::Mul(w, zero)), zero), bits);
    return (bits[0] & 7) == 7;
}

/// @param d     a direction; of the query it is d·down. Read from where the caller's ray is, since
///              what was just stored as a vector is slow to load by component.
/// @param down  a power of two, and `up` its inverse
HWY_INLINE void set_shear(RayQuery& q, const float* d, float down, float up) {
    const float x = std::abs(d[0]), y = std::abs(d[1]), z = std::abs(d[2]);
    // By arithmetic: which axis is the largest cannot be foretold.
    const int not_x = int(!(x > y)), not_z = int((x > y ? x : y) > z);
    q.kz = 2 - not_z * (2 - not_x);
    static constexpr int next[5] = {0, 1, 2, 0, 1};
    q.kx = next[q.kz + 1];
    q.ky = next[q.kz + 2];
    q.shear_z = 1.0f / d[q.kz] * up;
    q.shear_x = d[q.kx] * down * q.shear_z;
    q.shear_y = d[q.ky] * down * q.shear_z;
}

/// Whether it may be no normal float once it is scaled.
bool is_tiny(float t) { return std::abs(t) < 0x1p-100f && t != 0; }

/// Where scaling rounds the ends of the interval, nothing outside of it may be let in.
void keep_inside(const Ray& ray, float up, float down, RayQuery& q) {
    float t_min = ray.t_min * up, t_max = ray.t_max * up;
    while (t_min * down < ray.t_min) t_min = std::nextafter(t_min, INFINITY);
    while (t_max * down > ray.t_max) t_max = std::nextafter(t_max, -INFINITY);
    q.set_min(t_min);
    q.set_best(t_max);
}

/// Everything of a LocalRay that follows from origin, direction and pad.
/// @param inverse  1/d
/// @param limit  of |rcp|: a direction component below 1/limit moves the ray by less than the least
///               pad over any distance within the object, and may be replaced by that bound
HWY_INLINE void complete(LocalRay& ray, Float4 o, Float4 d, Float4 inverse, Float4 pad, float t_min,
                         float magnitude, float limit) {
    const auto replaced = hn::Gt(hn::Abs(inverse), hn::Set(f4, limit));
    // Enough to move the origin to the next float at least.
    pad = hn::Add(hn::Add(pad, hn::Set(f4, 0x1p-40f * magnitude)),
                  hn::IfThenElseZero(replaced, hn::Mul(hn::Abs(o), hn::Set(f4, 0x1p-22f))));
    if (HWY_UNLIKELY(t_min < 0))
        pad = hn::Add(
            pad, hn::Mul(hn::Set(f4, 4 * box_slack), hn::Add(hn::Abs(o), hn::Set(f4, magnitude))));
    const auto rcp = hn::CopySign(hn::Min(hn::Abs(inverse), hn::Set(f4, limit)), d);
    const auto shift = hn::CopySign(pad, rcp);
    hn::StoreU(o, f4, ray.origin);
    hn::StoreU(d, f4, ray.direction);
    hn::StoreU(pad, f4, ray.pad);
    hn::StoreU(rcp, f4, ray.rcp);
    hn::StoreU(hn::Mul(rcp, hn::Set(f4, 1 + box_slack)), f4, ray.far_rcp);
    hn::StoreU(hn::Add(o, shift), f4, ray.near_origin);
    hn::StoreU(hn::Sub(o, shift), f4, ray.far_origin);
}

}  // namespace

bool prepare(const Ray& ray, float magnitude, RayQuery& q, LocalRay& local, float& scale) {
    static_assert(offsetof(Ray, direction) == 16, "the fourth lanes are t_min and t_max");
    const auto o = hn::LoadU(f4, ray.origin.data());
    const auto d = hn::LoadU(f4, ray.direction.data());
    const float largest = std::max(std::max(std::abs(ray.direction[0]), std::abs(ray.direction[1])),
                                   std::abs(ray.direction[2]));
    if (!(largest > 0) || !(ray.t_min <= ray.t_max) || !finite3(o, d)) return false;

    // Of a denormal or nearly infinite direction, the power of two itself is no float.
    const int exponent = int(std::bit_cast<uint32_t>(largest) >> 23) - 127;
    if (HWY_UNLIKELY(exponent < -126 || exponent > 126)) return false;
    const float down = pow2(-exponent), up = pow2(exponent);
    const auto scaled = hn::Mul(d, hn::Set(f4, down));
    // The quotient does not wait for the power of two. It would be infinite too early for
    // components below 2^-128, which `complete` replaces if they are so much less than the largest.
    auto inverse = hn::Mul(hn::Div(hn::Set(f4, 1.0f), d), hn::Set(f4, up));
    if (HWY_UNLIKELY(exponent < -60)) inverse = hn::Div(hn::Set(f4, 1.0f), scaled);
    hn::StoreU(scaled, f4, q.direction);
    q.set_min(ray.t_min * up);
    q.set_best(ray.t_max * up);
    if (HWY_UNLIKELY(is_tiny(ray.t_min) || is_tiny(ray.t_max))) keep_inside(ray, up, down, q);
    set_shear(q, ray.direction.data(), down, up);
    scale = down;
    hn::StoreU(o, f4, q.origin);
    q.instance = 0;
    q.hit_ids = nullptr;

    local.frame = nullptr;
    complete(local, o, scaled, inverse, hn::Zero(f4), q.t_min, magnitude, 0x1p60f);
    return true;
}

/// Thickness: the leaf test sees fl(M·v) - o in the world, wrong by at most 4u·(|M|·|v| + |m| +
/// |o|) per axis and by the test's own 8u of the distance; |M⁻¹| brings that to object space. The
/// rounded map moves the origin by 4u·(|M⁻¹|·|o| + |M⁻¹·m|), and the direction by 4u·|M⁻¹|·|d|,
/// times t of which |d|·t is within the same sum. 32u covers all 20u of it, and the roundings of
/// the pad.
InstanceFrame::InstanceFrame(const Transform& to_world, const Transform& to_object,
                             const Vec3f& magnitudes)
    : world_from_object(to_world),
      object_from_world(to_object),
      world_from_object_f(rounded(to_world)),
      magnitude(magnitudes.maxCoeff()) {
    const Vec3d reach =
        to_world.linear.cwiseAbs() * magnitudes.cast<double>() + to_world.translation.cwiseAbs();
    const Vec3d thickness = pad_share * (to_object.linear.cwiseAbs() * reach);
    for (int a = 0; a < 3; ++a) {
        for (int k = 0; k < 3; ++k) column[k][a] = float(to_object.linear(a, k));
        column[3][a] = float(to_object.translation[a]);
        pad[a] = float(thickness[a]);
    }
    for (float(&c)[4] : column) c[3] = 0;
    pad[3] = 0;
}

bool enter(const InstanceFrame& frame, const RayQuery& query, LocalRay& local) {
    const auto x = hn::LoadU(f4, frame.column[0]), y = hn::LoadU(f4, frame.column[1]),
               z = hn::LoadU(f4, frame.column[2]), origin = hn::LoadU(f4, frame.column[3]);
    const auto o = hn::LoadU(f4, query.origin), d = hn::LoadU(f4, query.direction);
    const auto ox = hn::Broadcast<0>(o), oy = hn::Broadcast<1>(o), oz = hn::Broadcast<2>(o);
    const auto from =
        hn::Add(hn::Add(hn::Mul(x, ox), hn::Mul(y, oy)), hn::Add(hn::Mul(z, oz), origin));
    const auto way =
        hn::Add(hn::Add(hn::Mul(x, hn::Broadcast<0>(d)), hn::Mul(y, hn::Broadcast<1>(d))),
                hn::Mul(z, hn::Broadcast<2>(d)));
    const auto reach =
        hn::Add(hn::Add(hn::Abs(hn::Mul(x, ox)), hn::Abs(hn::Mul(y, oy))), hn::Abs(hn::Mul(z, oz)));
    const auto pad = hn::MulAdd(reach, hn::Set(f4, pad_share), hn::LoadU(f4, frame.pad));
    const float largest = hn::GetLane(hn::MaxOfLanes(f4, hn::Abs(way)));
    if (!(largest > 0) || !finite3(way, way)) return false;
    local.frame = &frame;
    // The fourth lane means nothing, but must not divide by zero.
    const auto divisor = hn::Or(way, hn::Load(f4, last_lane));
    complete(local, from, divisor, hn::Div(hn::Set(f4, 1.0f), divisor), pad, query.t_min,
             frame.magnitude, 0x1p60f / largest);
    return true;
}

ObjectRay::ObjectRay(const LocalRay& local, const RayQuery& query) {
    const Vec3d o(query.origin[0], query.origin[1], query.origin[2]);
    const Vec3d d(query.direction[0], query.direction[1], query.direction[2]);
    origin = local.frame ? local.frame->object_from_world.point(o) : o;
    direction = local.frame ? local.frame->object_from_world.vector(d) : d;
}

ShapeGroups IdTable::groups(uint32_t size) const {
    ShapeGroups groups;
    if (runs_.size() < 2 || size == 0) return groups;
    for (size_t r = 0; r < runs_.size(); ++r) {
        const uint32_t end = r + 1 < runs_.size() ? runs_[r + 1].first : ~0u;
        if (end > runs_[r].first) groups.push_back({runs_[r].first, end});
    }
    if (!whole_.empty()) return groups_of_part(groups, whole_);
    groups.back().end = size;
    return groups;
}

}  // namespace crofton
