#pragma once

#include <cstdint>
#include <cstring>
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
///        120  number of triangles
///        124  where their ids (indices in the set) begin in a list
/// Up to four triangles, as most patches have, need no list: their ids are at bytes 100, 108, 116
/// and 124, where the corners of triangles 4 to 7 would be.
struct alignas(64) TrianglePatch {
    static constexpr uint32_t width = 8;
    static constexpr uint32_t own_ids = 4;  ///< triangles at most whose ids are in the patch
    float v[3][width];
    uint8_t corner[3][width];
    uint32_t count;
    uint32_t first_id;

    Vec3f vertex(uint32_t triangle, int k) const {
        const uint8_t i = corner[k][triangle];
        return {v[0][i], v[1][i], v[2][i]};
    }
    /// @param list  of all patches
    uint32_t id(uint32_t triangle, const uint32_t* list) const {
        if (count > own_ids) return list[first_id + triangle];
        uint32_t id;
        std::memcpy(&id, reinterpret_cast<const char*>(this) + place_of_id(triangle), sizeof id);
        return id;
    }
    void set_own_id(uint32_t triangle, uint32_t id) {
        std::memcpy(reinterpret_cast<char*>(this) + place_of_id(triangle), &id, sizeof id);
    }

  private:
    static constexpr size_t place_of_id(uint32_t triangle) {
        return sizeof v + width * triangle + own_ids;
    }
};
static_assert(sizeof(TrianglePatch) == 128);

/// The corners of all triangles of a set by number, the same for those at one place: meshes that
/// were cut at seams of texture share no indices there. What patches are packed from.
class PatchCorners {
  public:
    using Numbers = std::array<uint32_t, 3>;
    /// O(N); must not outlive the set.
    /// @param quick  corners go by their indices where the triangles share so many that they do
    /// well
    explicit PatchCorners(const TriangleSet& set, bool quick = false);
    PatchCorners(const PatchCorners&) = delete;
    const Numbers* triangles() const { return triangles_; }
    /// Different numbers, or somewhat more: half as many as there are triangles in a closed mesh,
    /// three times as many where they share nothing.
    size_t distinct() const { return distinct_; }
    /// Three floats a number.
    const float* coordinates() const { return coordinates_; }
    /// How many patches some shapes fill.
    uint32_t count_patches(std::span<const uint32_t> shapes) const;

  private:
    const float* coordinates_;
    size_t distinct_;
    const Numbers* triangles_;          ///< the set's indices, or
    RawAlignedVector<Numbers> merged_;  ///< those of the first at each place
};

/// Leaves of one structure over triangles, as patches: a copy in the order of the leaves.
class TrianglePatches {
  public:
    TrianglePatches() = default;
    /// Of patches that are made, and the ids that they list.
    TrianglePatches(RawAlignedVector<TrianglePatch> patches, RawAlignedVector<uint32_t> ids)
        : patches_(std::move(patches)), ids_(std::move(ids)) {}
    /// Appends a leaf. @return its first patch; the others follow
    uint32_t add(const PatchCorners& corners, std::span<const uint32_t> shapes);
    /// Makes room; `put` fills it, in any order.
    void resize(size_t patches, size_t ids);
    /// Room in the list of ids for a leaf of so many shapes.
    static uint32_t listed_ids(size_t shapes) {
        return shapes > TrianglePatch::own_ids ? uint32_t(shapes) : 0;
    }
    /// Writes a leaf: as many patches as `count_patches` says, and `listed_ids`.
    void put(const PatchCorners& corners, std::span<const uint32_t> shapes, uint32_t first_patch,
             uint32_t first_id);
    template <class A>
    void archive(A& a) {
        a(patches_, ids_);
    }
    uint32_t size() const { return uint32_t(patches_.size()); }
    uint32_t count(uint32_t patch) const { return patches_[patch].count; }
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
