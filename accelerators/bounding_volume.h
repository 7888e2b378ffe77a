#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "accelerators/binary_tree.h"
#include "framework/aligned.h"
#include "framework/cost.h"
#include "framework/ray_query.h"
#include "framework/triangle_set.h"

namespace crofton {

/// What a node of a hierarchy is bounded by.
enum class BoundingVolume {
    box,     ///< axis-aligned
    sphere,  ///< Rubin & Whitted 1980; Weghorst, Hooper, Greenberg 1984
    obb,     ///< oriented box (Gottschalk, Lin, Manocha 1996)
    kdop,    ///< fourteen planes: the axes and the four diagonals (Kay & Kajiya 1986)
};

/// Nominal ns to test both children of a node.
inline double pair_cost(BoundingVolume volume) {
    switch (volume) {
        case BoundingVolume::sphere:
            return cost_constants.sphere_node;
        case BoundingVolume::obb:
            return cost_constants.obb_node;
        case BoundingVolume::kdop:
            return cost_constants.kdop_node;
        default:
            return cost_constants.node;
    }
}

/// What all nodes of two children have, whatever bounds them.
struct PairLinks {
    uint32_t index[2];  ///< an inner node, or where a leaf's shapes begin
    uint32_t count[2];  ///< 0 for an inner node, else shapes in the leaf
};

/// Two spheres. byte 0 center x, y, z of both (2 floats each), 24 radius of both, 32 links
struct SpherePair {
    float center[3][2];
    float radius[2];  ///< < 0: empty
    PairLinks links;
};
static_assert(sizeof(SpherePair) == 48);

/// Two intersections of three slabs along directions of their own.
///
///   byte   0  child 0: x of the three directions and a zero, y, z likewise; lower, upper
///         80  child 1 likewise
///        160  links
struct ObbPair {
    struct Child {
        float direction[3][4];  ///< [component][slab]; about unit length
        float lower[4];         ///< of direction·p; the fourth slab is without end
        float upper[4];
    };
    Child child[2];
    PairLinks links;
};
static_assert(sizeof(ObbPair) == 176);

/// Two intersections of seven slabs: x, y, z, x+y+z, x+y-z, x-y+z, x-y-z; the eighth is without
/// end. byte 0 child 0: lower (8 floats), upper; 64 child 1 likewise; 128 links
struct KdopPair {
    static constexpr int directions[7][3] = {{1, 0, 0},  {0, 1, 0},  {0, 0, 1},  {1, 1, 1},
                                             {1, 1, -1}, {1, -1, 1}, {1, -1, -1}};
    struct Child {
        float lower[8];
        float upper[8];
    };
    Child child[2];
    PairLinks links;
};
static_assert(sizeof(KdopPair) == 144);

/// A ray as thick as any leaf test can stray, for volumes that are no boxes.
///
/// A leaf test may accept a shape that the exact ray passes, on axis a, at no more than pad_a and
/// 12u·(|o_a| + magnitude) more: see LocalRay. What the tests of volumes do in float adds to that:
/// n·o, n·d and n·p of a direction n with |n_a| <= 1 have errors of at most 3u·Σ|n_a|·(their
/// coordinates); the error of n·d moves the ray by 3u·Σ|n_a|·|t·d_a|, and wherever it is in the
/// volume |t·d_a| <= |o_a| + magnitude; so does the replacement of 1/(n·d) by a finite number; the
/// distance along the ray has 3 roundings of |n·p - n·o|. In sum less than 14u·(|o_a| + magnitude);
/// 32u are more than both. So the thickness of n is Σ|n_a|·thickness_a.
struct VolumeRay {
    float thickness[3];

    /// @param magnitude  largest absolute coordinate of the structure's bounds
    VolumeRay(const LocalRay& ray, float magnitude) {
        for (int a = 0; a < 3; ++a)
            thickness[a] = ray.pad[a] + 0x1p-19f * (std::abs(ray.origin[a]) + magnitude);
    }
};

/// Points whose convex hull holds a shape: corners of triangles, otherwise of boxes.
inline void append_hull(const TriangleSet& set, uint32_t shape, std::vector<Vec3f>& points) {
    for (int k = 0; k < 3; ++k) points.push_back(set.vertex(shape, k));
}
template <class Set>
void append_hull(const Set& set, uint32_t shape, std::vector<Vec3f>& points) {
    const Bounds3 b = set.bounds(shape);
    for (int corner = 0; corner < 8; ++corner)
        points.emplace_back(corner & 1 ? b.upper[0] : b.lower[0],
                            corner & 2 ? b.upper[1] : b.lower[1],
                            corner & 4 ? b.upper[2] : b.lower[2]);
}

/// @name Fitting
/// Make child `side` of a node hold all points, rounded outwards; of no points, a volume that no
/// ray meets. Return half the surface area, 0 if empty.
/// @{

/// The least of several spheres: about the box's centre, and as points pull it (Bădoiu & Clarkson
/// 2003: "Smaller core-sets for balls"). O(n).
double fit(std::span<const Vec3f> points, int side, SpherePair& pair);
/// Along the axes, or along the principal directions if that box has less area. O(n).
double fit(std::span<const Vec3f> points, int side, ObbPair& pair);
double fit(std::span<const Vec3f> points, int side, KdopPair& pair);
/// @}

}  // namespace crofton
