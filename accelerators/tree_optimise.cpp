#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "accelerators/box4.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr uint32_t none = ~0u;
constexpr size_t least_candidates = 1024;
constexpr int batches = 16;            // of a pass; each sees what the ones before have moved
constexpr double least_gain = 2.5e-4;  // of the sum of areas: two batches that gain less end a pass
constexpr uint32_t most_visits = 512;  // of one search: bounds the time where boxes overlap much

/// A node as the search reads it.
///
///   byte 0  lower x, y, z     12  left child, or `none` for a leaf
///       16  upper x, y, z     28  right child
struct SearchNode {
    float lower[3];
    uint32_t left;
    float upper[3];
    uint32_t right;

    bool leaf() const { return left == none; }
    Box4 box() const { return {hn::LoadU(Box4::D(), lower), hn::LoadU(Box4::D(), upper)}; }
    void set_box(const Box4& b) {
        alignas(16) float l[4], u[4];
        hn::Store(b.lower, Box4::D(), l);
        hn::Store(b.upper, Box4::D(), u);
        std::copy(l, l + 3, lower);
        std::copy(u, u + 3, upper);
    }
    bool same_box(const Box4& b) const {
        const Box4::D d;
        uint8_t bits[8];
        hn::StoreMaskBits(
            d, hn::And(hn::Eq(hn::LoadU(d, lower), b.lower), hn::Eq(hn::LoadU(d, upper), b.upper)),
            bits);
        return (bits[0] & 7) == 7;
    }
};
static_assert(sizeof(SearchNode) == 32);

Box4 merge(Box4 a, const Box4& b) {
    a.extend(b);
    return a;
}

/// Sorts by a total order: the same for any number of threads.
template <class Iterator, class Less>
void parallel_sort(Iterator begin, Iterator end, const Less& less) {
    if (end - begin < 8192) return std::sort(begin, end, less);
    const Iterator middle = begin + (end - begin) / 2;
    parallel_invoke([&] { parallel_sort(begin, middle, less); },
                    [&] { parallel_sort(middle, end, less); });
    std::inplace_merge(begin, middle, end, less);
}

/// A subtree to be moved: it becomes the sibling of `target`.
struct Move {
    uint32_t node = none, target = none;
    float gain = 0;
};

class Optimiser {
  public:
    /// Nodes are numbered anew, depth first: what is near in the tree is near in memory.
    explicit Optimiser(const BinaryTree& tree) {
        struct Open {
            uint32_t from, parent;
        };
        std::vector<Open> open{{0, none}};
        nodes_.reserve(tree.nodes.size());
        parent_.reserve(tree.nodes.size());
        from_.reserve(tree.nodes.size());
        while (!open.empty()) {
            const auto [from, parent] = open.back();
            open.pop_back();
            const uint32_t i = uint32_t(nodes_.size());
            const BinaryTree::Node& node = tree.nodes[from];
            SearchNode& to = nodes_.emplace_back();
            for (int a = 0; a < 3; ++a)
                to.lower[a] = node.bounds.lower[a], to.upper[a] = node.bounds.upper[a];
            to.left = to.right = none;
            parent_.push_back(parent);
            from_.push_back(from);
            // The left child follows its parent.
            if (parent != none && parent + 1 != i) nodes_[parent].right = i;
            if (node.leaf()) continue;
            to.left = i + 1;
            open.push_back({node.right, i});
            open.push_back({node.left, i});
        }
        touched_.resize(nodes_.size());
        // A power of two makes areas of the order of 1: no product of extents overflows.
        const float extent = tree.nodes[0].bounds.extent().maxCoeff();
        const bool sane = extent > 0 && std::isfinite(extent);
        const int exponent = sane ? std::clamp(-std::ilogb(extent), -120, 120) : 0;
        scale_ = hn::Set(Box4::D(), std::ldexp(1.0f, exponent));
    }

    /// @return whether the sum of areas fell; if not, nothing has changed
    bool pass() {
        const double before = cost();
        saved_nodes_ = nodes_;
        saved_parents_ = parent_;
        const std::vector<uint32_t> candidates = largest_first();
        const size_t size = (candidates.size() + batches - 1) / batches;
        double last = before;
        int poor = 0;
        for (size_t begin = 0; begin < candidates.size(); begin += size) {
            batch(std::span(candidates).subspan(begin, std::min(size, candidates.size() - begin)));
            // Those that follow are smaller.
            const double gain = last - cost();
            poor = gain < least_gain * before ? poor + 1 : 0;
            if (poor == 2) break;
            last -= gain;
        }
        if (cost() < before) return true;
        nodes_.swap(saved_nodes_);
        parent_.swap(saved_parents_);
        return false;
    }

    /// Of all inner nodes, in double: the part of the area heuristic that moves can change.
    double cost() const {
        return sum_chunks<Sum>(0, nodes_.size(),
                               [&](size_t begin, size_t end) {
                                   Sum sum;
                                   for (size_t i = begin; i < end; ++i)
                                       if (!nodes_[i].leaf()) sum.value += area_of(nodes_[i]);
                                   return sum;
                               })
            .value;
    }

    /// The nodes as they are now. @param tree  that this was made of
    RawAlignedVector<BinaryTree::Node> nodes(const BinaryTree& tree) const {
        RawAlignedVector<BinaryTree::Node> list(nodes_.size());
        parallel_for(nodes_.size(), 1 << 13, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) {
                const SearchNode& from = nodes_[i];
                list[i] = tree.nodes[from_[i]];
                if (from.leaf()) continue;
                list[i].make_inner(from.left, from.right);
                for (int a = 0; a < 3; ++a)
                    list[i].bounds.lower[a] = from.lower[a],
                    list[i].bounds.upper[a] = from.upper[a];
            }
        });
        return list;
    }

  private:
    struct Entry {
        uint32_t node;
        float merged;  // area of the node's box with the moved one
        float left;    // gain so far: what is saved, less what ancestors grow
    };

    struct Sum {
        double value = 0;
        void add(const Sum& s) { value += s.value; }
    };

    static double area_of(const SearchNode& n) {
        const double x = double(n.upper[0]) - n.lower[0], y = double(n.upper[1]) - n.lower[1],
                     z = double(n.upper[2]) - n.lower[2];
        return x * y + y * z + z * x;
    }
    float area(const Box4& b) const {
        const Box4::D d;
        const auto e = hn::Mul(hn::Sub(b.upper, b.lower), scale_);
        const auto f = hn::Shuffle0321(e);  // y, z, -, x
        alignas(16) float p[4], q[4];
        hn::Store(e, d, p);
        hn::Store(f, d, q);
        return p[0] * q[0] + p[1] * q[1] + p[2] * p[0];
    }
    uint32_t sibling(uint32_t i) const {
        const SearchNode& p = nodes_[parent_[i]];
        return p.left == i ? p.right : p.left;
    }

    /// The largest quarter of the nodes that can move, by falling area. The others gain little: as
    /// many searches spent on further passes gain more.
    std::vector<uint32_t> largest_first() const {
        std::vector<std::pair<float, uint32_t>> keyed(nodes_.size());
        parallel_for(nodes_.size(), 1 << 13, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) {
                const bool moves = i != 0 && parent_[i] != 0;
                keyed[i] = {moves ? -area(nodes_[i].box()) : INFINITY, uint32_t(i)};
            }
        });
        // The root and its children, which can't move, come last.
        const size_t movable = nodes_.size() - 3;
        const size_t n = std::max(movable / 4, std::min(movable, least_candidates));
        std::nth_element(keyed.begin(), keyed.begin() + ptrdiff_t(n), keyed.end());
        keyed.resize(n);
        parallel_sort(keyed.begin(), keyed.end(), std::less<>());
        std::vector<uint32_t> list(n);
        for (size_t i = 0; i < n; ++i) list[i] = keyed[i].second;
        return list;
    }

    /// Searches for all of `candidates` at once, then makes the moves that don't meet, best first.
    void batch(std::span<const uint32_t> candidates) {
        std::vector<Move> moves(candidates.size());
        parallel_for(candidates.size(), 64, [&](size_t begin, size_t end) {
            std::vector<Entry> stack;
            for (size_t i = begin; i < end; ++i) moves[i] = best_move(candidates[i], stack);
        });
        std::erase_if(moves, [](const Move& m) { return m.target == none; });
        parallel_sort(moves.begin(), moves.end(), [](const Move& a, const Move& b) {
            return a.gain != b.gain ? a.gain > b.gain : a.node < b.node;
        });
        std::fill(touched_.begin(), touched_.end(), uint8_t{0});
        for (const Move& m : moves) {
            const uint32_t p = parent_[m.node];
            if (p == 0 || m.target == p) continue;
            const uint32_t meets[] = {m.node,     sibling(m.node), p,
                                      parent_[p], m.target,        parent_[m.target]};
            if (std::any_of(std::begin(meets), std::end(meets),
                            [&](uint32_t i) { return touched_[i] != 0; }) ||
                is_inside(m.target, m.node))
                continue;
            for (const uint32_t i : meets) touched_[i] = 1;
            apply(m);
        }
    }

    /// Best place for the subtree x, by branch and bound: up the tree, and down beside the path.
    /// Rounding may make a gain look larger than it is by some u of the areas: gains below that
    /// are none.
    Move best_move(uint32_t x, std::vector<Entry>& stack) const {
        const Box4 moved = nodes_[x].box();
        const float own = area(moved);
        uint32_t pivot = parent_[x];
        float saved = area(nodes_[pivot].box());
        Move best{x, none, saved * 1e-5f};
        Box4 path = nodes_[sibling(x)].box();
        uint32_t visits = 0;
        search_children(sibling(x), saved, moved, own, best, stack, visits);
        while (pivot != 0) {
            const uint32_t beside = sibling(pivot), above = parent_[pivot];
            stack.push_back({beside, area(merge(nodes_[beside].box(), moved)), saved});
            search(moved, own, best, stack, visits);
            path.extend(nodes_[beside].box());
            const float whole = area(nodes_[above].box());
            const float rest = area(path);
            saved += whole - rest;
            // Beside all that is left of this ancestor; its box and the new parent's are whole.
            if (above != 0 && saved - whole > best.gain) best = {x, above, saved - whole};
            pivot = above;
            if (visits > most_visits) break;
            // Where the path is as large without x as with it, nothing more is saved above.
            if (rest == whole && !(saved - own > best.gain)) break;
        }
        return best;
    }

    void search_children(uint32_t i, float saved, const Box4& moved, float own, Move& best,
                         std::vector<Entry>& stack, uint32_t& visits) const {
        if (nodes_[i].leaf()) return;
        const Box4 box = nodes_[i].box();
        const float left = saved - (area(merge(box, moved)) - area(box));
        push_children(nodes_[i], left, moved, stack);
        search(moved, own, best, stack, visits);
    }

    void push_children(const SearchNode& node, float left, const Box4& moved,
                       std::vector<Entry>& stack) const {
        Entry a{node.left, area(merge(nodes_[node.left].box(), moved)), left};
        Entry b{node.right, area(merge(nodes_[node.right].box(), moved)), left};
        if (a.merged < b.merged) std::swap(a, b);
        stack.push_back(a);
        stack.push_back(b);
    }

    void search(const Box4& moved, float own, Move& best, std::vector<Entry>& stack,
                uint32_t& visits) const {
        while (!stack.empty()) {
            const Entry e = stack.back();
            stack.pop_back();
            // No place in this subtree costs less than the moved box's own area.
            if (!(e.left - own > best.gain)) continue;
            if (++visits > most_visits) break;
            if (e.left - e.merged > best.gain) {
                best.gain = e.left - e.merged;
                best.target = e.node;
            }
            const SearchNode& node = nodes_[e.node];
            if (node.leaf()) continue;
            const float left = e.left - (e.merged - area(node.box()));
            if (left - own > best.gain) push_children(node, left, moved, stack);
        }
        stack.clear();
    }

    bool is_inside(uint32_t i, uint32_t subtree) const {
        while (i != none && i != subtree) i = parent_[i];
        return i == subtree;
    }

    void replace_child(uint32_t of, uint32_t old, uint32_t by) {
        SearchNode& node = nodes_[of];
        (node.left == old ? node.left : node.right) = by;
        parent_[by] = of;
    }

    /// The parent of the moved subtree moves with it.
    void apply(const Move& m) {
        const uint32_t p = parent_[m.node], grand = parent_[p];
        replace_child(grand, p, sibling(m.node));
        refit(grand);
        replace_child(parent_[m.target], m.target, p);
        nodes_[p].left = m.target;
        nodes_[p].right = m.node;
        parent_[m.target] = parent_[m.node] = p;
        nodes_[p].set_box(merge(nodes_[m.target].box(), nodes_[m.node].box()));
        refit(parent_[p]);
    }

    void refit(uint32_t i) {
        for (; i != none; i = parent_[i]) {
            const Box4 box = merge(nodes_[nodes_[i].left].box(), nodes_[nodes_[i].right].box());
            if (nodes_[i].same_box(box)) return;
            nodes_[i].set_box(box);
        }
    }

    RawAlignedVector<SearchNode> nodes_, saved_nodes_;
    RawAlignedVector<uint32_t> parent_, saved_parents_;
    RawAlignedVector<uint32_t> from_;  // the nodes' indices in the tree
    std::vector<uint8_t> touched_;     // by a move of the batch
    Box4::V scale_;
};

}  // namespace

void reinsert(BinaryTree& tree, int passes) {
    if (tree.nodes.size() < 7 || passes <= 0) return;
    Optimiser optimiser(tree);
    const double before = optimiser.cost();
    double cost = before;
    for (int i = 0; i < passes; ++i) {
        if (!optimiser.pass()) break;
        const double last = std::exchange(cost, optimiser.cost());
        if (last - cost < 1e-4 * last) break;
    }
    if (!(cost < before)) return;
    BinaryTree moved;
    moved.nodes = optimiser.nodes(tree);
    if (!limit_depth(moved) || inner_area(moved) <= inner_area(tree))
        tree.nodes = std::move(moved.nodes);
}

}  // namespace crofton
