#include "accelerators/kd_build.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "framework/parallel.h"

namespace crofton {

SplitCost::SplitCost(const Bounds3& cell, const TreeCosts& costs, double empty_bonus)
    : cell_(cell), costs_(costs), bonus_(1 - empty_bonus), area_(half_area(cell)) {
    const Vec3d e = cell.upper.cast<double>() - cell.lower.cast<double>();
    for (int a = 0; a < 3; ++a) {
        face_[a] = e[(a + 1) % 3] * e[(a + 2) % 3];
        rim_[a] = e[(a + 1) % 3] + e[(a + 2) % 3];
    }
}

double SplitCost::share(int axis, float position, int side) const {
    const double extent = side == 0 ? double(position) - double(cell_.lower[axis])
                                    : double(cell_.upper[axis]) - double(position);
    return (face_[axis] + rim_[axis] * extent) / area_;
}

double SplitCost::of(int axis, float position, uint32_t n_below, double sum_below, uint32_t n_above,
                     double sum_above) const {
    const double shapes = share(axis, position, 0) * costs_.leaf(sum_below, n_below) +
                          share(axis, position, 1) * costs_.leaf(sum_above, n_above);
    return costs_.node + (n_below == 0 || n_above == 0 ? bonus_ : 1.0) * shapes;
}

void try_binned_planes(std::span<const BuildReference> references, const SplitCost& cost, int axis,
                       int bins, SplitPlane& best) {
    constexpr int most = 64;
    bins = std::min(bins, most);
    float low = std::numeric_limits<float>::infinity(), high = -low;
    for (const BuildReference& r : references) {
        low = std::min(low, r.bounds.lower[axis]);
        high = std::max(high, r.bounds.upper[axis]);
    }
    const float scale = float(bins) / (high - low);
    if (!(high > low) || !std::isfinite(scale)) return;

    // A shape is below plane k if it begins in a bin before k, above it if it ends in bin k or
    // later.
    struct Ends {
        uint32_t begin = 0, end = 0;
        double begin_cost = 0, end_cost = 0;
    };
    std::array<Ends, most> bin{};
    const auto of = [&](float x) { return std::clamp(int((x - low) * scale), 0, bins - 1); };
    double sum = 0;
    for (const BuildReference& r : references) {
        Ends& begin = bin[size_t(of(r.bounds.lower[axis]))];
        Ends& end = bin[size_t(of(r.bounds.upper[axis]))];
        ++begin.begin, begin.begin_cost += r.cost;
        ++end.end, end.end_cost += r.cost;
        sum += r.cost;
    }
    uint32_t below = 0, above = uint32_t(references.size());
    double sum_below = 0, sum_above = sum;
    for (int k = 0; k <= bins; ++k) {
        const float position = k == bins ? high : low + (high - low) * (float(k) / float(bins));
        if (cost.inside(axis, position)) {
            const double c = cost.of(axis, position, below, sum_below, above, sum_above);
            if (best.axis < 0 || c < best.cost) best = {axis, position, true, c};
        }
        if (k == bins) break;
        below += bin[size_t(k)].begin, sum_below += bin[size_t(k)].begin_cost;
        above -= bin[size_t(k)].end, sum_above -= bin[size_t(k)].end_cost;
    }
}

namespace {

constexpr size_t parallel_size = 4096;  // fewer references are not worth a task
constexpr size_t exact_size = 32;       // below this, the binned builder tries every plane
constexpr size_t collapse_size = 64;    // at most so many are kept to turn into a leaf again
constexpr int patience = 3;             // splits in a row that do not pay

/// One end of a reference's bounds on one axis.
struct Event {
    enum Type : uint32_t { end, planar, start };  // in this order at one position

    float position;
    uint32_t key;  // index among the node's references << 2 | type

    uint32_t reference() const { return key >> 2; }
    uint32_t type() const { return key & 3; }
    bool operator<(const Event& o) const {
        return position != o.position ? position < o.position : type() < o.type();
    }
};

using EventLists = std::array<std::vector<Event>, 3>;

/// What a node is built from.
struct Work {
    BuildReferences references;  // shapes ascending
    EventLists events;           // sorted, while `exact`
    bool exact = false;

    size_t size() const { return references.size(); }
    double cost_sum() const {
        double sum = 0;
        for (const BuildReference& r : references) sum += r.cost;
        return sum;
    }
};

void add_events(const Bounds3& b, uint32_t reference, EventLists& lists) {
    for (size_t a = 0; a < 3; ++a) {
        if (b.lower[a] == b.upper[a]) {
            lists[a].push_back({b.lower[a], reference << 2 | Event::planar});
        } else {
            lists[a].push_back({b.lower[a], reference << 2 | Event::start});
            lists[a].push_back({b.upper[a], reference << 2 | Event::end});
        }
    }
}

void make_exact(Work& work) {
    for (size_t i = 0; i < work.size(); ++i)
        add_events(work.references[i].bounds, uint32_t(i), work.events);
    parallel_for(3, work.size() >= parallel_size ? 1 : 3, [&](size_t begin, size_t end) {
        for (size_t a = begin; a < end; ++a)
            std::sort(work.events[a].begin(), work.events[a].end());
    });
    work.exact = true;
}

/// Merges sorted `added` into sorted `list`, from the back and in place.
void merge_into(std::vector<Event>& list, const std::vector<Event>& added) {
    size_t i = list.size(), j = added.size(), k = i + j;
    list.resize(k);
    while (j > 0) {
        if (i > 0 && added[j - 1] < list[i - 1])
            list[--k] = list[--i];
        else
            list[--k] = added[--j];
    }
}

/// Best plane of one axis, from the sorted ends (Wald & Havran 2006, algorithm 5).
void sweep(const Work& work, const SplitCost& cost, int axis, double sum, SplitPlane& best) {
    struct Side {
        uint32_t count = 0;
        double sum = 0;
        void move(uint32_t n, double c) { count += n, sum += c; }
    };
    const std::vector<Event>& events = work.events[size_t(axis)];
    Side below, above;
    above.move(uint32_t(work.size()), sum);
    for (size_t i = 0; i < events.size();) {
        const float position = events[i].position;
        Side here[3];
        for (; i < events.size() && events[i].position == position; ++i)
            here[events[i].type()].move(1, work.references[events[i].reference()].cost);
        const Side& flat = here[Event::planar];
        above.count -= here[Event::end].count + flat.count;
        above.sum -= here[Event::end].sum + flat.sum;
        if (cost.inside(axis, position)) {
            const double low = cost.of(axis, position, below.count + flat.count,
                                       below.sum + flat.sum, above.count, above.sum);
            if (best.axis < 0 || low < best.cost) best = {axis, position, true, low};
            if (flat.count > 0) {
                const double high = cost.of(axis, position, below.count, below.sum,
                                            above.count + flat.count, above.sum + flat.sum);
                if (high < best.cost) best = {axis, position, false, high};
            }
        }
        below.move(here[Event::start].count + flat.count, here[Event::start].sum + flat.sum);
    }
}

bool is_planar(const BuildReference& r, const SplitPlane& p) {
    return r.bounds.lower[p.axis] == p.position && r.bounds.upper[p.axis] == p.position;
}
bool goes_below(const BuildReference& r, const SplitPlane& p) {
    return r.bounds.lower[p.axis] < p.position || (p.planar_below && is_planar(r, p));
}
bool goes_above(const BuildReference& r, const SplitPlane& p) {
    return r.bounds.upper[p.axis] > p.position || (!p.planar_below && is_planar(r, p));
}

/// A subtree in the making, depth first: the child below a plane follows its node, child() is the
/// one above. Indices count from the fragment's own beginning.
struct Fragment {
    std::vector<KdNode> nodes;
    std::vector<uint32_t> references;

    void append(const Fragment& f) {
        const uint32_t node_base = uint32_t(nodes.size()), base = uint32_t(references.size());
        for (KdNode n : f.nodes) {
            if (!n.is_leaf())
                n.set_child(n.child() + node_base);
            else if (n.count() > 1)
                n.value += base;
            nodes.push_back(n);
        }
        references.insert(references.end(), f.references.begin(), f.references.end());
    }
};

class Builder {
  public:
    Builder(const ClipShape& clip, const KdOptions& options, int max_depth)
        : clip_(clip), options_(options), max_depth_(max_depth) {}

    /// Appends the subtree of `work` to `out`.
    /// @param bad     splits above this node that did not pay
    /// @param budget  references that the subtree may have, at least as many as `work` has
    /// @return its cost: nominal ns of a line that meets the cell
    double build(Work work, const Bounds3& cell, int depth, int bad, size_t budget, Fragment& out) {
        const size_t n = work.size();
        const double sum = work.cost_sum();
        const double leaf_cost = options_.costs.leaf(sum, uint32_t(n));
        if (n <= size_t(options_.max_leaf_size) || depth >= max_depth_)
            return make_leaf(work.references, leaf_cost, out);

        const SplitCost cost(cell, options_.costs, options_.empty_bonus);
        const SplitPlane plane = find_plane(work, cell, cost, sum);
        if (plane.axis < 0) return make_leaf(work.references, leaf_cost, out);
        const bool pays = plane.cost < leaf_cost;
        if (!pays) ++bad;
        if (bad >= patience || (plane.cost > 4 * leaf_cost && n < 16))
            return make_leaf(work.references, leaf_cost, out);

        Bounds3 cells[2] = {cell, cell};
        cells[0].upper[plane.axis] = cells[1].lower[plane.axis] = plane.position;
        Work sides[2];
        distribute(work, plane, cells, sides);
        if (sides[0].size() + sides[1].size() > budget)
            return make_leaf(work.references, leaf_cost, out);
        BuildReferences kept;
        if (n <= collapse_size || !pays) kept = std::move(work.references);
        work = {};

        const size_t node_count = out.nodes.size(), reference_count = out.references.size();
        const double split_cost =
            build_children(plane, cost, cells, sides, depth, bad, budget, out);
        if (kept.empty() || split_cost < leaf_cost) return split_cost;
        out.nodes.resize(node_count);
        out.references.resize(reference_count);
        return make_leaf(kept, leaf_cost, out);
    }

  private:
    static double make_leaf(const BuildReferences& references, double cost, Fragment& out) {
        const uint32_t n = uint32_t(references.size());
        out.nodes.push_back(KdNode::leaf(uint32_t(out.references.size()), n));
        if (n == 1)
            out.nodes.back().value = references[0].shape;
        else
            for (const BuildReference& r : references) out.references.push_back(r.shape);
        return cost;
    }

    double build_children(const SplitPlane& plane, const SplitCost& cost, const Bounds3 (&cells)[2],
                          Work (&sides)[2], int depth, int bad, size_t budget, Fragment& out) {
        const size_t n[2] = {sides[0].size(), sides[1].size()};
        // In proportion: neither share is less than what its side holds now.
        const size_t share = n[0] + n[1] > 0 ? budget * n[0] / (n[0] + n[1]) : 0;
        const size_t budgets[2] = {share, budget - share};
        const size_t node = out.nodes.size();
        out.nodes.push_back(KdNode::inner(plane.axis, plane.position));
        double costs[2];
        const auto child = [&](int i, Fragment& to) {
            costs[i] = build(std::move(sides[i]), cells[i], depth + 1, bad, budgets[i], to);
        };
        if (n[0] + n[1] >= parallel_size) {
            Fragment fragments[2];
            parallel_invoke([&] { child(0, fragments[0]); }, [&] { child(1, fragments[1]); });
            out.append(fragments[0]);
            out.nodes[node].set_child(uint32_t(out.nodes.size()));
            out.append(fragments[1]);
        } else {
            child(0, out);
            out.nodes[node].set_child(uint32_t(out.nodes.size()));
            child(1, out);
        }
        return options_.costs.node + cost.share(plane.axis, plane.position, 0) * costs[0] +
               cost.share(plane.axis, plane.position, 1) * costs[1];
    }

    SplitPlane find_plane(Work& work, const Bounds3& cell, const SplitCost& cost,
                          double sum) const {
        SplitPlane best;
        if (cost.degenerate()) return best;
        const bool binned = options_.builder == KdBuilder::binned_sah;
        if (options_.builder == KdBuilder::spatial_median ||
            options_.builder == KdBuilder::object_median)
            return median(work, cell, cost);
        if (binned && work.size() > exact_size) {
            // More bins than shapes would find no better planes.
            const int bins = int(std::min(size_t(options_.bins), work.size()));
            for (int a = 0; a < 3; ++a) try_binned_planes(work.references, cost, a, bins, best);
            return best;
        }
        if (!work.exact) make_exact(work);
        for (int a = 0; a < 3; ++a) sweep(work, cost, a, sum, best);
        return best;
    }

    /// On the longest side, or on the next one where that plane would not be inside the cell.
    SplitPlane median(const Work& work, const Bounds3& cell, const SplitCost& cost) const {
        int axes[3] = {0, 1, 2};
        const Vec3d extent = cell.upper.cast<double>() - cell.lower.cast<double>();
        std::sort(axes, axes + 3, [&](int a, int b) {
            return extent[a] != extent[b] ? extent[a] > extent[b] : a < b;
        });
        for (const int a : axes) {
            const float at = options_.builder == KdBuilder::spatial_median
                                 ? cell.center()[a]
                                 : median_centre(work.references, a);
            if (!cost.inside(a, at)) continue;
            SplitPlane plane{a, at, true, 0};
            uint32_t n[2] = {0, 0};
            double sums[2] = {0, 0};
            for (const BuildReference& r : work.references) {
                if (goes_below(r, plane)) ++n[0], sums[0] += r.cost;
                if (goes_above(r, plane)) ++n[1], sums[1] += r.cost;
            }
            plane.cost = cost.of(a, at, n[0], sums[0], n[1], sums[1]);
            return plane;
        }
        return {};
    }

    static float median_centre(const BuildReferences& references, int axis) {
        std::vector<float> centres;
        centres.reserve(references.size());
        for (const BuildReference& r : references)
            centres.push_back(r.bounds.lower[axis] * 0.5f + r.bounds.upper[axis] * 0.5f);
        const auto middle = centres.begin() + ptrdiff_t(centres.size() / 2);
        std::nth_element(centres.begin(), middle, centres.end());
        return *middle;
    }

    /// Gives every reference to one side, or clipped to both.
    void distribute(const Work& work, const SplitPlane& plane, const Bounds3 (&cells)[2],
                    Work (&sides)[2]) const {
        const uint32_t n = uint32_t(work.size());
        // Per reference: its side and index there; a clipped one gets new events, not the old.
        constexpr uint32_t clipped = 2;
        std::vector<std::pair<uint32_t, uint32_t>> place(work.exact ? n : 0);
        EventLists added[2];
        for (Work& side : sides) side.exact = work.exact;
        for (uint32_t i = 0; i < n; ++i) {
            const BuildReference& r = work.references[i];
            const bool below = goes_below(r, plane), above = goes_above(r, plane);
            if (below != above) {
                BuildReferences& to = sides[above].references;
                if (work.exact) place[i] = {uint32_t(above), uint32_t(to.size())};
                to.push_back(r);
                continue;
            }
            if (work.exact) place[i] = {clipped, 0};
            clip(r, cells, sides, work.exact ? added : nullptr);
        }
        if (work.exact) distribute_events(work, place, added, sides);
    }

    void clip(const BuildReference& r, const Bounds3 (&cells)[2], Work (&sides)[2],
              EventLists* added) const {
        Bounds3 parts[2];
        for (int s = 0; s < 2; ++s) parts[s] = intersection(clip_(r.shape, cells[s]), r.bounds);
        // A shape that only touches this cell may be rounded away on both sides: keep its box.
        if (parts[0].empty() && parts[1].empty()) parts[0] = intersection(r.bounds, cells[0]);
        for (int s = 0; s < 2; ++s) {
            if (parts[s].empty()) continue;
            if (added) add_events(parts[s], uint32_t(sides[s].size()), added[s]);
            sides[s].references.push_back({parts[s], r.shape, r.cost});
        }
    }

    /// Keeps both sides' lists sorted without sorting again: only the clipped parts are new.
    static void distribute_events(const Work& work,
                                  const std::vector<std::pair<uint32_t, uint32_t>>& place,
                                  EventLists (&added)[2], Work (&sides)[2]) {
        for (size_t a = 0; a < 3; ++a) {
            for (Work& side : sides) side.events[a].reserve(2 * side.size());
            for (const Event& e : work.events[a]) {
                const auto [side, index] = place[e.reference()];
                if (side < 2) sides[side].events[a].push_back({e.position, index << 2 | e.type()});
            }
            for (size_t s = 0; s < 2; ++s) {
                std::sort(added[s][a].begin(), added[s][a].end());
                merge_into(sides[s].events[a], added[s][a]);
            }
        }
    }

    const ClipShape& clip_;
    const KdOptions& options_;
    int max_depth_;
};

/// Puts siblings side by side, and into one cache line the pairs that a ray is likeliest to visit
/// one after the other: from the top of each part, the largest cell's children first.
class PairLayout {
  public:
    explicit PairLayout(const std::vector<KdNode>& depth_first) : from_(depth_first) {}

    std::vector<KdNode> run(const Bounds3& box) {
        to_.reserve(from_.size() + 1);
        to_.push_back(from_[0]);
        to_.push_back(KdNode::leaf(0, 0));
        std::vector<Open> open, line;
        if (!from_[0].is_leaf()) open.push_back({0, 0, box, half_area(box)});
        while (!open.empty()) {
            line.push_back(open.back());
            open.pop_back();
            for (size_t room = pairs_a_line - to_.size() / 2 % pairs_a_line;
                 room > 0 && !line.empty(); --room)
                place_children(line);
            // The likeliest of the rest is next, as near as can be.
            std::sort(line.begin(), line.end(), less_likely);
            open.insert(open.end(), line.begin(), line.end());
            line.clear();
        }
        return std::move(to_);
    }

  private:
    static constexpr size_t pairs_a_line = 64 / (2 * sizeof(KdNode));

    /// An inner node that has its place, and its children not yet.
    struct Open {
        uint32_t from, to;
        Bounds3 cell;
        double area;
    };
    static bool less_likely(const Open& a, const Open& b) {
        return a.area != b.area ? a.area < b.area : a.from > b.from;
    }

    /// Of the likeliest of `line`, which they replace.
    void place_children(std::vector<Open>& line) {
        const auto likeliest = std::max_element(line.begin(), line.end(), less_likely);
        const Open parent = *likeliest;
        line.erase(likeliest);
        const KdNode node = from_[parent.from];
        const uint32_t pair = uint32_t(to_.size());
        to_[parent.to].set_child(pair);
        for (uint32_t side = 0; side < 2; ++side) {
            const uint32_t from = side == 0 ? parent.from + 1 : node.child();
            to_.push_back(from_[from]);
            if (from_[from].is_leaf()) continue;
            Open child{from, pair + side, parent.cell, 0};
            (side == 0 ? child.cell.upper : child.cell.lower)[node.axis()] = node.split();
            child.area = half_area(child.cell);
            line.push_back(child);
        }
    }

    const std::vector<KdNode>& from_;
    std::vector<KdNode> to_;
};

}  // namespace

KdTreeData build_kd_tree(BuildReferences references, const ClipShape& clip,
                         const KdOptions& options) {
    KdTreeData tree;
    if (references.empty()) return tree;
    Work work;
    work.references = std::move(references);
    for (const BuildReference& r : work.references) tree.box.extend(r.bounds);
    const double n = double(work.size());
    const int automatic = int(std::lround(8 + 1.3 * std::log2(n)));
    const int depth =
        std::min(options.max_depth > 0 ? options.max_depth : automatic, KdTreeData::max_depth);
    Fragment all;
    tree.cost = Builder(clip, options, depth)
                    .build(std::move(work), tree.box, 0, 0, size_t(16 * n) + 1024, all);
    tree.nodes = PairLayout(all.nodes).run(tree.box);
    tree.references = std::move(all.references);
    return tree;
}

}  // namespace crofton
