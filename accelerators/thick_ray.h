#pragma once

#include <algorithm>
#include <cmath>

#include "framework/bounds.h"
#include "framework/ray_query.h"

namespace crofton {

/// A ray as a structure of planes follows it: as thick as any leaf test can stray.
///
/// A leaf test may accept a shape that the exact ray passes at up to LocalRay::pad and
/// 5u·|o| + 12u·magnitude more. The rounding of the distances below, which all span at most |o| +
/// magnitude, is 3u of that. 16u cover both; so distances need no relative slack, and hold for
/// negative t as well.
struct ThickRay {
    // x, y, z, and a lane that means nothing.
    alignas(16) float near_origin[4];
    alignas(16) float far_origin[4];
    alignas(16) float rcp[4];
    uint32_t down = 0;       ///< bit a: the ray meets upper cells first
    float t_enter, t_leave;  ///< of the box, within [t_min, t_cull]; none if enter > leave

    /// No point of the thick ray is past the plane before this t,
    float enter(uint32_t axis, float plane) const {
        return (plane - near_origin[axis]) * rcp[axis];
    }
    /// and none is before the plane later than this. enter(a, p) <= leave(a, p).
    float leave(uint32_t axis, float plane) const { return (plane - far_origin[axis]) * rcp[axis]; }

    /// @param magnitude  largest absolute coordinate of `box`
    ThickRay(const Bounds3& box, float magnitude, const LocalRay& ray, const RayQuery& q) {
        for (int a = 0; a < 4; ++a) {
            const float thickness = ray.pad[a] + 0x1p-20f * (std::abs(ray.origin[a]) + magnitude);
            const float shift = std::copysign(thickness, ray.rcp[a]);
            near_origin[a] = ray.origin[a] + shift;
            far_origin[a] = ray.origin[a] - shift;
            rcp[a] = ray.rcp[a];
        }
        // What is accepted at t_min may be met as much before it as t can be wrong.
        t_enter = q.t_low;
        t_leave = q.t_cull;
        for (uint32_t a = 0; a < 3; ++a) {
            const bool backwards = std::signbit(rcp[a]);
            down |= uint32_t(backwards) << a;
            const float first = backwards ? box.upper[a] : box.lower[a];
            const float last = backwards ? box.lower[a] : box.upper[a];
            t_enter = std::max(t_enter, enter(a, first));
            t_leave = std::min(t_leave, leave(a, last));
        }
    }
};

}  // namespace crofton
