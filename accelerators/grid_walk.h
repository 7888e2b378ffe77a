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
#include "accelerators/stored_shapes.h"
#include "framework/counters.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Three doubles: x and y in one vector, z in both lanes of another.
struct Triple {
    using D = hn::FixedTag<double, 2>;
    using V = hn::Vec<D>;
    V xy, z;

    static HWY_INLINE Triple load(const double* p) {
        return {hn::LoadU(D(), p), hn::Set(D(), p[2])};
    }
    static HWY_INLINE Triple load(const float* p) {
        return {hn::PromoteTo(D(), hn::LoadU(hn::FixedTag<float, 2>(), p)),
                hn::Set(D(), double(p[2]))};
    }
    static HWY_INLINE Triple load(const int* p) {
        return {hn::PromoteTo(D(), hn::LoadU(hn::FixedTag<int32_t, 2>(), p)),
                hn::Set(D(), double(p[2]))};
    }
    static HWY_INLINE Triple all(double x) { return {hn::Set(D(), x), hn::Set(D(), x)}; }
    HWY_INLINE void store(double* p) const {
        hn::StoreU(xy, D(), p);
        p[2] = hn::GetLane(z);
    }
    HWY_INLINE double least() const {
        const V m = hn::Min(xy, z);
        return hn::GetLane(hn::Min(m, hn::Shuffle01(m)));
    }
    HWY_INLINE double greatest() const {
        const V m = hn::Max(xy, z);
        return hn::GetLane(hn::Max(m, hn::Shuffle01(m)));
    }
    HWY_INLINE Triple operator+(const Triple& b) const {
        return {hn::Add(xy, b.xy), hn::Add(z, b.z)};
    }
    HWY_INLINE Triple operator-(const Triple& b) const {
        return {hn::Sub(xy, b.xy), hn::Sub(z, b.z)};
    }
    HWY_INLINE Triple operator*(const Triple& b) const {
        return {hn::Mul(xy, b.xy), hn::Mul(z, b.z)};
    }
};
HWY_INLINE Triple least_of(const Triple& a, const Triple& b) {
    return {hn::Min(a.xy, b.xy), hn::Min(a.z, b.z)};
}
HWY_INLINE Triple greatest_of(const Triple& a, const Triple& b) {
    return {hn::Max(a.xy, b.xy), hn::Max(a.z, b.z)};
}
HWY_INLINE Triple magnitude_of(const Triple& a) { return {hn::Abs(a.xy), hn::Abs(a.z)}; }
HWY_INLINE Triple floor_of(const Triple& a) { return {hn::Floor(a.xy), hn::Floor(a.z)}; }

/// A truth for each of three.
struct TripleMask {
    hn::Mask<Triple::D> xy, z;
    HWY_INLINE Triple choose(const Triple& yes, const Triple& no) const {
        return {hn::IfThenElse(xy, yes.xy, no.xy), hn::IfThenElse(z, yes.z, no.z)};
    }
    HWY_INLINE bool all() const {
        // Not &&: one branch on both.
        return (int(hn::AllTrue(Triple::D(), xy)) & int(hn::AllTrue(Triple::D(), z))) != 0;
    }
};
HWY_INLINE TripleMask less(const Triple& a, const Triple& b) {
    return {hn::Lt(a.xy, b.xy), hn::Lt(a.z, b.z)};
}
HWY_INLINE TripleMask at_most(const Triple& a, const Triple& b) {
    return {hn::Le(a.xy, b.xy), hn::Le(a.z, b.z)};
}

/// The exact ray in double, with what all grids of a structure need of it.
struct ExactRay {
    // Stored as vectors, since they are loaded as such at once.
    double origin[3], direction[3];
    double inverse[3];  ///< inf where the direction is 0
    double reach[3];    ///< the ray's share of GridSpace::reach
    double t_min;       ///< lowered by what the t of a leaf test may be off
    /// -1 where the ray goes down an axis, 0 elsewhere; as flips of the bits of a block.
    int down[3];
    uint32_t flip = 0;

    HWY_INLINE ExactRay(const LocalRay& ray, const RayQuery& q) {
        const Triple zero = Triple::all(0);
        const Triple o = Triple::load(ray.origin);
        const Triple d = Triple::load(ray.direction) + zero;  // -0 becomes 0
        const V one = hn::Set(Triple::D(), 1.0);
        const Triple r = Triple::load(ray.pad) + Triple::all(GridSpace::leaf_reach) * magnitude_of(o);
        o.store(origin);
        d.store(direction);
        Triple{hn::Div(one, d.xy), hn::Div(one, d.z)}.store(inverse);
        r.store(reach);
        t_min = q.t_low;
        for (int a = 0; a < 3; ++a) {
            down[a] = -int(ray.direction[a] < 0);
            flip |= uint32_t(down[a]) & 3u << (2 * a);
        }
    }
    /// Whether a walk along the exact ray finds all that a leaf test may accept in this grid.
    HWY_INLINE bool fits(const GridSpace& grid) const {
        const Triple share = Triple::all(GridSpace::leaf_reach * grid.magnitude);
        return at_most(Triple::load(reach) + share, Triple::load(grid.margin)).all();
    }
    double at(double t, int axis) const { return origin[axis] + t * direction[axis]; }

  private:
    using V = Triple::V;
};

/// Where the ray is inside the grid's box: the exact ray, or as thick as it is.
/// @return whether it is within [t_min, t_cull]; 0·∞ at a plane drops out of the comparisons
HWY_INLINE bool meets_grid(const GridSpace& grid, const ExactRay& ray, const LocalRay& local,
                           bool thick, const RayQuery& q, double& t_enter, double& t_leave) {
    Triple lower = Triple::load(grid.box.lower.data()), upper = Triple::load(grid.box.upper.data());
    if (HWY_UNLIKELY(thick)) {
        double reach[3];
        for (int a = 0; a < 3; ++a) reach[a] = grid.reach(local, a);
        lower = lower - Triple::load(reach);
        upper = upper + Triple::load(reach);
    }
    const Triple origin = Triple::load(ray.origin), inverse = Triple::load(ray.inverse);
    const Triple t0 = (lower - origin) * inverse, t1 = (upper - origin) * inverse;
    const TripleMask down = less(inverse, Triple::all(0));
    const Triple first = down.choose(t1, t0), last = down.choose(t0, t1);
    const Triple t_min = Triple::all(ray.t_min), t_max = Triple::all(double(q.t_cull));
    t_enter = less(t_min, first).choose(first, t_min).greatest();
    t_leave = less(last, t_max).choose(last, t_max).least();
    // A ray that runs beside the box enters it at infinity, which t_cull may be.
    return t_enter <= t_leave && t_enter < std::numeric_limits<double>::infinity();
}

/// Follows the exact ray through a grid in blocks, cell by cell (3D-DDA: Amanatides & Woo 1987),
/// over empty blocks at once.
///
/// Cells are counted the way the ray goes, so that every axis counts up. A step has no branch that
/// depends on the axis: where the ray meets two planes at once, it passes both; a shape at their
/// edge stands in the cells around it, by their margin. The t of a plane is a linear function of
/// its index, never a sum, so that no error adds up and the ray cannot step out of the grid.
class BlockWalk {
    using D = Triple::D;
    using V = Triple::V;

  public:
    HWY_INLINE BlockWalk(const GridSpace& grid, const CellBlock* blocks, const ExactRay& ray,
                         double t_enter)
        : blocks_(blocks) {
        ptrdiff_t stride = 1;
        int padded[3];  // cells, with those that fill the last block
        for (int a = 0; a < 3; ++a) {
            const ptrdiff_t n = blocks_along(grid.resolution[a]), down = ray.down[a];
            padded[a] = int(4 * n);
            blocks_ += down & ((n - 1) * stride);
            stride_[a] = (stride ^ down) - down;
            stride *= n;
        }
        flip_ = ray.flip;

        const Triple none = Triple::all(0), one = Triple::all(1);
        const Triple lower = Triple::load(grid.lower), rate = Triple::load(grid.inverse_cell);
        const Triple origin = Triple::load(ray.origin), direction = Triple::load(ray.direction);
        const Triple inverse = Triple::load(ray.inverse);
        const Triple n = Triple::load(grid.resolution.data());
        const Triple beyond = {hn::ConcatLowerLower(D(), hn::Set(D(), double(padded[1])),
                                                    hn::Set(D(), double(padded[0]))),
                               hn::Set(D(), double(padded[2]))};
        const TripleMask down = less(direction, none);
        const Triple speed = magnitude_of(direction);
        const TripleMask moves = less(none, speed);

        const Triple zero = (lower - origin) * inverse;
        const Triple pace = Triple::load(grid.cell) * inverse;
        pace_ = moves.choose(magnitude_of(pace), none);
        zero_ = moves.choose(down.choose(zero + beyond * pace, zero),
                             Triple::all(std::numeric_limits<double>::infinity()));
        rate_ = speed * rate;
        const Triple end = down.choose(beyond, n);
        exit_ = (zero_ + end * pace_).least();
        last_ = end - one;

        const Triple at = (origin + Triple::all(t_enter) * direction - lower) * rate;
        const Triple cell = floor_of(least_of(greatest_of(at, none), n - one));
        stand_at(down.choose(beyond - one - cell, cell));
    }

    /// @param visit  visit(place of the cell's code) -> bool: the query is answered, stop
    /// @param skip   empty blocks are passed at once
    /// @return whether `visit` stopped the walk
    template <class C, class Visit>
    HWY_INLINE bool run(bool skip, const RayQuery& q, C& counters, Visit&& visit) {
        const D d;
        const Triple one = Triple::all(1);
        Triple next = zero_ + plane_ * pace_;
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
                    next = zero_ + plane_ * pace_;
                    continue;
                }
            }
            const Triple plane = plane_ + one;
            const Triple after = zero_ + plane * pace_;
            V t = hn::Min(next.xy, next.z);
            t = hn::Min(t, hn::Shuffle01(t));
            const double t_step = hn::GetLane(t);
            if (t_step >= exit_ || t_step > t_cull) return false;
            const TripleMask passed = {hn::Eq(next.xy, t), hn::Eq(next.z, t)};
            next = passed.choose(after, next);
            plane_ = passed.choose(plane, plane_);
            uint8_t xy[8], zz[8];
            hn::StoreMaskBits(d, passed.xy, xy);
            hn::StoreMaskBits(d, passed.z, zz);
            static constexpr uint64_t moves[4] = {0, 1, uint64_t(1) << bits,
                                                  1 | uint64_t(1) << bits};
            pos_ += moves[xy[0] & 3] + (uint64_t(zz[0] & 1) << (2 * bits));
        }
    }

  private:
    static constexpr int bits = 21;  ///< of pos_ for each axis

    uint32_t along(int a) const { return uint32_t(pos_ >> (bits * a)) & ((1u << bits) - 1); }

    /// @param cell  the way the ray goes; whole numbers
    HWY_INLINE void stand_at(const Triple& cell) {
        plane_ = cell + Triple::all(1);
        pos_ = uint64_t(int64_t(hn::GetLane(cell.xy))) |
               uint64_t(int64_t(hn::GetLane(hn::Shuffle01(cell.xy)))) << bits |
               uint64_t(int64_t(hn::GetLane(cell.z))) << (2 * bits);
    }

    /// To where the ray leaves the cube of empty blocks around this one (after the proximity clouds
    /// of Cohen & Sheffer 1994). Without a division: `rate_` is cells per t.
    /// @return whether that is inside the grid and not behind the best hit
    HWY_INLINE bool jump(uint32_t clear, double t_cull) {
        const Triple one = Triple::all(1), cell = plane_ - one;
        const Triple end = floor_of(cell * Triple::all(0.25)) * Triple::all(4) +
                           Triple::all(4 + 4 * double(clear));
        const Triple out = zero_ + end * pace_;
        const double t = out.least();
        if (t >= exit_ || t > t_cull) return false;
        // The cell at t; not before this one, nor beyond the cube unless it is left there.
        const Triple none = Triple::all(0), now = Triple::all(t);
        const Triple at = less(none, pace_).choose((now - zero_) * rate_, none);
        const TripleMask left = at_most(out, now);
        const Triple most = left.choose(end, least_of(end - one, last_));
        stand_at(floor_of(least_of(greatest_of(at, left.choose(end, cell)), most)));
        return true;
    }

    const CellBlock* blocks_;  ///< the first one of the ray's octant
    uint64_t pos_ = 0;         ///< of the cell, the way the ray goes: x, y, z
    uint32_t flip_;            ///< from there to the bit of the cell
    double exit_;              ///< where the ray leaves the grid
    Triple plane_;             ///< index of the planes behind the cell
    Triple zero_, pace_;       ///< t of plane i is zero + i·pace; d = 0: zero is infinity
    Triple rate_;              ///< cells per t
    Triple last_;              ///< cell of the grid
    ptrdiff_t stride_[3];      ///< of blocks
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
