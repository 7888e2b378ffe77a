#include "accelerators/bsp.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/bsp.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/stored_shapes.h"
#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// The thick ray (see Bsp), projected on every direction of bsp_direction.
struct BspRay {
    /// Along one direction. No point is past the plane at d before t = (d - near)·rcp, and none is
    /// before it later than (d - far)·rcp.
    struct Projection {
        float near, far, rcp;
        float enter(float d) const { return (d - near) * rcp; }
        float leave(float d) const { return (d - far) * rcp; }
        /// All ones if the ray goes down: it meets what is above a plane first.
        uint32_t down() const { return std::signbit(rcp) ? ~0u : 0u; }
    };
    alignas(16) float near[16], far[16], rcp[16];
    float origin[3], direction[3];
    float thickness;  ///< the largest of an axis
    float limit;      ///< of |rcp|
    float t_enter, t_leave;

    template <class Set>
    BspRay(const Bsp<Set>& tree, const LocalRay& ray, const RayQuery& q) {
        constexpr float w = std::is_same_v<Set, PolygonSet> ? 0x1p-18f : 0x1p-19f;
        float axis_thickness[3], largest = 0;
        thickness = 0;
        for (int a = 0; a < 3; ++a) {
            origin[a] = ray.origin[a];
            direction[a] = ray.direction[a];
            axis_thickness[a] = ray.pad[a] + w * (std::abs(ray.origin[a]) + tree.magnitude);
            thickness = std::max(thickness, axis_thickness[a]);
            largest = std::max(largest, std::abs(ray.direction[a]));
        }
        limit = 0x1p60f / largest;
        project(tree.diagonal ? 16 : 4, axis_thickness);

        // What is accepted at t_min may be met as much before it as t can be wrong.
        t_enter = q.t_low;
        t_leave = q.t_cull;
        for (uint32_t a = 0; a < 3; ++a) {
            const Projection p = along(a);
            t_enter = std::max(t_enter, p.enter(p.down() ? tree.box.upper[a] : tree.box.lower[a]));
            t_leave = std::min(t_leave, p.leave(p.down() ? tree.box.lower[a] : tree.box.upper[a]));
        }
    }

    Projection along(uint32_t k) const { return {near[k], far[k], rcp[k]}; }
    Projection along(const BspPlane& plane) const {
        const float* n = plane.n;
        const float o = n[0] * origin[0] + n[1] * origin[1] + n[2] * origin[2];
        const float d = n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2];
        const float r = std::copysign(std::min(std::abs(1.0f / d), limit), d);
        const float shift = std::copysign(thickness, d);
        return {o + shift, o - shift, r};
    }

  private:
    HWY_INLINE void project(size_t count, const float (&axis_thickness)[3]) {
        alignas(16) static constexpr float x[16] = {1, 0, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1};
        alignas(16) static constexpr float y[16] = {0, 1, 0, 1, -1, 0, 0, 1, 1, 1, 1, -1, -1};
        alignas(16) static constexpr float z[16] = {0, 0, 1, 0, 0, 1, -1, 1, -1, 1, -1, 1, -1};
        const hn::FixedTag<float, 4> f;
        const auto dot = [&](size_t i, const float* v, bool absolute) HWY_ATTR {
            auto nx = hn::Load(f, x + i), ny = hn::Load(f, y + i), nz = hn::Load(f, z + i);
            if (absolute) ny = hn::Abs(ny), nz = hn::Abs(nz);
            return hn::Add(hn::Add(hn::Mul(nx, hn::Set(f, v[0])), hn::Mul(ny, hn::Set(f, v[1]))),
                           hn::Mul(nz, hn::Set(f, v[2])));
        };
        for (size_t i = 0; i < count; i += 4) {
            const auto o = dot(i, origin, false), d = dot(i, direction, false);
            const auto inverse = hn::Div(hn::Set(f, 1.0f), d);
            const auto r = hn::CopySign(hn::Min(hn::Abs(inverse), hn::Set(f, limit)), d);
            const auto shift = hn::CopySign(dot(i, axis_thickness, true), d);
            hn::Store(hn::Add(o, shift), f, near + i);
            hn::Store(hn::Sub(o, shift), f, far + i);
            hn::Store(r, f, rcp + i);
        }
    }
};

struct BspTraversal {
    struct Entry {
        const BspNode* node;
        float t_enter, t_leave;
    };

    template <Query Q, class Set, class C>
    static bool run(const Bsp<Set>& tree, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        float t_near, t_far;
        if (tree.nodes.empty() || !meets_box(tree.box, ray, q, t_near, t_far)) return false;
        return test_lists<Q>(tree.mailbox, tree.shapes, set, ray, q, counters,
                             [&](const auto& test)
                                 HWY_ATTR { return follow(tree, ray, q, counters, test); });
    }

  private:
    /// Front to back with an explicit stack, as in a kd-tree; where the thick ray meets a plane
    /// within the cell, both sides are visited, their intervals overlapping.
    template <class Set, class C, class Test>
    static HWY_INLINE bool follow(const Bsp<Set>& tree, const LocalRay& ray, RayQuery& q,
                                  C& counters, const Test& test) {
        const BspRay thick(tree, ray, q);
        const BspNode* nodes = tree.nodes.data();
        Entry stack[Bsp<Set>::max_depth];
        Entry* top = stack;
        const BspNode* node = nodes;
        float t_enter = thick.t_enter, t_leave = thick.t_leave;
        while (true) {
            for (uint32_t kind; (kind = node->kind()) != BspNode::leaf_kind;) {
                counters.step();
                // The node's kind decides (Ize 2008): a plane of a few directions costs as much as
                // in a kd-tree.
                BspRay::Projection along;
                float d;
                if (HWY_LIKELY(kind != BspNode::general)) {
                    along = thick.along(kind);
                    d = node->distance();
                } else {
                    const BspPlane& plane = tree.planes[node->value];
                    along = thick.along(plane);
                    d = plane.d;
                }
                const float enter_second = along.enter(d);
                const float leave_first = along.leave(d);
                // By arithmetic: a table of two would be written and read back at every step.
                const uint32_t below = uint32_t(node - nodes) + 1;
                const uint32_t swap = (below ^ node->above()) & along.down();
                const BspNode* first = nodes + (below ^ swap);
                const BspNode* second = nodes + (node->above() ^ swap);
                if (leave_first < t_enter) {
                    node = second;
                } else if (enter_second > t_leave) {
                    node = first;
                } else {
                    *top++ = {second, std::max(t_enter, enter_second), t_leave};
                    node = first;
                    t_leave = std::min(t_leave, leave_first);
                }
            }
            counters.step();
            const uint32_t count = node->count();
            counters.cell(count == 0);
            if (count > 0) {
                const uint32_t* references =
                    count == 1 ? &node->value : tree.references.data() + node->value;
                if (test(references, count)) return true;
            }
            // Overlapping intervals do not begin in strict order, so each is looked at.
            do {
                if (top == stack) return false;
                --top;
            } while (top->t_enter > q.t_cull);
            node = top->node;
            t_enter = top->t_enter;
            t_leave = std::min(top->t_leave, q.t_cull);
        }
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(Bsp, BspTraversal, BspParameters)

#if HWY_ONCE
#include <Eigen/Geometry>

#include "accelerators/leaves.h"

namespace crofton {
namespace {

void describe(const TriangleSet& set, BspShapes& shapes) {
    for (const BuildReference& r : shapes.references) {
        shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
        for (int k = 0; k < 3; ++k) shapes.corners.push_back(set.vertex(r.shape, k).cast<double>());
    }
    shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
}

/// Whether all corners are in one plane but for their rounding to float.
bool is_flat(std::span<const Vec3f> corners) {
    const Vec3d o = corners[0].cast<double>();
    Vec3d n = Vec3d::Zero();
    float magnitude = 0;
    for (const Vec3f& c : corners) magnitude = std::max(magnitude, c.cwiseAbs().maxCoeff());
    for (size_t i = 2; i < corners.size(); ++i)
        n += (corners[i - 1].cast<double>() - o).cross(corners[i].cast<double>() - o);
    if (!(n.norm() > 0)) return false;
    n.normalize();
    double off = 0;
    for (const Vec3f& c : corners) off = std::max(off, std::abs(n.dot(c.cast<double>() - o)));
    return off <= 0x1p-22 * double(magnitude);
}

void describe(const PolygonSet& set, BspShapes& shapes) {
    for (const BuildReference& r : shapes.references) {
        shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
        const std::span<const Vec3f> corners = set.corners(r.shape);
        // One that is not flat may be hit anywhere in its bounds.
        if (!is_flat(corners)) continue;
        for (const Vec3f& c : corners) shapes.corners.push_back(c.cast<double>());
    }
    shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
}

void describe(const QuadricSet& set, BspShapes& shapes) {
    for (const BuildReference& r : shapes.references) {
        const QuadricShape& s = set.shape(r.shape);
        const Vec3d p = s.p.cast<double>(), q = s.q.cast<double>();
        BspShapes::Round round{{p, p}, {s.p_radius, s.p_radius}, Vec3d::Zero()};
        if (s.kind == QuadricKind::cone) {
            round.center[1] = q;
            round.radius[1] = s.q_radius;
            round.axis = (q - p).stableNormalized();
        } else if (s.kind == QuadricKind::disc) {
            round.axis = q.stableNormalized();
        }
        shapes.rounds.push_back(round);
    }
}

void describe(const ObjectSet&, BspShapes&) {}

}  // namespace

template <class Set>
Bsp<Set> Bsp<Set>::build(const Set& set, const BspParameters& p) {
    Bsp tree;
    BspShapes shapes;
    shapes.references = build_references(set);
    if (shapes.references.empty()) return tree;
    describe(set, shapes);
    const BspTreeData data =
        build_bsp(shapes, {p.planes, p.max_depth, p.max_leaf_size, p.bins, p.general_size,
                           p.sampled_shapes, p.empty_bonus, cost_constants.general_plane,
                           reference_costs<Set>(cost_constants.plane)});
    tree.nodes.assign(data.nodes.begin(), data.nodes.end());
    tree.planes.assign(data.planes.begin(), data.planes.end());
    tree.references.assign(data.references.begin(), data.references.end());
    tree.shapes = ShapeStore<Set>(set);
    for (BspNode& node : tree.nodes)
        if (node.is_leaf()) place_leaf(set, node.value, node.count(), tree.references, tree.shapes);
    tree.shapes.finish();
    tree.box = data.box;
    tree.magnitude = data.box.magnitude();
    tree.cost = data.cost;

    std::vector<std::pair<uint32_t, uint32_t>> open{{0, 0}};
    while (!open.empty()) {
        const auto [index, depth] = open.back();
        open.pop_back();
        const BspNode& n = tree.nodes[index];
        tree.stats.depth = std::max(tree.stats.depth, depth);
        tree.stats.N_IN += !n.is_leaf();
        tree.stats.N_V += n.is_leaf();
        if (n.is_leaf()) {
            tree.stats.N_EV += n.count() == 0;
            tree.stats.N_OIV += n.count();
            continue;
        }
        tree.diagonal = tree.diagonal || (n.kind() >= 3 && n.kind() < BspNode::general);
        open.emplace_back(n.above(), depth + 1);
        open.emplace_back(index + 1, depth + 1);
    }
    tree.stats.bytes = tree.nodes.size() * sizeof(BspNode) + tree.planes.size() * sizeof(BspPlane) +
                       tree.references.size() * sizeof(uint32_t) + tree.shapes.bytes();
    const double n = double(shapes.references.size());
    double cost_sum = 0;
    for (const BuildReference& r : shapes.references) cost_sum += r.cost;
    tree.mailbox = wants_mailbox(p.mailbox, std::is_same_v<Set, ObjectSet>,
                                 double(tree.stats.N_OIV), n, cost_sum / n);
    return tree;
}

template <class Set>
void Bsp<Set>::walk(const BoxVisitor& visit) const {
    walk_cells(nodes, planes, box, [&](uint32_t node, const BspCell& cell, uint32_t depth) {
        const BspNode& n = nodes[node];
        visit(cell.box, depth, n.is_leaf(), n.is_leaf() ? n.count() : 0);
    });
}

CROFTON_REGISTER_ACCELERATOR(
    Bsp, BspParameters, "bsp",
    "planes of any direction placed by the area heuristic over convex cells, with a fast path for "
    "a few directions",
    "Fuchs, Kedem, Naylor 1980; Kammaje & Mora 2007; Budge et al. 2008; Ize, Wald, Parker 2008");

}  // namespace crofton
#endif
