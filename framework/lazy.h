#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>

#include "framework/primitive.h"
#include "framework/primitive_sets.h"

namespace crofton {

/// Parameters that every accelerator has beside its own.
struct LazyOptions {
    bool lazy = false;
    int lazy_size = 1024;

    template <class V>
    void fields(V& v) {
        v.boolean("lazy", lazy, "build parts when the first ray needs them, and never otherwise");
        v.integer("lazy_size", lazy_size, 16, 1 << 24,
                  "shapes in a part that is built whole, for lazy");
    }
};

/// Builds a structure over any set.
using LazyBuild = std::function<std::unique_ptr<Primitive>(const PrimitiveSet&)>;

/// A structure that the first ray that meets its bounds builds; rays that come meanwhile wait.
/// Statistics, boxes and objects inside are those of what is built so far.
class LazyObject final : public Primitive {
  public:
    /// @param bounds  of all shapes inside
    /// @param shapes  their number
    /// @param cost    nominal ns of a ray, until the structure is there to ask
    /// @param bytes   of what is kept to build from
    LazyObject(const Bounds3& bounds, uint64_t shapes, double cost, uint64_t bytes,
               std::function<std::unique_ptr<Primitive>()> build)
        : shapes_(shapes), cost_(cost), bytes_(bytes), build_(std::move(build)) {
        set_bounds(bounds);
    }
    void closest_local(const LocalRay& ray, RayQuery& query) const override {
        object().closest_local(ray, query);
    }
    bool any_local(const LocalRay& ray, RayQuery& query) const override {
        return object().any_local(ray, query);
    }
    void closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        object().closest_local(ray, query, counters);
    }
    bool any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        return object().any_local(ray, query, counters);
    }
    /// What is built may trace them one by one.
    bool takes_packets() const override { return true; }
    void closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override;
    void any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override;
    bool takes_crowds() const override { return true; }
    void closest_crowd(RayCrowd& crowd) const override;
    void any_crowd(RayCrowd& crowd) const override;
    double expected_cost() const override;
    StructureStatistics statistics() const override;
    std::string type_name() const override { return "lazy"; }
    void walk(const BoxVisitor& visit) const override;
    void children(const std::function<void(const Primitive&)>& visit) const override;
    void archive(StructureWriter& out) const override;
    const Primitive& resolved() const override { return object().resolved(); }

    /// The structure, or null as long as no ray has needed it.
    const Primitive* built() const { return built_.load(std::memory_order_acquire); }

  private:
    const Primitive& object() const {
        const Primitive* p = built();
        return p ? *p : build_now();
    }
    const Primitive& build_now() const;

    uint64_t shapes_;
    double cost_;
    uint64_t bytes_;
    mutable std::mutex mutex_;
    mutable std::function<std::unique_ptr<Primitive>()> build_;  ///< empty once it has run
    mutable std::unique_ptr<Primitive> owner_;
    mutable std::atomic<const Primitive*> built_{nullptr};
};

/// A structure over `set` of which nothing is built yet but its bounds, O(N). The first ray makes
/// the upper part: the same structure over at most sixteen parts of neighbouring shapes, each lazy
/// in turn, until a part has no more than `whole_size` shapes (after Hunt, Mark, Fussell 2007:
/// "Fast and lazy build of acceleration structures from scene hierarchies"). Hits have the same
/// bits as without.
std::unique_ptr<Primitive> build_lazily(const PrimitiveSet& set, const LazyBuild& build,
                                        int whole_size);

}  // namespace crofton
