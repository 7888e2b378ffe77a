#include "accelerators/model_hierarchy.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/model_hierarchy.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct ModelHierarchyTraversal {
    struct Entry {
        uint32_t index, count;
        float t_near;
    };

    /// Front to back with an explicit stack, all children of a node tested at once.
    template <Query Q, class Set, class C>
    static bool run(const ModelHierarchy<Set>& tree, const Set& set, const LocalRay& ray,
                    RayQuery& q, C& counters, TraversalStart start = {}) {
        if (tree.nodes.empty()) return false;
        const ModelNode* nodes = tree.nodes.data();
        const int down[3] = {std::signbit(ray.rcp[0]), std::signbit(ray.rcp[1]),
                             std::signbit(ray.rcp[2])};
        Entry stack[ModelHierarchy<Set>::max_depth * 7 + 8];
        Entry* top = stack;
        Entry current{start.index, start.count, q.t_low};
        while (true) {
            counters.step();
            if (current.count > 0) {
                counters.cell(false);
                if (test_leaf<Q>(set, tree.leaves, current.index, current.count, ray, q, counters))
                    return true;
            } else {
                const ModelNode& node = nodes[current.index];
                alignas(32) float t_near[8];
                uint32_t hits = test(node, ray, down, q, t_near);
                Entry* const base = top;
                for (; hits; hits &= hits - 1) {
                    const uint32_t i = uint32_t(hwy::Num0BitsBelowLS1Bit_Nonzero32(hits));
                    insert<Q>(base, top++, {node.index[i], node.count[i], t_near[i]});
                }
            }
            do {
                if (top == stack) return false;
                current = *--top;
            } while (current.t_near > q.t_cull);
        }
    }

  private:
    /// @return bit i: child i may be hit within [t_low, t_cull]; where the ray enters, in t_near
    static HWY_INLINE uint32_t test(const ModelNode& node, const LocalRay& ray, const int* down,
                                    const RayQuery& q, float* HWY_RESTRICT t_near) {
        const hn::CappedTag<float, 8> d;
        uint32_t hits = 0;
        for (size_t i = 0; i < 8; i += hn::Lanes(d)) {
            auto enter = hn::Set(d, q.t_low), leave = hn::Set(d, q.t_cull);
            for (int a = 0; a < 3; ++a) {
                const auto lo = hn::Load(d, node.planes[down[a]][a] + i);
                const auto hi = hn::Load(d, node.planes[down[a] ^ 1][a] + i);
                enter = hn::Max(enter, hn::Mul(hn::Sub(lo, hn::Set(d, ray.near_origin[a])),
                                               hn::Set(d, ray.rcp[a])));
                leave = hn::Min(leave, hn::Mul(hn::Sub(hi, hn::Set(d, ray.far_origin[a])),
                                               hn::Set(d, ray.far_rcp[a])));
            }
            hn::Store(enter, d, t_near + i);
            uint8_t bits[8];
            hn::StoreMaskBits(d, hn::Le(enter, leave), bits);
            hits |= uint32_t(bits[0]) << i;
        }
        return hits;
    }

    /// Puts e into [base, top): far to near where the order matters.
    template <Query Q>
    static HWY_INLINE void insert(Entry* base, Entry* top, const Entry& e) {
        if constexpr (Q == Query::closest)
            for (; top > base && top[-1].t_near < e.t_near; --top) *top = top[-1];
        *top = e;
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(ModelHierarchy, ModelHierarchyTraversal, ModelHierarchyParameters)

#if HWY_ONCE
namespace crofton {
namespace {

constexpr uint32_t none = ~0u;

/// A member of a group: another group, or (group = none) consecutive shapes for one leaf.
struct Member {
    Bounds3 bounds;
    uint32_t first, end;  ///< positions in the order
    uint32_t group;
    float cost;  ///< sum over the shapes
    bool leaf() const { return group == none; }
};

/// Members [begin, end) of the list of all, that become one child of a node.
struct Run {
    uint32_t begin, end;
    Bounds3 bounds;
    uint32_t size() const { return end - begin; }
};

/// The children of a node.
class Runs {
  public:
    size_t size() const { return size_; }
    Run& operator[](size_t i) { return runs_[i]; }
    const Run& operator[](size_t i) const { return runs_[i]; }
    Run* begin() { return runs_; }
    Run* end() { return runs_ + size_; }
    void push_back(const Run& run) { runs_[size_++] = run; }
    /// Puts several in place of one. @pre  no more than eight then
    void replace(size_t at, const Run* by, size_t count) {
        std::copy_backward(runs_ + at + 1, runs_ + size_, runs_ + size_ + count - 1);
        std::copy(by, by + count, runs_ + at);
        size_ += count - 1;
    }

  private:
    Run runs_[8];
    size_t size_ = 0;
};

/// The groups of a set over its active shapes in their order; empty groups are gone.
class ModelGroups {
  public:
    /// @param shapes  active, ascending
    ModelGroups(const ShapeGroups& groups, const BuildReferences& shapes, uint32_t leaf_size)
        : shapes_(shapes), leaf_size_(leaf_size) {
        const auto position = [&](uint32_t shape) {
            return uint32_t(
                std::lower_bound(shapes.begin(), shapes.end(), shape,
                                 [](const BuildReference& r, uint32_t s) { return r.shape < s; }) -
                shapes.begin());
        };
        for (const ShapeGroup& g : groups)
            if (const uint32_t first = position(g.first), end = position(g.end); first < end)
                groups_.push_back({{}, first, end, uint32_t(groups_.size()), 0});
        link();
        measure();
    }

    uint32_t leaf_size() const { return leaf_size_; }

    /// Appends the members of a group, or of the whole set for `none`: groups in it, and the shapes
    /// between them in leaves. Ignores groups inside if `flat`.
    void members(uint32_t group, bool flat, std::vector<Member>& out) const {
        uint32_t at = group == none ? 0 : groups_[group].first;
        const uint32_t end = group == none ? uint32_t(shapes_.size()) : groups_[group].end;
        if (!flat)
            for (uint32_t g = group == none ? 0 : group + 1;
                 g < groups_.size() && groups_[g].first < end; g = after_[g]) {
                leaves(at, groups_[g].first, out);
                out.push_back(groups_[g]);
                at = groups_[g].end;
            }
        leaves(at, end, out);
    }

  private:
    /// Finds where each group's subtree ends in the preorder.
    void link() {
        after_.assign(groups_.size(), uint32_t(groups_.size()));
        parent_.assign(groups_.size(), none);
        std::vector<uint32_t> open;
        for (uint32_t g = 0; g < groups_.size(); ++g) {
            while (!open.empty() && groups_[open.back()].end <= groups_[g].first) {
                after_[open.back()] = g;
                open.pop_back();
            }
            if (!open.empty()) parent_[g] = open.back();
            open.push_back(g);
        }
    }
    /// Bounds and costs: shapes into their innermost group, then groups into their parents.
    void measure() {
        std::vector<uint32_t> open;
        uint32_t g = 0;
        for (uint32_t i = 0; i < shapes_.size(); ++i) {
            while (!open.empty() && groups_[open.back()].end <= i) open.pop_back();
            for (; g < groups_.size() && groups_[g].first == i; ++g) open.push_back(g);
            if (open.empty()) continue;
            groups_[open.back()].bounds.extend(shapes_[i].bounds);
            groups_[open.back()].cost += shapes_[i].cost;
        }
        for (uint32_t i = uint32_t(groups_.size()); i-- > 0;) {
            if (parent_[i] == none) continue;
            groups_[parent_[i]].bounds.extend(groups_[i].bounds);
            groups_[parent_[i]].cost += groups_[i].cost;
        }
    }
    void leaves(uint32_t first, uint32_t end, std::vector<Member>& out) const {
        if (out.empty()) out.reserve((end - first) / leaf_size_ + 1);
        for (; first < end; first += std::min(leaf_size_, end - first)) {
            Member leaf{{}, first, std::min(first + leaf_size_, end), none, 0};
            for (uint32_t i = first; i < leaf.end; ++i) {
                leaf.bounds.extend(shapes_[i].bounds);
                leaf.cost += shapes_[i].cost;
            }
            out.push_back(leaf);
        }
    }

    const BuildReferences& shapes_;
    const uint32_t leaf_size_;
    std::vector<Member> groups_;
    std::vector<uint32_t> after_;   ///< the first group behind a group and all inside it
    std::vector<uint32_t> parent_;  ///< or none
};

template <class Set>
class ModelWriter {
  public:
    ModelWriter(ModelHierarchy<Set>& tree, const Set& set, const ModelHierarchyParameters& p,
                const BuildReferences& shapes)
        : tree_(tree),
          set_(set),
          shapes_(shapes),
          merge_(p.merge),
          by_area_(p.split == OrderSplit::area),
          groups_(set.groups(), shapes,
                  std::is_same_v<Set, ObjectSet> ? 1 : uint32_t(p.max_leaf_size)) {}

    void write() {
        struct Open {
            Run run;
            uint32_t to, depth;
        };
        // About six of a node's eight places are taken.
        tree_.nodes.reserve(shapes_.size() / groups_.leaf_size() / 5 + 1);
        tree_.leaves.reserve(shapes_.size());
        tree_.nodes.emplace_back();
        std::vector<Open> open{{expand(none, 0), 0, 0}};
        tree_.box = open.back().run.bounds;
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            ++tree_.stats.N_IN;
            Runs children = cut(o.run, o.depth);
            if (merge_) merge(children, o.depth);
            ModelNode node;
            for (int i = int(children.size()); i < 8; ++i) set_child(node, i, Bounds3(), 0, 0);
            for (int i = 0; i < int(children.size()); ++i) {
                const Run& c = children[i];
                if (is_leaf(c)) {
                    add_leaf(node, i, members_[c.begin], o.depth + 1);
                    continue;
                }
                set_child(node, i, c.bounds, uint32_t(tree_.nodes.size()), 0);
                open.push_back({c, uint32_t(tree_.nodes.size()), o.depth + 1});
                tree_.nodes.emplace_back();
            }
            tree_.nodes[o.to] = node;
        }
    }

  private:
    bool is_leaf(const Run& r) const { return r.size() == 1 && members_[r.begin].leaf(); }

    /// The members of a group; of a group in a group in a … without anything beside it, the
    /// innermost's.
    Run expand(uint32_t group, uint32_t depth) {
        const bool flat = depth >= ModelHierarchy<Set>::group_levels;
        const uint32_t begin = uint32_t(members_.size());
        groups_.members(group, flat, members_);
        while (members_.size() == begin + 1 && !members_[begin].leaf()) {
            const uint32_t inner = members_[begin].group;
            members_.pop_back();
            groups_.members(inner, flat, members_);
        }
        return run(begin, uint32_t(members_.size()));
    }
    Run run(uint32_t begin, uint32_t end) const {
        Run r{begin, end, {}};
        for (uint32_t i = begin; i < end; ++i) r.bounds.extend(members_[i].bounds);
        return r;
    }

    /// At most eight runs in the order; a group that is alone in its run is expanded.
    /// @param depth  of the node that gets them
    Runs cut(const Run& whole, uint32_t depth) {
        Runs runs;
        if (whole.size() <= 8) {
            for (uint32_t i = whole.begin; i < whole.end; ++i)
                runs.push_back({i, i + 1, members_[i].bounds});
        } else {
            runs.push_back(whole);
            while (runs.size() < 8) cut_largest(runs, depth);
        }
        for (Run& r : runs)
            if (r.size() == 1 && !is_leaf(r)) r = expand(members_[r.begin].group, depth + 1);
        return runs;
    }

    /// Cuts one run in two: by area the one that costs most, else the longest in equal halves.
    void cut_largest(Runs& runs, uint32_t depth) const {
        const bool by_area = by_area_ && depth < ModelHierarchy<Set>::group_levels;
        size_t best = runs.size();
        double most = -1;
        for (size_t i = 0; i < runs.size(); ++i) {
            const double weight =
                by_area ? half_area(runs[i].bounds) * double(runs[i].size()) : runs[i].size();
            if (runs[i].size() > 1 && weight > most) {
                best = i;
                most = weight;
            }
        }
        const Run old = runs[best];
        Run halves[2];
        if (by_area) {
            cut_by_area(old, halves);
        } else {
            const uint32_t middle = old.begin + old.size() / 2;
            halves[0] = run(old.begin, middle), halves[1] = run(middle, old.end);
        }
        runs.replace(best, halves, 2);
    }

    /// What lies on one side of a cut.
    struct Side {
        Bounds3 bounds;
        double cost = 0;
        void extend(const Side& s) {
            bounds.extend(s.bounds);
            cost += s.cost;
        }
        double weight() const { return half_area(bounds) * cost; }
    };
    Side side(uint32_t begin, uint32_t end) const {
        Side s;
        for (uint32_t i = begin; i < end; ++i) s.extend({members_[i].bounds, members_[i].cost});
        return s;
    }

    /// Cuts a run so that the area heuristic is least: in one of a few places spread evenly, then
    /// in one around that, until each member's place has been looked at there.
    void cut_by_area(const Run& r, Run* halves) const {
        Side left, right;  // of what is looked at
        uint32_t begin = r.begin, end = r.end;
        while (true) {
            constexpr uint32_t most = 16;
            const uint32_t n = end - begin, pieces = std::min(n, most);
            const auto place = [&](uint32_t k) {
                return begin + uint32_t(uint64_t(n) * k / pieces);
            };
            Side piece[most], lefts[most + 1], rights[most + 1];
            for (uint32_t k = 0; k < pieces; ++k) piece[k] = side(place(k), place(k + 1));
            lefts[0] = left, rights[pieces] = right;
            for (uint32_t k = 0; k < pieces; ++k)
                lefts[k + 1] = lefts[k], lefts[k + 1].extend(piece[k]);
            for (uint32_t k = pieces; k-- > 0;)
                rights[k] = rights[k + 1], rights[k].extend(piece[k]);
            // The middle one of equal places, or where boxes are too large for a number.
            uint32_t best = pieces / 2;
            double least = lefts[best].weight() + rights[best].weight();
            for (uint32_t k = 1; k < pieces; ++k)
                if (const double sum = lefts[k].weight() + rights[k].weight(); sum < least)
                    least = sum, best = k;
            if (n <= most) {
                halves[0] = {r.begin, place(best), lefts[best].bounds};
                halves[1] = {place(best), r.end, rights[best].bounds};
                return;
            }
            left = lefts[best - 1], right = rights[best + 1];
            const uint32_t from = place(best - 1);
            end = place(best + 1), begin = from;
        }
    }

    /// Puts members into free places instead of their group, the largest box that fits first.
    void merge(Runs& children, uint32_t depth) {
        while (true) {
            size_t best = children.size();
            double most = -1;
            for (size_t i = 0; i < children.size(); ++i)
                if (!is_leaf(children[i]) && children.size() - 1 + children[i].size() <= 8 &&
                    half_area(children[i].bounds) > most) {
                    best = i;
                    most = half_area(children[i].bounds);
                }
            if (best == children.size()) return;
            Runs inner = cut(children[best], depth);
            children.replace(best, inner.begin(), inner.size());
        }
    }

    void add_leaf(ModelNode& node, int i, const Member& leaf, uint32_t depth) {
        ids_.clear();
        for (uint32_t s = leaf.first; s < leaf.end; ++s) ids_.push_back(shapes_[s].shape);
        set_child(node, i, leaf.bounds, tree_.leaves.add(set_, ids_), uint32_t(ids_.size()));
        ++tree_.stats.N_V;
        tree_.stats.N_OIV += ids_.size();
        tree_.stats.depth = std::max(tree_.stats.depth, depth);
    }
    static void set_child(ModelNode& node, int i, const Bounds3& b, uint32_t index,
                          uint32_t count) {
        for (int a = 0; a < 3; ++a) {
            node.planes[0][a][i] = b.lower[a];
            node.planes[1][a][i] = b.upper[a];
        }
        node.index[i] = index;
        node.count[i] = count;
    }

    ModelHierarchy<Set>& tree_;
    const Set& set_;
    const BuildReferences& shapes_;
    const bool merge_, by_area_;
    ModelGroups groups_;
    std::vector<Member> members_;  ///< of all groups expanded so far
    std::vector<uint32_t> ids_;    ///< of the leaf in hand
};

}  // namespace

template <class Set>
ModelHierarchy<Set> ModelHierarchy<Set>::build(const Set& set, const ModelHierarchyParameters& p) {
    ModelHierarchy tree;
    const BuildReferences shapes = build_references(set);
    if (shapes.empty()) return tree;
    ModelWriter<Set>(tree, set, p, shapes).write();
    if (tree.nodes.capacity() > tree.nodes.size() + tree.nodes.size() / 4)
        tree.nodes.shrink_to_fit();
    tree.cost = expected_cost_from(tree, set, {}, tree.box);
    tree.stats.bytes = tree.nodes.size() * sizeof(ModelNode) + tree.leaves.bytes();
    return tree;
}

template <class Set>
void ModelHierarchy<Set>::walk(const BoxVisitor& visit) const {
    if (nodes.empty()) return;
    struct Open {
        TraversalStart node;
        uint32_t depth;
    };
    visit(box, 0, false, 0);
    std::vector<Open> open{{{}, 0}};
    while (!open.empty()) {
        const Open o = open.back();
        open.pop_back();
        visit_children(o.node, [&](const Bounds3& b, TraversalStart child) {
            visit(b, o.depth + 1, is_leaf(child), child.count);
            if (!is_leaf(child)) open.push_back({child, o.depth + 1});
        });
    }
}

CROFTON_REGISTER_ACCELERATOR(
    ModelHierarchy, ModelHierarchyParameters, "model_hierarchy",
    "boxes around the groups that the model itself has, or over the order of its shapes",
    "Clark 1976; Rubin & Whitted 1980");

}  // namespace crofton
#endif
