#pragma once

#include <memory>

#include "accelerators/grid_space.h"
#include "accelerators/mailbox.h"
#include "accelerators/shape_store.h"
#include "framework/aligned.h"
#include "framework/archive.h"
#include "framework/primitive.h"

namespace crofton {

struct SparseGridParameters {
    double density = 1.0;
    int max_resolution = 4096;
    int size_classes = 4;
    int max_per_voxel = 48;
    int refinements = 2;
    MailboxMode mailbox = MailboxMode::automatic;

    template <class V>
    void fields(V& v) {
        v.real("density", density, 1e-2, 1e2,
               "voxels per median extent of the shapes, along an axis");
        v.integer("max_resolution", max_resolution, 1, 4096,
                  "voxels along the longest axis at most");
        v.integer("size_classes", size_classes, 1, 8,
                  "grids at most, each for shapes of a size, where one would be too large");
        v.integer("max_per_voxel", max_per_voxel, 1, 4096,
                  "what is in a voxel with more moves to a finer grid");
        v.integer("refinements", refinements, 0, 4, "finer grids at most, for each class of sizes");
        v.choice("mailbox", mailbox, {"off", "on", "auto"},
                 "test a shape once per ray; auto: where shapes are dear and repeat");
    }
};

/// A NanoVDB grid of list ids; only sparse_grid.cpp knows what is in it.
struct SparseVoxels;

void archive_voxels(ArchiveWriter& out, std::shared_ptr<const SparseVoxels>& voxels);
void archive_voxels(ArchiveReader& in, std::shared_ptr<const SparseVoxels>& voxels);

/// The grid of one class of sizes, or of what fills some voxels of such a grid.
struct SparseGridClass {
    GridSpace space;  ///< of voxels
    std::shared_ptr<const SparseVoxels> voxels;

    template <class A>
    void archive(A& a) {
        a(space);
        archive_voxels(a, voxels);
    }
};

/// Sparse grids of voxels, in the topology of OpenVDB (Museth 2013): 32³ nodes of 16³ nodes of 8³
/// voxels. An active voxel's value is the code of its list in `words`: see list_code.
template <class Set>
struct SparseGrid {
    static constexpr const char* name = "sparse_grid";
    static constexpr bool reads_set = ShapeStore<Set>::keeps_set;

    std::vector<SparseGridClass> classes;  ///< largest shapes first: they cut rays short
    AlignedVector<uint32_t> words;         ///< lists
    ShapeStore<Set> shapes;
    bool mailbox = false;
    Bounds3 box;  ///< of the shapes
    double cost = 0;
    StructureStatistics stats;

    static SparseGrid build(const Set& set, const SparseGridParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(classes, words, shapes, mailbox, box, cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
};

}  // namespace crofton
