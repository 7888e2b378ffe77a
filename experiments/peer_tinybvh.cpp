#include "experiments/peers.h"

#ifdef CROFTON_TINYBVH
#include <hwy/targets.h>

#include "experiments/peer_object.h"
#include "experiments/tinybvh_kernel.h"
#include "framework/ray_query.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

/// It takes every hit in front of the origin to lie within the ray and answers with its own t, u,
/// v; the mode of a query means nothing to it.
class TinyBvhObject final : public PeerObject {
  public:
    TinyBvhObject(std::shared_ptr<const TriangleSet> set, bool high)
        : PeerObject("tinybvh", *set),
          triangles_(std::move(set)),
          bvh_(triangles_->coordinates(), triangles_->vertices(), triangles_->triangles()->data(),
               triangles_->size(), high) {}

    using PeerObject::any_local;
    using PeerObject::closest_local;
    void closest_local(const LocalRay& ray, RayQuery& q) const override {
        const TinyBvh::Hit hit = bvh_.intersect(ray_of(ray, q));
        if (hit.t < q.t_best) q.record(hit.t, hit.u, hit.v, triangles_->ids(), hit.triangle);
    }
    bool any_local(const LocalRay& ray, RayQuery& q) const override {
        return bvh_.occluded(ray_of(ray, q));
    }

  private:
    uint64_t bytes() const override { return bvh_.bytes(); }
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
