#include "framework/exact_quadric.h"

namespace crofton::exact {
namespace {

/// a·s² + 2·b·s + c = 0, as b² - a·c in a form of its own where that is narrower.
template <class N>
struct Quadratic {
    N a, b, discriminant, c;
};

void widen(Interval& x, double by) { x = Interval::outward(x.lo - by, x.hi + by); }
void widen(Dyadic&, double) {}
double size_of(const Interval& x) { return x.magnitude(); }
double size_of(const Dyadic&) { return 0; }

}  // namespace

/// The ray in object space, all lengths times the determinant of the map, so that nothing is
/// divided: determinant·(point - p) = from_p + s·d, with t = t0 + s.
template <class N>
struct QuadricShapes::Local {
    Triple<N> from_p, d;
    N determinant;
    double t0;

    /// Where the axis coordinate (point - p)·w, times the determinant, is from + s·along.
    N from(const Triple<N>& w) const { return dot(from_p, w); }

    Quadratic<N> sphere(const QuadricShape& q) const {
        const N r = determinant * N(double(q.p_radius));
        // Lagrange's identity: narrower than b² - a·c.
        const N a = norm2(d);
        return {a, dot(d, from_p), a * square(r) - norm2(cross(d, from_p)), N()};
    }
    /// With w from base to apex, x = point - p, y = x·w: |w|²·|x × w|² = (r0·|w|² + (r1 - r0)·y)².
    Quadratic<N> cone(const QuadricShape& q, const Triple<N>& w) const {
        const N h2 = norm2(w), dr = N(double(q.q_radius)) - N(double(q.p_radius));
        const Triple<N> dw = cross(d, w), fw = cross(from_p, w);
        const N da = dr * dot(d, w), ra = N(double(q.p_radius)) * h2 * determinant + dr * from(w);
        Quadratic<N> e;
        e.a = h2 * norm2(dw) - square(da);
        e.b = h2 * dot(fw, dw) - ra * da;
        e.c = h2 * norm2(fw) - square(ra);
        e.discriminant = square(e.b) - e.a * e.c;
        return e;
    }
};

template <class N, class R>
QuadricShapes::Local<N> QuadricShapes::local(const R& ray, const QuadricShape& s, double t0,
                                             double scale) const {
    Local<N> l;
    l.t0 = t0;
    const Triple<N> o = triple_of<N>(ray.o), d = triple_of<N>(ray.d), p = triple<N>(s.p);
    double o_error = 0, d_error = 0;
    if (placed_->identity) {
        l.determinant = N(1.0);
        l.d = d;
        l.from_p = o - p;
        for (int a = 0; a < 3; ++a) {
            o_error = std::max(o_error, size_of(o[a]) + size_of(p[a]));
            d_error = std::max(d_error, size_of(d[a]));
        }
    } else {
        const Triple<N>* row = placed_->template rows<N>();
        const Triple<N> c[3] = {cross(row[1], row[2]), cross(row[2], row[0]),
                                cross(row[0], row[1])};
        l.determinant = dot(row[0], c[0]);
        const Triple<N> om = o - placed_->template offset<N>();
        l.d = d[0] * c[0] + d[1] * c[1] + d[2] * c[2];
        l.from_p = om[0] * c[0] + om[1] * c[1] + om[2] * c[2] - l.determinant * p;
        for (int a = 0; a < 3; ++a) {
            double x = size_of(l.determinant) * size_of(p[a]), y = 0;
            for (int b = 0; b < 3; ++b) {
                x += size_of(c[b][a]) * (size_of(o[b]) + placed_->absolute[b][3]);
                y += size_of(c[b][a]) * size_of(d[b]);
            }
            o_error = std::max(o_error, x);
            d_error = std::max(d_error, y);
        }
    }
    l.from_p = l.from_p + N(t0) * l.d;
    const double bound = scale * double_bound * placed_->condition;
    for (int a = 0; a < 3; ++a) {
        widen(l.from_p[a], bound * (o_error + std::abs(t0) * d_error));
        widen(l.d[a], bound * d_error);
    }
    return l;
}

QuadricShapes::QuadricShapes(std::span<const QuadricShape> shapes,
                             std::shared_ptr<const Placed> placed)
    : shapes_(shapes.begin(), shapes.end()), placed_(std::move(placed)) {}

bool QuadricShapes::active(uint32_t i) const {
    const QuadricShape& s = shapes_[i];
    if (!s.p.allFinite() || !std::isfinite(s.p_radius) || s.p_radius < 0) return false;
    if (s.kind == QuadricKind::sphere) return s.p_radius > 0;
    if (!s.q.allFinite() || !std::isfinite(s.q_radius) || s.q_radius < 0) return false;
    if (s.kind == QuadricKind::disc) return s.p_radius > 0 && !s.q.isZero(0);
    return (s.p_radius > 0 || s.q_radius > 0) && s.p != s.q;
}

Box QuadricShapes::bounds(uint32_t i) const {
    const QuadricShape& s = shapes_[i];
    Triple<Interval> object;
    for (int a = 0; a < 3; ++a) {
        object[a] = Interval::around(s.p[a], s.p_radius);
        if (s.kind != QuadricKind::cone) continue;
        const Interval top = Interval::around(s.q[a], s.q_radius);
        object[a] = {std::min(object[a].lo, top.lo), std::max(object[a].hi, top.hi)};
    }
    Box box;
    for (int a = 0; a < 3; ++a) {
        const Interval x =
            placed_->identity ? object[a] : dot(placed_->row[a], object) + placed_->translation[a];
        box.lower[a] = x.lo;
        box.upper[a] = x.hi;
        double size = placed_->absolute[a][3];
        for (int b = 0; b < 3; ++b) size += placed_->absolute[a][b] * object[b].magnitude();
        box.size = std::max(box.size, placed_->condition * size);
    }
    return box;
}

namespace {

/// Puts roots s of `e`, shifted by t0, into intervals; `keep` says 1, 0 or -1 for surely, perhaps
/// and surely not on the part of the surface that counts.
template <class Keep>
void put(const Quadratic<Interval>& e, double t0, const Keep& keep, Candidates& out) {
    if (e.discriminant.hi < 0) return;
    if (e.a.sign() == 0 || !e.discriminant.valid()) {
        out.add(Candidate{});
        return;
    }
    const Interval root = sqrt(e.discriminant);
    Interval first = (-e.b - root) / e.a, second = (root - e.b) / e.a;
    if (e.a.sign() < 0) std::swap(first, second);
    if (e.discriminant.lo < 0) {
        const Interval both(std::min(first.lo, second.lo), std::max(first.hi, second.hi));
        const Interval t = both + Interval(t0);
        if (keep(both) >= 0) out.add({t.lo, t.hi, false});
        return;
    }
    for (const Interval& s : {first, second}) {
        const int kept = keep(s);
        const Interval t = s + Interval(t0);
        if (kept >= 0) out.add({t.lo, t.hi, kept > 0});
    }
}

/// The same exactly. `keep(s)` tells whether the root (-b + s·√discriminant)/a counts.
template <class Keep>
void put(const Quadratic<Dyadic>& e, const Keep& keep, std::vector<Root>& out) {
    if (e.discriminant.sign() < 0) return;
    const int up = e.a.sign();
    for (int s : {-up, up}) {
        if (keep(s))
            out.push_back({up < 0 ? e.b : -e.b, e.discriminant, up < 0 ? -e.a : e.a, up * s});
        if (e.discriminant.sign() == 0) break;
    }
}

/// Whether r2 is in [inner², outer²], with all of them times the same square.
int in_ring(const Interval& r2, const Interval& inner2, const Interval& outer2) {
    const int out = (outer2 - r2).sign(), in = (r2 - inner2).sign();
    if (out < 0 || in < 0) return -1;
    return out > 0 && (in > 0 || inner2.hi == 0) ? 1 : 0;
}

}  // namespace

void QuadricShapes::candidates(const DoubleRay& ray, uint32_t i, double scale,
                               Candidates& out) const {
    find(ray, i, scale, out);
    for (int k = 0; k < out.count; ++k) out.at[k].widen(scale * double_t_bound);
}

void QuadricShapes::find(const DoubleRay& ray, uint32_t i, double scale, Candidates& out) const {
    const QuadricShape& s = shapes_[i];
    // Any t0 is right; near the shape, the numbers are small.
    double t0 = 0;
    {
        const Local<Interval> l = local<Interval>(ray, s, 0, 0);
        double fd = 0, dd = 0;
        for (int a = 0; a < 3; ++a) {
            const double d = l.d[a].lo;
            fd += l.from_p[a].lo * d;
            dd += d * d;
        }
        if (dd > 0 && std::isfinite(fd / dd)) t0 = -fd / dd;
    }
    const Local<Interval> l = local<Interval>(ray, s, t0, scale);
    if (s.kind == QuadricKind::sphere)
        return put(
            l.sphere(s), t0, [](const Interval&) { return 1; }, out);
    if (s.kind == QuadricKind::cone) {
        const Triple<Interval> w = triple<Interval>(s.q) - triple<Interval>(s.p);
        const Interval from = l.from(w), along = dot(l.d, w), top = norm2(w) * l.determinant;
        if (l.determinant.sign() == 0) return out.add(Candidate{});
        const auto keep = [&](const Interval& x) {
            const Interval y = from + x * along;
            const int turn = l.determinant.sign();
            const int low = y.sign() * turn, high = (top - y).sign() * turn;
            return low < 0 || high < 0 ? -1 : low > 0 && high > 0 ? 1 : 0;
        };
        return put(l.cone(s, w), t0, keep, out);
    }
    const Triple<Interval> n = triple<Interval>(s.q);
    const Interval dn = dot(l.d, n);
    if (dn.sign() == 0) return out.add(Candidate{});
    const Interval x = -l.from(n) / dn;
    const Interval inner = square(l.determinant * Interval(double(s.q_radius)));
    const Interval outer = square(l.determinant * Interval(double(s.p_radius)));
    const int kept =
        in_ring(norm2(l.from_p + x * l.d), s.q_radius == 0 ? Interval(0) : inner, outer);
    const Interval t = x + Interval(t0);
    if (kept >= 0) out.add({t.lo, t.hi, kept > 0});
}

void QuadricShapes::solve(const ExactRay& ray, uint32_t i, std::vector<Root>& out) const {
    const QuadricShape& s = shapes_[i];
    const Local<Dyadic> l = local<Dyadic>(ray, s, 0, 0);
    if (s.kind == QuadricKind::sphere) {
        const Quadratic<Dyadic> e = l.sphere(s);
        return put(
            e, [](int) { return true; }, out);
    }
    if (s.kind == QuadricKind::cone) {
        const Triple<Dyadic> w = triple<Dyadic>(s.q) - triple<Dyadic>(s.p);
        const Dyadic from = l.from(w), along = dot(l.d, w), top = norm2(w) * l.determinant;
        const Quadratic<Dyadic> e = l.cone(s, w);
        const int turn = l.determinant.sign();
        if (e.a.sign() == 0) {
            // Parallel to a line of the surface.
            if (e.b.sign() == 0) return;
            Root root = Root::fraction(-e.c, Dyadic(2) * e.b);
            const Dyadic y = from * root.c + root.a * along;
            if (y.sign() * turn >= 0 && (top * root.c - y).sign() * turn >= 0)
                out.push_back(std::move(root));
            return;
        }
        const auto keep = [&](int sign) {
            // y·a = from·a - b·along + sign·along·√discriminant.
            const Dyadic y = from * e.a - e.b * along, q = Dyadic(sign) * along;
            const int turned = turn * e.a.sign();
            return sign_of(y, q, e.discriminant) * turned >= 0 &&
                   sign_of(top * e.a - y, -q, e.discriminant) * turned >= 0;
        };
        return put(e, keep, out);
    }
    const Triple<Dyadic> n = triple<Dyadic>(s.q);
    const Dyadic dn = dot(l.d, n);
    if (dn.sign() == 0) return;
    const Dyadic x = -l.from(n);
    const Dyadic r2 = norm2(dn * l.from_p + x * l.d);
    const Dyadic unit = square(l.determinant * dn);
    if (compare(r2, unit * square(Dyadic(s.p_radius))) <= 0 &&
        compare(r2, unit * square(Dyadic(s.q_radius))) >= 0)
        out.push_back(Root::fraction(x, dn));
}

}  // namespace crofton::exact
