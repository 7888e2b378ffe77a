#include "accelerators/tree_build.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/tree_split.cpp"
#include <hwy/foreach_target.h>

#include <hwy/cache_control.h>

#include "accelerators/object_split.h"
#include "framework/triangle_set.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 2048;  // fewer references are not worth a task
constexpr size_t least_split = 8;       // fewer references are not cut
constexpr int max_slabs = max_bins;
constexpr double least_overlap = 0.4;  // share of a node, but no more than
constexpr double large_overlap = 100;  // times split_overlap of the root

/// A plane that cuts a node's box.
struct SpatialSplit {
    double cost = std::numeric_limits<double>::infinity();
    int axis = -1;
    float position = 0;
};

/// Equal slabs of a node's box on each axis.
class Slabs {
  public:
    HWY_INLINE Slabs(const StoredBox& box, int n) : count_(n), lower_(Box8(box).lower()) {
        const Bounds3 b = box.bounds();
        alignas(16) float scale[4] = {};
        for (int a = 0; a < 3; ++a) {
            const float extent = b.upper[a] - b.lower[a], s = float(n) / extent;
            usable_[a] = extent > 0 && std::isfinite(s) && std::isfinite(extent);
            if (!usable_[a]) continue;
            scale[a] = s;
            for (int k = 0; k < n; ++k) plane_[a][k] = b.lower[a] + extent * (float(k) / float(n));
        }
        scale_ = hn::Load(Box8::D4(), scale);
    }
    int count() const { return count_; }
    const bool (&usable() const)[3] { return usable_; }
    /// The lower one of slab k.
    float plane(int axis, int k) const { return plane_[axis][k]; }
    /// The slabs that a box lies in. What ends in a plane is below it.
    HWY_INLINE void of(const Box8& box, int32_t* first, int32_t* last) const {
        const Box8::D4 d;
        const hn::RebindToSigned<Box8::D4> d32;
        const auto most = hn::Set(d, float(count_ - 1));
        const auto at = [&](Box8::V4 x) HWY_ATTR {
            return hn::Mul(first_three_lanes(hn::Sub(x, lower_)), scale_);
        };
        const auto low = hn::Min(hn::Max(hn::Floor(at(box.lower())), hn::Zero(d)), most);
        const auto high =
            hn::Min(hn::Max(hn::Sub(hn::Ceil(at(box.upper())), hn::Set(d, 1)), low), most);
        hn::Store(hn::ConvertTo(d32, low), d32, first);
        hn::Store(hn::ConvertTo(d32, high), d32, last);
    }

  private:
    int count_;
    Box8::V4 lower_, scale_;
    bool usable_[3];
    float plane_[3][max_slabs];
};

/// Boxes of what lies in each slab, and how many references begin and end there. Not initialised
/// beyond `slabs`.
struct SlabTable {
    BinTable::Bin bin[max_slabs][4];
    alignas(16) uint32_t enter[max_slabs][4], leave[max_slabs][4];
    alignas(16) float enter_cost[max_slabs][4], leave_cost[max_slabs][4];
    int slabs;

    SlabTable() {}
    explicit SlabTable(int n) : slabs(n) {
        const Box8 none;
        for (int s = 0; s < n; ++s)
            for (int a = 0; a < 4; ++a) {
                none.store(bin[s][a].v);
                enter[s][a] = leave[s][a] = 0;
                enter_cost[s][a] = leave_cost[s][a] = 0;
            }
    }
    void add(const SlabTable& t) {
        for (int s = 0; s < slabs; ++s)
            for (int a = 0; a < 3; ++a) {
                bin[s][a].extend(t.bin[s][a].box());
                enter[s][a] += t.enter[s][a], leave[s][a] += t.leave[s][a];
                enter_cost[s][a] += t.enter_cost[s][a], leave_cost[s][a] += t.leave_cost[s][a];
            }
    }
};

struct Side {
    Bounds3 box;
    uint32_t count = 0;
    double cost = 0;
    void add(const BuildReference& r) {
        box.extend(r.bounds);
        ++count;
        cost += r.cost;
    }
};

class SplitBuilder {
  public:
    SplitBuilder(BuildReferences references, const ShapeClipper& clipper, const TreeParameters& p,
                 const TreeCosts& costs)
        : refs_(std::move(references)),
          clip_(clipper.clip),
          triangles_(clipper.triangles),
          costs_(costs),
          bins_(p.bins),
          overlap_(p.split_overlap) {
        n_ = refs_.size();
        refs_.resize(std::max(n_, size_t(double(n_) * p.reference_budget)));
    }

    BinaryTree build() {
        BinaryTree tree;
        tree.nodes.resize(2 * refs_.size() - 1);
        nodes_ = tree.nodes.data();
        build_range({0, n_, refs_.size()}, 0, 0);
        tree.order.resize(refs_.size());
        for (size_t i = 0; i < refs_.size(); ++i) tree.order[i] = refs_[i].shape;
        return tree;
    }

  private:
    /// References [begin, end), with room for more up to `limit`.
    struct Range {
        size_t begin, end, limit;
        size_t size() const { return end - begin; }
        size_t room() const { return limit - end; }
    };
    std::span<BuildReference> references(const Range& r) {
        return {refs_.data() + r.begin, r.size()};
    }

    /// A subtree with room for n references uses at most 2n - 1 nodes from `node` on: a fixed
    /// place, whichever thread builds it.
    void build_range(Range range, size_t node, int depth) {
        const ReferenceBounds bounds = bounds_of(references(range));
        nodes_[node].bounds = bounds.boxes.bounds();
        if (range.size() == 1) {
            nodes_[node].make_leaf(range.begin, 1);
            // A part has the slack of its triangle.
            if (triangles_)
                nodes_[node].bounds =
                    grown(nodes_[node].bounds, triangles_->slack(refs_[range.begin].shape));
            return;
        }
        if (node == 0) root_area_ = bounds.boxes.half_area();
        const size_t n_left = partition(range, bounds, nodes_[node].bounds, depth);
        const size_t n_right = range.size() - n_left;
        // Room is shared out by size; the right part moves up to leave the left its share.
        const size_t share = range.room() * n_left / range.size();
        const size_t middle = range.begin + n_left, right_begin = middle + share;
        std::copy_backward(refs_.begin() + ptrdiff_t(middle), refs_.begin() + ptrdiff_t(range.end),
                           refs_.begin() + ptrdiff_t(range.end + share));
        const size_t left = node + 1, right = node + 2 * (n_left + share);
        nodes_[node].make_inner(left, right);
        const auto build_left = [&] {
            build_range({range.begin, middle, right_begin}, left, depth + 1);
        };
        const auto build_right = [&] {
            build_range({right_begin, right_begin + n_right, range.limit}, right, depth + 1);
        };
        if (range.size() >= parallel_size) {
            parallel_invoke(build_left, build_right);
        } else {
            build_left();
            build_right();
        }
        nodes_[node].bounds = merge(nodes_[left].bounds, nodes_[right].bounds);
    }

    /// Reorders the range so that the left child's references come first; may add some.
    /// @return how many go left: not 0, and not all
    size_t partition(Range& range, const ReferenceBounds& bounds, const Bounds3& box, int depth) {
        const std::span<BuildReference> all = references(range);
        if (all.size() == 2) return 1;
        if (depth >= median_depth) return halve_references(all, bounds).left;
        const int bins = bins_for(all.size(), bins_);
        const Binning binning(bounds.centroids, bins);
        const ObjectSplit split = find_object_split(all, bounds, binning, bins, costs_);
        if (all.size() >= least_split && range.room() > 0 &&
            (split.axis < 0 || overlaps(split, half_area(box)))) {
            const SpatialSplit spatial = find_spatial_split(all, bounds.boxes);
            if (spatial.cost < split.cost)
                if (const size_t n = cut(range, spatial)) return n;
        }
        if (split.axis < 0) return halve_references(all, bounds).left;
        return divide(all, binning, split).left;
    }

    /// Whether the children of a split overlap by so much that a plane that cuts shapes may be
    /// better: more than the given share of the root, and of their parent unless that is large.
    bool overlaps(const ObjectSplit& split, double area) const {
        const double least =
            std::max(overlap_ * root_area_,
                     std::min(least_overlap * area, large_overlap * overlap_ * root_area_));
        return half_area(intersection(split.side[0].bounds(), split.side[1].bounds())) > least;
    }

    SpatialSplit find_spatial_split(std::span<const BuildReference> all,
                                    const StoredBox& box) const {
        const Slabs slabs(box, int(std::clamp<size_t>(all.size(), std::min(8, bins_), bins_)));
        const SlabTable table = sum_chunks<SlabTable>(0, all.size(), [&](size_t from, size_t to) {
            SlabTable sum(slabs.count());
            for (size_t i = from; i < to; ++i) {
                if (triangles_) prefetch(all.first(to), i);
                chop(all[i], slabs, sum);
            }
            return sum;
        });
        const BinRows rows{table.bin,        table.enter,      table.leave,
                           table.enter_cost, table.leave_cost, slabs.count()};
        const ObjectSplit best = BinSweep(rows, costs_).best(box, slabs.usable(), costs_);
        if (best.axis < 0) return {};
        return {best.cost, best.axis, slabs.plane(best.axis, best.bin)};
    }

    /// Fetches the corners of a reference that comes soon, and the indices of a later one: shapes
    /// lie anywhere in memory.
    void prefetch(std::span<const BuildReference> all, size_t i) const {
        constexpr size_t ahead = 4;
        if (i + 2 * ahead < all.size())
            hwy::Prefetch(triangles_->triangles() + all[i + 2 * ahead].shape);
        if (i + ahead < all.size())
            for (int k = 0; k < 3; ++k) hwy::Prefetch(&triangles_->vertex(all[i + ahead].shape, k));
    }

    /// Adds a reference's parts to the slabs that they lie in.
    void chop(const BuildReference& r, const Slabs& slabs, SlabTable& table) const {
        const Box8 whole = StoredReference(r).box();
        alignas(16) int32_t first[4], last[4];
        slabs.of(whole, first, last);
        for (int a = 0; a < 3; ++a) {
            if (!slabs.usable()[a]) continue;
            ++table.enter[first[a]][a], table.enter_cost[first[a]][a] += r.cost;
            ++table.leave[last[a]][a], table.leave_cost[last[a]][a] += r.cost;
            if (first[a] == last[a])
                table.bin[first[a]][a].extend(whole);
            else if (triangles_)
                chop_triangle(r.shape, whole, slabs, a, first[a], last[a], table);
            else
                chop_box(r, slabs, a, first[a], last[a], table);
        }
    }

    static void chop_box(const BuildReference& r, const Slabs& slabs, int axis, int first, int last,
                         SlabTable& table) {
        for (int s = first; s <= last; ++s) {
            BuildReference part = r;
            if (s > first) part.bounds.lower[axis] = slabs.plane(axis, s);
            if (s < last) part.bounds.upper[axis] = slabs.plane(axis, s + 1);
            table.bin[s][axis].extend(StoredReference(part).box());
        }
    }

    /// A slab holds the corners in it and the triangle's sections by its planes, within the
    /// reference's box. Rounded: it serves to compare planes, the cut itself is exact.
    void chop_triangle(uint32_t shape, const Box8& whole, const Slabs& slabs, int axis, int first,
                       int last, SlabTable& table) const {
        Box8::V4 corner[3];
        float at[3];
        for (int k = 0; k < 3; ++k) {
            const Vec3f& v = triangles_->vertex(shape, k);
            alignas(16) const float xyz[4] = {v[0], v[1], v[2], 0};
            corner[k] = hn::Load(Box8::D4(), xyz);
            at[k] = v[axis];
        }
        Box8 part;
        for (int s = first; s <= last; ++s) {
            const float begin = s > first ? slabs.plane(axis, s) : -INFINITY;
            const float end = s < last ? slabs.plane(axis, s + 1) : INFINITY;
            for (int k = 0; k < 3; ++k)
                if (at[k] >= begin && at[k] <= end) part.extend(Box8(corner[k]));
            Box8 section;
            if (s < last) {
                for (int k = 0; k < 3; ++k) {
                    const int m = k == 2 ? 0 : k + 1;
                    if ((at[k] < end) == (at[m] < end)) continue;
                    const auto share = hn::Set(Box8::D4(), (end - at[k]) / (at[m] - at[k]));
                    section.extend(
                        Box8(hn::Add(corner[k], hn::Mul(share, hn::Sub(corner[m], corner[k])))));
                }
                part.extend(section);
            }
            part.limit(whole);
            if (part.valid()) table.bin[s][axis].extend(part);
            part = section;
        }
    }

    /// Divides a range at a plane. @return how many go left; 0: not done, for want of room or
    /// because one side would be empty
    size_t cut(Range& range, const SpatialSplit& plane) {
        const std::span<BuildReference> all = references(range);
        Side side[2];
        size_t straddling = 0;
        for (const BuildReference& r : all) {
            const int s = side_of(r, plane);
            if (s < 2)
                side[s].add(r);
            else
                ++straddling;
        }
        if (straddling > range.room()) return 0;
        // Parts on both sides first: where a whole one goes is then decided by what they add up to.
        std::vector<Part> parts;
        parts.reserve(straddling);
        for (size_t i = 0; i < all.size(); ++i)
            if (side_of(all[i], plane) == 2) parts.push_back(split_reference(all[i], plane, i));
        if (side[0].count + parts.size() == 0 || side[1].count + parts.size() == 0) return 0;
        for (const Part& p : parts)
            for (int s = 0; s < 2; ++s)
                if (!p.part[s].bounds.empty()) side[s].add(p.part[s]);
        if (side[0].count == 0 || side[1].count == 0) return 0;
        return distribute(range, plane, parts, side);
    }

    struct Part {
        size_t index;  // of the whole one in the range
        BuildReference part[2];
    };

    /// 0: below the plane, 1: above, 2: on both sides.
    static int side_of(const BuildReference& r, const SpatialSplit& plane) {
        if (r.bounds.lower[plane.axis] >= plane.position) return 1;
        return r.bounds.upper[plane.axis] <= plane.position ? 0 : 2;
    }

    Part split_reference(const BuildReference& r, const SpatialSplit& plane, size_t index) const {
        Part p{index, {r, r}};
        p.part[0].bounds.upper[plane.axis] = plane.position;
        p.part[1].bounds.lower[plane.axis] = plane.position;
        for (BuildReference& part : p.part) part.bounds = clip_(r.shape, part.bounds);
        // What only touches this box may be rounded away on both sides: keep it.
        if (p.part[0].bounds.empty() && p.part[1].bounds.empty()) p.part[0] = r;
        return p;
    }

    /// Reference unsplitting (Stich et al. 2009): a whole reference on one side costs a larger box
    /// there, and one reference less on the other side.
    size_t distribute(Range& range, const SpatialSplit& plane, const std::vector<Part>& parts,
                      Side (&side)[2]) {
        BuildReference* const refs = refs_.data() + range.begin;
        std::vector<uint8_t> place(range.size());
        for (size_t i = 0; i < range.size(); ++i) place[i] = uint8_t(side_of(refs[i], plane));
        size_t end = range.size();
        for (const Part& p : parts) {
            const bool here[2] = {!p.part[0].bounds.empty(), !p.part[1].bounds.empty()};
            const int whole = here[0] && here[1] ? cheaper_whole(side, refs[p.index]) : -1;
            if (whole >= 0) {
                side[whole].box.extend(refs[p.index].bounds);
                --side[1 - whole].count;
                side[1 - whole].cost -= refs[p.index].cost;
                place[p.index] = uint8_t(whole);
            } else if (here[0] && here[1]) {
                refs[p.index] = p.part[0];
                place[p.index] = 0;
                refs[end++] = p.part[1];
                place.push_back(1);
            } else {
                const int s = here[0] ? 0 : 1;
                refs[p.index] = p.part[s];
                place[p.index] = uint8_t(s);
            }
        }
        range.end = range.begin + end;
        size_t left = 0;
        for (size_t i = 0; i < end; ++i)
            if (place[i] == 0) {
                std::swap(refs[left], refs[i]);
                std::swap(place[left], place[i]);
                ++left;
            }
        return left;
    }

    /// The side that takes the whole of a straddling reference at less cost than both would their
    /// parts; -1: none. A side's last reference stays.
    int cheaper_whole(const Side (&side)[2], const BuildReference& r) const {
        double best = 0;
        for (const Side& s : side) best += half_area(s.box) * costs_.leaf(s.cost, s.count);
        int whole = -1;
        for (int s = 0; s < 2; ++s) {
            const Side& other = side[1 - s];
            if (other.count <= 1) continue;
            const double cost =
                half_area(merge(side[s].box, r.bounds)) * costs_.leaf(side[s].cost, side[s].count) +
                half_area(other.box) * costs_.leaf(other.cost - r.cost, other.count - 1);
            if (cost < best) best = cost, whole = s;
        }
        return whole;
    }

    BuildReferences refs_;
    size_t n_ = 0;
    const ClipShape& clip_;
    const TriangleSet* triangles_;
    TreeCosts costs_;
    int bins_;
    double overlap_;
    double root_area_ = 0;
    BinaryTree::Node* nodes_ = nullptr;
};

BinaryTree build_split(BuildReferences references, const ShapeClipper& clipper,
                       const TreeParameters& parameters, const TreeCosts& costs) {
    return SplitBuilder(std::move(references), clipper, parameters, costs).build();
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace crofton {
HWY_EXPORT(build_split);

BinaryTree build_split(BuildReferences references, const ShapeClipper& clipper,
                       const TreeParameters& parameters, const TreeCosts& costs) {
    return HWY_DYNAMIC_DISPATCH(build_split)(std::move(references), clipper, parameters, costs);
}

}  // namespace crofton
#endif
