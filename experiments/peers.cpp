#include "experiments/peers.h"

#include "framework/registry.h"

#ifdef CROFTON_EMBREE
#include CROFTON_EMBREE

#include "framework/error.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

/// Embree's structure over one set of triangles. It answers with its own t, u, v and whichever of
/// several triangles at one t it meets first; the mode of a query means nothing to it.
class EmbreeObject final : public Primitive {
  public:
    EmbreeObject(std::shared_ptr<const TriangleSet> set, bool robust) : ids_(set->ids()) {
        device_ = rtcNewDevice("threads=0");
        scene_ = rtcNewScene(device_);
        if (robust) rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_HIGH);
        add_triangles(*set);
        rtcCommitScene(scene_);
        RTCBounds b;
        rtcGetSceneBounds(scene_, &b);
        Bounds3 bounds;
        for (uint32_t i = 0; i < set->size(); ++i)
            if (set->active(i)) bounds.extend(set->bounds(i));
        set_bounds(bounds);
    }
    ~EmbreeObject() override {
        rtcReleaseScene(scene_);
        rtcReleaseDevice(device_);
    }

    void closest_local(const LocalRay& ray, RayQuery& q) const override {
        RTCRayHit r;
        r.ray = ray_of(ray, q);
        r.hit.geomID = r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
        rtcIntersect1(scene_, &r);
#else
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcIntersect1(scene_, &context, &r);
#endif
        if (r.hit.geomID != RTC_INVALID_GEOMETRY_ID)
            q.record(r.ray.tfar, r.hit.u, r.hit.v, ids_, r.hit.primID);
    }
    bool any_local(const LocalRay& ray, RayQuery& q) const override {
        RTCRay r = ray_of(ray, q);
#if RTC_VERSION_MAJOR >= 4
        rtcOccluded1(scene_, &r);
#else
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcOccluded1(scene_, &context, &r);
#endif
        return r.tfar < 0;
    }
    void closest_local(const LocalRay& ray, RayQuery& q, Counters&) const override {
        closest_local(ray, q);
    }
    bool any_local(const LocalRay& ray, RayQuery& q, Counters&) const override {
        return any_local(ray, q);
    }
    double expected_cost() const override { return 0; }
    StructureStatistics statistics() const override { return {}; }
    std::string type_name() const override { return "embree"; }
    void walk(const BoxVisitor& visit) const override { visit(bounds(), 0, true, 0); }
    void children(const std::function<void(const Primitive&)>&) const override {}
    void archive(StructureWriter&) const override {
        throw InputError("embree: a peer's structure cannot be saved");
    }

  private:
    void add_triangles(const TriangleSet& set) {
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        const size_t n = set.size();
        auto* corners = static_cast<float*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, 3 * n));
        auto* indices = static_cast<uint32_t*>(
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, n));
        for (uint32_t i = 0; i < n; ++i)
            for (uint32_t k = 0; k < 3; ++k) {
                indices[3 * i + k] = 3 * i + k;
                const Vec3f& v = set.vertex(i, int(k));
                for (uint32_t a = 0; a < 3; ++a) corners[9 * i + 3 * k + a] = v[int(a)];
            }
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene_, geometry);
        rtcReleaseGeometry(geometry);
    }
    static RTCRay ray_of(const LocalRay& ray, const RayQuery& q) {
        RTCRay r{};
        r.org_x = ray.origin[0], r.org_y = ray.origin[1], r.org_z = ray.origin[2];
        r.dir_x = ray.direction[0], r.dir_y = ray.direction[1], r.dir_z = ray.direction[2];
        r.tnear = q.t_min;
        r.tfar = q.t_best;
        r.mask = ~0u;
        return r;
    }

    RTCDevice device_;
    RTCScene scene_;
    IdTable ids_;
};

std::unique_ptr<Primitive> build_embree(const PrimitiveSet& any, const ParameterValues& values) {
    const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&any);
    if (!set)
        throw InputError(
            "embree: only sets of triangles; give other shapes and the top an accelerator");
    const auto robust = values.find("robust");
    return std::make_unique<EmbreeObject>(*set,
                                          robust != values.end() && std::get<bool>(robust->second));
}

}  // namespace

}  // namespace crofton
#endif

namespace crofton {

void register_peers() {
    AcceleratorInfo info;
    info.name = "embree";
    info.summary =
        "Embree's own structure over triangles, of high build quality; a peer to compare with";
    info.source =
        "Wald, Woop, Benthin, Johnson, Ernst 2014, Embree: A Kernel Framework for Efficient CPU "
        "Ray Tracing";
    info.parameters = {{"robust", false, 0, 0, {}, "RTC_SCENE_FLAG_ROBUST"}};
#ifdef CROFTON_EMBREE
    info.build = build_embree;
#endif
    register_peer(std::move(info));
}

}  // namespace crofton
