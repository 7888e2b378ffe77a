#include "framework/triangle_patches.h"

#include <algorithm>
#include <array>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "framework/triangle_patches.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// The corners of a patch in the making, in registers. Spare lanes repeat the first, so that no
/// arithmetic on them is slow or invalid.
class Corners {
    using D = hn::CappedTag<int32_t, TrianglePatch::width>;
    using V = hn::Vec<D>;
    static constexpr size_t N = hn::MaxLanes(D()), parts = TrianglePatch::width / N;

  public:
    /// One corner, its coordinates as they are stored.
    struct Point {
        int32_t at[3];
        explicit HWY_INLINE Point(const float* p) { std::memcpy(at, p, sizeof at); }
    };

    explicit HWY_INLINE Corners(const Point& first) {
        for (size_t i = 0; i < parts; ++i)
            for (int a = 0; a < 3; ++a) v_[a][i] = hn::Set(D(), first.at[a]);
    }
    HWY_INLINE uint32_t count() const { return count_; }

    /// Bits of the corners that are at p. By position: meshes that were cut at seams of texture
    /// share no indices there.
    HWY_INLINE uint32_t find(const Point& p) const {
        uint32_t bits = 0;
        for (size_t i = 0; i < parts; ++i) {
            const D d;
            const auto same = hn::And(hn::And(hn::Eq(v_[0][i], hn::Set(d, p.at[0])),
                                              hn::Eq(v_[1][i], hn::Set(d, p.at[1]))),
                                      hn::Eq(v_[2][i], hn::Set(d, p.at[2])));
            uint8_t b[8] = {};
            hn::StoreMaskBits(d, same, b);
            bits |= uint32_t(b[0]) << (i * N);
        }
        return bits & ((1u << count_) - 1);
    }
    HWY_INLINE uint32_t put(const Point& p) {
        const D d;
        for (size_t i = 0; i < parts; ++i) {
            const auto here = hn::Eq(hn::Iota(d, int32_t(i * N)), hn::Set(d, int32_t(count_)));
            for (int a = 0; a < 3; ++a)
                v_[a][i] = hn::IfThenElse(here, hn::Set(d, p.at[a]), v_[a][i]);
        }
        return count_++;
    }
    HWY_INLINE void store(TrianglePatch& patch) const {
        for (int a = 0; a < 3; ++a)
            for (size_t i = 0; i < parts; ++i)
                hn::Store(v_[a][i], D(), reinterpret_cast<int32_t*>(patch.v[a] + i * N));
    }

  private:
    V v_[3][parts];
    uint32_t count_ = 0;
};

/// Adds a triangle to a patch in the making.
/// @param index  where its corners are in it, one byte each
/// @return false, and nothing has changed, if there is no room
HWY_INLINE bool add_triangle(Corners& corners, const TriangleSet& set, uint32_t shape,
                             uint8_t (&index)[3]) {
    const TriangleSet::Indices& t = set.triangles()[shape];
    const float* const at = set.coordinates();
    const Corners::Point p[3] = {Corners::Point(at + size_t{3} * t[0]),
                                 Corners::Point(at + size_t{3} * t[1]),
                                 Corners::Point(at + size_t{3} * t[2])};
    const uint32_t found[3] = {corners.find(p[0]), corners.find(p[1]), corners.find(p[2])};
    const bool fresh[3] = {!found[0], !found[1] && t[1] != t[0],
                           !found[2] && t[2] != t[0] && t[2] != t[1]};
    const uint32_t more = uint32_t(fresh[0]) + uint32_t(fresh[1]) + uint32_t(fresh[2]);
    if (corners.count() + more > TrianglePatch::width) return false;
    for (size_t k = 0; k < 3; ++k) {
        if (fresh[k])
            index[k] = uint8_t(corners.put(p[k]));
        else if (found[k])
            index[k] = uint8_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(found[k]));
        else
            index[k] = t[k] == t[0] ? index[0] : index[1];
    }
    return true;
}

/// Packs shapes into patches, each filled with the first of those left that fit.
/// @param patches  where to; null: nothing is written
/// @param list     ids of all patches; those of these from `first_id` on
/// @return patches filled
uint32_t pack(const TriangleSet& set, const uint32_t* shapes, size_t n, TrianglePatch* patches,
              uint32_t* list, uint32_t first_id) {
    uint32_t buffer[64], filled = 0;
    for (size_t from = 0; from < n; from += 64) {
        size_t left = std::min<size_t>(64, n - from);
        std::copy_n(shapes + from, left, buffer);
        while (left > 0) {
            Corners corners(
                Corners::Point(set.coordinates() + size_t{3} * set.triangles()[buffer[0]][0]));
            uint8_t corner[3][TrianglePatch::width] = {};
            uint32_t ids[TrianglePatch::width];
            size_t kept = 0;
            uint32_t count = 0;
            for (size_t i = 0; i < left; ++i) {
                uint8_t index[3];
                if (count < TrianglePatch::width && add_triangle(corners, set, buffer[i], index)) {
                    for (int k = 0; k < 3; ++k) corner[k][count] = index[k];
                    ids[count++] = buffer[i];
                } else {
                    buffer[kept++] = buffer[i];
                }
            }
            left = kept;
            if (patches) {
                TrianglePatch& patch = patches[filled];
                corners.store(patch);
                std::memcpy(patch.corner, corner, sizeof corner);
                patch.count = count;
                patch.first_id = first_id;
                if (count > TrianglePatch::own_ids) {
                    std::copy_n(ids, count, list + first_id);
                    first_id += count;
                } else {
                    for (uint32_t i = 0; i < count; ++i) patch.set_own_id(i, ids[i]);
                }
            }
            ++filled;
        }
    }
    return filled;
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
namespace {
HWY_EXPORT(pack);
}  // namespace

void TrianglePatches::resize(size_t patches, size_t ids) {
    patches_.resize(patches);
    ids_.resize(ids);
}

void TrianglePatches::put(const TriangleSet& set, std::span<const uint32_t> shapes,
                          uint32_t first_patch, uint32_t first_id) {
    // Several patches may leave some of it.
    std::fill_n(ids_.begin() + first_id, listed_ids(shapes.size()), no_id);
    HWY_DYNAMIC_DISPATCH(pack)
    (set, shapes.data(), shapes.size(), patches_.data() + first_patch, ids_.data(), first_id);
}

uint32_t TrianglePatches::add(const TriangleSet& set, std::span<const uint32_t> shapes) {
    const uint32_t first = size(), first_id = uint32_t(ids_.size());
    resize(first + count_patches(set, shapes), first_id + listed_ids(shapes.size()));
    put(set, shapes, first, first_id);
    return first;
}

uint32_t TrianglePatches::count_patches(const TriangleSet& set, std::span<const uint32_t> shapes) {
    if (shapes.size() <= 2) return uint32_t(!shapes.empty());  // six corners at most
    return HWY_DYNAMIC_DISPATCH(pack)(set, shapes.data(), shapes.size(), nullptr, nullptr, 0);
}

}  // namespace crofton
#endif
