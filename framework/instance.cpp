#include "framework/instance.h"

#include <hwy/base.h>

#include <algorithm>
#include <bit>
#include <iterator>
#include <optional>

#include "framework/archive.h"
#include "framework/cost.h"
#include "framework/ray_crowd.h"
#include "framework/ray_packet.h"

namespace crofton {
namespace {

/// Whether a box becomes a box, exactly as large as it has to be.
bool keeps_axes(const FloatTransform& f) {
    return std::all_of(std::begin(f.m), std::end(f.m),
                       [](const float(&row)[4]) { return std::count(row, row + 3, 0.0f) >= 2; });
}

}  // namespace

Instance::Instance(std::shared_ptr<const Primitive> object, const Transform& parent_from_object)
    : object_(std::move(object)),
      frame_(parent_from_object, inverse(parent_from_object).value(), object_->magnitudes()) {
    Bounds3 box = transformed(frame_.world_from_object_f, object_->bounds());
    if (!keeps_axes(frame_.world_from_object_f)) {
        // A box of turned boxes is smaller than that of the one turned box that holds them.
        Bounds3 parts;
        for (const Bounds3& part : Instance::cover()) parts.extend(part);
        box = intersection(box, parts);
    }
    set_bounds(box);
}

std::vector<Bounds3> Instance::cover() const {
    std::vector<Bounds3> boxes = object_->cover();
    for (Bounds3& box : boxes) box = transformed(frame_.world_from_object_f, box);
    return boxes;
}

bool Instance::is_valid(const Transform& parent_from_object) {
    return inverse(parent_from_object).has_value();
}

template <class Trace>
bool Instance::inside(const LocalRay& outer, const RayQuery& query, const Trace& trace) const {
    LocalRay inner;
    if (HWY_LIKELY(!outer.frame)) return enter(frame_, query, inner) && trace(inner);
    const InstanceFrame frame = frame_in(*outer.frame);
    return enter(frame, query, inner) && trace(inner);
}

template <Query Q>
void Instance::inside(RayPacket& packet, LocalPacket& outer, uint32_t rays) const {
    std::optional<InstanceFrame> composed;
    if (outer.frame) composed = frame_in(*outer.frame);
    LocalPacket inner;
    const uint32_t images = inner.enter(composed ? *composed : frame_, packet, rays);
    for (uint32_t left = images; left;) {
        const uint32_t together = inner.one_way(left);
        packet.enter<Q>(*object_, inner, together);
        left &= ~together;
    }
    for (uint32_t left = rays & ~images; left; left &= left - 1)
        packet.alone(uint32_t(std::countr_zero(left)), outer,
                     [&](const LocalRay& ray, RayQuery& query) {
                         if constexpr (Q == Query::any) return Instance::any_local(ray, query);
                         Instance::closest_local(ray, query);
                         return false;
                     });
}

template <class Trace>
void Instance::inside(RayCrowd& outer, const Trace& trace) const {
    // The rays of a crowd are in one space, so the maps are composed once for all of them.
    std::optional<InstanceFrame> composed;
    if (outer.local[0]->frame) composed = frame_in(*outer.local[0]->frame);
    const InstanceFrame& frame = composed ? *composed : frame_;
    RayCrowd inner;
    inner.depth = outer.depth;
    LocalRay rays[RayCrowd::most];
    uint32_t place[RayCrowd::most];  // in the outer crowd
    for (uint32_t i = 0; i < outer.size; ++i) {
        LocalRay& ray = rays[inner.size];
        if (!enter(frame, *outer.query[i], ray)) continue;
        place[inner.size] = i;
        inner.add(ray, *outer.query[i]);
    }
    if (inner.size == 0) return;
    trace(inner);
    for (uint64_t left = inner.found; left; left &= left - 1)
        outer.found |= uint64_t(1) << place[std::countr_zero(left)];
}

InstanceFrame Instance::frame_in(const InstanceFrame& outer) const {
    return {outer.world_from_object * frame_.world_from_object,
            frame_.object_from_world * outer.object_from_world, object_->magnitudes()};
}

void Instance::closest_local(const LocalRay& ray, RayQuery& query) const {
    inside(ray, query, [&](const LocalRay& inner) {
        object_->closest_local(inner, query);
        return true;
    });
}

bool Instance::any_local(const LocalRay& ray, RayQuery& query) const {
    return inside(ray, query,
                  [&](const LocalRay& inner) { return object_->any_local(inner, query); });
}

void Instance::closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const {
    inside<Query::closest>(packet, space, rays);
}

void Instance::any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const {
    inside<Query::any>(packet, space, rays);
}

void Instance::closest_crowd(RayCrowd& crowd) const {
    inside(crowd, [&](RayCrowd& inner) { object_->closest_crowd(inner); });
}

void Instance::any_crowd(RayCrowd& crowd) const {
    inside(crowd, [&](RayCrowd& inner) { object_->any_crowd(inner); });
}

void Instance::closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const {
    inside(ray, query, [&](const LocalRay& inner) {
        object_->closest_local(inner, query, counters);
        return true;
    });
}

bool Instance::any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const {
    return inside(ray, query, [&](const LocalRay& inner) {
        return object_->any_local(inner, query, counters);
    });
}

double Instance::expected_cost() const {
    return cost_constants.instance + object_->expected_cost();
}

StructureStatistics Instance::statistics() const {
    StructureStatistics s;
    s.bytes = sizeof(Instance);
    return s;
}

void Instance::walk(const BoxVisitor& visit) const { visit(bounds(), 0, true, 1); }

std::vector<PlacedPrimitive> Instance::open(const std::shared_ptr<const Primitive>&,
                                            PartCache& cache) const {
    // Instances are not merged with those inside: products of maps would be rounded differently.
    std::vector<PlacedPrimitive> parts;
    for (const PlacedPrimitive& part : cache.parts(object_))
        parts.push_back({std::make_shared<const Instance>(part.primitive, parent_from_object()),
                         part.instance});
    return parts;
}

void Instance::children(const std::function<void(const Primitive&)>& visit) const {
    visit(*object_);
}

void Instance::archive(StructureWriter& out) const {
    out.object(*object_);
    out(parent_from_object());
}

std::shared_ptr<const Primitive> Instance::load(StructureReader& in) {
    auto object = in.object();
    Transform parent_from_object;
    in(parent_from_object);
    if (!is_valid(parent_from_object)) in.refuse("places an object by a map without an inverse");
    return std::make_shared<const Instance>(std::move(object), parent_from_object);
}

}  // namespace crofton
