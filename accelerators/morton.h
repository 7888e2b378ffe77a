#pragma once

#include <cmath>
#include <cstdint>
#include <span>

#include "accelerators/box4.h"
#include "accelerators/morton_keys.h"
#include "framework/parallel.h"

namespace crofton {

/// Makes MortonKeys.
class MortonSorter {
  public:
    template <class BoxOf>
    static MortonKeys run(size_t n, const BoxOf& box) {
        MortonSorter sorter(n);
        sorter.make_keys(box);
        sorter.sort();
        return std::move(sorter.keys_);
    }

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

    explicit MortonSorter(size_t n) : keys_(n) {}

    template <class BoxOf>
    void make_keys(const BoxOf& box) {
        RawAlignedVector<uint64_t>& keys = keys_.keys_;
        const Sum all = sum_chunks<Sum>(0, keys.size(), [&](size_t begin, size_t end) {
            Sum sum;
            Box4 b;
            for (size_t i = begin; i < end; ++i)
                if (box(i, b)) sum.add(b);
            return sum;
        });
        keys_.size_ = all.count;
        keys_.bounds_ = all.boxes.bounds();
        // One scale for all axes: cells are cubes.
        const Bounds3 centroids = all.centroids.bounds();
        const float cells = float((1 << keys_.axis_bits_) - 1);
        const float extent = all.count > 0 ? (centroids.upper - centroids.lower).maxCoeff() : 0.0f;
        float scale = cells / extent;
        if (!(extent > 0 && std::isfinite(extent) && std::isfinite(scale))) scale = 0;
        const D d;
        const auto factor = hn::Set(d, scale), last = hn::Set(d, cells);
        const auto lower = scale > 0 ? all.centroids.lower : hn::Zero(d);
        parallel_for(keys.size(), 1 << 13, [&](size_t begin, size_t end) {
            Box4 b;
            for (size_t i = begin; i < end; ++i) {
                const bool exists = box(i, b);
                const auto x = hn::Mul(hn::Sub(b.centroid2(), lower), factor);
                keys[i] = exists ? packed(hn::Min(hn::Max(x, hn::Zero(d)), last)) : none;
            }
            interleave(begin, {keys.data() + begin, end - begin});
        });
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

    MortonKeys keys_;
};

/// @param box  of (i, Box4&): whether thing i exists, and then its box, finite; the others are left
///             out. Called twice, from any thread
template <class BoxOf>
MortonKeys morton_keys(size_t n, const BoxOf& box) {
    return MortonSorter::run(n, box);
}

inline MortonKeys morton_keys(const BuildReferences& references) {
    return morton_keys(references.size(), [&](size_t i, Box4& box) {
        box = Box4(references[i]);
        return true;
    });
}

}  // namespace crofton
