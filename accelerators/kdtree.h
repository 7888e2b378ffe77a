#pragma once

#include "accelerators/kd_build.h"
#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/aligned.h"
#include "framework/primitive.h"

namespace crofton {

struct KdTreeParameters {
    KdBuilder builder = KdBuilder::exact_sah;
    int max_depth = 0;
    int max_leaf_size = 1;
    int bins = 32;
    double empty_bonus = 0.2;
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.choice("builder", builder, {"spatial_median", "object_median", "binned_sah", "exact_sah"},
                 "where planes go: middle of the cell, median shape, or the area heuristic");
        v.integer("max_depth", max_depth, 0, KdTreeData::max_depth,
                  "levels at most; 0: 8 + 1.3 log2(shapes)");
        v.integer("max_leaf_size", max_leaf_size, 1, 64,
                  "cells with so few shapes are not split; others where a leaf costs less");
        v.integer("bins", bins, 2, 64, "candidate planes per axis and node of binned_sah");
        v.real("empty_bonus", empty_bonus, 0, 0.95,
               "share taken off the cost of a plane that cuts off empty space");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// Binary space partition by axis-aligned planes, over references. See build_kd_tree.
template <class Set>
struct KdTree {
    static constexpr const char* name = "kdtree";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;
    static constexpr int max_depth = KdTreeData::max_depth;

    AlignedVector<KdNode> nodes;  ///< as KdTreeData has them; empty: no shapes
    AlignedVector<uint32_t> references;
    ShapeStore<Set> shapes;
    Bounds3 box;
    float magnitude = 0;  ///< of the box
    bool mailbox = false;
    double cost = 0;
    StructureStatistics stats;

    static KdTree build(const Set& set, const KdTreeParameters& parameters);
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
