#include "scenegraph/splats.h"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>

#include "framework/parallel.h"

namespace crofton {
namespace {

constexpr uint32_t neighbours = 4;

/// The nearest others of one point, by (distance, index).
struct Nearest {
    struct Entry {
        double distance2;
        uint32_t index;
        bool operator<(const Entry& o) const {
            return distance2 != o.distance2 ? distance2 < o.distance2 : index < o.index;
        }
    };
    std::array<Entry, neighbours> entries;  ///< ascending
    uint32_t count = 0;

    /// What is farther does not belong here.
    double limit2() const {
        return count < neighbours ? std::numeric_limits<double>::infinity()
                                  : entries[neighbours - 1].distance2;
    }
    void add(const Entry& e) {
        if (count == neighbours && !(e < entries[neighbours - 1])) return;
        uint32_t i = count < neighbours ? count++ : neighbours - 1;
        for (; i > 0 && e < entries[i - 1]; --i) entries[i] = entries[i - 1];
        entries[i] = e;
    }
    double spacing() const { return count ? std::sqrt(entries[count - 1].distance2) : 0; }
};

/// A balanced kd-tree without pointers (Bentley 1975): the middle of a range is its node, split on
/// the longest side of what is in the range; so a search is no deeper than log2 of the points.
class PointTree {
  public:
    explicit PointTree(std::vector<Vec3f> points) : points_(std::move(points)) {
        axes_.resize(points_.size());
        build(0, points_.size());
    }
    const std::vector<Vec3f>& points() const { return points_; }

    Nearest nearest(uint32_t i) const {
        Nearest found;
        search(0, points_.size(), i, found);
        return found;
    }

  private:
    void build(size_t begin, size_t end) {
        if (end - begin < 2) return;
        Bounds3 b;
        for (size_t i = begin; i < end; ++i) b.extend(points_[i]);
        int axis;
        b.extent().maxCoeff(&axis);
        const size_t middle = begin + (end - begin) / 2;
        std::nth_element(points_.begin() + begin, points_.begin() + middle, points_.begin() + end,
                         [axis](const Vec3f& a, const Vec3f& c) { return a[axis] < c[axis]; });
        axes_[middle] = uint8_t(axis);
        const auto below = [&] { build(begin, middle); };
        const auto above = [&] { build(middle + 1, end); };
        if (end - begin > 8192) {
            parallel_invoke(below, above);
        } else {
            below();
            above();
        }
    }

    void search(size_t begin, size_t end, uint32_t of, Nearest& found) const {
        if (begin == end) return;
        const size_t middle = begin + (end - begin) / 2;
        const Vec3d offset = points_[of].cast<double>() - points_[middle].cast<double>();
        if (middle != of) found.add({offset.squaredNorm(), uint32_t(middle)});
        if (end - begin == 1) return;
        // A range on both sides of the plane: the nearer one first.
        const double across = offset[axes_[middle]];
        const bool below = across < 0 || (across == 0 && of < middle);
        below ? search(begin, middle, of, found) : search(middle + 1, end, of, found);
        if (across * across > found.limit2()) return;
        below ? search(middle + 1, end, of, found) : search(begin, middle, of, found);
    }

    std::vector<Vec3f> points_;
    std::vector<uint8_t> axes_;  ///< that a node splits
};

bool place_less(const Vec3f& a, const Vec3f& b) {
    return std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end());
}

/// Distinct finite places, ascending.
std::vector<Vec3f> places_of(const std::vector<Vec3f>& positions) {
    std::vector<Vec3f> places;
    for (const Vec3f& p : positions)
        if (p.allFinite()) places.push_back(p);
    std::sort(places.begin(), places.end(), place_less);
    places.erase(std::unique(places.begin(), places.end()), places.end());
    return places;
}

/// Radii of the places of a tree, in its order.
std::vector<float> radii_of(const PointTree& tree) {
    const size_t n = tree.points().size();
    std::vector<Nearest> nearest(n);
    parallel_for(n, 256, [&](size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) nearest[i] = tree.nearest(uint32_t(i));
    });
    std::vector<float> radii(n);
    for (size_t i = 0; i < n; ++i) {
        double widest = 0;
        for (uint32_t k = 0; k < nearest[i].count; ++k)
            widest = std::max(widest, nearest[nearest[i].entries[k].index].spacing());
        radii[i] = float(std::min(nearest[i].spacing(), 2 * widest));
    }
    return radii;
}

}  // namespace

std::vector<float> splat_radii(const std::vector<Vec3f>& positions) {
    const PointTree tree(places_of(positions));
    const std::vector<float> by_tree = radii_of(tree);
    // Back from the tree's order to that of the places, to look positions up.
    std::vector<uint32_t> order(by_tree.size());
    std::iota(order.begin(), order.end(), 0u);
    std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) {
        return place_less(tree.points()[a], tree.points()[b]);
    });
    std::vector<float> radii;
    radii.reserve(positions.size());
    for (const Vec3f& p : positions) {
        const auto at = std::lower_bound(
            order.begin(), order.end(), p,
            [&](uint32_t i, const Vec3f& v) { return place_less(tree.points()[i], v); });
        radii.push_back(p.allFinite() ? by_tree[*at] : 0.0f);
    }
    return radii;
}

std::vector<QuadricShape> splats(const Points& points) {
    const std::vector<float> radii =
        points.radii.empty() ? splat_radii(points.positions) : points.radii;
    std::vector<QuadricShape> shapes;
    shapes.reserve(points.positions.size());
    for (uint32_t i = 0; i < points.positions.size(); ++i) {
        if (is_disc(points, i))
            shapes.push_back(
                {QuadricKind::disc, points.positions[i], radii[i], points.normals[i], 0});
        else
            shapes.push_back(
                {QuadricKind::sphere, points.positions[i], radii[i], Vec3f::Zero(), 0});
    }
    return shapes;
}

}  // namespace crofton
