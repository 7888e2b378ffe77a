#pragma once

#include <cstdint>
#include <vector>

#include "accelerators/binary_tree.h"

namespace crofton {

/// Shapes that belong together, for a grid of their own.
struct ShapeCluster {
    Bounds3 bounds;
    uint32_t size_class = 0;       ///< 0: the smallest shapes; see clusters_by_size
    std::vector<uint32_t> shapes;  ///< ascending
};

/// Clusters by place: neighbours are merged, bottom up, while the merged box has less area than
/// `merge_ratio` times the sum of both (Klimaszewski & Sederberg 1997: "Faster ray tracing using
/// adaptive grids"). Departs from it in finding neighbours in a binned tree instead of by
/// insertion.
/// @param references  not empty
std::vector<ShapeCluster> clusters_by_place(BuildReferences references, double merge_ratio);

/// Clusters by size, then place: shapes are filtered into classes of similar extent; those of a
/// class that share a bucket as wide as the largest of them are connected (Cazals, Drettakis, Puech
/// 1995: "Filtering, clustering and hierarchy construction"). O(N).
/// @param references  not empty
/// @param classes     at most so many, each at least a factor of four wide
std::vector<ShapeCluster> clusters_by_size(const BuildReferences& references, int classes);

}  // namespace crofton
