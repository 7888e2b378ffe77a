#pragma once

#include <cstdint>
#include <vector>

#include "framework/triangle_set.h"

namespace crofton {

/// Corners and triangles of a mesh over a square: 2·n·n triangles that share (n + 1)² corners.
struct HeightField {
    std::vector<Vec3f> corners;
    std::vector<TriangleSet::Indices> triangles;

    /// @param corner  corner(x, y), x and y from 0 to n: a point
    template <class Corner>
    HeightField(uint32_t n, const Corner& corner) {
        for (uint32_t y = 0; y <= n; ++y)
            for (uint32_t x = 0; x <= n; ++x) corners.push_back(corner(float(x), float(y)));
        for (uint32_t y = 0; y < n; ++y)
            for (uint32_t x = 0; x < n; ++x) {
                const uint32_t c = y * (n + 1) + x;
                triangles.push_back({c, c + 1, c + n + 1});
                triangles.push_back({c + 1, c + n + 2, c + n + 1});
            }
    }
};

}  // namespace crofton
