#include "framework/exact_triangle.h"

namespace crofton::exact {
namespace {

constexpr double unit = 0x1p-53;  ///< half an ulp in double
/// Error bounds are themselves computed with some thirty roundings.
constexpr double bound_roundings = 1 + 0x1p-40;

}  // namespace

Corners::Corners(std::span<const Vec3f> object, std::shared_ptr<const Placed> placed)
    : object_(object.begin(), object.end()), placed_(std::move(placed)) {
    if (placed_->identity) return;
    world_.resize(object_.size());
    for (size_t i = 0; i < object_.size(); ++i)
        placed_->point(object_[i], world_[i].p, world_[i].radius, world_[i].size);
}

Corners::World Corners::at(uint32_t corner) const {
    if (!world_.empty()) return world_[corner];
    const Vec3f& p = object_[corner];
    return {{p[0], p[1], p[2]}, 0, 0};
}

void Corners::extend(Box& box, uint32_t corner) const {
    const World w = at(corner);
    box.extend(w.p, w.radius);
    box.size = std::max(box.size, w.size);
}

Triple<Interval> Corners::world(uint32_t corner) const {
    const World w = at(corner);
    Triple<Interval> r;
    for (int a = 0; a < 3; ++a)
        r[a] = w.radius == 0 ? Interval(w.p[a]) : Interval::around(w.p[a], w.radius);
    return r;
}

/// Error bound. X = fl(v.x - o.x) and Z alike are wrong by u relatively and the radius e of v,
/// sx = fl(d.x/d.z) by u; fl(sx·Z) by 3u in all, and the difference by u|x|, |x| <= |X| + |Z|:
/// together 2u|X| + 4u|Z| + 2e, to first order, below 8u·max(|X|, |Y|, |Z|) + 2e(1 + 8u).
Corners::Sheared Corners::shear(const DoubleRay& ray, const World& w, double bound,
                                double size_bound) {
    const double X = w.p[ray.kx] - ray.o[ray.kx], Y = w.p[ray.ky] - ray.o[ray.ky],
                 Z = w.p[ray.kz] - ray.o[ray.kz];
    const double reach = std::max(std::max(std::abs(X), std::abs(Y)), std::abs(Z));
    const double displaced = bound * reach + size_bound * w.size;
    const double least = bound > 0 ? least_bound : 0x1p-1000;
    return {X - ray.sx * Z, Y - ray.sy * Z, Z,
            ((8 * unit) * reach + 2 * w.radius + displaced) * bound_roundings + least,
            (2 * unit * std::abs(Z) + w.radius + size_bound * w.size) * bound_roundings};
}

Triple<Dyadic> Corners::shear(const ExactRay& ray, const Triple<Dyadic>& corner) {
    const Triple<Dyadic> v = corner - ray.o;
    const Dyadic &dz = ray.d[ray.kz], &z = v[ray.kz];
    return {{v[ray.kx] * dz - ray.d[ray.kx] * z, v[ray.ky] * dz - ray.d[ray.ky] * z, z}};
}

Triangles::Triangles(std::span<const Vec3f> positions,
                     std::span<const std::array<uint32_t, 3>> triangles,
                     std::shared_ptr<const Placed> placed)
    : corners_(positions, std::move(placed)), triangles_(triangles.begin(), triangles.end()) {}

bool Triangles::active(uint32_t i) const {
    const auto& t = triangles_[i];
    return corners_.finite(t[0]) && corners_.finite(t[1]) && corners_.finite(t[2]);
}

Box Triangles::bounds(uint32_t i) const {
    Box box;
    for (uint32_t corner : triangles_[i]) corners_.extend(box, corner);
    return box;
}

namespace {

/// With corners known to within r, the edge function w = x1·y2 - x2·y1 is wrong by at most
/// r1(|x2| + |y2|) + r2(|x1| + |y1|) + 2·r1·r2 through them and 2u(|x1·y2| + |x2·y1|) by its own
/// roundings. The weighted depth t = z0 + (w1·(z1 - z0) + w2·(z2 - z0))/(w0 + w1 + w2) follows by
/// the rules for sums, products and quotients of numbers with known errors.
void find_candidates(const DoubleRay& ray, const Corners::Sheared (&c)[3], double scale,
                     Candidates& out) {
    double w[3], e[3];
    int positive = 0, negative = 0;
    for (int k = 0; k < 3; ++k) {
        const Corners::Sheared &p = c[(k + 1) % 3], &q = c[(k + 2) % 3];
        const double a = p.x * q.y, b = q.x * p.y;
        w[k] = a - b;
        e[k] = (p.radius * (std::abs(q.x) + std::abs(q.y)) +
                q.radius * (std::abs(p.x) + std::abs(p.y)) + 2 * p.radius * q.radius +
                (4 * unit) * (std::abs(a) + std::abs(b))) *
               bound_roundings;
        positive += w[k] > e[k];
        negative += w[k] < -e[k];
    }
    if (positive && negative) return;
    Candidate hit;
    hit.sure = positive == 3 || negative == 3;

    const double sum = w[0] + w[1] + w[2];
    const double e_sum =
        e[0] + e[1] + e[2] + (4 * unit) * (std::abs(w[0]) + std::abs(w[1]) + std::abs(w[2]));
    const double dz = ray.d[ray.kz];
    const double z0 = c[0].z / dz, g1 = c[1].z / dz - z0, g2 = c[2].z / dz - z0;
    const double largest = std::max({std::abs(c[0].z), std::abs(c[1].z), std::abs(c[2].z)});
    const double e_z =
        (4 * unit * largest + 2 * std::max({c[0].z_radius, c[1].z_radius, c[2].z_radius})) /
        std::abs(dz);
    if (std::abs(sum) > e_sum) {
        const double q = (w[1] * g1 + w[2] * g2) / sum;
        const double e_top = e[1] * std::abs(g1) + e[2] * std::abs(g2) +
                             (std::abs(w[1]) + std::abs(w[2]) + e[1] + e[2]) * e_z +
                             (4 * unit) * (std::abs(w[1] * g1) + std::abs(w[2] * g2));
        const double e_t = ((e_top + std::abs(q) * e_sum) / (std::abs(sum) - e_sum) + e_z +
                            (4 * unit) * (std::abs(q) + std::abs(z0))) *
                           bound_roundings;
        hit.lo = Interval::down(z0 + q - e_t);
        hit.hi = Interval::up(z0 + q + e_t);
    }
    // No weighted depth leaves the range of the corners.
    const double low = z0 + std::min({0.0, g1, g2}) - 2 * e_z;
    const double high = z0 + std::max({0.0, g1, g2}) + 2 * e_z;
    if (!(hit.lo >= low)) hit.lo = Interval::down(low);
    if (!(hit.hi <= high)) hit.hi = Interval::up(high);
    hit.widen(scale * ray.t_bound);
    hit.lo -= scale * least_t_bound;
    hit.hi += scale * least_t_bound;
    out.add(hit);
}

void solve_sheared(const ExactRay& ray, const Triple<Dyadic> (&c)[3], std::vector<Root>& out) {
    Dyadic w[3];
    int positive = 0, negative = 0;
    for (int k = 0; k < 3; ++k) {
        const auto &p = c[(k + 1) % 3], &q = c[(k + 2) % 3];
        w[k] = p[0] * q[1] - q[0] * p[1];
        positive += w[k].sign() > 0;
        negative += w[k].sign() < 0;
        if (positive && negative) return;
    }
    if (positive == negative) return;  // all zero: seen edge-on, or no area
    out.push_back(Root::fraction(w[0] * c[0][2] + w[1] * c[1][2] + w[2] * c[2][2],
                                 (w[0] + w[1] + w[2]) * ray.d[ray.kz]));
}

}  // namespace

void Triangles::candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const {
    Corners::Sheared c[3];
    for (int k = 0; k < 3; ++k)
        c[k] =
            corners_.shear(ray, triangles_[i][k], scale * triangle_bound, scale * triangle_bound);
    find_candidates(ray, c, scale, out);
}

void Triangles::solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const {
    Triple<Dyadic> c[3];
    for (int k = 0; k < 3; ++k) c[k] = corners_.shear(ray, triangles_[i][k]);
    solve_sheared(ray, c, out);
}

void triangle_candidates(const DoubleRay& ray, const Vec3f (&v)[3], Candidates& out) {
    Corners::Sheared c[3];
    for (int k = 0; k < 3; ++k)
        c[k] = Corners::shear(ray, {{v[k][0], v[k][1], v[k][2]}, 0, 0}, 0, 0);
    find_candidates(ray, c, 0, out);
}

void solve_triangle(const ExactRay& ray, const Vec3f (&v)[3], std::vector<Root>& out) {
    Triple<Dyadic> c[3];
    for (int k = 0; k < 3; ++k) c[k] = Corners::shear(ray, triple<Dyadic>(v[k]));
    solve_sheared(ray, c, out);
}

}  // namespace crofton::exact
