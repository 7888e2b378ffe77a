#pragma once

#include "accelerators/cell_blocks.h"
#include "accelerators/grid_space.h"
#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

/// How many cells a grid gets, for N shapes in a box of extents e.
enum class ResolutionRule {
    lrt,           ///< n per axis, all alike, with n³ = 8·density·N
    pbrt,          ///< 3·∛(density·N) on the longest axis, others in proportion (pbrt 1, 2004)
    woo,           ///< ∛(density·N) on the longest axis, others in proportion (Woo 1992)
    klimaszewski,  ///< cubic cells, density·N in all (Klimaszewski & Sederberg 1997)
    fixed,         ///< resolution_x × resolution_y × resolution_z
};

struct UniformGridParameters {
    ResolutionRule resolution = ResolutionRule::pbrt;
    double density = 1.0;
    int resolution_x = 32, resolution_y = 32, resolution_z = 32;
    bool skip_empty = true;
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.choice("resolution", resolution, {"lrt", "pbrt", "woo", "klimaszewski", "fixed"},
                 "rule for the number of cells");
        v.real("density", density, 1e-3, 1e3, "cells per shape, relative to the rule's own");
        v.integer("resolution_x", resolution_x, 1, 2048, "cells along x, for the fixed rule");
        v.integer("resolution_y", resolution_y, 1, 2048, "cells along y, for the fixed rule");
        v.integer("resolution_z", resolution_z, 1, 2048, "cells along z, for the fixed rule");
        v.boolean("skip_empty", skip_empty, "pass empty regions in one step");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// Cells per axis by a rule. At least 1; at most 2^26 cells in all (the density is lowered).
Vec3i grid_resolution(const UniformGridParameters& parameters, const Bounds3& bounds,
                      size_t shapes);

/// Regular grid of lists of references.
template <class Set>
struct UniformGrid {
    static constexpr const char* name = "uniform_grid";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;

    GridSpace space;
    Bounds3 box;  ///< of the shapes; the grid is a margin larger
    bool mailbox = false;
    bool skip_empty = true;
    AlignedVector<CellBlock> blocks;  ///< empty: no shapes
    AlignedVector<uint32_t> words;    ///< block by block: codes of lists, then the lists
    ShapeStore<Set> shapes;
    double cost = 0;
    StructureStatistics stats;

    static UniformGrid build(const Set& set, const UniformGridParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(space, box, mailbox, skip_empty, blocks, words, shapes, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
