#include "accelerators/model_hierarchy.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/model_hierarchy.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"
#include "framework/parallel.h"

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
                    const uint32_t i = lowest(hits);
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
#include "accelerators/box4.h"

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
            Box4 box;
            for (uint32_t i = first; i < leaf.end; ++i) {
                box.extend(Box4(shapes_[i]));
                leaf.cost += shapes_[i].cost;
            }
            leaf.bounds = box.bounds();
            out.push_back(leaf);
        }
    }

    const BuildReferences& shapes_;
    const uint32_t leaf_size_;
    std::vector<Member> groups_;
    std::vector<uint32_t> after_;   ///< the first group behind a group and all inside it
    std::vector<uint32_t> parent_;  ///< or none
};

struct ModelRules {
    bool merge, by_area;
    uint32_t group_levels;  ///< from here down there are no groups
};

/// Nodes of a subtree, whose children are numbered as they are here, and whose leaves are positions
/// in the order.
template <class Set>
class ModelPart {
  public:
    /// What a node is to be made of.
    struct Open {
        Run run;
        uint32_t to, depth;
    };

    ModelPart(const ModelGroups& groups, const ModelRules& rules)
        : groups_(groups), rules_(rules) {}

    Open whole() {
        const Run all = expand(none, 0);
        nodes_.emplace_back();
        return {all, 0, 0};
    }
    /// Shapes below a node that is to be made.
    uint32_t shapes(const Open& o) const {
        return members_[o.run.end - 1].end - members_[o.run.begin].first;
    }
    /// Room for a subtree over so many shapes.
    void reserve(uint32_t shapes) {
        // Groups end with leaves that are not full; about six of a node's eight places are taken.
        const uint32_t leaves = shapes / groups_.leaf_size() * 3 / 2 + 8;
        members_.reserve(leaves);
        nodes_.reserve(leaves / 4);
    }
    /// As the root here. @param from  whose members the run is of
    Open part_of(const ModelPart& from, const Open& o) {
        members_.assign(from.members_.begin() + o.run.begin, from.members_.begin() + o.run.end);
        nodes_.emplace_back();
        return {{0, o.run.size(), o.run.bounds}, 0, o.depth};
    }

    /// One node; what its children that are no leaves are to be made of, is appended to `open`.
    void write(const Open& o, std::vector<Open>& open) {
        ++stats_.N_IN;
        Runs children = cut(o.run, o.depth);
        if (rules_.merge) merge(children, o.depth);
        ModelNode node;
        for (int i = int(children.size()); i < 8; ++i) set_child(node, i, Bounds3(), 0, 0);
        for (int i = 0; i < int(children.size()); ++i) {
            const Run& c = children[i];
            if (is_leaf(c)) {
                add_leaf(node, i, members_[c.begin], o.depth + 1);
                continue;
            }
            set_child(node, i, c.bounds, uint32_t(nodes_.size()), 0);
            open.push_back({c, uint32_t(nodes_.size()), o.depth + 1});
            nodes_.emplace_back();
        }
        nodes_[o.to] = node;
        cost_ += half_area(o.run.bounds) * ModelHierarchy<Set>::node_cost(children.size());
    }
    void write_all(const Open& root) {
        for (std::vector<Open> open{root}; !open.empty();) {
            const Open o = open.back();
            open.pop_back();
            write(o, open);
        }
    }

    const AlignedVector<ModelNode>& nodes() const { return nodes_; }
    const StructureStatistics& statistics() const { return stats_; }
    size_t leaf_room() const { return leaf_room_; }  ///< that Leaves<Set> need
    double cost() const { return cost_; }            ///< sum of costs times half areas

  private:
    bool is_leaf(const Run& r) const { return r.size() == 1 && members_[r.begin].leaf(); }

    /// The members of a group; of a group in a group in a … without anything beside it, the
    /// innermost's.
    Run expand(uint32_t group, uint32_t depth) {
        const bool flat = depth >= rules_.group_levels;
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
        return {begin, end, side(begin, end).box.bounds()};
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
        const bool by_area = rules_.by_area && depth < rules_.group_levels;
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
        Box4 box;
        double cost = 0;
        void extend(const Side& s) {
            box.extend(s.box);
            cost += s.cost;
        }
        /// @pre  not empty
        double weight() const { return box.half_area() * cost; }
    };
    Side side(uint32_t begin, uint32_t end) const {
        Side s;
        for (uint32_t i = begin; i < end; ++i)
            s.extend({Box4(members_[i].bounds), members_[i].cost});
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
                halves[0] = {r.begin, place(best), lefts[best].box.bounds()};
                halves[1] = {place(best), r.end, rights[best].box.bounds()};
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
        const uint32_t shapes = leaf.end - leaf.first;
        set_child(node, i, leaf.bounds, leaf.first, shapes);
        leaf_room_ += Leaves<Set>::room(shapes);
        cost_ += half_area(leaf.bounds) * Leaves<Set>::cost(leaf.cost, shapes);
        ++stats_.N_V;
        stats_.N_OIV += shapes;
        stats_.depth = std::max(stats_.depth, depth);
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

    const ModelGroups& groups_;
    const ModelRules rules_;
    std::vector<Member> members_;  ///< of all groups expanded so far
    AlignedVector<ModelNode> nodes_;
    StructureStatistics stats_;
    size_t leaf_room_ = 0;
    double cost_ = 0;
};

/// A tree from parts that are written at once: the nodes at the top, and what is below them.
template <class Set>
class ModelWriter {
  public:
    ModelWriter(ModelHierarchy<Set>& tree, const Set& set, const ModelHierarchyParameters& p,
                const BuildReferences& shapes)
        : tree_(tree),
          set_(set),
          shapes_(shapes),
          groups_(set.groups(), shapes,
                  std::is_same_v<Set, ObjectSet> ? 1 : uint32_t(p.max_leaf_size)),
          rules_{p.merge, p.split == OrderSplit::area, ModelHierarchy<Set>::group_levels} {}

    void write() {
        std::vector<Open> open = write_top();
        const size_t parts = open.size();
        // Memory is asked for here, by one thread: what the others free, goes back to the system.
        for (const Open& o : open)
            parts_.emplace_back(groups_, rules_).reserve(parts_[0].shapes(o));
        parallel_for(parts, 1, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                parts_[1 + i].write_all(parts_[1 + i].part_of(parts_[0], open[i]));
        });
        join(open);
    }

  private:
    using Part = ModelPart<Set>;
    using Open = typename Part::Open;

    /// Writes nodes until there are enough subtrees below for all threads, as it does for any
    /// number of threads; or everything, if that is little.
    std::vector<Open> write_top() {
        constexpr size_t subtrees = 16, least_shapes = 2048;
        parts_.reserve(2 * subtrees);
        Part& top = parts_.emplace_back(groups_, rules_);
        top.reserve(uint32_t(shapes_.size()));
        std::vector<Open> open{top.whole()};
        tree_.box = open.front().run.bounds;
        if (shapes_.size() < least_shapes) {
            top.write_all(open.front());
            return {};
        }
        while (!open.empty() && open.size() < subtrees) {
            const auto largest = std::max_element(
                open.begin(), open.end(),
                [&](const Open& a, const Open& b) { return top.shapes(a) < top.shapes(b); });
            const Open o = *largest;
            open.erase(largest);
            top.write(o, open);
        }
        return open;
    }

    /// Puts all parts into the tree, and packs their leaves. A part's root takes the place that the
    /// top has for it.
    /// @param open  what the parts but the first were made of
    void join(const std::vector<Open>& open) {
        std::vector<size_t> first_node, first_leaf;
        size_t nodes = parts_[0].nodes().size(), room = parts_[0].leaf_room();
        for (size_t i = 0; i < open.size(); ++i) {
            first_node.push_back(nodes - 1);
            first_leaf.push_back(room);
            nodes += parts_[1 + i].nodes().size() - 1;
            room += parts_[1 + i].leaf_room();
        }
        tree_.nodes.resize(nodes);
        tree_.leaves.resize(room);
        place(parts_[0], 0, [](uint32_t n) { return n; });
        parallel_for(open.size(), 1, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                place(parts_[1 + i], first_leaf[i], [&](uint32_t n) {
                    return n == 0 ? open[i].to : uint32_t(first_node[i]) + n;
                });
        });
        for (const Part& part : parts_) add_totals(part);
    }

    /// @param leaf    where the room for the part's leaves begins
    /// @param number  of a part's node in the tree
    template <class Number>
    void place(const Part& part, size_t leaf, const Number& number) {
        std::vector<uint32_t> ids;
        for (uint32_t n = 0; n < part.nodes().size(); ++n) {
            ModelNode& node = tree_.nodes[number(n)] = part.nodes()[n];
            for (int i = 0; i < 8; ++i) {
                if (node.count[i] == 0) {
                    node.index[i] = number(node.index[i]);
                    continue;
                }
                ids.clear();
                for (uint32_t k = 0; k < node.count[i]; ++k)
                    ids.push_back(shapes_[node.index[i] + k].shape);
                tree_.leaves.put(set_, ids, uint32_t(leaf));
                node.index[i] = uint32_t(leaf);
                leaf += Leaves<Set>::room(node.count[i]);
            }
        }
    }

    void add_totals(const Part& part) {
        const StructureStatistics& s = part.statistics();
        tree_.stats.N_IN += s.N_IN;
        tree_.stats.N_V += s.N_V;
        tree_.stats.N_OIV += s.N_OIV;
        tree_.stats.depth = std::max(tree_.stats.depth, s.depth);
        tree_.cost += part.cost();
    }

    ModelHierarchy<Set>& tree_;
    const Set& set_;
    const BuildReferences& shapes_;
    const ModelGroups groups_;
    const ModelRules rules_;
    std::vector<Part> parts_;  ///< the top, then what is below it
};

}  // namespace

template <class Set>
ModelHierarchy<Set> ModelHierarchy<Set>::build(const Set& set, const ModelHierarchyParameters& p) {
    ModelHierarchy tree;
    const BuildReferences shapes = build_references(set);
    if (shapes.empty()) return tree;
    ModelWriter<Set>(tree, set, p, shapes).write();
    const double area = half_area(tree.box);
    tree.cost = area > 0 ? tree.cost / area : expected_cost_from(tree, set, {}, tree.box);
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
