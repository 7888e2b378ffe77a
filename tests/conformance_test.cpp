// Every registered accelerator, with every value of its choices, over every kind of set, against
// brute force: the same bits in t, u, v and the ids. A new accelerator is tested without a line
// here.

#include <cmath>
#include <cstring>
#include <map>

#include "framework/parallel.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

bool same_bits(const Hit& a, const Hit& b) { return std::memcmp(&a, &b, sizeof(Hit)) == 0; }

std::string describe(const Ray& r) {
    char text[256];
    std::snprintf(text, sizeof text, "o %a %a %a d %a %a %a t %a %a", r.origin[0], r.origin[1],
                  r.origin[2], r.direction[0], r.direction[1], r.direction[2], r.t_min, r.t_max);
    return text;
}

/// The defaults, then each other value of each choice and flag, and both ends of each number that
/// does not make a build of a small scene long.
std::vector<ParameterValues> variations(const AcceleratorInfo& info) {
    std::vector<ParameterValues> list{{}};
    for (const ParameterInfo& p : info.parameters) {
        for (const std::string& choice : p.choices) list.push_back({{p.name, choice}});
        if (std::holds_alternative<bool>(p.default_value))
            list.push_back({{p.name, !std::get<bool>(p.default_value)}});
        if (std::holds_alternative<int64_t>(p.default_value)) {
            list.push_back({{p.name, int64_t(p.minimum)}});
            list.push_back({{p.name, int64_t(std::min(p.maximum, 64.0))}});
        }
    }
    return list;
}

std::string text(const ParameterValues& values) {
    std::string s;
    for (const auto& [name, value] : values) s += " " + name + "=" + to_string(value);
    return s;
}

void compare(const Primitive& reference, const Primitive& tested, const std::vector<Ray>& rays) {
    size_t wrong = 0;
    for (const Ray& ray : rays) {
        const Hit expected = reference.intersect(ray), found = tested.intersect(ray);
        Counters counters;
        const bool good = same_bits(expected, found) &&
                          same_bits(found, tested.intersect(ray, counters)) &&
                          tested.occluded(ray) == expected.is_hit() &&
                          tested.occluded(ray, counters) == expected.is_hit();
        if (good) continue;
        if (++wrong > 3) continue;
        UNSCOPED_INFO(describe(ray) << ": expected primitive " << expected.primitive << " instance "
                                    << expected.instance << " at " << expected.t << ", found "
                                    << found.primitive << " instance " << found.instance << " at "
                                    << found.t << ", occluded " << tested.occluded(ray));
    }
    CHECK(wrong == 0);
}

}  // namespace

TEST_CASE("every accelerator returns brute force's bits over every set") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto reference = accelerator("brute_force").build(scene.set, {});
        for (const auto& [name, info] : accelerators())
            for (const ParameterValues& values : variations(info)) {
                INFO(name << text(values) << " over " << scene.name);
                const auto tested = info.build(scene.set, values);
                CHECK(tested->bounds().contains(test::bounds_of(scene.set)));
                compare(*reference, *tested, scene.rays);
            }
    }
}

TEST_CASE("every instruction set returns the same bits") {
    const std::string before = active_isa();
    for (const test::HardScene& scene : test::hard_scenes()) {
        set_isa("sse4");
        const auto reference = accelerator("brute_force").build(scene.set, {});
        for (const std::string& isa : available_isas()) {
            set_isa(isa);
            for (const auto& [name, info] : accelerators()) {
                INFO(name << " on " << isa << " over " << scene.name);
                compare(*reference, *info.build(scene.set, {}), scene.rays);
            }
        }
    }
    set_isa(before);
}

TEST_CASE("no ray from inside a closed mesh gets out through a vertex or an edge") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        if (!scene.closed) continue;
        for (const auto& [name, info] : accelerators()) {
            const auto tested = info.build(scene.set, {});
            test::Random random(99);
            size_t leaks = 0;
            for (int i = 0; i < 4000; ++i) {
                const Vec3f a = scene.vertices[random.next() % scene.vertices.size()];
                const Vec3f b = scene.vertices[random.next() % scene.vertices.size()];
                const float s = i & 1 ? 0 : random.uniform();
                Ray ray;
                ray.origin = scene.inside;
                ray.direction = a + (b - a) * s - scene.inside;
                leaks += !tested->intersect(ray).is_hit();
            }
            INFO(name << " over " << scene.name);
            CHECK(leaks == 0);
        }
    }
}

TEST_CASE("a ray that a large triangle's test accepts in its error finds it in every structure") {
    // Triangles of 1e3 with an edge in an axis-aligned plane: rays begin a few 1e-5 outside that
    // plane, where the box of the triangle, or of the part of it near the ray, ends.
    const auto edge_triangles = [](test::Random& random) {
        std::vector<Vec3f> corners;
        for (uint32_t i = 0; i < 12; ++i) {
            Vec3f a = random.point(1000), b = random.point(1000), c = random.point(1000);
            const int axis = int(random.next() % 3);
            a[axis] = b[axis] = random.uniform(-1, 1);
            c[axis] = a[axis] - random.uniform(0, 2) * (random.next() & 1 ? 1.0f : 100.0f);
            corners.insert(corners.end(), {a, b, c});
        }
        return corners;
    };
    // One shape a leaf, so that no neighbour's box helps; and every builder, cutting as it may.
    const auto settings = [](const AcceleratorInfo& info) {
        ParameterValues base;
        std::vector<ParameterValues> list;
        for (const ParameterInfo& p : info.parameters) {
            if (p.name == "max_leaf_size") base[p.name] = int64_t(1);
            if (p.name == "split_overlap") base[p.name] = 0.0;
            if (p.name == "reference_budget") base[p.name] = p.maximum;
        }
        for (const ParameterInfo& p : info.parameters)
            for (const std::string& choice : p.choices)
                if (p.name == "builder") {
                    list.push_back(base);
                    list.back()[p.name] = choice;
                }
        if (list.empty()) list.push_back(base);
        return list;
    };
    std::map<std::string, size_t> wrong;
    test::Random random(5);
    for (int scene = 0; scene < 150; ++scene) {
        const std::vector<Vec3f> corners = edge_triangles(random);
        std::vector<std::array<uint32_t, 3>> triangles;
        for (uint32_t i = 0; i < 12; ++i) triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
        const PrimitiveSet set = std::make_shared<const TriangleSet>(corners, triangles);
        const auto reference = accelerator("brute_force").build(set, {});
        std::vector<Ray> rays(400);
        for (Ray& ray : rays) {
            const uint32_t t = random.next() % 12;
            const Vec3f a = corners[3 * t], b = corners[3 * t + 1];
            ray.direction = random.direction();
            ray.origin = a + (b - a) * random.uniform() +
                         random.point(std::pow(10.0f, random.uniform(-6, -4))) -
                         ray.direction * std::pow(10.0f, random.uniform(-6, 0));
        }
        std::vector<Hit> expected;
        for (const Ray& ray : rays) expected.push_back(reference->intersect(ray));
        for (const auto& [name, info] : accelerators())
            for (const ParameterValues& values : settings(info)) {
                const auto tested = info.build(set, values);
                size_t& count = wrong[name + text(values)];
                for (size_t i = 0; i < rays.size(); ++i)
                    count += !same_bits(expected[i], tested->intersect(rays[i]));
            }
    }
    for (const auto& [name, count] : wrong) {
        INFO(name);
        CHECK(count == 0);
    }
}

TEST_CASE("a build does not depend on the number of threads") {
    for (const test::HardScene& scene : test::hard_scenes())
        for (const auto& [name, info] : accelerators()) {
            set_threads(1);
            const StructureStatistics one = info.build(scene.set, {})->statistics();
            set_threads(4);
            const StructureStatistics four = info.build(scene.set, {})->statistics();
            set_threads(0);
            INFO(name << " over " << scene.name);
            CHECK(one.N_IN == four.N_IN);
            CHECK(one.N_V == four.N_V);
            CHECK(one.N_OIV == four.N_OIV);
            CHECK(one.bytes == four.bytes);
        }
}

TEST_CASE("a structure's own boxes stay inside its bounds and hold as many references as it says") {
    for (const test::HardScene& scene : test::hard_scenes())
        for (const auto& [name, info] : accelerators()) {
            const auto tested = info.build(scene.set, {});
            uint64_t references = 0;
            bool inside = true;
            tested->walk([&](const Bounds3& b, uint32_t, bool, uint32_t n) {
                references += n;
                // A cell's corners are rounded to float once more than the bounds are.
                inside = inside && widened(tested->bounds(), 1e-5f).contains(b);
            });
            INFO(name << " over " << scene.name);
            CHECK(inside);
            CHECK(references == tested->statistics().N_OIV);
        }
}

TEST_CASE("a wrong parameter is refused with its name, range or the nearest valid value") {
    const test::HardScene scene = test::hard_scenes()[1];
    const auto message = [&](const std::string& name,
                             const ParameterValues& values) -> std::string {
        try {
            accelerator(name).build(scene.set, values);
        } catch (const std::exception& e) {
            return e.what();
        }
        return "accepted";
    };
    CHECK(message("bvh", {{"bin", int64_t(8)}}).find("did you mean 'bins'") != std::string::npos);
    CHECK(message("bvh", {{"bins", int64_t(1)}}).find("outside 2 ... 64") != std::string::npos);
    CHECK(message("bvh", {{"bins", true}}).find("expected an integer") != std::string::npos);
    CHECK(message("uniform_grid", {{"resolution", std::string("wo")}}).find("'woo'") !=
          std::string::npos);
    CHECK(message("uniform_grid", {{"density", int64_t(2)}}) == "accepted");
    CHECK_THROWS(accelerator("bhv"));
}

}  // namespace crofton
