#include "framework/triangle_patches.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace crofton {
namespace {

/// The corners of a patch in the making.
struct Corners {
    std::array<Vec3f, TrianglePatch::width> at;
    uint32_t count = 0;

    /// Where a corner is, put there if it is new; `width` if there is no room. By position: meshes
    /// that were cut at seams of texture share no indices there.
    uint32_t place(const Vec3f& p) {
        for (uint32_t i = 0; i < count; ++i)
            if (std::memcmp(&at[i], &p, sizeof p) == 0) return i;
        if (count == TrianglePatch::width) return TrianglePatch::width;
        at[count] = p;
        return count++;
    }
    /// @return false, and nothing has changed, if there is no room
    bool add(const TriangleSet& set, uint32_t shape, std::array<uint32_t, 3>& corner) {
        const uint32_t before = count;
        for (int k = 0; k < 3; ++k) {
            corner[size_t(k)] = place(set.vertex(shape, k));
            if (corner[size_t(k)] == TrianglePatch::width) {
                count = before;
                return false;
            }
        }
        return true;
    }
};

/// Packs shapes into patches, each filled with the first of those left that fit.
/// @param begin  begin(): a patch; put(shape, corner, corners) -> void: a triangle into it
template <class Begin, class Put, class End>
void pack(const TriangleSet& set, std::span<const uint32_t> shapes, Begin&& begin, Put&& put,
          End&& end) {
    std::array<uint32_t, 64> buffer;
    for (size_t from = 0; from < shapes.size(); from += buffer.size()) {
        const size_t n = std::min(buffer.size(), shapes.size() - from);
        std::copy_n(shapes.begin() + ptrdiff_t(from), n, buffer.begin());
        size_t left = n;
        while (left > 0) {
            Corners corners;
            begin();
            size_t kept = 0;
            uint32_t count = 0;
            for (size_t i = 0; i < left; ++i) {
                std::array<uint32_t, 3> corner;
                if (count < TrianglePatch::width && corners.add(set, buffer[i], corner))
                    put(buffer[i], corner, count++);
                else
                    buffer[kept++] = buffer[i];
            }
            left = kept;
            end(corners, count);
        }
    }
}

}  // namespace

uint32_t TrianglePatches::add(const TriangleSet& set, std::span<const uint32_t> shapes) {
    const uint32_t first = size();
    pack(
        set, shapes,
        [&] {
            patches_.push_back({});
            patches_.back().first_id = uint32_t(ids_.size());
        },
        [&](uint32_t shape, const std::array<uint32_t, 3>& corner, uint32_t i) {
            for (int k = 0; k < 3; ++k) patches_.back().corner[k][i] = uint8_t(corner[size_t(k)]);
            ids_.push_back(shape);
        },
        [&](const Corners& corners, uint32_t count) {
            TrianglePatch& patch = patches_.back();
            patch.count = count;
            // Spare lanes repeat the first, so that no arithmetic on them is slow or invalid.
            for (uint32_t i = 0; i < TrianglePatch::width; ++i)
                for (int a = 0; a < 3; ++a)
                    patch.v[a][i] = corners.at[i < corners.count ? i : 0][a];
        });
    return first;
}

uint32_t TrianglePatches::count_patches(const TriangleSet& set, std::span<const uint32_t> shapes) {
    uint32_t count = 0;
    pack(
        set, shapes, [] {}, [](uint32_t, const std::array<uint32_t, 3>&, uint32_t) {},
        [&](const Corners&, uint32_t) { ++count; });
    return count;
}

}  // namespace crofton
