#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "framework/bounds.h"
#include "framework/ray_query.h"

namespace crofton {

/// The next float above or below, as std::nextafter, which is a call into a library. Infinity
/// stays.
inline float next_above(float x) {
    if (!(std::abs(x) <= std::numeric_limits<float>::max())) return x;
    if (x == 0) return std::numeric_limits<float>::denorm_min();
    const uint32_t bits = std::bit_cast<uint32_t>(x);
    return std::bit_cast<float>(x > 0 ? bits + 1 : bits - 1);
}
inline float next_below(float x) { return -next_above(-x); }

/// Geometry of a regular grid. Planes are computed in double from their integer index, never
/// accumulated, and by the same expression when shapes are put into cells and when rays walk.
struct GridSpace {
    Bounds3 box;
    Vec3i resolution = Vec3i::Ones();
    double lower[3] = {0, 0, 0};
    double cell[3] = {1, 1, 1};  ///< > 0
    double inverse_cell[3] = {1, 1, 1};
    /// Shapes stand in every cell that they meet when widened by this much, so that a walk along
    /// the exact ray finds all that a rounded leaf test can accept, unless the ray's `reach` is
    /// larger.
    double margin[3] = {0, 0, 0};
    /// Largest absolute coordinate of the whole shapes that stand in the cells, parts outside the
    /// box included: what the error of a leaf test grows with.
    double magnitude = 0;

    GridSpace() = default;
    GridSpace(const Bounds3& bounds, const Vec3i& n)
        : box(bounds), resolution(n), magnitude(bounds.magnitude()) {
        for (int a = 0; a < 3; ++a) {
            lower[a] = bounds.lower[a];
            const double extent = double(bounds.upper[a]) - lower[a];
            cell[a] = extent / n[a];
            if (!(cell[a] > 0)) cell[a] = std::numeric_limits<float>::min();
            inverse_cell[a] = 1 / cell[a];
            margin[a] = std::max(0x1p-12 * cell[a], 0x1p-18 * magnitude);
        }
    }
    template <class A>
    void archive(A& a) {
        a(box, resolution, lower, cell, inverse_cell, margin, magnitude);
    }
    size_t cells() const {
        return size_t(resolution[0]) * size_t(resolution[1]) * size_t(resolution[2]);
    }
    double plane(int axis, int index) const { return lower[axis] + index * cell[axis]; }
    int index(int axis, double x) const {
        const double i = (x - lower[axis]) * inverse_cell[axis];
        return i > 0 ? int(std::min(i, double(resolution[axis] - 1))) : 0;
    }
    Bounds3 cell_box(int x, int y, int z) const {
        const int i[3] = {x, y, z};
        Bounds3 b;
        for (int a = 0; a < 3; ++a) {
            b.lower[a] = float(plane(a, i[a]));
            b.upper[a] = float(plane(a, i[a] + 1));
        }
        return b;
    }
    /// 12u: share of |o| + magnitude that a leaf test may err by, see LocalRay.
    static constexpr double leaf_reach = 0x1.8p-21;
    /// What a leaf test may add to a ray's own thickness, per axis.
    double reach(const LocalRay& ray, int axis) const {
        return ray.pad[axis] + leaf_reach * (std::abs(double(ray.origin[axis])) + magnitude);
    }
};

/// A grid a margin larger than its content, so that the exact ray is inside wherever a shape in it
/// may be hit. Margins hold the reach of rays that begin within a few sizes of the whole scene,
/// unless that would make them a large part of a fine cell, but always that of rays that begin near
/// the shapes.
/// @param shapes  magnitude of the shapes in the grid, parts outside the content included
/// @param scene   magnitude of all shapes of the structure
inline GridSpace widened_space(const Bounds3& content, const Vec3i& n, double shapes,
                               double scene) {
    constexpr float largest = std::numeric_limits<float>::max();
    Bounds3 box = content;
    double margin[3];
    for (int a = 0; a < 3; ++a) {
        const double cell = (double(content.upper[a]) - content.lower[a]) / n[a];
        const double wanted = 0x1p-18 * scene;
        margin[a] = std::max({0x1p-12 * cell, 0x1p-19 * shapes,
                              n[a] == 1 ? wanted : std::min(wanted, cell / 4),
                              double(std::numeric_limits<float>::min())});
        // Near the end of the range, a bound stays finite.
        box.lower[a] = std::max(next_below(float(box.lower[a] - margin[a])), -largest);
        box.upper[a] = std::min(next_above(float(box.upper[a] + margin[a])), largest);
    }
    GridSpace space(box, n);
    space.magnitude = shapes;
    std::copy(margin, margin + 3, space.margin);
    return space;
}

/// How many cells a shape in `box` may stand in. @param flat  it fills a layer of its box at most
inline double cells_spanned(const Bounds3& box, const Vec3d& cell, bool flat) {
    double all = 1, least = std::numeric_limits<double>::infinity();
    for (int a = 0; a < 3; ++a) {
        const double n = 1 + (double(box.upper[a]) - box.lower[a]) / cell[a];
        all *= n;
        least = std::min(least, n);
    }
    return flat ? all / least * std::min(least, 1.5) : all;
}

/// Calls visit(x, y, z) for every cell that the part of a shape inside `whole`, widened by the
/// margin, meets. Clips the shape to slabs and rows, so that a slanted shape does not fill its box.
template <class Set, class Visit>
void for_each_cell(const GridSpace& grid, const Set& set, uint32_t shape, const Bounds3& whole,
                   Visit&& visit) {
    const auto range = [&](const Bounds3& b, int axis, int& first, int& last) {
        first = grid.index(axis, b.lower[axis] - grid.margin[axis]);
        last = grid.index(axis, b.upper[axis] + grid.margin[axis]);
    };
    // `part` cut to cells first … last of one axis, which the margin widens.
    const auto cut = [&](Bounds3 part, int axis, int i) {
        part.lower[axis] =
            std::max(part.lower[axis], next_below(float(grid.plane(axis, i) - grid.margin[axis])));
        part.upper[axis] = std::min(part.upper[axis],
                                    next_above(float(grid.plane(axis, i + 1) + grid.margin[axis])));
        return part;
    };
    int z0, z1;
    range(whole, 2, z0, z1);
    for (int z = z0; z <= z1; ++z) {
        Bounds3 slab = whole;
        if (z0 != z1) slab = set.clipped_bounds(shape, cut(whole, 2, z));
        if (slab.empty()) continue;
        int y0, y1;
        range(slab, 1, y0, y1);
        for (int y = y0; y <= y1; ++y) {
            Bounds3 row = slab;
            if (y0 != y1) row = set.clipped_bounds(shape, cut(slab, 1, y));
            if (row.empty()) continue;
            int x0, x1;
            range(row, 0, x0, x1);
            for (int x = x0; x <= x1; ++x) visit(x, y, z);
        }
    }
}

template <class Set, class Visit>
void for_each_cell(const GridSpace& grid, const Set& set, uint32_t shape, Visit&& visit) {
    for_each_cell(grid, set, shape, set.bounds(shape), std::forward<Visit>(visit));
}

/// Walks the cells of a ray that is thicker than their margin (a far origin, an instance with an
/// ill-conditioned map): slice by slice along the axis that the ray crosses fastest, all cells that
/// the thick ray touches. Cells come in order of slices.
/// @param visit  visit(x, y, z) -> bool: the query is answered, stop
template <class Visit, class Past>
bool walk_cells_thick(const GridSpace& grid, const LocalRay& ray, double t_enter, double t_leave,
                      Visit&& visit, Past&& past) {
    int k = 0;
    for (int a = 1; a < 3; ++a)
        if (std::abs(ray.direction[a]) * grid.inverse_cell[a] >
            std::abs(ray.direction[k]) * grid.inverse_cell[k])
            k = a;
    const double o = ray.origin[k], d = ray.direction[k], inverse = 1 / d;
    const auto at = [&](double t, int a) { return ray.origin[a] + t * double(ray.direction[a]); };
    const double thick = grid.reach(ray, k);
    const int first = grid.index(k, at(t_enter, k) - std::copysign(thick, d));
    const int last = grid.index(k, at(t_leave, k) + std::copysign(thick, d));
    const int step = d > 0 ? 1 : -1;
    for (int s = first;; s += step) {
        // The part of the ray inside this slice, longer by its thickness at both ends.
        const double extra = thick * std::abs(inverse);
        const double a0 = (grid.plane(k, s) - o) * inverse,
                     a1 = (grid.plane(k, s + 1) - o) * inverse;
        const double t0 = std::max(std::min(a0, a1) - extra, t_enter);
        const double t1 = std::min(std::max(a0, a1) + extra, t_leave);
        int low[3], high[3];
        for (int a = 0; a < 3; ++a) {
            const double p = at(t0, a), q = at(t1, a), w = grid.reach(ray, a);
            low[a] = a == k ? s : grid.index(a, std::min(p, q) - w);
            high[a] = a == k ? s : grid.index(a, std::max(p, q) + w);
        }
        for (int z = low[2]; z <= high[2]; ++z)
            for (int y = low[1]; y <= high[1]; ++y)
                for (int x = low[0]; x <= high[0]; ++x)
                    if (visit(x, y, z)) return true;
        if (s == last || past(std::max(a0, a1) - extra)) return false;
    }
}

}  // namespace crofton
