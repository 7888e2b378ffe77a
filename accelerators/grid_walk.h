// Walks through grids within grids, compiled for every target so that visits are inlined; included
// once per target, after framework/simd.h.
#if defined(CROFTON_ACCELERATORS_GRID_WALK_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_GRID_WALK_H_
#undef CROFTON_ACCELERATORS_GRID_WALK_H_
#else
#define CROFTON_ACCELERATORS_GRID_WALK_H_
#endif

#include "accelerators/grid_space.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// The exact ray in double, with what all grids of a structure need of it.
struct ExactRay {
    double origin[3], direction[3];
    double inverse[3];  ///< inf where the direction is 0
    double t_min;       ///< lowered by what the t of a leaf test may be off

    ExactRay(const LocalRay& ray, const RayQuery& q) {
        for (int a = 0; a < 3; ++a) {
            origin[a] = ray.origin[a];
            direction[a] = ray.direction[a] + 0.0;  // -0 becomes 0
            inverse[a] = 1 / direction[a];
        }
        t_min = q.t_low;
    }
    double at(double t, int axis) const { return origin[axis] + t * direction[axis]; }
};

/// Where the ray, `reach` thick on each side, is inside the grid's box.
/// @return whether it is within [t_min, t_cull]; 0·∞ at a plane drops out of the comparisons
HWY_INLINE bool meets_grid(const GridSpace& grid, const ExactRay& ray, const RayQuery& q,
                           const double (&reach)[3], double& t_enter, double& t_leave) {
    double enter = ray.t_min, leave = q.t_cull;
    for (int a = 0; a < 3; ++a) {
        const double t0 = (double(grid.box.lower[a]) - reach[a] - ray.origin[a]) * ray.inverse[a];
        const double t1 = (double(grid.box.upper[a]) + reach[a] - ray.origin[a]) * ray.inverse[a];
        const bool down = ray.direction[a] < 0;
        enter = std::max(enter, down ? t1 : t0);
        leave = std::min(leave, down ? t0 : t1);
    }
    t_enter = enter;
    t_leave = leave;
    // A ray that runs beside the box enters it at infinity, which t_cull may be.
    return enter <= leave && enter < std::numeric_limits<double>::infinity();
}

/// Walks the cells that the exact ray crosses, as walk_cells does (Amanatides & Woo 1987).
/// @param visit  visit(cell index) -> bool: the query is answered, stop
/// @param past   past(t) -> bool: nothing that begins at t or later matters, stop
/// @return whether `visit` stopped the walk
template <class Visit, class Past>
HWY_INLINE bool walk_grid(const GridSpace& grid, const ExactRay& ray, double t_enter, Visit&& visit,
                          Past&& past) {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    // The plane behind the cell is where its index, or the one after it, begins.
    double index[3], step[3], end[3], next[3];
    ptrdiff_t stride[3] = {1, grid.resolution[0],
                           ptrdiff_t(grid.resolution[0]) * grid.resolution[1]};
    size_t cell = 0;
    for (int a = 0; a < 3; ++a) {
        const int i = grid.index(a, ray.at(t_enter, a));
        const bool up = ray.direction[a] > 0;
        cell += size_t(i) * size_t(stride[a]);
        index[a] = up ? i + 1 : i;
        step[a] = up ? 1 : -1;
        end[a] = up ? grid.resolution[a] : 0;
        next[a] = ray.direction[a] == 0
                      ? infinity
                      : (grid.lower[a] + index[a] * grid.cell[a] - ray.origin[a]) * ray.inverse[a];
        if (!up) stride[a] = -stride[a];
    }
    // Called with constants, so that all of it stays in registers.
    const auto advance = [&](int a) HWY_ATTR {
        if (index[a] == end[a] || past(next[a])) return false;
        cell = size_t(ptrdiff_t(cell) + stride[a]);
        index[a] += step[a];
        next[a] = (grid.lower[a] + index[a] * grid.cell[a] - ray.origin[a]) * ray.inverse[a];
        return true;
    };
    while (true) {
        if (visit(cell)) return true;
        const bool on = next[0] <= next[1] ? (next[0] <= next[2] ? advance(0) : advance(2))
                                           : (next[1] <= next[2] ? advance(1) : advance(2));
        if (!on) return false;
    }
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
