// Micro-benchmarks: ray set-up, ray/box, ray/triangle, leaves, builds, traversals.
// Run `build/release/crofton_bench`; `--benchmark_filter=` chooses, `--benchmark_list_tests` lists.

#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>
#include <vector>

#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "scenegraph/procedural/procedural.h"
#include "scenegraph/shape_sets.h"

namespace crofton {
namespace {

/// Terrain of 2·n² triangles: smooth neighbours, as in a scanned mesh.
PrimitiveSet terrain(int n) {
    const Scene scene = make_scene("terrain", {{"n", double(n)}});
    ShapeSetBuilder builder(scene);
    for (uint32_t m = 0; m < scene.meshes.size(); ++m) builder.add_mesh(m, nullptr, 0);
    return builder.take().front();
}

Bounds3 bounds_of(const TriangleSet& set) {
    Bounds3 b;
    for (uint32_t i = 0; i < set.size(); ++i) b.extend(set.bounds(i));
    return b;
}

/// Rays from a sphere around the bounds to points inside, by a fixed sequence.
std::vector<Ray> rays_through(const Bounds3& b, size_t n) {
    std::vector<Ray> rays(n);
    uint64_t state = 1;
    const auto next = [&] {
        state = state * 6364136223846793005ull + 1442695040888963407ull;
        return float(state >> 40) * 0x1p-24f;
    };
    const float radius = b.extent().norm();
    for (Ray& ray : rays) {
        const float z = 2 * next() - 1, a = 6.2831853f * next(), r = std::sqrt(1 - z * z);
        ray.origin = b.center() + radius * Vec3f(r * std::cos(a), r * std::sin(a), z);
        const Vec3f target = b.lower + Vec3f(next(), next(), next()).cwiseProduct(b.extent());
        ray.direction = target - ray.origin;
    }
    return rays;
}

void trace(benchmark::State& state, const Primitive& primitive, const std::vector<Ray>& rays) {
    size_t i = 0;
    for (auto _ : state) {
        benchmark::DoNotOptimize(primitive.intersect(rays[i]));
        if (++i == rays.size()) i = 0;
    }
    state.SetItemsProcessed(int64_t(state.iterations()));
}

std::shared_ptr<const TriangleSet> some_triangles(int n) {
    std::vector<Vec3f> p;
    std::vector<TriangleSet::Indices> t;
    for (int i = 0; i < n; ++i) {
        const float x = float(i) * 0.01f;
        p.insert(p.end(), {{x, 0, 0}, {x + 1, 0, 0.1f}, {x, 1, 0.2f}});
        t.push_back({uint32_t(3 * i), uint32_t(3 * i + 1), uint32_t(3 * i + 2)});
    }
    return std::make_shared<const TriangleSet>(p, t);
}

/// What every ray costs before it meets anything: set-up, the seam, and a box that it misses.
void ray_box_miss(benchmark::State& state) {
    const auto primitive = accelerator("brute_force").build(some_triangles(1), {});
    Ray ray;
    ray.origin = Vec3f(5, 5, 5);
    ray.direction = Vec3f(0.3f, 0.5f, 1);
    for (auto _ : state) benchmark::DoNotOptimize(primitive->intersect(ray));
}
BENCHMARK(ray_box_miss);

/// The watertight test, hit and miss by turns, one leaf of n triangles.
void leaf(benchmark::State& state) {
    const auto set = some_triangles(int(state.range(0)));
    const auto primitive = accelerator("brute_force").build(set, {});
    trace(state, *primitive, rays_through(bounds_of(*set), 1024));
}
BENCHMARK(leaf)->Arg(1)->Arg(4)->Arg(16)->Arg(64);

void build(benchmark::State& state, const std::string& name) {
    const PrimitiveSet set = terrain(int(state.range(0)));
    for (auto _ : state) benchmark::DoNotOptimize(accelerator(name).build(set, {}));
    state.SetItemsProcessed(int64_t(state.iterations()) * 2 * state.range(0) * state.range(0));
}

void traverse(benchmark::State& state, const std::string& name) {
    const PrimitiveSet set = terrain(int(state.range(0)));
    const auto primitive = accelerator(name).build(set, {});
    trace(state, *primitive, rays_through(primitive->bounds(), 1 << 14));
}

}  // namespace
}  // namespace crofton

int main(int argc, char** argv) {
    using namespace crofton;
    for (const std::string& name : accelerator_names()) {
        if (name == "brute_force") continue;
        benchmark::RegisterBenchmark(("build/" + name).c_str(), build, name)
            ->Arg(64)
            ->Arg(256)
            ->Unit(benchmark::kMillisecond);
        benchmark::RegisterBenchmark(("traverse/" + name).c_str(), traverse, name)
            ->Arg(64)
            ->Arg(256);
    }
    benchmark::Initialize(&argc, argv);
    if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
    benchmark::RunSpecifiedBenchmarks();
}
