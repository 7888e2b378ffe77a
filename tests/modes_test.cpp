// The modes of a query: the same bits from every structure, and each mode's promise against the
// oracle.

#include <cmath>
#include <cstring>

#include "framework/exact.h"
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

constexpr Mode careful_modes[] = {Mode::robust, Mode::double_precision, Mode::exact};

bool same_bits(const Hit& a, const Hit& b) { return std::memcmp(&a, &b, sizeof(Hit)) == 0; }

/// Rays whose answers differ in mode `mode`, closest or any, with counting or without.
size_t different_hits(const Primitive& a, const Primitive& b, std::span<const Ray> rays,
                      Mode mode) {
    size_t n = 0;
    for (const Ray& ray : rays) {
        const Hit expected = a.intersect(ray, mode);
        Counters counters;
        n += !same_bits(expected, b.intersect(ray, mode)) ||
             !same_bits(expected, b.intersect(ray, counters, mode)) ||
             b.occluded(ray, mode) != expected.is_hit();
    }
    return n;
}

/// The shapes of a set as the oracle takes them; ids count from 0.
std::optional<exact::Oracle> oracle_of(const PrimitiveSet& any) {
    exact::Oracle oracle;
    if (const auto* t = std::get_if<std::shared_ptr<const TriangleSet>>(&any)) {
        const TriangleSet& set = **t;
        std::vector<Vec3f> corners;
        std::vector<std::array<uint32_t, 3>> triangles;
        for (uint32_t i = 0; i < set.size(); ++i) {
            triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
            for (int k = 0; k < 3; ++k) corners.push_back(set.vertex(i, k));
        }
        oracle.add_triangles(corners, triangles, {});
    } else if (const auto* q = std::get_if<std::shared_ptr<const QuadricSet>>(&any)) {
        std::vector<QuadricShape> shapes;
        for (uint32_t i = 0; i < (*q)->size(); ++i) shapes.push_back((*q)->shape(i));
        oracle.add_quadrics(shapes, {});
    } else if (const auto* p = std::get_if<std::shared_ptr<const PolygonSet>>(&any)) {
        std::vector<Vec3f> corners;
        std::vector<uint32_t> first{0};
        for (uint32_t i = 0; i < (*p)->size(); ++i) {
            const auto part = (*p)->corners(i);
            corners.insert(corners.end(), part.begin(), part.end());
            first.push_back(uint32_t(corners.size()));
        }
        oracle.add_polygons(corners, first, {});
    } else {
        return std::nullopt;
    }
    oracle.finish();
    return oracle;
}

/// Floats between two.
int64_t steps(float a, float b) {
    const auto ordinal = [](float f) {
        int32_t bits;
        std::memcpy(&bits, &f, 4);
        return bits >= 0 ? int64_t(bits) : -int64_t(bits & 0x7fffffff);
    };
    return std::abs(ordinal(a) - ordinal(b));
}

std::string text(const Ray& r, const Hit& hit, const exact::Answer& truth) {
    char line[320];
    std::snprintf(line, sizeof line, "o %a %a %a d %a %a %a t %a %a: %u at %a, truly %u at %a",
                  r.origin[0], r.origin[1], r.origin[2], r.direction[0], r.direction[1],
                  r.direction[2], r.t_min, r.t_max, hit.primitive, hit.t,
                  truth.is_hit() ? truth.ties[0].primitive : no_id, truth.t());
    return line;
}

/// Counts what breaks the promise of `exact` and of `double`.
void check_promises(const Primitive& tested, const exact::Oracle& oracle,
                    std::span<const Ray> rays) {
    size_t not_exact = 0, beyond_ulp = 0, faults = 0;
    for (const Ray& ray : rays) {
        const exact::Answer truth = oracle.closest(ray);
        Hit expected;
        if (truth.is_hit()) expected = truth.ties[0];
        const Hit hit = tested.intersect(ray, Mode::exact);
        const bool right = hit.primitive == expected.primitive &&
                           hit.geometry == expected.geometry && hit.instance == expected.instance &&
                           hit.t == expected.t &&
                           tested.occluded(ray, Mode::exact) == truth.is_hit();
        if (!right && ++not_exact <= 3) UNSCOPED_INFO("exact: " << text(ray, hit, truth));

        const Hit fine = tested.intersect(ray, Mode::double_precision);
        const bool near = !truth.has(fine) || steps(fine.t, truth.t()) <= 1;
        if (!near && ++beyond_ulp <= 3) UNSCOPED_INFO("double: " << text(ray, fine, truth));

        for (const Mode mode : {Mode::robust, Mode::double_precision, Mode::exact}) {
            const Hit h = tested.intersect(ray, mode);
            if (oracle.judge(ray, h, truth).is_fault() && ++faults <= 3)
                UNSCOPED_INFO(name_of(mode) << ": " << text(ray, h, truth));
        }
    }
    CHECK(not_exact == 0);
    CHECK(beyond_ulp == 0);
    CHECK(faults == 0);
}

}  // namespace

TEST_CASE("modes: every accelerator returns brute force's bits in robust, double and exact") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto reference = accelerator("brute_force").build(scene.set, {});
        for (const auto& [name, info] : accelerators()) {
            std::vector<ParameterValues> variants{{}};
            if (name == "wide_bvh") variants.push_back({{"leaves", std::string("compact")}});
            for (const ParameterValues& values : variants) {
                const auto tested = info.build(scene.set, values);
                for (const Mode mode : careful_modes) {
                    INFO(name << (values.empty() ? "" : ", compact") << " in " << name_of(mode)
                              << " over " << scene.name);
                    CHECK(different_hits(*reference, *tested, scene.rays, mode) == 0);
                }
            }
        }
    }
}

TEST_CASE("modes: outside the declared range, answers are defined: in time, and no NaN") {
    std::vector<Vec3f> ball;
    std::vector<std::array<uint32_t, 3>> triangles;
    test::icosphere(1, ball, triangles);
    for (const float size : {1e-44f, 1e-38f, 1e-30f, 1e-24f, 1e22f, 1e30f, 3e38f}) {
        std::vector<Vec3f> corners;
        for (const Vec3f& p : ball) corners.push_back(p * size);
        const PrimitiveSet sets[] = {
            std::make_shared<const TriangleSet>(corners, triangles),
            std::make_shared<const PolygonSet>(
                std::vector<Vec3f>{
                    {-size, -size, 0}, {size, -size, 0}, {size, size, size}, {-size, size, size}},
                std::vector<uint32_t>{0, 4}),
            std::make_shared<const QuadricSet>(
                std::vector<QuadricShape>{{QuadricKind::sphere, {0, 0, 0}, size, {0, 0, 0}, 0},
                                          {QuadricKind::disc, {0, 0, 0}, size, {0, 0, 1}, 0},
                                          {QuadricKind::cone, {0, 0, 0}, size, {0, size, 0}, 0}})};
        for (const PrimitiveSet& set : sets) {
            std::vector<Ray> rays = test::hard_rays(test::bounds_of(set), corners, 41);
            for (size_t i = 0; i < rays.size(); i += 2) rays[i].direction *= size;
            for (const auto& [name, info] : accelerators()) {
                const auto tested = info.build(set, {});
                for (const Mode mode :
                     {Mode::fast, Mode::robust, Mode::double_precision, Mode::exact}) {
                    INFO(name << " in " << name_of(mode) << ", set " << set.index() << " of size "
                              << size);
                    size_t wrong = 0;
                    for (const Ray& ray : rays) {
                        const Hit hit = tested->intersect(ray, mode);
                        const bool is_shape = hit.primitive < triangles.size() && hit.u >= 0 &&
                                              hit.u <= 1 && hit.v >= 0 && hit.v <= 1 &&
                                              hit.t >= ray.t_min && hit.t <= ray.t_max;
                        const bool defined = is_shape || same_bits(hit, Hit{});
                        if (!defined && ++wrong <= 2) UNSCOPED_INFO(text(ray, hit, {}));
                    }
                    CHECK(wrong == 0);
                }
            }
        }
    }
}

TEST_CASE("modes: without one, a query is robust") {
    CHECK(name_of(Mode::robust) == "robust");
    const test::HardScene scene = test::hard_scenes()[0];
    const auto tested = accelerator("bvh").build(scene.set, {});
    for (const Ray& ray : scene.rays)
        CHECK(same_bits(tested->intersect(ray), tested->intersect(ray, Mode::robust)));
}

TEST_CASE("modes: exact is the oracle's answer, and double within an ulp of it") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto oracle = oracle_of(scene.set);
        if (!oracle) continue;
        const auto tested = accelerator("bvh").build(scene.set, {});
        INFO(scene.name);
        check_promises(*tested, *oracle, scene.rays);
    }
}

TEST_CASE("modes: under nested maps the truth is that of the placed corners") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(1, p, t);
    Geometry geometry;
    geometry.shapes = TriangleMesh{p, t};
    Scene scene;
    for (int i = 0; i < 6; ++i) {
        Transform map = rotation(Vec3d(1, 2, 3).normalized(), i) *
                        scaling(Vec3d(1 + 0.1 * i, 0.7, i % 2 ? -1.3 : 1.3));
        map.translation = Vec3d(1.7 * i, 0.3 * i, -0.2 * i);
        scene.add_object("ball" + std::to_string(i), geometry, map);
    }
    const auto choice = std::make_shared<AcceleratorChoice>();
    choice->label = choice->type = "bvh";
    AssemblyPlan plan;
    plan.top = plan.objects = choice;
    const exact::Oracle oracle = make_oracle(scene, PlacementTruth::as_placed);
    for (const bool bake : {false, true}) {
        INFO((bake ? "baked" : "instances"));
        plan.bake = bake;
        const Assembly assembly = assemble(scene, plan);
        check_promises(*assembly.root, oracle, test::hard_rays(assembly.root->bounds(), p, 5));
    }
}

TEST_CASE("modes: two sheets a fraction of an ulp of t apart are told apart by exact alone") {
    // Seen from 2^20 away, t of both rounds to the same float; the nearer one has the higher id.
    const float far = 0x1p20f, gap = 0x1p-10f;
    const std::vector<Vec3f> p{{-1, -1, 0},   {1, -1, 0},   {0, 1, 0},
                               {-1, -1, gap}, {1, -1, gap}, {0, 1, gap}};
    const auto set = std::make_shared<const TriangleSet>(
        p, std::vector<TriangleSet::Indices>{{0, 1, 2}, {3, 4, 5}});
    const Ray ray{{0, 0, far}, 0, {0, 0, -1}};
    for (const auto& [name, info] : accelerators()) {
        INFO(name);
        const auto tested = info.build(set, {});
        CHECK(tested->intersect(ray, Mode::robust).primitive == 0);
        CHECK(tested->intersect(ray, Mode::exact).primitive == 1);
        CHECK(tested->intersect(ray, Mode::exact).t == far);
    }
}

TEST_CASE("modes: fast is right outside its margin") {
    // Smaller triangles are outside of the range that it states.
    const auto in_range = [](const PrimitiveSet& any) {
        const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&any);
        for (uint32_t i = 0; set && i < (*set)->size(); ++i) {
            if (!(*set)->active(i)) continue;
            const float size = (*set)->bounds(i).extent().maxCoeff();
            if (size > 0 && size < 1e-14f) return false;
        }
        return true;
    };
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto oracle = oracle_of(scene.set);
        if (!oracle || !in_range(scene.set)) continue;
        const auto tested = accelerator("bvh").build(scene.set, {});
        size_t wrong = 0;
        for (const Ray& ray : scene.rays) {
            const float length = ray.direction.norm();
            if (!(length > 1e-6f && length < 1e6f)) continue;
            if (!(oracle->margin(ray) >= 1)) continue;
            const exact::Answer truth = oracle->closest(ray);
            if (truth.is_hit() && !(truth.t() < 1e15f)) continue;
            const Hit hit = tested->intersect(ray, Mode::fast);
            wrong += hit.is_hit() ? !truth.has(hit) : truth.is_hit();
        }
        INFO(scene.name);
        CHECK(wrong == 0);
    }
}

TEST_CASE(
    "modes: an interval holds the hit that it ends at, and not the one a float beyond its end") {
    // Occlusion is answered in float where that is certain: of slivers, of triangles seen from the
    // side or from within their plane, and of large ones close by, it must not be too sure.
    test::Random random(11);
    size_t hits = 0, wrong = 0;
    const auto look = [&](const Primitive& object, Ray ray, float t_min, float t_max, bool hit,
                          Mode mode) {
        ray.t_min = t_min, ray.t_max = t_max;
        wrong += object.occluded(ray, mode) != hit || object.intersect(ray, mode).is_hit() != hit;
    };
    const auto power = [&](int least, int most) {
        return std::exp2(random.uniform(float(least), float(most)));
    };
    for (int i = 0; i < 2000; ++i) {
        const float size = power(-20, 20);
        const Vec3f a = random.point(size * power(-3, 6));
        const Vec3f along = random.direction() * size;
        const Vec3f across = random.direction() * size * power(-16, 1);
        auto set =
            std::make_shared<const TriangleSet>(std::vector<Vec3f>{a, a + along, a + across},
                                                std::vector<TriangleSet::Indices>{{0, 1, 2}});
        for (const char* name : {"bvh", "wide_bvh"}) {
            const auto object = accelerator(name).build(set, {});
            for (int k = 0; k < 8; ++k) {
                float u = random.uniform(), v = random.uniform();
                if (u + v > 1) u = 1 - u, v = 1 - v;
                // From any side, or nearly along the triangle; from afar, or from its surface.
                Ray ray;
                ray.direction = (k % 2 ? random.direction()
                                       : Vec3f(along * random.uniform(-1, 1) / size +
                                               random.direction() * power(-12, 0))) *
                                power(-8, 8);
                ray.origin = a + u * along + v * across - ray.direction * size * power(-20, 3);
                ray.t_min = -INFINITY;
                const Hit hit = object->intersect(ray);
                if (!hit.is_hit()) continue;
                ++hits;
                for (const Mode mode : {Mode::robust, Mode::double_precision}) {
                    const float t = object->intersect(ray, mode).t;
                    const float before = std::nextafter(t, -INFINITY),
                                after = std::nextafter(t, INFINITY);
                    look(*object, ray, -INFINITY, t, true, mode);
                    look(*object, ray, -INFINITY, before, false, mode);
                    look(*object, ray, t, INFINITY, true, mode);
                    look(*object, ray, after, INFINITY, false, mode);
                    look(*object, ray, t, t, true, mode);
                    const float far = std::abs(t) * power(-22, -6);
                    look(*object, ray, t - far, t + far, true, mode);
                    look(*object, ray, after + far, t + 2 * far + size, false, mode);
                }
            }
        }
    }
    CHECK(wrong == 0);
    CHECK(hits > 20000);
}

TEST_CASE("modes: so far away that the product of origin and 1/d would not be a float") {
    // Sheets across the x axis, 1e22 away from it, met by rays along it.
    std::vector<Vec3f> corners;
    std::vector<std::array<uint32_t, 3>> triangles;
    for (uint32_t i = 0; i < 64; ++i) {
        const float x = 1e17f * float(i), y = 1e22f, size = 4e15f;
        for (const Vec3f& p :
             {Vec3f(x, y - size, -1e15f), Vec3f(x, y + size, -1e15f), Vec3f(x, y, 2e15f)})
            corners.push_back(p);
        triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const PrimitiveSet set = std::make_shared<const TriangleSet>(corners, triangles);
    for (const auto& [name, info] : accelerators()) {
        const auto tested = info.build(set, {});
        for (const float dy : {0.0f, -0.0f, 1e-30f, -1e-30f}) {
            INFO(name << ", " << dy);
            const Hit hit = tested->intersect(Ray{{-1e17f, 1e22f, 0}, 0, {1, dy, 0}});
            CHECK(hit.primitive == 0);
        }
    }
}

}  // namespace crofton
