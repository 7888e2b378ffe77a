#pragma once

#include "accelerators/cell_blocks.h"
#include "accelerators/grid_space.h"
#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "accelerators/uniform_grid.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

/// Where grids stand inside grids.
enum class NestedGridMethod {
    two_level,  ///< a coarse grid; one more level in the cells where the cost says so (Ize 2007)
    recursive,  ///< every cell with too many shapes is split, again and again (Jevans & Wyvill
                ///< 1989)
    adaptive,   ///< recursive grids around merged clusters (Klimaszewski & Sederberg 1997)
    hierarchy,  ///< shapes by size, a grid for each cluster of a size (HUG: Cazals et al. 1995)
};

struct NestedGridParameters {
    NestedGridMethod method = NestedGridMethod::two_level;
    ResolutionRule resolution = ResolutionRule::klimaszewski;
    double density = 1.0;
    int max_per_cell = 16;
    int max_depth = 4;
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.choice("method", method, {"two_level", "recursive", "adaptive", "hierarchy"},
                 "where grids stand inside grids");
        v.choice("resolution", resolution, {"lrt", "pbrt", "woo", "klimaszewski"},
                 "rule for the number of cells of each grid");
        v.real("density", density, 1e-3, 1e3, "cells per shape, relative to the rule's own");
        v.integer("max_per_cell", max_per_cell, 1, 4096,
                  "a cell with no more shapes gets no grid; a smaller cluster gets none either");
        v.integer("max_depth", max_depth, 1, 16,
                  "levels of recursive and adaptive grids; sizes of a hierarchy");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// One of the grids: its geometry, and where its blocks of cells begin.
struct NestedGridHeader {
    GridSpace space;
    uint32_t first_block = 0;
    uint32_t depth = 0;  ///< 0: the root

    template <class A>
    void archive(A& a) {
        a(space, first_block, depth);
    }
};

/// A cell that is not empty has the code of a list (see list_code), or
///   grid_flag | g     the cell is grid g
/// If the number of a list's references bears grid_flag, the number of grids follows the
/// references, then the grids: objects that stand in several cells.
namespace nested_cell {
inline constexpr uint32_t grid_flag = 1u << 31;
}

/// Grids in the cells of grids, over any set: see NestedGridMethod.
template <class Set>
struct NestedGrid {
    static constexpr const char* name = "nested_grid";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;

    AlignedVector<NestedGridHeader> grids;  ///< the root first; empty: no shapes
    AlignedVector<CellBlock> blocks;        ///< of cells, grid after grid
    AlignedVector<uint32_t> words;          ///< block by block: codes, then lists
    ShapeStore<Set> shapes;
    bool mailbox = false;
    Bounds3 box;  ///< of the shapes; grids are a margin larger
    double cost = 0;
    StructureStatistics stats;

    static NestedGrid build(const Set& set, const NestedGridParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(grids, blocks, words, shapes, mailbox, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
