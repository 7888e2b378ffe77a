#pragma once

#include "accelerators/leaves.h"
#include "framework/primitive.h"

namespace crofton {

struct BruteForceParameters {
    template <class V>
    void fields(V&) {}
};

/// No structure: every ray that meets the bounds tests every shape. The reference for the others,
/// and the best choice for a handful of shapes.
template <class Set>
struct BruteForce {
    static constexpr const char* name = "brute_force";
    static constexpr bool reads_set = Leaves<Set>::keeps_set;

    Leaves<Set> leaves;  ///< one leaf of all active shapes
    uint32_t count = 0;
    Bounds3 box;
    double cost = 0;

    static BruteForce build(const Set& set, const BruteForceParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(leaves, count, box, cost);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const;
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
