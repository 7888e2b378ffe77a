#include "tests/hard_scenes.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"

namespace crofton::test {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float nan = std::numeric_limits<float>::quiet_NaN();
using Triangles = std::vector<std::array<uint32_t, 3>>;

struct Soup {
    std::vector<Vec3f> p;
    Triangles t;
    void add(const Vec3f& a, const Vec3f& b, const Vec3f& c) {
        const uint32_t n = uint32_t(p.size());
        p.insert(p.end(), {a, b, c});
        t.push_back({n, n + 1, n + 2});
    }
};

HardScene triangles(std::string name, Soup soup, uint64_t seed, bool closed = false) {
    HardScene scene;
    scene.name = std::move(name);
    scene.vertices = soup.p;
    const auto set = std::make_shared<const TriangleSet>(soup.p, soup.t);
    scene.set = set;
    scene.closed = closed;
    scene.rays = hard_rays(bounds_of(scene.set), scene.vertices, seed);
    return scene;
}

Soup sphere(int level, const Vec3f& scale, const Vec3f& offset) {
    Soup soup;
    icosphere(level, soup.p, soup.t);
    for (Vec3f& p : soup.p) p = p.cwiseProduct(scale) + offset;
    return soup;
}

Soup random_soup(int n, float size) {
    Soup soup;
    Random random(7);
    for (int i = 0; i < n; ++i) {
        const Vec3f c = random.point(1);
        soup.add(c + random.point(size), c + random.point(size), c + random.point(size));
    }
    return soup;
}

/// Integer heights on an integer grid: rays hit edges, vertices and cell planes exactly.
Soup steps(int n) {
    Soup soup;
    for (int y = 0; y <= n; ++y)
        for (int x = 0; x <= n; ++x) soup.p.emplace_back(x, y, (x * 7 + y * 3) % 4);
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            const uint32_t i = uint32_t(y * (n + 1) + x), j = i + uint32_t(n) + 1;
            soup.t.push_back({i, i + 1, j + 1});
            soup.t.push_back({i, j + 1, j});
        }
    return soup;
}

/// Everything that is no good triangle, beside a few that are.
Soup broken() {
    Soup soup = random_soup(60, 0.4f);
    soup.add({0, 0, 0}, {0, 0, 0}, {0, 0, 0});
    soup.add({0, 0, 0}, {1, 1, 1}, {0.5f, 0.5f, 0.5f});
    soup.add({0, 0, 0}, {1, 0, 0}, {1, 0, 0});
    soup.add({nan, 0, 0}, {1, 0, 0}, {0, 1, 0});
    soup.add({0, 0, infinity}, {1, 0, 0}, {0, 1, 0});
    soup.add({0, 0, 0}, {1, 0, 0}, {0.5f, 1e-38f, 0});
    soup.add({-1, -1, 0}, {1, -1, 1e-7f}, {0, 1, 0});
    return soup;
}

Soup duplicates(int n) {
    Soup soup;
    for (int i = 0; i < n; ++i) soup.add({-1, -1, 0}, {1, -1, 0.25f}, {0, 1, 0});
    return soup;
}

/// Nested triangles with one centroid, in one plane.
Soup concentric(int n) {
    Soup soup;
    for (int i = 1; i <= n; ++i) {
        const float s = float(i);
        soup.add({-s, -s, 0}, {s, -s, 0}, {0, 2 * s, 0});
    }
    return soup;
}

Soup slivers(int n) {
    Soup soup;
    Random random(11);
    for (int i = 0; i < n; ++i) {
        const Vec3f a = random.point(1), d = random.direction() * 3;
        soup.add(a, a + d, a + d * 0.5f + random.direction() * 1e-6f);
    }
    return soup;
}

/// A fan around one vertex: thin wedges that share it.
Soup fan(int n) {
    Soup soup;
    soup.p.emplace_back(0.1f, 0.2f, 0.3f);
    for (int i = 0; i < n; ++i) {
        const float a = 6.2831853f * float(i) / float(n);
        soup.p.emplace_back(std::cos(a), std::sin(a), 0.2f * std::sin(5 * a));
    }
    for (int i = 0; i < n; ++i) soup.t.push_back({0, uint32_t(1 + i), uint32_t(1 + (i + 1) % n)});
    return soup;
}

/// A small detailed ball in a huge, sparse ring: the lecture's worst case.
Soup ball_in_stadium() {
    Soup soup = sphere(2, Vec3f::Constant(1), Vec3f(0, 0, 0));
    for (int i = 0; i < 64; ++i) {
        const float a = 6.2831853f * float(i) / 64, b = 6.2831853f * float(i + 1) / 64;
        const Vec3f p(1000 * std::cos(a), 1000 * std::sin(a), -10),
            q(1000 * std::cos(b), 1000 * std::sin(b), -10);
        soup.add(p, q, p + Vec3f(0, 0, 300));
        soup.add(q, q + Vec3f(0, 0, 300), p + Vec3f(0, 0, 300));
    }
    return soup;
}

/// One thing at every power of two: a tree that wants to be a list.
Soup powers_of_two() {
    Soup soup;
    for (int e = -60; e <= 60; ++e) {
        const float s = std::ldexp(1.0f, e);
        soup.add({s, 0, 0}, {s * 1.5f, s * 0.3f, 0}, {s, 0, s * 0.5f});
    }
    return soup;
}

/// @param size  of the scene; also at the ends of the declared range
HardScene quadrics(float size = 1) {
    Random random(21);
    std::vector<QuadricShape> shapes;
    HardScene scene;
    for (int i = 0; i < 60; ++i) {
        const Vec3f c = random.point(2), e = c + random.point(0.8f);
        const float r = random.uniform(0.02f, 0.4f);
        const QuadricKind kind = QuadricKind(i % 3);
        const float second = i % 6 == 1 ? r : i % 6 == 4 ? 0 : r * 0.3f;
        shapes.push_back({kind, c, r, kind == QuadricKind::disc ? random.direction() : e, second});
        scene.vertices.push_back(c);
        scene.vertices.push_back(e);
    }
    shapes.push_back({QuadricKind::sphere, {0, 0, 0}, 0, {0, 0, 0}, 0});
    shapes.push_back({QuadricKind::sphere, {nan, 0, 0}, 1, {0, 0, 0}, 0});
    shapes.push_back({QuadricKind::sphere, {0, 0, 0}, -1, {0, 0, 0}, 0});
    shapes.push_back({QuadricKind::cone, {0, 0, 0}, 0.5f, {0, 0, 0}, 0.5f});
    shapes.push_back({QuadricKind::disc, {0, 0, 0}, 0.5f, {0, 0, 0}, 0});
    shapes.push_back({QuadricKind::cone, {0, 0, -3}, 0.5f, {0, 0, 3}, 0.5f});
    shapes.push_back({QuadricKind::disc, {1, 1, 1}, 1, {0, 0, 2}, 0.4f});
    for (QuadricShape& s : shapes) {
        s.p *= size;
        s.p_radius *= size;
        if (s.kind != QuadricKind::disc) s.q *= size;
        s.q_radius *= size;
    }
    for (Vec3f& v : scene.vertices) v *= size;
    scene.name =
        "spheres, cones, cylinders, discs, of 10^" + std::to_string(std::lround(std::log10(size)));
    scene.set = std::make_shared<const QuadricSet>(shapes);
    scene.rays = hard_rays(bounds_of(scene.set), scene.vertices, 22);
    return scene;
}

HardScene polygons(float size = 1) {
    Random random(31);
    HardScene scene;
    std::vector<Vec3f> corners;
    std::vector<uint32_t> first{0};
    for (int i = 0; i < 50; ++i) {
        const Vec3f c = random.point(1.5f), n = random.direction();
        const Vec3f u = n.unitOrthogonal(), v = n.cross(u);
        const int k = 3 + int(random.next() % 9);
        for (int j = 0; j < k; ++j) {
            // Alternating radii make stars: simple, not convex.
            const float a = 6.2831853f * float(j) / float(k), r = j % 2 ? 0.5f : 0.2f;
            corners.push_back(c + (u * std::cos(a) + v * std::sin(a)) * r);
        }
        first.push_back(uint32_t(corners.size()));
    }
    // An axis-aligned square, one without area, one with NaN.
    corners.insert(corners.end(), {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}});
    first.push_back(uint32_t(corners.size()));
    corners.insert(corners.end(), {{0, 0, 0}, {1, 1, 1}, {2, 2, 2}});
    first.push_back(uint32_t(corners.size()));
    corners.insert(corners.end(), {{nan, 0, 0}, {1, 1, 1}, {2, 0, 2}});
    first.push_back(uint32_t(corners.size()));
    for (Vec3f& v : corners) v *= size;
    scene.name = "polygons, of 10^" + std::to_string(std::lround(std::log10(size)));
    scene.vertices = corners;
    scene.set = std::make_shared<const PolygonSet>(corners, first);
    scene.rays = hard_rays(bounds_of(scene.set), corners, 32);
    return scene;
}

HardScene objects() {
    HardScene scene;
    std::vector<ObjectSet::Object> list;
    Random random(41);
    for (uint32_t i = 0; i < 20; ++i) {
        Soup soup = sphere(1, Vec3f::Constant(random.uniform(0.1f, 0.8f)), random.point(2));
        const auto set =
            std::make_shared<const TriangleSet>(soup.p, soup.t, IdTable({{0, i % 3, 0, 0}}));
        list.push_back({accelerator("brute_force").build(set, {}), i});
        scene.vertices.insert(scene.vertices.end(), soup.p.begin(), soup.p.end());
    }
    const auto empty = std::make_shared<const TriangleSet>(std::vector<Vec3f>{}, Triangles{});
    list.push_back({accelerator("brute_force").build(empty, {}), 20});
    scene.name = "objects that overlap, one empty";
    scene.set = std::make_shared<const ObjectSet>(list);
    scene.rays = hard_rays(bounds_of(scene.set), scene.vertices, 42);
    return scene;
}

}  // namespace

uint32_t Random::next() {
    state_ = state_ * 6364136223846793005ull + 1442695040888963407ull;
    const uint32_t x = uint32_t(((state_ >> 18) ^ state_) >> 27), r = uint32_t(state_ >> 59);
    return (x >> r) | (x << ((32 - r) & 31));
}

Vec3f Random::point(float radius) {
    const float x = uniform(-radius, radius), y = uniform(-radius, radius);
    return {x, y, uniform(-radius, radius)};
}

Vec3f Random::direction() {
    const float z = uniform(-1, 1), a = uniform(0, 6.2831853f);
    const float r = std::sqrt(std::max(0.0f, 1 - z * z));
    return {r * std::cos(a), r * std::sin(a), z};
}

void icosphere(int level, std::vector<Vec3f>& p, Triangles& t) {
    const float f = 1.6180339887f;
    p = {{-1, f, 0},  {1, f, 0},  {-1, -f, 0}, {1, -f, 0}, {0, -1, f},  {0, 1, f},
         {0, -1, -f}, {0, 1, -f}, {f, 0, -1},  {f, 0, 1},  {-f, 0, -1}, {-f, 0, 1}};
    t = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
         {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
         {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
    for (Vec3f& v : p) v.normalize();
    for (int l = 0; l < level; ++l) {
        std::map<std::pair<uint32_t, uint32_t>, uint32_t> middles;
        const auto middle = [&](uint32_t a, uint32_t b) {
            const auto [it, fresh] = middles.try_emplace(std::minmax(a, b), uint32_t(p.size()));
            if (fresh) p.push_back((p[a] + p[b]).normalized());
            return it->second;
        };
        Triangles finer;
        for (const auto& [a, b, c] : t) {
            const uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
            finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
        }
        t = std::move(finer);
    }
}

size_t different_hits(const Primitive& a, const Primitive& b, std::span<const Ray> rays) {
    size_t n = 0;
    for (const Ray& ray : rays) {
        const Hit x = a.intersect(ray), y = b.intersect(ray);
        n += std::memcmp(&x, &y, sizeof(Hit)) != 0 || a.occluded(ray) != b.occluded(ray);
    }
    return n;
}

Bounds3 bounds_of(const PrimitiveSet& any) {
    Bounds3 b;
    std::visit(
        [&](const auto& set) {
            for (uint32_t i = 0; i < set->size(); ++i)
                if (set->active(i)) b.extend(set->bounds(i));
        },
        any);
    return b;
}

std::vector<Ray> hard_rays(const Bounds3& given, const std::vector<Vec3f>& all, uint64_t seed) {
    const Bounds3 bounds = given.empty() ? Bounds3{{-1, -1, -1}, {1, 1, 1}} : given;
    Random random(seed);
    std::vector<Ray> rays;
    std::vector<Vec3f> vertices;
    for (const Vec3f& v : all)
        if (v.allFinite()) vertices.push_back(v);
    if (vertices.empty()) vertices.push_back(bounds.center());
    const Vec3f center = bounds.center(), half = bounds.extent() * 0.5f;
    const float size = std::max(half.stableNorm(), std::numeric_limits<float>::min());
    const auto inside = [&] { return Vec3f(center + random.point(1.2f).cwiseProduct(half)); };
    const auto vertex = [&] { return vertices[random.next() % vertices.size()]; };
    const auto add = [&](const Vec3f& o, const Vec3f& d, float t_min = 0, float t_max = infinity) {
        rays.push_back({o, t_min, d, t_max});
    };
    for (int i = 0; i < 150; ++i) add(inside(), random.direction());
    for (int i = 0; i < 150; ++i) {
        const Vec3f d = random.direction();
        add(center + random.point(1).cwiseProduct(half) - d * size * 3, d);
    }
    // Axis-parallel, with +0 and -0, from inside and through vertices.
    for (int i = 0; i < 120; ++i) {
        Vec3f d = Vec3f::Constant(i & 1 ? 0.0f : -0.0f);
        d[i % 3] = i & 2 ? 1.0f : -1.0f;
        const Vec3f through = i & 4 ? vertex() : inside();
        add(i & 8 ? through : Vec3f(through - d * size), d);
    }
    // In one axis-aligned plane, or nearly.
    for (int i = 0; i < 120; ++i) {
        Vec3f d = random.direction();
        constexpr float tiny[] = {0.0f, -0.0f, 1e-45f, -1e-38f, 1e-18f, 1e-7f};
        d[i % 3] = tiny[i % 6];
        const Vec3f through = vertex();
        add(i & 1 ? through : Vec3f(through - d * size), d);
    }
    // At vertices and at points of segments between them; direction not normalised.
    for (int i = 0; i < 300; ++i) {
        const Vec3f a = vertex(), b = vertex();
        const float s = i & 1 ? 0.0f : random.uniform();
        const Vec3f o = i & 2 ? inside() : Vec3f(center + random.direction() * size * 2.5f);
        add(o, a + (b - a) * s - o);
    }
    // Far origins, and directions of extreme length.
    for (int i = 0; i < 60; ++i) {
        const Vec3f d = random.direction();
        const float far = size * std::pow(10.0f, float(1 + i % 8));
        add(inside() - d * far, d);
        constexpr float lengths[] = {1e-30f, 1e-18f, 1e-6f, 1e6f, 1e18f, 1e30f};
        add(inside(), random.direction() * lengths[i % 6]);
    }
    // Intervals: short, exactly reaching, empty, negative.
    for (int i = 0; i < 60; ++i) {
        const Vec3f a = vertex(), o = inside();
        add(o, a - o, 0, i & 1 ? 1.0f : std::nextafter(1.0f, 0.0f));
        add(o, a - o, i & 1 ? 1.0f : std::nextafter(1.0f, 2.0f));
        add(o, a - o, -3.0f, i & 1 ? 0.5f : -0.5f);
        add(o, a - o, 0.3f, 0.3f);
        add(o, a - o, 0.5f, 0.25f);
    }
    for (const float bad : {nan, infinity, -infinity}) {
        add({bad, 0, 0}, {0, 0, 1});
        add({0, 0, 0}, {0, bad, 1});
        add({0, 0, 0}, {0, 0, 1}, bad, bad);
    }
    add({0, 0, 0}, {0, 0, 1}, 0, nan);
    add({0, 0, 0}, {0, 0, 0});
    return rays;
}

std::vector<HardScene> hard_scenes() {
    std::vector<HardScene> scenes;
    scenes.push_back(triangles("no triangle", {}, 1));
    scenes.push_back(triangles("one triangle", duplicates(1), 2));
    scenes.push_back(triangles("random triangles", random_soup(500, 0.15f), 3));
    scenes.push_back(triangles("long triangles", random_soup(100, 2.0f), 4));
    scenes.push_back(
        triangles("a closed ball", sphere(3, Vec3f::Constant(1), Vec3f::Zero()), 5, true));
    scenes.push_back(
        triangles("an anisotropic ball", sphere(2, {1e3f, 1, 1e-3f}, Vec3f::Zero()), 6, true));
    scenes.push_back(
        triangles("a ball at 1e4", sphere(2, Vec3f::Constant(1), {1e4f, -1e4f, 1e4f}), 7, true));
    scenes.back().inside = {1e4f, -1e4f, 1e4f};
    scenes.push_back(
        triangles("a ball of 1e-20", sphere(2, Vec3f::Constant(1e-20f), Vec3f::Zero()), 8, true));
    scenes.push_back(
        triangles("a ball of 1e18", sphere(2, Vec3f::Constant(1e18f), Vec3f::Zero()), 9, true));
    scenes.push_back(triangles("integer steps", steps(12), 10));
    scenes.push_back(triangles("broken triangles", broken(), 11));
    scenes.push_back(triangles("one triangle 300 times", duplicates(300), 12));
    scenes.push_back(triangles("concentric coplanar triangles", concentric(200), 13));
    scenes.push_back(triangles("slivers", slivers(200), 14));
    scenes.push_back(triangles("a fan of 257", fan(257), 15));
    scenes.push_back(triangles("a ball in a stadium", ball_in_stadium(), 16));
    scenes.push_back(triangles("powers of two", powers_of_two(), 17));
    for (const float size : {1.0f, 1e-20f, 1e18f}) {
        scenes.push_back(quadrics(size));
        scenes.push_back(polygons(size));
    }
    scenes.push_back(objects());
    return scenes;
}

}  // namespace crofton::test
