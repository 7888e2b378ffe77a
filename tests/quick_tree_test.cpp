// What the quick build of a wide_bvh makes before its nodes: keys, joined patches, and a tree over
// them. Hits are the business of conformance_test.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "accelerators/leaves.h"
#include "accelerators/morton.h"
#include "accelerators/quick_tree.h"
#include "framework/registry.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
#include "tests/height_field.h"
#include "tests/isas.h"

namespace crofton {
namespace {

constexpr float nan = std::numeric_limits<float>::quiet_NaN();

QuickTree quick(const TriangleSet& set, int max_leaf_size = 8) {
    const PatchCorners corners(set);
    return build_quick_tree(set, corners, tree_costs<TriangleSet>(cost_constants.wide_node),
                            max_leaf_size);
}

/// Every active triangle is in one patch, with its own corners, and all boxes hold what is below
/// them.
void check_tree(const TriangleSet& set, const QuickTree& quick, uint32_t most = 8) {
    std::map<uint32_t, int> seen;
    struct Open {
        uint32_t node;
        Bounds3 box;
        int depth;
    };
    std::vector<Open> open;
    if (!quick.tree.empty()) open.push_back({0, quick.tree.nodes[0].bounds, 0});
    size_t leaves = 0;
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const BinaryTree::Node& node = quick.tree.nodes[o.node];
        REQUIRE(o.box.contains(node.bounds));
        REQUIRE(o.depth <= BinaryTree::max_depth);
        if (!node.leaf()) {
            open.push_back({node.left, node.bounds, o.depth + 1});
            open.push_back({node.right, node.bounds, o.depth + 1});
            continue;
        }
        ++leaves;
        REQUIRE(node.first < quick.patches.size());
        const TrianglePatch& patch = quick.patches[node.first];
        REQUIRE(patch.count == node.count);
        REQUIRE(patch.count <= most);
        for (uint32_t i = 0; i < patch.count; ++i) {
            const uint32_t id = patch.id(i, quick.ids.data());
            if (i > 0) CHECK(id > patch.id(i - 1, quick.ids.data()));
            ++seen[id];
            for (int k = 0; k < 3; ++k) CHECK(patch.vertex(i, k) == set.vertex(id, k));
            CHECK(node.bounds.contains(set.bounds(id)));
        }
    }
    CHECK(leaves == quick.patches.size());
    uint32_t active = 0;
    for (uint32_t i = 0; i < set.size(); ++i) active += set.active(i);
    CHECK(quick.triangles == active);
    CHECK(seen.size() == active);
    for (const auto& [id, times] : seen) CHECK((times == 1 && set.active(id)));
}

TEST_CASE("quick tree: every triangle is in one patch, and boxes hold what is below them") {
    for (const test::HardScene& scene : test::hard_scenes())
        if (const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&scene.set)) {
            INFO(scene.name);
            for (const int most : {1, 3, 8}) check_tree(**set, quick(**set, most), uint32_t(most));
        }
}

TEST_CASE("quick tree: the same for every instruction set") {
    const HeightField mesh(
        80, [](float x, float y) { return Vec3f(x, y, 5 * std::sin(0.3f * x) * std::cos(y)); });
    const TriangleSet set(mesh.corners, mesh.triangles);
    std::map<std::string, QuickTree> trees;
    for_each_isa([&] { trees[active_isa()] = quick(set); });
    const QuickTree& first = trees.begin()->second;
    check_tree(set, first);
    // Three or four of a mesh's triangles share a patch; fewer would be a waste.
    CHECK(first.patches.size() < set.size() / 3.5);
    for (const auto& [isa, tree] : trees) {
        INFO(isa);
        REQUIRE(tree.patches.size() == first.patches.size());
        for (size_t i = 0; i < first.patches.size(); ++i)
            REQUIRE(std::memcmp(&tree.patches[i], &first.patches[i], sizeof(TrianglePatch)) == 0);
        CHECK(tree.ids == first.ids);
    }
}

TEST_CASE("quick tree: triangles at one place, without extent, and nowhere") {
    std::vector<Vec3f> corners{{0, 0, 0},
                               {1, 0, 0},
                               {0, 1, 0},
                               {nan, 0, 0},
                               {std::numeric_limits<float>::infinity(), 1, 1}};
    std::vector<TriangleSet::Indices> triangles;
    for (int i = 0; i < 1000; ++i) triangles.push_back({0, 1, 2});
    for (int i = 0; i < 20; ++i) triangles.push_back({0, 0, 0});
    for (int i = 0; i < 20; ++i) triangles.push_back({0, 1, 1});
    for (int i = 0; i < 20; ++i) triangles.push_back({0, 1, 3});
    for (int i = 0; i < 20; ++i) triangles.push_back({4, 1, 2});
    const TriangleSet set(corners, triangles);
    const QuickTree all = quick(set);
    check_tree(set, all);
    CHECK(all.triangles == 1040);
    // Eight triangles on three corners are one patch.
    CHECK(all.patches.size() <= 1040 / 8 + 20);

    const TriangleSet none(corners, {{0, 1, 3}, {4, 1, 2}});
    CHECK(quick(none).tree.empty());
    const TriangleSet one(corners, {{0, 1, 2}});
    check_tree(one, quick(one));
}

TEST_CASE("quick tree: what is far apart is not joined, though a patch had room for it") {
    // Pairs of small triangles that share nothing, a thousand apart.
    std::vector<Vec3f> corners;
    std::vector<TriangleSet::Indices> triangles;
    for (int pair = 0; pair < 8; ++pair)
        for (int half = 0; half < 2; ++half) {
            const float x = 1000.0f * float(pair), z = 500.0f * float(half);
            const auto n = uint32_t(corners.size());
            corners.insert(corners.end(), {{x, 0, z}, {x + 1, 0, z}, {x, 1, z}});
            triangles.push_back({n, n + 1, n + 2});
        }
    const TriangleSet set(corners, triangles);
    const QuickTree tree = quick(set);
    check_tree(set, tree);
    CHECK(tree.patches.size() == set.size());
}

TEST_CASE("morton keys: by code and then by index, and what does not exist is left out") {
    test::Random random(5);
    const size_t n = 20000;
    std::vector<Vec3f> points;
    for (size_t i = 0; i < n; ++i) points.push_back(random.point(1));
    // Some at one place: their indices decide.
    for (size_t i = 0; i < n; i += 7) points[i] = Vec3f(0.25f, 0.25f, 0.25f);
    const auto exists = [](size_t i) { return i % 11 != 0; };
    for (const int threads : {1, 4}) {
        set_threads(threads);
        const MortonKeys keys = morton_keys(n, [&](size_t i, Box4& box) {
            box = Box4(Bounds3{points[i], points[i]});
            return exists(i);
        });
        set_threads(0);
        std::vector<bool> seen(n);
        for (size_t i = 0; i < keys.size(); ++i) {
            REQUIRE(exists(keys.index(i)));
            REQUIRE_FALSE(seen[keys.index(i)]);
            seen[keys.index(i)] = true;
            if (i > 0) REQUIRE(keys.key(i - 1) < keys.key(i));
        }
        CHECK(keys.size() ==
              size_t(std::count_if(points.begin(), points.end(), [&](const Vec3f& p) {
                  return exists(size_t(&p - points.data()));
              })));
        // The highest bit of a code is the half of the z axis.
        const Bounds3 b = keys.bounds();
        for (size_t i = 1; i < keys.size(); ++i) {
            const float lower = b.lower[2], extent = (b.upper - b.lower).maxCoeff();
            const auto high = [&](size_t k) {
                return (points[keys.index(k)][2] - lower) / extent >= 0.5001f;
            };
            if (high(i - 1)) CHECK((points[keys.index(i)][2] - lower) / extent >= 0.4999f);
        }
    }
}

}  // namespace
}  // namespace crofton
