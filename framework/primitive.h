#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "framework/bounds.h"
#include "framework/counters.h"
#include "framework/ray.h"
#include "framework/ray_query.h"

namespace crofton {

class StructureWriter;
struct TraversalStart;

/// What was built: the structure part of the Best Efficiency Scheme. Nested objects not included.
struct StructureStatistics {
    uint64_t N_IN = 0;   ///< interior nodes (trees) or 0 (flat grids)
    uint64_t N_V = 0;    ///< elementary cells: leaves, grid cells
    uint64_t N_EV = 0;   ///< of these, the empty ones
    uint64_t N_OIV = 0;  ///< references to primitives in elementary cells
    uint64_t bytes = 0;  ///< of the structure with everything that its traversal reads
    uint32_t depth = 0;  ///< of the deepest leaf; 0 = the root is a leaf

    StructureStatistics& operator+=(const StructureStatistics& o) {
        N_IN += o.N_IN, N_V += o.N_V, N_EV += o.N_EV, N_OIV += o.N_OIV, bytes += o.bytes;
        depth = std::max(depth, o.depth);
        return *this;
    }
};

/// Receives the boxes of a structure, parents first. `references` is 0 for inner nodes.
using BoxVisitor =
    std::function<void(const Bounds3& box, uint32_t depth, bool leaf, uint32_t references)>;

class Primitive;

/// A primitive as something above holds it.
struct PlacedPrimitive {
    std::shared_ptr<const Primitive> primitive;
    uint32_t instance = 0;  ///< added to the instance ids of hits inside
};

/// Parts of primitives, each primitive opened once: instances of one object share its parts.
class PartCache {
  public:
    /// @return  what stands for `primitive`; empty if it cannot be opened
    const std::vector<PlacedPrimitive>& parts(const std::shared_ptr<const Primitive>& primitive);

  private:
    struct Opened {
        std::shared_ptr<const Primitive> primitive;  ///< kept, so that its address stays its own
        std::vector<PlacedPrimitive> parts;
    };
    std::unordered_map<const Primitive*, Opened> opened_;
};

class LocalPacket;
struct RayPacket;
struct RayCrowd;

/// One object that rays can meet: a set of shapes with its accelerator, an instance of another
/// primitive, or a whole scene. An accelerator is itself a Primitive, so any may hold any.
///
/// The virtual functions are the seam: one call an object, and nothing virtual below it. Users call
/// the functions without `_local`.
class Primitive {
  public:
    virtual ~Primitive() = default;
    Primitive() = default;
    Primitive(const Primitive&) = delete;
    Primitive& operator=(const Primitive&) = delete;

    /// In the primitive's own space; contains every point that a hit can have.
    const Bounds3& bounds() const { return bounds_; }

    /// Closest hit with t in [ray.t_min, ray.t_max]; of several at the same t, the one with the
    /// lowest (instance, geometry, primitive). Thread-safe, does not throw.
    /// @param mode  how hard it tries to be right, with the promise of each: see Mode
    Hit intersect(const Ray& ray, Mode mode = Mode::robust) const;
    /// Whether anything is hit with t in [ray.t_min, ray.t_max].
    bool occluded(const Ray& ray, Mode mode = Mode::robust) const;
    /// The same for many rays; results are in the order of the rays and equal the single calls bit
    /// for bit. Neighbours that go together are traced together where the structure can: see
    /// RayPacket. Others are traced in turns where that is faster: see RayCrowd. Thousands of rays
    /// that jump about in a structure larger than the last cache are traced in a better order: see
    /// RayOrder. Spans must have equal length.
    void intersect(std::span<const Ray> rays, std::span<Hit> hits, Mode mode = Mode::robust) const;
    void occluded(std::span<const Ray> rays, std::span<uint8_t> results,
                  Mode mode = Mode::robust) const;
    /// The same with counting: the hits are identical, the time is not to be measured.
    Hit intersect(const Ray& ray, Counters& counters, Mode mode = Mode::robust) const;
    bool occluded(const Ray& ray, Counters& counters, Mode mode = Mode::robust) const;

    /// @name The seam, for accelerators and instances
    /// @{
    /// `intersect` and `occluded`, in any mode but `exact`: the ray is prepared, and traced. An
    /// accelerator has both steps compiled for one instruction set.
    virtual Hit closest(const Ray& ray, Mode mode) const;
    virtual bool any(const Ray& ray, Mode mode) const;
    virtual void closest_local(const LocalRay& ray, RayQuery& query) const = 0;
    virtual bool any_local(const LocalRay& ray, RayQuery& query) const = 0;
    virtual void closest_local(const LocalRay& ray, RayQuery& query, Counters& counters) const = 0;
    virtual bool any_local(const LocalRay& ray, RayQuery& query, Counters& counters) const = 0;
    /// Whether rays that go together can be traced together: see RayPacket. If not, the next two
    /// are never called. They trace `rays` (bits) of a packet, whose space is the object's.
    virtual bool takes_packets() const { return false; }
    virtual void closest_packet(RayPacket&, LocalPacket& /*space*/, uint32_t /*rays*/) const {}
    virtual void any_packet(RayPacket&, LocalPacket& /*space*/, uint32_t /*rays*/) const {}
    /// Whether rays that go each its own way can be traced in turns: see RayCrowd. If not, the next
    /// two are never called.
    virtual bool takes_crowds() const { return false; }
    virtual void closest_crowd(RayCrowd&) const {}
    virtual void any_crowd(RayCrowd&) const {}
    /// @}

    /// Expected cost in nanoseconds of a ray that meets the bounds (closest hit, ignoring that rays
    /// end), from the structure as built and the nominal constants of framework/cost.h; nested
    /// objects included.
    virtual double expected_cost() const = 0;
    /// Of this structure alone.
    virtual StructureStatistics statistics() const = 0;
    /// Registry name, e.g. "bvh"; "instance" for an instance.
    virtual std::string type_name() const = 0;
    /// Visits this structure's own boxes, in its own space.
    virtual void walk(const BoxVisitor& visit) const = 0;
    /// Visits the objects directly inside, each once per reference in its set (not per leaf).
    virtual void children(const std::function<void(const Primitive&)>& visit) const = 0;
    /// Writes what a reader needs to make this again, objects inside by their numbers: see
    /// save_structure.
    virtual void archive(StructureWriter& out) const = 0;
    /// What stands in for this in a saved file: itself, or the structure that it builds on demand.
    virtual const Primitive& resolved() const { return *this; }

    /// Opens this primitive (re-braiding: Benthin, Woop, Wald, Áfra 2017): primitives that together
    /// give the same hits, to the bits, so that a structure above can be built over parts of
    /// objects that overlap. Parts share this one's data.
    /// @param self  owns this primitive
    /// @return      empty if it cannot be opened
    virtual std::vector<PlacedPrimitive> open(const std::shared_ptr<const Primitive>& /*self*/,
                                              PartCache&) const {
        return {};
    }
    /// One of the parts again, as a saved file names it: see AcceleratedPart.
    /// @return  null if there are no such parts
    virtual std::shared_ptr<const Primitive> part(const std::shared_ptr<const Primitive>& /*self*/,
                                                  const Bounds3& /*box*/,
                                                  const TraversalStart&) const {
        return nullptr;
    }
    /// A few boxes that hold, together, what bounds() holds, and leave out empty corners of it
    /// where the root of a structure has children. For what turns them: see Instance.
    virtual std::vector<Bounds3> cover() const { return {bounds()}; }
    /// Largest absolute coordinates of the shapes inside; more than those of the bounds where this
    /// is a part whose shapes stick out of it.
    const Vec3f& magnitudes() const { return magnitudes_; }
    float magnitude() const { return magnitude_; }  ///< the largest

  protected:
    void set_bounds(const Bounds3& bounds) {
        bounds_ = bounds;
        magnitudes_ = bounds.empty()
                          ? Vec3f(0, 0, 0)
                          : Vec3f(bounds.lower.cwiseAbs().cwiseMax(bounds.upper.cwiseAbs()));
        magnitude_ = magnitudes_.maxCoeff();
    }
    /// Of a part.
    void set_bounds(const Bounds3& bounds, const Primitive& whole) {
        bounds_ = bounds;
        magnitudes_ = whole.magnitudes_;
        magnitude_ = whole.magnitude_;
    }

  private:
    /// `intersect` and `occluded` in mode exact; `counters` may be null.
    Hit closest_exactly(const Ray& ray, Counters* counters) const;
    bool any_exactly(const Ray& ray, Counters* counters) const;

    Bounds3 bounds_;
    Vec3f magnitudes_ = Vec3f::Zero();
    float magnitude_ = 0;

    /// Whether the whole, all inside included, has RayOrder::large_structure bytes; found when
    /// first asked.
    bool is_large() const;
    /// Calls one(i) for a ray, or together(packet, first) for those of a packet, whose ray 0 is ray
    /// `first`.
    template <class One, class Together>
    void in_good_order(std::span<const Ray> rays, Mode mode, const One& one,
                       const Together& together) const;
    template <class One, class Together>
    void as_given(std::span<const Ray> rays, Mode mode, const One& one,
                  const Together& together) const;
    /// The same with local(ray, query), trace(crowd) and keep(i, query, scale, found): see Crowds.
    template <class One, class Local, class Together, class Trace, class Keep>
    void stream(std::span<const Ray> rays, Mode mode, const One& one, const Local& local,
                const Together& together, const Trace& trace, const Keep& keep) const;
    enum : uint8_t { unknown_size, small_size, large_size };
    mutable std::atomic<uint8_t> size_known_ = unknown_size;
};

/// Sum of statistics over a structure and every distinct one nested in it (shared objects once).
StructureStatistics total_statistics(const Primitive& root);

}  // namespace crofton
