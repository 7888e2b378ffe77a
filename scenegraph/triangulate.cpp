#include "scenegraph/triangulate.h"

#include <cmath>

namespace crofton {
namespace {

struct Point2 {
    double x, y;
};

/// Twice the signed area; positive if a, b, c turn left.
double turn(const Point2& a, const Point2& b, const Point2& c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// Newell's normal: the sum of the signed areas in the three coordinate planes.
Vec3d newell_normal(const std::vector<Vec3f>& positions, std::span<const uint32_t> corners) {
    const Vec3d origin = positions[corners[0]].cast<double>();
    Vec3d normal = Vec3d::Zero();
    Vec3d a = positions[corners.back()].cast<double>() - origin;
    for (uint32_t corner : corners) {
        const Vec3d b = positions[corner].cast<double>() - origin;
        normal += Vec3d(a.y() * b.z() - a.z() * b.y(), a.z() * b.x() - a.x() * b.z(),
                        a.x() * b.y() - a.y() * b.x());
        a = b;
    }
    return normal;
}

/// The polygon without its dominant axis, counterclockwise; empty if it has no plane.
std::vector<Point2> projected(const std::vector<Vec3f>& positions,
                              std::span<const uint32_t> corners) {
    const Vec3d normal = newell_normal(positions, corners);
    int axis;
    if (!normal.allFinite() || normal.cwiseAbs().maxCoeff(&axis) == 0) return {};
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    std::vector<Point2> points;
    points.reserve(corners.size());
    for (uint32_t corner : corners) {
        const Vec3f& p = positions[corner];
        // A mirror image turns a clockwise polygon round.
        points.push_back({normal[axis] < 0 ? -double(p[u]) : double(p[u]), double(p[v])});
    }
    return points;
}

/// Whether no corner turns right and the outline goes round once: x rises once and falls once.
bool is_convex(const std::vector<Point2>& points) {
    const size_t n = points.size();
    for (size_t i = 0; i < n; ++i)
        if (turn(points[i], points[(i + 1) % n], points[(i + 2) % n]) < 0) return false;
    int changes = 0;
    double last_dx = 0;
    for (size_t i = 0; i <= n; ++i) {
        const double dx = points[(i + 1) % n].x - points[i % n].x;
        if (dx == 0) continue;
        if (last_dx != 0 && (dx < 0) != (last_dx < 0)) ++changes;
        last_dx = dx;
    }
    return changes <= 2;
}

/// Cuts ears off a counterclockwise polygon, kept as a ring of the corners that are left.
class EarCutter {
  public:
    explicit EarCutter(const std::vector<Point2>& points) : points_(points) {
        const uint32_t n = uint32_t(points.size());
        next_.resize(n);
        previous_.resize(n);
        for (uint32_t i = 0; i < n; ++i) {
            next_[i] = (i + 1) % n;
            previous_[i] = (i + n - 1) % n;
        }
        for (uint32_t i = 0; i < n; ++i)
            if (turn_at(i) <= 0) reflex_.push_back(i);
        for (uint32_t i = 0; i < n; ++i) ear_.push_back(is_ear(i));
    }

    /// Calls cut(a, b, c) for each of the n − 2 triangles.
    template <class Cut>
    void run(Cut cut) {
        uint32_t left = uint32_t(points_.size()), corner = 0, refused = 0;
        while (left > 3) {
            // With all corners refused the polygon is not simple: cut anywhere.
            if (refused < left && !ear_[corner]) {
                corner = next_[corner];
                ++refused;
                continue;
            }
            const uint32_t before = previous_[corner], after = next_[corner];
            cut(before, corner, after);
            next_[before] = after;
            previous_[after] = before;
            next_[corner] = corner;  // marks it as gone
            --left;
            refused = 0;
            corner = after;
            drop_corners_not_reflex();
            // Whether other corners are ears does not change.
            ear_[before] = is_ear(before);
            ear_[after] = is_ear(after);
        }
        cut(previous_[corner], corner, next_[corner]);
    }

  private:
    double turn_at(uint32_t i) const {
        return turn(points_[previous_[i]], points_[i], points_[next_[i]]);
    }
    bool is_ear(uint32_t i) const {
        if (turn_at(i) <= 0) return false;
        const uint32_t before = previous_[i], after = next_[i];
        const Point2 &a = points_[before], &b = points_[i], &c = points_[after];
        for (uint32_t r : reflex_) {
            if (r == before || r == i || r == after) continue;
            const Point2& p = points_[r];
            if (turn(a, b, p) < 0 || turn(b, c, p) < 0 || turn(c, a, p) < 0) continue;
            if (same(p, a) || same(p, b) || same(p, c)) continue;
            return false;
        }
        return true;
    }
    static bool same(const Point2& p, const Point2& q) { return p.x == q.x && p.y == q.y; }
    void drop_corners_not_reflex() {
        std::erase_if(reflex_, [&](uint32_t i) { return next_[i] == i || turn_at(i) > 0; });
    }

    const std::vector<Point2>& points_;
    std::vector<uint32_t> next_, previous_;
    std::vector<bool> ear_;
    std::vector<uint32_t> reflex_;  ///< corners that are left and do not turn left
};

}  // namespace

bool triangulate(const std::vector<Vec3f>& positions, std::span<const uint32_t> corners,
                 std::vector<std::array<uint32_t, 3>>& triangles) {
    const size_t n = corners.size();
    if (n > 3) {
        const std::vector<Point2> points = projected(positions, corners);
        if (!points.empty() && !is_convex(points)) {
            if (n > kMaxConcaveCorners) return false;
            EarCutter(points).run([&](uint32_t a, uint32_t b, uint32_t c) {
                triangles.push_back({corners[a], corners[b], corners[c]});
            });
            return true;
        }
    }
    for (size_t i = 2; i < n; ++i) triangles.push_back({corners[0], corners[i - 1], corners[i]});
    return true;
}

}  // namespace crofton
