#pragma once

#include <cstdint>

#include "framework/triangle_patches.h"

namespace crofton {

/// A TrianglePatch that names its corners by numbers of one byte: a quarter of its size, and a
/// vertex is stored once for most of the patches around it. No coordinate is rounded, so the test
/// sees the same bits.
///
///   byte   0  vertex that the numbers count from
///          4  the corners, 8 numbers of vertices
///         12  by triangle, corner 0, 1, 2 in bits 0 … 2, 4 … 6, 8 … 10: indices of the above;
///             in bits 12 … 14 of the first, triangles - 1, and in bit 15 whether it has a list
///         28  first id: with a list, where in it the ids begin; else they are this and more by
///             what is at bytes 20 … 27, where the corners of triangles 4 to 7 would be
struct alignas(32) CompactPatch {
    static constexpr uint32_t width = TrianglePatch::width;
    static constexpr uint32_t own_ids = 4;  ///< triangles at most whose ids are in the patch
    static constexpr uint16_t list_bit = 0x8000;
    uint32_t base;
    uint8_t offset[width];
    uint16_t corner[width];
    uint32_t first_id;

    uint32_t count() const { return (corner[0] >> 12 & 7u) + 1; }
    uint32_t vertex(uint32_t triangle, uint32_t k) const {
        return base + offset[corner[triangle] >> 4 * k & 7];
    }
    /// @param list  of all patches
    uint32_t id(uint32_t triangle, const uint32_t* list) const {
        if (corner[0] & list_bit) return list[first_id + triangle];
        return first_id + corner[own_ids + triangle];
    }
};
static_assert(sizeof(CompactPatch) == 32);

/// Leaves of one structure over triangles, as compact patches, and the vertices that they share:
/// in the order of the patches that use them first, each again where a patch would have to reach
/// further back than a byte can name.
class CompactPatches {
  public:
    CompactPatches() = default;
    /// The same triangles in the same patches. In parallel; the same for any number of threads.
    explicit CompactPatches(const TrianglePatches& full);
    template <class A>
    void archive(A& a) {
        a(patches_, vertices_, ids_);
    }
    uint32_t size() const { return uint32_t(patches_.size()); }
    const CompactPatch* patches() const { return patches_.data(); }
    /// x, y, z of each; one more float may be read behind the last.
    const float* vertices() const { return vertices_.data(); }
    const uint32_t* ids() const { return ids_.data(); }
    uint32_t count(uint32_t patch) const { return patches_[patch].count(); }
    uint64_t bytes() const {
        return patches_.size() * sizeof(CompactPatch) + vertices_.size() * sizeof(float) +
               ids_.size() * sizeof(uint32_t);
    }

  private:
    RawAlignedVector<CompactPatch> patches_;
    RawAlignedVector<float> vertices_;
    RawAlignedVector<uint32_t> ids_;
};

}  // namespace crofton
