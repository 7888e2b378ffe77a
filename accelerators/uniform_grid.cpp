#include "accelerators/uniform_grid.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/uniform_grid.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/grid_walk.h"
#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct UniformGridTraversal {
    template <Query Q, class Set, class C>
    static bool run(const UniformGrid<Set>& grid, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (grid.blocks.empty()) return false;
        return grid.mailbox ? run_cells<Q, true>(grid, set, ray, q, counters)
                            : run_cells<Q, false>(grid, set, ray, q, counters);
    }

  private:
    /// A hit counts only once the walk has passed it: a shape may be hit beyond the current cell,
    /// and the walk goes on until the next cell begins behind the best hit.
    template <Query Q, bool UseMailbox, class Set, class C>
    static bool run_cells(const UniformGrid<Set>& grid, const Set& set, const LocalRay& ray,
                          RayQuery& q, C& counters) {
        const ExactRay exact(ray, q);
        const bool thick = !exact.fits(grid.space);
        double t_enter, t_leave;
        if (!meets_grid(grid.space, exact, ray, thick, q, t_enter, t_leave)) return false;
        std::conditional_t<UseMailbox, Mailbox, NoMailbox> mailbox;
        const uint32_t* words = grid.words.data();
        const auto test = [&](const uint32_t* references, uint32_t count) HWY_ATTR {
            return mailbox.test_fresh(
                references, count, [&](const uint32_t* fresh, uint32_t n) HWY_ATTR {
                    return test_stored<Q>(grid.shapes, set, fresh, n, ray, q, counters);
                });
        };
        const auto visit = [&](uint32_t place) HWY_ATTR {
            counters.cell(false);
            return test_list(words[place], words, test);
        };
        if (HWY_LIKELY(!thick))
            return BlockWalk(grid.space, grid.blocks.data(), exact, t_enter)
                .run(grid.skip_empty, q, counters, visit);
        return walk_blocks_thick(grid.space, grid.blocks.data(), ray, q, t_enter, t_leave, counters,
                                 visit);
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(UniformGrid, UniformGridTraversal, UniformGridParameters)

#if HWY_ONCE
#include "accelerators/leaves.h"
#include "framework/cost.h"
#include "framework/crofton.h"
#include "framework/parallel.h"

namespace crofton {

Vec3i grid_resolution(const UniformGridParameters& p, const Bounds3& bounds, size_t shapes) {
    const Vec3d e = bounds.upper.cast<double>() - bounds.lower.cast<double>();
    const double longest = e.maxCoeff(), n = p.density * double(std::max<size_t>(shapes, 1));
    Vec3d r(1, 1, 1);
    const auto proportional = [&](double on_longest) {
        return longest > 0 ? Vec3d(e / longest * on_longest) : Vec3d(1, 1, 1);
    };
    switch (p.resolution) {
        case ResolutionRule::lrt:
            r = Vec3d::Constant(std::cbrt(8 * n));
            break;
        case ResolutionRule::pbrt:
            r = proportional(3 * std::cbrt(n)).array() + 0.5;
            break;
        case ResolutionRule::woo:
            r = proportional(std::cbrt(n));
            break;
        case ResolutionRule::klimaszewski: {
            // A flat axis counts as one millionth of the longest, so that no quotient is infinite.
            const Vec3d f = e.cwiseMax(longest * 1e-6);
            if (!(longest > 0)) break;
            r[0] = std::max(1.0, std::floor(std::cbrt(n * f[0] * f[0] / (f[1] * f[2])) + 0.5));
            r[1] = std::max(1.0, std::floor(std::sqrt(n * f[1] / (r[0] * f[2])) + 0.5));
            r[2] = n / (r[0] * r[1]) + 0.5;
            break;
        }
        case ResolutionRule::fixed:
            r = Vec3d(p.resolution_x, p.resolution_y, p.resolution_z);
            break;
    }
    for (int a = 0; a < 3; ++a)
        if (!(e[a] > 0)) r[a] = 1;
    r = r.cwiseMax(1.0).cwiseMin(2048.0);
    constexpr double most = 1 << 26;
    if (r.prod() > most) r *= std::cbrt(most / r.prod());
    return r.cwiseMax(1.0).cast<int>();
}

namespace {

/// A cell, by blocks, and a shape that stands in it.
using CellEntry = std::pair<uint32_t, uint32_t>;

/// Entries of every active shape, shapes ascending; made in parallel by ranges.
template <class Set>
std::vector<std::vector<CellEntry>> cell_entries(const GridSpace& space, const Set& set) {
    constexpr size_t range = 4096;
    std::vector<std::vector<CellEntry>> parts((set.size() + range - 1) / range);
    parallel_for(parts.size(), 1, [&](size_t begin, size_t end) {
        for (size_t part = begin; part < end; ++part) {
            const uint32_t last = uint32_t(std::min<size_t>(set.size(), (part + 1) * range));
            for (uint32_t i = uint32_t(part * range); i < last; ++i)
                if (set.active(i))
                    for_each_cell(space, set, i, [&](int x, int y, int z) {
                        parts[part].emplace_back(uint32_t(blocked_index(space.resolution, x, y, z)),
                                                 i);
                    });
        }
    });
    return parts;
}

/// Counting sort of entries by cell; shapes stay ascending within one. In parallel by ranges of
/// cells: each reads all entries and keeps its own.
/// @param first  out: per cell, where its shapes begin; one more at the end
std::vector<uint32_t> sort_entries(const std::vector<std::vector<CellEntry>>& parts, size_t cells,
                                   std::vector<uint32_t>& first) {
    first.assign(cells + 1, 0);
    const size_t grain = std::max<size_t>(1 << 16, cells / size_t(threads()) + 1);
    const auto own = [&](auto&& visit) {
        parallel_for(cells, grain, [&](size_t begin, size_t end) {
            for (const auto& part : parts)
                for (const auto& [cell, shape] : part)
                    if (cell >= begin && cell < end) visit(cell, shape);
        });
    };
    own([&](uint32_t cell, uint32_t) { ++first[cell + 1]; });
    for (size_t c = 0; c < cells; ++c) first[c + 1] += first[c];
    std::vector<uint32_t> shapes(first[cells]), next(first.begin(), first.end() - 1);
    own([&](uint32_t cell, uint32_t shape) { shapes[next[cell]++] = shape; });
    return shapes;
}

}  // namespace

template <class Set>
UniformGrid<Set> UniformGrid<Set>::build(const Set& set, const UniformGridParameters& p) {
    UniformGrid grid;
    size_t active = 0;
    double cost_sum = 0;
    for (uint32_t i = 0; i < set.size(); ++i) {
        if (!set.active(i)) continue;
        grid.box.extend(set.bounds(i));
        cost_sum += set.cost(i);
        ++active;
    }
    if (active == 0) return grid;
    const double magnitude = grid.box.magnitude();
    const Vec3i n = grid_resolution(p, grid.box, active);
    grid.space = widened_space(grid.box, n, magnitude, magnitude);
    grid.skip_empty = p.skip_empty;

    std::vector<uint32_t> begins;
    const size_t blocks = block_count(n);
    const std::vector<uint32_t> shapes =
        sort_entries(cell_entries(grid.space, set), blocks * 64, begins);
    grid.shapes = ShapeStore<Set>(set);
    grid.blocks.resize(blocks);
    ListWriter<Set> lists(set, grid.words, grid.shapes);
    for (size_t b = 0; b < blocks; ++b) {
        lists.begin(grid.blocks[b], std::span(begins).subspan(b * 64, 65));
        for (size_t i = b * 64; i < b * 64 + 64; ++i)
            if (begins[i] != begins[i + 1])
                lists.add(std::span(shapes).subspan(begins[i], begins[i + 1] - begins[i]));
        grid.stats.N_EV -= size_t(std::popcount(grid.blocks[b].occupied));
    }
    grid.stats.N_EV += grid.space.cells();
    grid.shapes.finish();
    measure_clearance(grid.blocks, blocks_of(n));

    double cost_of_references = 0;
    for (const uint32_t shape : shapes) cost_of_references += set.cost(shape);
    grid.stats.N_V = grid.space.cells();
    grid.stats.N_OIV = shapes.size();
    grid.stats.bytes = grid.blocks.size() * sizeof(CellBlock) +
                       grid.words.size() * sizeof(uint32_t) + grid.shapes.bytes();
    grid.mailbox = wants_mailbox(p.mailbox, std::is_same_v<Set, ObjectSet>, double(shapes.size()),
                                 double(active), reference_cost<Set>(cost_sum / double(active)));
    const double cells = expected_cells(n, grid.box);
    grid.cost = cells * (cost_constants.cell + cost_of_references / double(grid.space.cells()));
    return grid;
}

template <class Set>
void UniformGrid<Set>::walk(const BoxVisitor& visit) const {
    if (blocks.empty()) return;
    // Cells reach a margin beyond the shapes.
    const auto inside = [&](const Bounds3& b) {
        Bounds3 cut = intersection(b, box);
        cut.upper = cut.upper.cwiseMax(cut.lower);
        return cut;
    };
    visit(box, 0, false, 0);
    for (int z = 0; z < space.resolution[2]; ++z)
        for (int y = 0; y < space.resolution[1]; ++y)
            for (int x = 0; x < space.resolution[0]; ++x) {
                const uint32_t place =
                    code_place(blocks.data(), blocked_index(space.resolution, x, y, z));
                const uint32_t count =
                    place == no_code ? 0 : list_length(words[place], words.data());
                visit(inside(space.cell_box(x, y, z)), 1, true, count);
            }
}

CROFTON_REGISTER_ACCELERATOR(
    UniformGrid, UniformGridParameters, "uniform_grid",
    "regular grid of lists, walked cell by cell along the ray",
    "Fujimoto, Tanaka, Iwata 1986; walk: Amanatides & Woo 1987; empty space: Cohen & Sheffer 1994");

}  // namespace crofton
#endif
