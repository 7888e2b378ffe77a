#include "framework/primitive.h"

#include <cassert>
#include <unordered_set>

namespace crofton {
namespace {

Hit result(const RayQuery& query, float scale) {
    Hit hit = query.ids();
    if (!query.hit_ids) return hit;
    hit.t = query.t_best * scale;
    hit.u = query.hit_u;
    hit.v = query.hit_v;
    return hit;
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

Hit Primitive::intersect(const Ray& ray) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitudes_.maxCoeff(), query, local, scale)) return {};
    closest_local(local, query);
    return result(query, scale);
}

bool Primitive::occluded(const Ray& ray) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitudes_.maxCoeff(), query, local, scale)) return false;
    return any_local(local, query);
}

void Primitive::intersect(std::span<const Ray> rays, std::span<Hit> hits) const {
    assert(rays.size() == hits.size());
    for (size_t i = 0; i < rays.size(); ++i) hits[i] = intersect(rays[i]);
}

void Primitive::occluded(std::span<const Ray> rays, std::span<uint8_t> results) const {
    assert(rays.size() == results.size());
    for (size_t i = 0; i < rays.size(); ++i) results[i] = occluded(rays[i]);
}

Hit Primitive::intersect(const Ray& ray, Counters& counters) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitudes_.maxCoeff(), query, local, scale)) return {};
    closest_local(local, query, counters);
    return result(query, scale);
}

bool Primitive::occluded(const Ray& ray, Counters& counters) const {
    RayQuery query;
    LocalRay local;
    float scale;
    if (!prepare(ray, magnitudes_.maxCoeff(), query, local, scale)) return false;
    return any_local(local, query, counters);
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
