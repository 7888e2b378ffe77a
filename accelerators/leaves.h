#pragma once

#include <type_traits>

#include "accelerators/binary_tree.h"
#include "framework/cost.h"
#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"

namespace crofton {

/// How the leaves of a tree over `Set` are stored.
template <class Set>
using Leaves =
    std::conditional_t<std::is_same_v<Set, TriangleSet>, TriangleLeaves, ReferenceLeaves>;

template <class Set>
TreeCosts tree_costs(double node) {
    TreeCosts costs;
    costs.node = node;
    if constexpr (std::is_same_v<Set, TriangleSet>) {
        costs.leaf_width = TriangleLeaves::width;
        costs.leaf_block = cost_constants.triangle_block;
    }
    return costs;
}

/// The same where leaves are lists of references: each triangle is gathered before its test.
template <class Set>
TreeCosts reference_costs(double node) {
    TreeCosts costs = tree_costs<Set>(node);
    if constexpr (std::is_same_v<Set, TriangleSet>)
        costs.leaf_shape = cost_constants.triangle_fetch;
    return costs;
}

/// Nominal cost of a test by reference in a short list, whose blocks are mostly empty lanes.
/// @param cost  of the shape alone
template <class Set>
double reference_cost(double cost) {
    if constexpr (std::is_same_v<Set, TriangleSet>)
        return (cost_constants.triangle_block + cost_constants.triangle_gather) / 2;
    return cost;
}

/// Nominal ns of one leaf.
template <class Set>
double leaf_cost(const Set& set, const Leaves<Set>& leaves, uint32_t first, uint32_t count) {
    if constexpr (std::is_same_v<Set, TriangleSet>) {
        return tree_costs<Set>(0).leaf(0, count);
    } else {
        double sum = 0;
        for (uint32_t i = 0; i < count; ++i) sum += set.cost(leaves.references()[first + i]);
        return sum;
    }
}

}  // namespace crofton
