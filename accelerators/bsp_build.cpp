#include "accelerators/bsp_build.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "accelerators/kd_build.h"
#include "framework/parallel.h"

namespace crofton {
namespace {

constexpr size_t parallel_size = 1024;  // fewer pieces are not worth a task
constexpr size_t exact_size = 256;      // below this, every plane is tried instead of bins
constexpr size_t collapse_size = 64;    // at most so many are kept to turn into a leaf again
constexpr int patience = 3;             // splits in a row that do not pay
constexpr int most_edges = 8;           // of one shape whose planes are tried

/// The part of one shape inside a cell.
struct Piece {
    Bounds3 box;
    uint32_t index;         ///< of the shape among the builder's references
    uint32_t first, count;  ///< corners in Work::points; none: only the box is known
    float cost;
};

/// What a node is built from.
struct Work {
    std::vector<Piece> pieces;  // shapes ascending
    std::vector<Vec3d> points;
    size_t size() const { return pieces.size(); }
};

struct Interval {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    void add(double x) { low = std::min(low, x), high = std::max(high, x); }
};

/// The parts of the lines through a cell that meet what is on either side of a plane.
struct Shares {
    double below = 0, above = 0;
};

/// A plane across a cell.
struct Split {
    uint32_t kind = BspNode::leaf_kind;  ///< as in BspNode; a leaf: none found
    Vec3d n = Vec3d::Zero();             ///< exactly representable in float
    float d = 0;
    bool flat_below = true;  ///< where shapes in the plane go
    Shares share;
    double cost = std::numeric_limits<double>::infinity();  ///< nominal ns; the bonus taken off

    bool found() const { return kind != BspNode::leaf_kind; }
    bool is_axis() const { return kind < 3; }
};

Vec3d direction(int k) {
    return {double(bsp_direction[size_t(k)][0]), double(bsp_direction[size_t(k)][1]),
            double(bsp_direction[size_t(k)][2])};
}

float float_below(double x) {
    const float f = float(x);
    return double(f) > x ? std::nextafter(f, -INFINITY) : f;
}
float float_above(double x) { return -float_below(-x); }

Bounds3 bounds_of(std::span<const Vec3d> points) {
    Bounds3 b;
    for (const Vec3d& p : points)
        for (int a = 0; a < 3; ++a) {
            b.lower[a] = std::min(b.lower[a], float_below(p[a]));
            b.upper[a] = std::max(b.upper[a], float_above(p[a]));
        }
    return b;
}

Interval extent(const Bounds3& b, const Vec3d& n) {
    const Vec3d lower = b.lower.cast<double>(), upper = b.upper.cast<double>();
    Interval e{0, 0};
    for (int a = 0; a < 3; ++a) {
        e.low += n[a] * (n[a] > 0 ? lower : upper)[a];
        e.high += n[a] * (n[a] > 0 ? upper : lower)[a];
    }
    return e;
}

Interval extent(const BspShapes::Round& round, const Vec3d& n) {
    Interval e;
    const double along = n.dot(round.axis);
    const double reach = std::sqrt(std::max(0.0, n.squaredNorm() - along * along));
    for (size_t i = 0; i < 2; ++i) {
        const double middle = n.dot(round.center[i]);
        e.add(middle - reach * round.radius[i]);
        e.add(middle + reach * round.radius[i]);
    }
    return e;
}

/// Cuts a box to what one half-space leaves of it, as far as a box can say.
/// @param sign  1: n·x <= d, −1: n·x >= d
Bounds3 cut_box(Bounds3 b, const Vec3d& plane_n, double plane_d, int sign) {
    const Vec3d n = sign * plane_n;
    const double d = sign * plane_d;
    const double least = extent(b, n).low;
    for (int a = 0; a < 3; ++a) {
        // A steep axis gains nothing, and would magnify rounding.
        if (std::abs(n[a]) < 0x1p-10) continue;
        const double own = n[a] * (n[a] > 0 ? double(b.lower[a]) : double(b.upper[a]));
        const double limit = (d - (least - own)) / n[a];
        if (n[a] > 0)
            b.upper[a] = std::min(b.upper[a], float_above(limit));
        else
            b.lower[a] = std::max(b.lower[a], float_below(limit));
    }
    return b;
}

/// Cuts a cell in two. @return false if rounding leaves nothing of one of them
/// @param axis       of the plane, 3: none
/// @param magnitude  largest coordinate of the tree's box
bool split_cell(const BspCell& cell, uint32_t axis, const BspEquation& plane, double magnitude,
                BspCell (&cells)[2]) {
    cells[0].box = cells[1].box = cell.box;
    if (axis < 3) cells[0].box.upper[axis] = cells[1].box.lower[axis] = float(plane.d);
    if (axis < 3 && cell.is_box()) return true;
    Polyhedron room;
    const Polyhedron& whole = cell.polyhedron(room);
    // Far more than corners are wrong by, far less than planes are apart.
    const double merged = 0x1p-44 * magnitude;
    for (int s = 0; s < 2; ++s) {
        const double sign = s == 0 ? 1 : -1;
        cells[s].shape = clipped(whole, sign * plane.n, sign * plane.d, merged);
        if (cells[s].shape.empty()) return false;
        cells[s].box = intersection(cells[s].shape.bounds(), cells[s].box);
        if (cells[s].box.empty()) return false;
    }
    return true;
}

/// One end of a piece's extent along a direction, in an integer that sorts by position, then type.
struct Event {
    enum Type : uint64_t { end, flat, start };

    uint64_t key;  // position << 32 | type << 30 | index among the node's pieces

    Event(float position, Type type, size_t piece) {
        const uint32_t bits = std::bit_cast<uint32_t>(position + 0.0f);
        const uint32_t ordered = bits >> 31 ? ~bits : bits | 0x80000000u;
        key = uint64_t(ordered) << 32 | type << 30 | piece;
    }
    float position() const {
        const uint32_t ordered = uint32_t(key >> 32);
        return std::bit_cast<float>(ordered >> 31 ? ordered & 0x7fffffffu : ~ordered);
    }
    Type type() const { return Type(key >> 30 & 3); }
    size_t piece() const { return key & 0x3fffffff; }
    bool operator<(const Event& o) const { return key < o.key; }
};

/// How many shapes are on a side of a plane, and what their tests cost.
struct Side {
    uint32_t count = 0;
    double sum = 0;
    void add(uint32_t n, double c) { count += n, sum += c; }
    Side operator+(const Side& o) const { return {count + o.count, sum + o.sum}; }
};

/// A subtree in the making; indices count from its own beginning.
struct Fragment {
    std::vector<BspNode> nodes;
    std::vector<BspPlane> planes;
    std::vector<uint32_t> references;

    void append(const Fragment& f) {
        const uint32_t node_base = uint32_t(nodes.size()), plane_base = uint32_t(planes.size());
        const uint32_t base = uint32_t(references.size());
        for (BspNode n : f.nodes) {
            if (!n.is_leaf()) {
                n.set_above(n.above() + node_base);
                if (n.kind() == BspNode::general) n.value += plane_base;
            } else if (n.count() > 1) {
                n.value += base;
            }
            nodes.push_back(n);
        }
        planes.insert(planes.end(), f.planes.begin(), f.planes.end());
        references.insert(references.end(), f.references.begin(), f.references.end());
    }
    struct Mark {
        size_t nodes, planes, references;
    };
    Mark mark() const { return {nodes.size(), planes.size(), references.size()}; }
    void cut_back(const Mark& m) {
        nodes.resize(m.nodes);
        planes.resize(m.planes);
        references.resize(m.references);
    }
};

/// Shares of planes of one of bsp_direction, across one cell.
class Ruler {
  public:
    /// @param box     closed forms for the cell's box
    /// @param areas   of the cell; not read for an axis of a box
    /// @param margin  planes are no closer to the ends of the cell
    /// @param planes  how many will be asked for, about
    Ruler(const BspCell& cell, const SplitCost& box, const CellAreas* areas, int k, double margin,
          size_t planes)
        : box_(box), k_(k), closed_form_(k < 3 && cell.is_box()) {
        if (closed_form_) return;
        profile_.look_along(*areas, direction(k));
        total_ = areas->total();
        low_ = profile_.lowest() + margin, high_ = profile_.highest() - margin;
        if (!(low_ < high_)) return;
        steps_ = int(std::min<size_t>(planes / 4, most));
        scale_ = steps_ / (high_ - low_);
        for (int i = 0; i <= steps_ && steps_ > 0; ++i)
            at_[size_t(i)] = exact(low_ + (high_ - low_) * (double(i) / steps_));
    }
    bool inside(float d) const {
        if (k_ < 3 && !box_.inside(k_, d)) return false;
        return closed_form_ || (low_ < double(d) && double(d) < high_);
    }
    Shares exact(double d) const {
        if (closed_form_) return {box_.share(k_, float(d), 0), box_.share(k_, float(d), 1)};
        const AreaProfile::Parts parts = profile_.at(d);
        return {parts.below / total_, parts.above / total_};
    }
    /// No more than the exact ones, and cheaper: a convex body has less area than one around it, so
    /// that a part's area grows with it.
    Shares least(float d) const {
        if (closed_form_) return exact(d);
        if (steps_ == 0) return {};
        const int i = std::clamp(int((double(d) - low_) * scale_), 0, steps_ - 1);
        return {at_[size_t(i)].below * (1 - 1e-9), at_[size_t(i) + 1].above * (1 - 1e-9)};
    }

  private:
    static constexpr size_t most = 16;
    const SplitCost& box_;
    int k_;
    bool closed_form_;
    AreaProfile profile_;
    double total_ = 1, low_ = 0, high_ = 0, scale_ = 0;
    int steps_ = 0;
    std::array<Shares, most + 1> at_;
};

/// Looks for the best plane across one cell.
class PlaneSearch {
  public:
    PlaneSearch(const BspShapes& shapes, const BspOptions& options, double tolerance,
                const Work& work, const BspCell& cell)
        : shapes_(shapes),
          options_(options),
          tolerance_(tolerance),
          work_(work),
          cell_(cell),
          box_(cell.box, options.costs, options.empty_bonus) {
        for (const Piece& p : work.pieces) sum_ += p.cost;
        const BspPlanes planes = options.planes;
        diagonal_ = planes == BspPlanes::kdop || planes == BspPlanes::all;
        general_ = (planes == BspPlanes::polygons || planes == BspPlanes::all) &&
                   work.size() <= size_t(options.general_size) && any_face();
        slanted_ = diagonal_ || general_;
        if (!cell.is_box() || options.planes != BspPlanes::axis_aligned)
            areas_.emplace(cell.polyhedron(room_));
    }

    Split run() const {
        Split best;
        if (areas_ ? !(areas_->total() > 0) : box_.degenerate()) return best;
        std::array<Split, bsp_directions> found;
        const size_t n = diagonal_ ? bsp_directions : 3;
        parallel_for(n, work_.size() >= parallel_size ? 1 : n, [&](size_t begin, size_t end) {
            for (size_t k = begin; k < end; ++k) found[k] = along(int(k));
        });
        for (size_t k = 0; k < n; ++k)
            if (found[k].cost < best.cost) best = found[k];
        if (general_) try_shapes(best);
        return best;
    }

    /// Where a piece is, along n; less the tolerance, where n is not an axis.
    Interval piece_extent(const Piece& p, const Vec3d& n) const {
        Interval e;
        if (p.count > 0) {
            for (uint32_t i = p.first; i < p.first + p.count; ++i) e.add(n.dot(work_.points[i]));
            return e;
        }
        e = extent(p.box, n);
        if (!shapes_.rounds.empty()) {
            const Interval round = extent(shapes_.rounds[p.index], n);
            const double error = tolerance_ * n.lpNorm<1>();
            e.low = std::max(e.low, round.low - error);
            e.high = std::min(e.high, round.high + error);
        }
        return e;
    }

  private:
    /// What a plane costs, and what cutting off empty space takes off the cost of its shapes.
    struct Price {
        double step, bonus;
    };
    Price price(uint32_t kind) const {
        if (kind == BspNode::general) return {options_.general_node, 0};
        return {options_.costs.node, slanted_ ? 0 : options_.empty_bonus};
    }
    double cost(const Price& price, const Shares& share, const Side& below,
                const Side& above) const {
        const double shapes = share.below * options_.costs.leaf(below.sum, below.count) +
                              share.above * options_.costs.leaf(above.sum, above.count);
        return price.step + (below.count == 0 || above.count == 0 ? 1 - price.bonus : 1.0) * shapes;
    }

    /// Takes the plane if it is better; shapes in the plane go to the cheaper side.
    void offer(const Price& price, const Shares& share, const Side& below, const Side& flat,
               const Side& above, Split plane, Split& best) const {
        plane.share = share;
        plane.cost = cost(price, share, below + flat, above);
        if (plane.cost < best.cost) best = plane;
        if (flat.count == 0) return;
        plane.flat_below = false;
        plane.cost = cost(price, share, below, above + flat);
        if (plane.cost < best.cost) best = plane;
    }

    /// The best plane of one direction.
    Split along(int k) const {
        Split plane;
        plane.kind = uint32_t(k);
        plane.n = direction(k);
        std::vector<std::array<float, 2>> ends;
        ends.reserve(work_.size());
        const float error = k < 3 ? 0 : float(tolerance_ * plane.n.lpNorm<1>());
        for (const Piece& p : work_.pieces) {
            if (k < 3) {
                ends.push_back({p.box.lower[k], p.box.upper[k]});
                continue;
            }
            const Interval e = piece_extent(p, plane.n);
            float low = float(e.low) + error, high = float(e.high) - error;
            if (low > high) low = high = float(0.5 * (e.low + e.high));
            ends.push_back({low, high});
        }
        const Ruler ruler(cell_, box_, areas_ ? &*areas_ : nullptr, k, 4 * double(error),
                          ends.size());
        const Price paid = price(plane.kind);
        Split best;
        const auto consider = [&](float d, const Side& below, const Side& flat, const Side& above) {
            if (!ruler.inside(d)) return;
            const Shares least = ruler.least(d);
            const double bound = std::min(cost(paid, least, below + flat, above),
                                          cost(paid, least, below, above + flat));
            if (bound >= best.cost) return;
            plane.d = d;
            offer(paid, ruler.exact(d), below, flat, above, plane, best);
        };
        if (work_.size() > exact_size)
            sweep_bins(ends, consider);
        else
            sweep_ends(ends, consider);
        return best;
    }

    /// At every position where a piece begins or ends.
    template <class F>
    void sweep_ends(const std::vector<std::array<float, 2>>& ends, const F& consider) const {
        std::vector<Event> events;
        events.reserve(2 * ends.size());
        for (size_t i = 0; i < ends.size(); ++i) {
            if (ends[i][0] == ends[i][1]) {
                events.emplace_back(ends[i][0], Event::flat, i);
            } else {
                events.emplace_back(ends[i][0], Event::start, i);
                events.emplace_back(ends[i][1], Event::end, i);
            }
        }
        std::sort(events.begin(), events.end());
        Side below, above{uint32_t(work_.size()), sum_};
        for (size_t i = 0; i < events.size();) {
            const float position = events[i].position();
            Side here[3];
            for (; i < events.size() && events[i].position() == position; ++i)
                here[events[i].type()].add(1, work_.pieces[events[i].piece()].cost);
            const Side& flat = here[Event::flat];
            above.count -= here[Event::end].count + flat.count;
            above.sum -= here[Event::end].sum + flat.sum;
            consider(position, below, flat, above);
            below = below + here[Event::start] + flat;
        }
    }

    /// At the boundaries of equal bins.
    template <class F>
    void sweep_bins(const std::vector<std::array<float, 2>>& ends, const F& consider) const {
        constexpr int most = 64;
        const int bins = std::min(options_.bins, most);
        float low = std::numeric_limits<float>::infinity(), high = -low;
        for (const auto& e : ends) low = std::min(low, e[0]), high = std::max(high, e[1]);
        const float scale = float(bins) / (high - low);
        if (!(high > low) || !std::isfinite(scale)) return;
        std::array<Side, most> begin{}, end{};
        const auto bin = [&](float x) {
            return size_t(std::clamp(int((x - low) * scale), 0, bins - 1));
        };
        for (size_t i = 0; i < ends.size(); ++i) {
            begin[bin(ends[i][0])].add(1, work_.pieces[i].cost);
            end[bin(ends[i][1])].add(1, work_.pieces[i].cost);
        }
        Side below, above{uint32_t(work_.size()), sum_};
        for (int k = 0; k <= bins; ++k) {
            const float d = k == bins ? high : low + (high - low) * (float(k) / float(bins));
            consider(d, below, Side{}, above);
            if (k == bins) break;
            below = below + begin[size_t(k)];
            above.count -= end[size_t(k)].count;
            above.sum -= end[size_t(k)].sum;
        }
    }

    bool any_face() const {
        return std::any_of(work_.pieces.begin(), work_.pieces.end(), [&](const Piece& p) {
            return shapes_.rounds.empty() ? !shapes_.outline(p.index).empty()
                                          : !shapes_.rounds[p.index].axis.isZero(0);
        });
    }

    /// Planes of the shapes' own faces and edges.
    void try_shapes(Split& best) const {
        const size_t n = work_.size();
        const size_t samples = std::min(n, size_t(options_.sampled_shapes));
        AreaProfile profile;
        for (size_t s = 0; s < samples; ++s) {
            const uint32_t index = work_.pieces[s * n / samples].index;
            if (!shapes_.rounds.empty())
                try_round(shapes_.rounds[index], profile, best);
            else
                try_outline(shapes_.outline(index), profile, best);
        }
    }

    void try_outline(std::span<const Vec3d> c, AreaProfile& profile, Split& best) const {
        Vec3d normal = Vec3d::Zero();
        for (size_t i = 2; i < c.size(); ++i) normal += (c[i - 1] - c[0]).cross(c[i] - c[0]);
        const double length = normal.norm();
        if (!(length > 0) || !std::isfinite(length)) return;
        normal /= length;
        try_plane(normal, c[0], profile, best);
        const size_t edges = std::min(c.size(), size_t(most_edges));
        for (size_t e = 0; e < edges; ++e) {
            const size_t i = e * c.size() / edges;
            try_plane(normal.cross(c[(i + 1) % c.size()] - c[i]), c[i], profile, best);
        }
    }

    /// Across the axis at both ends, and four along the wider end's surface.
    void try_round(const BspShapes::Round& r, AreaProfile& profile, Split& best) const {
        if (r.axis.isZero(0)) return;
        const size_t wide = r.radius[0] >= r.radius[1] ? 0 : 1;
        const bool disc = r.center[0] == r.center[1];
        try_plane(r.axis, r.center[0], profile, best);
        if (!disc) try_plane(r.axis, r.center[1], profile, best);
        const Vec3d u = r.axis.unitOrthogonal(), v = r.axis.cross(u);
        for (const Vec3d& n : {u, v})
            for (const double sign : {-1.0, 1.0})
                try_plane(n, r.center[wide] + n * (sign * r.radius[wide]), profile, best);
    }

    void try_plane(const Vec3d& direction, const Vec3d& through, AreaProfile& profile,
                   Split& best) const {
        const double length = direction.lpNorm<1>();
        if (!(length > 0) || !std::isfinite(length)) return;
        Split plane;
        plane.kind = BspNode::general;
        // A little shorter than 1, so that it is no longer when rounded.
        plane.n = (direction * ((1 - 0x1p-20) / length)).cast<float>().cast<double>();
        plane.d = float(plane.n.dot(through));
        // An axis's own plane has been tried, and costs less.
        if (plane.n.cwiseAbs().maxCoeff() > 1 - 0x1p-19) return;
        Side below, flat, above;
        for (const Piece& p : work_.pieces) {
            const Interval e = piece_extent(p, plane.n);
            const bool low = e.low<plane.d - tolerance_, high = e.high> plane.d + tolerance_;
            if (low) below.add(1, p.cost);
            if (high) above.add(1, p.cost);
            if (!low && !high) flat.add(1, p.cost);
        }
        // Areas are dear, and their shares sum to more than 1.
        const Price paid = price(BspNode::general);
        const double bound = std::min(std::min(cost(paid, {1, 0}, below + flat, above),
                                               cost(paid, {0, 1}, below + flat, above)),
                                      std::min(cost(paid, {1, 0}, below, above + flat),
                                               cost(paid, {0, 1}, below, above + flat)));
        if (bound >= best.cost) return;
        profile.look_along(*areas_, plane.n);
        if (!(profile.lowest() + 4 * tolerance_ < plane.d &&
              plane.d < profile.highest() - 4 * tolerance_))
            return;
        const AreaProfile::Parts parts = profile.at(plane.d);
        const double total = areas_->total();
        offer(paid, {parts.below / total, parts.above / total}, below, flat, above, plane, best);
    }

    const BspShapes& shapes_;
    const BspOptions& options_;
    double tolerance_;
    const Work& work_;
    const BspCell& cell_;
    SplitCost box_;
    Polyhedron room_;
    std::optional<CellAreas> areas_;  ///< where no box's closed form will do
    double sum_ = 0;
    bool diagonal_, general_;  ///< which planes are tried
    /// Any but axis-aligned ones. There is then nearly always a corner to cut off, so that a bonus
    /// for empty space would make a chain of such cuts the best choice.
    bool slanted_;
};

class Builder {
  public:
    Builder(const BspShapes& shapes, const BspOptions& options, int max_depth, float magnitude)
        : shapes_(shapes),
          options_(options),
          max_depth_(max_depth),
          magnitude_(magnitude),
          tolerance_(bsp_tolerance * double(magnitude)) {}

    /// Appends the subtree of `work` to `out`.
    /// @param bad     splits above this node that did not pay
    /// @param budget  references that the subtree may have, at least as many as `work` has
    /// @return its cost: nominal ns of a line that meets the cell
    double build(Work work, const BspCell& cell, int depth, int bad, size_t budget, Fragment& out) {
        const size_t n = work.size();
        double sum = 0;
        for (const Piece& p : work.pieces) sum += p.cost;
        const double leaf_cost = options_.costs.leaf(sum, uint32_t(n));
        if (n <= size_t(options_.max_leaf_size) || depth >= max_depth_)
            return make_leaf(indices(work), leaf_cost, out);

        const PlaneSearch search(shapes_, options_, tolerance_, work, cell);
        const Split plane = search.run();
        if (!plane.found()) return make_leaf(indices(work), leaf_cost, out);
        const bool pays = plane.cost < leaf_cost;
        if (!pays) ++bad;
        if (bad >= patience || (plane.cost > 4 * leaf_cost && n < 16))
            return make_leaf(indices(work), leaf_cost, out);

        BspCell cells[2];
        Work sides[2];
        if (!split_cell(cell, std::min(plane.kind, 3u), {plane.n, plane.d}, magnitude_, cells))
            return make_leaf(indices(work), leaf_cost, out);
        distribute(search, work, plane, cells, sides);
        if (sides[0].size() + sides[1].size() > budget)
            return make_leaf(indices(work), leaf_cost, out);
        std::vector<uint32_t> kept;
        if (n <= collapse_size || !pays) kept = indices(work);
        work = {};

        const Fragment::Mark mark = out.mark();
        const double split_cost = build_children(plane, cells, sides, depth, bad, budget, out);
        if (kept.empty() || split_cost < leaf_cost) return split_cost;
        out.cut_back(mark);
        return make_leaf(kept, leaf_cost, out);
    }

  private:
    static std::vector<uint32_t> indices(const Work& work) {
        std::vector<uint32_t> list;
        list.reserve(work.size());
        for (const Piece& p : work.pieces) list.push_back(p.index);
        return list;
    }

    double make_leaf(const std::vector<uint32_t>& list, double cost, Fragment& out) const {
        const uint32_t n = uint32_t(list.size());
        out.nodes.push_back(BspNode::leaf(uint32_t(out.references.size()), n));
        if (n == 1)
            out.nodes.back().value = shapes_.references[list[0]].shape;
        else
            for (const uint32_t i : list) out.references.push_back(shapes_.references[i].shape);
        return cost;
    }

    double build_children(const Split& plane, const BspCell (&cells)[2], Work (&sides)[2],
                          int depth, int bad, size_t budget, Fragment& out) {
        const size_t n[2] = {sides[0].size(), sides[1].size()};
        // In proportion: neither share is less than what its side holds now.
        const size_t share = n[0] + n[1] > 0 ? budget * n[0] / (n[0] + n[1]) : 0;
        const size_t budgets[2] = {share, budget - share};
        const size_t node = out.nodes.size();
        if (plane.kind == BspNode::general) {
            out.nodes.push_back(BspNode::any(uint32_t(out.planes.size())));
            out.planes.push_back(
                {{float(plane.n[0]), float(plane.n[1]), float(plane.n[2])}, plane.d});
        } else {
            out.nodes.push_back(BspNode::along(int(plane.kind), plane.d));
        }
        double costs[2];
        const auto child = [&](int i, Fragment& to) {
            costs[i] = build(std::move(sides[i]), cells[i], depth + 1, bad, budgets[i], to);
        };
        if (n[0] + n[1] >= parallel_size) {
            Fragment fragments[2];
            parallel_invoke([&] { child(0, fragments[0]); }, [&] { child(1, fragments[1]); });
            out.append(fragments[0]);
            out.nodes[node].set_above(uint32_t(out.nodes.size()));
            out.append(fragments[1]);
        } else {
            child(0, out);
            out.nodes[node].set_above(uint32_t(out.nodes.size()));
            child(1, out);
        }
        const double step =
            plane.kind == BspNode::general ? options_.general_node : options_.costs.node;
        return step + plane.share.below * costs[0] + plane.share.above * costs[1];
    }

    /// Gives every piece to one side, or cut to both.
    void distribute(const PlaneSearch& search, const Work& work, const Split& plane,
                    const BspCell (&cells)[2], Work (&sides)[2]) const {
        const double error = plane.is_axis() ? 0 : tolerance_ * plane.n.lpNorm<1>();
        std::vector<double> heights;
        for (const Piece& p : work.pieces) {
            Interval e;
            if (plane.is_axis())
                e = {double(p.box.lower[plane.kind]), double(p.box.upper[plane.kind])};
            else
                e = search.piece_extent(p, plane.n);
            const bool below = e.low<plane.d - error, above = e.high> plane.d + error;
            if (below && above) {
                if (p.count > 0)
                    cut_outline(work, p, plane, heights, sides);
                else
                    for (int s = 0; s < 2; ++s) cut_to_box(p, plane, s, cells[s], sides[s]);
            } else {
                const bool low = below || (!above && plane.flat_below);
                keep(work, p, sides[low ? 0 : 1]);
            }
        }
    }

    static void keep(const Work& work, const Piece& p, Work& side) {
        Piece copy = p;
        copy.first = uint32_t(side.points.size());
        side.points.insert(side.points.end(), work.points.begin() + p.first,
                           work.points.begin() + p.first + p.count);
        side.pieces.push_back(copy);
    }

    static void cut_to_box(const Piece& p, const Split& plane, int s, const BspCell& cell,
                           Work& side) {
        Piece part = p;
        Bounds3 box = p.box;
        if (plane.is_axis())
            (s == 0 ? box.upper : box.lower)[plane.kind] = plane.d;
        else
            box = cut_box(box, plane.n, plane.d, s == 0 ? 1 : -1);
        box = intersection(box, cell.box);
        // What rounding leaves nothing of still touches the cell.
        if (!box.empty()) part.box = box;
        part.first = 0;
        side.pieces.push_back(part);
    }

    /// Sutherland & Hodgman 1974, both sides at once.
    static void cut_outline(const Work& work, const Piece& p, const Split& plane,
                            std::vector<double>& heights, Work (&sides)[2]) {
        const std::span<const Vec3d> c(work.points.data() + p.first, p.count);
        heights.clear();
        for (const Vec3d& x : c) heights.push_back(plane.n.dot(x) - double(plane.d));
        const size_t first[2] = {sides[0].points.size(), sides[1].points.size()};
        for (size_t i = 0; i < c.size(); ++i) {
            const size_t j = (i + 1) % c.size();
            if (heights[i] <= 0) sides[0].points.push_back(c[i]);
            if (heights[i] >= 0) sides[1].points.push_back(c[i]);
            if ((heights[i] < 0 && heights[j] > 0) || (heights[i] > 0 && heights[j] < 0)) {
                Vec3d x = c[i] + (c[j] - c[i]) * (heights[i] / (heights[i] - heights[j]));
                if (plane.is_axis()) x[plane.kind] = plane.d;
                for (Work& side : sides) side.points.push_back(x);
            }
        }
        for (size_t s = 0; s < 2; ++s) {
            Piece part = p;
            part.first = uint32_t(first[s]);
            part.count = uint32_t(sides[s].points.size() - first[s]);
            const Bounds3 box =
                intersection(bounds_of({sides[s].points.data() + first[s], part.count}), p.box);
            if (!box.empty()) part.box = box;
            sides[s].pieces.push_back(part);
        }
    }

    const BspShapes& shapes_;
    const BspOptions& options_;
    int max_depth_;
    float magnitude_;
    double tolerance_;
};

Work all_pieces(const BspShapes& shapes) {
    Work work;
    work.points = shapes.corners;
    work.pieces.reserve(shapes.references.size());
    for (uint32_t i = 0; i < shapes.references.size(); ++i) {
        const BuildReference& r = shapes.references[i];
        Piece p{r.bounds, i, 0, 0, r.cost};
        if (!shapes.first_corner.empty()) {
            p.first = shapes.first_corner[i];
            p.count = shapes.first_corner[i + 1] - p.first;
        }
        work.pieces.push_back(p);
    }
    return work;
}

}  // namespace

BspTreeData build_bsp(const BspShapes& shapes, const BspOptions& options) {
    BspTreeData tree;
    const size_t n = shapes.references.size();
    if (n == 0) return tree;
    for (const BuildReference& r : shapes.references) tree.box.extend(r.bounds);
    const int automatic = int(std::lround(8 + 1.6 * std::log2(double(n))));
    const int depth =
        std::min(options.max_depth > 0 ? options.max_depth : automatic, BspTreeData::max_depth);
    const auto build = [&](int levels, size_t budget) {
        Fragment all;
        tree.cost = Builder(shapes, options, levels, tree.box.magnitude())
                        .build(all_pieces(shapes), {tree.box, {}}, 0, 0, budget, all);
        return all;
    };
    Fragment all = build(depth, 16 * n + 1024);
    // A node has 28 bits for an index.
    if (all.nodes.size() > BspNode::most) all = build(26, 16 * n + 1024);
    tree.nodes = std::move(all.nodes);
    tree.planes = std::move(all.planes);
    tree.references = std::move(all.references);
    return tree;
}

BspEquation equation(const BspNode& node, std::span<const BspPlane> planes) {
    if (node.kind() == BspNode::general) {
        const BspPlane& p = planes[node.value];
        return {Vec3d(p.n[0], p.n[1], p.n[2]), p.d};
    }
    return {direction(int(node.kind())), node.distance()};
}

void walk_cells(std::span<const BspNode> nodes, std::span<const BspPlane> planes,
                const Bounds3& box,
                const std::function<void(uint32_t, const BspCell&, uint32_t)>& visit) {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
        BspCell cell;
    };
    std::vector<Open> open;
    open.push_back({0, 0, {box, {}}});
    while (!open.empty()) {
        const Open o = std::move(open.back());
        open.pop_back();
        visit(o.node, o.cell, o.depth);
        const BspNode& n = nodes[o.node];
        if (n.is_leaf()) continue;
        BspCell cells[2];
        if (!split_cell(o.cell, std::min(n.kind(), 3u), equation(n, planes), box.magnitude(),
                        cells))
            cells[0] = cells[1] = o.cell;
        open.push_back({n.above(), o.depth + 1, std::move(cells[1])});
        open.push_back({o.node + 1, o.depth + 1, std::move(cells[0])});
    }
}

}  // namespace crofton
