#include "accelerators/polyhedron.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace crofton {

Polyhedron Polyhedron::box(const Bounds3& bounds) {
    Polyhedron p;
    const Vec3d lower = bounds.lower.cast<double>(), upper = bounds.upper.cast<double>();
    for (int i = 0; i < 8; ++i)
        p.points.emplace_back(i & 1 ? upper[0] : lower[0], i & 2 ? upper[1] : lower[1],
                              i & 4 ? upper[2] : lower[2]);
    for (uint32_t a = 0; a < 3; ++a) {
        const uint32_t u = 1u << (a + 1) % 3, v = 1u << (a + 2) % 3;
        for (uint32_t side = 0; side < 2; ++side) {
            const uint32_t base = side << a;
            Vec3d normal = Vec3d::Zero();
            normal[a] = side ? 1 : -1;
            p.faces.push_back({uint32_t(p.corners.size()), 4, normal});
            p.corners.insert(p.corners.end(), {base, base + u, base + u + v, base + v});
        }
    }
    return p;
}

Bounds3 Polyhedron::bounds() const {
    Bounds3 b;
    for (const Vec3d& p : points)
        for (int a = 0; a < 3; ++a) {
            const float x = float(p[a]);
            b.lower[a] = std::min(b.lower[a], double(x) > p[a] ? std::nextafter(x, -INFINITY) : x);
            b.upper[a] = std::max(b.upper[a], double(x) < p[a] ? std::nextafter(x, INFINITY) : x);
        }
    return b;
}

std::array<double, 2> Polyhedron::extent(const Vec3d& n) const {
    std::array<double, 2> e{INFINITY, -INFINITY};
    for (const Vec3d& p : points) {
        const double x = n.dot(p);
        e[0] = std::min(e[0], x);
        e[1] = std::max(e[1], x);
    }
    return e;
}

double Polyhedron::area() const { return CellAreas(*this).total(); }

namespace {

/// One cut: keeps what is below, closes it with a new face.
class Cut {
  public:
    Cut(const Polyhedron& from, const Vec3d& n, double d, double tolerance) : from_(from) {
        for (const Vec3d& p : from.points) {
            const double x = n.dot(p) - d;
            height_.push_back(std::abs(x) <= tolerance ? 0 : x);
            above_ = above_ || height_.back() > 0;
            below_ = below_ || height_.back() < 0;
        }
        moved_.assign(from.points.size(), none);
    }
    bool any_above() const { return above_; }
    bool any_below() const { return below_; }

    Polyhedron run(const Vec3d& n) {
        for (const Polyhedron::Face& face : from_.faces) cut_face(face);
        close(n.normalized());
        return std::move(to_);
    }

  private:
    static constexpr uint32_t none = ~0u;
    struct Crossing {
        uint32_t from, to, point;
    };

    void cut_face(const Polyhedron::Face& face) {
        const uint32_t first = uint32_t(to_.corners.size());
        for (uint32_t k = 0; k < face.count; ++k) {
            const uint32_t i = from_.corners[face.first + k];
            const uint32_t j = from_.corners[face.first + (k + 1) % face.count];
            if (height_[i] <= 0) to_.corners.push_back(kept(i));
            if ((height_[i] < 0 && height_[j] > 0) || (height_[i] > 0 && height_[j] < 0))
                to_.corners.push_back(crossing(std::min(i, j), std::max(i, j)));
        }
        const uint32_t count = uint32_t(to_.corners.size()) - first;
        if (count >= 3)
            to_.faces.push_back({first, count, face.normal});
        else
            to_.corners.resize(first);
    }

    uint32_t kept(uint32_t i) {
        if (moved_[i] == none) {
            moved_[i] = uint32_t(to_.points.size());
            to_.points.push_back(from_.points[i]);
            if (height_[i] == 0) rim_.push_back(moved_[i]);
        }
        return moved_[i];
    }

    uint32_t crossing(uint32_t i, uint32_t j) {
        for (const Crossing& c : crossings_)
            if (c.from == i && c.to == j) return c.point;
        const double s = height_[i] / (height_[i] - height_[j]);
        const uint32_t point = uint32_t(to_.points.size());
        to_.points.push_back(from_.points[i] + (from_.points[j] - from_.points[i]) * s);
        crossings_.push_back({i, j, point});
        rim_.push_back(point);
        return point;
    }

    /// The new face: all points in the plane, by their angle around the middle.
    void close(const Vec3d& normal) {
        if (rim_.size() < 3) return;
        Vec3d middle = Vec3d::Zero();
        for (const uint32_t i : rim_) middle += to_.points[i] / double(rim_.size());
        const Vec3d u = normal.unitOrthogonal(), v = normal.cross(u);
        std::vector<std::pair<double, uint32_t>> around;
        for (const uint32_t i : rim_) {
            const Vec3d x = to_.points[i] - middle;
            around.emplace_back(std::atan2(v.dot(x), u.dot(x)), i);
        }
        std::sort(around.begin(), around.end());
        to_.faces.push_back({uint32_t(to_.corners.size()), uint32_t(around.size()), normal});
        for (const auto& [angle, i] : around) to_.corners.push_back(i);
    }

    const Polyhedron& from_;
    Polyhedron to_;
    std::vector<double> height_;
    std::vector<uint32_t> moved_, rim_;
    std::vector<Crossing> crossings_;
    bool above_ = false, below_ = false;
};

}  // namespace

Polyhedron clipped(const Polyhedron& p, const Vec3d& n, double d, double tolerance) {
    Cut cut(p, n, d, tolerance);
    if (!cut.any_above()) return p;
    if (!cut.any_below()) return {};
    return cut.run(n);
}

CellAreas::CellAreas(const Polyhedron& cell) : cell_(cell) {
    for (uint32_t f = 0; f < cell.faces.size(); ++f) {
        const Polyhedron::Face& face = cell.faces[f];
        const uint32_t* corner = cell.corners.data() + face.first;
        for (uint32_t k = 2; k < face.count; ++k) {
            const Vec3d& a = cell.points[corner[0]];
            const Vec3d& b = cell.points[corner[k - 1]];
            const Vec3d& c = cell.points[corner[k]];
            const double area = 0.5 * (b - a).cross(c - a).norm();
            if (!(area > 0)) continue;
            triangles_.push_back({{corner[0], corner[k - 1], corner[k]}, f, area});
            total_ += area;
        }
    }
}

void AreaProfile::look_along(const CellAreas& areas, const Vec3d& n) {
    total_ = areas.total_;
    const double scale = 1 / n.norm();
    heights_.clear();
    lowest_ = INFINITY, highest_ = -INFINITY;
    for (const Vec3d& p : areas.cell_.points) {
        heights_.push_back(n.dot(p));
        lowest_ = std::min(lowest_, heights_.back());
        highest_ = std::max(highest_, heights_.back());
    }
    projected_.clear();
    for (const CellAreas::Triangle& t : areas.triangles_) {
        const double a = heights_[t.corner[0]], b = heights_[t.corner[1]],
                     c = heights_[t.corner[2]];
        const double low = std::min({a, b, c}), high = std::max({a, b, c});
        const double middle = std::max(std::min(a, b), std::min(std::max(a, b), c));
        projected_.push_back(
            {low, middle, high, t.area, areas.cell_.faces[t.face].normal.dot(n) * scale});
    }
}

AreaProfile::Parts AreaProfile::at(double d) const {
    double below = 0, flux = 0;
    for (const Projected& t : projected_) {
        if (t.low >= d) continue;
        double part = t.area;
        if (t.high > d) {
            // Similar triangles below the middle corner, and above it.
            if (d <= t.middle)
                part *= (d - t.low) / (t.middle - t.low) * ((d - t.low) / (t.high - t.low));
            else
                part *= 1 - (t.high - d) / (t.high - t.middle) * ((t.high - d) / (t.high - t.low));
        }
        below += part;
        flux += part * t.along;
    }
    const double cut = std::max(0.0, -flux);
    return {below + cut, std::max(0.0, total_ - below) + cut};
}

}  // namespace crofton
