#pragma once

#include <string>
#include <utility>
#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// Counts of shapes that estimates start from.
struct SceneCounts {
    struct Kind {
        std::string name;  ///< see kind_of
        double unique = 0, placed = 0;
    };
    std::vector<Kind> kinds;               ///< those that there are, most placed first
    const std::string& main_kind() const;  ///< the first, or "triangles"
    /// Meshes that are placed, put together where they are of similar size: shapes in each, and how
    /// many there are of these.
    std::vector<std::pair<double, double>> meshes;
    double placements = 0;
    double order = 1;   ///< order_visits of the scene
    double weight = 1;  ///< test_weight of the main kind
};
SceneCounts count_shapes(const Scene& scene);

/// How good the order of the shapes in the largest mesh's file is as a hierarchy: Crofton's
/// expected number of boxes that a line meets, of boxes around runs of 8, 64, 512, … shapes, for
/// each level; about 1 where runs are patches that lie side by side, more where they are scattered.
/// From a sample: O(log N).
double order_visits(const Scene& scene);

/// Nominal cost of a test of the scene's main kind of shapes, the mean over their areas, relative
/// to that of the shapes that calibrations are measured with. From a sample.
double test_weight(const Scene& scene, const std::string& kind);

}  // namespace crofton
