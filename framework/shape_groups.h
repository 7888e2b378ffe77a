#pragma once

#include <cstdint>
#include <vector>

namespace crofton {

/// Consecutive shapes of a set that belong together in its model: all that is below one node of a
/// scene graph, or one geometry of a mesh.
struct ShapeGroup {
    uint32_t first, end;  ///< shapes first … end - 1
};

/// Groups in preorder: each before those inside it, siblings in ascending order. Two of them are
/// nested or disjoint. Shapes outside all groups belong to the set itself.
using ShapeGroups = std::vector<ShapeGroup>;

}  // namespace crofton
