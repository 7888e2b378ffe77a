#pragma once

#include "framework/bounds.h"

namespace crofton {

/// Expected number of cells that a uniform isotropic line visits, given that it meets the grid.
/// @param resolution  cells per axis, each >= 1
/// @param bounds      object units; not empty
/// @return            cells per line (no unit), >= 1; a flat grid's lines are those that cross it
/// Source: Cauchy–Crofton; E = 1 + Σ (n_a − 1)·A_a / Σ A_a, A_a the face area normal to axis a.
///         Ignores that rays end at a hit: an upper bound for closest-hit workloads.
double expected_cells(const Vec3i& resolution, const Bounds3& bounds);

/// Probability that a uniform isotropic line that meets the convex `outer` meets the convex `inner`
/// inside it: the ratio of their surface areas (Crofton 1868; Santaló 1976).
double hit_probability(const Bounds3& inner, const Bounds3& outer);

/// Mean length of the part of a uniform isotropic line inside a convex body: 4·V / S.
double mean_chord(const Bounds3& body);

}  // namespace crofton
