// Counts of cells and references against those that Havran & Sixta published for the scenes of the
// Standard Procedural Databases (Comparison of hierarchical grids, 1999). The scenes lie beside the
// repository; where they do not, there is nothing to compare.

#include <algorithm>
#include <filesystem>
#include <numeric>
#include <string>
#include <variant>

#include "accelerators/grid_space.h"
#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "scenegraph/nff.h"
#include "scenegraph/shape_sets.h"
#include "tests/catch.h"

namespace crofton {
namespace {

std::string scene_path(const std::string& name) {
    return std::string(CROFTON_SOURCE_DIR) + "/../shared/scenes/spd/" + name + ".nff";
}

std::vector<PrimitiveSet> sets_of(const std::string& name) {
    const Scene scene = load_nff(scene_path(name));
    ShapeSetBuilder builder(scene);
    for (uint32_t m = 0; m < scene.meshes.size(); ++m) builder.add_mesh(m, nullptr, 0);
    return builder.take();
}

struct Counts {
    uint64_t N_V = 0, N_EV = 0, N_OIV = 0;
};

/// One grid over all sets. Cells without a margin, as published: a shape that only touches a plane
/// from below does not stand behind it.
Counts count_cells(const std::vector<PrimitiveSet>& sets, const Vec3i& resolution) {
    const auto each = [&](auto&& visit) {
        for (const PrimitiveSet& any : sets)
            std::visit(
                [&](const auto& set) {
                    for (uint32_t i = 0; i < set->size(); ++i) visit(*set, i);
                },
                any);
    };
    Bounds3 box;
    each([&](const auto& set, uint32_t i) { box.extend(set.bounds(i)); });
    GridSpace space(box, resolution);
    for (double& margin : space.margin) margin = 0;
    std::vector<uint32_t> references(space.cells(), 0);
    each([&](const auto& set, uint32_t i) {
        for_each_cell(space, set, i, [&](int x, int y, int z) {
            ++references[(size_t(z) * size_t(resolution[1]) + size_t(y)) * size_t(resolution[0]) +
                         size_t(x)];
        });
    });
    Counts counts;
    counts.N_V = space.cells();
    counts.N_EV = uint64_t(std::count(references.begin(), references.end(), 0u));
    counts.N_OIV = std::accumulate(references.begin(), references.end(), uint64_t(0));
    return counts;
}

}  // namespace

TEST_CASE("uniform_grid: cells of the SPD scenes are empty where Havran & Sixta counted them so") {
    struct Published {
        const char* scene;
        Vec3i resolution;
        uint64_t N_V, N_EV;
        uint64_t N_OIV;  ///< 0: theirs counts other boxes of quadrics than ours
    };
    const Published published[] = {
        {"balls", {46, 46, 3}, 6348, 4208, 0},      {"lattice", {20, 20, 20}, 8000, 0, 32152},
        {"lattice", {44, 44, 44}, 85184, 38016, 0}, {"tetra", {35, 35, 35}, 42875, 37311, 35936},
        {"tree", {52, 52, 3}, 8112, 5400, 0},       {"tree", {117, 118, 5}, 69030, 55191, 0},
        {"tree", {60, 60, 60}, 216000, 212179, 0},
    };
    for (const Published& p : published) {
        if (!std::filesystem::exists(scene_path(p.scene))) continue;
        INFO(p.scene << " " << p.resolution.transpose());
        const Counts counts = count_cells(sets_of(p.scene), p.resolution);
        CHECK(counts.N_V == p.N_V);
        CHECK(counts.N_EV == p.N_EV);
        if (p.N_OIV > 0) {
            CHECK(counts.N_OIV == p.N_OIV);
        }
    }
}

TEST_CASE("uniform_grid: the grid as built over tetra has the cells and references published") {
    if (!std::filesystem::exists(scene_path("tetra"))) return;
    const std::vector<PrimitiveSet> sets = sets_of("tetra");
    REQUIRE(sets.size() == 1);
    const auto grid = accelerator("uniform_grid")
                          .build(sets[0], {{"resolution", std::string("fixed")},
                                           {"resolution_x", int64_t(35)},
                                           {"resolution_y", int64_t(35)},
                                           {"resolution_z", int64_t(35)}});
    const StructureStatistics s = grid->statistics();
    CHECK(s.N_V == 42875);
    CHECK(s.N_EV == 37311);
    CHECK(s.N_OIV == 35936);
}

}  // namespace crofton
