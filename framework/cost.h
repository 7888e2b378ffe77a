#pragma once

namespace crofton {

/// Nominal costs in nanoseconds on a 3–4 GHz core with everything in cache: what area heuristics
/// weigh nodes against shapes with, and what `expected_cost` sums. Ratios matter, not their unit.
struct CostConstants {
    double node = 3.0;         ///< both children of a binary node
    double sphere_node = 6.0;  ///< the same of spheres, oriented boxes, 14-dops
    double obb_node = 9.0;
    double kdop_node = 6.0;
    double wide_node = 1.5;  ///< all children at once, as a share of each binary node inside
    double four_spheres_node = 9.0;  ///< four quantised spheres at once
    double plane = 2.5;              ///< a step down a tree of planes
    double general_plane = 4.0;      ///< the same where the plane has any direction
    double octree_node = 5.0;        ///< three planes, eight children
    double triangle_gather = 5.0;    ///< four triangles by reference, before their test
    double triangle_fetch = 2.5;     ///< one of them in the leaf of a tree, cache misses included
    double cell = 3.5;               ///< a step to the next grid cell
    double triangle_block = 5.0;     ///< four triangles at once
    double sphere = 6.0;
    double cone = 14.0;
    double disc = 5.0;
    double polygon = 4.0;  ///< plus, for each corner:
    double polygon_corner = 2.0;
    double object = 6.0;     ///< entering a nested object: box test and call
    double instance = 12.0;  ///< transforming a ray
};
inline constexpr CostConstants cost_constants{};

}  // namespace crofton
