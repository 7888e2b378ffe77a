// The model's own groups as a hierarchy: what it keeps of them, and graphs that are no good trees.

#include "accelerators/model_hierarchy.h"

#include <algorithm>
#include <cstring>
#include <functional>

#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

/// n triangles along a line.
std::shared_ptr<const TriangleSet> row(uint32_t n, ShapeGroups groups) {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    for (uint32_t i = 0; i < n; ++i) {
        const float x = float(i), y = float(i % 7);
        p.insert(p.end(), {{x, y, 0}, {x + 2, y, 1}, {x, y + 2, 0.5f}});
        t.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    return std::make_shared<const TriangleSet>(p, t, IdTable(), std::move(groups));
}

std::vector<Bounds3> boxes(const Primitive& p) {
    std::vector<Bounds3> found;
    p.walk([&](const Bounds3& b, uint32_t, bool, uint32_t) { found.push_back(b); });
    return found;
}

Bounds3 bounds_of(const TriangleSet& set, const ShapeGroup& g) {
    Bounds3 b;
    for (uint32_t i = g.first; i < g.end; ++i) b.extend(set.bounds(i));
    return b;
}

size_t differences(const Primitive& a, const Primitive& b, float length) {
    test::Random random(9);
    size_t wrong = 0, hits = 0;
    for (int i = 0; i < 3000; ++i) {
        Ray ray;
        ray.origin = Vec3f(random.uniform(0, length), random.uniform(0, 8), 5);
        ray.direction = random.direction() * 0.3f + Vec3f(0, 0, -1);
        const Hit x = a.intersect(ray), y = b.intersect(ray);
        wrong += std::memcmp(&x, &y, sizeof(Hit)) != 0 || b.occluded(ray) != x.is_hit();
        hits += x.is_hit();
    }
    CHECK(hits > 300);
    return wrong;
}

}  // namespace

TEST_CASE("model_hierarchy: every group of the model is a box of the tree") {
    const ShapeGroups groups{{0, 40}, {0, 12}, {3, 9}, {12, 30}, {15, 20}, {20, 27}, {50, 58}};
    const auto set = row(60, groups);
    const auto tree = accelerator("model_hierarchy")
                          .build(set, {{"merge", false}, {"max_leaf_size", int64_t(2)}});
    const std::vector<Bounds3> found = boxes(*tree);
    for (const ShapeGroup& g : groups)
        CHECK(std::find(found.begin(), found.end(), bounds_of(*set, g)) != found.end());
    // Without the groups, not all of these boxes come about by themselves.
    const auto plain = accelerator("model_hierarchy")
                           .build(row(60, {}), {{"merge", false}, {"max_leaf_size", int64_t(2)}});
    const std::vector<Bounds3> other = boxes(*plain);
    CHECK(std::any_of(groups.begin(), groups.end(), [&](const ShapeGroup& g) {
        return std::find(other.begin(), other.end(), bounds_of(*set, g)) == other.end();
    }));
    const auto flat = accelerator("brute_force").build(set, {});
    CHECK(differences(*flat, *tree, 60) == 0);
}

TEST_CASE("model_hierarchy: geometries of a mesh are its groups where nothing else is known") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(1, p, t);
    const size_t n = p.size(), m = t.size();
    for (size_t i = 0; i < n; ++i) p.push_back(p[i] + Vec3f(0.5f, 0, 0));
    for (size_t i = 0; i < m; ++i)
        t.push_back({t[i][0] + uint32_t(n), t[i][1] + uint32_t(n), t[i][2] + uint32_t(n)});
    const TriangleSet set(p, t, IdTable({{0, 0, 0, 0}, {uint32_t(m), 1, 0, 0}}));
    REQUIRE(set.groups().size() == 2);
    CHECK(set.groups()[1].first == m);
    CHECK(set.groups()[1].end == 2 * m);
    CHECK(TriangleSet(p, t).groups().empty());
}

TEST_CASE("model_hierarchy: a part of a set keeps what is left of the model's groups") {
    const std::vector<uint32_t> shapes{1, 2, 5, 13, 14, 16, 58};
    const ShapeGroups part =
        row(60, {{0, 40}, {0, 12}, {3, 9}, {12, 30}, {20, 27}, {50, 58}})->subset(shapes).groups();
    const ShapeGroups left{{0, 6}, {0, 3}, {2, 3}, {3, 6}};
    REQUIRE(part.size() == left.size());
    for (size_t i = 0; i < left.size(); ++i) {
        CHECK(part[i].first == left[i].first);
        CHECK(part[i].end == left[i].end);
    }

    // Geometries of a mesh; a part of a part.
    const IdTable ids({{0, 0, 0, 0}, {10, 1, 0, 0}, {14, 2, 0, 0}});
    const std::vector<uint32_t> some{1, 3, 6};
    const ShapeGroups runs = ids.subset(shapes).subset(some).groups(3);
    REQUIRE(runs.size() == 3);
    for (uint32_t i = 0; i < 3; ++i) CHECK((runs[i].first == i && runs[i].end == i + 1));
    CHECK(ids.subset({}).groups(0).empty());
}

TEST_CASE("model_hierarchy: the lazy parts of a model are hierarchies of its groups") {
    // Pairs of neighbours: without groups, a leaf takes up to four.
    ShapeGroups pairs;
    for (uint32_t i = 0; i < 256; i += 2) pairs.push_back({i, i + 2});
    const auto lazy = accelerator("model_hierarchy")
                          .build(row(256, pairs), {{"lazy", true}, {"lazy_size", int64_t(64)}});
    size_t leaves = 0, largest = 0;
    const std::function<void(const Primitive&)> visit = [&](const Primitive& p) {
        if (p.type_name() == "model_hierarchy" && total_statistics(p).N_OIV == p.statistics().N_OIV)
            p.walk([&](const Bounds3&, uint32_t, bool leaf, uint32_t references) {
                leaves += leaf;
                if (leaf) largest = std::max<size_t>(largest, references);
            });
        p.children(visit);
    };
    Ray ray;
    for (int i = 0; i < 256; ++i) {
        ray.origin = Vec3f(float(i) + 0.5f, float(i % 7) + 0.5f, 5);
        ray.direction = Vec3f(0, 0, -1);
        lazy->intersect(ray);
    }
    visit(*lazy);
    CHECK(leaves >= 128);
    CHECK(largest <= 2);
}

TEST_CASE("model_hierarchy: a chain of 100,000 groups, and 100,000 members of one, end") {
    const uint32_t n = 100000;
    ShapeGroups chain, nested, pairs;
    for (uint32_t i = 0; i < n; ++i) chain.push_back({i, n});
    for (uint32_t i = 0; i < n / 2; ++i) nested.push_back({i, n - i});
    for (uint32_t i = 0; i < n; i += 2) pairs.push_back({i, i + 2});
    const auto plain = row(n, {});
    const auto reference = accelerator("bvh").build(plain, {});
    for (const ShapeGroups& groups : {ShapeGroups(), chain, nested, pairs, ShapeGroups(n, {0, n})})
        for (const char* split : {"area", "halves"}) {
            const auto tree = accelerator("model_hierarchy")
                                  .build(row(n, groups), {{"split", std::string(split)}});
            const StructureStatistics s = tree->statistics();
            INFO(groups.size() << " groups, split by " << split);
            CHECK(s.N_OIV == n);
            CHECK(s.depth <= ModelHierarchy<TriangleSet>::max_depth);
            CHECK(differences(*reference, *tree, float(n)) == 0);
        }
}

TEST_CASE(
    "model_hierarchy: shapes that shrink by powers of two do not make it deeper than its stack") {
    // Cuts by area peel off one shape at a time.
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    ShapeGroups groups;
    const uint32_t n = 4096;
    for (uint32_t i = 0; i < n; ++i) {
        const float s = std::ldexp(1.0f, -int(i % 120));
        p.insert(p.end(), {{s, 0, 0}, {0, s, 0}, {0, 0, s}});
        t.push_back({3 * i, 3 * i + 1, 3 * i + 2});
        if (i + 1 < n) groups.push_back({i, n});
    }
    const auto set = std::make_shared<const TriangleSet>(p, t, IdTable(), groups);
    const auto tree = accelerator("model_hierarchy").build(set, {{"max_leaf_size", int64_t(1)}});
    CHECK(tree->statistics().depth <= ModelHierarchy<TriangleSet>::max_depth);
    const auto flat = accelerator("brute_force").build(set, {});
    size_t wrong = 0;
    for (const Ray& ray : test::hard_rays(flat->bounds(), p, 6))
        wrong += !(flat->intersect(ray) == tree->intersect(ray));
    CHECK(wrong == 0);
}

}  // namespace crofton
