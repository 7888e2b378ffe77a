#include "accelerators/sphere_hierarchy.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/sphere_hierarchy.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// What the test of one node gives: its children, decoded, and where the ray is in each.
struct alignas(16) FourHits {
    float x[4], y[4], z[4], r[4];
    float along[4];  ///< distance along the ray of the point nearest to the centre
    float near[4];   ///< and of the first point inside
};

/// Decodes the children of a node and tests all four. No fused operations: `decoded` must give the
/// same bits, and so must every instruction set where rays may end at a sphere.
class FourSphereTest {
  public:
    using D = hn::FixedTag<float, 4>;
    using V = hn::Vec<D>;

    FourSphereTest(const SphereRay& ray, const RayQuery& q) : slack_(hn::Set(D(), ray.slack)) {
        for (int a = 0; a < 3; ++a) {
            p_[a] = hn::Set(D(), ray.p[a]);
            d_[a] = hn::Set(D(), ray.d[a]);
        }
        begin_ = hn::Set(D(), ray.begin(q.t_low));
        shrink(ray, q);
    }
    void shrink(const SphereRay& ray, const RayQuery& q) { end_ = hn::Set(D(), ray.end(q.t_cull)); }
    bool is_beyond(float distance) const { return distance > hn::GetLane(end_); }

    /// @return bit i: child i may be hit
    HWY_INLINE uint32_t test(const SphereNode& node, const NodeSphere& parent,
                             FourHits& hits) const {
        const D d;
        const V step = hn::Set(d, parent.r * SphereNode::center_step);
        const V x = hn::Add(hn::Set(d, parent.c[0]), hn::Mul(load(node.x), step));
        const V y = hn::Add(hn::Set(d, parent.c[1]), hn::Mul(load(node.y), step));
        const V z = hn::Add(hn::Set(d, parent.c[2]), hn::Mul(load(node.z), step));
        const V r = hn::Mul(load(node.r), hn::Set(d, parent.r * SphereNode::radius_step));
        hn::Store(x, d, hits.x);
        hn::Store(y, d, hits.y);
        hn::Store(z, d, hits.z);
        hn::Store(r, d, hits.r);

        const V vx = hn::Sub(x, p_[0]), vy = hn::Sub(y, p_[1]), vz = hn::Sub(z, p_[2]);
        const V along =
            hn::Add(hn::Add(hn::Mul(vx, d_[0]), hn::Mul(vy, d_[1])), hn::Mul(vz, d_[2]));
        // The vector across, rather than |v|² - along², which would cancel.
        const V wx = hn::Sub(vx, hn::Mul(along, d_[0])), wy = hn::Sub(vy, hn::Mul(along, d_[1])),
                wz = hn::Sub(vz, hn::Mul(along, d_[2]));
        const V across2 = hn::Add(hn::Add(hn::Mul(wx, wx), hn::Mul(wy, wy)), hn::Mul(wz, wz));
        const V reach = hn::Add(r, slack_);
        const V chord2 = hn::Sub(hn::Mul(reach, reach), across2);
        const V chord = hn::Sqrt(hn::Max(chord2, hn::Zero(d)));
        const V near = hn::Sub(along, chord), far = hn::Add(along, chord);
        hn::Store(along, d, hits.along);
        hn::Store(near, d, hits.near);
        const auto met = hn::And(hn::Ge(chord2, hn::Zero(d)), hn::Gt(r, hn::Zero(d)));
        const auto in_time = hn::And(hn::Le(near, end_), hn::Ge(far, begin_));
        uint8_t bits[8];
        hn::StoreMaskBits(d, hn::And(met, in_time), bits);
        return bits[0] & 15u;
    }

  private:
    template <class Byte>
    static HWY_INLINE V load(const Byte (&bytes)[4]) {
        const hn::FixedTag<Byte, 4> b;
        return hn::ConvertTo(D(), hn::PromoteTo(hn::FixedTag<int32_t, 4>(), hn::LoadU(b, bytes)));
    }

    V p_[3], d_[3], slack_, begin_, end_;
};

struct SphereHierarchyTraversal {
    struct Entry {
        NodeSphere sphere;
        float near;
        uint32_t index, count;  ///< an inner node, or where a leaf's references begin
    };

    template <Query Q, class Set, class C>
    static bool run(const SphereHierarchy<Set>& h, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        float t_near, t_far;
        if (h.nodes.empty() || !meets_box(h.box, ray, q, t_near, t_far)) return false;
        const SphereRay along(h, ray, q);
        if (!along.meets_root) return false;
        if constexpr (SphereHierarchy<Set>::has_lod) {
            if (HWY_UNLIKELY(h.lod > 0)) {
                const Footprint footprint(h, along, ray, q);
                // The root is no one's child, so it is looked at here.
                float across2 = 0;
                for (const float x : along.p) across2 += x * x;
                const float reach = h.root.r + along.slack;
                const float near = -std::sqrt(std::max(reach * reach - across2, 0.0f));
                if (HWY_UNLIKELY(footprint.replaces(h.root.r, near)))
                    return end_at<Q>(0, h.representative(h.nodes[0], 0), along, set, q);
                return follow<Q, true>(h, set, ray, along, footprint, q, counters);
            }
        }
        return follow<Q, false>(h, set, ray, along, {}, q, counters);
    }

  private:
    struct NoFootprint {
        bool replaces(float, float) const { return false; }
    };

    /// Front to back with an explicit stack: a node's children are put on it with the nearest on
    /// top; those that begin beyond the best hit are dropped.
    template <Query Q, bool Lod, class Set, class C>
    static HWY_INLINE bool follow(const SphereHierarchy<Set>& h, const Set& set,
                                  const LocalRay& ray, const SphereRay& along,
                                  const std::conditional_t<Lod, Footprint, NoFootprint>& footprint,
                                  RayQuery& q, C& counters) {
        const SphereNode* nodes = h.nodes.data();
        FourSphereTest spheres(along, q);
        // A node takes one entry off and puts up to four on.
        Entry stack[3 * SphereHierarchy<Set>::max_depth + 4];
        Entry* top = stack;
        Entry current{h.root, 0, 0, 0};
        while (true) {
            counters.step();
            if (current.count == 0) {
                const SphereNode& node = nodes[current.index];
                FourHits hits;
                const uint32_t met = spheres.test(node, current.sphere, hits);
                Entry* const base = top;
                uint32_t child = node.child, first = node.first;
                for (int i = 0; i < 4; ++i) {
                    const uint32_t count = node.count[i];
                    const uint32_t index = count == 0 ? child++ : first;
                    first += count;
                    if (!(met >> i & 1)) continue;
                    if constexpr (Lod) {
                        if (footprint.replaces(hits.r[i], hits.near[i])) {
                            if (end_at<Q>(hits.along[i], h.representative(node, i), along, set, q))
                                return true;
                            spheres.shrink(along, q);
                            continue;
                        }
                    }
                    Entry* at = top++;
                    for (; at > base && at[-1].near < hits.near[i]; --at) *at = at[-1];
                    *at = {
                        {{hits.x[i], hits.y[i], hits.z[i]}, hits.r[i]}, hits.near[i], index, count};
                }
            } else {
                counters.cell(false);
                if (test_references<Q>(set, h.references.data() + current.index, current.count, ray,
                                       q, counters))
                    return true;
                spheres.shrink(along, q);
            }
            do {
                if (top == stack) return false;
                current = *--top;
            } while (spheres.is_beyond(current.near));
        }
    }

    /// Ends the ray at a sphere: on a disc across the ray, through the centre.
    /// @return whether an `any` query is answered
    template <Query Q, class Set>
    static bool end_at(float distance, uint32_t shape, const SphereRay& along, const Set& set,
                       RayQuery& q) {
        const float t = along.t_of(distance);
        if (!(t >= q.t_min && t <= q.t_best)) return false;
        if constexpr (Q == Query::closest) q.record(t, 0, 0, set.ids(), shape);
        return Q == Query::any;
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(SphereHierarchy, SphereHierarchyTraversal, SphereHierarchyParameters)

#if HWY_ONCE
#include "accelerators/enclosing_sphere.h"
#include "accelerators/leaves.h"
#include "framework/parallel.h"

namespace crofton {
namespace {

/// The smallest radius byte, for given bytes of the centre, with which a child contains `tight`;
/// 0 if none does. `tight` in the space of NodeSpheres.
uint8_t radius_byte(SphereNode& node, int i, const NodeSphere& parent,
                    const EnclosingSphere& tight) {
    node.r[i] = 255;
    const NodeSphere widest = decoded(node, i, parent);
    const Vec3d c(widest.c[0], widest.c[1], widest.c[2]);
    const double needed = (c - tight.center).norm() + tight.radius;
    if (!(needed <= widest.r)) return 0;
    const double steps = std::ceil(255 * needed / widest.r);
    node.r[i] = uint8_t(std::clamp(steps, 1.0, 255.0));
    // Rounded outwards after decoding: what counts is the sphere that a ray will see.
    while (decoded(node, i, parent).r < needed) ++node.r[i];
    return node.r[i];
}

/// Writes `tight` as child i. What stands in the child stands in the parent, too: where bytes
/// cannot hold the tight sphere within the parent's, the parent's own sphere serves.
void encode(SphereNode& node, int i, const NodeSphere& parent, const EnclosingSphere& tight) {
    int8_t* bytes[3] = {&node.x[i], &node.y[i], &node.z[i]};
    const double step = double(parent.r) * SphereNode::center_step;
    for (int a = 0; a < 3; ++a)
        *bytes[a] =
            int8_t(std::lround(std::clamp((tight.center[a] - parent.c[a]) / step, -127.0, 127.0)));
    node.r[i] = radius_byte(node, i, parent, tight);
    const NodeSphere s = decoded(node, i, parent);
    // Centres stay inside the root, as SphereRay supposes.
    if (node.r[i] > 0 && Vec3d(s.c[0], s.c[1], s.c[2]).norm() <= 1) return;
    for (int a = 0; a < 3; ++a) *bytes[a] = 0;
    node.r[i] = 255;
}

/// Makes four-wide nodes of a binary tree, depth first.
template <class Set>
class SphereWriter {
  public:
    SphereWriter(SphereHierarchy<Set>& h, const BinaryTree& tree, const Set& set,
                 const TreeCosts& costs, std::vector<float> shape_costs)
        : h_(h),
          tree_(tree),
          costs_(costs),
          shape_costs_(std::move(shape_costs)),
          spheres_(tree.nodes.size()) {
        enclose(set);
        collapse();
    }

    void write() {
        struct Open {
            uint32_t from, to, depth;
            NodeSphere sphere;
        };
        set_root();
        h_.nodes.emplace_back();
        std::vector<Open> open{{0, 0, 0, h_.root}};
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            ++h_.stats.N_IN;
            h_.cost += probability(o.sphere) * cost_constants.four_spheres_node;
            const std::vector<uint32_t> children = open_children(o.from);
            SphereNode node{};
            node.child = uint32_t(h_.nodes.size());
            node.first = uint32_t(h_.references.size());
            for (int i = 0; i < int(children.size()); ++i) {
                const BinaryTree::Node& child = tree_.nodes[children[i]];
                encode(node, i, o.sphere, relative(spheres_[children[i]]));
                const NodeSphere s = decoded(node, i, o.sphere);
                if (h_.lod > 0 && SphereHierarchy<Set>::has_lod) h_.box.extend(h_.box_of(s));
                if (child.leaf()) {
                    node.count[i] = uint8_t(child.count);
                    add_leaf(child, s, o.depth + 1);
                } else {
                    open.push_back({children[i], uint32_t(h_.nodes.size()), o.depth + 1, s});
                    h_.nodes.emplace_back();
                }
            }
            h_.nodes[o.to] = node;
        }
    }

  private:
    /// Spheres around everything below each node of the binary tree.
    void enclose(const Set& set) {
        std::vector<Ball> balls;
        std::vector<std::pair<uint32_t, uint32_t>> range(tree_.nodes.size());
        // Twice through each inner node: on the way down, and when its subtree is done.
        std::vector<std::pair<uint32_t, bool>> open{{0, false}};
        while (!open.empty()) {
            const auto [n, done] = open.back();
            open.pop_back();
            const BinaryTree::Node& node = tree_.nodes[n];
            if (!done) {
                range[n].first = uint32_t(balls.size());
                order_.push_back(n);
            }
            if (node.leaf()) {
                for (uint32_t i = 0; i < node.count; ++i)
                    add_balls(set, tree_.order[node.first + i], balls);
            } else if (!done) {
                open.push_back({n, true});
                open.push_back({node.right, false});
                open.push_back({node.left, false});
                continue;
            }
            range[n].second = uint32_t(balls.size());
        }
        parallel_for(tree_.nodes.size(), 64, [&](size_t begin, size_t end) {
            for (size_t n = begin; n < end; ++n)
                spheres_[n] = enclosing_sphere(
                    std::span(balls).subspan(range[n].first, range[n].second - range[n].first));
        });
    }

    void set_root() {
        const EnclosingSphere& s = spheres_[0];
        h_.center = s.center;
        // One point has no radius; any that floats can work with will do.
        const double radius = std::max(s.radius, 0x1p-120);
        h_.unit = std::ldexp(1.0, std::ilogb(radius) + 1);
        h_.root = {{0, 0, 0}, std::min(1.0f, float(radius / h_.unit * (1 + 0x1p-22)))};
    }

    EnclosingSphere relative(const EnclosingSphere& s) const {
        // Doubles round, too, but far below anything that a float holds.
        return {(s.center - h_.center) / h_.unit, s.radius / h_.unit * (1 + 0x1p-40) + 0x1p-50};
    }

    /// Which inner nodes of the binary tree get a wide node of their own, so that wide nodes are
    /// few and seldom visited: dynamic programming from the leaves up (Ylitie, Karras, Laine 2017).
    void collapse() {
        plans_.resize(tree_.nodes.size());
        const double area = std::max(spheres_[0].radius * spheres_[0].radius, 1e-300);
        const double each = node_weight / double(order_.size());
        for (auto n = order_.rbegin(); n != order_.rend(); ++n) {  // children first
            const BinaryTree::Node& node = tree_.nodes[*n];
            if (node.leaf()) continue;
            const Plan &left = plans_[node.left], &right = plans_[node.right];
            Plan& plan = plans_[*n];
            for (int slots = 2; slots <= 4; ++slots) {
                plan.cost[slots] = std::numeric_limits<double>::infinity();
                for (int l = 1; l < slots; ++l)
                    if (const double c = left.cost[l] + right.cost[slots - l];
                        c < plan.cost[slots]) {
                        plan.cost[slots] = c;
                        plan.left[slots] = uint8_t(l);
                    }
            }
            const double share = spheres_[*n].radius * spheres_[*n].radius / area;
            plan.cost[1] = plan.cost[4] + share + each;
            for (int slots = 2; slots < 4; ++slots)
                if (plan.cost[1] <= plan.cost[slots]) {
                    plan.cost[slots] = plan.cost[1];
                    plan.left[slots] = 0;
                }
        }
    }

    /// The children of the wide node that stands for `root`, the largest sphere first.
    std::vector<uint32_t> open_children(uint32_t root) const {
        std::vector<uint32_t> children;
        std::vector<std::pair<uint32_t, int>> open{{root, 4}};  // node, slots
        while (!open.empty()) {
            const auto [n, slots] = open.back();
            open.pop_back();
            const int left = plans_[n].left[slots];
            if (left == 0) {
                children.push_back(n);
                continue;
            }
            open.push_back({tree_.nodes[n].right, slots - left});
            open.push_back({tree_.nodes[n].left, left});
        }
        std::stable_sort(children.begin(), children.end(), [&](uint32_t a, uint32_t b) {
            return spheres_[a].radius > spheres_[b].radius;
        });
        return children;
    }

    void add_leaf(const BinaryTree::Node& leaf, const NodeSphere& sphere, uint32_t depth) {
        double sum = 0;
        for (uint32_t i = 0; i < leaf.count; ++i) {
            const uint32_t shape = tree_.order[leaf.first + i];
            h_.references.push_back(shape);
            if (!shape_costs_.empty()) sum += shape_costs_[shape];
        }
        h_.cost += probability(sphere) * costs_.leaf(sum, leaf.count);
        ++h_.stats.N_V;
        h_.stats.N_OIV += leaf.count;
        h_.stats.depth = std::max(h_.stats.depth, depth);
    }

    /// Of meeting a sphere, for a random line that meets the box: areas of convex bodies.
    double probability(const NodeSphere& s) const {
        const double r = h_.unit * s.r, area = surface_area(tree_.nodes[0].bounds);
        return area > 0 ? std::min(1.0, 4 * 3.141592653589793 * r * r / area) : 1.0;
    }

    /// How a subtree goes into some of its parent's four slots.
    struct Plan {
        double cost[5] = {};   ///< of its wide nodes, by the number of slots
        uint8_t left[5] = {};  ///< slots that the left child gets; 0: the subtree takes one itself
    };
    /// All nodes together weigh as much as so many visits of the root.
    static constexpr double node_weight = 100;

    SphereHierarchy<Set>& h_;
    const BinaryTree& tree_;
    TreeCosts costs_;
    std::vector<float> shape_costs_;
    std::vector<EnclosingSphere> spheres_;  ///< of the binary nodes
    std::vector<uint32_t> order_;           ///< binary nodes, parents first
    std::vector<Plan> plans_;               ///< of the binary nodes
};

}  // namespace

template <class Set>
SphereHierarchy<Set> SphereHierarchy<Set>::build(const Set& set,
                                                 const SphereHierarchyParameters& p) {
    SphereHierarchy h;
    h.lod = p.lod;
    // A field of 45 degrees over 512 pixels, if nobody knows better.
    h.pixel_angle = p.pixel_angle > 0 ? p.pixel_angle : 2 * 0.41421356237 / 512;
    h.pixel_width = p.pixel_width;
    // A node of four replaces three binary ones.
    const TreeCosts costs = reference_costs<Set>(cost_constants.four_spheres_node / 3);
    const BinaryTree tree = build_tree(set, p, costs);
    if (tree.empty()) return h;
    h.box = tree.nodes[0].bounds;
    h.magnitude = h.box.magnitude();
    SphereWriter<Set>(h, tree, set, costs, shape_costs(set, costs)).write();
    h.nodes.shrink_to_fit();
    h.references.shrink_to_fit();
    h.stats.bytes = h.nodes.size() * sizeof(SphereNode) + h.references.size() * sizeof(uint32_t);
    return h;
}

template <class Set>
uint32_t SphereHierarchy<Set>::representative(const SphereNode& node, int i) const {
    uint32_t child = node.child, first = node.first;
    for (int k = 0; k < i; ++k) {
        child += node.count[k] == 0;
        first += node.count[k];
    }
    if (node.count[i] > 0) return references[first];
    const SphereNode* at = &nodes[child];
    while (at->count[0] == 0) at = &nodes[at->child];
    return references[at->first];
}

template <class Set>
Bounds3 SphereHierarchy<Set>::box_of(const NodeSphere& s) const {
    Bounds3 b;
    for (int a = 0; a < 3; ++a) {
        const double c = center[a] + unit * s.c[a], r = unit * s.r;
        b.lower[a] = float(c - r);
        b.upper[a] = float(c + r);
    }
    return widened(b, 0x1p-23f);
}

template <class Set>
void SphereHierarchy<Set>::walk(const BoxVisitor& visit) const {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
        NodeSphere sphere;
    };
    visit(box, 0, false, 0);
    std::vector<Open> open{{0, 0, root}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const SphereNode& n = nodes[o.node];
        uint32_t child = n.child;
        for (int i = 0; i < 4 && n.r[i] > 0; ++i) {
            const NodeSphere s = decoded(n, i, o.sphere);
            visit(intersection(box_of(s), box), o.depth + 1, n.count[i] > 0, n.count[i]);
            if (n.count[i] == 0) open.push_back({child++, o.depth + 1, s});
        }
    }
}

template struct SphereHierarchy<TriangleSet>;
template struct SphereHierarchy<QuadricSet>;
template struct SphereHierarchy<PolygonSet>;
template struct SphereHierarchy<ObjectSet>;

CROFTON_REGISTER_ACCELERATOR(
    SphereHierarchy, SphereHierarchyParameters, "sphere_hierarchy",
    "quantised bounding spheres, four a node; rays may end where spheres are smaller than a pixel",
    "Rusinkiewicz & Levoy 2000: QSplat; Rubin & Whitted 1980");

}  // namespace crofton
#endif
