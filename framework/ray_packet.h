#pragma once

#include <cstdint>

#include "framework/bounds.h"
#include "framework/ray.h"
#include "framework/ray_query.h"

namespace crofton {

/// Sixteen neighbours of a stream side by side, of which some start close to each other and go
/// nearly the same way: what none of these can meet, a structure passes over once for all.
///
/// They are set up together, to the bits as crofton::prepare does it one by one. A ray out of the
/// ordinary (a defined miss, or one that `prepare` has a special case for) never takes part.
struct RayPacket {
    static constexpr uint32_t most = 16;
    static constexpr uint32_t everyone = ~0u >> (32 - most);
    using Row = float[most];

    /// A ray that goes some way by itself.
    struct Single {
        LocalRay local;
        RayQuery query;
    };

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

    /// The state of ray r by itself, with what it has found so far.
    Single& single(uint32_t r) {
        const uint32_t bit = 1u << r;
        if (!(are_single & bit)) make_single(r);
        if (hit_in_row & bit) singles[r].query.replace(t_best[r], u[r], v[r], *ids, shape[r]);
        hit_in_row &= ~bit;
        return singles[r];
    }
    /// Whether the rays loaded last passed many nodes that hardly one of them would have met, as
    /// where triangles are much smaller than rays are apart.
    /// @param taken  how many went together
    bool was_futile(uint32_t taken) const { return visits > 4 * taken && encounters < visits; }
    /// What ray r hits.
    Hit hit(uint32_t r) const {
        const uint32_t bit = 1u << r;
        if (!(hit_in_row & bit)) return are_single & bit ? singles[r].query.hit(scale) : Hit();
        Hit hit;
        ids->resolve(shape[r], 0, hit);
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
    /// See LocalRay and RayQuery; vectors by axis x, y, z.
    alignas(64) Row origin[3], direction[3], near_origin[3], far_origin[3], rcp[3], far_rcp[3];
    alignas(64) Row shear[3];
    alignas(64) Row t_min, t_low, t_best;
    alignas(64) Row t_cull;  ///< -inf where a ray looks for nothing any more

    uint32_t found;       ///< bits of rays whose `any` query is answered: they are occluded
    uint32_t hit_in_row;  ///< bits of rays whose closest hit so far is t_best and what follows;
                          ///< others have it in their own state, if there is one
    const IdTable* ids;   ///< of the set that was hit
    alignas(64) Row u, v;
    alignas(64) uint32_t shape[most];

    uint32_t are_single;  ///< bits of rays with a state of their own
    uint32_t visits;      ///< nodes and leaves that the rays loaded last passed together
    uint32_t encounters;  ///< of rays with leaves there
    Single singles[most];

  private:
    void make_single(uint32_t r);
};

}  // namespace crofton
