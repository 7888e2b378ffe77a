#include "experiments/peers.h"

#ifdef CROFTON_EMBREE
#include CROFTON_EMBREE

#include <algorithm>
#include <atomic>

#include "experiments/peer_object.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/ray_packet.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

/// What Embree has allocated, in bytes.
std::atomic<int64_t> embree_bytes = 0;

/// One device for all structures: instances of one scene in another ask for that.
RTCDevice device() {
    static const RTCDevice device = [] {
        const RTCDevice d = rtcNewDevice("threads=0");
        const auto count = [](void*, ssize_t bytes, bool) {
            embree_bytes += bytes;
            return true;
        };
        rtcSetDeviceMemoryMonitorFunction(d, count, nullptr);
        return d;
    }();
    return device;
}

struct EmbreeOptions {
    RTCBuildQuality quality = RTC_BUILD_QUALITY_HIGH;
    RTCSceneFlags flags = RTC_SCENE_FLAG_NONE;
};

/// Embree's structure over triangles, or over other structures of Embree and instances of them. It
/// answers with its own t, u, v and whichever of several triangles at one t it meets first; the
/// mode of a query means nothing to it.
class EmbreeObject final : public PeerObject {
  public:
    EmbreeObject(std::shared_ptr<const TriangleSet> set, const EmbreeOptions& options)
        : PeerObject("embree", *set), triangles_(std::move(set)) {
        build(options, [&] { add_triangles(); });
    }
    EmbreeObject(std::shared_ptr<const ObjectSet> set, const EmbreeOptions& options)
        : PeerObject("embree", *set), objects_(std::move(set)) {
        build(options, [&] {
            for (uint32_t i = 0; i < objects_->size(); ++i) add_instance(objects_->object(i));
        });
    }
    ~EmbreeObject() override { rtcReleaseScene(scene_); }

    using PeerObject::any_local;
    using PeerObject::closest_local;

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
        if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return;
        const uint32_t outer = q.instance;
        const RayPacket::Owner hit = owner(r.hit.instID[0], outer);
        q.instance = hit.instance;
        q.record(r.ray.tfar, r.hit.u, r.hit.v, *hit.ids, r.hit.primID);
        q.instance = outer;
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
    /// Sixteen neighbours that go together are one call, with the hint that they do.
    bool takes_packets() const override { return true; }
    void closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        if (space.frame)
            return each_alone(packet, space, rays, [&](auto& ray, auto& query) {
                EmbreeObject::closest_local(ray, query);
                return false;
            });
        RTCRayHit16 r;
        alignas(64) int valid[16];
        fill(packet, rays, r.ray, valid);
        std::fill_n(r.hit.geomID, 16, RTC_INVALID_GEOMETRY_ID);
#if RTC_VERSION_MAJOR >= 4
        RTCIntersectArguments arguments;
        rtcInitIntersectArguments(&arguments);
        arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
        rtcIntersect16(valid, scene_, &r, &arguments);
#else
        RTCIntersectContext context = coherent();
        rtcIntersect16(valid, scene_, &context, &r);
#endif
        for (uint32_t i = 0; i < 16; ++i) {
            if (!(rays >> i & 1) || r.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
            packet.t_best[i] = r.ray.tfar[i];
            packet.u[i] = r.hit.u[i];
            packet.v[i] = r.hit.v[i];
            packet.shape[i] = r.hit.primID[i];
            packet.hit_in_row |= 1u << i;
            packet.fresh &= ~(1u << i);
            packet.owner[i] = owner(r.hit.instID[0][i], packet.instance);
        }
    }
    void any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        if (space.frame)
            return each_alone(packet, space, rays, [&](auto& ray, auto& query) {
                return EmbreeObject::any_local(ray, query);
            });
        RTCRay16 r;
        alignas(64) int valid[16];
        fill(packet, rays, r, valid);
#if RTC_VERSION_MAJOR >= 4
        RTCOccludedArguments arguments;
        rtcInitOccludedArguments(&arguments);
        arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
        rtcOccluded16(valid, scene_, &r, &arguments);
#else
        RTCIntersectContext context = coherent();
        rtcOccluded16(valid, scene_, &context, &r);
#endif
        for (uint32_t i = 0; i < 16; ++i)
            if (rays >> i & 1 && r.tfar[i] < 0) {
                packet.found |= 1u << i;
                packet.t_cull[i] = -std::numeric_limits<float>::infinity();
            }
    }
    void children(const std::function<void(const Primitive&)>& visit) const override {
        for (uint32_t i = 0; objects_ && i < objects_->size(); ++i) visit(objects_->object(i));
    }

  private:
    uint64_t bytes() const override { return bytes_; }
    /// @param object  that was hit, if this is over objects
    RayPacket::Owner owner(uint32_t object, uint32_t instance) const {
        if (triangles_) return {&triangles_->ids(), instance};
        return {inside_[object], instance + objects_->entry(object).instance};
    }
    template <class Trace>
    static void each_alone(RayPacket& packet, LocalPacket& space, uint32_t rays,
                           const Trace& trace) {
        for (uint32_t i = 0; i < 16; ++i)
            if (rays >> i & 1) packet.alone(i, space, trace);
    }
    template <class Add>
    void build(const EmbreeOptions& options, const Add& add) {
        const int64_t before = embree_bytes;
        scene_ = rtcNewScene(device());
        rtcSetSceneFlags(scene_, options.flags);
        rtcSetSceneBuildQuality(scene_, options.quality);
        quality_ = options.quality;
        add();
        rtcCommitScene(scene_);
        bytes_ = uint64_t(std::max<int64_t>(0, embree_bytes - before));
    }
    void attach(RTCGeometry geometry) {
        // Embree sorts by Morton codes only if the geometry asks for it, too.
        if (quality_ == RTC_BUILD_QUALITY_LOW) rtcSetGeometryBuildQuality(geometry, quality_);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene_, geometry);
        rtcReleaseGeometry(geometry);
    }
    /// Vertices and indices stay where they are.
    void add_triangles() {
        const TriangleSet& set = *triangles_;
        RTCGeometry geometry = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                   set.coordinates(), 0, sizeof(Vec3f), set.vertices());
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                   set.triangles(), 0, sizeof(TriangleSet::Indices), set.size());
        attach(geometry);
    }
    void add_instance(const Primitive& object) {
        const auto* instance = dynamic_cast<const Instance*>(&object);
        const auto* inside =
            dynamic_cast<const EmbreeObject*>(instance ? &instance->object() : &object);
        if (!inside || !inside->triangles_)
            throw InputError(
                "embree: over objects it takes its own structures over triangles, placed by one "
                "map at most");
        RTCGeometry geometry = rtcNewGeometry(device(), RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(geometry, inside->scene_);
        const FloatTransform map = rounded(instance ? instance->parent_from_object() : Transform{});
        rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, map.m);
        attach(geometry);
        inside_.push_back(&inside->triangles_->ids());
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

#if RTC_VERSION_MAJOR < 4
    static RTCIntersectContext coherent() {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        return context;
    }
#endif
    static void fill(const RayPacket& packet, uint32_t rays, RTCRay16& r, int (&valid)[16]) {
        static_assert(RayPacket::most == 16);
        for (uint32_t i = 0; i < 16; ++i) {
            valid[i] = rays >> i & 1 ? -1 : 0;
            r.org_x[i] = packet.origin[0][i], r.org_y[i] = packet.origin[1][i];
            r.org_z[i] = packet.origin[2][i];
            r.dir_x[i] = packet.direction[0][i], r.dir_y[i] = packet.direction[1][i];
            r.dir_z[i] = packet.direction[2][i];
            r.tnear[i] = packet.t_min[i], r.tfar[i] = packet.t_best[i];
            r.time[i] = 0, r.mask[i] = ~0u, r.id[i] = 0, r.flags[i] = 0;
        }
    }

    std::shared_ptr<const TriangleSet> triangles_;  ///< or
    std::shared_ptr<const ObjectSet> objects_;
    std::vector<const IdTable*> inside_;  ///< of each object
    RTCBuildQuality quality_ = RTC_BUILD_QUALITY_HIGH;
    RTCScene scene_ = nullptr;
    uint64_t bytes_ = 0;
};

std::unique_ptr<Primitive> build_embree(const PrimitiveSet& any, const ParameterValues& values) {
    const auto is_set = [&](const char* name) {
        const auto at = values.find(name);
        return at != values.end() && std::get<bool>(at->second);
    };
    EmbreeOptions options;
    if (const auto at = values.find("quality"); at != values.end()) {
        const std::string& quality = std::get<std::string>(at->second);
        options.quality = quality == "low"      ? RTC_BUILD_QUALITY_LOW
                          : quality == "medium" ? RTC_BUILD_QUALITY_MEDIUM
                                                : RTC_BUILD_QUALITY_HIGH;
    }
    if (is_set("robust")) options.flags = RTCSceneFlags(options.flags | RTC_SCENE_FLAG_ROBUST);
    if (is_set("compact")) options.flags = RTCSceneFlags(options.flags | RTC_SCENE_FLAG_COMPACT);
    if (const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&any))
        return std::make_unique<EmbreeObject>(*set, options);
    if (const auto* set = std::get_if<std::shared_ptr<const ObjectSet>>(&any))
        return std::make_unique<EmbreeObject>(*set, options);
    throw InputError("embree: only triangles, and objects made of them");
}

}  // namespace

}  // namespace crofton
#endif

namespace crofton {

AcceleratorInfo embree_peer() {
    AcceleratorInfo info;
    info.name = "embree";
    info.summary =
        "Embree's own structure over triangles or instances of them; a peer to compare with";
    info.source =
        "Wald, Woop, Benthin, Johnson, Ernst 2014, Embree: A Kernel Framework for Efficient CPU "
        "Ray Tracing";
    info.parameters = {
        {"quality", std::string("high"), 0, 0, {"low", "medium", "high"}, "RTC_BUILD_QUALITY"},
        {"robust", false, 0, 0, {}, "RTC_SCENE_FLAG_ROBUST"},
        {"compact", false, 0, 0, {}, "RTC_SCENE_FLAG_COMPACT"}};
#ifdef CROFTON_EMBREE
    info.build = build_embree;
#endif
    return info;
}

}  // namespace crofton
