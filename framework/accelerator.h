// The adapter from a traversal kernel to a Primitive; included once per target, after simd.h.
#if defined(CROFTON_FRAMEWORK_ACCELERATOR_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_ACCELERATOR_H_
#undef CROFTON_FRAMEWORK_ACCELERATOR_H_
#else
#define CROFTON_FRAMEWORK_ACCELERATOR_H_
#endif

#include "framework/archive.h"
#include "framework/parameters.h"
#include "framework/parts.h"
#include "framework/primitive.h"
#include "framework/ray_packet.h"
#include "framework/ray_setup.h"
#include "framework/registry.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// A structure over a set, as one Primitive. `Structure` is plain data with
///   bounds(), statistics(), walk(visitor), expected_cost(set), `reads_set`, `name`;
/// `Traversal` has
///   template <Query, class Set, class Counters>
///   static bool run(structure, set, ray, query, counters)   // true: an `any` query is answered
/// and, if it traces RayPackets, takes_packets(structure) and run_packet<Query>(structure, set,
/// packet, space, rays), and, if it traces RayCrowds, run_crowd<Query>(structure, set, crowd). All
/// of them take a TraversalStart more if the structure Opens.
/// Each override holds its own specialised copy of that traversal, so that over triangles a ray
/// makes no indirect call below the virtual one. Counting is never timed and counts the same on
/// every target, so counted traversals exist for the baseline only (`run_counted`).
template <class Structure, class Traversal, class Set>
class AcceleratedPart;

template <class Structure, class Traversal, class Set>
class AcceleratedObject final : public Primitive {
  public:
    AcceleratedObject(std::shared_ptr<const Set> set, Structure structure)
        : structure_(std::move(structure)) {
        set_bounds(structure_.bounds());
        expected_cost_ = structure_.expected_cost(*set);
        if constexpr (Structure::reads_set)
            set_ = std::move(set);
        else
            set_ = std::make_shared<const Set>(set->ids_only());
    }
    Hit closest(const Ray& ray, Mode mode) const override {
        RayQuery query;
        LocalRay local;
        float scale;
        if (!ray_setup::prepare(ray, magnitude(), query, local, scale)) return {};
        query.mode = mode;
        AcceleratedObject::closest_local(local, query);
        return query.hit(scale);
    }
    bool any(const Ray& ray, Mode mode) const override {
        RayQuery query;
        LocalRay local;
        float scale;
        if (!ray_setup::prepare(ray, magnitude(), query, local, scale)) return false;
        query.mode = mode;
        return AcceleratedObject::any_local(local, query);
    }
    void closest_local(const LocalRay& ray, RayQuery& query) const override {
        NoCounters none;
        Traversal::template run<Query::closest>(structure_, *set_, ray, query, none);
    }
    bool any_local(const LocalRay& ray, RayQuery& query) const override {
        NoCounters none;
        return Traversal::template run<Query::any>(structure_, *set_, ray, query, none);
    }
    bool takes_packets() const override {
        if constexpr (has_packets)
            return Traversal::takes_packets(structure_);
        else
            return false;
    }
    void closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        trace_packet<Query::closest>(packet, space, rays);
    }
    void any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        trace_packet<Query::any>(packet, space, rays);
    }
    bool takes_crowds() const override { return has_crowds; }
    void closest_crowd(RayCrowd& crowd) const override { trace_crowd<Query::closest>(crowd); }
    void any_crowd(RayCrowd& crowd) const override { trace_crowd<Query::any>(crowd); }
    void closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        run_counted(Query::closest, structure_, *set_, ray, query, counters);
    }
    bool any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        return run_counted(Query::any, structure_, *set_, ray, query, counters);
    }
    double expected_cost() const override { return expected_cost_; }
    StructureStatistics statistics() const override {
        StructureStatistics s = structure_.statistics();
        s.bytes += set_->bytes();
        return s;
    }
    std::string type_name() const override { return Structure::name; }
    void walk(const BoxVisitor& visit) const override { structure_.walk(visit); }
    void children(const std::function<void(const Primitive&)>& visit) const override {
        if constexpr (std::is_same_v<Set, ObjectSet>)
            for (uint32_t i = 0; i < set_->size(); ++i) visit(set_->object(i));
    }
    void archive(StructureWriter& out) const override {
        out.set(set_);
        out(structure_);
    }
    /// Subtrees where the structure has them; else, over objects, the objects themselves.
    std::vector<PlacedPrimitive> open(const std::shared_ptr<const Primitive>& self,
                                      PartCache&) const override {
        if constexpr (Opens<Structure, Set>)
            return open_from(std::static_pointer_cast<const AcceleratedObject>(self), {});
        else if constexpr (std::is_same_v<Set, ObjectSet>)
            return set_->objects();
        else
            return {};
    }

    std::vector<Bounds3> cover() const override {
        if constexpr (Opens<Structure, Set>) {
            std::vector<Bounds3> boxes;
            structure_.visit_children(
                {}, [&](const Bounds3& box, TraversalStart) { boxes.push_back(box); });
            return boxes;
        } else {
            return Primitive::cover();
        }
    }
    std::shared_ptr<const Primitive> part(const std::shared_ptr<const Primitive>& self,
                                          const Bounds3& box,
                                          const TraversalStart& start) const override {
        if constexpr (Opens<Structure, Set>)
            return std::make_shared<const Part>(
                std::static_pointer_cast<const AcceleratedObject>(self), box, start);
        else
            return nullptr;
    }

  private:
    static constexpr bool has_packets = requires(const Structure& s) {
        Traversal::takes_packets(s);
    };
    static constexpr bool has_crowds =
        requires(const Structure& structure, const Set& set, RayCrowd& crowd) {
        Traversal::template run_crowd<Query::any>(structure, set, crowd);
    };
    friend class AcceleratedPart<Structure, Traversal, Set>;
    using Part = AcceleratedPart<Structure, Traversal, Set>;

    /// @param start  nothing, or a TraversalStart
    template <Query Q, class... Start>
    void trace_packet([[maybe_unused]] RayPacket& packet, [[maybe_unused]] LocalPacket& space,
                      [[maybe_unused]] uint32_t rays, Start... start) const {
        if constexpr (has_packets)
            Traversal::template run_packet<Q>(structure_, *set_, packet, space, rays, start...);
    }
    template <Query Q, class... Start>
    void trace_crowd([[maybe_unused]] RayCrowd& crowd, Start... start) const {
        if constexpr (has_crowds)
            Traversal::template run_crowd<Q>(structure_, *set_, crowd, start...);
    }

    std::vector<PlacedPrimitive> open_from(const std::shared_ptr<const AcceleratedObject>& self,
                                           TraversalStart start) const {
        std::vector<PlacedPrimitive> parts;
        structure_.visit_children(start, [&](const Bounds3& box, TraversalStart child) {
            if constexpr (std::is_same_v<Set, ObjectSet>)
                if (Structure::is_leaf(child)) {
                    for (const uint32_t i : structure_.references(child))
                        parts.push_back(set_->objects()[i]);
                    return;
                }
            parts.push_back({std::make_shared<const Part>(self, box, child), 0});
        });
        return parts;
    }

    Structure structure_;
    std::shared_ptr<const Set> set_;
    double expected_cost_ = 0;
};

/// A subtree of a structure: its traversal starts at an inner node or a leaf. Owns the structure
/// together with all other parts.
template <class Structure, class Traversal, class Set>
class AcceleratedPart final : public Primitive {
  public:
    using Whole = AcceleratedObject<Structure, Traversal, Set>;
    AcceleratedPart(std::shared_ptr<const Whole> whole, const Bounds3& box, TraversalStart start)
        : whole_(std::move(whole)), start_(start) {
        set_bounds(box, *whole_);
        expected_cost_ = expected_cost_from(whole_->structure_, *whole_->set_, start, box);
    }
    void closest_local(const LocalRay& ray, RayQuery& query) const override {
        NoCounters none;
        Traversal::template run<Query::closest>(whole_->structure_, *whole_->set_, ray, query, none,
                                                start_);
    }
    bool any_local(const LocalRay& ray, RayQuery& query) const override {
        NoCounters none;
        return Traversal::template run<Query::any>(whole_->structure_, *whole_->set_, ray, query,
                                                   none, start_);
    }
    bool takes_packets() const override { return whole_->takes_packets(); }
    void closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        whole_->template trace_packet<Query::closest>(packet, space, rays, start_);
    }
    void any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const override {
        whole_->template trace_packet<Query::any>(packet, space, rays, start_);
    }
    bool takes_crowds() const override { return Whole::has_crowds; }
    void closest_crowd(RayCrowd& crowd) const override {
        whole_->template trace_crowd<Query::closest>(crowd, start_);
    }
    void any_crowd(RayCrowd& crowd) const override {
        whole_->template trace_crowd<Query::any>(crowd, start_);
    }
    void closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        run_counted(Query::closest, whole_->structure_, *whole_->set_, ray, query, counters,
                    start_);
    }
    bool any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const override {
        return run_counted(Query::any, whole_->structure_, *whole_->set_, ray, query, counters,
                           start_);
    }
    double expected_cost() const override { return expected_cost_; }
    StructureStatistics statistics() const override {
        StructureStatistics s;
        s.bytes = sizeof(AcceleratedPart);
        return s;
    }
    std::string type_name() const override { return part_name; }
    void walk(const BoxVisitor& visit) const override { visit(bounds(), 0, true, 1); }
    void children(const std::function<void(const Primitive&)>& visit) const override {
        visit(*whole_);
    }
    void archive(StructureWriter& out) const override {
        out.object(*whole_);
        out(bounds(), start_);
    }
    std::vector<PlacedPrimitive> open(const std::shared_ptr<const Primitive>&,
                                      PartCache&) const override {
        if (Structure::is_leaf(start_)) return {};
        return whole_->open_from(whole_, start_);
    }

  private:
    std::shared_ptr<const Whole> whole_;
    TraversalStart start_;
    double expected_cost_ = 0;
};

/// Builds `Structure<Set>` for whatever the set is and wraps it with this target's kernels.
template <template <class> class Structure, class Traversal, class Parameters>
std::unique_ptr<Primitive> build_object(const PrimitiveSet& any_set, const Parameters& parameters) {
    return std::visit(
        [&]<class Set>(const std::shared_ptr<const Set>& set) -> std::unique_ptr<Primitive> {
            return std::make_unique<AcceleratedObject<Structure<Set>, Traversal, Set>>(
                set, Structure<Set>::build(*set, parameters));
        },
        any_set);
}

template <template <class> class Structure, class Traversal>
std::unique_ptr<Primitive> load_object(StructureReader& in) {
    const PrimitiveSet any_set = in.set();
    return std::visit(
        [&]<class Set>(const std::shared_ptr<const Set>& set) -> std::unique_ptr<Primitive> {
            Structure<Set> structure;
            in(structure);
            return std::make_unique<AcceleratedObject<Structure<Set>, Traversal, Set>>(
                set, std::move(structure));
        },
        any_set);
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

/// The counted traversal of one structure, defined in the last pass, which is the baseline's.
#undef CROFTON_COUNTED_KERNEL
#if HWY_TARGET == HWY_STATIC_TARGET
#define CROFTON_COUNTED_KERNEL(Structure, Traversal)                                      \
    {                                                                                     \
        using Kernel = HWY_NAMESPACE::Traversal;                                          \
        if (kind == Query::any)                                                           \
            return Kernel::template run<Query::any>(structure, set, ray, query, counters, \
                                                    start...);                            \
        return Kernel::template run<Query::closest>(structure, set, ray, query, counters, \
                                                    start...);                            \
    }
#else
#define CROFTON_COUNTED_KERNEL(Structure, Traversal) ;
#endif

/// In an accelerator's source, for every target: instantiates its kernels over every set.
#define CROFTON_ACCELERATOR_KERNELS(Structure, Traversal, Parameters)                            \
    namespace crofton {                                                                          \
    template <class Set, class... Start>                                                         \
    bool run_counted(Query kind, const Structure<Set>& structure, const Set& set,                \
                     const LocalRay& ray, RayQuery& query, Counters& counters, Start... start)   \
        CROFTON_COUNTED_KERNEL(Structure, Traversal)                                             \
    }                                                                                            \
    HWY_BEFORE_NAMESPACE();                                                                      \
    namespace crofton {                                                                          \
    namespace HWY_NAMESPACE {                                                                    \
    std::unique_ptr<Primitive> build_##Structure(const PrimitiveSet& set, const Parameters& p) { \
        return build_object<Structure, Traversal>(set, p);                                       \
    }                                                                                            \
    std::unique_ptr<Primitive> load_##Structure(StructureReader& in) {                           \
        return load_object<Structure, Traversal>(in);                                            \
    }                                                                                            \
    }                                                                                            \
    }                                                                                            \
    HWY_AFTER_NAMESPACE();

/// Once, under HWY_ONCE, inside namespace crofton: puts the accelerator into the registry.
#define CROFTON_REGISTER_ACCELERATOR(Structure, Parameters, registry_name, summary, source) \
    HWY_EXPORT(load_##Structure);                                                           \
    HWY_EXPORT(build_##Structure);                                                          \
    bool Structure##_registered = register_accelerator(                                     \
        {registry_name, summary, source, list_parameters<Parameters>(),                     \
         [](const PrimitiveSet& set, const ParameterValues& values) {                       \
             const Parameters p = read_parameters<Parameters>(values);                      \
             return HWY_DYNAMIC_DISPATCH(build_##Structure)(set, p);                        \
         },                                                                                 \
         [](StructureReader& in) { return HWY_DYNAMIC_DISPATCH(load_##Structure)(in); }})

#endif
