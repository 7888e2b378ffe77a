#include "framework/exact_polygon.h"

namespace crofton::exact {
namespace {

/// Newell's normal about the first corner; twice the area long.
template <class N, class Corner>
Triple<N> newell(uint32_t begin, uint32_t end, const Corner& corner) {
    Triple<N> n{};
    const Triple<N> o = corner(begin);
    Triple<N> last = corner(begin) - o;
    for (uint32_t k = begin + 1; k < end; ++k) {
        const Triple<N> next = corner(k) - o;
        n = n + cross(last, next);
        last = next;
    }
    return n;
}

/// Where an edge, as the ray sees it, crosses the x axis (half-open in y).
enum class Side { none, left, right, on_edge, unsure };

template <class N>
struct Crossing {
    Side side = Side::none;
    N x, z, rise;  ///< at (x/rise, 0, z/rise), rise > 0
};

/// The edge from a to b, taken upwards.
Crossing<Dyadic> crossing(const Triple<Dyadic>& a, const Triple<Dyadic>& b) {
    const Dyadic side = a[0] * b[1] - b[0] * a[1];
    if (side.sign() == 0) {
        // In one line with the origin, which is between them or is not.
        const bool between = (a[0] * b[0]).sign() <= 0 && (a[1] * b[1]).sign() <= 0;
        if (!between) return {};
        // Where the line passes the origin: by y, or else by x; or else all of it does.
        const int axis = a[1].sign() || b[1].sign() ? 1 : 0;
        const Dyadic rise = b[axis] - a[axis];
        if (rise.sign() == 0) return {Side::on_edge, {}, a[2], Dyadic(1)};
        return {Side::on_edge, {}, a[2] * b[axis] - b[2] * a[axis], rise};
    }
    const bool a_up = a[1].sign() > 0, b_up = b[1].sign() > 0;
    if (a_up == b_up) return {};
    if (a_up) return crossing(b, a);
    return {side.sign() > 0 ? Side::right : Side::left, side, a[2] * b[1] - b[2] * a[1],
            b[1] - a[1]};
}

/// Where a ray is inside, as far as a double can tell.
Side crossing_side(const Corners::Sheared& a, const Corners::Sheared& b) {
    const Interval ax = Interval::around(a.x, a.radius), ay = Interval::around(a.y, a.radius);
    const Interval bx = Interval::around(b.x, b.radius), by = Interval::around(b.y, b.radius);
    if (ay.sign() * by.sign() == 1) return Side::none;
    // What is on the left does not matter to who counts on the right.
    if (ax.sign() == -1 && bx.sign() == -1) return Side::left;
    if (ay.sign() == 0 || by.sign() == 0) return Side::unsure;
    const int side = (ax * by - bx * ay).sign();
    if (side == 0) return Side::unsure;
    return (side > 0) == (by.sign() > 0) ? Side::right : Side::left;
}

Interval hull(const Interval& a, const Interval& b) {
    return {std::min(a.lo, b.lo), std::max(a.hi, b.hi)};
}

}  // namespace

Polygons::Polygons(std::span<const Vec3f> corners, std::span<const uint32_t> first,
                   std::shared_ptr<const Placed> placed)
    : corners_(corners, std::move(placed)), first_(first.begin(), first.end()) {
    if (first_.empty()) first_.push_back(0);
}

bool Polygons::active(uint32_t i) const {
    for (uint32_t k = first_[i]; k < first_[i + 1]; ++k)
        if (!corners_.finite(k)) return false;
    return first_[i] < first_[i + 1];
}

Box Polygons::bounds(uint32_t i) const {
    Box box;
    for (uint32_t k = first_[i]; k < first_[i + 1]; ++k) corners_.extend(box, k);
    return box;
}

/// A hit is a mean of corners: it is between the outermost of them along the ray, and between the
/// outermost planes through them, whichever axis the ray's image is cut along.
void Polygons::candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const {
    const uint32_t begin = first_[i], end = first_[i + 1];
    const double bound = scale * double_bound * corners_.placed().condition;
    bool sure = true, inside = false;
    Corners::Sheared last = corners_.shear(ray, end - 1, bound, bound);
    for (uint32_t k = begin; k < end; ++k) {
        const Corners::Sheared next = corners_.shear(ray, k, bound, bound);
        const Side side = crossing_side(last, next);
        if (side == Side::unsure) sure = false;
        if (side == Side::right) inside = !inside;
        last = next;
    }
    if (sure && !inside) return;

    const auto corner = [&](uint32_t k) {
        Triple<Interval> p = corners_.world(k);
        if (bound > 0)
            for (int a = 0; a < 3; ++a) {
                const double wide = bound * (p[a].magnitude() + std::abs(ray.o[a]));
                p[a] = Interval::outward(p[a].lo - wide, p[a].hi + wide);
            }
        return p;
    };
    const Triple<Interval> n = newell<Interval>(begin, end, corner);
    const Triple<Interval> o = triple<Interval>(ray.o);
    const Interval dn = dot(n, triple<Interval>(ray.d));
    Interval height, depth;
    for (uint32_t k = begin; k < end; ++k) {
        const Triple<Interval> v = corner(k) - o;
        const Interval h = dot(n, v), z = v[ray.kz];
        height = k == begin ? h : hull(height, h);
        depth = k == begin ? z : hull(depth, z);
    }
    Interval t = depth / Interval(ray.d[ray.kz]);
    if (dn.sign() != 0) {
        const Interval plane = height / dn;
        t = {std::max(t.lo, plane.lo), std::min(t.hi, plane.hi)};
        if (t.lo > t.hi) return;
    } else {
        sure = false;  // parallel to the plane it would miss
    }
    Candidate hit{t.lo, t.hi, sure};
    hit.widen(scale * double_t_bound);
    out.add(hit);
}

void Polygons::solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const {
    const uint32_t begin = first_[i], end = first_[i + 1];
    const Triple<Dyadic> n =
        newell<Dyadic>(begin, end, [&](uint32_t k) { return corners_.exact_world(k); });
    if (dot(n, ray.d).sign() == 0) return;
    const Dyadic& dz = ray.d[ray.kz];
    bool inside = false;
    Crossing<Dyadic> left, right;
    Triple<Dyadic> last = corners_.shear(ray, end - 1);
    for (uint32_t k = begin; k < end; ++k) {
        const Triple<Dyadic> next = corners_.shear(ray, k);
        Crossing<Dyadic> c = crossing(last, next);
        last = next;
        if (c.side == Side::on_edge) return out.push_back(Root::fraction(c.z, c.rise * dz));
        if (c.side == Side::none) continue;
        const bool on_right = c.side == Side::right;
        inside ^= on_right;
        Crossing<Dyadic>& nearest = on_right ? right : left;
        const int order =
            nearest.side == Side::none ? 0 : compare(c.x * nearest.rise, nearest.x * c.rise);
        if (nearest.side == Side::none || (on_right ? order < 0 : order > 0)) nearest = c;
    }
    // As many edges go up as down, so that an odd number on the right has one on the left.
    if (inside)
        out.push_back(Root::fraction(right.x * left.z - left.x * right.z,
                                     (right.x * left.rise - left.x * right.rise) * dz));
}

}  // namespace crofton::exact
