// Accelerators inside accelerators: every ordered pair, three levels deep, under maps that scale,
// shear and mirror. Hits have the bits of one flat structure over baked vertices.

#include <random>

#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/quadric_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

Transform shear(double xy, double yz) {
    Transform t;
    t.linear(0, 1) = xy;
    t.linear(1, 2) = yz;
    return t;
}

TEST_CASE("ids: a shape is found in its run, however runs are spread, and in parts of a set") {
    std::mt19937 random(3);
    for (const uint32_t count : {1u, 2u, 3u, 17u, 400u})
        for (const bool crowded : {false, true}) {
            CAPTURE(count, crowded);
            // Some empty; crowded: all but one among the first few shapes of very many.
            std::vector<IdTable::Run> runs;
            for (uint32_t r = 0, first = 0; r < count; ++r) {
                runs.push_back({first, 10 + r, 5 * r, r % 3});
                first += random() % 4 == 0 ? 0 : 1 + random() % (crowded ? 3 : 5000);
                if (crowded && r + 2 == count) first = 3'000'000'000u;
            }
            const IdTable table(runs);
            const auto expected = [&](uint32_t shape) {
                size_t r = runs.size() - 1;
                while (runs[r].first > shape) --r;
                return Hit{0,
                           0,
                           0,
                           runs[r].primitive + (shape - runs[r].first),
                           runs[r].geometry,
                           100 + runs[r].instance};
            };
            const uint32_t end = runs.back().first + 5000;
            std::vector<uint32_t> shapes{0, 1, end - 1, ~0u - 1};
            for (const IdTable::Run& run : runs)
                for (const uint32_t shape : {run.first, run.first + 1, std::max(run.first, 1u) - 1})
                    shapes.push_back(shape);
            for (int i = 0; i < 1000; ++i) shapes.push_back(uint32_t(random() % end));
            const IdTable part = table.subset(shapes);
            size_t wrong = 0;
            for (size_t i = 0; i < shapes.size(); ++i) {
                const Hit right = expected(shapes[i]);
                Hit hit, of_part;
                table.resolve(shapes[i], 100, hit);
                part.resolve(uint32_t(i), 100, of_part);
                for (const Hit& h : {hit, of_part})
                    wrong += h.primitive != right.primitive || h.geometry != right.geometry ||
                             h.instance != right.instance;
            }
            CHECK(wrong == 0);
        }
}

/// Powers of two and short sums: composed maps are exact, in whatever order they are multiplied.
std::vector<Transform> maps() {
    return {
        translation({1.5, -0.5, 0.25}),
        translation({-1, 2, 0.5}) * scaling({0.5, 2, 1}),
        translation({0, -2, 1}) * scaling({-1, 1, 1}),
        translation({2, 1, -1}) * shear(0.5, -0.25),
        translation({-2, -1, -1.5}) * shear(-0.25, 0.5) * scaling({0.25, -0.5, 2}),
    };
}

struct World {
    std::vector<Vec3f> positions;
    std::vector<std::array<uint32_t, 3>> triangles;
    std::vector<IdTable::Run> runs;

    void add(const std::vector<Vec3f>& p, const std::vector<std::array<uint32_t, 3>>& t,
             const Transform& world_from_object, uint32_t instance) {
        runs.push_back({uint32_t(triangles.size()), 0, 0, instance});
        const FloatTransform f = rounded(world_from_object);
        const uint32_t base = uint32_t(positions.size());
        for (const Vec3f& v : p) positions.push_back(apply(f, v));
        for (const auto& [a, b, c] : t) triangles.push_back({base + a, base + b, base + c});
    }
};

}  // namespace

TEST_CASE("every ordered pair nests three levels deep with the bits of the flat structure") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(1, p, t);
    const auto mesh = std::make_shared<const TriangleSet>(p, t);

    World world;
    uint32_t instance = 0;
    for (const Transform& outer : maps())
        for (const Transform& inner : maps()) world.add(p, t, outer * inner, instance++);
    const auto flat_set =
        std::make_shared<const TriangleSet>(world.positions, world.triangles, IdTable(world.runs));
    const auto flat = accelerator("brute_force").build(flat_set, {});
    const std::vector<Ray> rays = test::hard_rays(flat->bounds(), world.positions, 5);

    for (const auto& [outer, outer_info] : accelerators())
        for (const auto& [inner, inner_info] : accelerators()) {
            const std::shared_ptr<const Primitive> leaf = inner_info.build(mesh, {});
            std::vector<ObjectSet::Object> low, high;
            for (uint32_t i = 0; i < maps().size(); ++i)
                low.push_back({std::make_shared<Instance>(leaf, maps()[i]), i});
            const std::shared_ptr<const Primitive> middle =
                outer_info.build(std::make_shared<const ObjectSet>(low), {});
            for (uint32_t i = 0; i < maps().size(); ++i)
                high.push_back(
                    {std::make_shared<Instance>(middle, maps()[i]), i * uint32_t(maps().size())});
            const auto top = inner_info.build(std::make_shared<const ObjectSet>(high), {});

            INFO(inner << " in " << outer << " in " << inner);
            CHECK(test::different_hits(*flat, *top, rays) == 0);
        }
}

TEST_CASE("quadrics and triangles nest in one structure") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(2, p, t);
    const auto mesh = std::make_shared<const TriangleSet>(p, t);
    const auto ball = std::make_shared<const QuadricSet>(
        std::vector<QuadricShape>{{QuadricKind::sphere, {0, 0, 0}, 1, {0, 0, 0}, 0}});
    test::Random random(3);
    for (const auto& [name, info] : accelerators()) {
        // The fine mesh is inscribed in the sphere: an ellipsoid around it is hit first, always.
        const Transform map = translation({3, 2, 1}) * shear(0.3, 0.2) * scaling({2, 0.7, 1.3});
        std::vector<ObjectSet::Object> both{
            {std::make_shared<Instance>(std::shared_ptr<const Primitive>(info.build(mesh, {})),
                                        map),
             0},
            {std::make_shared<Instance>(std::shared_ptr<const Primitive>(info.build(ball, {})),
                                        map),
             1}};
        const auto top = info.build(std::make_shared<const ObjectSet>(both), {});
        size_t hits = 0, wrong = 0;
        for (int i = 0; i < 2000; ++i) {
            Ray ray;
            ray.origin = Vec3f(3, 2, 1) + random.direction() * 9;
            ray.direction = Vec3f(3, 2, 1) + random.point(1) - ray.origin;
            const Hit hit = top->intersect(ray);
            hits += hit.is_hit();
            wrong += hit.is_hit() && hit.instance != 1;
        }
        INFO(name);
        CHECK(hits > 1000);
        CHECK(wrong == 0);
    }
}

TEST_CASE("the box of a turned structure leaves out corners that its parts leave empty") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(3, p, t);
    const auto mesh = std::make_shared<const TriangleSet>(p, t);
    const Transform map = translation({3, 2, 1}) * rotation({1, 2, 3}, 0.7);
    World world;
    world.add(p, t, map, 0);
    const auto flat =
        accelerator("brute_force")
            .build(std::make_shared<const TriangleSet>(world.positions, world.triangles), {});
    for (const auto& [name, info] : accelerators()) {
        const std::shared_ptr<const Primitive> ball = info.build(mesh, {});
        const Instance once(ball, map);
        INFO(name);
        const Bounds3 box = transformed(rounded(map), ball->bounds());
        CHECK(half_area(once.bounds()) <= half_area(box));
        if (name == "wide_bvh") CHECK(half_area(once.bounds()) < 0.9 * half_area(box));
        // Of an instance in an instance, too; and it still holds the mesh.
        const Instance twice(std::make_shared<const Instance>(ball, rotation({1, 2, 3}, 0.7)),
                             translation({3, 2, 1}));
        if (name == "wide_bvh") CHECK(half_area(twice.bounds()) < 0.9 * half_area(box));
        for (const Instance* instance : {&once, &twice})
            CHECK(test::different_hits(*flat, *instance,
                                       test::hard_rays(flat->bounds(), world.positions, 4)) == 0);
    }
}

TEST_CASE("thirty-two nested transforms keep the hit of the composed map") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(2, p, t);
    for (const auto& [name, info] : accelerators()) {
        std::shared_ptr<const Primitive> nested =
            info.build(std::make_shared<const TriangleSet>(p, t), {});
        Transform composed;
        for (int i = 0; i < 32; ++i) {
            const Transform step = i % 2 ? shear(0.25, -0.125) * scaling({1e3, -1e3, 1e3})
                                         : translation({1, 2, 3}) * scaling({1e-3, 1e-3, 1e-3});
            nested = std::make_shared<Instance>(nested, step);
            composed = step * composed;
        }
        World world;
        world.add(p, t, composed, 0);
        const auto flat =
            info.build(std::make_shared<const TriangleSet>(world.positions, world.triangles), {});
        test::Random random(17);
        size_t missed = 0, far = 0;
        for (int i = 0; i < 1000; ++i) {
            const Vec3f target = world.positions[random.next() % world.positions.size()];
            Ray ray;
            ray.origin =
                flat->bounds().center() + random.direction() * flat->bounds().extent().norm();
            ray.direction = target - ray.origin;
            const Hit a = flat->intersect(ray), b = nested->intersect(ray);
            missed += a.is_hit() != b.is_hit();
            // Composing in another order moves vertices by about 1e-7 of the size.
            far += a.is_hit() && std::abs(a.t - b.t) > 1e-4f;
        }
        INFO(name);
        CHECK(missed == 0);
        CHECK(far == 0);
    }
}

TEST_CASE("a map without an inverse is refused before it can place anything") {
    CHECK_FALSE(Instance::is_valid(scaling({1, 0, 1})));
    CHECK_FALSE(Instance::is_valid(scaling({1, std::nan(""), 1})));
    CHECK_FALSE(Instance::is_valid(scaling({1, 1e39, 1})));
    CHECK(Instance::is_valid(scaling({1e3, 1, 1e-3})));
}

}  // namespace crofton
