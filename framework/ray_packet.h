#pragma once

#include <cstdint>
#include <span>

#include "framework/bounds.h"
#include "framework/ray.h"
#include "framework/ray_query.h"

namespace crofton {

/// Up to 16 neighbours of a stream that start close to each other and go nearly the same way: what
/// none of them can meet, a structure passes over once for all.
struct RayPacket {
    static constexpr uint32_t most = 16;

    uint32_t count = 0;
    LocalRay local[most];
    RayQuery query[most];
    float scale[most];     ///< see `prepare`
    uint32_t index[most];  ///< in the caller's span
    bool found[most];      ///< answers of `any` queries

    /// Whether rays are worth a packet: every direction component has one sign and differs by an
    /// eighth of the largest at most, and origins by a 64th of the box.
    /// @param rays  at most `most`
    static bool suits(std::span<const Ray> rays, const Bounds3& box);

    /// Fills the packet; rays that are defined misses are left out.
    /// @param magnitude  see `prepare`
    void prepare(std::span<const Ray> rays, size_t first, float magnitude, Mode mode);
};

}  // namespace crofton
