// The oracle against a second one, written from the definitions with rational numbers (triangles,
// polygons) and with 300 digits (quadrics), without its filter, its tree or its number types; and
// the library against the oracle.

#include "framework/exact.h"

#include <Eigen/Geometry>
#include <boost/multiprecision/cpp_bin_float.hpp>
#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <map>

#include "framework/exact_number.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "scenegraph/assemble.h"
#include "scenegraph/exact_scene.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

namespace mp = boost::multiprecision;
using Rational = mp::cpp_rational;
using Real = mp::number<mp::cpp_bin_float<300>>;
using exact::Answer;
using exact::Dyadic;
using exact::Judgement;
using exact::Oracle;
using exact::Root;
using Triangles = std::vector<std::array<uint32_t, 3>>;

/// A triangle or a ray in rationals.
template <class N>
struct P3 {
    N x, y, z;
};
template <class N>
P3<N> operator-(const P3<N>& a, const P3<N>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class N>
P3<N> operator+(const P3<N>& a, const P3<N>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class N>
P3<N> operator*(const N& s, const P3<N>& a) {
    return {s * a.x, s * a.y, s * a.z};
}
template <class N>
N inner(const P3<N>& a, const P3<N>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class N>
P3<N> outer(const P3<N>& a, const P3<N>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class N, class V>
P3<N> exactly(const V& v) {
    return {N(double(v[0])), N(double(v[1])), N(double(v[2]))};
}

/// The image under the chain, one map after the other.
template <class N>
P3<N> mapped(const std::vector<Transform>& chain, P3<N> p) {
    for (auto t = chain.rbegin(); t != chain.rend(); ++t) {
        const auto row = [&](int i) -> N {
            return N(t->linear(i, 0)) * p.x + N(t->linear(i, 1)) * p.y + N(t->linear(i, 2)) * p.z +
                   N(t->translation[i]);
        };
        p = {row(0), row(1), row(2)};
    }
    return p;
}

/// Solves o + t·d = a + u·(b - a) + v·(c - a) by Cramer's rule.
std::optional<Rational> hit_triangle(const Ray& ray, const P3<Rational> (&v)[3]) {
    const P3<Rational> o = exactly<Rational>(ray.origin), d = exactly<Rational>(ray.direction);
    const P3<Rational> e = v[1] - v[0], f = v[2] - v[0], s = o - v[0];
    const Rational det = inner(outer(e, f), d);
    if (det == 0) return {};
    const Rational t = -inner(outer(e, f), s) / det;
    const P3<Rational> p = s + t * d;
    // Weights from the 2x2 system of dot products.
    const Rational ee = inner(e, e), ef = inner(e, f), ff = inner(f, f);
    const Rational area = ee * ff - ef * ef;
    const Rational u = (inner(p, e) * ff - inner(p, f) * ef) / area;
    const Rational w = (inner(p, f) * ee - inner(p, e) * ef) / area;
    if (u < 0 || w < 0 || u + w > 1) return {};
    return t;
}

struct PlainMesh {
    std::vector<Vec3f> p;
    Triangles t;
    std::vector<Transform> chain;
};

/// Every triangle, in order.
Answer brute_force(const std::vector<PlainMesh>& meshes, const Ray& ray, Rational* t_exact) {
    Answer answer;
    std::optional<Rational> best;
    for (uint32_t m = 0; m < meshes.size(); ++m)
        for (uint32_t i = 0; i < meshes[m].t.size(); ++i) {
            P3<Rational> v[3];
            bool finite = true;
            for (int k = 0; k < 3; ++k) {
                const Vec3f& p = meshes[m].p[meshes[m].t[i][k]];
                finite = finite && p.allFinite();
                if (finite) v[k] = mapped(meshes[m].chain, exactly<Rational>(p));
            }
            if (!finite) continue;
            const std::optional<Rational> t = hit_triangle(ray, v);
            if (!t || *t < Rational(ray.t_min)) continue;
            if (!std::isinf(ray.t_max) && *t > Rational(ray.t_max)) continue;
            if (best && *t > *best) continue;
            if (!best || *t < *best) answer.ties.clear();
            best = t;
            Hit hit;
            hit.primitive = i, hit.geometry = 0, hit.instance = m;
            answer.ties.push_back(hit);
        }
    if (best) *t_exact = *best;
    return answer;
}

bool is_void(const Ray& r) {
    return !r.origin.allFinite() || !r.direction.allFinite() || r.direction.isZero(0) ||
           !(r.t_min <= r.t_max);
}

bool same_ties(const Answer& a, const Answer& b) {
    if (a.ties.size() != b.ties.size()) return false;
    for (size_t i = 0; i < a.ties.size(); ++i)
        if (!b.has(a.ties[i])) return false;
    return true;
}

/// Whether no float is nearer to t.
bool nearest(float f, const Rational& t) {
    const Rational error = abs(Rational(f) - t);
    for (float g : {std::nextafter(f, INFINITY), std::nextafter(f, -INFINITY)})
        if (std::isfinite(g) && abs(Rational(g) - t) < error) return false;
    return true;
}

Oracle oracle_of(const std::vector<PlainMesh>& meshes) {
    Oracle oracle;
    for (uint32_t m = 0; m < meshes.size(); ++m)
        oracle.add_triangles(meshes[m].p, meshes[m].t, {meshes[m].chain, 0, m});
    oracle.finish();
    return oracle;
}

void check_against_rationals(const std::vector<PlainMesh>& meshes, const std::vector<Ray>& rays) {
    const Oracle oracle = oracle_of(meshes);
    for (const Ray& ray : rays) {
        if (is_void(ray)) {
            CHECK(!oracle.closest(ray).is_hit());
            CHECK(!oracle.any(ray));
            continue;
        }
        Rational t;
        const Answer expected = brute_force(meshes, ray, &t), found = oracle.closest(ray);
        INFO("o " << ray.origin.transpose() << " d " << ray.direction.transpose() << " t "
                  << ray.t_min << " " << ray.t_max);
        CHECK(same_ties(expected, found));
        CHECK(oracle.any(ray) == expected.is_hit());
        if (expected.is_hit()) CHECK(nearest(found.t(), t));
    }
}

std::vector<Ray> some(std::vector<Ray> rays, size_t step) {
    std::vector<Ray> out;
    for (size_t i = 0; i < rays.size(); i += step) out.push_back(rays[i]);
    return out;
}

PlainMesh ball(int level, float size = 1) {
    PlainMesh mesh;
    test::icosphere(level, mesh.p, mesh.t);
    for (Vec3f& p : mesh.p) p *= size;
    return mesh;
}

Bounds3 box_of(const std::vector<Vec3f>& points) {
    Bounds3 b;
    for (const Vec3f& p : points)
        if (p.allFinite()) b.extend(p);
    return b;
}

/// Integer corners in a small range: edges, corners and planes are met exactly, and t ties.
PlainMesh integer_soup(int n, uint64_t seed) {
    PlainMesh mesh;
    test::Random random(seed);
    const auto coordinate = [&] { return float(int(random.next() % 7) - 3); };
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < 3; ++k) {
            const float x = coordinate(), y = coordinate();
            mesh.p.emplace_back(x, y, coordinate());
        }
        const uint32_t j = uint32_t(3 * i);
        mesh.t.push_back({j, j + 1, j + 2});
    }
    return mesh;
}

std::vector<Ray> integer_rays(int n, uint64_t seed) {
    test::Random random(seed);
    std::vector<Ray> rays;
    for (int i = 0; i < n; ++i) {
        Ray ray;
        for (int a = 0; a < 3; ++a) {
            ray.origin[a] = float(int(random.next() % 9) - 4);
            ray.direction[a] = float(int(random.next() % 5) - 2);
        }
        rays.push_back(ray);
    }
    return rays;
}

}  // namespace

TEST_CASE("exact: dyadic numbers add, multiply and compare as rationals do") {
    test::Random random(1);
    const auto number = [&] {
        return std::ldexp(double(random.uniform(-1, 1)), int(random.next() % 300) - 150);
    };
    for (int i = 0; i < 2000; ++i) {
        const double a = number(), b = number(), c = number();
        const Dyadic d = Dyadic(a) * Dyadic(b) - Dyadic(c) * Dyadic(a) + Dyadic(b);
        const Rational r = Rational(a) * Rational(b) - Rational(c) * Rational(a) + Rational(b);
        CHECK(d.sign() == r.sign());
        if (r != 0) CHECK(std::abs(d.to_double() / double(r) - 1) < 1e-15);
    }
    CHECK((Dyadic(0x1p-149) * Dyadic(0x1p-149) * Dyadic(0x1p-149)).sign() == 1);
    CHECK((Dyadic(1e30) - Dyadic(1e30)).sign() == 0);
    CHECK((Dyadic(-0.0)).sign() == 0);
}

TEST_CASE("exact: roots with square roots compare and round as 300 digits do") {
    test::Random random(2);
    const auto root = [&] {
        Root r;
        r.a = Dyadic(double(int(random.next() % 21) - 10));
        r.b = Dyadic(double(random.next() % 12));
        r.c = Dyadic(double(1 + random.next() % 4));
        r.s = int(random.next() % 3) - 1;
        return r;
    };
    const auto value = [](const Root& r) -> Real {
        return (Real(r.a.to_double()) + r.s * sqrt(Real(r.b.to_double()))) / r.c.to_double();
    };
    for (int i = 0; i < 20000; ++i) {
        const Root x = root(), y = root();
        const Real difference = value(x) - value(y);
        const int expected = abs(difference) < Real(1e-200) ? 0 : difference.sign();
        CHECK(exact::compare(x, y) == expected);
        CHECK(exact::compare(y, x) == -expected);
        const float f = exact::round_to_float(x);
        const Real error = abs(value(x) - Real(f));
        CHECK(error <= abs(value(x) - Real(std::nextafter(f, INFINITY))));
        CHECK(error <= abs(value(x) - Real(std::nextafter(f, -INFINITY))));
    }
}

TEST_CASE("exact: rounding to float is to nearest, ties to even, with denormals and overflow") {
    const auto rounded_value = [](double d) {
        return exact::round_to_float(Root::fraction(Dyadic(d), Dyadic(1)));
    };
    for (double d : {1.0, -1.0, 0.0, 1e-45, 0x1p-150, 0x1.8p-149, -0x1.8p-149, 0x1p-151, 3e38,
                     0x1.ffffffp127, 0x1.fffffefp127, 1e39, -1e39, 0x1.000001p0, 0x1.000003p0,
                     -0x1.000001p0, 0x1.0000010001p0, 1e-30, 0.1})
        CHECK(rounded_value(d) == float(d));
    CHECK(exact::round_to_float(Root::fraction(Dyadic(1), Dyadic(3))) == 1.0f / 3);
    CHECK(exact::round_to_float(Root::fraction(Dyadic(2), Dyadic(-3))) == -2.0f / 3);
    // 1e15 - √(1e30 + 1): all but cancelled; to first order -1/(2e15).
    const Root tiny{Dyadic(1e15), Dyadic(1e15) * Dyadic(1e15) + Dyadic(1), Dyadic(1), -1};
    CHECK(exact::round_to_float(tiny) == float(-0.5e-15));
}

TEST_CASE("exact: triangles, edges and corners agree with rational arithmetic") {
    for (int level : {0, 1}) {
        const PlainMesh mesh = ball(level);
        check_against_rationals({mesh}, some(test::hard_rays(box_of(mesh.p), mesh.p, 5), 3));
    }
    for (uint64_t seed : {1, 2, 3}) {
        const PlainMesh soup = integer_soup(25, seed);
        check_against_rationals({soup}, integer_rays(250, seed));
    }
}

TEST_CASE("exact: extreme sizes agree with rational arithmetic") {
    for (float size : {1e-30f, 1e-12f, 1e12f, 1e30f}) {
        const PlainMesh mesh = ball(0, size);
        check_against_rationals({mesh}, some(test::hard_rays(box_of(mesh.p), mesh.p, 6), 7));
    }
    PlainMesh slivers;
    test::Random random(3);
    for (uint32_t i = 0; i < 40; ++i) {
        const Vec3f a = random.point(1), d = random.direction();
        slivers.p.insert(slivers.p.end(),
                         {a, a + d, a + 0.5f * d + random.direction() * (i % 2 ? 1e-7f : 0.0f)});
        slivers.t.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    check_against_rationals({slivers}, some(test::hard_rays(box_of(slivers.p), slivers.p, 7), 3));
}

TEST_CASE("exact: chains of maps are composed without rounding") {
    const Transform shear{(Eigen::Matrix3d() << 1, 0.3, 0, 0, 1e-3, 0, 0.1, 0, 7).finished(),
                          Vec3d(0.1, 1e3, -2)};
    const Transform mirror = scaling({-1e3, 1, 1e-3});
    const Transform turn = rotation(Vec3d(1, 2, 3).normalized(), 0.7);
    std::vector<PlainMesh> meshes{ball(0), ball(0), integer_soup(10, 4)};
    meshes[0].chain = {shear, turn, mirror};
    meshes[1].chain = {mirror, shear, turn, mirror, shear};
    meshes[2].chain = {scaling({0.5, 2, -4}), translation({1, -2, 3})};
    std::vector<Vec3f> world;
    for (const PlainMesh& m : meshes)
        for (const Vec3f& p : m.p) {
            Vec3d q = p.cast<double>();
            for (auto t = m.chain.rbegin(); t != m.chain.rend(); ++t) q = t->point(q);
            world.push_back(q.cast<float>());
        }
    check_against_rationals(meshes, some(test::hard_rays(box_of(world), world, 8), 4));
    check_against_rationals(meshes, integer_rays(60, 9));
}

TEST_CASE("exact: a ray in a triangle's plane misses it, a tie names all triangles") {
    PlainMesh square;
    square.p = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    square.t = {{0, 1, 2}, {0, 2, 3}, {0, 1, 2}};
    const Oracle oracle = oracle_of({square});
    CHECK(!oracle.closest({{-1, 0.25f, 0}, 0, {1, 0, 0}}).is_hit());
    CHECK(oracle.closest({{0.5f, 0.5f, 1}, 0, {0, 0, -1}}).ties.size() == 3);
    CHECK(oracle.closest({{0.75f, 0.5f, 1}, 0, {0, 0, -1}}).ties.size() == 2);
    CHECK(oracle.margin({{0.5f, 0.5f, 1}, 0, {0, 0, -1}}) == 0);
    CHECK(oracle.closest({{0.25f, 0.5f, 1}, 1, {0, 0, -1}, 1}).t() == 1);
    CHECK(!oracle.closest({{0.25f, 0.5f, 1}, std::nextafter(1.0f, 2.0f), {0, 0, -1}}).is_hit());
    CHECK(!oracle.closest({{0.25f, 0.5f, 1}, 0, {0, 0, -1}, std::nextafter(1.0f, 0.0f)}).is_hit());
    CHECK(!Oracle(oracle_of({})).closest({}).is_hit());
}

TEST_CASE("exact: the margin is the distance to the nearest edge in units of the bound") {
    PlainMesh one;
    one.p = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    one.t = {{0, 1, 2}};
    const Oracle oracle = oracle_of({one});
    // The edge y = 0 passes at `off` from the ray; displacements are 2^-21 of a reach of 1.
    double last = 1e300;
    for (int e = 4; e < 20; ++e) {
        const float off = std::ldexp(1.0f, -e);
        const double margin = oracle.margin({{0.25f, off, 1}, 0, {0, 0, -1}});
        CHECK(margin <= last);
        CHECK(margin <= std::ldexp(1.0, 21 - e));
        CHECK(margin >= std::ldexp(1.0, 21 - e - 3));
        last = margin;
    }
    CHECK(oracle.margin({{0.25f, 0, 1}, 0, {0, 0, -1}}) == 0);
    CHECK(oracle.margin({{0.25f, -0x1p-10f, 1}, 0, {0, 0, -1}}) >= 0x1p8);
}

namespace {

/// The quadric's equation at o + t·d, solved with 300 digits.
std::optional<Real> hit_quadric(const QuadricShape& s, const P3<Real>& o, const P3<Real>& d,
                                const Ray& ray, bool& close_call) {
    const Real tiny = Real("1e-250");
    const P3<Real> p = exactly<Real>(s.p), q = exactly<Real>(s.q);
    const Real r0 = s.p_radius, r1 = s.q_radius;
    std::vector<Real> roots;
    const auto in = [&](const Real& t) {
        return t >= Real(ray.t_min) && (std::isinf(ray.t_max) || t <= Real(ray.t_max));
    };
    if (s.kind == QuadricKind::disc) {
        const Real dn = inner(d, q);
        if (dn == 0) return {};
        const Real t = inner(p - o, q) / dn;
        const P3<Real> x = o + t * d - p;
        const Real r2 = inner(x, x);
        if (abs(r2 - r0 * r0) < tiny || (r1 > 0 && abs(r2 - r1 * r1) < tiny)) close_call = true;
        if (r2 <= r0 * r0 && r2 >= r1 * r1 && in(t)) return t;
        return {};
    }
    const P3<Real> f = o - p;
    Real a = inner(d, d), b = inner(d, f), c = inner(f, f), height = 0, fy = 0, dy = 0;
    if (s.kind == QuadricKind::sphere) {
        c -= r0 * r0;
    } else {
        height = sqrt(inner(q - p, q - p));
        const P3<Real> axis = (1 / height) * (q - p);
        fy = inner(f, axis);
        dy = inner(d, axis);
        const Real k = (r1 - r0) / height;
        a -= dy * dy * (1 + k * k);
        b -= fy * dy * (1 + k * k) + r0 * k * dy;
        c -= fy * fy * (1 + k * k) + 2 * r0 * k * fy + r0 * r0;
    }
    if (abs(a) < tiny) {
        if (abs(b) >= tiny)
            roots = {-c / (2 * b)};
        else
            close_call = true;
    } else {
        const Real discriminant = b * b - a * c;
        if (abs(discriminant) < tiny) close_call = true;
        if (discriminant < 0) return {};
        roots = {(-b - sqrt(discriminant)) / a, (-b + sqrt(discriminant)) / a};
        if (roots[0] > roots[1]) std::swap(roots[0], roots[1]);
    }
    for (const Real& t : roots) {
        const Real y = fy + t * dy;
        if (s.kind == QuadricKind::cone && (abs(y) < tiny || abs(y - height) < tiny))
            close_call = true;
        if (s.kind == QuadricKind::cone && (y < 0 || y > height)) continue;
        if (in(t)) return t;
    }
    return {};
}

/// Object-space ray by solving M·x = o with Cramer's rule, one map after the other.
void pull_back(const Transform& m, P3<Real>& o, P3<Real>& d) {
    const auto column = [&](int j) {
        return P3<Real>{Real(m.linear(0, j)), Real(m.linear(1, j)), Real(m.linear(2, j))};
    };
    const P3<Real> a = column(0), b = column(1), c = column(2);
    const Real det = inner(a, outer(b, c));
    const auto solve = [&](const P3<Real>& x) {
        return P3<Real>{inner(x, outer(b, c)) / det, inner(a, outer(x, c)) / det,
                        inner(a, outer(b, x)) / det};
    };
    o = solve(o - exactly<Real>(m.translation));
    d = solve(d);
}

std::vector<QuadricShape> quadric_soup(int n, uint64_t seed) {
    test::Random random(seed);
    std::vector<QuadricShape> shapes;
    for (int i = 0; i < n; ++i) {
        const Vec3f c = random.point(1), e = c + random.point(0.8f);
        const float r = random.uniform(0.05f, 0.6f);
        const QuadricKind kind = QuadricKind(i % 3);
        const float second = i % 6 == 1 ? r : i % 6 == 4 ? 0 : r * 0.3f;
        shapes.push_back({kind, c, r, kind == QuadricKind::disc ? random.direction() : e, second});
    }
    return shapes;
}

}  // namespace

TEST_CASE("exact: quadrics under maps agree with their equations solved to 300 digits") {
    const Transform shear{(Eigen::Matrix3d() << 1, 0.3, 0, 0, -0.5, 0, 0.1, 0, 2).finished(),
                          Vec3d(0.1, 1, -2)};
    const std::vector<std::vector<Transform>> chains{{}, {shear}, {scaling({2, -1, 0.1}), shear}};
    const std::vector<QuadricShape> shapes = quadric_soup(18, 5);
    for (const auto& chain : chains) {
        Oracle oracle;
        oracle.add_quadrics(shapes, {chain, 0, 0});
        oracle.finish();
        std::vector<Vec3f> world;
        for (const QuadricShape& s : shapes)
            for (const Vec3f& p : {s.p, s.q}) {
                Vec3d x = p.cast<double>();
                for (auto t = chain.rbegin(); t != chain.rend(); ++t) x = t->point(x);
                world.push_back(x.cast<float>());
            }
        int compared = 0, hits = 0;
        for (const Ray& ray : some(test::hard_rays(box_of(world), world, 9), 5)) {
            if (is_void(ray)) continue;
            P3<Real> o = exactly<Real>(ray.origin), d = exactly<Real>(ray.direction);
            for (const Transform& t : chain) pull_back(t, o, d);
            std::optional<Real> best;
            uint32_t first = no_id;
            bool close_call = false;
            for (uint32_t i = 0; i < shapes.size(); ++i) {
                const std::optional<Real> t = hit_quadric(shapes[i], o, d, ray, close_call);
                if (!t || (best && *t >= *best)) continue;
                best = t;
                first = i;
            }
            if (close_call) continue;
            ++compared;
            const Answer found = oracle.closest(ray);
            INFO("o " << ray.origin.transpose() << " d " << ray.direction.transpose());
            REQUIRE(found.is_hit() == best.has_value());
            CHECK(oracle.any(ray) == found.is_hit());
            if (!best) continue;
            ++hits;
            CHECK(found.ties[0].primitive == first);
            CHECK(found.t() == static_cast<float>(*best));
        }
        CHECK(compared > 100);
        CHECK(hits > 50);
    }
}

TEST_CASE("exact: quadrics that are touched, ended and entered exactly") {
    Oracle oracle;
    const std::vector<QuadricShape> shapes{
        {QuadricKind::sphere, {0, 0, 0}, 5, {0, 0, 0}, 0},
        {QuadricKind::cone, {20, 0, 0}, 1, {20, 0, 4}, 1},
        {QuadricKind::cone, {40, 0, 0}, 3, {40, 0, 3}, 0},
        {QuadricKind::disc, {60, 0, 0}, 5, {0, 0, 2}, 3},
        {QuadricKind::sphere, {80, 0, 0}, 0, {0, 0, 0}, 0},
        {QuadricKind::disc, {90, 0, 0}, 0, {0, 0, 1}, 0},
        {QuadricKind::cone, {100, 0, 0}, 0, {100, 0, 1}, 0},
    };
    oracle.add_quadrics(shapes, {});
    oracle.finish();
    const auto shoot = [&](Vec3f o, Vec3f d, float t_min = 0) {
        const Answer a = oracle.closest({o, t_min, d});
        return a.is_hit() ? int(a.ties[0].primitive) * 1000 + int(a.t() * 8) : -1;
    };
    CHECK(shoot({-9, 3, 4}, {1, 0, 0}) == 9 * 8);  // touches the sphere
    CHECK(shoot({-9, 3, std::nextafter(4.0f, 5.0f)}, {1, 0, 0}) == -1);
    CHECK(shoot({0, 0, 0}, {0, 0, 1}) == 5 * 8);           // from the centre: the far side
    CHECK(shoot({0, 0, 5}, {0, 0, -1}) == 0);              // from the surface: there
    CHECK(shoot({20, -3, 4}, {0, 1, 0}) == 1000 + 2 * 8);  // the end belongs to a cylinder
    CHECK(shoot({20, -3, std::nextafter(4.0f, 5.0f)}, {0, 1, 0}) == -1);
    CHECK(shoot({21, 0, -1}, {0, 0, 1}) == -1);            // in the surface
    CHECK(shoot({20.5f, 0, -1}, {0, 0, 1}) == -1);         // through the open ends
    CHECK(shoot({40, 0, 9}, {0, 0, -1}) == 2000 + 6 * 8);  // the apex
    CHECK(shoot({40, -9, 3}, {0, 1, 0}) == 2000 + 9 * 8);
    CHECK(shoot({63, 4, 1}, {0, 0, -1}) == 3000 + 8);  // rim, 3-4-5
    CHECK(shoot({63, 0, 1}, {0, 0, -1}) == 3000 + 8);  // inner rim
    CHECK(shoot({62.875f, 0, 1}, {0, 0, -1}) == -1);
    CHECK(shoot({80, 0, -1}, {0, 0, 1}) == -1);
    CHECK(shoot({90, 0, -1}, {0, 0, 1}) == -1);
    CHECK(shoot({100, -1, 0.5f}, {0, 1, 0}) == -1);
}

namespace {

/// Even-odd rule in the polygon's own plane, by rationals: the crossing of a line in it with the
/// edges; corners in the plane only.
std::optional<Rational> hit_polygon(const std::vector<P3<Rational>>& v, const Ray& ray) {
    P3<Rational> n{0, 0, 0};
    const size_t m = v.size();
    for (size_t k = 0; k < m; ++k) n = n + outer(v[k], v[(k + 1) % m]);
    const P3<Rational> o = exactly<Rational>(ray.origin), d = exactly<Rational>(ray.direction);
    const Rational dn = inner(n, d);
    if (dn == 0) return {};
    const Rational t = inner(n, v[0] - o) / dn;
    const P3<Rational> p = o + t * d;
    // A direction in the plane that passes through no corner: the wanted parity is along it.
    const P3<Rational> e = outer(n, P3<Rational>{Rational(1, 3), Rational(2, 7), Rational(5, 11)});
    const P3<Rational> side = outer(n, e);
    int crossings = 0;
    for (size_t k = 0; k < m; ++k) {
        const P3<Rational> a = v[k] - p, b = v[(k + 1) % m] - p;
        const P3<Rational> c = outer(a, b);
        if (c.x == 0 && c.y == 0 && c.z == 0 && inner(a, b) <= 0) return t;  // on the edge
        const Rational sa = inner(a, side), sb = inner(b, side);
        if ((sa > 0) == (sb > 0)) continue;
        const Rational cut = sa / (sa - sb);
        if (inner(a + cut * (b - a), e) > 0) ++crossings;
    }
    if (crossings % 2) return t;
    return {};
}

}  // namespace

TEST_CASE("exact: polygons agree with the even-odd rule in rational arithmetic") {
    // Integer outlines in three planes, of both windings, one not convex, one crossing itself.
    const std::vector<std::vector<std::array<int, 2>>> outlines{
        {{-2, -2}, {2, -2}, {2, 2}, {-2, 2}},
        {{-3, 0}, {-1, -1}, {0, -3}, {1, -1}, {3, 0}, {1, 1}, {0, 3}, {-1, 1}},
        {{0, 0}, {0, 2}, {2, 2}, {2, 1}, {1, 1}, {1, 0}},
        {{-2, -2}, {2, 2}, {2, -2}, {-2, 3}}};
    std::vector<Vec3f> corners;
    std::vector<uint32_t> first{0};
    std::vector<std::vector<P3<Rational>>> plain;
    const std::vector<Transform> chain{scaling({1, 0.75, -2})};
    for (size_t i = 0; i < outlines.size(); ++i)
        for (int plane = 0; plane < 3; ++plane) {
            std::vector<P3<Rational>> v;
            for (const auto& [x, y] : outlines[i]) {
                const float z = float(plane == 2 ? x + 2 * y : plane);
                corners.emplace_back(plane == 1 ? z : x, y, plane == 1 ? x : z);
                v.push_back(mapped(chain, exactly<Rational>(corners.back())));
            }
            first.push_back(uint32_t(corners.size()));
            plain.push_back(v);
        }
    Oracle oracle;
    oracle.add_polygons(corners, first, {chain, 0, 0});
    oracle.finish();
    int hits = 0;
    for (Ray ray : integer_rays(1500, 12)) {
        if (is_void(ray)) continue;
        ray.origin.y() *= 0.75f;
        std::optional<Rational> best;
        size_t ties = 0;
        for (const auto& v : plain) {
            const std::optional<Rational> t = hit_polygon(v, ray);
            if (!t || *t < 0 || (best && *t > *best)) continue;
            if (!best || *t < *best) ties = 0;
            best = t;
            ++ties;
        }
        const Answer found = oracle.closest(ray);
        INFO("o " << ray.origin.transpose() << " d " << ray.direction.transpose());
        CHECK(found.ties.size() == (best ? ties : 0));
        CHECK(oracle.any(ray) == best.has_value());
        if (best && found.is_hit()) CHECK(nearest(found.t(), *best));
        hits += best.has_value();
    }
    CHECK(hits > 300);
}

namespace {

std::shared_ptr<const AcceleratorChoice> brute_force_choice() {
    return std::make_shared<AcceleratorChoice>(
        AcceleratorChoice{"brute_force", "brute_force", {}, nullptr});
}

/// A ball under three maps that float cannot hold, beside another.
Scene mapped_scene() {
    Scene scene;
    TriangleMesh mesh;
    test::icosphere(1, mesh.positions, mesh.triangles);
    const Transform turn = rotation(Vec3d(1, 2, 3).normalized(), 0.7);
    const uint32_t a = scene.add_node("a", {}, translation({0.1, 0.2, 0.3}) * turn);
    const uint32_t b = scene.add_node("b", {}, scaling({1.1, -0.7, 0.9}), a);
    const uint32_t ball = scene.add_object("ball", {"ball", 0, mesh}, turn, b);
    scene.add_node("other", scene.nodes[ball].mesh, translation({1.3, 0, 0}), a);
    return scene;
}

}  // namespace

TEST_CASE(
    "exact: where the margin is wide, the library's hit is the truth under both of its names") {
    const Scene scene = mapped_scene();
    AssemblyPlan plan;
    plan.top = plan.objects = brute_force_choice();
    const Assembly assembly = assemble(scene, plan);
    const Oracle composed = make_oracle(scene),
                 placed = make_oracle(scene, PlacementTruth::as_placed);
    CHECK(composed.size() == placed.size());
    const auto& mesh = std::get<TriangleMesh>(scene.geometries[0].shapes);
    int wide = 0, same_bits = 0, hits = 0;
    for (const Ray& ray : test::hard_rays(assembly.root->bounds(), mesh.positions, 17)) {
        const Hit hit = assembly.root->intersect(ray);
        for (const Oracle* oracle : {&composed, &placed}) {
            const Answer truth = oracle->closest(ray);
            CHECK(!oracle->judge(ray, hit, truth).is_fault());
            if (is_void(ray) || oracle->margin(ray) < 1) continue;
            ++wide;
            REQUIRE(hit.is_hit() == truth.is_hit());
            if (!hit.is_hit()) continue;
            CHECK(truth.has(hit));
            if (oracle != &placed) continue;
            ++hits;
            same_bits += hit.t == truth.t();
        }
    }
    CHECK(wide > 500);
    // t differs from the rounded exact one by few ulp, and mostly not at all.
    CHECK(same_bits > hits / 2);
}

TEST_CASE("exact: a closed ball is crossed once from its inside, twice from outside") {
    const Oracle oracle = oracle_of({ball(1)});
    CHECK(oracle.sure_crossings({{0.01f, 0.02f, 0.03f}, 0, {0.3f, 0.5f, -0.7f}}) == 1);
    CHECK(oracle.sure_crossings({{-3, 0.02f, 0.03f}, 0, {1, 0.01f, 0.02f}}) == 2);
    CHECK(oracle.sure_crossings({{-3, 2, 0}, 0, {1, 0.01f, 0.02f}}) == 0);
    const Vec3f corner = ball(1).p[0];
    CHECK(!oracle.sure_crossings({{0, 0, 0}, 0, corner}).has_value());
}

TEST_CASE("exact: wrong answers are told apart, and from those within the margin") {
    PlainMesh two;
    two.p = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, -1}, {1, 0, -1}, {0, 1, -1}};
    two.t = {{0, 1, 2}, {3, 4, 5}};
    const Oracle oracle = oracle_of({two});
    const auto judge = [&](const Ray& ray, uint32_t primitive, float t) {
        Hit hit;
        if (primitive != no_id)
            hit.primitive = primitive, hit.geometry = hit.instance = 0, hit.t = t;
        return oracle.judge(ray, hit, oracle.closest(ray));
    };
    const Ray middle{{0.25f, 0.25f, 1}, 0, {0, 0, -1}}, outside{{2, 2, 1}, 0, {0, 0, -1}};
    using Kind = Judgement::Kind;
    const auto is_fault_of = [](const Judgement& j, Kind kind) {
        return j.kind == kind && j.is_fault();
    };
    CHECK(judge(middle, 0, 1).kind == Kind::right);
    CHECK(judge(outside, no_id, 0).kind == Kind::right);
    CHECK(is_fault_of(judge(middle, no_id, 0), Kind::false_miss));
    CHECK(is_fault_of(judge(outside, 0, 1), Kind::false_hit));
    CHECK(is_fault_of(judge(middle, 1, 2), Kind::wrong_primitive));
    CHECK(is_fault_of(judge(middle, 0, 1.001f), Kind::wrong_t));
    CHECK(judge(middle, 0, std::nextafter(1.0f, 2.0f)).t_ulp == 1);
    CHECK(oracle.judge(middle, false, oracle.closest(middle)).is_fault());
    CHECK(oracle.judge(outside, true, oracle.closest(outside)).is_fault());
    // 2^-22 from an edge, at a distance of 1: the shear's rounding can take the ray across.
    const Ray near{{0.25f, 0x1p-22f, 1}, 0, {0, 0, -1}};
    CHECK(judge(near, no_id, 0).kind == Kind::false_miss);
    CHECK(!judge(near, no_id, 0).is_fault());
    CHECK(!judge(near, 1, 2).is_fault());
    const Ray beside{{0.25f, -0x1p-22f, 1}, 0, {0, 0, -1}};
    CHECK(judge(beside, 0, 1).kind == Kind::false_hit);
    CHECK(!judge(beside, 0, 1).is_fault());
    CHECK(judge({{0.25f, -0x1p-18f, 1}, 0, {0, 0, -1}}, 0, 1).is_fault());
}

namespace {

template <class Set>
bool set_is_hit(const Set& set, const Ray& ray) {
    return accelerator("brute_force").build(std::make_shared<const Set>(set), {})->occluded(ray);
}

}  // namespace

TEST_CASE("polygons: a ray through any edge or corner is inside") {
    // An octagon with integer corners, and edges in both axis directions.
    const std::vector<Vec3f> corners{{-1, -2, 0}, {1, -2, 0}, {2, -1, 0}, {2, 1, 0},
                                     {1, 2, 0},   {-1, 2, 0}, {-2, 1, 0}, {-2, -1, 0}};
    const PolygonSet set(corners, {0, 8});
    for (size_t k = 0; k < corners.size(); ++k) {
        const Vec3f middle = 0.5f * (corners[k] + corners[(k + 1) % 8]);
        INFO(k);
        CHECK(set_is_hit(set, {corners[k] + Vec3f(0, 0, 1), 0, {0, 0, -1}}));
        CHECK(set_is_hit(set, {middle + Vec3f(0, 0, 1), 0, {0, 0, -1}}));
        const Vec3f off = middle * (1 + 0x1p-20f);
        CHECK(!set_is_hit(set, {off + Vec3f(0, 0, 1), 0, {0, 0, -1}}));
    }
}

TEST_CASE("quadrics: nothing of radius 0 is hit") {
    const QuadricSet set({{QuadricKind::sphere, {0, 0, 0}, 0, {0, 0, 0}, 0},
                          {QuadricKind::disc, {3, 0, 0}, 0, {0, 0, 1}, 0},
                          {QuadricKind::cone, {6, 0, -1}, 0, {6, 0, 1}, 0}});
    for (float x : {0.0f, 3.0f, 6.0f}) {
        CHECK(!set_is_hit(set, {{x, 0, 5}, 0, {0, 0, -1}}));
        CHECK(!set_is_hit(set, {{x, 5, 0}, 0, {0, -1, 0}}));
        CHECK(!set_is_hit(set, {{x + 1, 1, 1}, 0, {-1, -1, -1}}));
    }
}

}  // namespace crofton
