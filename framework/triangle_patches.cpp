#include "framework/triangle_patches.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstring>

#include "framework/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "framework/triangle_patches.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// The corners of a patch in the making, by number, in registers. Spare lanes repeat the first.
class Corners {
    using D = hn::CappedTag<uint32_t, TrianglePatch::width>;
    using V = hn::Vec<D>;
    static constexpr size_t N = hn::MaxLanes(D()), parts = TrianglePatch::width / N;
    static constexpr uint32_t none = TrianglePatch::width;

  public:
    explicit HWY_INLINE Corners(uint32_t first) {
        for (V& v : numbers_) v = hn::Set(D(), first);
    }

    /// Adds a triangle, without a branch on which of its corners are there: it could not be
    /// guessed.
    /// @param index  where its corners are, one byte each
    /// @return false, and nothing has changed, if there is no room
    HWY_INLINE bool add(const PatchCorners::Numbers& t, uint8_t (&index)[3]) {
        // A corner that is here is found before the first place that is free.
        const uint32_t found[3] = {find(t[0]), find(t[1]), find(t[2])};
        uint32_t count = count_, place[3];
        for (int k = 0; k < 3; ++k) {
            place[k] = std::min(found[k], count);
            count += found[k] / none;
        }
        if (HWY_UNLIKELY(t[0] == t[1] || t[1] == t[2] || t[2] == t[0])) {
            // Corners that are one are stored once.
            count = count_;
            for (int k = 0; k < 3; ++k) {
                const int same = t[size_t(k)] == t[0] ? 0 : t[size_t(k)] == t[1] ? 1 : 2;
                place[k] = same < k ? place[same] : std::min(found[k], count);
                count += same < k ? 0 : found[k] / none;
            }
        }
        if (count > TrianglePatch::width) return false;
        for (size_t k = 0; k < 3; ++k) {
            put(t[k], place[k]);
            index[k] = uint8_t(place[k]);
        }
        count_ = count;
        return true;
    }
    HWY_INLINE void store(const float* coordinates, TrianglePatch& patch) const {
        alignas(32) uint32_t numbers[TrianglePatch::width];
        for (size_t i = 0; i < parts; ++i) hn::Store(numbers_[i], D(), numbers + i * N);
        for (size_t i = 0; i < TrianglePatch::width; ++i)
            for (size_t a = 0; a < 3; ++a) patch.v[a][i] = coordinates[size_t{3} * numbers[i] + a];
    }

  private:
    /// Where a corner is; `none` if it is not there.
    HWY_INLINE uint32_t find(uint32_t number) const {
        uint32_t bits = 1u << none;
        for (size_t i = 0; i < parts; ++i) {
            uint8_t b[8] = {};
            hn::StoreMaskBits(D(), hn::Eq(numbers_[i], hn::Set(D(), number)), b);
            bits |= uint32_t(b[0]) << (i * N);
        }
        return uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(bits));
    }
    HWY_INLINE void put(uint32_t number, uint32_t place) {
        const D d;
        for (size_t i = 0; i < parts; ++i)
            numbers_[i] = hn::IfThenElse(hn::Eq(hn::Iota(d, uint32_t(i * N)), hn::Set(d, place)),
                                         hn::Set(d, number), numbers_[i]);
    }

    V numbers_[parts];
    uint32_t count_ = 1;
};

/// Of so many shapes it is first seen whether they fit together; more hardly ever do.
constexpr size_t most_at_once = 6;

/// Packs shapes into patches, each filled with the first of those left that fit.
/// @param patches  where to; not read unless `writes`
/// @param list     ids of all patches; those of these from `first_id` on
/// @return patches filled
template <bool writes>
HWY_INLINE uint32_t pack(const PatchCorners& corners, const uint32_t* shapes, size_t n,
                         TrianglePatch* patches, uint32_t* list, uint32_t first_id) {
    uint32_t buffer[64], filled = 0;
    for (size_t from = 0; from < n; from += 64) {
        size_t left = std::min<size_t>(64, n - from);
        const uint32_t* next = shapes + from;
        while (left > 0) {
            Corners patch_corners(corners.triangles()[next[0]][0]);
            uint8_t corner[3][TrianglePatch::width] = {};
            uint32_t ids[TrianglePatch::width];
            size_t kept = 0;
            uint32_t count = 0;
            for (size_t i = 0; i < left; ++i) {
                const uint32_t shape = next[i];
                uint8_t index[3];
                if (count < TrianglePatch::width &&
                    patch_corners.add(corners.triangles()[shape], index)) {
                    if constexpr (writes) {
                        for (int k = 0; k < 3; ++k) corner[k][count] = index[k];
                        ids[count] = shape;
                    }
                    ++count;
                } else {
                    buffer[kept++] = shape;
                }
            }
            left = kept;
            next = buffer;
            if constexpr (writes) {
                TrianglePatch& patch = patches[filled];
                patch_corners.store(corners.coordinates(), patch);
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

/// Whether a few shapes fit into one patch: as many different corners as it has room for.
HWY_INLINE bool fit_together(const PatchCorners& corners, const uint32_t* shapes, size_t n) {
    using D = hn::CappedTag<uint32_t, 16>;
    constexpr size_t lanes = hn::MaxLanes(D());
    alignas(64) uint32_t numbers[3 * most_at_once / lanes * lanes + lanes];
    for (size_t i = 0; i < n; ++i) {
        const PatchCorners::Numbers& t = corners.triangles()[shapes[i]];
        numbers[3 * i] = t[0], numbers[3 * i + 1] = t[1], numbers[3 * i + 2] = t[2];
    }
    uint32_t different = 0;
    for (uint32_t k = 0; k < 3 * n; ++k) {
        const auto number = hn::Set(D(), numbers[k]);
        uint32_t equal = 0;
        for (size_t i = 0; i <= k; i += lanes) {
            uint8_t bits[8] = {};
            hn::StoreMaskBits(D(), hn::Eq(hn::Load(D(), numbers + i), number), bits);
            equal |= (uint32_t(bits[0]) | uint32_t(bits[1]) << 8) << i;
        }
        different += (equal & ((1u << k) - 1)) == 0;  // none before it
    }
    return different <= TrianglePatch::width;
}

uint32_t count_patches(const PatchCorners& corners, const uint32_t* shapes, size_t n) {
    if (n <= most_at_once) {
        if (fit_together(corners, shapes, n)) return 1;
        if (n <= 4) return 2;  // what does not fit into the first are two at most, or one
    }
    return pack<false>(corners, shapes, n, nullptr, nullptr, 0);
}
void write_patches(const PatchCorners& corners, const uint32_t* shapes, size_t n,
                   TrianglePatch* patches, uint32_t* list, uint32_t first_id) {
    pack<true>(corners, shapes, n, patches, list, first_id);
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
namespace {
HWY_EXPORT(count_patches);
HWY_EXPORT(write_patches);

/// Finds a place for each position, the same for equal ones: a table of points by a hash of their
/// position, filled by all threads at once. Of the points at one position the lowest stays.
class PointTable {
  public:
    /// @param corner  of a point: the number of a corner
    template <class Corner>
    PointTable(size_t points, const float* coordinates, const Corner& corner)
        : shift_(64 - std::bit_width(2 * points)), table_(size_t{1} << (64 - shift_)) {
        std::memset(table_.data(), 0xff, table_.size() * sizeof(uint32_t));
        place_.resize(points);
        parallel_for(points, 1 << 13, [&](size_t begin, size_t end) {
            for (size_t p = begin; p < end; ++p) {
                const float* const at = coordinates + size_t{3} * corner(p);
                place_[p] = insert(uint32_t(p), at, [&](uint32_t other) {
                    return std::memcmp(at, coordinates + size_t{3} * corner(other), 12) == 0;
                });
            }
        });
    }
    /// By point: the lowest one at its position. Called once, when all are in.
    std::span<const uint32_t> first() {
        parallel_for(place_.size(), 1 << 14, [&](size_t begin, size_t end) {
            for (size_t p = begin; p < end; ++p) place_[p] = table_[place_[p]];
        });
        return place_;
    }

  private:
    template <class Equal>
    uint32_t insert(uint32_t p, const float* at, const Equal& equal) {
        uint32_t bits[3];
        std::memcpy(bits, at, sizeof bits);
        const uint64_t hash = bits[0] * uint64_t{0x9e3779b97f4a7c15} +
                              bits[1] * uint64_t{0xc2b2ae3d27d4eb4f} +
                              bits[2] * uint64_t{0x165667b19e3779f9};
        for (size_t i = hash >> shift_;; i = (i + 1) & (table_.size() - 1)) {
            std::atomic_ref<uint32_t> slot(table_[i]);
            uint32_t other = slot.load(std::memory_order_relaxed);
            // A place once taken stays that of its position.
            if (other == free && slot.compare_exchange_strong(other, p, std::memory_order_relaxed))
                return uint32_t(i);
            if (!equal(other)) continue;
            while (p < other && !slot.compare_exchange_weak(other, p, std::memory_order_relaxed)) {
            }
            return uint32_t(i);
        }
    }

    static constexpr uint32_t free = ~0u;
    int shift_;
    RawAlignedVector<uint32_t> table_, place_;
};
}  // namespace

PatchCorners::PatchCorners(const TriangleSet& set, bool quick)
    : coordinates_(set.coordinates()), distinct_(set.vertices()), triangles_(set.triangles()) {
    // A closed mesh has half as many corners as triangles.
    if (set.size() == 0 || (quick && set.vertices() < 0.7 * set.size())) return;
    merged_.resize(set.size());
    triangles_ = merged_.data();
    const uint32_t* const begin = set.triangles()[0].data();
    const size_t corners = size_t{3} * set.size();
    uint32_t least = ~0u, most = 0;
    for (size_t i = 0; i < corners; ++i)
        least = std::min(least, begin[i]), most = std::max(most, begin[i]);
    const auto number = [&](PointTable table, const auto& point, const auto& corner) {
        const std::span<const uint32_t> first = table.first();
        distinct_ = 0;
        for (size_t p = 0; p < first.size(); ++p) distinct_ += first[p] == p;
        parallel_for(set.size(), 1 << 13, [&](size_t from, size_t to) {
            uint32_t* const to_numbers = merged_[0].data();
            for (size_t i = 3 * from; i < 3 * to; ++i)
                to_numbers[i] = uint32_t(corner(first[point(i)]));
        });
    };
    if (most - least < corners) {
        const auto corner = [&](size_t point) { return size_t(least + point); };
        number(
            PointTable(most - least + size_t{1}, coordinates_, corner),
            [&](size_t i) { return size_t(begin[i] - least); }, corner);
    } else {
        // A few triangles of a large mesh.
        const auto corner = [&](size_t point) { return size_t(begin[point]); };
        number(
            PointTable(corners, coordinates_, corner), [](size_t i) { return i; }, corner);
    }
}

void TrianglePatches::resize(size_t patches, size_t ids) {
    patches_.resize(patches);
    ids_.resize(ids);
}

void TrianglePatches::put(const PatchCorners& corners, std::span<const uint32_t> shapes,
                          uint32_t first_patch, uint32_t first_id) {
    // Several patches may leave some of it.
    std::fill_n(ids_.begin() + first_id, listed_ids(shapes.size()), no_id);
    HWY_DYNAMIC_DISPATCH(write_patches)
    (corners, shapes.data(), shapes.size(), patches_.data() + first_patch, ids_.data(), first_id);
}

uint32_t TrianglePatches::add(const PatchCorners& corners, std::span<const uint32_t> shapes) {
    const uint32_t first = size(), first_id = uint32_t(ids_.size());
    resize(first + corners.count_patches(shapes), first_id + listed_ids(shapes.size()));
    put(corners, shapes, first, first_id);
    return first;
}

uint32_t PatchCorners::count_patches(std::span<const uint32_t> shapes) const {
    if (shapes.size() <= 2) return uint32_t(!shapes.empty());  // six corners at most
    return HWY_DYNAMIC_DISPATCH(count_patches)(*this, shapes.data(), shapes.size());
}

}  // namespace crofton
#endif
