#pragma once

#include <memory>
#include <optional>

#include "framework/exact_triangle.h"
#include "framework/ray_query.h"

namespace crofton::exact {

/// What one ray has been shown to hit first. In units of the user's ray, so that nothing of it was
/// scaled or rounded.
///
/// Culling stays conservative: the query's t_best is the exact t rounded to float (and up to the
/// query's units), so that what begins at the exact t or before it begins before t_cull =
/// t_best·(1 + 2^-14); boxes, planes and cells hold the exact shapes with more room than their
/// distances have roundings, as they must for the robust test, which accepts what is displaced.
class NearestHit {
  public:
    /// @param scale  t of the user = t of the query · scale, a power of two
    NearestHit(const Ray& ray, float scale) : ray_(ray), scale_(scale), double_ray_(ray) {}

    /// Tests a triangle of world-space corners; those that are not finite are never hit.
    /// @return  whether an `any` query is answered
    bool test_triangle(const Vec3f (&v)[3], const IdTable& ids, uint32_t shape, Query kind,
                       RayQuery& query);
    /// Tests the only shape of `one`.
    bool test_shape(const Shapes& one, const IdTable& ids, uint32_t shape, Query kind,
                    RayQuery& query);
    /// The map of a frame for the oracle's shapes.
    std::shared_ptr<const Placed> placed(const InstanceFrame* frame);

    /// Whether the query's hit is one that was decided here.
    bool decided(const RayQuery& query) const {
        return query.hit_ids == ids_ && query.hit_shape == shape_ &&
               query.hit_instance == instance_;
    }
    /// Of the hit, rounded to nearest.
    float t() const { return t_; }

  private:
    enum class Outcome { passed, taken, answered };
    /// @param deferred  the exact t of a sure hit may wait until it is needed: see corners_
    template <class Solve>
    Outcome consider(const Candidates& found, const Solve& solve, const IdTable& ids,
                     uint32_t shape, float u, float v, Query kind, bool deferred, RayQuery& query);
    template <class Solve>
    bool first_root(const Solve& solve, Root& root);
    bool in_front(const Root& root, const IdTable& ids, uint32_t shape, const RayQuery& query);
    void take(double lo, double hi, float t, const IdTable& ids, uint32_t shape, float u, float v,
              RayQuery& query);
    void adopt(const RayQuery& query);
    const ExactRay& exact_ray();

    const Ray ray_;
    const float scale_;
    const DoubleRay double_ray_;
    std::optional<ExactRay> exact_ray_;
    std::shared_ptr<const Placed> placed_;
    Transform placed_map_;

    // The hit: its exact t is in [lo_, hi_], and is root_, if that was needed. Else it is a
    // triangle of these corners.
    const IdTable* ids_ = nullptr;
    uint32_t shape_ = 0, instance_ = 0;
    double lo_ = INFINITY, hi_ = INFINITY;
    float t_ = INFINITY;
    std::optional<Root> root_;
    Vec3f corners_[3];
};

}  // namespace crofton::exact
