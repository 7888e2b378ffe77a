// What grids promise about work, in counts: empty space and crowded places.

#include <cmath>
#include <memory>
#include <vector>

#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

class Triangles {
  public:
    void add(const Vec3f& a, const Vec3f& b, const Vec3f& c) {
        const uint32_t i = uint32_t(positions_.size());
        positions_.insert(positions_.end(), {a, b, c});
        triangles_.push_back({i, i + 1, i + 2});
    }
    PrimitiveSet set() const { return std::make_shared<const TriangleSet>(positions_, triangles_); }

  private:
    std::vector<Vec3f> positions_;
    std::vector<TriangleSet::Indices> triangles_;
};

/// Two heaps of small triangles in opposite corners of a cube of edge 1000.
PrimitiveSet two_heaps() {
    Triangles t;
    for (int corner = 0; corner < 2; ++corner)
        for (int i = 0; i < 64; ++i) {
            const Vec3f at = Vec3f::Constant(999.0f * float(corner)) +
                             0.2f * Vec3f(float(i & 3), float(i >> 2 & 3), float(i >> 4));
            t.add(at, at + Vec3f(0.2f, 0, 0.1f), at + Vec3f(0, 0.2f, 0.1f));
        }
    return t.set();
}

Counters trace(const Primitive& primitive, const Vec3f& from, const Vec3f& to) {
    Counters counters;
    Ray ray;
    ray.origin = from;
    ray.direction = to - from;
    primitive.intersect(ray, counters);
    return counters;
}

}  // namespace

TEST_CASE("uniform_grid: a ray through an empty region passes it in a few steps") {
    const PrimitiveSet set = two_heaps();
    ParameterValues values{{"resolution", std::string("fixed")},
                           {"resolution_x", int64_t(128)},
                           {"resolution_y", int64_t(128)},
                           {"resolution_z", int64_t(128)}};
    const auto skipping = accelerator("uniform_grid").build(set, values);
    values["skip_empty"] = false;
    const auto walking = accelerator("uniform_grid").build(set, values);
    // Across the diagonal that neither heap lies on: 128 cells along x alone.
    const Vec3f from(-10, 990, 400), to(1010, 20, 610);
    const Counters fast = trace(*skipping, from, to), slow = trace(*walking, from, to);
    CHECK(fast.N_IT == 0);
    CHECK(slow.N_TS > 256);
    // The distance to the next block in use halves on the way there: log2(128 / 4) cubes and a few.
    CHECK(fast.N_TS <= 16);
}

TEST_CASE("sparse_grid: a ray passes empty nodes of each level at once") {
    const auto grid = accelerator("sparse_grid").build(two_heaps(), {});
    // 4096 voxels along each axis, in 32 blocks of the root: a ray that meets no child of it takes
    // at most 3·32 steps.
    const Counters empty = trace(*grid, Vec3f(-10, 990, 400), Vec3f(1010, 20, 610));
    CHECK(empty.N_IT == 0);
    CHECK(empty.N_TS <= 96);
    // Into a heap from nearby: blocks of the root, then of a node, then voxels of a leaf.
    const Counters full = trace(*grid, Vec3f(-10, 3, 5), Vec3f(0.3f, 0.2f, 0.1f));
    CHECK(full.N_IT > 0);
    CHECK(full.N_TS <= 3 * (32 + 16 + 8));
}

TEST_CASE("sparse_grid, nested_grid: a fan of long triangles is not one list") {
    Triangles t;
    constexpr int spokes = 512;
    for (int i = 0; i < spokes; ++i) {
        const float a = float(2 * M_PI * i / spokes), b = float(2 * M_PI * (i + 1) / spokes);
        t.add(Vec3f(0, 0, 0), 100 * Vec3f(std::cos(a), std::sin(a), 0),
              100 * Vec3f(std::cos(b), std::sin(b), 0));
    }
    const PrimitiveSet set = t.set();
    const auto sparse = accelerator("sparse_grid").build(set, {});
    const auto coarse = accelerator("sparse_grid").build(set, {{"refinements", int64_t(0)}});
    const auto nested = accelerator("nested_grid").build(set, {});
    // From above, a tenth of the radius away from where all meet.
    const Vec3f from(10, 1, 5), to(9, 2, 0);
    const uint64_t unrefined = trace(*coarse, from, to).N_IT;
    CHECK(trace(*sparse, from, to).N_IT * 2 < unrefined);
    CHECK(trace(*nested, from, to).N_IT < unrefined);
}

TEST_CASE("grids: voxels refined and empty space walked return brute force's bits") {
    const std::vector<std::pair<std::string, ParameterValues>> variants = {
        {"sparse_grid", {{"max_per_voxel", int64_t(1)}, {"refinements", int64_t(2)}}},
        {"sparse_grid", {{"max_per_voxel", int64_t(4)}, {"density", 0.3}}},
        {"uniform_grid", {{"skip_empty", false}}},
        {"uniform_grid", {{"density", 30.0}}},
        {"nested_grid", {{"max_per_cell", int64_t(1)}, {"density", 4.0}}},
    };
    for (const test::HardScene& scene : test::hard_scenes()) {
        const auto reference = accelerator("brute_force").build(scene.set, {});
        for (const auto& [name, values] : variants) {
            INFO(scene.name << ", " << name << " " << values.begin()->first);
            const auto grid = accelerator(name).build(scene.set, values);
            CHECK(test::different_hits(*reference, *grid, scene.rays) == 0);
        }
    }
}

}  // namespace crofton
