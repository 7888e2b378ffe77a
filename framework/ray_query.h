#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "framework/mode.h"
#include "framework/ray.h"
#include "framework/shape_groups.h"
#include "framework/transform.h"

namespace crofton {

class IdTable;
namespace exact {
class NearestHit;
}

/// The two queries. `closest`: the nearest hit; `any`: whether there is one.
enum class Query { closest, any };

/// Where an object stands: the whole chain of instances composed in double, and rounded once, with
/// what a ray needs to enter it.
struct InstanceFrame {
    Transform world_from_object;
    Transform object_from_world;
    FloatTransform world_from_object_f;  ///< rounded(world_from_object)
    /// object_from_world, rounded: images of the three axes, and of the world's origin.
    float column[4][4];
    float pad[4];     ///< of a ray from the world's origin, see `enter`
    float magnitude;  ///< largest absolute coordinate of the object's bounds, in its space

    /// @param magnitudes  largest absolute coordinates of the object
    InstanceFrame(const Transform& world_from_object, const Transform& object_from_world,
                  const Vec3f& magnitudes);
};

/// A ray in one object's space, prepared for conservative box tests.
///
/// A plane at b is met at fl(fl(b - near_origin)·rcp) or later and fl(fl(b - far_origin)·far_rcp)
/// or earlier, the origins shifted by `pad` apart; or, in one operation where there is a fused
/// one, at fl(fl(b·rcp) - fl(near_origin·rcp)) and so on. The shift covers (a) in an instance, the
/// rounding of its map and of the origin, (c) the replacement of 1/d by a finite number where d
/// is 0 or tiny, and (d) the rounding of the two products, which is that of a plane and an origin
/// moved by u·|b| and u·|o|, b being o + t·d: 2u·|o|, and what is relative to t. A pad of 4u·|o|
/// moves the origin by 3u·|o| at least, rounded. What a leaf test errs by, (b), is in `box_slack`
/// and in the boxes themselves.
///
/// As for (b): a test that works with s(v) = fl(fl(v_x - o_x) - fl(sx·fl(v_z - o_z))), z the main
/// axis of the ray, accepts only rays that meet the triangle of such rounded corners. So there is a
/// point p of the exact triangle, a mean of its corners, that the ray passes at no more than the
/// same mean of their errors. A corner's error is at most u·|v_x - o_x| + 4u·|sx|·|v_z - o_z|, the
/// factor sx having two roundings, and u·|s(v)| of the difference. Now |v - o| <= |v - p| + |p -
/// o|; the mean of |v - p| on an axis is at most half the triangle's extent there; and |sx|·|p_z -
/// o_z| = |p_x - o_x| on the ray. That makes 5u·|p_x - o_x| + u·extent_x + 2.5u·extent_z.
/// `box_slack` covers the first, and boxes of triangles are larger by the others:
/// TriangleSet::slack. So a scene's size does not make its small parts thick. Nothing here asks
/// that a box hold all of the triangle: it must hold p with that slack. Boxes of parts do as well,
/// as long as the parts cover the triangle.
///
/// A structure that follows the ray by other means than boxes of shapes takes 5u·(|o| + magnitude)
/// and, since an extent is at most 2·magnitude, 7u·magnitude: ThickRay.
///
/// Since `box_slack` shrinks a negative far distance, `pad` has that share too where t_min is
/// negative.
struct LocalRay {
    // x, y, z, and a lane that means nothing.
    float origin[4];
    float direction[4];
    float near_origin[4];
    float far_origin[4];
    float rcp[4];  ///< finite: 1/d, or ±2^60/max|d| where |d| is below that. Its product with an
                   ///< origin is finite too
    float far_rcp[4];            ///< rcp·(1 + box_slack)
    float near_base[4];          ///< near_origin·rcp
    float far_base[4];           ///< far_origin·far_rcp
    float pad[4];                ///< half-width of the thick ray that a structure must follow, >= 0
    const InstanceFrame* frame;  ///< null: this is world space (in Mode::exact the identity)
};

/// Shares of an object's magnitude and of a ray's origin that `pad` has at least.
inline constexpr float magnitude_pad = 0x1p-40f, origin_pad = 0x1p-22f;
/// In an instance also of what the map adds up to, see InstanceFrame.
inline constexpr float frame_pad = 0x1p-19f;
/// Largest |rcp|, times max|d|.
inline constexpr float rcp_limit = 0x1p60f;
/// Relative widening of a far box distance. Two slab distances carry 3 roundings each, γ3 = 3u; a
/// leaf test may put a hit 8u·|v - o| outside its triangle. 16u = 2^-20 covers both.
inline constexpr float box_slack = 0x1p-20f;
/// A leaf test's t is right within 2^-15 (relative; far better in all modes but `fast`), so
/// a node is culled only if it begins beyond t·(1 + 2^-14): no order of visits can then change
/// which hit is found.
inline constexpr float cull_slack = 0x1p-14f;

/// One ray's progress. Space: world, with t scaled so that max|direction| is in [1, 2); scaling by
/// a power of two loses nothing and keeps every product in range for |d| from 1e-30 to 1e30.
struct RayQuery {
    float origin[4];
    float direction[4];
    float t_min;
    float t_low;   ///< t_min less cull_slack: what ends before it cannot matter
    float t_best;  ///< of the closest hit so far, or t_max
    float t_cull;  ///< t_best and cull_slack: what begins beyond it cannot matter
    /// Shear of the watertight test (Woop, Benthin, Wald 2013): axis order and factors.
    int kx, ky, kz;
    uint32_t instance;  ///< sum of the instance offsets on the path to the current object
    float shear_x, shear_y, shear_z;

    float hit_u, hit_v;      ///< of the hit, if there is one
    uint32_t hit_shape;      ///< index in the set that was hit
    const IdTable* hit_ids;  ///< the set that was hit; null: nothing yet
    uint32_t hit_instance;

    Mode mode;                 ///< looked at where a leaf has something for it
    exact::NearestHit* exact;  ///< of the hit so far; in Mode::exact only, else not set

    void set_best(float t) {
        t_best = t;
        t_cull = t + std::abs(t) * cull_slack;
    }
    void set_min(float t) {
        t_min = t;
        t_low = t - std::abs(t) * cull_slack;
    }
    /// Ids of the current hit.
    Hit ids() const;
    /// The current hit. @param scale  see `prepare`
    Hit hit(float scale) const;
    /// Records a hit with t in [t_min, t_best] unless one at the same t has lower ids.
    void record(float t, float u, float v, const IdTable& ids, uint32_t shape);
    /// Records a hit that is known to be nearer, or to have lower ids at the same t.
    void replace(float t, float u, float v, const IdTable& ids, uint32_t shape);
};

/// Fills a ray's state, and its LocalRay in the world, from a user's ray.
/// @param magnitude  largest absolute coordinate of the root's bounds
/// @param scale      power of two with t_user = t·scale, to give results back
/// @return false  for a ray that is a defined miss (see Ray)
bool prepare(const Ray& ray, float magnitude, RayQuery& query, LocalRay& local, float& scale);

/// Fills the LocalRay of a query in an object's space.
/// @param frame  referred to by `local` from then on
/// @return false  where the mapped direction is zero or not finite
bool enter(const InstanceFrame& frame, const RayQuery& query, LocalRay& local);

/// The ray in an object's space, in double.
struct ObjectRay {
    Vec3d origin, direction;
    ObjectRay(const LocalRay& local, const RayQuery& query);
};

/// Maps a shape's index in a set to what a Hit names: its geometry, its index there, and the
/// instance (relative to the object's).
class IdTable {
  public:
    /// Shapes from `first` on, until the next run.
    struct Run {
        uint32_t first;
        uint32_t geometry;
        uint32_t primitive;  ///< of the first shape of the run
        uint32_t instance;   ///< offset from the object's own
    };
    IdTable() : IdTable(std::vector<Run>{{0, 0, 0, 0}}) {}
    /// @param runs  by `first`, that of the first 0
    explicit IdTable(std::vector<Run> runs) : runs_(std::move(runs)) { index_runs(); }

    /// Of a part of the set: shape i of the part is shape shapes[i] of the whole.
    IdTable subset(std::span<const uint32_t> shapes) const {
        IdTable part(runs_);
        part.whole_.assign(shapes.begin(), shapes.end());
        if (!whole_.empty())
            for (uint32_t& shape : part.whole_) shape = whole_[shape];
        return part;
    }
    template <class A>
    void archive(A& a) {
        a(runs_, whole_);
        if constexpr (A::reads) index_runs();
    }
    void resolve(uint32_t shape, uint32_t base, Hit& hit) const {
        if (!whole_.empty()) shape = whole_[shape];
        const Run& run = run_of(shape);
        hit.primitive = run.primitive + (shape - run.first);
        hit.geometry = run.geometry;
        hit.instance = base + run.instance;
    }
    size_t bytes() const {
        return runs_.size() * sizeof(Run) + (whole_.size() + run_at_.size()) * sizeof(uint32_t);
    }
    /// A group for each run: the geometries of a mesh, or the meshes that were put together; none
    /// for one run.
    /// @param size  shapes in the set
    ShapeGroups groups(uint32_t size) const;

  private:
    /// Every hit asks for its run, so the runs where a shape can be are looked up: mostly one or
    /// two.
    const Run& run_of(uint32_t shape) const {
        if (runs_.size() == 1) return runs_[0];
        const size_t place = std::min<size_t>(shape >> shift_, run_at_.size() - 2);
        const Run* const first = &runs_[run_at_[place]];
        const Run* const last = &runs_[run_at_[place + 1]];
        if (last - first < 2) return first < last && last->first <= shape ? *last : *first;
        return *(std::upper_bound(first + 1, last + 1, shape,
                                  [](uint32_t s, const Run& r) { return s < r.first; }) -
                 1);
    }
    void index_runs();

    std::vector<Run> runs_;        ///< sorted by `first`, the first one 0
    std::vector<uint32_t> whole_;  ///< a part's shapes in the whole set; empty: this is the whole
    /// Of shapes from i << shift_ on, the run of the first of them; and the last run at the end.
    std::vector<uint32_t> run_at_;
    uint32_t shift_ = 0;
};

inline Hit RayQuery::ids() const {
    Hit hit;
    if (hit_ids) hit_ids->resolve(hit_shape, hit_instance, hit);
    return hit;
}

inline Hit RayQuery::hit(float scale) const {
    Hit hit = ids();
    if (!hit_ids) return hit;
    hit.t = t_best * scale;
    hit.u = hit_u;
    hit.v = hit_v;
    return hit;
}

inline void RayQuery::record(float t, float u, float v, const IdTable& ids, uint32_t shape) {
    if (t == t_best && hit_ids) {
        Hit candidate;
        ids.resolve(shape, instance, candidate);
        if (!id_less(candidate, this->ids())) return;
    }
    replace(t, u, v, ids, shape);
}

inline void RayQuery::replace(float t, float u, float v, const IdTable& ids, uint32_t shape) {
    set_best(t);
    hit_ids = &ids;
    hit_shape = shape;
    hit_instance = instance;
    hit_u = u;
    hit_v = v;
}

}  // namespace crofton
