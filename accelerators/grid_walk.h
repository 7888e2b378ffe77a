// Walks through grids within grids, compiled for every target so that visits are inlined; included
// once per target, after framework/simd.h.
#if defined(CROFTON_ACCELERATORS_GRID_WALK_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_GRID_WALK_H_
#undef CROFTON_ACCELERATORS_GRID_WALK_H_
#else
#define CROFTON_ACCELERATORS_GRID_WALK_H_
#endif

#include "accelerators/cell_blocks.h"
#include "accelerators/grid_space.h"
#include "accelerators/shape_store.h"
#include "framework/counters.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Up to four triangles into a block: per corner four loads and a transpose, which brings the
/// indices along.
HWY_INLINE void load_records(const TriangleRecord* records, const uint32_t* references,
                             uint32_t count, TriangleBlock<4>& block) {
    const hn::FixedTag<float, 4> d;
    const hn::FixedTag<double, 2> d2;
    const hn::FixedTag<uint32_t, 4> du;
    const TriangleRecord* r[4];
    for (uint32_t i = 0; i < 4; ++i) r[i] = records + references[i < count ? i : 0];
    for (int k = 0; k < 3; ++k) {
        const auto a = hn::Load(d, r[0]->corner[k]), b = hn::Load(d, r[1]->corner[k]);
        const auto e = hn::Load(d, r[2]->corner[k]), f = hn::Load(d, r[3]->corner[k]);
        const auto ab_low = hn::BitCast(d2, hn::InterleaveLower(d, a, b));
        const auto ef_low = hn::BitCast(d2, hn::InterleaveLower(d, e, f));
        const auto ab_high = hn::BitCast(d2, hn::InterleaveUpper(d, a, b));
        const auto ef_high = hn::BitCast(d2, hn::InterleaveUpper(d, e, f));
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d2, ab_low, ef_low)), d, block.v[k][0]);
        hn::Store(hn::BitCast(d, hn::InterleaveUpper(d2, ab_low, ef_low)), d, block.v[k][1]);
        hn::Store(hn::BitCast(d, hn::InterleaveLower(d2, ab_high, ef_high)), d, block.v[k][2]);
        if (k == 0)
            hn::Store(hn::BitCast(du, hn::InterleaveUpper(d2, ab_high, ef_high)), du, block.id);
    }
}

/// Tests what references mean. @return whether an `any` query is answered
template <Query Q, class Set, class C>
HWY_INLINE bool test_stored(const ShapeStore<Set>& store, const Set& set,
                            const uint32_t* references, uint32_t count, const LocalRay& ray,
                            RayQuery& q, C& counters) {
    if constexpr (ShapeStore<Set>::keeps_set) {
        return test_references<Q>(set, references, count, ray, q, counters);
    } else {
        counters.test(count);
        TriangleBlock<4> block;
        for (uint32_t i = 0; i < count; i += 4) {
            // Spare lanes repeat the first triangle: a tie with itself changes nothing.
            load_records(store.records(), references + i, count - i, block);
            if (test_blocks<Q>(set, &block, 1, ray, q)) return true;
        }
        return false;
    }
}

/// The exact ray in double, with what all grids of a structure need of it.
struct ExactRay {
    double origin[3], direction[3];
    double inverse[3];  ///< inf where the direction is 0
    double reach[3];    ///< the ray's share of GridSpace::reach
    double t_min;       ///< lowered by what the t of a leaf test may be off

    ExactRay(const LocalRay& ray, const RayQuery& q) {
        for (int a = 0; a < 3; ++a) {
            origin[a] = ray.origin[a];
            direction[a] = ray.direction[a] + 0.0;  // -0 becomes 0
            inverse[a] = 1 / direction[a];
            reach[a] = ray.pad[a] + 0x1p-21 * std::abs(origin[a]);
        }
        t_min = q.t_low;
    }
    /// Whether a walk along the exact ray finds all that a leaf test may accept in this grid.
    bool fits(const GridSpace& grid) const {
        const double share = 0x1p-21 * grid.magnitude;
        return (reach[0] + share <= grid.margin[0]) & (reach[1] + share <= grid.margin[1]) &
               (reach[2] + share <= grid.margin[2]);
    }
    double at(double t, int axis) const { return origin[axis] + t * direction[axis]; }
};

/// Where the ray is inside the grid's box: the exact ray, or as thick as it is.
/// @return whether it is within [t_min, t_cull]; 0·∞ at a plane drops out of the comparisons
HWY_INLINE bool meets_grid(const GridSpace& grid, const ExactRay& ray, const LocalRay& local,
                           bool thick, const RayQuery& q, double& t_enter, double& t_leave) {
    double reach[3] = {0, 0, 0};
    if (HWY_UNLIKELY(thick))
        for (int a = 0; a < 3; ++a) reach[a] = grid.reach(local, a);
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

/// Follows the exact ray through a grid in blocks, cell by cell (3D-DDA: Amanatides & Woo 1987),
/// over empty blocks at once. A step loads nothing unless it enters another block.
///
/// The t of a plane is a linear function of its index, so that no error adds up along the way.
/// Where it is rounded, the walk is off by far less than the margin of the cells.
class BlockWalk {
  public:
    BlockWalk(const GridSpace& grid, const CellBlock* blocks, const ExactRay& ray, double t_enter,
              double t_leave)
        : block_(blocks), t_leave_(t_leave) {
        constexpr double infinity = std::numeric_limits<double>::infinity();
        ptrdiff_t stride = 1;
        for (int a = 0; a < 3; ++a) {
            const int i = grid.index(a, ray.at(t_enter, a)), n = blocks_along(grid.resolution[a]);
            const bool up = ray.direction[a] > 0, still = ray.direction[a] == 0;
            zero_[a] = still ? infinity : (grid.lower[a] - ray.origin[a]) * ray.inverse[a];
            pace_[a] = still ? 0 : grid.cell[a] * ray.inverse[a];
            rate_[a] = std::abs(ray.direction[a]) * grid.inverse_cell[a];
            up_[a] = up;
            step_[a] = up ? 1 : -1;
            index_[a] = i + int(up);
            next_[a] = zero_[a] + index_[a] * pace_[a];
            left_[a] = up ? 3 - (i & 3) : i & 3;
            blocks_left_[a] = up ? n - 1 - (i >> 2) : i >> 2;
            block_ += (i >> 2) * stride;
            bit_ += uint32_t(i & 3) << (2 * a);
            block_step_[a] = up ? stride : -stride;
            stride *= n;
        }
        occupied_ = block_->occupied;
    }

    /// @param visit  visit(place of the cell's code) -> bool: the query is answered, stop
    /// @param skip   empty blocks are passed at once
    /// @return whether `visit` stopped the walk
    template <class C, class Visit>
    HWY_INLINE bool run(bool skip, const RayQuery& q, C& counters, Visit&& visit) {
        double t_limit = std::min(t_leave_, double(q.t_cull));
        while (true) {
            counters.step();
            if (occupied_ >> bit_ & 1) {
                const uint64_t before = occupied_ & ((uint64_t(1) << bit_) - 1);
                if (visit(block_->first + uint32_t(hwy::PopCount(before)))) return true;
                t_limit = std::min(t_leave_, double(q.t_cull));
            } else {
                counters.cell(true);
                if (occupied_ == 0 && skip) {
                    if (!jump(t_limit)) return false;
                    continue;
                }
            }
            // Called with constants, so that all of it stays in registers.
            const bool on =
                next_[0] <= next_[1]
                    ? (next_[0] <= next_[2] ? advance(0, t_limit) : advance(2, t_limit))
                    : (next_[1] <= next_[2] ? advance(1, t_limit) : advance(2, t_limit));
            if (!on) return false;
        }
    }

  private:
    HWY_INLINE bool advance(int a, double t_limit) {
        if (next_[a] > t_limit) return false;
        index_[a] += step_[a];
        next_[a] = zero_[a] + index_[a] * pace_[a];
        const int bits = up_[a] ? 1 << (2 * a) : -(1 << (2 * a));
        if (--left_[a] >= 0) {
            bit_ += uint32_t(bits);
            return true;
        }
        if (--blocks_left_[a] < 0) return false;
        left_[a] = 3;
        bit_ -= uint32_t(3 * bits);
        block_ += block_step_[a];
        occupied_ = block_->occupied;
        return true;
    }
    /// To where the ray leaves the cube of empty blocks around this one (after the proximity clouds
    /// of Cohen & Sheffer 1994). Without a division: `rate_` is cells per t.
    HWY_INLINE bool jump(double t_limit) {
        const int reach = 4 * int(block_->clear);
        double t = std::numeric_limits<double>::infinity(), out[3];
        for (int a = 0; a < 3; ++a) {
            out[a] = zero_[a] + (index_[a] + step_[a] * (left_[a] + reach)) * pace_[a];
            t = std::min(t, out[a]);
        }
        if (t > t_limit) return false;
        bit_ = 0;
        bool inside = true;
        for (int a = 0; a < 3; ++a) {
            // Planes met by then: the last of the cube's only where the ray leaves through it.
            const int most = left_[a] + reach + int(out[a] <= t);
            const int passed =
                next_[a] <= t ? std::min(int((t - next_[a]) * rate_[a]) + 1, most) : 0;
            index_[a] += step_[a] * passed;
            next_[a] = zero_[a] + index_[a] * pace_[a];
            // Counted the way the ray goes, from where the first block of the walk began.
            const int from = 3 - left_[a] + passed, over = from >> 2;
            left_[a] = 3 - (from & 3);
            blocks_left_[a] -= over;
            inside &= blocks_left_[a] >= 0;
            block_ += over * block_step_[a];
            bit_ += uint32_t(up_[a] ? from & 3 : 3 - (from & 3)) << (2 * a);
        }
        if (!inside) return false;
        occupied_ = block_->occupied;
        return true;
    }

    const CellBlock* block_;
    uint64_t occupied_ = 0;  ///< of the block
    uint32_t bit_ = 0;       ///< of the cell in it
    double t_leave_;
    double zero_[3], pace_[3];   ///< t of plane i is zero + i·pace; d = 0: zero is infinity
    double rate_[3];             ///< cells per t
    double index_[3], next_[3];  ///< of the plane behind the cell, and its t
    double step_[3];             ///< of index_: ±1
    int left_[3];                ///< cells of the block behind this one, per axis
    int blocks_left_[3];         ///< of the grid behind the block
    ptrdiff_t block_step_[3];
    bool up_[3];
};

/// The same for a ray thicker than the margins of the cells.
template <class C, class Visit>
bool walk_blocks_thick(const GridSpace& grid, const CellBlock* blocks, const LocalRay& ray,
                       const RayQuery& q, double t_enter, double t_leave, C& counters,
                       Visit&& visit) {
    const auto visit_cell = [&](int x, int y, int z) HWY_ATTR {
        const uint32_t place = code_place(blocks, blocked_index(grid.resolution, x, y, z));
        counters.step();
        if (place != no_code) return visit(place);
        counters.cell(true);
        return false;
    };
    const auto past = [&](double t) HWY_ATTR { return t > double(q.t_cull); };
    return walk_cells_thick(grid, ray, t_enter, t_leave, visit_cell, past);
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
