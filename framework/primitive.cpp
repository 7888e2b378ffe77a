#include "framework/primitive.h"

#include <hwy/base.h>
#include <hwy/cache_control.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <new>
#include <unordered_set>

#include "framework/crowds.h"
#include "framework/exact_nearest.h"
#include "framework/ray_order.h"
#include "framework/ray_packet.h"

namespace crofton {
namespace {

/// What a query in mode exact has more than others: what is known of the hit, and a frame for the
/// world too. Under the identity nothing is rounded.
struct ExactStart {
    exact::NearestHit nearest;

    ExactStart(const Ray& ray, float scale, LocalRay& local, RayQuery& query)
        : nearest(ray, scale) {
        query.mode = Mode::exact;
        query.exact = &nearest;
        static const InstanceFrame world({}, {}, Vec3f::Zero());
        local.frame = &world;
    }
};

/// Calls trace() for a packet's rays that go together, some at a time, as long as there are enough.
/// @return  bits of the others
template <class Trace>
uint32_t take_together(RayPacket& packet, const Trace& trace) {
    constexpr int least = 4;
    uint32_t left = RayPacket::everyone;
    for (uint32_t open = left; std::popcount(open) >= least;) {
        const uint32_t together = packet.companions(open);
        // A ray without enough others is left, but does not keep these from going together.
        open &= ~(together | (open & -open));
        if (std::popcount(together) < least) continue;
        left &= ~together;
        packet.prepare(together);
        trace();
    }
    return left;
}

void add_statistics(const Primitive& p, std::unordered_set<const Primitive*>& seen,
                    StructureStatistics& sum) {
    // Explicit stack: structures may nest as deep as a scene graph does.
    std::vector<const Primitive*> open{&p};
    seen.insert(&p);
    while (!open.empty()) {
        const Primitive* next = open.back();
        open.pop_back();
        sum += next->statistics();
        next->children([&](const Primitive& child) {
            if (seen.insert(&child).second) open.push_back(&child);
        });
    }
}

}  // namespace

bool Primitive::is_large() const {
    uint8_t known = size_known_.load(std::memory_order_relaxed);
    if (known == unknown_size) {
        StructureStatistics sum;
        std::unordered_set<const Primitive*> seen;
        add_statistics(*this, seen, sum);
        known = sum.bytes > RayOrder::large_structure ? large_size : small_size;
        size_known_.store(known, std::memory_order_relaxed);
    }
    return known == large_size;
}

template <class One, class Together>
void Primitive::as_given(std::span<const Ray> rays, Mode mode, const One& one,
                         const Together& together) const {
    size_t i = 0;
    if (mode != Mode::exact && rays.size() >= RayPacket::most && takes_packets()) {
        RayPacket packet(bounds_, magnitude_, mode);
        // Where packets are futile ever fewer are tried.
        constexpr size_t longest_pause = 63;
        // Where nothing goes together for long it is not even looked for every time.
        constexpr size_t patience = 4, longest_look = 7;
        size_t pause = 0, left_out = 0, apart = 0;
        for (; i + RayPacket::most <= rays.size(); i += RayPacket::most) {
            uint32_t left = RayPacket::everyone;
            if (left_out > 0) {
                --left_out;
            } else if (RayPacket::promising(&rays[i])) {
                packet.load(&rays[i]);
                left = take_together(packet, [&] { together(packet, i); });
                const auto taken = uint32_t(std::popcount(~left & RayPacket::everyone));
                pause =
                    packet.was_futile(taken) ? std::min(2 * pause + 1, longest_pause) : pause / 2;
                left_out = pause;
                apart = 0;
            } else if (++apart > patience) {
                left_out = std::min(apart - patience, longest_look);
            }
            for (; left; left &= left - 1) one(i + size_t(std::countr_zero(left)));
        }
    }
    for (; i < rays.size(); ++i) one(i);
}

template <class One, class Together>
void Primitive::in_good_order(std::span<const Ray> rays, Mode mode, const One& one,
                              const Together& together) const {
    if (rays.size() < RayOrder::least_batch || bounds_.empty() || !is_large() ||
        !RayOrder::are_scattered(rays, bounds_))
        return as_given(rays, mode, one, together);
    thread_local RayOrder order;
    for (size_t begin = 0; begin < rays.size(); begin += RayOrder::most_batch) {
        const auto batch = rays.subspan(begin, std::min(RayOrder::most_batch, rays.size() - begin));
        std::span<const uint32_t> sorted;
        try {
            sorted = order.sort(batch, bounds_);
        } catch (const std::bad_alloc&) {
            for (size_t i = 0; i < batch.size(); ++i) one(begin + i);
            continue;
        }
        constexpr size_t ahead = 8;
        for (size_t i = 0; i < sorted.size(); ++i) {
            if (i + ahead < sorted.size()) hwy::Prefetch(&batch[sorted[i + ahead]]);
            one(begin + sorted[i]);
        }
    }
}

template <class One, class Local, class Together, class Trace, class Keep>
void Primitive::stream(std::span<const Ray> rays, Mode mode, const One& one, const Local& local,
                       const Together& together, const Trace& trace, const Keep& keep) const {
    // In mode fast a hit may depend on the order of visits, which is another one in crowds.
    const bool any_order = mode == Mode::robust || mode == Mode::double_precision;
    if (!any_order || rays.size() < RayCrowd::most || !takes_crowds())
        return in_good_order(rays, mode, one, together);
    // What this thread has found when it last asked the same, if it was of this structure: short
    // spans would be over before anything is known.
    thread_local const Primitive* asked = nullptr;
    thread_local FasterWay way;
    if (asked != this) way = {};
    asked = this;
    Crowds crowds(rays, magnitude_, mode, one, local, trace, keep, way);
    in_good_order(
        rays, mode, [&](size_t i) { crowds.add(i); }, together);
    crowds.finish();
}

Hit Primitive::intersect(const Ray& ray, Mode mode) const {
    if (HWY_UNLIKELY(mode == Mode::exact)) return closest_exactly(ray, nullptr);
    return closest(ray, mode);
}

bool Primitive::occluded(const Ray& ray, Mode mode) const {
    if (HWY_UNLIKELY(mode == Mode::exact)) return any_exactly(ray, nullptr);
    return any(ray, mode);
}

Hit Primitive::closest(const Ray& ray, Mode mode) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return {};
    query.mode = mode;
    closest_local(local, query);
    return query.hit(scale);
}

bool Primitive::any(const Ray& ray, Mode mode) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return false;
    query.mode = mode;
    return any_local(local, query);
}

void Primitive::intersect(std::span<const Ray> rays, std::span<Hit> hits, Mode mode) const {
    assert(rays.size() == hits.size());
    stream(
        rays, mode, [&](size_t i) { hits[i] = intersect(rays[i], mode); },
        [&](const LocalRay& ray, RayQuery& query) {
            closest_local(ray, query);
            return true;
        },
        [&](RayPacket& packet, size_t first) {
            closest_packet(packet, packet.world, packet.rays);
            for (uint32_t left = packet.rays; left; left &= left - 1) {
                const auto r = uint32_t(std::countr_zero(left));
                hits[first + r] = packet.hit(r);
            }
        },
        [&](RayCrowd& crowd) { closest_crowd(crowd); },
        [&](size_t i, const RayQuery& query, float scale, bool) { hits[i] = query.hit(scale); });
}

void Primitive::occluded(std::span<const Ray> rays, std::span<uint8_t> results, Mode mode) const {
    assert(rays.size() == results.size());
    stream(
        rays, mode, [&](size_t i) { results[i] = occluded(rays[i], mode); },
        [&](const LocalRay& ray, RayQuery& query) { return any_local(ray, query); },
        [&](RayPacket& packet, size_t first) {
            any_packet(packet, packet.world, packet.rays);
            for (uint32_t left = packet.rays; left; left &= left - 1) {
                const auto r = uint32_t(std::countr_zero(left));
                results[first + r] = packet.found >> r & 1;
            }
        },
        [&](RayCrowd& crowd) { any_crowd(crowd); },
        [&](size_t i, const RayQuery&, float, bool found) { results[i] = found; });
}

Hit Primitive::intersect(const Ray& ray, Counters& counters, Mode mode) const {
    if (HWY_UNLIKELY(mode == Mode::exact)) return closest_exactly(ray, &counters);
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return {};
    query.mode = mode;
    closest_local(local, query, counters);
    return query.hit(scale);
}

bool Primitive::occluded(const Ray& ray, Counters& counters, Mode mode) const {
    if (HWY_UNLIKELY(mode == Mode::exact)) return any_exactly(ray, &counters);
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return false;
    query.mode = mode;
    return any_local(local, query, counters);
}

Hit Primitive::closest_exactly(const Ray& ray, Counters* counters) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return {};
    const ExactStart start(ray, scale, local, query);
    counters ? closest_local(local, query, *counters) : closest_local(local, query);
    Hit hit = query.hit(scale);
    if (hit.is_hit() && start.nearest.decided(query)) hit.t = start.nearest.t();
    return hit;
}

bool Primitive::any_exactly(const Ray& ray, Counters* counters) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitude_, query, local, scale)) return false;
    const ExactStart start(ray, scale, local, query);
    return counters ? any_local(local, query, *counters) : any_local(local, query);
}

const std::vector<PlacedPrimitive>& PartCache::parts(
    const std::shared_ptr<const Primitive>& primitive) {
    if (const auto it = opened_.find(primitive.get()); it != opened_.end()) return it->second.parts;
    // Opening an instance opens its object, in this cache too: insert only afterwards.
    std::vector<PlacedPrimitive> parts = primitive->open(primitive, *this);
    return opened_.emplace(primitive.get(), Opened{primitive, std::move(parts)})
        .first->second.parts;
}

StructureStatistics total_statistics(const Primitive& root) {
    StructureStatistics sum;
    std::unordered_set<const Primitive*> seen;
    add_statistics(root, seen, sum);
    return sum;
}

}  // namespace crofton
