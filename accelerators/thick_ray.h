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
    struct Axis {
        float near_origin, far_origin, rcp;
        uint32_t down;  ///< 1: the ray meets upper cells first

        /// No point of the thick ray is past the plane before this t,
        float enter(float plane) const { return (plane - near_origin) * rcp; }
        /// and none is before the plane later than this. enter(p) <= leave(p).
        float leave(float plane) const { return (plane - far_origin) * rcp; }
    };
    Axis axis[3];
    float t_enter, t_leave;  ///< of the box, within [t_min, t_cull]; none if enter > leave

    /// @param magnitude  largest absolute coordinate of `box`
    ThickRay(const Bounds3& box, float magnitude, const LocalRay& ray, const RayQuery& q) {
        // What is accepted at t_min may be met as much before it as t can be wrong.
        t_enter = q.t_low;
        t_leave = q.t_cull;
        for (int a = 0; a < 3; ++a) {
            const float r = ray.rcp[a];
            const float thickness = ray.pad[a] + 0x1p-20f * (std::abs(ray.origin[a]) + magnitude);
            const float shift = std::copysign(thickness, r);
            const bool down = std::signbit(r);
            axis[a] = {ray.origin[a] + shift, ray.origin[a] - shift, r, down ? 1u : 0u};
            t_enter = std::max(t_enter, axis[a].enter(down ? box.upper[a] : box.lower[a]));
            t_leave = std::min(t_leave, axis[a].leave(down ? box.lower[a] : box.upper[a]));
        }
    }
};

}  // namespace crofton
