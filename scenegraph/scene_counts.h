#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// How good the order of the shapes in a file is as a hierarchy: Crofton's expected numbers of
/// boxes and of shapes that a line through the largest mesh tests, if the tree above it has nodes
/// of eight runs of consecutive shapes and leaves of four. The line does not end where it hits.
struct OrderCost {
    double nodes = 0, tests = 0;
    bool known = false;
};

/// Counts of shapes that estimates start from.
struct SceneCounts {
    struct Kind {
        std::string name;  ///< see kind_of
        double unique = 0, placed = 0;
    };
    std::vector<Kind> kinds;               ///< those that there are, most placed first
    const std::string& main_kind() const;  ///< the first, or "triangles"
    double unique() const;                 ///< shapes of all kinds
    double placed() const;
    /// Meshes that are placed, put together where they are of similar size: shapes in each, and how
    /// many there are of these.
    std::vector<std::pair<double, double>> meshes;
    double placements = 0;
    std::optional<uint32_t> largest;  ///< geometry with the most shapes, as often as it is placed
    OrderCost order;                  ///< of the largest, by a glance
    double weight = 1;                ///< test_weight of the main kind
};
SceneCounts count_shapes(const Scene& scene);

/// How many shapes are looked at: some tens, or a sixteenth of all and at most a thousand.
enum class OrderSample { glance, look };

/// Of one list of shapes, from a sample. Not known of few shapes, or of none that has an area.
OrderCost order_cost(const Geometry& geometry, OrderSample sample = OrderSample::look);

/// Nominal cost of a test of the scene's main kind of shapes, the mean over their areas, relative
/// to that of the shapes that calibrations are measured with. From a sample.
double test_weight(const Scene& scene, const std::string& kind);

}  // namespace crofton
