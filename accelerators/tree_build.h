#pragma once

#include <type_traits>
#include <vector>

#include "accelerators/binary_tree.h"

namespace crofton {

class TriangleSet;

/// How a binary hierarchy is made; see bvh.md.
enum class TreeBuilder { median, binned_sah, sweep_sah, sbvh, ploc, lbvh, insertion };

/// In which order shapes are inserted.
enum class InsertionOrder { file, shuffled, morton };

/// Of every structure made from a binary hierarchy.
struct TreeParameters {
    TreeBuilder builder = TreeBuilder::binned_sah;
    int max_leaf_size = 8;
    int bins = 16;
    double split_overlap = 1e-5;
    double reference_budget = 2.0;
    int ploc_radius = 16;
    InsertionOrder insertion_order = InsertionOrder::shuffled;
    int reinsertion = 0;

    /// @param largest_leaf  that the structure can store
    template <class V>
    void fields(V& v, int largest_leaf) {
        v.choice("builder", builder,
                 {"median", "binned_sah", "sweep_sah", "sbvh", "ploc", "lbvh", "insertion"},
                 "halves by count; area heuristic at bins or at every centroid; with spatial "
                 "splits; nearest clusters; Morton order; one shape after another");
        v.integer("max_leaf_size", max_leaf_size, 1, largest_leaf,
                  "shapes in a leaf at most; fewer where the area heuristic says so");
        v.integer("bins", bins, 2, 64, "candidate planes per axis and node, plus one");
        v.real(
            "split_overlap", split_overlap, 0, 1,
            "sbvh: planes cut shapes where children overlap by more than this share of the root");
        v.real("reference_budget", reference_budget, 1, 16,
               "sbvh: references at most, as a multiple of the shapes");
        v.integer("ploc_radius", ploc_radius, 1, 256,
                  "ploc: clusters looked at on either side in Morton order");
        v.choice("insertion_order", insertion_order, {"file", "shuffled", "morton"},
                 "insertion: order in which shapes come");
        v.integer(
            "reinsertion", reinsertion, 0, 64,
            "passes that move the largest subtrees to where they cost less; any builder; 0: none");
    }
};

/// What spatial splits ask of a set.
struct ShapeClipper {
    ClipShape clip;
    const TriangleSet* triangles = nullptr;  ///< null: other shapes, known by their boxes
};

/// Builds a hierarchy over references: by the chosen builder, optimised, no deeper than
/// BinaryTree::max_depth, with leaves where they cost no more than what they replace. The result
/// does not depend on the number of threads. Leaves name each shape once, ascending.
/// @param references  not changed in what they bound; empty: an empty tree
/// @param clipper     used by sbvh only
BinaryTree build_tree(BuildReferences references, const ShapeClipper& clipper,
                      const TreeParameters& parameters, const TreeCosts& costs);

/// The same over all active shapes of a set.
template <class Set>
BinaryTree build_tree(const Set& set, const TreeParameters& parameters, const TreeCosts& costs) {
    ShapeClipper clipper;
    clipper.clip = [&](uint32_t shape, const Bounds3& box) {
        return intersection(set.clipped_bounds(shape, box), box);
    };
    if constexpr (std::is_same_v<Set, TriangleSet>) clipper.triangles = &set;
    return build_tree(build_references(set), clipper, parameters, costs);
}

/// @name Builders
/// Take at least one reference; every leaf has one reference unless said otherwise. Same result
/// for any number of threads.
/// @{

/// Area heuristic (MacDonald & Booth 1990) evaluated at bins of centroids (Wald 2007: "On fast
/// construction of SAH-based bounding volume hierarchies"), top down, O(N log N). Where no split is
/// possible (equal centroids) or the tree gets deeper than 40 levels, references are halved by
/// count, so that no tree is deeper than 72.
/// @param max_leaf_size  leaves of up to so many, where no split at hand costs less
BinaryTree build_binned(BuildReferences references, const TreeCosts& costs, int bins,
                        int max_leaf_size);

/// Halves by count on the axis where centroids spread most (Kay & Kajiya 1986). Depth: log2(N).
BinaryTree build_median(BuildReferences references);

/// Area heuristic at every centroid, from lists sorted once: O(N log N). Halves as build_binned.
BinaryTree build_sweep(BuildReferences references, const TreeCosts& costs);

/// Area heuristic at bins of centroids, and where the children of the best such split overlap by
/// more than `split_overlap` of the root's area, at planes that cut shapes (Stich, Friedrich,
/// Dietrich 2009: "Spatial splits in bounding volume hierarchies"): a shape that straddles one goes
/// clipped to both sides, or whole to one where that is cheaper. Leaves have one reference; there
/// are at most reference_budget times as many as shapes.
BinaryTree build_split(BuildReferences references, const ShapeClipper& clipper,
                       const TreeParameters& parameters, const TreeCosts& costs);

/// Splits at the highest bit of Morton codes that differs (Lauterbach et al. 2009: "Fast BVH
/// construction on GPUs").
/// @param leaf_size  of as many references no more nodes are made
BinaryTree build_morton(BuildReferences references, int leaf_size);

/// Parallel locally-ordered clustering (Meister & Bittner 2018), bottom up: neighbours in Morton
/// order that are each other's nearest, of `radius` on either side, become one cluster.
BinaryTree build_clustered(BuildReferences references, int radius);

/// One shape after another, each greedily to where areas grow least (Goldsmith & Salmon 1987:
/// "Automatic creation of object hierarchies for ray tracing"; here every node has two children).
BinaryTree build_inserted(BuildReferences references, InsertionOrder order);
/// @}

/// Indices by the Morton code of the centroid, see MortonKeys.
std::vector<uint32_t> morton_order(const BuildReferences& references);

/// @name Work on a finished tree
/// @{

/// Rebuilds what is deeper than BinaryTree::max_depth: below level 40 as halves by centroid.
/// @return whether there was any
bool limit_depth(BinaryTree& tree);

/// Moves subtrees to where the sum of areas falls most, pass after pass (Bittner, Hapala, Havran
/// 2013: "Fast insertion-based optimization of bounding volume hierarchies"; Meister & Bittner
/// 2018: "Parallel reinsertion for bounding volume hierarchy optimization"). Leaves move as they
/// are. The sum never grows; the depth stays within BinaryTree::max_depth if it was.
void reinsert(BinaryTree& tree, int passes);

/// Half areas of all inner nodes, in sum.
double inner_area(const BinaryTree& tree);

/// Makes leaves of subtrees that cost no less (bottom up, by dynamic programming) and puts nodes
/// and shapes into depth-first order. The depth must be within BinaryTree::max_depth.
void collapse_leaves(BinaryTree& tree, const TreeCosts& costs, std::span<const float> cost_of_shape,
                     int max_leaf_size);
/// @}

/// Twice the centre of a box, on one axis; finite for all finite boxes up to FLT_MAX / 2.
inline float centroid2(const Bounds3& b, int axis) { return b.lower[axis] + b.upper[axis]; }

}  // namespace crofton
