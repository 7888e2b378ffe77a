#pragma once

#include <bit>

#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

/// Where the three planes of an octree's node are.
enum class OctreePlanes {
    center,  ///< in the middle of the cell (Glassner 1984)
    sah,     ///< on each axis by itself, where the area heuristic is least (Octree-R, Whang 1995)
};

struct OctreeParameters {
    OctreePlanes planes = OctreePlanes::sah;
    int max_depth = 0;
    int max_leaf_size = 4;
    int bins = 32;
    MailboxMode mailbox = MailboxMode::automatic;

    static constexpr int depth_limit = 32;

    template <class V>
    void fields(V& v) {
        v.choice("planes", planes, {"center", "sah"},
                 "middle of the cell, or on each axis where the area heuristic is least");
        v.integer("max_depth", max_depth, 0, depth_limit,
                  "levels at most; 0: 3 + 0.45 log2(shapes)");
        v.integer("max_leaf_size", max_leaf_size, 1, 64,
                  "cells with so few shapes are not split; others where a leaf costs less");
        v.integer("bins", bins, 2, 64, "candidate planes per axis and node of sah");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// A cell of an octree. Child k is above the plane of axis a if bit a of k is set; children that
/// are not empty stand side by side, in the order of k.
///
///   byte  0  plane[3]; in a leaf, the first 4 bytes are the number of references
///        12  the first child, or where a leaf's references begin
///        16  bit k: child k is not empty; 0: this is a leaf
struct OctreeNode {
    float plane[3];
    uint32_t first;
    uint32_t children;

    static OctreeNode leaf(uint32_t first, uint32_t count) {
        return {{std::bit_cast<float>(count), 0, 0}, first, 0};
    }
    bool is_leaf() const { return children == 0; }
    uint32_t count() const { return std::bit_cast<uint32_t>(plane[0]); }
    /// @pre child k is not empty
    uint32_t child(uint32_t k) const {
        return first + uint32_t(std::popcount(children & ((1u << k) - 1)));
    }
};
static_assert(sizeof(OctreeNode) == 20);

/// Tree of cells that three planes cut into eight, over references. A shape stands in every leaf
/// that it meets. Built top down, in parallel, with the same result for any number of threads.
///
/// A subtree that costs no less than a leaf becomes one (checked where it is small, or its first
/// split did not pay); besides, there are at most 16·N + 1024 references, each subtree having its
/// share.
template <class Set>
struct Octree {
    static constexpr const char* name = "octree";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;
    static constexpr int max_depth = OctreeParameters::depth_limit;

    AlignedVector<OctreeNode> nodes;  ///< the root first; empty: no shapes
    AlignedVector<uint32_t> references;
    ShapeStore<Set> shapes;
    Bounds3 box;
    float magnitude = 0;  ///< of the box
    bool mailbox = false;
    double cost = 0;
    StructureStatistics stats;

    static Octree build(const Set& set, const OctreeParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, references, shapes, box, magnitude, mailbox, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
