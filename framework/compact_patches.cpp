#include "framework/compact_patches.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include "framework/parallel.h"

namespace crofton {
namespace {

/// What some consecutive patches become; vertices and ids are counted from its own first.
class CompactRun {
  public:
    std::vector<float> vertices;
    std::vector<uint32_t> ids;

    void add(const TrianglePatch& full, const uint32_t* list, CompactPatch& patch) {
        std::array<uint32_t, TrianglePatch::width> at;
        // Far enough back that all of this patch is within reach of a byte.
        const uint32_t end = size() + TrianglePatch::width;
        const uint32_t begin = end > reach ? end - reach : 0;
        for (uint32_t i = 0; i < at.size(); ++i)
            at[i] = vertex({full.v[0][i], full.v[1][i], full.v[2][i]}, begin);
        patch.base = *std::min_element(at.begin(), at.end());
        for (uint32_t i = 0; i < at.size(); ++i) patch.offset[i] = uint8_t(at[i] - patch.base);
        std::fill_n(patch.corner, CompactPatch::width, uint16_t(0));
        for (uint32_t i = 0; i < full.count; ++i)
            patch.corner[i] =
                uint16_t(full.corner[0][i] | full.corner[1][i] << 4 | full.corner[2][i] << 8);
        patch.corner[0] = uint16_t(patch.corner[0] | (full.count - 1) << 12);
        put_ids(full, list, patch);
    }

  private:
    static constexpr uint32_t reach = 256;
    using Point = std::array<float, 3>;

    uint32_t size() const { return uint32_t(vertices.size() / 3); }

    /// The vertex at p, one from `begin` on or a new one. Positions are the same if their bits are.
    uint32_t vertex(const Point& p, uint32_t begin) {
        std::array<uint32_t, 3> bits;
        std::memcpy(bits.data(), p.data(), sizeof bits);
        uint32_t hash = 0;
        for (const uint32_t x : bits) {
            hash = (hash ^ x) * 0x9e3779b1u;
            hash ^= hash >> 15;
        }
        // Two places; a new vertex takes that of the older.
        uint32_t* const slot = &latest_[hash % (latest_.size() / 2) * 2];
        for (int i = 0; i < 2; ++i)
            if (slot[i] > begin &&
                std::memcmp(&vertices[size_t{3} * (slot[i] - 1)], p.data(), sizeof p) == 0)
                return slot[i] - 1;
        vertices.insert(vertices.end(), p.begin(), p.end());
        uint32_t& oldest = slot[0] < slot[1] ? slot[0] : slot[1];
        oldest = size();
        return oldest - 1;
    }

    void put_ids(const TrianglePatch& full, const uint32_t* list, CompactPatch& patch) {
        std::array<uint32_t, TrianglePatch::width> id;
        for (uint32_t i = 0; i < full.count; ++i) id[i] = full.id(i, list);
        const auto [low, high] = std::minmax_element(id.begin(), id.begin() + full.count);
        if (full.count <= CompactPatch::own_ids && *high - *low <= 0xffff) {
            patch.first_id = *low;
            for (uint32_t i = 0; i < full.count; ++i)
                patch.corner[CompactPatch::own_ids + i] = uint16_t(id[i] - *low);
        } else {
            patch.corner[0] |= CompactPatch::list_bit;
            patch.first_id = uint32_t(ids.size());
            ids.insert(ids.end(), id.begin(), id.begin() + full.count);
        }
    }

    /// By hash of a position, vertices that were put there last, counted from 1.
    std::array<uint32_t, 2048> latest_{};
};

}  // namespace

CompactPatches::CompactPatches(const TrianglePatches& full) {
    // Runs of a fixed length, so that threads decide nothing; they share no vertices.
    constexpr size_t length = 4096;
    const size_t n = full.size(), runs = (n + length - 1) / length;
    patches_.resize(n);
    std::vector<CompactRun> run(runs);
    const auto patches_of = [&](size_t r, const auto& visit) {
        for (size_t i = r * length; i < std::min(n, (r + 1) * length); ++i) visit(i);
    };
    const auto for_each = [&](const auto& body) {
        parallel_for(runs, 1, [&](size_t begin, size_t end) {
            for (size_t r = begin; r < end; ++r) body(r);
        });
    };
    for_each([&](size_t r) {
        patches_of(r, [&](size_t i) { run[r].add(full.patches()[i], full.ids(), patches_[i]); });
    });
    struct Begin {
        size_t vertex = 0, id = 0;
    };
    std::vector<Begin> begin(runs + 1);
    for (size_t r = 0; r < runs; ++r)
        begin[r + 1] = {begin[r].vertex + run[r].vertices.size() / 3,
                        begin[r].id + run[r].ids.size()};
    vertices_.resize(begin[runs].vertex * 3 + 1);
    vertices_.back() = 0;
    ids_.resize(begin[runs].id);
    for_each([&](size_t r) {
        std::copy(run[r].vertices.begin(), run[r].vertices.end(),
                  vertices_.begin() + ptrdiff_t(begin[r].vertex * 3));
        std::copy(run[r].ids.begin(), run[r].ids.end(), ids_.begin() + ptrdiff_t(begin[r].id));
        patches_of(r, [&](size_t i) {
            CompactPatch& patch = patches_[i];
            patch.base += uint32_t(begin[r].vertex);
            if (patch.corner[0] & CompactPatch::list_bit) patch.first_id += uint32_t(begin[r].id);
        });
    });
}

}  // namespace crofton
