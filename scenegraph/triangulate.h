#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "framework/vec.h"

namespace crofton {

/// Most corners of a face that is not convex: the work for one is quadratic.
inline constexpr size_t kMaxConcaveCorners = 4096;

/// Appends the corners.size() − 2 triangles of a polygon, each with the polygon's orientation. A
/// convex one becomes a fan about its first corner; another is cut into ears in the plane of its
/// two dominant axes (Meisters 1975, "Polygons have ears"; with a list of reflex corners, O(n·r)).
/// A polygon that is not simple, not finite or has no area still gives that many triangles.
/// @param positions  vertices, any units
/// @param corners    indices into positions, >= 3 of them, all in range
/// @return           false, with nothing appended, if it is not convex and has more than
///                   kMaxConcaveCorners corners
bool triangulate(const std::vector<Vec3f>& positions, std::span<const uint32_t> corners,
                 std::vector<std::array<uint32_t, 3>>& triangles);

}  // namespace crofton
