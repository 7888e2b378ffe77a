#pragma once

#include "accelerators/tree_build.h"
#include "framework/aligned.h"
#include "framework/object_set.h"
#include "framework/primitive.h"

namespace crofton {

struct SphereHierarchyParameters : TreeParameters {
    SphereHierarchyParameters() { max_leaf_size = 4; }
    double lod = 0;
    double pixel_angle = 0;
    double pixel_width = 0;

    template <class V>
    void fields(V& v) {
        TreeParameters::fields(v, 64);
        v.real("lod", lod, 0, 64,
               "end a ray at a sphere no wider than so many footprints; 0: at the exact shape");
        v.real("pixel_angle", pixel_angle, 0, 1,
               "radians by which a footprint widens; 0: the camera's, else 45 degrees over 512");
        v.real("pixel_width", pixel_width, 0, 1e12, "world units of a footprint at the origin");
    }
};

/// A sphere of the hierarchy, decoded: relative to the centre of the whole, in its unit of length.
struct NodeSphere {
    float c[3];
    float r;
};

/// Up to four spheres inside the sphere of their parent, in 7 bytes each.
///
///   byte  0  x[4], y[4], z[4]: centres, from the parent's centre in steps of its radius / 127
///        12  r[4]: radii in steps of the parent's / 255; 0 = no child
///        16  count[4]: shapes of a leaf; 0 = an inner node
///        20  child: index of the first inner child; the others follow it
///        24  first: first reference of the first leaf child; those of the others follow
/// The largest child stands first.
struct SphereNode {
    int8_t x[4], y[4], z[4];
    uint8_t r[4];
    uint8_t count[4];
    uint32_t child;
    uint32_t first;

    static constexpr float center_step = 1 / 127.0f;
    /// So much more than 1/255 that 255 steps, rounded, are no less than the parent's radius.
    static constexpr float radius_step = 0x1.010106p-8f;
};
static_assert(sizeof(SphereNode) == 28);
static_assert(SphereNode::radius_step > (1 + 0x1p-22) / 255);

/// The sphere of child i, with the roundings of traversal: a builder that encodes a sphere must see
/// what a ray will see.
inline NodeSphere decoded(const SphereNode& node, int i, const NodeSphere& parent) {
    const float step = parent.r * SphereNode::center_step;
    return {{parent.c[0] + float(node.x[i]) * step, parent.c[1] + float(node.y[i]) * step,
             parent.c[2] + float(node.z[i]) * step},
            float(node.r[i]) * (parent.r * SphereNode::radius_step)};
}

/// Bounding spheres over any set, four children a node, quantised relative to the parent; the
/// hierarchy itself is a model of the shapes at every scale. See SphereHierarchyParameters and
/// sphere_hierarchy.md.
template <class Set>
struct SphereHierarchy {
    static constexpr const char* name = "sphere_hierarchy";
    static constexpr bool reads_set = true;
    static constexpr int max_depth = BinaryTree::max_depth;
    /// An object is not replaced by a sphere of its parent's: its own hierarchy stands for it.
    static constexpr bool has_lod = !std::is_same_v<Set, ObjectSet>;

    AlignedVector<SphereNode> nodes;  ///< the root first; empty: no shapes
    AlignedVector<uint32_t> references;
    Vec3d center = Vec3d::Zero();  ///< of the root's sphere, object units: origin of NodeSphere
    double unit = 1;               ///< object units per unit of NodeSphere, a power of two
    NodeSphere root{};             ///< about 0, with a radius in (0.5, 1]
    Bounds3 box;                   ///< of the shapes, and of all spheres if rays may end there
    float magnitude = 0;           ///< largest absolute coordinate of the shapes
    double lod = 0, pixel_angle = 0, pixel_width = 0;
    double cost = 0;
    StructureStatistics stats;

    static SphereHierarchy build(const Set& set, const SphereHierarchyParameters& parameters);
    template <class A>
    void archive(A& a) {
        a(nodes, references, center, unit, root, box, magnitude, lod, pixel_angle, pixel_width,
          cost, stats);
    }
    const Bounds3& bounds() const { return box; }
    double expected_cost(const Set&) const { return cost; }
    StructureStatistics statistics() const { return stats; }
    void walk(const BoxVisitor& visit) const;
    /// The box of a sphere, in object space, rounded outwards.
    Bounds3 box_of(const NodeSphere& s) const;
    /// The shape that stands for everything in child i of a node: the first of the largest leaf, as
    /// far as one finds it by always taking the largest child.
    uint32_t representative(const SphereNode& node, int i) const;
};

/// A ray in the space of NodeSpheres, from its point nearest to the centre of the whole, so that no
/// digits are lost to a far origin (Haines, Günther, Akenine-Möller 2019). It is as thick as
/// anything a leaf test may accept:
///
/// (a) A leaf test may accept a shape at up to LocalRay::pad and 12u·(|o| + magnitude) per axis
/// from
///     the exact ray, see LocalRay; `slack` has the length of that vector.
/// (b) The test of a sphere works in float. Centres and the origin lie within the root's sphere, so
///     that with |v| <= 2 the vector from the ray to a centre is off by at most 19u, comparing
///     squares by 3u, and the distance along the ray by 18u with the rounding of both ends: 40u
///     in all, of which `slack` has 64u = 2^-18.
/// A sphere that is enlarged by both contains, of the exact ray, every point next to which a shape
/// inside can be accepted, so the chord through it holds every t of such a hit.
struct SphereRay {
    float p[3];       ///< nearest to 0
    float d[3];       ///< unit length
    float slack;      ///< what radii grow by
    double t0;        ///< t at p
    double per_t;     ///< distance per t
    bool whole;       ///< the ray is so thick that no distance along it tells anything
    bool meets_root;  ///< false: nothing can be hit

    template <class Set>
    SphereRay(const SphereHierarchy<Set>& h, const LocalRay& ray, const RayQuery& q) {
        const ObjectRay along(ray, q);
        const Vec3d &o = along.origin, &way = along.direction;
        const Vec3d f = o - h.center;
        const double dd = way.squaredNorm(), length = std::sqrt(dd);
        t0 = -f.dot(way) / dd;
        per_t = length / h.unit;
        const Vec3d nearest = (f + t0 * way) / h.unit;
        Vec3d thickness;
        for (int a = 0; a < 3; ++a)
            thickness[a] = ray.pad[a] + 0x1.8p-21 * (std::abs(double(ray.origin[a])) + h.magnitude);
        const double thick = (thickness.norm() / h.unit + 0x1p-18) * (1 + 0x1p-17);
        // Beyond this, squares could leave the range of float.
        whole = !(thick < 0x1p60);
        slack = whole ? 0x1p60f : float(thick);
        meets_root = whole || nearest.norm() <= h.root.r + thick;
        for (int a = 0; a < 3; ++a) {
            p[a] = whole ? 0 : float(nearest[a]);
            d[a] = float(way[a] / length);
        }
    }
    /// Distances along the ray from p, of t.
    float begin(float t) const { return whole ? -INFINITY : float((t - t0) * per_t); }
    float end(float t) const { return whole ? INFINITY : float((t - t0) * per_t); }
    float t_of(float distance) const { return float(t0 + distance / per_t); }
};

/// Width of a ray's footprint as the radius of the sphere that may replace what is in it: at
/// distance s, radii up to base + slope·s. A footprint is lod·(pixel_width + pixel_angle·distance)
/// wide, in world units.
struct Footprint {
    float base, slope;
    float first;  ///< from here on; a sphere around the origin is as far as the origin

    template <class Set>
    Footprint(const SphereHierarchy<Set>& h, const SphereRay& along, const LocalRay& ray,
              const RayQuery& q) {
        // The largest stretch of the map from object to world, or a bound of it: exact where axes
        // stay perpendicular (Gershgorin's theorem on the square of the map).
        double stretch = 1;
        if (ray.frame) {
            const Eigen::Matrix3d& m = ray.frame->world_from_object.linear;
            const Eigen::Matrix3d square = m.transpose() * m;
            stretch = std::sqrt(square.cwiseAbs().rowwise().sum().maxCoeff());
        }
        const double speed =
            Vec3d(q.direction[0], q.direction[1], q.direction[2]).norm();  // world units per t
        const double scale = 0.5 * h.lod / (h.unit * stretch);
        base = float(scale * (h.pixel_width + h.pixel_angle * speed * along.t0));
        slope = float(scale * h.pixel_angle * speed / along.per_t);
        first = along.begin(std::max(q.t_min, 0.0f));
    }
    bool replaces(float radius, float distance) const {
        return radius <= base + slope * std::max(distance, first);
    }
};

}  // namespace crofton
