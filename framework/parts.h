#pragma once

#include <concepts>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "framework/object_set.h"

namespace crofton {

/// Where a traversal starts: at the root, or at a node or leaf as the structure encodes them.
struct TraversalStart {
    uint32_t index = 0, count = 0;
};

/// Primitive::type_name of what AcceleratedPart makes of a structure's subtree.
inline constexpr const char* part_name = "part";

/// A structure that can be traversed from any of its nodes. Beside what every structure has:
///   visit_children(start, f)  calls f(const Bounds3&, TraversalStart) for each child of a node
///   is_leaf(start)
///   cost_of(set, start)       nominal ns of a visit of this node or leaf alone
///   references(start)         of a leaf; only where leaves are lists of references
/// and its traversal takes a TraversalStart as last argument.
template <class Structure, class Set>
concept Opens = requires(const Structure& s, const Set& set, TraversalStart start) {
    { Structure::is_leaf(start) } -> std::same_as<bool>;
    { s.cost_of(set, start) } -> std::convertible_to<double>;
    s.visit_children(start, [](const Bounds3&, TraversalStart) {});
};

/// Nominal ns of a random line that meets `box`, the bounds of the node at `start`, by the area
/// heuristic. O(nodes below).
template <class Structure, class Set>
double expected_cost_from(const Structure& structure, const Set& set, TraversalStart start,
                          const Bounds3& box) {
    struct Open {
        TraversalStart node;
        double area;
    };
    const double root_area = half_area(box);
    double sum = 0;
    std::vector<Open> open{{start, root_area}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        sum += (root_area > 0 ? o.area / root_area : 1.0) * structure.cost_of(set, o.node);
        if (Structure::is_leaf(o.node)) continue;
        structure.visit_children(o.node, [&](const Bounds3& b, TraversalStart child) {
            open.push_back({child, half_area(b)});
        });
    }
    return sum;
}

}  // namespace crofton
