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

/// What one edge tells about the origin.
enum class Crossing { none, crossed, on_edge, unsure };

/// Crossing of the positive x axis by the edge from a to b, half-open in y.
Crossing crossing(const Triple<Dyadic>& a, const Triple<Dyadic>& b) {
    const Dyadic side = a[0] * b[1] - b[0] * a[1];
    if (side.sign() == 0) {
        // In one line with the origin, which is between them or is not.
        const bool between = (a[0] * b[0]).sign() <= 0 && (a[1] * b[1]).sign() <= 0;
        return between ? Crossing::on_edge : Crossing::none;
    }
    const bool a_up = a[1].sign() > 0, b_up = b[1].sign() > 0;
    if (a_up == b_up) return Crossing::none;
    return (side.sign() > 0) == b_up ? Crossing::crossed : Crossing::none;
}

Crossing crossing(const Corners::Sheared& a, const Corners::Sheared& b) {
    const Interval ax = Interval::around(a.x, a.radius), ay = Interval::around(a.y, a.radius);
    const Interval bx = Interval::around(b.x, b.radius), by = Interval::around(b.y, b.radius);
    if (ay.sign() * by.sign() == 1) return Crossing::none;
    if (ax.sign() == -1 && bx.sign() == -1) return Crossing::none;
    if (ay.sign() == 0 || by.sign() == 0) return Crossing::unsure;
    const int side = (ax * by - bx * ay).sign();
    if (side == 0) return Crossing::unsure;
    return (side > 0) == (by.sign() > 0) ? Crossing::crossed : Crossing::none;
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

/// Corners may stand off the plane by their rounding, and what is hit off the corners' box by as
/// much, times the tangent of the angle of incidence. The box is widened by its own size for that:
/// a hit of a crooked polygon farther out does not count, here as in every structure.
Box Polygons::bounds(uint32_t i) const {
    Box box;
    for (uint32_t k = first_[i]; k < first_[i + 1]; ++k) corners_.extend(box, k);
    double extent = 0;
    for (int a = 0; a < 3; ++a) extent = std::max(extent, box.upper[a] - box.lower[a]);
    for (int a = 0; a < 3; ++a) box.lower[a] -= extent, box.upper[a] += extent;
    return box;
}

void Polygons::candidates(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const {
    const uint32_t begin = first_[i], end = first_[i + 1];
    const double bound = scale * double_bound * corners_.placed().condition;
    bool sure = true, inside = false;
    Corners::Sheared last = corners_.shear(ray, end - 1, bound, bound);
    for (uint32_t k = begin; k < end; ++k) {
        const Corners::Sheared next = corners_.shear(ray, k, bound, bound);
        const Crossing c = crossing(last, next);
        if (c == Crossing::unsure) sure = false;
        if (c == Crossing::crossed) inside = !inside;
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
    const Interval dn = dot(n, triple<Interval>(ray.d));
    Candidate hit;
    if (dn.sign() != 0) {
        const Interval t = dot(n, corner(begin) - triple<Interval>(ray.o)) / dn;
        hit = {t.lo, t.hi, sure};
        hit.widen(scale * double_t_bound);
    }
    out.add(hit);
}

void Polygons::solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const {
    const uint32_t begin = first_[i], end = first_[i + 1];
    const auto corner = [&](uint32_t k) { return corners_.exact_world(k); };
    const Triple<Dyadic> n = newell<Dyadic>(begin, end, corner);
    const Dyadic dn = dot(n, ray.d);
    if (dn.sign() == 0) return;
    bool inside = false, on_edge = false;
    Triple<Dyadic> last = corners_.shear(ray, end - 1);
    for (uint32_t k = begin; k < end && !on_edge; ++k) {
        const Triple<Dyadic> next = corners_.shear(ray, k);
        const Crossing c = crossing(last, next);
        if (c == Crossing::crossed) inside = !inside;
        on_edge = c == Crossing::on_edge;
        last = next;
    }
    if (inside || on_edge) out.push_back(Root::fraction(dot(n, corner(begin) - ray.o), dn));
}

}  // namespace crofton::exact
