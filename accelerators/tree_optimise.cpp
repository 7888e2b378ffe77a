#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "accelerators/box4.h"
#include "accelerators/tree_build.h"

namespace crofton {
namespace {

constexpr uint32_t none = ~0u;
constexpr size_t least_candidates = 1024;
constexpr size_t least_batch = 256;
constexpr size_t batches = 16;         // of a pass; each sees what the ones before have moved
constexpr double least_gain = 1e-3;    // of the sum of areas: two batches that gain less end a pass
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
    /// Half of its surface, in double.
    double half_area() const {
        const double x = double(upper[0]) - lower[0], y = double(upper[1]) - lower[1],
                     z = double(upper[2]) - lower[2];
        return x * y + y * z + z * x;
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

/// A subtree to be moved: it becomes the sibling of `target`.
struct Move {
    uint32_t node = none, target = none;
    float gain = 0;
};

/// Nodes that may move, in batches of falling area. Within a batch they are in the order of the
/// tree, so that a search mostly passes where the one before it did.
class Batches {
  public:
    /// @param areas  negative: such a node can't move
    /// @param most   nodes in all batches, about
    Batches(std::span<const float> areas, size_t most) {
        // By the leading bits of the area, of which there are few: no need to sort.
        std::vector<uint32_t> count(keys);
        for (const float a : areas)
            if (a >= 0) ++count[key(a)];
        const size_t size = std::max(most / batches + 1, least_batch);
        std::vector<uint8_t> batch(keys, batches);
        size_t larger = 0;
        for (size_t k = keys; k-- > 0 && larger < most;) {
            batch[k] = uint8_t(std::min(larger / size, batches - 1));
            larger += count[k];
        }
        for (size_t i = 0; i < areas.size(); ++i) {
            const size_t b = areas[i] >= 0 ? batch[key(areas[i])] : batches;
            // In a mesh of equal triangles a batch would have most of them.
            if (b < batches && lists_[b].size() < 2 * size) lists_[b].push_back(uint32_t(i));
        }
    }
    auto begin() const { return lists_.begin(); }
    auto end() const { return lists_.end(); }

  private:
    static constexpr size_t keys = size_t{1} << 15;
    static size_t key(float area) { return std::bit_cast<uint32_t>(area) >> 16; }
    std::array<std::vector<uint32_t>, batches> lists_;
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
        cost_ = sum_chunks<Sum>(0, nodes_.size(), [&](size_t begin, size_t end) {
                    Sum sum;
                    for (size_t i = begin; i < end; ++i)
                        if (!nodes_[i].leaf()) sum.value += nodes_[i].half_area();
                    return sum;
                }).value;
    }

    /// Half areas of all inner nodes: the part of the area heuristic that moves can change.
    double cost() const { return cost_; }

    void pass() {
        const double least = least_gain * cost_;
        int poor = 0;
        for (const std::vector<uint32_t>& batch : largest_first()) {
            const double before = cost_;
            move_all(batch);
            // Those that follow are smaller.
            poor = before - cost_ < least ? poor + 1 : 0;
            if (poor == 2) break;
        }
    }

    /// Whether a leaf is deeper than BinaryTree::max_depth.
    bool is_too_deep() const {
        RawAlignedVector<std::pair<uint32_t, int>> open{{0, 0}};
        while (!open.empty()) {
            const auto [i, depth] = open.back();
            open.pop_back();
            if (depth > BinaryTree::max_depth) return true;
            if (nodes_[i].leaf()) continue;
            open.emplace_back(nodes_[i].right, depth + 1);
            open.emplace_back(nodes_[i].left, depth + 1);
        }
        return false;
    }

    /// Puts the inner nodes, as they are now, into the tree that this was made of.
    void store(BinaryTree& tree) const {
        parallel_for(nodes_.size(), 1 << 13, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) {
                const SearchNode& from = nodes_[i];
                if (from.leaf()) continue;
                BinaryTree::Node& to = tree.nodes[from_[i]];
                to.make_inner(from_[from.left], from_[from.right]);
                for (int a = 0; a < 3; ++a)
                    to.bounds.lower[a] = from.lower[a], to.bounds.upper[a] = from.upper[a];
            }
        });
    }

  private:
    /// For the best place of a subtree.
    struct Search {
        Box4 moved;
        float own;  // its area
        Move best;
        uint32_t visits = 0;

        /// Whether places below a node may be better than the best: none costs less than the
        /// moved box's own area.
        bool may_gain(float left) const { return left - own > best.gain; }
        void found(uint32_t target, float gain) {
            if (gain > best.gain) best.gain = gain, best.target = target;
        }
    };

    struct Sum {
        double value = 0;
        void add(const Sum& s) { value += s.value; }
    };

    float area(const Box4& b) const {
        const Box4::D d;
        const hn::Repartition<uint8_t, Box4::D> d8;
        alignas(16) static constexpr uint8_t yzx[16] = {4, 5, 6, 7, 8, 9, 10, 11,
                                                        0, 1, 2, 3, 0, 1, 2,  3};
        const auto e = hn::Mul(hn::Sub(b.upper, b.lower), scale_);
        const auto next =
            hn::BitCast(d, hn::TableLookupBytes(hn::BitCast(d8, e), hn::Load(d8, yzx)));
        const auto faces = hn::Mul(e, next);  // xy, yz, zx, -
        return hn::GetLane(hn::Add(hn::Add(faces, hn::Shuffle2301(faces)), hn::Shuffle1032(faces)));
    }
    uint32_t sibling(uint32_t i) const {
        const SearchNode& p = nodes_[parent_[i]];
        return p.left == i ? p.right : p.left;
    }

    /// The largest quarter of the nodes that can move. The others gain little: as many searches
    /// spent on further passes gain more.
    Batches largest_first() const {
        RawAlignedVector<float> areas(nodes_.size());
        parallel_for(nodes_.size(), 1 << 13, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                areas[i] = i != 0 && parent_[i] != 0 ? area(nodes_[i].box()) : -1.0f;
        });
        // The root and its children can't move.
        const size_t movable = nodes_.size() - 3;
        return Batches(areas, std::max(movable / 4, std::min(movable, least_candidates)));
    }

    /// Searches for all of `candidates` at once, then makes the moves that don't meet, best first.
    void move_all(std::span<const uint32_t> candidates) {
        std::vector<Move> moves(candidates.size());
        parallel_for(candidates.size(), 64, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) moves[i] = best_move(candidates[i]);
        });
        std::erase_if(moves, [](const Move& m) { return m.target == none; });
        std::sort(moves.begin(), moves.end(), [](const Move& a, const Move& b) {
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
    Move best_move(uint32_t x) const {
        uint32_t pivot = parent_[x], beside = sibling(x);
        Box4 path = nodes_[beside].box();
        float whole = area(nodes_[pivot].box());
        float saved = whole;
        Search search{nodes_[x].box(), area(nodes_[x].box()), {x, none, saved * 1e-5f}};
        look_below(beside, saved - (whole - area(path)), search);
        while (pivot != 0 && search.visits <= most_visits) {
            beside = sibling(pivot);
            const uint32_t above = parent_[pivot];
            const float below = look_at(beside, saved, search);
            if (search.may_gain(below)) look_below(beside, below, search);
            path.extend(nodes_[beside].box());
            whole = area(nodes_[above].box());
            const float rest = area(path);
            saved += whole - rest;
            // Beside all that is left of this ancestor; its box and the new parent's are whole.
            if (above != 0) search.found(above, saved - whole);
            pivot = above;
            // Where the path is as large without x as with it, nothing more is saved above.
            if (rest == whole && !search.may_gain(saved)) break;
        }
        return search.best;
    }

    /// Beside node i as a place. @param left  gain before that: saved, less what ancestors grow
    /// @return the same for places below it; minus infinity for a leaf
    float look_at(uint32_t i, float left, Search& search) const {
        ++search.visits;
        const SearchNode& node = nodes_[i];
        const Box4 box = node.box();
        const float merged = area(merge(box, search.moved));
        search.found(i, left - merged);
        return node.leaf() ? -std::numeric_limits<float>::infinity() : left - (merged - area(box));
    }

    /// Places below node i, where they may gain more than the best so far. @param left  as above
    void look_below(uint32_t i, float left, Search& search) const {
        if (nodes_[i].leaf()) return;
        struct Entry {
            uint32_t node;
            float left;
        };
        // No deeper than any tree that is kept; two children a level at most.
        std::array<Entry, 2 * BinaryTree::max_depth> stack;
        size_t size = 0;
        Entry next{i, left};
        while (true) {
            const SearchNode& node = nodes_[next.node];
            Entry a{node.left, look_at(node.left, next.left, search)};
            Entry b{node.right, look_at(node.right, next.left, search)};
            if (a.left > b.left) std::swap(a, b);
            if (size < stack.size() && search.may_gain(a.left)) stack[size++] = a;
            next = b;
            while (!search.may_gain(next.left)) {
                if (size == 0) return;
                next = stack[--size];
            }
            if (search.visits > most_visits) return;
        }
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
        cost_ -= nodes_[p].half_area();
        nodes_[p].set_box(merge(nodes_[m.target].box(), nodes_[m.node].box()));
        cost_ += nodes_[p].half_area();
        refit(parent_[p]);
    }

    void refit(uint32_t i) {
        for (; i != none; i = parent_[i]) {
            const Box4 box = merge(nodes_[nodes_[i].left].box(), nodes_[nodes_[i].right].box());
            if (nodes_[i].same_box(box)) return;
            cost_ -= nodes_[i].half_area();
            nodes_[i].set_box(box);
            cost_ += nodes_[i].half_area();
        }
    }

    RawAlignedVector<SearchNode> nodes_;
    RawAlignedVector<uint32_t> parent_;
    RawAlignedVector<uint32_t> from_;  // the nodes' indices in the tree
    double cost_;
    std::vector<uint8_t> touched_;  // by a move of the batch
    Box4::V scale_;
};

}  // namespace

void reinsert(BinaryTree& tree, int passes) {
    if (tree.nodes.size() < 7 || passes <= 0) return;
    Optimiser optimiser(tree);
    const double before = optimiser.cost();
    for (int i = 0; i < passes; ++i) {
        const double last = optimiser.cost();
        optimiser.pass();
        if (last - optimiser.cost() < least_gain * last) break;
    }
    if (!(optimiser.cost() < before)) return;
    if (!optimiser.is_too_deep()) return optimiser.store(tree);
    BinaryTree moved;
    moved.nodes = tree.nodes;
    optimiser.store(moved);
    limit_depth(moved);
    if (inner_area(moved) <= inner_area(tree)) tree.nodes.swap(moved.nodes);
}

}  // namespace crofton
