#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "accelerators/binary_tree.h"
#include "accelerators/polyhedron.h"
#include "framework/bounds.h"

namespace crofton {

/// Directions of planes that need no more than an index: the axes, and the edges and corners of a
/// cube (the 26-DOP). A ray is projected on each once; a step is then the same for all of them.
inline constexpr int bsp_directions = 13;
inline constexpr std::array<std::array<int, 3>, bsp_directions> bsp_direction{{{1, 0, 0},
                                                                               {0, 1, 0},
                                                                               {0, 0, 1},
                                                                               {1, 1, 0},
                                                                               {1, -1, 0},
                                                                               {1, 0, 1},
                                                                               {1, 0, -1},
                                                                               {0, 1, 1},
                                                                               {0, 1, -1},
                                                                               {1, 1, 1},
                                                                               {1, 1, -1},
                                                                               {1, -1, 1},
                                                                               {1, -1, -1}}};

/// A plane n·x = d of any direction; |n₀| + |n₁| + |n₂| <= 1, so that the thickness of a ray along
/// n is no more than its largest thickness along an axis.
struct BspPlane {
    float n[3];
    float d;
};
static_assert(sizeof(BspPlane) == 16);

/// A node of a BSP tree; the child below the plane is the next node.
///
///   byte 0  the plane's distance d (float), or its index among the planes of any direction, or
///           where a leaf's references begin, or, for a leaf with one reference, that reference
///        4  bits 0–3: direction of the plane; 13: any; 15: a leaf
///           bits 4–31: index of the child above the plane, or how many references
struct BspNode {
    static constexpr uint32_t general = 13, leaf_kind = 15;
    static constexpr uint32_t most = 0x0fffffff;  ///< nodes

    uint32_t value;
    uint32_t bits;

    static BspNode along(int direction, float d) {
        return {std::bit_cast<uint32_t>(d), uint32_t(direction)};
    }
    static BspNode any(uint32_t plane) { return {plane, general}; }
    static BspNode leaf(uint32_t first, uint32_t count) { return {first, count << 4 | leaf_kind}; }
    uint32_t kind() const { return bits & 15; }
    bool is_leaf() const { return kind() == leaf_kind; }
    float distance() const { return std::bit_cast<float>(value); }
    uint32_t above() const { return bits >> 4; }
    uint32_t count() const { return bits >> 4; }
    void set_above(uint32_t index) { bits = index << 4 | kind(); }
};
static_assert(sizeof(BspNode) == 8);

/// Which planes are tried.
enum class BspPlanes {
    axis_aligned,  ///< a kd-tree
    kdop,          ///< all of bsp_direction (Kammaje & Mora 2007; Budge et al. 2008)
    polygons,      ///< axis-aligned, and those of the shapes' own faces and edges (Ize et al. 2008)
    all,           ///< both
};

struct BspOptions {
    BspPlanes planes = BspPlanes::polygons;
    int max_depth = 0;         ///< 0: 8 + 1.6·log2(shapes)
    int max_leaf_size = 1;     ///< with so few references, a node is not split further
    int bins = 32;             ///< planes per direction in cells of more than 256 shapes
    int general_size = 128;    ///< shapes' own planes are tried in cells of so many shapes
    int sampled_shapes = 32;   ///< of so many of them
    double empty_bonus = 0.0;  ///< share taken off a plane that cuts off empty space, in cells that
                               ///< try the axes only
    double general_node = 4.0;  ///< nominal ns of a step at a plane of any direction
    TreeCosts costs;            ///< its node: a step at a plane of bsp_direction
};

/// The shapes to build over, in the order of their index in the set.
struct BspShapes {
    /// A shape that is the hull of two discs or balls: sphere, disc, cylinder, cone.
    struct Round {
        std::array<Vec3d, 2> center;
        std::array<double, 2> radius;
        Vec3d axis;  ///< unit; zero: balls
    };
    BuildReferences references;
    /// By position in `references`: corners, in order around a flat polygon; none: the shape is
    /// somewhere in its bounds. Either empty as a whole or with one more entry.
    std::vector<uint32_t> first_corner;
    std::vector<Vec3d> corners;
    std::vector<Round> rounds;  ///< by position in `references`, or empty

    std::span<const Vec3d> outline(size_t i) const {
        if (first_corner.empty()) return {};
        return {corners.data() + first_corner[i], first_corner[i + 1] - first_corner[i]};
    }
};

/// A finished BSP tree.
struct BspTreeData {
    static constexpr int max_depth = 96;
    std::vector<BspNode> nodes;        ///< depth first; empty: no shapes
    std::vector<BspPlane> planes;      ///< of any direction
    std::vector<uint32_t> references;  ///< ascending within a leaf
    Bounds3 box;
    double cost = 0;  ///< nominal ns of a line that meets the box, by areas of the convex cells
};

/// Builds a BSP tree top down by the area heuristic, with the true areas of the convex cells, in
/// parallel, with the same result for any number of threads.
///
/// Large cells choose among `bins` planes for each direction, cells of at most 256 shapes among all
/// planes of those directions that a shape begins or ends at. Cells of at most `general_size` also
/// try, for up to `sampled_shapes` of their shapes, the plane of a face and those through its edges
/// at right angles to it (Ize, Wald, Parker 2008: "Ray tracing with the BSP tree"). So each level
/// of the tree costs a bounded time per reference.
///
/// Polygons are cut exactly (in double): a reference stands only where its part is. Other shapes
/// are bounded in every direction by their box, cut to the cell as far as one plane at a time can,
/// and by their own extent.
///
/// A shape that reaches past a plane not of an axis by no more than bsp_tolerance times the largest
/// coordinate is not put there: faces with an edge in the plane stay on one side. Traversal allows
/// for it. The ends of branches are those of build_kd_tree.
BspTreeData build_bsp(const BspShapes& shapes, const BspOptions& options);

/// See build_bsp: 4u, the largest error of the corners of a face against its plane in float.
inline constexpr double bsp_tolerance = 0x1p-22;

/// A plane as an equation n·x = d.
struct BspEquation {
    Vec3d n;
    double d;
};
BspEquation equation(const BspNode& node, std::span<const BspPlane> planes);

/// A convex cell; no polyhedron is made where it is a box.
struct BspCell {
    Bounds3 box;       ///< around it
    Polyhedron shape;  ///< empty: it is the box

    bool is_box() const { return shape.empty(); }
    /// @param room  where a box's polyhedron is put
    const Polyhedron& polyhedron(Polyhedron& room) const {
        return is_box() ? room = Polyhedron::box(box) : shape;
    }
};

/// Visits every node, parents first: visit(node's index, cell, depth).
void walk_cells(std::span<const BspNode> nodes, std::span<const BspPlane> planes,
                const Bounds3& box,
                const std::function<void(uint32_t, const BspCell&, uint32_t)>& visit);

}  // namespace crofton
