#include "accelerators/uniform_grid.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/uniform_grid.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct UniformGridTraversal {
    static constexpr uint32_t batch = 64;  ///< references filtered by the mailbox at a time

    template <Query Q, class Set, class C>
    static bool run(const UniformGrid<Set>& grid, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        float t_near, t_far;
        if (grid.first.empty() || !meets_box(grid.space.box, ray, q, t_near, t_far)) return false;
        return grid.mailbox ? run_cells<Q, true>(grid, set, ray, q, counters, t_near, t_far)
                            : run_cells<Q, false>(grid, set, ray, q, counters, t_near, t_far);
    }

  private:
    /// A hit counts only once the walk has passed it: a shape may be hit beyond the current cell,
    /// and the walk goes on until the next cell begins behind the best hit.
    template <Query Q, bool UseMailbox, class Set, class C>
    static bool run_cells(const UniformGrid<Set>& grid, const Set& set, const LocalRay& ray,
                          RayQuery& q, C& counters, float t_near, float t_far) {
        struct Empty {};
        std::conditional_t<UseMailbox, Mailbox, Empty> mailbox;
        const uint32_t* first = grid.first.data();
        const uint32_t* references = grid.references.data();
        const auto visit = [&](size_t cell) HWY_ATTR {
            const uint32_t begin = first[cell], end = first[cell + 1];
            counters.step();
            counters.cell(begin == end);
            if (begin == end) return false;
            if constexpr (!UseMailbox) {
                return test_references<Q>(set, references + begin, end - begin, ray, q, counters);
            } else {
                for (uint32_t i = begin; i < end; i += batch) {
                    uint32_t fresh[batch];
                    const uint32_t n =
                        mailbox.filter(references + i, std::min(batch, end - i), fresh);
                    if (n && test_references<Q>(set, fresh, n, ray, q, counters)) return true;
                }
                return false;
            }
        };
        const auto past = [&](double t) HWY_ATTR { return t > double(q.t_cull); };
        if (HWY_LIKELY(grid.space.walk_is_exact(ray)))
            return walk_cells(grid.space, ray, t_near, visit, past);
        return walk_cells_thick(grid.space, ray, t_near, t_far, visit, past);
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(UniformGrid, UniformGridTraversal, UniformGridParameters)

#if HWY_ONCE
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

/// Cells of every active shape as (cell, shape), shapes ascending; made in parallel by ranges.
template <class Set>
std::vector<std::vector<std::pair<uint32_t, uint32_t>>> cell_entries(const GridSpace& space,
                                                                     const Set& set) {
    constexpr size_t range = 4096;
    std::vector<std::vector<std::pair<uint32_t, uint32_t>>> parts((set.size() + range - 1) / range);
    parallel_for(parts.size(), 1, [&](size_t begin, size_t end) {
        for (size_t part = begin; part < end; ++part) {
            const uint32_t last = uint32_t(std::min<size_t>(set.size(), (part + 1) * range));
            for (uint32_t i = uint32_t(part * range); i < last; ++i)
                if (set.active(i))
                    for_each_cell(space, set, i, [&](int x, int y, int z) {
                        parts[part].emplace_back(uint32_t(space.at(x, y, z)), i);
                    });
        }
    });
    return parts;
}

/// Auto: a table lookup costs about a nanosecond a reference, a repeated test its cost.
template <class Set>
bool wants_mailbox(MailboxMode mode, double references, double shapes, double mean_cost) {
    if (mode != MailboxMode::automatic) return mode == MailboxMode::on;
    if (std::is_same_v<Set, ObjectSet>) return references > shapes;
    return references > 1.5 * shapes && mean_cost > 4.0;
}

}  // namespace

template <class Set>
UniformGrid<Set> UniformGrid<Set>::build(const Set& set, const UniformGridParameters& p) {
    UniformGrid grid;
    Bounds3 box;
    size_t active = 0;
    double cost_sum = 0;
    for (uint32_t i = 0; i < set.size(); ++i) {
        if (!set.active(i)) continue;
        box.extend(set.bounds(i));
        cost_sum += set.cost(i);
        ++active;
    }
    if (active == 0) return grid;
    grid.space = GridSpace(box, grid_resolution(p, box, active));

    // Counting sort by cell; shapes stay ascending within one.
    const auto parts = cell_entries(grid.space, set);
    grid.first.assign(grid.space.cells() + 1, 0);
    for (const auto& part : parts)
        for (const auto& [cell, shape] : part) ++grid.first[cell + 1];
    double cost_of_references = 0;
    for (size_t c = 0; c < grid.space.cells(); ++c) {
        grid.stats.N_EV += grid.first[c + 1] == 0;
        grid.longest = std::max(grid.longest, grid.first[c + 1]);
        grid.first[c + 1] += grid.first[c];
    }
    grid.references.resize(grid.first.back());
    std::vector<uint32_t> next(grid.first.begin(), grid.first.end() - 1);
    for (const auto& part : parts)
        for (const auto& [cell, shape] : part) {
            grid.references[next[cell]++] = shape;
            cost_of_references += set.cost(shape);
        }

    grid.stats.N_V = grid.space.cells();
    grid.stats.N_OIV = grid.references.size();
    grid.stats.bytes = (grid.first.size() + grid.references.size()) * sizeof(uint32_t);
    grid.mailbox = wants_mailbox<Set>(p.mailbox, double(grid.references.size()), double(active),
                                      cost_sum / double(active));
    const double cells = expected_cells(grid.space.resolution, box);
    grid.cost = cells * (cost_constants.cell + cost_of_references / double(grid.space.cells()));
    return grid;
}

template <class Set>
void UniformGrid<Set>::walk(const BoxVisitor& visit) const {
    if (first.empty()) return;
    visit(space.box, 0, false, 0);
    size_t cell = 0;
    for (int z = 0; z < space.resolution[2]; ++z)
        for (int y = 0; y < space.resolution[1]; ++y)
            for (int x = 0; x < space.resolution[0]; ++x, ++cell)
                visit(space.cell_box(x, y, z), 1, true, first[cell + 1] - first[cell]);
}

CROFTON_REGISTER_ACCELERATOR(
    UniformGrid, UniformGridParameters, "uniform_grid",
    "regular grid of lists, walked cell by cell along the ray",
    "Fujimoto, Tanaka, Iwata 1986; walk: Amanatides & Woo 1987; rules: see resolution");

}  // namespace crofton
#endif
