// What builders that look for planes between bins of centroids have in common; included once per
// target.
#if defined(CROFTON_ACCELERATORS_OBJECT_SPLIT_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_OBJECT_SPLIT_H_
#undef CROFTON_ACCELERATORS_OBJECT_SPLIT_H_
#else
#define CROFTON_ACCELERATORS_OBJECT_SPLIT_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>

#include "accelerators/binary_tree.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int max_bins = 64;

/// Bins for a node of n references: where there are few, few planes between them differ.
inline int bins_for(size_t n, int bins) {
    return std::min({bins, max_bins, int(4 + std::min<size_t>(n / 8, max_bins))});
}

/// A box between loops, as Box8 has it in registers: the lower corner, and the upper one negated.
/// Empty at first.
struct StoredBox {
    alignas(32) float v[8];
    StoredBox() { std::fill_n(v, 8, std::numeric_limits<float>::infinity()); }
    void extend(const StoredBox& b) {
        for (int i = 0; i < 8; ++i) v[i] = std::min(v[i], b.v[i]);
    }
    Bounds3 bounds() const { return {{v[0], v[1], v[2]}, {-v[4], -v[5], -v[6]}}; }
    double half_area() const { return crofton::half_area(bounds()); }
};

/// The three axes; as a denormal number the fourth lane would be slow.
HWY_INLINE hn::Vec<hn::FixedTag<float, 4>> first_three_lanes(hn::Vec<hn::FixedTag<float, 4>> v) {
    return hn::IfThenElseZero(hn::FirstN(hn::FixedTag<float, 4>(), 3), v);
}

/// A box in registers, one of eight lanes or two of four: the lower corner, and the upper one
/// negated, so that one minimum extends both. The fourth lanes mean nothing.
class Box8 {
  public:
    using D = hn::CappedTag<float, 8>;
    using D4 = hn::FixedTag<float, 4>;
    using V4 = hn::Vec<D4>;

    HWY_INLINE Box8() {
        for (auto& v : v_) v = hn::Inf(D());
    }
    explicit HWY_INLINE Box8(const StoredBox& b) : Box8(b.v) {}
    /// @param v  eight floats, on 32 bytes
    explicit HWY_INLINE Box8(const float* v) {
        for (size_t i = 0; i < parts; ++i) v_[i] = hn::Load(D(), v + i * lanes);
    }
    explicit HWY_INLINE Box8(V4 point) : Box8(point, hn::Neg(point)) {}
    HWY_INLINE void store(float* v) const {
        for (size_t i = 0; i < parts; ++i) hn::Store(v_[i], D(), v + i * lanes);
    }
    HWY_INLINE StoredBox stored() const {
        StoredBox b;
        store(b.v);
        return b;
    }

    HWY_INLINE void extend(const Box8& b) {
        for (size_t i = 0; i < parts; ++i) v_[i] = hn::Min(v_[i], b.v_[i]);
    }
    /// What is left of it in another.
    HWY_INLINE void limit(const Box8& b) {
        for (size_t i = 0; i < parts; ++i) v_[i] = hn::Max(v_[i], b.v_[i]);
    }
    HWY_INLINE V4 lower() const {
#if HWY_CAP_GE256
        return hn::LowerHalf(D4(), v_[0]);
#else
        return v_[0];
#endif
    }
    HWY_INLINE V4 negated_upper() const {
#if HWY_CAP_GE256
        return hn::UpperHalf(D4(), v_[0]);
#else
        return v_[1];
#endif
    }
    HWY_INLINE V4 upper() const { return hn::Neg(negated_upper()); }
    HWY_INLINE V4 extent() const { return hn::Neg(negated_extent()); }
    HWY_INLINE V4 negated_extent() const { return hn::Add(lower(), negated_upper()); }
    /// Twice the centre.
    HWY_INLINE V4 centroid2() const { return hn::Sub(lower(), negated_upper()); }
    /// Not empty on any of the three axes.
    HWY_INLINE bool valid() const {
        const auto none = hn::Gt(first_three_lanes(negated_extent()), hn::Zero(D4()));
        return hn::AllFalse(D4(), none);
    }
    /// a where `mask`, else b. @param mask  of whole boxes
    static HWY_INLINE Box8 either(hn::Mask<D> mask, const Box8& a, const Box8& b) {
        Box8 r;
        for (size_t i = 0; i < parts; ++i) r.v_[i] = hn::IfThenElse(mask, a.v_[i], b.v_[i]);
        return r;
    }

  private:
    friend class StoredReference;
    static constexpr size_t lanes = hn::MaxLanes(D()), parts = 8 / lanes;
    HWY_INLINE Box8(V4 lower, V4 negated_upper) {
#if HWY_CAP_GE256
        v_[0] = hn::Combine(D(), negated_upper, lower);
#else
        v_[0] = lower;
        v_[1] = negated_upper;
#endif
    }

    hn::Vec<D> v_[parts];
};

/// A reference in registers, loaded as it is stored: a load across two stores waits for both.
class StoredReference {
  public:
    explicit HWY_INLINE StoredReference(const BuildReference& r) {
        for (size_t i = 0; i < Box8::parts; ++i)
            v_[i] = hn::LoadU(D(), r.bounds.lower.data() + i * Box8::lanes);
    }
    HWY_INLINE void store(BuildReference& r) const {
        for (size_t i = 0; i < Box8::parts; ++i)
            hn::StoreU(v_[i], D(), r.bounds.lower.data() + i * Box8::lanes);
    }
    HWY_INLINE Box8 box() const {
#if HWY_CAP_GE256
        alignas(32) static constexpr int32_t place[8] = {0, 1, 2, 0, 3, 4, 5, 3};
        alignas(32) static constexpr float sign[8] = {0, 0, 0, 0, -0.0f, -0.0f, -0.0f, -0.0f};
        Box8 b;
        b.v_[0] = hn::Xor(hn::TableLookupLanes(v_[0], hn::SetTableIndices(D(), place)),
                          hn::Load(D(), sign));
        return b;
#else
        return {v_[0], hn::Neg(hn::CombineShiftRightBytes<12>(D(), v_[1], v_[0]))};
#endif
    }

  private:
    using D = Box8::D;
    hn::Vec<D> v_[Box8::parts];
};

/// Bounds of references and of their centroids (doubled).
struct ReferenceBounds {
    StoredBox boxes, centroids;

    ReferenceBounds() = default;
    explicit ReferenceBounds(std::span<const BuildReference> references) {
        Box8 all, centres;
        for (const BuildReference& r : references) {
            const Box8 box = StoredReference(r).box();
            all.extend(box);
            centres.extend(Box8(box.centroid2()));
        }
        boxes = all.stored();
        centroids = centres.stored();
    }
    void add(const ReferenceBounds& o) {
        boxes.extend(o.boxes);
        centroids.extend(o.centroids);
    }
};

/// Which bin a reference's centroid is in, on all axes at once.
class Binning {
  public:
    HWY_INLINE Binning(const StoredBox& stored, int bins) {
        const Box8 centroids(stored);
        lower_ = centroids.lower();
        const auto extent = first_three_lanes(centroids.extent());
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
    HWY_INLINE void of(const Box8& box, int32_t* bin) const {
        const hn::FixedTag<int32_t, 4> d32;
        const auto x = hn::Floor(hn::Min(hn::Max(place(box), hn::Zero(d)), last_));
        // Added to 2^23, whole numbers are in the lowest bits.
        const auto bits = hn::BitCast(d32, hn::Add(x, hn::Set(d, 0x1p23f)));
        hn::Store(hn::And(bits, hn::Set(d32, 255)), d32, bin);
    }
    /// In units of bins, not yet limited to them.
    HWY_INLINE Box8::V4 place(const Box8& box) const {
        return hn::Mul(first_three_lanes(hn::Sub(box.centroid2(), lower_)), scale_);
    }
    /// Whether there is more than one centroid on an axis.
    bool splits(int axis) const { return splits_[axis]; }

  private:
    static constexpr Box8::D4 d{};
    Box8::V4 lower_, scale_, last_;
    bool splits_[3];
};

/// A node's references by the bins of their centroids on each axis. Not initialised beyond `bins`.
struct BinTable {
    struct Bin {
        alignas(32) float v[8];
        HWY_INLINE Box8 box() const { return Box8(v); }
        HWY_INLINE void extend(const Box8& b) {
            Box8 sum(v);
            sum.extend(b);
            sum.store(v);
        }
    };
    Bin bin[max_bins][4];                     // [bin][axis]
    alignas(16) uint32_t count[max_bins][4];  // likewise
    alignas(16) float cost[max_bins][4];      // likewise, where references weigh differently
    int bins;
    bool weighted;

    BinTable(std::span<const BuildReference> references, const Binning& binning, int n,
             bool by_cost) {
        clear(n, by_cost);
        // Neighbours are mostly in one bin, and each waits until the one before is stored there: so
        // they take turns with two tables.
        constexpr size_t many = 128;
        if (references.size() < many) {
            fill(references, binning, *this);
            return;
        }
        BinTable other;
        other.clear(n, by_cost);
        fill(references, binning, other);
        add(other);
    }
    BinTable() {}
    void add(const BinTable& t) {
        for (int b = 0; b < bins; ++b)
            for (int a = 0; a < 3; ++a) {
                bin[b][a].extend(t.bin[b][a].box());
                count[b][a] += t.count[b][a];
                if (weighted) cost[b][a] += t.cost[b][a];
            }
    }

  private:
    void clear(int n, bool by_cost) {
        bins = n;
        weighted = by_cost;
        const Box8 none;
        for (int b = 0; b < n; ++b) {
            for (int a = 0; a < 3; ++a) none.store(bin[b][a].v);
            std::fill_n(count[b], 4, 0u);
            if (weighted) std::fill_n(cost[b], 4, 0.0f);
        }
    }
    /// Every other reference into another table.
    void fill(std::span<const BuildReference> references, const Binning& binning, BinTable& other) {
        const auto put = [&](auto by_cost, const BuildReference& r, BinTable& table) HWY_ATTR {
            const Box8 box = StoredReference(r).box();
            alignas(16) int32_t place[4];
            binning.of(box, place);
            for (int a = 0; a < 3; ++a) {
                table.bin[place[a]][a].extend(box);
                ++table.count[place[a]][a];
                if constexpr (by_cost.value) table.cost[place[a]][a] += r.cost;
            }
        };
        const auto put_all = [&](auto by_cost) HWY_ATTR {
            const size_t n = references.size();
            for (size_t i = 0; i + 1 < n; i += 2) {
                put(by_cost, references[i], *this);
                put(by_cost, references[i + 1], other);
            }
            if (n & 1) put(by_cost, references[n - 1], *this);
        };
        if (weighted)
            put_all(std::true_type());
        else
            put_all(std::false_type());
    }
};

/// Half areas of three boxes, in units in which a node's largest extent is about 1: no product of
/// extents overflows.
class ScaledAreas {
  public:
    using V = Box8::V4;
    explicit HWY_INLINE ScaledAreas(const StoredBox& node) {
        const float extent = node.bounds().extent().maxCoeff();
        const bool sane = extent > 0 && std::isfinite(extent);
        const int e = sane ? std::clamp(-std::ilogb(extent), -120, 120) : 0;
        scale_ = hn::Set(Box8::D4(), std::ldexp(1.0f, e));
    }
    /// Lanes 0 to 2; lane 3 is 0.
    HWY_INLINE V of(const Box8& a, const Box8& b, const Box8& c) const {
        const Box8::D4 d;
        // Two factors of each product are negated.
        const V ea = a.negated_extent(), eb = b.negated_extent(),
                ec = first_three_lanes(c.negated_extent());
        const V low = hn::InterleaveLower(d, ea, eb), high = hn::InterleaveUpper(d, ea, eb);
        const V x = hn::Mul(first_three_lanes(hn::ConcatLowerLower(d, ec, low)), scale_);
        const V y =
            hn::Mul(first_three_lanes(hn::ConcatLowerUpper(d, hn::Shuffle0321(ec), low)), scale_);
        const V z = hn::Mul(hn::ConcatUpperLower(d, ec, high), scale_);
        return hn::Add(hn::Add(hn::Mul(x, y), hn::Mul(y, z)), hn::Mul(z, x));
    }
    HWY_INLINE float of(const Box8& a) const { return hn::GetLane(of(a, a, a)); }

  private:
    V scale_;
};

/// A plane between bins.
struct ObjectSplit {
    double cost = std::numeric_limits<double>::infinity();  ///< of the node, in nominal ns
    int axis = -1;                                          ///< -1: none found
    int bin = 0;                                            ///< references in bins < bin go left
    StoredBox side[2];                                      ///< boxes of the children
};

/// Bins or slabs of all axes: what is left of a plane, and what is right of it, may be counted in
/// different ones.
struct BinRows {
    using Counts = const uint32_t (*)[4];
    using Costs = const float (*)[4];
    const BinTable::Bin (*bin)[4];
    Counts left_count, right_count;
    Costs left_cost, right_cost;
    int bins;
};

/// The best of all planes between bins.
class BinSweep {
  public:
    BinSweep(const BinRows& rows, const TreeCosts& costs)
        : rows_(rows),
          weighted_(costs.leaf_width == 1),
          width_(hn::Set(d, float(costs.leaf_width))),
          block_(hn::Set(d, float(costs.leaf_block))),
          shape_(hn::Set(d, float(costs.leaf_shape))) {}

    /// @param node    box of all references
    /// @param usable  axes
    ObjectSplit best(const StoredBox& node, const bool (&usable)[3], const TreeCosts& costs) const {
        const ScaledAreas areas(node);
        const int n = rows_.bins;
        alignas(16) float right_cost[max_bins][4];
        Side right;
        for (int b = n - 1; b > 0; --b) {
            add(right, b, rows_.right_count, rows_.right_cost);
            hn::Store(cost(right, areas), d, right_cost[b]);
        }
        Side left;
        V least = hn::Inf(d), where = hn::Zero(d);
        for (int b = 1; b < n; ++b) {
            add(left, b - 1, rows_.left_count, rows_.left_cost);
            const V sum = hn::Add(cost(left, areas), hn::Load(d, right_cost[b]));
            const auto better = hn::Lt(sum, least);
            least = hn::IfThenElse(better, sum, least);
            where = hn::IfThenElse(better, hn::Set(d, float(b)), where);
        }
        alignas(16) float sums[4], bins[4];
        hn::Store(least, d, sums);
        hn::Store(where, d, bins);
        ObjectSplit split;
        float sum = std::numeric_limits<float>::infinity();
        for (int a = 0; a < 3; ++a)
            if (usable[a] && sums[a] < sum) sum = sums[a], split.axis = a, split.bin = int(bins[a]);
        if (split.axis < 0) return split;
        // A flat box of no area is met by no line: any split of it is as good.
        const float area = areas.of(Box8(node));
        split.cost = costs.node + (area > 0 ? double(sum) / double(area) : 0.0);
        split.side[0] = union_of(0, split.bin, split.axis);
        split.side[1] = union_of(split.bin, n, split.axis);
        return split;
    }

  private:
    using V = Box8::V4;
    static constexpr Box8::D4 d{};
    static constexpr hn::FixedTag<int32_t, 4> d32{};
    struct Side {
        Box8 box[3];
        hn::Vec<hn::FixedTag<int32_t, 4>> count;
        V cost;
        HWY_INLINE Side() : count(hn::Zero(d32)), cost(hn::Zero(d)) {}
    };
    HWY_INLINE StoredBox union_of(int from, int to, int axis) const {
        Box8 box;
        for (int b = from; b < to; ++b) box.extend(rows_.bin[b][axis].box());
        return box.stored();
    }
    HWY_INLINE void add(Side& side, int b, BinRows::Counts count, BinRows::Costs cost) const {
        for (int a = 0; a < 3; ++a) side.box[a].extend(rows_.bin[b][a].box());
        side.count = hn::Add(side.count, hn::Load(d32, reinterpret_cast<const int32_t*>(count[b])));
        if (weighted_) side.cost = hn::Add(side.cost, hn::Load(d, cost[b]));
    }
    /// Times area; infinite for none.
    HWY_INLINE V cost(const Side& side, const ScaledAreas& areas) const {
        const V count = hn::ConvertTo(d, side.count);
        const V leaf = weighted_ ? side.cost
                                 : hn::Add(hn::Mul(block_, hn::Ceil(hn::Div(count, width_))),
                                           hn::Mul(shape_, count));
        const V area = areas.of(side.box[0], side.box[1], side.box[2]);
        return hn::IfThenElse(hn::Gt(count, hn::Zero(d)), hn::Mul(area, leaf), hn::Inf(d));
    }

    BinRows rows_;
    bool weighted_;
    V width_, block_, shape_;
};

/// The best plane between bins of centroids on any axis.
inline ObjectSplit find_object_split(std::span<const BuildReference> references,
                                     const ReferenceBounds& range, const Binning& binning, int bins,
                                     const TreeCosts& costs) {
    const BinTable table =
        sum_chunks<BinTable>(0, references.size(), [&](size_t begin, size_t end) {
            return BinTable(references.subspan(begin, end - begin), binning, bins,
                            costs.leaf_width == 1);
        });
    const BinRows rows{table.bin, table.count, table.count, table.cost, table.cost, bins};
    const bool usable[3] = {binning.splits(0), binning.splits(1), binning.splits(2)};
    return BinSweep(rows, costs).best(range.boxes, usable, costs);
}

inline ReferenceBounds bounds_of(std::span<const BuildReference> references) {
    return sum_chunks<ReferenceBounds>(0, references.size(), [&](size_t begin, size_t end) {
        return ReferenceBounds(references.subspan(begin, end - begin));
    });
}

/// What a division of references has made: the first `left` go left.
struct Halves {
    size_t left = 0;
    ReferenceBounds side[2];
};

/// Divides references at a plane between bins, without a branch: its outcome could not be guessed.
/// Bounds only of the centroids.
inline Halves divide_chunk(std::span<BuildReference> references, const Binning& binning,
                           const ObjectSplit& split) {
    const Box8::D4 d;
    const Box8::D d8;
    const hn::RebindToSigned<Box8::D> d32;
    alignas(16) float bounds[4];
    std::fill_n(bounds, 4, std::numeric_limits<float>::infinity());
    bounds[split.axis] = float(split.bin);
    const auto bound = hn::Load(d, bounds);
    Box8 left, right;
    const Box8 none;
    size_t n = 0;
    for (BuildReference& r : references) {
        const StoredReference stored(r);
        const Box8 box = stored.box();
        const Box8 c(box.centroid2());
        const bool goes_right = !hn::AllFalse(d, hn::Ge(binning.place(box), bound));
        const auto mask = hn::MaskFromVec(hn::BitCast(d8, hn::Set(d32, -int32_t(goes_right))));
        left.extend(Box8::either(mask, none, c));
        right.extend(Box8::either(mask, c, none));
        StoredReference(references[n]).store(r);
        stored.store(references[n]);
        n += !goes_right;
    }
    Halves halves;
    halves.left = n;
    halves.side[0].centroids = left.stored();
    halves.side[1].centroids = right.stored();
    return halves;
}

/// Swaps what chunks have on the wrong side of all that goes left.
inline void join_chunks(std::span<BuildReference> references, std::span<const Halves> chunks,
                        size_t size, size_t left) {
    const size_t n = references.size();
    // Of each chunk the right ones in front of `left`, and the left ones behind it.
    struct Run {
        size_t begin, end;
    };
    std::vector<Run> front, back;
    for (size_t c = 0; c < chunks.size(); ++c) {
        const size_t begin = std::min(n, c * size), end = std::min(n, begin + size);
        const size_t middle = begin + chunks[c].left;
        if (middle < std::min(end, left)) front.push_back({middle, std::min(end, left)});
        if (std::max(begin, left) < middle) back.push_back({std::max(begin, left), middle});
    }
    auto from = back.begin();
    for (Run to : front)
        while (to.begin < to.end) {
            const size_t k = std::min(to.end - to.begin, from->end - from->begin);
            const auto at = references.begin() + ptrdiff_t(to.begin);
            std::swap_ranges(at, at + ptrdiff_t(k), references.begin() + ptrdiff_t(from->begin));
            to.begin += k;
            from->begin += k;
            if (from->begin == from->end) ++from;
        }
}

/// Reorders references so that those left of a split come first; in chunks that do not depend on
/// the number of threads.
inline Halves divide(std::span<BuildReference> references, const Binning& binning,
                     const ObjectSplit& split) {
    const size_t n = references.size(), size = chunk_size(n), chunks = (n + size - 1) / size;
    std::vector<Halves> parts;
    Halves whole;
    if (chunks <= 1) {
        whole = divide_chunk(references, binning, split);
    } else {
        parts.resize(chunks);
        parallel_for(chunks, 1, [&](size_t from, size_t to) {
            for (size_t c = from; c < to; ++c)
                parts[c] = divide_chunk(references.subspan(c * size, std::min(size, n - c * size)),
                                        binning, split);
        });
        for (const Halves& p : parts) {
            whole.left += p.left;
            for (int s = 0; s < 2; ++s) whole.side[s].centroids.extend(p.side[s].centroids);
        }
        join_chunks(references, parts, size, whole.left);
    }
    for (int s = 0; s < 2; ++s) whole.side[s].boxes = split.side[s];
    return whole;
}

/// Puts the lower half by count, on the axis where centroids spread most, first.
inline Halves halve_references(std::span<BuildReference> references, const ReferenceBounds& range) {
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
    return {middle, {bounds_of(references.first(middle)), bounds_of(references.subspan(middle))}};
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
