#pragma once

#include "accelerators/bsp_build.h"
#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

struct BspParameters {
    BspPlanes planes = BspPlanes::polygons;
    int max_depth = 0;
    int max_leaf_size = 1;
    int bins = 32;
    int general_size = 128;
    int sampled_shapes = 32;
    double empty_bonus = 0.2;
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.choice("planes", planes, {"axis_aligned", "kdop", "polygons", "all"},
                 "axis_aligned; kdop: 13 directions; polygons: those of the shapes' own faces and "
                 "edges too; all: both");
        v.integer("max_depth", max_depth, 0, BspTreeData::max_depth,
                  "levels at most; 0: 8 + 1.6 log2(shapes)");
        v.integer("max_leaf_size", max_leaf_size, 1, 64,
                  "cells with so few shapes are not split; others where a leaf costs less");
        v.integer("bins", bins, 2, 64,
                  "candidate planes per direction in cells of more than 256 shapes");
        v.integer("general_size", general_size, 0, 4096,
                  "the shapes' own planes are tried in cells of at most so many shapes");
        v.integer("sampled_shapes", sampled_shapes, 1, 4096,
                  "of at most so many shapes of a cell, evenly");
        v.real(
            "empty_bonus", empty_bonus, 0, 0.95,
            "share taken off a plane that cuts off empty space, in cells that try the axes only");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// Binary space partition by planes of any direction, over references. See build_bsp.
///
/// Robustness. The ray is followed as thick as hits may stray from it: within t of the root's box,
/// all that a leaf test accepts at t lies within Tₐ = padₐ + w·(|oₐ| + M) of o + t·d on each axis
/// a, M the largest coordinate of the box (LocalRay, ThickRay). For a plane n·x = d, the thick ray
/// is thus within H = Σ|nₐ|·Tₐ of n·o + t·(n·d), and both sides are visited where that meets the
/// plane within the cell's interval of t. H also covers, in units of u·Σ|nₐ|·(|oₐ| + M), which
/// bounds all distances along n between points of the box and the origin:
///
///   12  triangles only: what a leaf test strays beyond pad (LocalRay)
///    3  rounding of n·o; 3 of n·d, since |t·dₐ| <= |oₐ| + M; 1 of adding H; 1 of the subtraction
///    2  of the quotient and its product, which are relative to that same distance
///    4  bsp_tolerance: shapes that reach past a plane by so much are not behind it
///   16  polygons only: corners may stand off the plane that is hit
///
/// 26u, or 30u for polygons; w is 32u or 64u, which leaves room for terms of second order and for what clipping
/// rounds in double. Where n·d is so small that 1/(n·d) is replaced by 2^60/max|d|, the ray's
/// points move along n by less than 2^-60·(|o| + M). A wrong sign of a rounded n·d needs no care:
/// it is within the 3u. Where a product overflows to NaN, both sides are visited, since either
/// comparison that would rule one out fails.
template <class Set>
struct Bsp {
    static constexpr const char* name = "bsp";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;
    static constexpr int max_depth = BspTreeData::max_depth;

    AlignedVector<BspNode> nodes;  ///< depth first, the root first; empty: no shapes
    AlignedVector<BspPlane> planes;
    AlignedVector<uint32_t> references;
    ShapeStore<Set> shapes;
    Bounds3 box;
    float magnitude = 0;    ///< of the box
    bool diagonal = false;  ///< there are planes of bsp_direction other than axes
    bool mailbox = false;
    double cost = 0;
    StructureStatistics stats;

    static Bsp build(const Set& set, const BspParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, planes, references, shapes, box, magnitude, diagonal, mailbox, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
