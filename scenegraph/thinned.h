#pragma once

#include <limits>

#include "scenegraph/scene.h"

namespace crofton {

/// A scene with about one in `factor` of the shapes: the largest of every so many that follow each
/// other, scaled about its own middle so that it has the area of them all. Then Crofton's expected
/// number of crossings along a line is the same as in the scene, region by region (models list
/// neighbours together), and a structure over it behaves like one over the scene whose leaves are a
/// few levels nearer. (A triangle that would reach beyond the region of those that it stands for is
/// cut back to it, which costs a little area.) Shapes of more than `factor` times the mean area are
/// kept as they are: they matter one by one. Meshes of fewer than 64 shapes are kept whole; nodes
/// and meshes stay.
/// O(shapes), or of those that are looked at.
/// @param factor     >= 1
/// @param looked_at  of so many that become one, at most: a sample, evenly spread, which may miss
/// one
///                   that is large among many
Scene thinned(const Scene& scene, double factor,
              size_t looked_at = std::numeric_limits<size_t>::max());

}  // namespace crofton
