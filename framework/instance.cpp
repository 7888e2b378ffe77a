#include "framework/instance.h"

#include <cassert>

#include "framework/archive.h"
#include "framework/cost.h"

namespace crofton {

Instance::Instance(std::shared_ptr<const Primitive> object, const Transform& parent_from_object)
    : object_(std::move(object)),
      parent_from_object_(parent_from_object),
      object_from_parent_(inverse(parent_from_object).value()),
      parent_from_object_f_(rounded(parent_from_object)) {
    set_bounds(transformed(parent_from_object_f_, object_->bounds()));
}

bool Instance::is_valid(const Transform& parent_from_object) {
    return inverse(parent_from_object).has_value();
}

bool Instance::enter(const LocalRay& outer, const RayQuery& query, InstanceFrame& frame,
                     LocalRay& inner) const {
    if (outer.frame) {
        frame.world_from_object = outer.frame->world_from_object * parent_from_object_;
        frame.object_from_world = object_from_parent_ * outer.frame->object_from_world;
        frame.world_from_object_f = rounded(frame.world_from_object);
    } else {
        frame.world_from_object = parent_from_object_;
        frame.object_from_world = object_from_parent_;
        frame.world_from_object_f = parent_from_object_f_;
    }
    const Vec3d o(query.origin[0], query.origin[1], query.origin[2]);
    const Vec3d d(query.direction[0], query.direction[1], query.direction[2]);
    frame.origin = frame.object_from_world.point(o);
    frame.direction = frame.object_from_world.vector(d);

    // Thickness: the leaf test sees fl(M·v) - o in the world, wrong by at most
    // 4u·(|M|·|v| + |m| + |o|) per axis and by the test's own 8u of the distance; |M⁻¹| brings that
    // to object space. 32u covers both, and the rounding of origin and direction to float.
    const Vec3d magnitude = object_->magnitudes().cast<double>();
    const Vec3d reach = frame.world_from_object.linear.cwiseAbs() * magnitude +
                        frame.world_from_object.translation.cwiseAbs() + o.cwiseAbs();
    const Vec3d pad = 0x1p-19 * (frame.object_from_world.linear.cwiseAbs() * reach);
    float largest = 0;
    inner.origin[3] = inner.pad[3] = 0;
    inner.direction[3] = 1;
    for (int a = 0; a < 3; ++a) {
        inner.origin[a] = float(frame.origin[a]);
        inner.direction[a] = float(frame.direction[a]);
        inner.pad[a] = float(pad[a]);
        largest = std::max(largest, float(magnitude[a]));
    }
    inner.frame = &frame;
    finish(inner, query, largest);
    return frame.direction.allFinite() && !frame.direction.isZero(0);
}

void Instance::closest_local(const LocalRay& ray, RayQuery& query) const {
    InstanceFrame frame;
    LocalRay inner;
    if (enter(ray, query, frame, inner)) object_->closest_local(inner, query);
}

bool Instance::any_local(const LocalRay& ray, RayQuery& query) const {
    InstanceFrame frame;
    LocalRay inner;
    return enter(ray, query, frame, inner) && object_->any_local(inner, query);
}

void Instance::closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const {
    InstanceFrame frame;
    LocalRay inner;
    if (enter(ray, query, frame, inner)) object_->closest_local(inner, query, counters);
}

bool Instance::any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const {
    InstanceFrame frame;
    LocalRay inner;
    return enter(ray, query, frame, inner) && object_->any_local(inner, query, counters);
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
        parts.push_back(
            {std::make_shared<const Instance>(part.primitive, parent_from_object_), part.instance});
    return parts;
}

void Instance::children(const std::function<void(const Primitive&)>& visit) const {
    visit(*object_);
}

void Instance::archive(StructureWriter& out) const {
    out.object(*object_);
    out(parent_from_object_);
}

std::shared_ptr<const Primitive> Instance::load(StructureReader& in) {
    auto object = in.object();
    Transform parent_from_object;
    in(parent_from_object);
    if (!is_valid(parent_from_object)) in.refuse("places an object by a map without an inverse");
    return std::make_shared<const Instance>(std::move(object), parent_from_object);
}

}  // namespace crofton
