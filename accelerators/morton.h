#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>

#include "accelerators/box4.h"
#include "accelerators/quick_tree.h"
#include "framework/aligned.h"
#include "framework/parallel.h"

namespace crofton {

/// Things in the order of the Morton codes of their boxes' centres, those of one code by index.
class MortonKeys {
  public:
    /// @param box  of (i, Box4&): whether thing i exists, and then its box, finite. Those that do
    /// not are left
    ///             out. Called twice, from any thread
    template <class BoxOf>
    MortonKeys(size_t n, const BoxOf& box) : keys_(n) {
        set_bits(n);
        all_ = sum_chunks<Sum>(0, n, [&](size_t begin, size_t end) {
            Sum sum;
            Box4 b;
            for (size_t i = begin; i < end; ++i)
                if (box(i, b)) sum.add(b);
            return sum;
        });
        // One scale for all axes: cells are cubes.
        const Bounds3 centroids = all_.centroids.bounds();
        const float cells = float((1 << axis_bits_) - 1);
        const float extent = size() > 0 ? (centroids.upper - centroids.lower).maxCoeff() : 0.0f;
        float scale = cells / extent;
        if (!(extent > 0 && std::isfinite(extent) && std::isfinite(scale))) scale = 0;
        const D d;
        const auto factor = hn::Set(d, scale), last = hn::Set(d, cells);
        const auto lower = scale > 0 ? all_.centroids.lower : hn::Zero(d);
        parallel_for(n, 1 << 13, [&](size_t begin, size_t end) {
            Box4 b;
            for (size_t i = begin; i < end; ++i) {
                const bool exists = box(i, b);
                const auto x = hn::Mul(hn::Sub(b.centroid2(), lower), factor);
                keys_[i] = exists ? packed(hn::Min(hn::Max(x, hn::Zero(d)), last)) : none;
            }
            interleave(begin, {keys_.data() + begin, end - begin});
        });
        sort();
    }
    explicit MortonKeys(const BuildReferences& references)
        : MortonKeys(references.size(), [&](size_t i, Box4& b) {
              b = Box4(references[i]);
              return true;
          }) {}

    /// Of those that exist.
    size_t size() const { return all_.count; }
    /// Of all boxes.
    Bounds3 bounds() const { return all_.boxes.bounds(); }
    uint32_t index(size_t i) const { return uint32_t(keys_[i] & index_mask_); }
    /// Code and index: different for any two.
    uint64_t key(size_t i) const { return keys_[i]; }
    uint64_t code(size_t i) const { return keys_[i] >> index_bits_; }
    const uint64_t* data() const { return keys_.data(); }
    SortedKeys sorted() const { return {keys_.data(), size(), index_mask_, bounds()}; }

  private:
    using D = Box4::D;
    struct Sum {
        Box4 boxes, centroids;
        size_t count = 0;
        void add(const Box4& b) {
            boxes.extend(b);
            centroids.extend_point(b.centroid2());
            ++count;
        }
        void add(const Sum& o) {
            boxes.extend(o.boxes);
            centroids.extend(o.centroids);
            count += o.count;
        }
    };
    static constexpr uint64_t none = uint64_t{1} << 63;

    /// 63 bits for both: as many for the index as it needs, the others for the code.
    void set_bits(size_t n) {
        index_bits_ = n > 1 ? int(std::bit_width(n - 1)) : 1;
        index_mask_ = (uint64_t{1} << index_bits_) - 1;
        axis_bits_ = std::min(21, (63 - index_bits_) / 3);
    }
    /// The three coordinates side by side, to be interleaved.
    static uint64_t packed(Box4::V cell) {
        alignas(16) int32_t c[4];
        hn::Store(hn::ConvertTo(hn::RebindToSigned<D>(), cell), hn::RebindToSigned<D>(), c);
        return uint64_t(c[0]) | uint64_t(c[1]) << 21 | uint64_t(c[2]) << 42;
    }
    /// Makes keys of packed coordinates, which are those of indices from `first` on.
    void interleave(size_t first, std::span<uint64_t> keys) const;
    void sort();

    RawAlignedVector<uint64_t> keys_;
    Sum all_;
    int index_bits_ = 1, axis_bits_ = 21;
    uint64_t index_mask_ = 1;
};

}  // namespace crofton
