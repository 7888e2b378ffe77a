#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
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

/// The groups over a part of the set: what is left of each, numbered as in the part.
/// @param shapes  of the part, ascending
inline ShapeGroups groups_of_part(const ShapeGroups& groups, std::span<const uint32_t> shapes) {
    const auto place = [&](uint32_t shape) {
        return uint32_t(std::lower_bound(shapes.begin(), shapes.end(), shape) - shapes.begin());
    };
    ShapeGroups part;
    for (const ShapeGroup& g : groups)
        if (const ShapeGroup left{place(g.first), place(g.end)}; left.first < left.end)
            part.push_back(left);
    return part;
}

}  // namespace crofton
