#pragma once

#include <cstdint>
#include <span>

#include "framework/bounds.h"

namespace crofton {

/// 4 × 4 × 4 cells of a grid. Only cells that are not empty have a code; those of a block follow
/// each other, in the order of their bits. An empty cell is known from its block alone, and a ray
/// loads a block once for all cells that it crosses there: 0.25 bytes a cell, and 4 for one that is
/// not empty.
///
///   byte  0  occupied: bit x + 4y + 16z of the cells that are not empty
///         8  first:    place of the first code
///        12  clear:    for an empty block, how many blocks on all sides are empty, too
struct CellBlock {
    uint64_t occupied = 0;
    uint32_t first = 0;
    uint32_t clear = 0;
};
static_assert(sizeof(CellBlock) == 16);

inline int blocks_along(int cells) { return (cells + 3) >> 2; }
inline Vec3i blocks_of(const Vec3i& resolution) {
    return {blocks_along(resolution[0]), blocks_along(resolution[1]), blocks_along(resolution[2])};
}
inline size_t block_count(const Vec3i& resolution) {
    const Vec3i n = blocks_of(resolution);
    return size_t(n[0]) * size_t(n[1]) * size_t(n[2]);
}

/// A cell's number in the order of blocks: 64·block + bit.
inline size_t blocked_index(const Vec3i& resolution, int x, int y, int z) {
    const size_t nx = size_t(blocks_along(resolution[0])), ny = size_t(blocks_along(resolution[1]));
    const size_t block = (size_t(z >> 2) * ny + size_t(y >> 2)) * nx + size_t(x >> 2);
    return block << 6 | size_t((x & 3) | (y & 3) << 2 | (z & 3) << 4);
}
/// Its inverse.
inline Vec3i cell_at(const Vec3i& resolution, size_t index) {
    const size_t nx = size_t(blocks_along(resolution[0])), ny = size_t(blocks_along(resolution[1]));
    const size_t block = index >> 6;
    const int bit = int(index & 63);
    return {int(block % nx) * 4 + (bit & 3), int(block / nx % ny) * 4 + (bit >> 2 & 3),
            int(block / nx / ny) * 4 + (bit >> 4)};
}

/// Place of the code of a cell, or `none`.
inline constexpr uint32_t no_code = ~0u;
inline uint32_t code_place(const CellBlock* blocks, size_t index) {
    const CellBlock& block = blocks[index >> 6];
    const uint64_t bit = uint64_t(1) << (index & 63);
    if (!(block.occupied & bit)) return no_code;
    return block.first + uint32_t(__builtin_popcountll(block.occupied & (bit - 1)));
}

/// Fills in `clear`: chessboard distances in two sweeps (Rosenfeld & Pfaltz 1968). Beyond the grid,
/// all is empty.
/// @param n  blocks per axis
inline void measure_clearance(std::span<CellBlock> blocks, const Vec3i& n) {
    constexpr uint32_t far = 1 << 20;
    const auto sweep = [&](bool back) {
        const int s = back ? 1 : -1;
        for (size_t k = 0; k < blocks.size(); ++k) {
            const size_t i = back ? blocks.size() - 1 - k : k;
            const int x = int(i % size_t(n[0])), y = int(i / size_t(n[0]) % size_t(n[1]));
            const int z = int(i / size_t(n[0]) / size_t(n[1]));
            if (blocks[i].occupied) continue;
            uint32_t least = back ? blocks[i].clear : far;
            // Neighbours that the sweep has passed, as (z, y, x) less or more than this one's.
            for (int dz = 0; dz <= 1; ++dz)
                for (int dy = dz ? -1 : 0; dy <= 1; ++dy)
                    for (int dx = dz || dy ? -1 : 1; dx <= 1; ++dx) {
                        const int u = x + s * dx, v = y + s * dy, w = z + s * dz;
                        if (u < 0 || v < 0 || w < 0 || u >= n[0] || v >= n[1] || w >= n[2])
                            continue;
                        const CellBlock& b = blocks[(size_t(w) * n[1] + v) * n[0] + u];
                        least = std::min(least, b.occupied ? 0 : b.clear + 1);
                    }
            blocks[i].clear = least;
        }
    };
    sweep(false);
    sweep(true);
}

}  // namespace crofton
