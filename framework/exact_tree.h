#pragma once

#include <vector>

#include "framework/exact_shapes.h"

namespace crofton::exact {

/// A tree of boxes for the oracle, of its own kind: split at the median, tested in double.
struct Tree {
    struct Node {
        Box box;
        uint32_t first = 0;  ///< of its leaf's shapes, or its second child (the first is the next)
        uint32_t count = 0;  ///< 0: an inner node
    };
    std::vector<Node> nodes;

    /// @param order  receives the shapes in the order of the leaves
    void build(const std::vector<Box>& boxes, std::vector<uint32_t>& order);
};

/// Whether the ray's line passes a box, and where.
///
/// (b - o)/d has two roundings, 2^-53 each; the distances are moved outwards by 2^-50 of
/// themselves, so that the exact interval lies in [near, far]. A component 0 of d is compared
/// exactly.
/// @param scale  widens the box by as much as that multiple of any leaf test's bound can move what
///               is inside it
bool passes(const DoubleRay& ray, const Box& box, double scale, double& near, double& far);

}  // namespace crofton::exact
