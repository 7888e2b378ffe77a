#include "accelerators/bvh.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/bvh.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Tests both children of a node at once: lanes 0 and 1 hold where the ray enters each child, lanes
/// 2 and 3 minus where it leaves, so that one maximum serves both.
class ChildPairTest {
  public:
    using D = hn::FixedTag<float, 4>;
    using V = hn::Vec<D>;

    ChildPairTest(const LocalRay& ray, const RayQuery& q) {
        const D d;
        alignas(16) static constexpr int32_t orders[2][4] = {{0, 1, 2, 3}, {2, 3, 0, 1}};
        for (int a = 0; a < 3; ++a) {
            origin_[a] = hn::ConcatLowerLower(d, hn::Set(d, ray.far_origin[a]),
                                              hn::Set(d, ray.near_origin[a]));
            rcp_[a] = hn::ConcatLowerLower(d, hn::Set(d, -ray.far_rcp[a]), hn::Set(d, ray.rcp[a]));
            // A ray that goes down an axis meets uppers first: swap the halves.
            order_[a] = hn::SetTableIndices(d, orders[std::signbit(ray.rcp[a])]);
        }
        shrink(q);
    }
    void shrink(const RayQuery& q) {
        limits_ = hn::ConcatLowerLower(D(), hn::Set(D(), -q.t_cull), hn::Set(D(), q.t_low));
    }
    /// @param t_near  lanes 0 and 1: where the ray enters each child
    /// @return bit i: child i may be hit
    HWY_INLINE uint32_t test(const BvhNode& node, float* HWY_RESTRICT t_near) const {
        const D d;
        V t = limits_;
        for (int a = 0; a < 3; ++a) {
            const V planes = hn::TableLookupLanes(hn::Load(d, node.bounds[a]), order_[a]);
            t = hn::Max(hn::Mul(hn::Sub(planes, origin_[a]), rcp_[a]), t);
        }
        const V leave = hn::Neg(hn::Shuffle1032(t));
        hn::Store(t, d, t_near);
        uint8_t bits[8];
        hn::StoreMaskBits(d, hn::Le(t, leave), bits);
        return bits[0] & 3u;
    }

  private:
    V origin_[3], rcp_[3], limits_;
    decltype(hn::IndicesFromVec(D(), hn::Zero(hn::RebindToSigned<D>()))) order_[3];
};

/// The same for spheres, in double: both children as two lanes.
class SpherePairTest {
  public:
    SpherePairTest(const LocalRay& ray, const RayQuery& q, float magnitude) {
        const VolumeRay thick(ray, magnitude);
        double dd = 0;
        for (int a = 0; a < 3; ++a) {
            origin_[a] = ray.origin[a];
            direction_[a] = ray.direction[a];
            dd += direction_[a] * direction_[a];
            thickness_ += thick.thickness[a];
        }
        inverse_dd_ = 1 / dd;
        t_low_ = q.t_low;
        shrink(q);
    }
    void shrink(const RayQuery& q) { t_cull_ = q.t_cull; }

    HWY_INLINE uint32_t test(const SpherePair& node, float* HWY_RESTRICT t_near) const {
        const hn::FixedTag<double, 2> d;
        const hn::FixedTag<float, 2> f;
        hn::Vec<decltype(d)> to_center[3];
        auto along = hn::Zero(d);
        for (int a = 0; a < 3; ++a) {
            to_center[a] =
                hn::Sub(hn::PromoteTo(d, hn::LoadU(f, node.center[a])), hn::Set(d, origin_[a]));
            along = hn::Add(along, hn::Mul(to_center[a], hn::Set(d, direction_[a])));
        }
        // From the point nearest to the centre, so that a far origin costs no digits.
        const auto t = hn::Mul(along, hn::Set(d, inverse_dd_));
        auto apart = hn::Zero(d);
        for (int a = 0; a < 3; ++a) {
            const auto x = hn::Sub(to_center[a], hn::Mul(t, hn::Set(d, direction_[a])));
            apart = hn::Add(apart, hn::Mul(x, x));
        }
        const auto radius = hn::PromoteTo(d, hn::LoadU(f, node.radius));
        const auto thick = hn::Add(radius, hn::Set(d, thickness_));
        const auto h2 = hn::Sub(hn::Mul(thick, thick), apart);
        const auto half = hn::Sqrt(hn::Mul(hn::Max(h2, hn::Zero(d)), hn::Set(d, inverse_dd_)));
        const auto enter = hn::Sub(t, half), leave = hn::Add(t, half);
        const auto within =
            hn::And(hn::And(hn::Ge(h2, hn::Zero(d)), hn::Ge(radius, hn::Zero(d))),
                    hn::And(hn::Le(enter, hn::Set(d, t_cull_)), hn::Ge(leave, hn::Set(d, t_low_))));
        hn::StoreU(hn::DemoteTo(f, enter), f, t_near);
        uint8_t bits[8];
        hn::StoreMaskBits(d, within, bits);
        return bits[0] & 3u;
    }

  private:
    double origin_[3], direction_[3], inverse_dd_, thickness_ = 0;
    double t_low_, t_cull_;
};

/// Where a ray is in all of N slabs. `down`: it meets the upper planes first.
template <class D>
struct SlabInterval {
    float near, far;
    HWY_INLINE SlabInterval(D d, hn::Vec<D> lower, hn::Vec<D> upper, hn::Vec<D> origin,
                            hn::Vec<D> thickness, hn::Vec<D> rcp) {
        const auto down = hn::Lt(rcp, hn::Zero(d));  // 1/x is never 0
        const auto shift = hn::CopySign(thickness, rcp);
        const auto first = hn::IfThenElse(down, upper, lower);
        const auto second = hn::IfThenElse(down, lower, upper);
        near = hn::GetLane(hn::MaxOfLanes(d, hn::Mul(hn::Sub(first, hn::Add(origin, shift)), rcp)));
        far = hn::GetLane(hn::MinOfLanes(d, hn::Mul(hn::Sub(second, hn::Sub(origin, shift)), rcp)));
    }
};

/// 1/x, finite: see LocalRay.
template <class D>
HWY_INLINE hn::Vec<D> finite_inverse(D d, hn::Vec<D> x, float limit) {
    const auto inverse = hn::Div(hn::Set(d, 1.0f), x);
    return hn::CopySign(hn::Min(hn::Abs(inverse), hn::Set(d, limit)), x);
}

inline float rcp_limit(const LocalRay& ray) {
    return 0x1p60f / std::max(std::max(std::abs(ray.direction[0]), std::abs(ray.direction[1])),
                              std::abs(ray.direction[2]));
}

class ObbPairTest {
  public:
    ObbPairTest(const LocalRay& ray, const RayQuery& q, float magnitude)
        : ray_(ray), thick_(ray, magnitude), limit_(rcp_limit(ray)), t_low_(q.t_low) {
        shrink(q);
    }
    void shrink(const RayQuery& q) { t_cull_ = q.t_cull; }

    HWY_INLINE uint32_t test(const ObbPair& node, float* HWY_RESTRICT t_near) const {
        const hn::FixedTag<float, 4> d;
        uint32_t hits = 0;
        for (uint32_t side = 0; side < 2; ++side) {
            const ObbPair::Child& c = node.child[side];
            auto o = hn::Zero(d), v = o, thickness = o;
            for (int a = 0; a < 3; ++a) {
                const auto n = hn::LoadU(d, c.direction[a]);
                o = hn::Add(o, hn::Mul(n, hn::Set(d, ray_.origin[a])));
                v = hn::Add(v, hn::Mul(n, hn::Set(d, ray_.direction[a])));
                thickness =
                    hn::Add(thickness, hn::Mul(hn::Abs(n), hn::Set(d, thick_.thickness[a])));
            }
            const SlabInterval slabs(d, hn::LoadU(d, c.lower), hn::LoadU(d, c.upper), o, thickness,
                                     finite_inverse(d, v, limit_));
            t_near[side] = std::max(slabs.near, t_low_);
            hits |= uint32_t(t_near[side] <= std::min(slabs.far, t_cull_)) << side;
        }
        return hits;
    }

  private:
    const LocalRay& ray_;
    VolumeRay thick_;
    float limit_, t_low_, t_cull_;
};

class KdopPairTest {
  public:
    using D = hn::CappedTag<float, 8>;
    static constexpr size_t N = hn::MaxLanes(D());

    KdopPairTest(const LocalRay& ray, const RayQuery& q, float magnitude) : t_low_(q.t_low) {
        const VolumeRay thick(ray, magnitude);
        const float limit = rcp_limit(ray);
        origin_[7] = thickness_[7] = 0;
        rcp_[7] = 1;
        for (int k = 0; k < 7; ++k) {
            origin_[k] = thickness_[k] = 0;
            float v = 0;
            for (int a = 0; a < 3; ++a) {
                const float n = float(KdopPair::directions[k][a]);
                origin_[k] += n * ray.origin[a];
                v += n * ray.direction[a];
                thickness_[k] += std::abs(n) * thick.thickness[a];
            }
            rcp_[k] = std::copysign(std::min(std::abs(1 / v), limit), v);
        }
        shrink(q);
    }
    void shrink(const RayQuery& q) { t_cull_ = q.t_cull; }

    HWY_INLINE uint32_t test(const KdopPair& node, float* HWY_RESTRICT t_near) const {
        const D d;
        uint32_t hits = 0;
        for (uint32_t side = 0; side < 2; ++side) {
            const KdopPair::Child& c = node.child[side];
            float near = t_low_, far = t_cull_;
            for (size_t i = 0; i < 8; i += N) {
                const SlabInterval slabs(d, hn::LoadU(d, c.lower + i), hn::LoadU(d, c.upper + i),
                                         hn::LoadU(d, origin_ + i), hn::LoadU(d, thickness_ + i),
                                         hn::LoadU(d, rcp_ + i));
                near = std::max(near, slabs.near);
                far = std::min(far, slabs.far);
            }
            t_near[side] = near;
            hits |= uint32_t(near <= far) << side;
        }
        return hits;
    }

  private:
    float origin_[8], thickness_[8], rcp_[8];
    float t_low_, t_cull_;
};

struct BvhTraversal {
    template <Query Q, class Set, class C>
    static bool run(const Bvh<Set>& bvh, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters, TraversalStart start = {}) {
        if (bvh.box.empty()) return false;
        const Entry first{start.index, start.count, 0};
        if (HWY_LIKELY(bvh.volume == BoundingVolume::box)) {
            ChildPairTest pair(ray, q);
            return follow(
                bvh.nodes.data(), pair, first, q, counters, [&](const Entry& leaf) HWY_ATTR {
                    return test_leaf<Q>(set, bvh.leaves, leaf.index, leaf.count, ray, q, counters);
                });
        }
        return run_other<Q>(bvh, set, first, ray, q, counters);
    }

  private:
    struct Entry {
        uint32_t index, count;
        float t_near;
    };

    template <Query Q, class Set, class C>
    static HWY_NOINLINE bool run_other(const Bvh<Set>& bvh, const Set& set, const Entry& first,
                                       const LocalRay& ray, RayQuery& q, C& counters) {
        const float magnitude = bvh.box.magnitude();
        // One copy of the leaf test for the three.
        const auto leaf = [&](const Entry& e) HWY_ATTR {
            return test_leaf_apart<Q>(set, bvh.leaves, e, ray, q, counters);
        };
        if (bvh.volume == BoundingVolume::sphere) {
            SpherePairTest pair(ray, q, magnitude);
            return follow(bvh.spheres.data(), pair, first, q, counters, leaf);
        }
        if (bvh.volume == BoundingVolume::obb) {
            ObbPairTest pair(ray, q, magnitude);
            return follow(bvh.obbs.data(), pair, first, q, counters, leaf);
        }
        KdopPairTest pair(ray, q, magnitude);
        return follow(bvh.kdops.data(), pair, first, q, counters, leaf);
    }
    template <Query Q, class Set, class C>
    static HWY_NOINLINE bool test_leaf_apart(const Set& set, const Leaves<Set>& leaves,
                                             const Entry& e, const LocalRay& ray, RayQuery& q,
                                             C& counters) {
        return test_leaf<Q>(set, leaves, e.index, e.count, ray, q, counters);
    }

    /// Front to back with an explicit stack; a child that begins beyond the best hit is dropped.
    template <class Node, class PairTest, class C, class Leaf>
    static HWY_INLINE bool follow(const Node* nodes, PairTest& pair, Entry current, RayQuery& q,
                                  C& counters, const Leaf& test) {
        Entry stack[BinaryTree::max_depth + 1];
        Entry* top = stack;
        while (true) {
            // Down, to the nearer child first, until a leaf or a miss.
            while (current.count == 0) {
                const Node& node = nodes[current.index];
                const PairLinks& links = node.links;
                counters.step();
                alignas(16) float t_near[4];
                const uint32_t hits = pair.test(node, t_near);
                if (hits == 0) goto pop;
                // Branches rather than arithmetic: a predicted branch lets the next node load
                // before this one's test is through.
                if (hits == 1) {
                    current = {links.index[0], links.count[0], t_near[0]};
                } else if (hits == 2) {
                    current = {links.index[1], links.count[1], t_near[1]};
                } else if (t_near[1] < t_near[0]) {
                    *top++ = {links.index[0], links.count[0], t_near[0]};
                    current = {links.index[1], links.count[1], t_near[1]};
                } else {
                    *top++ = {links.index[1], links.count[1], t_near[1]};
                    current = {links.index[0], links.count[0], t_near[0]};
                }
            }
            counters.step();
            counters.cell(false);
            if (test(current)) return true;
            pair.shrink(q);
        pop:
            do {
                if (top == stack) return false;
                current = *--top;
            } while (current.t_near > q.t_cull);
        }
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(Bvh, BvhTraversal, BvhParameters)

#if HWY_ONCE
namespace crofton {
namespace {

/// A node in the making: its links, and the tree's nodes that its children are.
struct Pair {
    static constexpr uint32_t none = ~0u;
    PairLinks links{};
    uint32_t child[2] = {none, none};
};

/// Pairs of children, depth first, with the leaves in the same order.
template <class Set>
class PairWriter {
  public:
    PairWriter(Bvh<Set>& bvh, const BinaryTree& tree, const Set& set)
        : bvh_(bvh), tree_(tree), set_(set) {}

    std::vector<Pair> write() {
        struct Open {
            uint32_t from, to, depth;
        };
        pairs_.emplace_back();
        if (tree_.nodes[0].leaf()) {
            // A lone leaf still needs a node to stand in; its sibling is met by no ray.
            set_child(0, 0, 0, 0);
            return std::move(pairs_);
        }
        std::vector<Open> open{{0, 0, 0}};
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            ++bvh_.stats.N_IN;
            const uint32_t children[2] = {tree_.nodes[o.from].left, tree_.nodes[o.from].right};
            for (int side = 0; side < 2; ++side)
                if (const uint32_t to = set_child(o.to, side, children[side], o.depth + 1))
                    open.push_back({children[side], to, o.depth + 1});
        }
        return std::move(pairs_);
    }

  private:
    /// @return the node to fill for an inner child, 0 for a leaf
    uint32_t set_child(uint32_t parent, int side, uint32_t from, uint32_t depth) {
        const BinaryTree::Node& child = tree_.nodes[from];
        pairs_[parent].child[side] = from;
        if (!child.leaf()) {
            const uint32_t to = uint32_t(pairs_.size());
            pairs_[parent].links.index[side] = to;
            pairs_.emplace_back();
            return to;
        }
        const std::span<const uint32_t> shapes(tree_.order.data() + child.first, child.count);
        pairs_[parent].links.index[side] = bvh_.leaves.add(set_, shapes);
        pairs_[parent].links.count[side] = child.count;
        ++bvh_.stats.N_V;
        bvh_.stats.N_OIV += child.count;
        bvh_.stats.depth = std::max(bvh_.stats.depth, depth);
        return 0;
    }

    Bvh<Set>& bvh_;
    const BinaryTree& tree_;
    const Set& set_;
    std::vector<Pair> pairs_;
};

void fill_boxes(AlignedVector<BvhNode>& nodes, const std::vector<Pair>& pairs,
                const BinaryTree& tree) {
    nodes.resize(pairs.size());
    for (size_t i = 0; i < pairs.size(); ++i) {
        nodes[i].links = pairs[i].links;
        for (int side = 0; side < 2; ++side) {
            const uint32_t child = pairs[i].child[side];
            const Bounds3 b = child == Pair::none ? Bounds3() : tree.nodes[child].bounds;
            for (int a = 0; a < 3; ++a) {
                nodes[i].bounds[a][side] = b.lower[a];
                nodes[i].bounds[a][2 + side] = b.upper[a];
            }
        }
    }
}

/// The range of `order` below every node of a tree in depth-first order.
std::vector<std::pair<uint32_t, uint32_t>> shape_ranges(const BinaryTree& tree,
                                                        const std::vector<Pair>& pairs) {
    std::vector<std::pair<uint32_t, uint32_t>> range(tree.nodes.size());
    const auto set_leaf = [&](uint32_t node) {
        if (node != Pair::none && tree.nodes[node].leaf())
            range[node] = {tree.nodes[node].first, tree.nodes[node].first + tree.nodes[node].count};
    };
    set_leaf(0);
    // Pairs come after their parents: backwards, children are known first.
    std::vector<uint32_t> parent_of(pairs.size(), 0);
    for (const Pair& pair : pairs)
        for (int side = 0; side < 2; ++side) {
            set_leaf(pair.child[side]);
            if (pair.links.count[side] == 0 && pair.child[side] != Pair::none)
                parent_of[pair.links.index[side]] = pair.child[side];
        }
    for (size_t i = pairs.size(); i-- > 0;) {
        const auto& [left, right] = pairs[i].child;
        if (left == Pair::none || right == Pair::none) continue;
        range[parent_of[i]] = {std::min(range[left].first, range[right].first),
                               std::max(range[left].second, range[right].second)};
    }
    return range;
}

/// Fits every child's volume to the shapes below it: O(N log N).
/// @return nominal ns of a random line that meets the root's box
template <class Node, class Set>
double fill_volumes(AlignedVector<Node>& nodes, const std::vector<Pair>& pairs,
                    const BinaryTree& tree, const Set& set, const TreeCosts& costs) {
    const auto ranges = shape_ranges(tree, pairs);
    std::vector<double> cost(pairs.size(), 0);
    nodes.resize(pairs.size());
    parallel_for(pairs.size(), 64, [&](size_t begin, size_t end) {
        std::vector<Vec3f> points;
        for (size_t i = begin; i < end; ++i) {
            nodes[i].links = pairs[i].links;
            for (int side = 0; side < 2; ++side) {
                const uint32_t child = pairs[i].child[side];
                points.clear();
                double shapes = 0;
                const auto [first, last] = child == Pair::none ? std::pair{0u, 0u} : ranges[child];
                for (uint32_t k = first; k < last; ++k) {
                    append_hull(set, tree.order[k], points);
                    shapes += set.cost(tree.order[k]);
                }
                const double area = fit(points, side, nodes[i]);
                const uint32_t count = pairs[i].links.count[side];
                if (child != Pair::none)
                    cost[i] += area * (count > 0 ? costs.leaf(shapes, count) : costs.node);
            }
        }
    });
    const double root = half_area(tree.nodes[0].bounds);
    double sum = 0;
    for (const double c : cost) sum += c;
    return costs.node + (root > 0 ? sum / root : 0);
}

}  // namespace

template <class Set>
Bvh<Set> Bvh<Set>::build(const Set& set, const BvhParameters& p) {
    Bvh bvh;
    const TreeCosts costs = tree_costs<Set>(pair_cost(p.volume));
    const BinaryTree tree = build_tree(set, p, costs);
    bvh.volume = p.volume;
    if (tree.empty()) return bvh;
    bvh.box = tree.nodes[0].bounds;
    const std::vector<Pair> pairs = PairWriter<Set>(bvh, tree, set).write();
    switch (p.volume) {
        case BoundingVolume::box:
            fill_boxes(bvh.nodes, pairs, tree);
            bvh.cost = crofton::expected_cost(tree, costs, shape_costs(set, costs));
            break;
        case BoundingVolume::sphere:
            bvh.cost = fill_volumes(bvh.spheres, pairs, tree, set, costs);
            break;
        case BoundingVolume::obb:
            bvh.cost = fill_volumes(bvh.obbs, pairs, tree, set, costs);
            break;
        case BoundingVolume::kdop:
            bvh.cost = fill_volumes(bvh.kdops, pairs, tree, set, costs);
            break;
    }
    bvh.stats.bytes = bvh.nodes.size() * sizeof(BvhNode) + bvh.spheres.size() * sizeof(SpherePair) +
                      bvh.obbs.size() * sizeof(ObbPair) + bvh.kdops.size() * sizeof(KdopPair) +
                      bvh.leaves.bytes();
    return bvh;
}

namespace {

/// Wider by more than the roundings of a few sums of such coordinates.
Bounds3 padded(const Bounds3& b) {
    const Vec3f error = Vec3f::Constant(0x1p-19f * b.magnitude());
    return {b.lower - error, b.upper + error};
}

}  // namespace

Bounds3 child_box(const BvhNode& n, int side) {
    Bounds3 b;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = n.bounds[a][side];
        b.upper[a] = n.bounds[a][2 + side];
    }
    return b;
}
Bounds3 child_box(const SpherePair& n, int side) {
    Bounds3 b;
    for (int a = 0; a < 3 && n.radius[side] >= 0; ++a) {
        b.lower[a] = n.center[a][side] - n.radius[side];
        b.upper[a] = n.center[a][side] + n.radius[side];
    }
    return b.empty() ? b : padded(b);
}
Bounds3 child_box(const ObbPair& n, int side) {
    const ObbPair::Child& c = n.child[side];
    Bounds3 b;
    if (!(c.lower[0] <= c.upper[0])) return b;
    // The directions are at right angles: p = Σ (n_k·p)·n_k.
    for (int corner = 0; corner < 8; ++corner) {
        Vec3f p = Vec3f::Zero();
        for (int k = 0; k < 3; ++k)
            for (int a = 0; a < 3; ++a)
                p[a] += c.direction[a][k] * (corner >> k & 1 ? c.upper[k] : c.lower[k]);
        b.extend(p);
    }
    return padded(b);
}
Bounds3 child_box(const KdopPair& n, int side) {
    const KdopPair::Child& c = n.child[side];
    return {Vec3f(c.lower[0], c.lower[1], c.lower[2]), Vec3f(c.upper[0], c.upper[1], c.upper[2])};
}

namespace {

template <class Node>
void walk_pairs(const AlignedVector<Node>& nodes, const Bounds3& box, const BoxVisitor& visit) {
    if (nodes.empty()) return;
    struct Open {
        uint32_t node, depth;
    };
    visit(box, 0, false, 0);
    std::vector<Open> open{{0, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        const Node& n = nodes[o.node];
        for (int side = 0; side < 2; ++side) {
            const Bounds3 b = intersection(child_box(n, side), box);
            if (b.empty()) continue;
            const uint32_t count = n.links.count[side];
            visit(b, o.depth + 1, count > 0, count);
            if (count == 0) open.push_back({n.links.index[side], o.depth + 1});
        }
    }
}

}  // namespace

template <class Set>
void Bvh<Set>::walk(const BoxVisitor& visit) const {
    walk_pairs(nodes, box, visit);
    walk_pairs(spheres, box, visit);
    walk_pairs(obbs, box, visit);
    walk_pairs(kdops, box, visit);
}

CROFTON_REGISTER_ACCELERATOR(
    Bvh, BvhParameters, "bvh",
    "binary hierarchy of bounding volumes, split by the surface area heuristic",
    "Rubin & Whitted 1980; Kay & Kajiya 1986; MacDonald & Booth 1990; builders: see bvh.md");

}  // namespace crofton
#endif
