#include "accelerators/octree.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/octree.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/stored_shapes.h"
#include "accelerators/thick_ray.h"
#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Intervals of a ray in the eight children of a node, numbered in the order in which it meets
/// them: bit a of k is set if child k is behind the plane of axis a. Counting up is then front to
/// back.
///
/// The parametric traversal of Revelles, Ureña and Lastra (2000), without its state machine: each
/// child's interval is what the planes leave of the parent's, and a thick ray may have any of them.
class OctantIntervals {
  public:
    static constexpr uint32_t children = 8;
    float enter[children], leave[children];

    explicit OctantIntervals(const ThickRay& ray) {
        const D d;
        alignas(16) constexpr float bit_0[4] = {0, 1, 0, 1}, bit_1[4] = {0, 0, 1, 1};
        x_ = hn::Gt(hn::Load(d, bit_0), hn::Zero(d));
        y_ = hn::Gt(hn::Load(d, bit_1), hn::Zero(d));
        near_origin_ = hn::Load(d, ray.near_origin);
        far_origin_ = hn::Load(d, ray.far_origin);
        rcp_ = hn::Load(d, ray.rcp);
    }
    /// @return bit k: child k has an interval
    HWY_INLINE uint32_t set(const OctreeNode& node, float t_enter, float t_leave) {
        const D d;
        // ThickRay::enter and leave of the three planes; the fourth lane means nothing.
        const auto planes = hn::LoadU(d, node.plane);
        const auto in = hn::Mul(hn::Sub(planes, near_origin_), rcp_);
        const auto out = hn::Mul(hn::Sub(planes, far_origin_), rcp_);
        const auto begin = hn::Set(d, t_enter), end = hn::Set(d, t_leave);
        const auto enter_low =
            hn::Max(begin, hn::Max(hn::IfThenElse(x_, hn::Broadcast<0>(in), begin),
                                   hn::IfThenElse(y_, hn::Broadcast<1>(in), begin)));
        const auto enter_high = hn::Max(enter_low, hn::Broadcast<2>(in));
        const auto leave_high =
            hn::Min(end, hn::Min(hn::IfThenElse(x_, end, hn::Broadcast<0>(out)),
                                 hn::IfThenElse(y_, end, hn::Broadcast<1>(out))));
        const auto leave_low = hn::Min(leave_high, hn::Broadcast<2>(out));
        hn::StoreU(enter_low, d, enter);
        hn::StoreU(enter_high, d, enter + 4);
        hn::StoreU(leave_low, d, leave);
        hn::StoreU(leave_high, d, leave + 4);
        uint8_t low[8], high[8];
        hn::StoreMaskBits(d, hn::Le(enter_low, leave_low), low);
        hn::StoreMaskBits(d, hn::Le(enter_high, leave_high), high);
        return (low[0] & 15u) | (high[0] & 15u) << 4;
    }

  private:
    using D = hn::FixedTag<float, 4>;
    hn::Mask<D> x_, y_;
    hn::Vec<D> near_origin_, far_origin_, rcp_;
};

struct OctreeTraversal {
    static constexpr uint32_t no_node = ~0u;  ///< an empty cell, visited only to be counted

    struct Entry {
        uint32_t node;
        float t_enter, t_leave;
    };

    template <Query Q, class Set, class C>
    static bool run(const Octree<Set>& tree, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (tree.nodes.empty()) return false;
        return test_lists<Q>(tree.mailbox, tree.shapes, set, ray, q, counters,
                             [&](const auto& test)
                                 HWY_ATTR { return follow(tree, ray, q, counters, test); });
    }

  private:
    template <class Set, class C, class Test>
    static HWY_INLINE bool follow(const Octree<Set>& tree, const LocalRay& ray, RayQuery& q,
                                  C& counters, const Test& test) {
        constexpr bool counting = !std::is_same_v<C, NoCounters>;
        const ThickRay thick(tree.box, tree.magnitude, ray, q);
        if (!(thick.t_enter <= thick.t_leave)) return false;
        const uint32_t flip = thick.down;
        OctantIntervals octants(thick);
        Entry stack[7 * Octree<Set>::max_depth + 8];
        Entry* top = stack;
        Entry now{0, thick.t_enter, thick.t_leave};
        while (true) {
            counters.step();
            if (counting && now.node == no_node) {
                counters.cell(true);
            } else if (const OctreeNode& node = tree.nodes[now.node]; node.is_leaf()) {
                counters.cell(false);
                if (test(tree.references.data() + node.first, node.count())) return true;
            } else {
                uint32_t open = octants.set(node, now.t_enter, now.t_leave);
                const uint32_t filled = in_ray_order(node.children, flip);
                if (!counting) open &= filled;
                const auto child = [&](uint32_t k) {
                    const bool empty = counting && !(filled >> k & 1);
                    return Entry{empty ? no_node : node.child(k ^ flip), octants.enter[k],
                                 octants.leave[k]};
                };
                // The last one first; the first one is next at once.
                while (open & (open - 1)) {
                    const uint32_t k = 31 - uint32_t(std::countl_zero(open));
                    open ^= 1u << k;
                    *top++ = child(k);
                }
                if (open) {
                    now = child(uint32_t(std::countr_zero(open)));
                    continue;
                }
            }
            // Overlapping intervals do not begin in strict order, so each is looked at.
            do {
                if (top == stack) return false;
                now = *--top;
            } while (now.t_enter > q.t_cull);
            now.t_leave = std::min(now.t_leave, q.t_cull);
        }
    }
    /// The mask of a node's children, renumbered from the ray's point of view: bit k is child
    /// k ^ flip. The same three choices for all of a ray's nodes.
    static HWY_INLINE uint32_t in_ray_order(uint32_t children, uint32_t flip) {
        if (flip & 1) children = (children & 0x55) << 1 | (children & 0xaa) >> 1;
        if (flip & 2) children = (children & 0x33) << 2 | (children & 0xcc) >> 2;
        if (flip & 4) children = (children & 0x0f) << 4 | (children & 0xf0) >> 4;
        return children;
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(Octree, OctreeTraversal, OctreeParameters)

#if HWY_ONCE
#include "accelerators/kd_build.h"
#include "accelerators/leaves.h"
#include "framework/parallel.h"

namespace crofton {
namespace {

constexpr size_t parallel_size = 4096;  // fewer references are not worth a task
constexpr size_t collapse_size = 64;    // at most so many are kept to turn into a leaf again
constexpr int patience = 3;             // splits in a row that do not pay

using References = BuildReferences;

/// Box of child k of a cell.
Bounds3 octant(const Bounds3& cell, const float (&plane)[3], uint32_t k) {
    Bounds3 b = cell;
    for (uint32_t a = 0; a < 3; ++a) (k >> a & 1 ? b.lower : b.upper)[a] = plane[a];
    return b;
}

/// A subtree in the making, without its root; indices count from its own beginning.
struct OctreeFragment {
    std::vector<OctreeNode> nodes;
    std::vector<uint32_t> references;

    static OctreeNode moved(OctreeNode n, uint32_t node_base, uint32_t reference_base) {
        n.first += n.is_leaf() ? reference_base : node_base;
        return n;
    }
    /// @return the subtree's root, as it is to stand here
    OctreeNode append(const OctreeFragment& f, const OctreeNode& root) {
        const uint32_t node_base = uint32_t(nodes.size()), base = uint32_t(references.size());
        for (const OctreeNode& n : f.nodes) nodes.push_back(moved(n, node_base, base));
        references.insert(references.end(), f.references.begin(), f.references.end());
        return moved(root, node_base, base);
    }
};

class OctreeBuilder {
  public:
    OctreeBuilder(const ClipShape& clip, const OctreeParameters& p, const TreeCosts& costs,
                  int max_depth)
        : clip_(clip), parameters_(p), costs_(costs), max_depth_(max_depth) {}

    /// Appends what is below the node to `out`.
    /// @param bad     splits above this node that did not pay
    /// @param budget  references that the subtree may have, at least as many as there are
    /// @param cost    nominal ns of a line that meets the cell
    OctreeNode build(References references, const Bounds3& cell, int depth, int bad, size_t budget,
                     OctreeFragment& out, double& cost) {
        const uint32_t n = uint32_t(references.size());
        double sum = 0;
        for (const BuildReference& r : references) sum += r.cost;
        const double leaf_cost = cost = costs_.leaf(sum, n);
        Children children;
        if (n <= uint32_t(parameters_.max_leaf_size) || depth >= max_depth_ ||
            !choose_planes(references, cell, children.plane))
            return make_leaf(references, out);
        distribute(references, cell, children);
        const bool pays = children.cost(costs_) < leaf_cost;
        if (!pays && ++bad >= patience) return make_leaf(references, out);
        if (children.total() > budget) return make_leaf(references, out);
        const bool keep = n <= collapse_size || !pays;
        if (!keep) References().swap(references);

        const size_t node_count = out.nodes.size(), reference_count = out.references.size();
        const OctreeNode node = build_children(children, depth, bad, budget, out, cost);
        if (!keep || cost < leaf_cost) return node;
        out.nodes.resize(node_count);
        out.references.resize(reference_count);
        cost = leaf_cost;
        return make_leaf(references, out);
    }

  private:
    struct Children {
        float plane[3];
        Bounds3 box[8];
        double share[8];  ///< of the lines through the cell that meet the child
        References references[8];

        size_t total() const {
            size_t n = 0;
            for (const References& r : references) n += r.size();
            return n;
        }
        /// Of the cell if every child is a leaf.
        double cost(const TreeCosts& costs) const {
            double c = costs.node;
            for (int k = 0; k < 8; ++k) {
                double sum = 0;
                for (const BuildReference& r : references[k]) sum += r.cost;
                c += share[k] * costs.leaf(sum, uint32_t(references[k].size()));
            }
            return c;
        }
    };

    static OctreeNode make_leaf(const References& references, OctreeFragment& out) {
        const OctreeNode leaf =
            OctreeNode::leaf(uint32_t(out.references.size()), uint32_t(references.size()));
        for (const BuildReference& r : references) out.references.push_back(r.shape);
        return leaf;
    }

    /// @return false where the cell cannot be cut: it is met by no line, or a float thin
    bool choose_planes(const References& references, const Bounds3& cell, float (&plane)[3]) const {
        const SplitCost cost(cell, costs_, 0);
        if (cost.degenerate()) return false;
        const Vec3f center = cell.center();
        bool any = false;
        for (int a = 0; a < 3; ++a) {
            SplitPlane best;
            if (parameters_.planes == OctreePlanes::sah)
                try_binned_planes(references, cost, a, parameters_.bins, best);
            plane[a] = best.axis == a ? best.position : center[a];
            any |= cost.inside(a, plane[a]);
        }
        return any;
    }

    /// Puts every shape into the octants that it meets: an axis at a time, as a plane of a kd-tree
    /// would, so that it is clipped only where it straddles one.
    void distribute(const References& references, const Bounds3& cell, Children& c) const {
        const double area = half_area(cell);
        for (uint32_t k = 0; k < 8; ++k) {
            c.box[k] = octant(cell, c.plane, k);
            c.share[k] = half_area(c.box[k]) / area;
        }
        for (const BuildReference& r : references) {
            uint32_t below = 0, above = 0;
            for (int a = 0; a < 3; ++a) {
                below |= uint32_t(r.bounds.lower[a] < c.plane[a]) << a;
                above |= uint32_t(r.bounds.upper[a] > c.plane[a]) << a;
                // In the plane, or of no extent: the side does not matter to a thick ray.
                if (!(below >> a & 1) && !(above >> a & 1)) below |= 1u << a;
            }
            const bool straddles = (below & above) != 0;
            bool placed = false;
            for (uint32_t k = 0; k < 8; ++k) {
                if ((k & ~above) != 0 || (~k & 7 & ~below) != 0) continue;
                Bounds3 part = r.bounds;
                if (straddles) part = intersection(clip_(r.shape, c.box[k]), r.bounds);
                if (part.empty()) continue;
                c.references[k].push_back({part, r.shape, r.cost});
                placed = true;
            }
            // A shape that only touches this cell may be rounded away everywhere: keep its box.
            if (!placed) {
                const uint32_t k = above & ~below & 7;
                c.references[k].push_back({intersection(r.bounds, c.box[k]), r.shape, r.cost});
            }
        }
    }

    OctreeNode build_children(Children& c, int depth, int bad, size_t budget, OctreeFragment& out,
                              double& cost) {
        OctreeNode node{{c.plane[0], c.plane[1], c.plane[2]}, uint32_t(out.nodes.size()), 0};
        const size_t total = c.total();
        uint32_t filled[8], n = 0;
        size_t budgets[8];
        for (uint32_t k = 0; k < 8; ++k) {
            if (c.references[k].empty()) continue;
            node.children |= 1u << k;
            // In proportion: no share is less than what its child holds now.
            budgets[n] = budget * c.references[k].size() / total;
            filled[n++] = k;
        }
        out.nodes.resize(out.nodes.size() + n);

        double costs[8];
        const auto child = [&](size_t i, OctreeFragment& to) {
            const uint32_t k = filled[i];
            return build(std::move(c.references[k]), c.box[k], depth + 1, bad, budgets[i], to,
                         costs[i]);
        };
        if (total >= parallel_size) {
            OctreeFragment fragments[8];
            OctreeNode roots[8];
            parallel_for(n, 1, [&](size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) roots[i] = child(i, fragments[i]);
            });
            for (uint32_t i = 0; i < n; ++i)
                out.nodes[node.first + i] = out.append(fragments[i], roots[i]);
        } else {
            for (uint32_t i = 0; i < n; ++i) {
                const OctreeNode made = child(i, out);
                out.nodes[node.first + i] = made;
            }
        }
        cost = costs_.node;
        for (uint32_t i = 0; i < n; ++i) cost += c.share[filled[i]] * costs[i];
        return node;
    }

    const ClipShape& clip_;
    const OctreeParameters& parameters_;
    TreeCosts costs_;
    int max_depth_;
};

}  // namespace

template <class Set>
Octree<Set> Octree<Set>::build(const Set& set, const OctreeParameters& p) {
    Octree tree;
    References shapes = build_references(set);
    if (shapes.empty()) return tree;
    const double n = double(shapes.size());
    double cost_sum = 0;
    for (const BuildReference& r : shapes) {
        tree.box.extend(r.bounds);
        cost_sum += r.cost;
    }
    const ClipShape clip = [&](uint32_t i, const Bounds3& box) {
        return set.clipped_bounds(i, box);
    };
    const int automatic = int(std::lround(3 + 0.45 * std::log2(n)));
    const int depth = p.max_depth > 0 ? p.max_depth : std::min(automatic, max_depth);
    OctreeFragment all;
    all.nodes.emplace_back();
    OctreeBuilder builder(clip, p, reference_costs<Set>(cost_constants.octree_node), depth);
    all.nodes[0] =
        builder.build(std::move(shapes), tree.box, 0, 0, size_t(16 * n) + 1024, all, tree.cost);

    tree.nodes.assign(all.nodes.begin(), all.nodes.end());
    tree.references.assign(all.references.begin(), all.references.end());
    tree.shapes = ShapeStore<Set>(set);
    for (const OctreeNode& node : tree.nodes)
        if (node.is_leaf())
            tree.shapes.place(set, std::span(tree.references).subspan(node.first, node.count()));
    tree.shapes.finish();
    tree.magnitude = tree.box.magnitude();
    tree.walk([&](const Bounds3&, uint32_t d, bool leaf, uint32_t references) {
        tree.stats.N_IN += !leaf;
        tree.stats.N_V += leaf;
        tree.stats.N_EV += leaf && references == 0;
        tree.stats.N_OIV += references;
        tree.stats.depth = std::max(tree.stats.depth, d);
    });
    tree.stats.bytes = tree.nodes.size() * sizeof(OctreeNode) +
                       tree.references.size() * sizeof(uint32_t) + tree.shapes.bytes();
    tree.mailbox = wants_mailbox(p.mailbox, std::is_same_v<Set, ObjectSet>,
                                 double(tree.stats.N_OIV), n, cost_sum / n);
    return tree;
}

template <class Set>
void Octree<Set>::walk(const BoxVisitor& visit) const {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
        Bounds3 cell;
    };
    std::vector<Open> open{{0, 0, box}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const OctreeNode& n = nodes[o.node];
        visit(o.cell, o.depth, n.is_leaf(), n.is_leaf() ? n.count() : 0);
        for (uint32_t k = 0; !n.is_leaf() && k < 8; ++k) {
            const Bounds3 cell = octant(o.cell, n.plane, k);
            if (n.children >> k & 1)
                open.push_back({n.child(k), o.depth + 1, cell});
            else
                visit(cell, o.depth + 1, true, 0);
        }
    }
}

CROFTON_REGISTER_ACCELERATOR(
    Octree, OctreeParameters, "octree",
    "cells cut into eight, with the planes centred or placed by area",
    "Glassner 1984; Whang et al. 1995 (Octree-R); walk: Revelles et al. 2000");

}  // namespace crofton
#endif
