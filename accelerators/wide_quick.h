#pragma once

#include "accelerators/quick_tree.h"

namespace crofton {

/// @param max_leaf_size  triangles in a leaf at most, as far as a patch has room
QuickTree build_quick_tree(const TriangleSet& set, const PatchCorners& corners,
                           const TreeCosts& costs, int max_leaf_size);

}  // namespace crofton
