#include "framework/triangle_patches.h"

#include <cmath>
#include <fstream>
#include <iterator>
#include <map>
#include <numeric>

#include "framework/archive.h"
#include "framework/parallel.h"
#include "framework/primitive.h"
#include "framework/registry.h"
#include "tests/catch.h"
#include "tests/height_field.h"
#include "tests/scratch_file.h"

namespace crofton {
namespace {

/// n triangles of a strip: corners k, k + 1, k + 2.
TriangleSet strip(uint32_t n) {
    std::vector<Vec3f> corners;
    for (uint32_t k = 0; k < n + 2; ++k) corners.emplace_back(float(k / 2), float(k % 2), 0.0f);
    std::vector<TriangleSet::Indices> triangles;
    for (uint32_t k = 0; k < n; ++k) triangles.push_back({k, k + 1, k + 2});
    return TriangleSet(corners, triangles);
}

/// n triangles that share nothing.
TriangleSet soup(uint32_t n) {
    std::vector<Vec3f> corners;
    std::vector<TriangleSet::Indices> triangles;
    for (uint32_t k = 0; k < n; ++k) {
        const float x = float(2 * k);
        for (const Vec3f& p : {Vec3f(x, 0, 0), Vec3f(x + 1, 0, 0), Vec3f(x, 1, 0)})
            corners.push_back(p);
        triangles.push_back({3 * k, 3 * k + 1, 3 * k + 2});
    }
    return TriangleSet(corners, triangles);
}

std::vector<uint32_t> all(const TriangleSet& set) {
    std::vector<uint32_t> shapes(set.size());
    std::iota(shapes.begin(), shapes.end(), 0u);
    return shapes;
}

void check_patches(const TriangleSet& set, uint32_t expected) {
    TrianglePatches patches;
    CHECK(patches.add(set, all(set)) == 0);
    CHECK(patches.size() == expected);
    CHECK(TrianglePatches::count_patches(set, all(set)) == expected);
    std::map<uint32_t, int> seen;
    for (uint32_t p = 0; p < patches.size(); ++p) {
        const TrianglePatch& patch = patches.patches()[p];
        REQUIRE(patch.count <= TrianglePatch::width);
        for (uint32_t i = 0; i < patch.count; ++i) {
            const uint32_t id = patch.id(i, patches.ids());
            ++seen[id];
            for (int k = 0; k < 3; ++k) CHECK(patch.vertex(i, k) == set.vertex(id, k));
        }
    }
    CHECK(seen.size() == set.size());
    for (const auto& [id, times] : seen) CHECK(times == 1);
}

TEST_CASE("triangle patches: neighbours share corners, and every triangle is in one patch") {
    check_patches(strip(6), 1);
    check_patches(strip(7), 2);
    check_patches(strip(100), 17);
    check_patches(soup(2), 1);
    check_patches(soup(3), 2);
    check_patches(soup(70), 35);
}

TEST_CASE("triangle patches: a mesh in wide_bvh takes at most 43 bytes a triangle, 38 quantised") {
    constexpr uint32_t n = 128;
    const HeightField mesh(
        n, [](float x, float y) { return Vec3f(x, y, 8 * std::sin(0.1f * (x * x + 3 * y))); });
    const PrimitiveSet set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    const auto bytes = [&](const ParameterValues& values) {
        return double(accelerator("wide_bvh").build(set, values)->statistics().bytes) / (2 * n * n);
    };
    CHECK(bytes({}) <= 43);
    CHECK(bytes({{"nodes", std::string("quantised")}}) <= 38);
}

TEST_CASE("a wide_bvh is the same, byte for byte, for any number of threads") {
    constexpr uint32_t n = 160;
    const HeightField mesh(
        n, [](float x, float y) { return Vec3f(x, y, 8 * std::sin(0.1f * (x * x + 3 * y))); });
    const PrimitiveSet set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    const auto saved = [&](int threads, const ParameterValues& values) {
        set_threads(threads);
        const auto structure = accelerator("wide_bvh").build(set, values);
        set_threads(0);
        const ScratchFile file("structure", "");
        save_structure(*structure, file.path());
        std::ifstream in(file.path(), std::ios::binary);
        return std::string(std::istreambuf_iterator<char>(in), {});
    };
    for (const std::string builder : {"lbvh", "binned_sah", "sbvh"})
        for (const std::string nodes : {"full", "quantised"}) {
            INFO(builder << ", " << nodes);
            const ParameterValues values{{"builder", builder},
                                         {"nodes", nodes},
                                         {"reinsertion", int64_t(builder == "sbvh")}};
            const std::string one = saved(1, values), four = saved(4, values);
            CHECK(one.size() > 1000000);
            CHECK((one == four));
        }
}

TEST_CASE("thin rays: a scene's size does not make its small parts thick") {
    // A flat mesh of a hundredth, and far below it a triangle of a thousand.
    constexpr uint32_t n = 16;
    HeightField mesh(n, [](float x, float y) { return Vec3f(0.01f * x / n, 0.01f * y / n, 0); });
    const uint32_t far = uint32_t(mesh.corners.size());
    for (const Vec3f& p : {Vec3f(-500, -500, -500), Vec3f(500, -500, -500), Vec3f(0, 500, -500)})
        mesh.corners.push_back(p);
    mesh.triangles.push_back({far, far + 1, far + 2});
    const PrimitiveSet set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    for (const char* name : {"bvh", "wide_bvh"}) {
        INFO(name);
        const auto object = accelerator(name).build(set, {});
        Counters counters;
        Ray ray;
        ray.origin = Vec3f(-0.001f, 0.004f, 1e-5f);
        ray.direction = Vec3f(1, 0.1f, 1e-4f);
        CHECK_FALSE(object->intersect(ray, counters).is_hit());
        CHECK(counters.N_IT == 0);
    }
}

}  // namespace
}  // namespace crofton
