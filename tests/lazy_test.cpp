// Structures that are built where rays go: the same bits, from any number of threads, and nothing
// that no ray needed.

#include "framework/lazy.h"

#include <algorithm>
#include <thread>

#include "framework/parallel.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

const ParameterValues small_parts{{"lazy", true}, {"lazy_size", int64_t(16)}};

/// Parts that some ray has built, and all that are known of.
void count_parts(const Primitive& p, size_t& built, size_t& known) {
    if (const auto* lazy = dynamic_cast<const LazyObject*>(&p)) {
        ++known;
        built += lazy->built() != nullptr;
    }
    p.children([&](const Primitive& child) { count_parts(child, built, known); });
}

}  // namespace

TEST_CASE("every lazy accelerator returns the eager one's bits, in parts of parts") {
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto reference = accelerator("brute_force").build(scene.set, {});
        for (const auto& [name, info] : accelerators()) {
            INFO(name << " over " << scene.name);
            const auto lazy = info.build(scene.set, small_parts);
            CHECK(lazy->bounds().contains(test::bounds_of(scene.set)));
            CHECK(test::different_hits(*reference, *lazy, scene.rays) == 0);
        }
    }
}

TEST_CASE("what no ray meets is not built") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(5, p, t);
    const auto set = std::make_shared<const TriangleSet>(p, t);
    for (const auto& [name, info] : accelerators()) {
        INFO(name);
        const auto lazy = info.build(set, {{"lazy", true}, {"lazy_size", int64_t(256)}});
        size_t built = 0, known = 0;
        count_parts(*lazy, built, known);
        CHECK(built == 0);
        CHECK(known == 1);
        Ray away;
        away.origin = {0, 0, 5};
        away.direction = {0, 0, 1};
        CHECK_FALSE(lazy->intersect(away).is_hit());
        const uint64_t before = total_statistics(*lazy).bytes;
        Ray ray;
        ray.origin = {0.1f, 0.2f, 5};
        ray.direction = {0, 0, -1};
        CHECK(lazy->intersect(ray).is_hit());
        built = known = 0;
        count_parts(*lazy, built, known);
        CHECK(built > 1);
        CHECK(built < known);
        CHECK(total_statistics(*lazy).bytes > before);
    }
}

TEST_CASE("threads that need the same part at once wait for one build of it") {
    const test::HardScene scene = test::hard_scenes()[1];
    set_threads(4);
    for (const auto& [name, info] : accelerators()) {
        INFO(name);
        const auto eager = info.build(scene.set, {});
        const auto lazy = info.build(scene.set, small_parts);
        std::vector<size_t> wrong(4, 0);
        std::vector<std::thread> threads;
        for (size_t k = 0; k < wrong.size(); ++k)
            threads.emplace_back(
                [&, k] { wrong[k] = test::different_hits(*eager, *lazy, scene.rays); });
        for (std::thread& thread : threads) thread.join();
        CHECK(wrong == std::vector<size_t>(4, 0));

        // Rays traced in parallel loops: a build inside must not take up another ray.
        const auto again = info.build(scene.set, small_parts);
        std::vector<uint8_t> same(scene.rays.size(), 0);
        parallel_for(scene.rays.size(), 1, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                same[i] = test::different_hits(*eager, *again, {&scene.rays[i], 1}) == 0;
        });
        CHECK(std::count(same.begin(), same.end(), 1) == std::ptrdiff_t(same.size()));
    }
    set_threads(0);
}

TEST_CASE("a wrong parameter of a lazy structure is refused before any ray") {
    const test::HardScene scene = test::hard_scenes()[1];
    ParameterValues bad = small_parts;
    bad["bins"] = int64_t(1);
    CHECK_THROWS(accelerator("bvh").build(scene.set, bad));
}

}  // namespace crofton
