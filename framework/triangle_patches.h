#pragma once

#include <cstdint>
#include <span>

#include "framework/aligned.h"
#include "framework/triangle_set.h"

namespace crofton {

/// Up to eight triangles on up to eight corners, which neighbours in a mesh share: six triangles of
/// a strip, a third of the bytes and of the arithmetic of as many by themselves. (Shared corners in
/// leaves: after the strips of Lauterbach, Yoon, Manocha 2007, "Ray-strips".)
///
///   byte   0  x, y, z of the corners, 8 floats each
///         96  corner 0, 1, 2 of the triangles, 8 bytes each: indices of the above
///        120  number of triangles      124  of their indices in the set, where they begin
struct alignas(64) TrianglePatch {
    static constexpr uint32_t width = 8;
    float v[3][width];
    uint8_t corner[3][width];
    uint32_t count;
    uint32_t first_id;

    Vec3f vertex(uint32_t triangle, int k) const {
        const uint8_t i = corner[k][triangle];
        return {v[0][i], v[1][i], v[2][i]};
    }
};
static_assert(sizeof(TrianglePatch) == 128);

/// Leaves of one structure over triangles, as patches: a copy in the order of the leaves.
class TrianglePatches {
  public:
    /// Appends a leaf. @return its first patch; the others follow
    uint32_t add(const TriangleSet& set, std::span<const uint32_t> shapes);
    /// Makes room; `put` fills it, in any order.
    void resize(size_t patches, size_t ids);
    /// Writes a leaf: as many patches as `count_patches` says and an id for each shape.
    void put(const TriangleSet& set, std::span<const uint32_t> shapes, uint32_t first_patch,
             uint32_t first_id);
    /// How many patches some shapes fill.
    static uint32_t count_patches(const TriangleSet& set, std::span<const uint32_t> shapes);
    template <class A>
    void archive(A& a) {
        a(patches_, ids_);
    }
    uint32_t size() const { return uint32_t(patches_.size()); }
    const TrianglePatch* patches() const { return patches_.data(); }
    const uint32_t* ids() const { return ids_.data(); }
    uint64_t bytes() const {
        return patches_.size() * sizeof(TrianglePatch) + ids_.size() * sizeof(uint32_t);
    }
    static constexpr bool keeps_set = false;  ///< the set itself is not read in traversal

  private:
    RawAlignedVector<TrianglePatch> patches_;
    RawAlignedVector<uint32_t> ids_;
};

}  // namespace crofton
