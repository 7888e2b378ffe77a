#include "framework/compact_patches.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <numeric>

#include "framework/archive.h"
#include "framework/parallel.h"
#include "framework/primitive.h"
#include "framework/registry.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
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
    const PatchCorners corners(set);
    TrianglePatches patches;
    CHECK(patches.add(corners, all(set)) == 0);
    CHECK(patches.size() == expected);
    CHECK(corners.count_patches(all(set)) == expected);
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

TEST_CASE("patches: corners at one place have one number, whatever their indices") {
    // A strip whose triangles share no indices, and the same as a few triangles of a large mesh.
    for (const uint32_t unused : {0u, 100000u}) {
        const TriangleSet joined = strip(60);
        std::vector<Vec3f> corners{{7, 7, 7}};
        corners.resize(1 + unused, Vec3f(1, 0, 0));
        std::vector<TriangleSet::Indices> triangles;
        for (uint32_t i = 0; i < joined.size(); ++i) {
            const uint32_t k = uint32_t(corners.size());
            for (int c = 0; c < 3; ++c) corners.push_back(joined.vertex(i, c));
            triangles.push_back({k, k + 1, k + 2});
        }
        if (unused) triangles.push_back({0, 0, 0});
        const TriangleSet cut(corners, triangles);
        const PatchCorners numbers(cut);
        CHECK(numbers.count_patches(all(joined)) == 10);
        std::map<std::array<float, 3>, uint32_t> number;
        for (uint32_t i = 0; i < cut.size(); ++i)
            for (int c = 0; c < 3; ++c) {
                const Vec3f& v = cut.vertex(i, c);
                const uint32_t n = numbers.triangles()[i][size_t(c)];
                CHECK(number.try_emplace({v[0], v[1], v[2]}, n).first->second == n);
                CHECK(Vec3f(Eigen::Map<const Vec3f>(numbers.coordinates() + 3 * n)) == v);
            }
    }
}

/// Compact patches of the same triangles: corners by their bits, ids, and no more vertices than
/// asked.
void check_compact(const TriangleSet& set, size_t most_vertices) {
    const PatchCorners corners(set);
    TrianglePatches full;
    const std::vector<uint32_t> shapes = all(set);
    for (size_t i = 0; i < shapes.size(); i += 16)
        full.add(corners, std::span(shapes).subspan(i, std::min<size_t>(16, shapes.size() - i)));
    const CompactPatches compact(full);
    REQUIRE(compact.size() == full.size());
    size_t wrong = 0;
    uint32_t vertices = 0;
    for (uint32_t p = 0; p < full.size(); ++p) {
        const TrianglePatch& a = full.patches()[p];
        const CompactPatch& b = compact.patches()[p];
        REQUIRE(a.count == b.count());
        for (uint32_t i = 0; i < a.count; ++i) {
            wrong += a.id(i, full.ids()) != b.id(i, compact.ids());
            for (uint32_t k = 0; k < 3; ++k) {
                const uint32_t at = b.vertex(i, k);
                const Vec3f corner = a.vertex(i, int(k));
                wrong += std::memcmp(compact.vertices() + size_t{3} * at, &corner, 12) != 0;
                vertices = std::max(vertices, at + 1);
            }
        }
    }
    CHECK(wrong == 0);
    CHECK(vertices <= most_vertices);
}

TEST_CASE("compact patches: the same corners and ids; vertices are shared within reach") {
    check_compact(strip(6), 8);
    check_compact(strip(100000), 101000);
    check_compact(soup(70), 210);
    check_compact(TriangleSet(), 0);
    // Zero has two signs, which are two positions.
    check_compact(TriangleSet({{0, 0, 0}, {-0.0f, 0, 0}, {1, 0, 0}}, {{0, 1, 2}, {2, 1, 0}}), 3);
    // Rows that begin again at the same corners are beyond reach if they are long.
    const auto rows = [](uint32_t length) {
        std::vector<Vec3f> corners;
        std::vector<TriangleSet::Indices> triangles;
        for (uint32_t k = 0; k < length + 2; ++k)
            corners.emplace_back(float(k / 2), float(k % 2), 0.0f);
        for (int row = 0; row < 8; ++row)
            for (uint32_t k = 0; k < length; ++k) triangles.push_back({k, k + 1, k + 2});
        return TriangleSet(corners, triangles);
    };
    check_compact(rows(100), 102);
    check_compact(rows(1000), 8 * 1002);
    // Neighbours whose ids are far apart have a list.
    std::vector<TriangleSet::Indices> apart(100000, {0, 1, 2});
    for (size_t i = 0; i < apart.size(); i += 2) apart[i] = {1, 2, 3};
    const std::vector<Vec3f> corners{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 1}};
    const TriangleSet set(corners, apart);
    TrianglePatches full;
    const std::vector<uint32_t> near{3, 5, 7}, far{2, 70000}, most{9, 65544}, more{9, 65545};
    for (const auto* leaf : {&near, &far, &most, &more}) full.add(PatchCorners(set), *leaf);
    const CompactPatches compact(full);
    REQUIRE(compact.size() == 4);
    uint32_t p = 0;
    for (const auto* leaf : {&near, &far, &most, &more}) {
        for (uint32_t i = 0; i < leaf->size(); ++i)
            CHECK(compact.patches()[p].id(i, compact.ids()) == (*leaf)[i]);
        ++p;
    }
    CHECK(compact.bytes() == 4 * sizeof(CompactPatch) + (4 * 3 + 1) * 4 + 4 * 4);
}

TEST_CASE("triangle patches: a mesh in wide_bvh takes at most 43 bytes a triangle, 27 compact") {
    constexpr uint32_t n = 128;
    const HeightField mesh(
        n, [](float x, float y) { return Vec3f(x, y, 8 * std::sin(0.1f * (x * x + 3 * y))); });
    const PrimitiveSet set = std::make_shared<const TriangleSet>(mesh.corners, mesh.triangles);
    const auto bytes = [&](const ParameterValues& values) {
        return double(accelerator("wide_bvh").build(set, values)->statistics().bytes) / (2 * n * n);
    };
    CHECK(bytes({}) <= 43);
    const auto text = [](const char* value) { return std::string(value); };
    CHECK(bytes({{"nodes", text("quantised")}}) <= 38);
    CHECK(bytes({{"leaves", text("compact")}}) <= 27);
    CHECK(bytes({{"nodes", text("quantised")}, {"leaves", text("compact")}}) <= 21.5);
}

TEST_CASE("triangles that share nothing become leaves of as many as fit, not of four") {
    test::Random random(3);
    std::vector<Vec3f> corners;
    std::vector<TriangleSet::Indices> triangles;
    for (uint32_t i = 0; i < 2000; ++i) {
        const Vec3f center = random.point(1);
        const float size = i % 8 == 0 ? 0.3f : 0.03f;
        for (int k = 0; k < 3; ++k) corners.push_back(center + random.point(size));
        triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    const PrimitiveSet set = std::make_shared<const TriangleSet>(corners, triangles);
    const auto cost = [&](const char* builder) {
        return accelerator("wide_bvh")
            .build(set, {{"builder", std::string(builder)}})
            ->expected_cost();
    };
    // A build that looks for planes is worth more than one that goes by Morton codes.
    CHECK(cost("binned_sah") < 0.97 * cost("lbvh"));
    CHECK(cost("sbvh") < 0.97 * cost("lbvh"));
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
        for (const std::string form : {"full", "quantised", "compact"}) {
            INFO(builder << ", " << form);
            const bool compact = form == "compact";
            const ParameterValues values{{"builder", builder},
                                         {compact ? "leaves" : "nodes", form},
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
