#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "accelerators/binary_tree.h"
#include "framework/bounds.h"

namespace crofton {

/// A node of a kd-tree. Siblings stand side by side, so that one read brings both.
///
///   byte 0  the plane's position (float), or where a leaf's references begin, or, for a leaf with
///           one reference, that reference
///        4  bits 0–1: axis of the plane, 3 for a leaf
///           bits 2–31: index of the child below the plane (the one above is the next), or how many
///           references
struct KdNode {
    static constexpr int axis_bits = 2;
    uint32_t value;
    uint32_t bits;

    static KdNode inner(int axis, float split) {
        return {std::bit_cast<uint32_t>(split), uint32_t(axis)};
    }
    static KdNode leaf(uint32_t first, uint32_t count) { return {first, count << 2 | 3}; }
    bool is_leaf() const { return (bits & 3) == 3; }
    uint32_t axis() const { return bits & 3; }
    float split() const { return std::bit_cast<float>(value); }
    uint32_t child() const { return bits >> 2; }
    uint32_t count() const { return bits >> 2; }
    void set_child(uint32_t index) { bits = index << 2 | (bits & 3); }
};
static_assert(sizeof(KdNode) == 8);

/// Where an inner node's plane goes.
enum class KdBuilder {
    spatial_median,  ///< middle of the longest side (Kaplan 1985)
    object_median,   ///< median of the shapes' centres on the longest side
    binned_sah,      ///< best of a few planes per axis by the area heuristic; exact in small nodes
    exact_sah,       ///< best of all planes where a bound begins or ends
};

struct KdOptions {
    KdBuilder builder = KdBuilder::exact_sah;
    int max_depth = 0;         ///< 0: 8 + 1.3·log2(shapes)
    int max_leaf_size = 1;     ///< with so few references, a node is not split further
    int bins = 32;             ///< candidate planes per axis of the binned builder
    double empty_bonus = 0.0;  ///< share taken off the cost of a plane that cuts off empty space
    TreeCosts costs;
};

/// A finished kd-tree.
struct KdTreeData {
    static constexpr int max_depth = 64;
    std::vector<KdNode> nodes;         ///< the root and a spare, then pairs; empty: no shapes
    std::vector<uint32_t> references;  ///< ascending within a leaf
    Bounds3 box;
    double cost = 0;  ///< nominal ns of a line that meets the box, by areas
};

/// Box of the part of a shape inside a box, rounded outwards; empty if there is none.
using ClipShape = std::function<Bounds3(uint32_t shape, const Bounds3& box)>;

/// Builds a kd-tree top down, in parallel, with the same result for any number of threads.
///
/// The exact builder sorts the ends of all bounds once and keeps them sorted, O(N log N) (Wald &
/// Havran 2006: "On building fast kd-trees for ray tracing, and on doing that in O(N log N)");
/// every builder clips a shape that straddles a plane to both cells ("perfect splits"). A shape in
/// a plane goes to the side where it is cheaper: traversal visits both sides of a plane that it
/// meets within the ray's thickness, so that no hit depends on this choice.
///
/// A subtree that costs no less than a leaf becomes one (checked where it is small, or its first
/// split did not pay); besides, there are at most 16·N + 1024 references, each subtree having its
/// share, and 64 levels.
KdTreeData build_kd_tree(BuildReferences references, const ClipShape& clip,
                         const KdOptions& options);

/// A plane across a cell.
struct SplitPlane {
    int axis = -1;  ///< -1: none found
    float position = 0;
    bool planar_below = true;  ///< where shapes in the plane go
    double cost = 0;           ///< of the split cell, in nominal ns; the bonus taken off
};

/// Area heuristic for one cell (MacDonald & Booth 1990).
class SplitCost {
  public:
    SplitCost(const Bounds3& cell, const TreeCosts& costs, double empty_bonus);
    /// The part of lines through the cell that meet what is below (side 0) or above (1) a plane.
    double share(int axis, float position, int side) const;
    double of(int axis, float position, uint32_t n_below, double sum_below, uint32_t n_above,
              double sum_above) const;
    /// Whether a plane has a cell of some width on either side.
    bool inside(int axis, float position) const {
        return cell_.lower[axis] < position && position < cell_.upper[axis];
    }
    bool degenerate() const { return !(area_ > 0); }

  private:
    Bounds3 cell_;
    TreeCosts costs_;
    double bonus_, area_;
    double face_[3], rim_[3];  ///< half area = face + rim · extent, by axis
};

/// Tries the boundaries of equal bins over the references' extent on one axis; keeps the best in
/// `best`.
void try_binned_planes(std::span<const BuildReference> references, const SplitCost& cost, int axis,
                       int bins, SplitPlane& best);

}  // namespace crofton
