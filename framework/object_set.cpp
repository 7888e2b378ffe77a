#include "framework/object_set.h"

#include "framework/cost.h"

namespace crofton {

ObjectSet::ObjectSet(std::vector<Object> objects, ShapeGroups groups)
    : objects_(std::move(objects)), groups_(std::move(groups)) {
    entries_.reserve(objects_.size());
    for (const Object& object : objects_)
        entries_.push_back({object.primitive->bounds(), object.instance, object.primitive.get()});
}

ObjectSet ObjectSet::subset(std::span<const uint32_t> objects) const {
    std::vector<Object> part;
    part.reserve(objects.size());
    for (uint32_t i : objects) part.push_back(objects_[i]);
    return ObjectSet(std::move(part), groups_of_part(groups_, objects));
}

double ObjectSet::cost(uint32_t i) const {
    return cost_constants.object + entries_[i].primitive->expected_cost();
}

}  // namespace crofton
