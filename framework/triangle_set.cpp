#include "framework/triangle_set.h"

#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "framework/cost.h"
#include "framework/error.h"
#include "framework/triangle_slack.h"

namespace crofton {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

/// 1.1u of the extent on an axis and 2.6u of the largest. Scaled before the subtraction, which then
/// cannot overflow.
Vec3f slack_of(const Bounds3& b) {
    const Vec3f u = b.upper * 0x1p-24f - b.lower * 0x1p-24f;
    return (u * 1.1f).array() + u.maxCoeff() * 2.6f;
}

}  // namespace

TriangleSet::TriangleSet(Positions positions, Triangles triangles, IdTable ids, ShapeGroups groups)
    : triangles_(std::move(triangles)), ids_(std::move(ids)), groups_(std::move(groups)) {
    Indices most{0, 0, 0};
    for (const Indices& t : triangles_)
        for (size_t k = 0; k < 3; ++k) most[k] = std::max(most[k], t[k]);
    if (!triangles_.empty() && std::max({most[0], most[1], most[2]}) >= positions.size())
        refuse_indices(positions.size());
    positions.push_back(Vec3f::Zero());
    own(std::move(positions));
}

void TriangleSet::refuse_indices(size_t positions) const {
    for (size_t i = 0; i < triangles_.size(); ++i)
        for (uint32_t index : triangles_[i])
            if (index >= positions)
                throw InputError("triangle " + std::to_string(i) + ": vertex index " +
                                 std::to_string(index) + " of " + std::to_string(positions));
}

TriangleSet TriangleSet::subset(std::span<const uint32_t> shapes) const {
    TriangleSet part;
    part.positions_ = positions_;
    part.vertices_ = vertices_;
    part.part_ = true;
    part.triangles_.reserve(shapes.size());
    for (uint32_t i : shapes) part.triangles_.push_back(triangles_[i]);
    part.ids_ = ids_.subset(shapes);
    part.groups_ = groups_of_part(groups_, shapes);
    return part;
}

bool TriangleSet::active(uint32_t i) const {
    // Zero times what is not finite is NaN; the fourth lane is of no vertex.
    const hn::FixedTag<float, 4> d;
    const float* const at = coordinates();
    const auto zeros = [&](size_t k) {
        return hn::Mul(hn::LoadU(d, at + size_t{3} * triangles_[i][k]), hn::Zero(d));
    };
    const auto sum = hn::Add(hn::Add(zeros(0), zeros(1)), zeros(2));
    uint8_t bits[8];
    hn::StoreMaskBits(d, hn::Eq(sum, hn::Zero(d)), bits);
    return (bits[0] & 7) == 7;
}

Bounds3 TriangleSet::corner_bounds(uint32_t i) const {
    Bounds3 b;
    for (int k = 0; k < 3; ++k) b.extend(vertex(i, k));
    return b;
}

Bounds3 TriangleSet::bounds(uint32_t i) const {
    const hn::FixedTag<float, 4> d;
    const float* const at = coordinates();
    const auto corner = [&](size_t k) { return hn::LoadU(d, at + size_t{3} * triangles_[i][k]); };
    const auto a = corner(0), b = corner(1), c = corner(2);
    const auto box =
        HWY_NAMESPACE::with_slack(hn::Min(hn::Min(a, b), c), hn::Max(hn::Max(a, b), c));
    alignas(16) float l[4], u[4];
    hn::Store(box.lower, d, l);
    hn::Store(box.upper, d, u);
    return {{l[0], l[1], l[2]}, {u[0], u[1], u[2]}};
}

Vec3f TriangleSet::slack(uint32_t i) const { return slack_of(corner_bounds(i)); }

double TriangleSet::cost(uint32_t) const { return cost_constants.triangle_block / 4; }

uint64_t TriangleSet::bytes() const {
    const size_t vertices = part_ ? 0 : positions_->size();
    return vertices * sizeof(Vec3f) + triangles_.size() * sizeof(Indices) + ids_.bytes();
}

Bounds3 TriangleSet::clipped_bounds(uint32_t i, const Bounds3& box) const {
    // Sutherland–Hodgman in double against the six planes: at most 3 + 6 corners.
    Vec3d polygon[10], next[10];
    int n = 3;
    for (int k = 0; k < 3; ++k) polygon[k] = vertex(i, k).cast<double>();
    for (int plane = 0; plane < 6 && n > 0; ++plane) {
        const int a = plane >> 1;
        const double sign = plane & 1 ? -1 : 1;
        const double at = plane & 1 ? -double(box.upper[a]) : double(box.lower[a]);
        bool cut = false;
        for (int k = 0; k < n; ++k) cut = cut || sign * polygon[k][a] < at;
        if (!cut) continue;
        int m = 0;
        for (int k = 0; k < n; ++k) {
            const Vec3d& p = polygon[k];
            const Vec3d& q = polygon[k + 1 == n ? 0 : k + 1];
            const double dp = sign * p[a] - at, dq = sign * q[a] - at;
            if (dp >= 0) next[m++] = p;
            if ((dp < 0) != (dq < 0)) {
                next[m] = p + (q - p) * (dp / (dp - dq));
                next[m++][a] = sign * at;
            }
        }
        n = m;
        std::copy(next, next + m, polygon);
    }
    if (n == 0) return {};
    Vec3d lower = polygon[0], upper = polygon[0];
    for (int k = 1; k < n; ++k) {
        lower = lower.cwiseMin(polygon[k]);
        upper = upper.cwiseMax(polygon[k]);
    }
    Bounds3 out;
    for (int a = 0; a < 3; ++a) {
        // One float step outwards covers the rounding of the cut and of the conversion.
        out.lower[a] = std::nextafter(float(lower[a]), -INFINITY);
        out.upper[a] = std::nextafter(float(upper[a]), INFINITY);
    }
    return intersection(out, intersection(box, corner_bounds(i)));
}

uint32_t TriangleLeaves::add(const TriangleSet& set, std::span<const uint32_t> shapes) {
    const uint32_t first = uint32_t(blocks_.size());
    blocks_.resize(first + room(uint32_t(shapes.size())));
    put(set, shapes, first);
    return first;
}

void TriangleLeaves::put(const TriangleSet& set, std::span<const uint32_t> shapes, uint32_t first) {
    for (size_t i = 0; i < shapes.size(); i += width) {
        TriangleBlock<width>& block = blocks_[first + i / width];
        const size_t used = std::min<size_t>(width, shapes.size() - i);
        for (size_t lane = 0; lane < used; ++lane) {
            block.id[lane] = shapes[i + lane];
            for (int k = 0; k < 3; ++k) {
                const Vec3f p = set.vertex(shapes[i + lane], k);
                for (int a = 0; a < 3; ++a) block.v[k][a][lane] = p[a];
            }
        }
        for (size_t lane = used; lane < width; ++lane) {
            block.id[lane] = no_id;
            for (int k = 0; k < 3; ++k)
                for (int a = 0; a < 3; ++a)
                    block.v[k][a][lane] = std::numeric_limits<float>::quiet_NaN();
        }
    }
}

double TriangleLeaves::cost(double, uint32_t count) {
    return cost_constants.triangle_block * room(count);
}

namespace {

/// Weights of the point of a triangle's edges that is nearest to the origin.
void nearest_on_edges(const double (&x)[3], const double (&y)[3], double (&weights)[3]) {
    double nearest = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3;
        const double dx = x[j] - x[i], dy = y[j] - y[i], length2 = dx * dx + dy * dy;
        const double along = -(x[i] * dx + y[i] * dy);
        const double s = length2 > 0 ? std::clamp(along / length2, 0.0, 1.0) : 0;
        const double px = x[i] + s * dx, py = y[i] + s * dy, distance2 = px * px + py * py;
        if (!(distance2 < nearest)) continue;
        nearest = distance2;
        weights[i] = 1 - s;
        weights[j] = s;
        weights[3 - i - j] = 0;
    }
}

}  // namespace

bool refine_triangle(const float (&v)[3][3], const RayQuery& q, float& t, float& u, float& w) {
    // The sheared corners, rounded as in the SIMD test: shared by all triangles at an edge, so that
    // exact signs on them partition the plane without gaps. Products of two floats are exact in
    // double, and a difference keeps its sign.
    float px[3], py[3];
    for (int i = 0; i < 3; ++i) {
        const float pz = v[i][q.kz] - q.origin[q.kz];
        px[i] = (v[i][q.kx] - q.origin[q.kx]) - q.shear_x * pz;
        py[i] = (v[i][q.ky] - q.origin[q.ky]) - q.shear_y * pz;
    }
    const double e[3] = {double(px[2]) * py[1] - double(py[2]) * px[1],
                         double(px[0]) * py[2] - double(py[0]) * px[2],
                         double(px[1]) * py[0] - double(py[1]) * px[0]};
    const bool negative = e[0] < 0 || e[1] < 0 || e[2] < 0;
    const bool positive = e[0] > 0 || e[1] > 0 || e[2] > 0;
    if (negative == positive) return false;  // outside, edge-on (all zero), or NaN

    // Again in double, times the direction's main component, so that nothing is divided.
    const double dx = q.direction[q.kx], dy = q.direction[q.ky], dz = q.direction[q.kz];
    double x[3], y[3], z[3];
    for (int i = 0; i < 3; ++i) {
        z[i] = double(v[i][q.kz]) - q.origin[q.kz];
        x[i] = (double(v[i][q.kx]) - q.origin[q.kx]) * dz - dx * z[i];
        y[i] = (double(v[i][q.ky]) - q.origin[q.ky]) * dz - dy * z[i];
    }
    const double b[3] = {x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2],
                         x[1] * y[0] - y[1] * x[0]};
    const double det = b[0] + b[1] + b[2];
    const double reach = std::max({std::abs(x[0]), std::abs(x[1]), std::abs(x[2]), std::abs(y[0]),
                                   std::abs(y[1]), std::abs(y[2])});
    const bool inside =
        positive ? b[0] >= 0 && b[1] >= 0 && b[2] >= 0 : b[0] <= 0 && b[1] <= 0 && b[2] <= 0;
    const double per_det = 1.0 / det, per_z = 1.0 / dz;
    double weights[3] = {b[0] * per_det, b[1] * per_det, b[2] * per_det};
    // Where double sees the ray pass outside, or too little area for weights, the boundary is
    // within the rounding of the shear: its nearest point is the hit. (The plane would be met
    // anywhere if it is seen edge-on; a structure may rely on a hit being a point of the triangle.)
    if (!inside || !(std::abs(det) > 0x1p-31 * reach * reach)) nearest_on_edges(x, y, weights);
    const double at = (weights[0] * z[0] + weights[1] * z[1] + weights[2] * z[2]) * per_z;
    const double first = std::min({z[0], z[1], z[2]}) * per_z,
                 last = std::max({z[0], z[1], z[2]}) * per_z;
    t = float(std::clamp(at, std::min(first, last), std::max(first, last)));
    u = float(std::clamp(weights[1], 0.0, 1.0));
    w = float(std::clamp(weights[2], 0.0, 1.0));
    return true;
}

}  // namespace crofton
