#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <span>

#include "accelerators/box4.h"

namespace crofton {

inline constexpr int max_bins = 64;

/// Bins for a node of n references.
inline int bins_for(size_t n, int bins) {
    return std::min({bins, max_bins, std::max(4, int(std::min<size_t>(n, max_bins)))});
}

/// Which bin a reference's centroid is in, on all axes at once.
class Binning {
  public:
    Binning(const Box4& centroids, int bins) : lower_(centroids.lower) {
        namespace hn = hwy::HWY_NAMESPACE;
        const auto extent = hn::Sub(centroids.upper, centroids.lower);
        const auto scale = hn::Div(hn::Set(d, float(bins) * 0.999999f), extent);
        const auto usable = hn::And(hn::Gt(extent, hn::Zero(d)),
                                    hn::Lt(scale, hn::Set(d, std::numeric_limits<float>::max())));
        scale_ = hn::IfThenElseZero(usable, scale);
        last_ = hn::Set(d, float(bins - 1));
        alignas(16) float s[4];
        hn::Store(scale_, d, s);
        for (int a = 0; a < 3; ++a) splits_[a] = s[a] > 0;
    }
    /// @param bin  room for 4, aligned to 16 bytes
    void of(const Box4& box, int32_t* bin) const {
        namespace hn = hwy::HWY_NAMESPACE;
        const hn::FixedTag<int32_t, 4> d32;
        auto x = hn::Mul(hn::Sub(box.centroid2(), lower_), scale_);
        x = hn::Min(hn::Max(x, hn::Zero(d)), last_);
        hn::Store(hn::ConvertTo(d32, x), d32, bin);
    }
    int of(const BuildReference& r, int axis) const {
        alignas(16) int32_t bin[4];
        of(Box4(r), bin);
        return bin[axis];
    }
    /// Whether there is more than one centroid on an axis.
    bool splits(int axis) const { return splits_[axis]; }

  private:
    static constexpr Box4::D d{};
    Box4::V lower_, scale_, last_;
    bool splits_[3];
};

struct Bin {
    Box4 box;
    uint32_t count = 0;
    double cost = 0;

    void add(const Box4& b, double c) {
        box.extend(b);
        ++count;
        cost += c;
    }
    void add(const Bin& b) {
        box.extend(b.box);
        count += b.count;
        cost += b.cost;
    }
};

/// A node's references by the bins of their centroids on each axis.
struct BinTable {
    std::array<std::array<Bin, max_bins>, 3> axis;
    int bins = 0;

    BinTable(std::span<const BuildReference> references, const Binning& binning, int n) : bins(n) {
        for (auto& a : axis) std::fill_n(a.begin(), n, Bin());
        for (const BuildReference& r : references) {
            const Box4 box(r);
            alignas(16) int32_t bin[4];
            binning.of(box, bin);
            for (size_t a = 0; a < 3; ++a) axis[a][size_t(bin[a])].add(box, r.cost);
        }
    }
    BinTable() {}
    void add(const BinTable& t) {
        for (size_t a = 0; a < 3; ++a)
            for (size_t b = 0; b < size_t(bins); ++b) axis[a][b].add(t.axis[a][b]);
    }
};

/// A plane between bins.
struct ObjectSplit {
    double cost = std::numeric_limits<double>::infinity();  ///< of the node, in nominal ns
    int axis = -1;                                          ///< -1: none found
    int bin = 0;                                            ///< references in bins < bin go left
};

/// Improves `best` by the planes of one axis.
/// @param area  half area of the node
inline void sweep_bins(const std::array<Bin, max_bins>& bins, int n, int axis, double area,
                       const TreeCosts& costs, ObjectSplit& best) {
    std::array<double, max_bins> right_cost;
    Bin right;
    for (size_t b = size_t(n) - 1; b > 0; --b) {
        right.add(bins[b]);
        right_cost[b] =
            right.count ? right.box.half_area() * costs.leaf(right.cost, right.count) : -1;
    }
    Bin left;
    for (size_t b = 1; b < size_t(n); ++b) {
        left.add(bins[b - 1]);
        if (left.count == 0 || right_cost[b] < 0) continue;
        const double children =
            left.box.half_area() * costs.leaf(left.cost, left.count) + right_cost[b];
        // A flat box of no area is met by no line: any split of it is as good.
        const double cost = costs.node + (area > 0 ? children / area : 0.0);
        if (cost < best.cost) best = {cost, axis, int(b)};
    }
}

/// The best plane between bins of centroids on any axis.
inline ObjectSplit find_object_split(std::span<const BuildReference> references,
                                     const ReferenceBounds& range, const Binning& binning, int bins,
                                     const TreeCosts& costs) {
    const BinTable table =
        sum_chunks<BinTable>(0, references.size(), [&](size_t begin, size_t end) {
            return BinTable(references.subspan(begin, end - begin), binning, bins);
        });
    ObjectSplit best;
    const double area = range.boxes.half_area();
    for (int a = 0; a < 3; ++a)
        if (binning.splits(a)) sweep_bins(table.axis[size_t(a)], bins, a, area, costs, best);
    return best;
}

inline ReferenceBounds bounds_of(std::span<const BuildReference> references) {
    return sum_chunks<ReferenceBounds>(0, references.size(), [&](size_t begin, size_t end) {
        ReferenceBounds sum;
        for (size_t i = begin; i < end; ++i) sum.add(references[i]);
        return sum;
    });
}

/// Puts the lower half by count, on the axis where centroids spread most, first.
/// @return how many these are
inline size_t halve_references(std::span<BuildReference> references, const ReferenceBounds& range) {
    const Bounds3 centroids = range.centroids.bounds();
    int axis;
    (centroids.upper - centroids.lower).maxCoeff(&axis);
    const size_t middle = references.size() / 2;
    std::nth_element(references.begin(), references.begin() + ptrdiff_t(middle), references.end(),
                     [axis](const BuildReference& a, const BuildReference& b) {
                         const float ca = a.bounds.lower[axis] + a.bounds.upper[axis];
                         const float cb = b.bounds.lower[axis] + b.bounds.upper[axis];
                         return ca != cb ? ca < cb : a.shape < b.shape;
                     });
    return middle;
}

}  // namespace crofton
