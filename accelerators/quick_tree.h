#pragma once

#include "accelerators/tree_build.h"
#include "framework/triangle_patches.h"

namespace crofton {

/// What the quick build of a wide_bvh over triangles makes before its nodes: a binary tree in
/// Morton order (Lauterbach et al. 2009: "Fast BVH construction on GPUs") whose leaves are patches.
/// It is made from the leaves up, in one pass over the sorted keys (after Apetrei 2014: "Fast and
/// simple agglomerative LBVH construction").
struct QuickTree {
    BinaryTree tree;  ///< a leaf's `first` is its patch; there is no order
    RawAlignedVector<TrianglePatch> patches;
    RawAlignedVector<uint32_t> ids;  ///< that patches list
    uint32_t triangles = 0;
};

/// Triangles are joined in a patch where they fit one and the area heuristic says so. Same result
/// for any number of threads.
/// @param max_leaf_size  triangles in a leaf at most, as far as a patch has room
QuickTree build_quick_tree(const TriangleSet& set, const PatchCorners& corners,
                           const TreeCosts& costs, int max_leaf_size);

}  // namespace crofton
