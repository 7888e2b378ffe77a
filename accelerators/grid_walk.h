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
/// over empty blocks at once.
///
/// Cells are counted the way the ray goes, so that every axis counts up. A step has no branch that
/// depends on the axis: where the ray meets two planes at once, it passes both; a shape at their
/// edge stands in the cells around it, by their margin. The t of a plane is a linear function of
/// its index, never a sum, so that no error adds up and the ray cannot step out of the grid.
class BlockWalk {
    using D = hn::FixedTag<double, 2>;
    using V = hn::Vec<D>;

  public:
    BlockWalk(const GridSpace& grid, const CellBlock* blocks, const ExactRay& ray, double t_enter)
        : blocks_(blocks) {
        constexpr double infinity = std::numeric_limits<double>::infinity();
        double exit = infinity;
        ptrdiff_t stride = 1;
        for (int a = 0; a < 3; ++a) {
            const int n = blocks_along(grid.resolution[a]);
            const int i = grid.index(a, ray.at(t_enter, a));
            const double zero = (grid.lower[a] - ray.origin[a]) * ray.inverse[a];
            const double pace = grid.cell[a] * ray.inverse[a];
            const bool down = ray.direction[a] < 0, still = ray.direction[a] == 0;
            const int end = down ? 4 * n : grid.resolution[a];
            zero_[a] = still ? infinity : down ? zero + 4 * n * pace : zero;
            pace_[a] = still ? 0 : std::abs(pace);
            rate_[a] = std::abs(ray.direction[a]) * grid.inverse_cell[a];
            exit = std::min(exit, zero_[a] + end * pace_[a]);
            last_[a] = end - 1;
            pos_ |= uint64_t(down ? 4 * n - 1 - i : i) << (bits * a);
            flip_ |= down ? 3u << (2 * a) : 0u;
            blocks_ += down ? (n - 1) * stride : 0;
            stride_[a] = down ? -stride : stride;
            stride *= n;
        }
        exit_ = exit;
    }

    /// @param visit  visit(place of the cell's code) -> bool: the query is answered, stop
    /// @param skip   empty blocks are passed at once
    /// @return whether `visit` stopped the walk
    template <class C, class Visit>
    HWY_INLINE bool run(bool skip, const RayQuery& q, C& counters, Visit&& visit) {
        const D d;
        const V one = hn::Set(d, 1.0);
        const V zero_xy = hn::LoadU(d, zero_), pace_xy = hn::LoadU(d, pace_);
        const V zero_z = hn::Set(d, zero_[2]), pace_z = hn::Set(d, pace_[2]);
        // The plane behind the cell, the one behind it, and their t. Both lanes of z are the same.
        V plane_xy, plane_z, next_xy, next_z;
        const auto set_planes = [&] {
            plane_xy =
                hn::ConcatLowerLower(d, hn::Set(d, along(1) + 1.0), hn::Set(d, along(0) + 1.0));
            plane_z = hn::Set(d, along(2) + 1.0);
            next_xy = hn::Add(zero_xy, hn::Mul(plane_xy, pace_xy));
            next_z = hn::Add(zero_z, hn::Mul(plane_z, pace_z));
        };
        set_planes();
        double t_cull = q.t_cull;
        while (true) {
            const uint32_t x = along(0), y = along(1), z = along(2);
            const CellBlock& block =
                blocks_[(x >> 2) * stride_[0] + (y >> 2) * stride_[1] + (z >> 2) * stride_[2]];
            const uint32_t bit = ((x & 3) | (y & 3) << 2 | (z & 3) << 4) ^ flip_;
            counters.step();
            if (block.occupied >> bit & 1) {
                const uint64_t before = block.occupied & ((uint64_t(1) << bit) - 1);
                if (visit(block.first + uint32_t(hwy::PopCount(before)))) return true;
                t_cull = q.t_cull;
            } else {
                counters.cell(true);
                if (block.occupied == 0 && skip) {
                    if (!jump(block.clear, t_cull)) return false;
                    set_planes();
                    continue;
                }
            }
            const V after_xy = hn::Add(zero_xy, hn::Mul(hn::Add(plane_xy, one), pace_xy));
            const V after_z = hn::Add(zero_z, hn::Mul(hn::Add(plane_z, one), pace_z));
            V t = hn::Min(next_xy, next_z);
            t = hn::Min(t, hn::Shuffle01(t));
            const double t_step = hn::GetLane(t);
            if (t_step >= exit_ || t_step > t_cull) return false;
            const auto on_xy = hn::Eq(next_xy, t), on_z = hn::Eq(next_z, t);
            next_xy = hn::IfThenElse(on_xy, after_xy, next_xy);
            next_z = hn::IfThenElse(on_z, after_z, next_z);
            plane_xy = hn::Add(plane_xy, hn::IfThenElseZero(on_xy, one));
            plane_z = hn::Add(plane_z, hn::IfThenElseZero(on_z, one));
            uint8_t xy[8], zz[8];
            hn::StoreMaskBits(d, on_xy, xy);
            hn::StoreMaskBits(d, on_z, zz);
            static constexpr uint64_t moves[4] = {0, 1, uint64_t(1) << bits,
                                                  1 | uint64_t(1) << bits};
            pos_ += moves[xy[0] & 3] + (uint64_t(zz[0] & 1) << (2 * bits));
        }
    }

  private:
    static constexpr int bits = 21;  ///< of pos_ for each axis

    uint32_t along(int a) const { return uint32_t(pos_ >> (bits * a)) & ((1u << bits) - 1); }

    /// To where the ray leaves the cube of empty blocks around this one (after the proximity clouds
    /// of Cohen & Sheffer 1994). Without a division: `rate_` is cells per t.
    /// @return whether that is inside the grid and not behind the best hit
    HWY_INLINE bool jump(uint32_t clear, double t_cull) {
        double end[3], out[3];
        for (int a = 0; a < 3; ++a) {
            end[a] = double((along(a) | 3) + 1 + 4 * clear);
            out[a] = zero_[a] + end[a] * pace_[a];
        }
        const double t = std::min({out[0], out[1], out[2]});
        if (t >= exit_ || t > t_cull) return false;
        uint64_t pos = 0;
        for (int a = 0; a < 3; ++a) {
            // The cell at t; not before this one, nor beyond the cube unless it is left there.
            const double at = pace_[a] > 0 ? (t - zero_[a]) * rate_[a] : 0;
            const double most = out[a] <= t ? end[a] : std::min(end[a] - 1, last_[a]);
            const double least = out[a] <= t ? end[a] : double(along(a));
            pos |= uint64_t(int64_t(std::min(std::max(at, least), most))) << (bits * a);
        }
        pos_ = pos;
        return true;
    }

    const CellBlock* blocks_;   ///< the first one of the ray's octant
    uint64_t pos_ = 0;          ///< of the cell, the way the ray goes: x, y, z
    uint32_t flip_ = 0;         ///< from there to the bit of the cell
    double exit_;               ///< where the ray leaves the grid
    double zero_[3], pace_[3];  ///< t of plane i is zero + i·pace; d = 0: zero is infinity
    double rate_[3];            ///< cells per t
    double last_[3];            ///< cell of the grid
    ptrdiff_t stride_[3];       ///< of blocks
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
