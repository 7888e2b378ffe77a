#pragma once

#include <string>
#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// A mean over lines beside what Crofton's formulas say it tends to.
struct LineMean {
    double truth = 0;
    double mean = 0;
    double standard_error = 0;  ///< of the mean: falls as 1/sqrt(lines)
};

/// One experiment with isotropic lines, uniform over a scene's bounding sphere (radius r).
struct TheoremRow {
    int64_t lines = 0;
    /// Area of all surfaces, each side of a sheet counted once, in squares of world units:
    /// 2·pi·r²·crossings, for a line meets 2A/(4·pi·r²) surfaces. Of a convex body's two crossings
    /// each counts half, and so its area is 4 times its mean projected area.
    LineMean area;
    /// Share of the lines that meets the scene's box: the ratio of the surface areas.
    LineMean box;
    /// Boxes of a bvh that a line meets, of those that meet the root's: the sum of the areas over
    /// the root's. What the area heuristic counts.
    LineMean boxes;
};

/// Rows for 1000, 4000, 16000, … lines; each row holds the lines of those before it.
/// @param lines  of the last row at most
/// @throws InputError  an empty scene; quadrics that are not placed as they are
std::vector<TheoremRow> crofton_theorem(const Scene& scene, int64_t lines, uint64_t seed);

std::string theorem_text(const std::vector<TheoremRow>& rows);

}  // namespace crofton
