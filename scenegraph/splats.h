#pragma once

#include <vector>

#include "framework/quadric_set.h"
#include "scenegraph/scene.h"

namespace crofton {

/// Whether a point is a disc across its normal rather than a sphere.
inline bool is_disc(const Points& points, uint32_t i) {
    return !points.normals.empty() && points.normals[i].allFinite() && !points.normals[i].isZero(0);
}

/// What each point is traced as, in the same order: a disc if the point has a normal, else a
/// sphere; with the point's own radius, or else that of `splat_radii`.
std::vector<QuadricShape> splats(const Points& points);

/// Radii from the points' spacing: the distance d of a point to the fourth nearest of all other
/// places where points are (the farthest, if there are fewer), so that splats on a sampled surface
/// overlap; but at most twice the largest d of these four, so that a stray point far from all
/// others does not swallow the scene. 0 where there is no other place, and for points that are not
/// finite. Object units. Deterministic, in parallel; O(N log N) on sampled surfaces.
std::vector<float> splat_radii(const std::vector<Vec3f>& positions);

}  // namespace crofton
