#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "accelerators/object_split.h"
#include "accelerators/tree_build.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

constexpr int median_depth = 40;        // from here on, halves by count
constexpr size_t parallel_size = 2048;  // fewer references are not worth a task
constexpr size_t least_split = 4;       // fewer references are not cut
constexpr int max_slabs = 32;

/// A plane that cuts a node's box.
struct SpatialSplit {
    double cost = std::numeric_limits<double>::infinity();
    int axis = -1;
    float position = 0;
};

/// Equal slabs of a node's box on one axis.
struct Slabs {
    float lower, extent, scale;
    int count, axis;

    Slabs(const Bounds3& box, int a, int n)
        : lower(box.lower[a]),
          extent(box.upper[a] - box.lower[a]),
          scale(float(n) / extent),
          count(n),
          axis(a) {}
    bool usable() const { return extent > 0 && std::isfinite(scale) && std::isfinite(extent); }
    int of(float x) const { return std::clamp(int((x - lower) * scale), 0, count - 1); }
    float plane(int k) const { return lower + extent * (float(k) / float(count)); }
};

struct SlabTable {
    struct Slab {
        Box4 box;
        uint32_t enter = 0, leave = 0;
        double enter_cost = 0, leave_cost = 0;
    };
    std::array<std::array<Slab, max_slabs>, 3> axis;

    void add(const SlabTable& t) {
        for (size_t a = 0; a < 3; ++a)
            for (size_t s = 0; s < max_slabs; ++s) {
                Slab& to = axis[a][s];
                const Slab& from = t.axis[a][s];
                to.box.extend(from.box);
                to.enter += from.enter, to.leave += from.leave;
                to.enter_cost += from.enter_cost, to.leave_cost += from.leave_cost;
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
    SplitBuilder(std::vector<BuildReference> references, const ShapeClipper& clipper,
                 const TreeParameters& p, const TreeCosts& costs)
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
        if (depth >= median_depth) return halve_references(all, bounds).left;
        const int bins = bins_for(all.size(), bins_);
        const Binning binning(bounds.centroids, bins);
        const ObjectSplit split = find_object_split(all, bounds, binning, bins, costs_);
        if (all.size() >= least_split && range.room() > 0 && (split.axis < 0 || overlaps(split))) {
            const SpatialSplit spatial = find_spatial_split(all, box);
            if (spatial.cost < split.cost)
                if (const size_t n = cut(range, spatial)) return n;
        }
        if (split.axis < 0) return halve_references(all, bounds).left;
        return divide(all, binning, split).left;
    }

    /// Whether the children of a split overlap by more than the given share of the root.
    bool overlaps(const ObjectSplit& split) const {
        return half_area(intersection(split.side[0].bounds(), split.side[1].bounds())) >
               overlap_ * root_area_;
    }

    SpatialSplit find_spatial_split(std::span<const BuildReference> all, const Bounds3& box) const {
        // Finer than the bins: where a plane cuts shapes matters more than which side whole ones
        // take.
        const int slabs = std::min(max_slabs, 2 * bins_);
        const SlabTable table = sum_chunks<SlabTable>(0, all.size(), [&](size_t from, size_t to) {
            SlabTable sum;
            for (int a = 0; a < 3; ++a) {
                const Slabs axis(box, a, slabs);
                if (!axis.usable()) continue;
                for (size_t i = from; i < to; ++i) chop(all[i], axis, sum.axis[size_t(a)]);
            }
            return sum;
        });
        SpatialSplit best;
        const double area = half_area(box);
        for (int a = 0; a < 3; ++a) {
            const Slabs axis(box, a, slabs);
            if (axis.usable() && area > 0) sweep(table.axis[size_t(a)], axis, area, best);
        }
        return best;
    }

    /// Adds a reference's parts to the slabs that they lie in.
    void chop(const BuildReference& r, const Slabs& slabs,
              std::array<SlabTable::Slab, max_slabs>& table) const {
        const int first = slabs.of(r.bounds.lower[slabs.axis]);
        int last = slabs.of(r.bounds.upper[slabs.axis]);
        // What ends in a plane is below it.
        if (last > first && r.bounds.upper[slabs.axis] <= slabs.plane(last)) --last;
        SlabTable::Slab &enter = table[size_t(first)], &leave = table[size_t(last)];
        ++enter.enter, enter.enter_cost += r.cost;
        ++leave.leave, leave.leave_cost += r.cost;
        if (first == last) {
            enter.box.extend(Box4(r));
            return;
        }
        if (triangles_)
            chop_triangle(r, slabs, first, last, table);
        else
            chop_box(r, slabs, first, last, table);
    }

    static void chop_box(const BuildReference& r, const Slabs& slabs, int first, int last,
                         std::array<SlabTable::Slab, max_slabs>& table) {
        for (int s = first; s <= last; ++s) {
            BuildReference part = r;
            if (s > first) part.bounds.lower[slabs.axis] = slabs.plane(s);
            if (s < last) part.bounds.upper[slabs.axis] = slabs.plane(s + 1);
            table[size_t(s)].box.extend(Box4(part));
        }
    }

    /// A slab holds the corners in it and the triangle's sections by its planes, within the
    /// reference's box. Rounded: it serves to compare planes, the cut itself is exact.
    void chop_triangle(const BuildReference& r, const Slabs& slabs, int first, int last,
                       std::array<SlabTable::Slab, max_slabs>& table) const {
        const int axis = slabs.axis;
        const Box4 whole(r);
        Box4::V corner[3];
        float at[3];
        for (int k = 0; k < 3; ++k) {
            const Vec3f& v = triangles_->vertex(r.shape, k);
            alignas(16) const float xyz[4] = {v[0], v[1], v[2], 0};
            corner[k] = hn::Load(Box4::D(), xyz);
            at[k] = v[axis];
        }
        Box4 part;
        for (int s = first; s <= last; ++s) {
            const float begin = s > first ? slabs.plane(s) : -INFINITY;
            const float end = s < last ? slabs.plane(s + 1) : INFINITY;
            for (int k = 0; k < 3; ++k)
                if (at[k] >= begin && at[k] <= end) part.extend_point(corner[k]);
            Box4 section;
            if (s < last) {
                for (int k = 0; k < 3; ++k) {
                    const int m = k == 2 ? 0 : k + 1;
                    if ((at[k] < end) == (at[m] < end)) continue;
                    const auto share = hn::Set(Box4::D(), (end - at[k]) / (at[m] - at[k]));
                    section.extend_point(
                        hn::Add(corner[k], hn::Mul(share, hn::Sub(corner[m], corner[k]))));
                }
                part.extend(section);
            }
            part.lower = hn::Max(part.lower, whole.lower);
            part.upper = hn::Min(part.upper, whole.upper);
            if (part.valid()) table[size_t(s)].box.extend(part);
            part = section;
        }
    }

    void sweep(const std::array<SlabTable::Slab, max_slabs>& table, const Slabs& slabs, double area,
               SpatialSplit& best) const {
        std::array<double, max_slabs> right_cost;
        Box4 box;
        uint32_t count = 0;
        double cost = 0;
        for (int s = slabs.count - 1; s > 0; --s) {
            const SlabTable::Slab& slab = table[size_t(s)];
            box.extend(slab.box);
            count += slab.leave, cost += slab.leave_cost;
            right_cost[size_t(s)] = count ? box.half_area() * costs_.leaf(cost, count) : -1;
        }
        box = Box4(), count = 0, cost = 0;
        for (int s = 1; s < slabs.count; ++s) {
            const SlabTable::Slab& slab = table[size_t(s) - 1];
            box.extend(slab.box);
            count += slab.enter, cost += slab.enter_cost;
            if (count == 0 || right_cost[size_t(s)] < 0) continue;
            const double both = box.half_area() * costs_.leaf(cost, count) + right_cost[size_t(s)];
            const double total = costs_.node + both / area;
            if (total < best.cost) best = {total, slabs.axis, slabs.plane(s)};
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

    std::vector<BuildReference> refs_;
    size_t n_ = 0;
    const ClipShape& clip_;
    const TriangleSet* triangles_;
    TreeCosts costs_;
    int bins_;
    double overlap_;
    double root_area_ = 0;
    BinaryTree::Node* nodes_ = nullptr;
};

}  // namespace

BinaryTree build_split(std::vector<BuildReference> references, const ShapeClipper& clipper,
                       const TreeParameters& parameters, const TreeCosts& costs) {
    return SplitBuilder(std::move(references), clipper, parameters, costs).build();
}

}  // namespace crofton
