#pragma once

#include <bit>
#include <cstdint>
#include <limits>

#include "framework/bounds.h"
#include "framework/ray.h"
#include "framework/ray_query.h"

namespace crofton {

class Primitive;
struct RayPacket;

/// A packet's rays in one object's space, for box tests: see LocalRay.
class LocalPacket {
  public:
    static constexpr uint32_t most = 16;
    using Row = float[most];

    LocalPacket() = default;
    LocalPacket(const LocalPacket&) = delete;
    LocalPacket& operator=(const LocalPacket&) = delete;

    /// Brings rays of a packet into an object's space, as crofton::enter does it one by one.
    /// @param where  referred to from then on
    /// @return       bits of those that have an image there, and are none of its special cases
    uint32_t enter(const InstanceFrame& where, const RayPacket& packet, uint32_t rays);
    /// Of rays the first, and those that go its way on every axis.
    uint32_t one_way(uint32_t rays) const;
    /// Ray r by itself. @param query  its own, see RayPacket::query
    const LocalRay& single(uint32_t r, const RayQuery& query);

    const InstanceFrame* frame = nullptr;  ///< null: this is world space
    alignas(64) Row near_origin[3], far_origin[3], rcp[3], far_rcp[3];
    /// Bits of rays that go down an axis; not in world space, where all go one way.
    uint32_t down[3];

  private:
    friend struct RayPacket;
    uint32_t are_single_ = 0;  ///< bits of rays that have gone alone
    LocalRay single_[most];
};

/// Sixteen neighbours of a stream side by side, of which some start close to each other and go
/// nearly the same way: what none of these can meet, a structure passes over once for all.
///
/// They are set up together, to the bits as crofton::prepare does it one by one. A ray out of the
/// ordinary (a defined miss, or one that `prepare` has a special case for) never takes part.
struct RayPacket {
    static constexpr uint32_t most = LocalPacket::most;
    static constexpr uint32_t everyone = ~0u >> (32 - most);
    using Row = LocalPacket::Row;

    /// @param box        of the structure
    /// @param magnitude  see crofton::prepare
    RayPacket(const Bounds3& box, float magnitude, Mode mode);

    /// Whether some rays may go together, by a look at a few of them.
    /// @param rays  `most`
    static bool promising(const Ray* rays);
    /// Takes `most` rays, which have to stay where they are.
    void load(const Ray* rays);
    /// Of some rays the first, and those that may go together with it: every direction component
    /// has one sign and differs by an eighth of the largest at most, which is on one axis and has
    /// one binary exponent; origins differ by a 64th of the box.
    /// @param among  bits of rays
    /// @return       bits; none if the first is out of the ordinary
    uint32_t companions(uint32_t among);
    /// Sets up what `companions` last returned, or some of it with the first. The lanes of others
    /// repeat the first of them, with nothing to look for.
    void prepare(uint32_t companions);

    /// The state of ray r by itself, with what it has found so far, in the object that the packet
    /// is in.
    RayQuery& query(uint32_t r) {
        const uint32_t bit = 1u << r;
        if (!(are_single & bit)) make_single(r);
        if (hit_in_row & bit) {
            queries[r].instance = owner_of(r).instance;
            queries[r].replace(t_best[r], u[r], v[r], *owner_of(r).ids, shape[r]);
            hit_in_row &= ~bit;
        }
        queries[r].instance = instance;
        return queries[r];
    }
    /// Traces ray r by itself.
    /// @param space  of the object that the packet is in
    /// @param trace  (ray, query): returns whether an `any` query is answered
    /// @return       whether the ray goes less far now
    template <class F>
    bool alone(uint32_t r, LocalPacket& space, const F& trace) {
        RayQuery& q = query(r);
        const float before = q.t_cull;
        if (trace(space.single(r, q), q)) {
            found |= 1u << r;
            t_cull[r] = -std::numeric_limits<float>::infinity();
            return true;
        }
        if (q.t_cull == before) return false;
        t_best[r] = q.t_best;
        t_cull[r] = q.t_cull;
        return true;
    }
    /// Traces rays in an object that they are at: together where it can, else one by one.
    /// @param space  the object's
    /// @return       whether it may be that some go less far now
    template <Query Q>
    bool enter(const Primitive& object, LocalPacket& space, uint32_t rays);
    /// Names the set whose shapes are recorded from now on.
    void hits_are_of(const IdTable& ids) {
        for (; fresh; fresh &= fresh - 1) owner[std::countr_zero(fresh)] = current;
        current = {&ids, instance};
    }
    /// Whether the rays loaded last passed many nodes that hardly one of them would have met, as
    /// where triangles are much smaller than rays are apart.
    /// @param taken  how many went together
    bool was_futile(uint32_t taken) const { return visits > 4 * taken && encounters < visits; }
    /// What ray r hits.
    Hit hit(uint32_t r) const {
        const uint32_t bit = 1u << r;
        if (!(hit_in_row & bit)) return are_single & bit ? queries[r].hit(scale) : Hit();
        Hit hit;
        owner_of(r).ids->resolve(shape[r], owner_of(r).instance, hit);
        hit.t = t_best[r] * scale;
        hit.u = u[r];
        hit.v = v[r];
        return hit;
    }

    const Ray* source = nullptr;
    Mode mode;
    float magnitude;
    float near;  ///< how far apart origins may be; below 0 where rays go alone in any case
    alignas(64) Row given[8];  ///< origin, t_min, direction and t_max of all rays

    uint32_t rays = 0;  ///< bits of those that take part
    float scale;        ///< see crofton::prepare
    int axis[3];        ///< kx, ky, kz
    LocalPacket world;  ///< in which the packet begins
    /// See RayQuery; vectors by axis x, y, z.
    alignas(64) Row origin[3], direction[3];
    alignas(64) Row shear[3];
    alignas(64) Row t_min, t_low, t_best;
    alignas(64) Row t_cull;  ///< -inf where a ray looks for nothing any more

    uint32_t instance;  ///< sum of the instance offsets on the path to the current object
    /// Of objects inside objects. Where it is `deepest`, rays go on alone, so that objects may nest
    /// deeper than stacks have room for packets.
    uint32_t depth;
    static constexpr uint32_t deepest = 8;

    /// Where shapes belong that were hit.
    struct Owner {
        const IdTable* ids;  ///< of the set
        uint32_t instance;
    };
    const Owner& owner_of(uint32_t r) const { return fresh >> r & 1 ? current : owner[r]; }

    uint32_t found;       ///< bits of rays whose `any` query is answered: they are occluded
    uint32_t hit_in_row;  ///< bits of rays whose closest hit so far is t_best and what follows;
                          ///< others have it in their own state, if there is one
    uint32_t fresh;       ///< of these, those that hit a shape of `current`
    Owner current;
    Owner owner[most];
    alignas(64) Row u, v;
    alignas(64) uint32_t shape[most];

    uint32_t are_single;  ///< bits of rays with a state of their own
    uint32_t visits;      ///< nodes and leaves that the rays loaded last passed together
    uint32_t encounters;  ///< of rays with leaves there
    RayQuery queries[most];

  private:
    void make_single(uint32_t r);
};

}  // namespace crofton
