#include "experiments/peers.h"

#ifdef CROFTON_TINYBVH
#include <hwy/targets.h>

#include <algorithm>

#include "experiments/tinybvh_kernel.h"
#include "framework/error.h"
#include "framework/ray_query.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

/// It takes every hit in front of the origin to lie within the ray and answers with its own t, u,
/// v; the mode of a query means nothing to it.
class TinyBvhObject final : public Primitive {
  public:
    TinyBvhObject(std::shared_ptr<const TriangleSet> set, bool high)
        : triangles_(std::move(set)),
          bvh_(triangles_->coordinates(), vertices(*triangles_), triangles_->triangles()->data(),
               triangles_->size(), high) {
        Bounds3 bounds;
        for (uint32_t i = 0; i < triangles_->size(); ++i)
            if (triangles_->active(i)) bounds.extend(triangles_->bounds(i));
        set_bounds(bounds);
    }

    void closest_local(const LocalRay& ray, RayQuery& q) const override {
        const TinyBvh::Hit hit = bvh_.intersect(ray_of(ray, q));
        if (hit.t < q.t_best) q.record(hit.t, hit.u, hit.v, triangles_->ids(), hit.triangle);
    }
    bool any_local(const LocalRay& ray, RayQuery& q) const override {
        return bvh_.occluded(ray_of(ray, q));
    }
    void closest_local(const LocalRay& ray, RayQuery& q, Counters&) const override {
        closest_local(ray, q);
    }
    bool any_local(const LocalRay& ray, RayQuery& q, Counters&) const override {
        return any_local(ray, q);
    }
    double expected_cost() const override { return 0; }
    StructureStatistics statistics() const override {
        StructureStatistics s;
        s.bytes = bvh_.bytes();
        return s;
    }
    std::string type_name() const override { return "tinybvh"; }
    void walk(const BoxVisitor& visit) const override { visit(bounds(), 0, true, 0); }
    void children(const std::function<void(const Primitive&)>&) const override {}
    void archive(StructureWriter&) const override {
        throw InputError("tinybvh: a peer's structure cannot be saved");
    }

  private:
    static size_t vertices(const TriangleSet& set) {
        size_t count = 0;
        for (uint32_t i = 0; i < set.size(); ++i)
            for (const uint32_t corner : set.triangles()[i])
                count = std::max<size_t>(count, corner + size_t{1});
        return count;
    }
    static TinyBvh::Ray ray_of(const LocalRay& ray, const RayQuery& q) {
        return {{ray.origin[0], ray.origin[1], ray.origin[2]},
                {ray.direction[0], ray.direction[1], ray.direction[2]},
                q.t_best};
    }

    std::shared_ptr<const TriangleSet> triangles_;
    TinyBvh bvh_;
};

std::unique_ptr<Primitive> build_tinybvh(const PrimitiveSet& any, const ParameterValues& values) {
    if (!(hwy::SupportedTargets() & HWY_AVX2)) throw InputError("tinybvh: needs AVX2");
    const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&any);
    if (!set) throw InputError("tinybvh: only triangles");
    const auto at = values.find("quality");
    const bool high = at != values.end() && std::get<std::string>(at->second) == "high";
    return std::make_unique<TinyBvhObject>(*set, high);
}

}  // namespace
}  // namespace crofton
#endif

namespace crofton {

AcceleratorInfo tinybvh_peer() {
    AcceleratorInfo info;
    info.name = "tinybvh";
    info.summary = "BVH8_CPU of tinybvh, over triangles; a peer to compare with";
    info.source = "Bikker 2024, tinybvh, a single-header BVH library";
    info.parameters = {{"quality",
                        std::string("medium"),
                        0,
                        0,
                        {"medium", "high"},
                        "Build (binned) or BuildHQ (spatial splits)"}};
#ifdef CROFTON_TINYBVH
    info.build = build_tinybvh;
#endif
    return info;
}

}  // namespace crofton
