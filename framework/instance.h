#pragma once

#include "framework/primitive.h"

namespace crofton {

class StructureReader;

/// Another primitive under an affine map. t keeps its meaning: directions are not renormalised.
///
/// A ray is always moved from the world with the composed map, never through a chain of rounded
/// rays, and triangles are tested in world space against vertices mapped by `apply`: a hit has the
/// same bits whether a mesh is instanced at any depth or its transform is baked into the vertices.
/// Object space serves to skip: the local ray is thick by the error of the map.
class Instance final : public Primitive {
  public:
    static constexpr const char* registry_name = "instance";
    /// @param parent_from_object  must have a finite inverse, see `is_valid`
    Instance(std::shared_ptr<const Primitive> object, const Transform& parent_from_object);

    /// Whether a map can place an instance: finite, and so is its inverse, in float too.
    static bool is_valid(const Transform& parent_from_object);

    const Primitive& object() const { return *object_; }
    const Transform& parent_from_object() const { return frame_.world_from_object; }

    void closest_local(const LocalRay& ray, RayQuery& query) const override;
    bool any_local(const LocalRay& ray, RayQuery& query) const override;
    void closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override;
    bool any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override;
    bool takes_packets() const override { return object_->takes_packets(); }
    void closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override;
    void any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override;
    bool takes_crowds() const override { return object_->takes_crowds(); }
    void closest_crowd(RayCrowd& crowd) const override;
    void any_crowd(RayCrowd& crowd) const override;
    double expected_cost() const override;
    StructureStatistics statistics() const override;
    std::string type_name() const override { return registry_name; }
    void walk(const BoxVisitor& visit) const override;
    std::vector<Bounds3> cover() const override;
    void children(const std::function<void(const Primitive&)>& visit) const override;
    void archive(StructureWriter& out) const override;
    static std::shared_ptr<const Primitive> load(StructureReader& in);
    std::vector<PlacedPrimitive> open(const std::shared_ptr<const Primitive>& self,
                                      PartCache& cache) const override;

  private:
    /// trace(inner), unless the ray has no image in the object's space.
    template <class Trace>
    bool inside(const LocalRay& outer, const RayQuery& query, const Trace& trace) const;
    /// Traces rays of a packet, those together that go one way in the object's space.
    template <Query Q>
    void inside(RayPacket& packet, LocalPacket& outer, uint32_t rays) const;
    /// trace(inner) with those of a crowd that have an image in the object's space.
    template <class Trace>
    void inside(RayCrowd& outer, const Trace& trace) const;
    /// Where the object stands, for a ray in an instance of its own.
    InstanceFrame frame_in(const InstanceFrame& outer) const;

    std::shared_ptr<const Primitive> object_;
    InstanceFrame frame_;  ///< where the parent is the world
};

}  // namespace crofton
