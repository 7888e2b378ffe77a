#pragma once

#include "accelerators/grid_space.h"
#include "accelerators/mailbox.h"
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
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.choice("resolution", resolution, {"lrt", "pbrt", "woo", "klimaszewski", "fixed"},
                 "rule for the number of cells");
        v.real("density", density, 1e-3, 1e3, "cells per shape, relative to the rule's own");
        v.integer("resolution_x", resolution_x, 1, 2048, "cells along x, for the fixed rule");
        v.integer("resolution_y", resolution_y, 1, 2048, "cells along y, for the fixed rule");
        v.integer("resolution_z", resolution_z, 1, 2048, "cells along z, for the fixed rule");
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
    static constexpr bool reads_set = true;

    GridSpace space;
    bool mailbox = false;
    AlignedVector<uint32_t> first;       ///< per cell, into references; one more at the end
    AlignedVector<uint32_t> references;  ///< ascending within a cell
    uint32_t longest = 0;                ///< references in the fullest cell
    double cost = 0;
    StructureStatistics stats;

    static UniformGrid build(const Set& set, const UniformGridParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(space, mailbox, first, references, longest, cost, stats);
    }
    const Bounds3& bounds() const { return space.box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
