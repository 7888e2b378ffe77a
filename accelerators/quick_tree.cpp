#include "accelerators/quick_tree.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/quick_tree.cpp"
#include <hwy/foreach_target.h>

#include <hwy/cache_control.h>

#include "accelerators/morton_keys.h"
#include "accelerators/object_split.h"
#include "framework/triangle_slack.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Triangles that may still become one patch, or a subtree whose nodes are made.
struct QuickEntry {
    static constexpr uint32_t width = TrianglePatch::width;
    StoredBox box;
    /// Open: numbers of the different ones, then the first again; as far as `width`.
    alignas(32) uint32_t corner[2 * width];
    uint32_t corners;
    uint32_t count;  ///< open: triangles; 0: a subtree
    uint32_t first;  ///< open: the first of their keys
    uint32_t node;   ///< of a subtree
};

/// Makes subtrees from the leaves up. What is on the stack is not yet joined with what follows it.
class QuickBuilder {
    static constexpr uint32_t width = QuickEntry::width;
    using DN = hn::CappedTag<uint32_t, width>;  // numbers of corners
    static constexpr size_t N = hn::MaxLanes(DN());

  public:
    QuickBuilder(const PatchCorners& corners, const MortonKeys& keys, const TreeCosts& costs,
                 const ScaledAreas& areas, uint32_t most, QuickTree& out)
        : corners_(corners),
          keys_(keys),
          block_(float(costs.leaf_block)),
          one_block_(float(costs.leaf_block - costs.node)),
          areas_(areas),
          most_(most),
          out_(out) {}

    /// The subtree over keys [begin, end), which are all of those with the same highest bits.
    QuickEntry build(size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) {
            ask_ahead(i, end);
            start(i);
            settle(i + 1 < end ? keys_.key(i) ^ keys_.key(i + 1) : ~uint64_t{0});
        }
        return stack_[--size_];
    }
    /// The tree over subtrees, each over the keys from its `first` on.
    QuickEntry join(std::span<const QuickEntry> parts, std::span<const size_t> begins) {
        for (size_t i = 0; i < parts.size(); ++i) {
            stack_[size_++] = parts[i];
            settle(i + 1 < parts.size() ? keys_.key(begins[i + 1] - 1) ^ keys_.key(begins[i + 1])
                                        : ~uint64_t{0});
        }
        return stack_[--size_];
    }
    uint32_t close(QuickEntry& e) {
        if (e.count > 0) write_patch(e);
        return e.node;
    }

  private:
    /// Triangles follow one another by place, but lie in memory as the model has them.
    HWY_INLINE void ask_ahead(size_t i, size_t end) const {
        constexpr size_t triangle = 12, corner = 6;
        if (i + triangle < end) hwy::Prefetch(&corners_.triangles()[keys_.index(i + triangle)]);
        if (i + corner >= end) return;
        for (const uint32_t c : corners_.triangles()[keys_.index(i + corner)])
            hwy::Prefetch(corners_.coordinates() + size_t{3} * c);
    }
    /// A triangle by itself.
    void start(size_t i) {
        QuickEntry& e = stack_[size_++];
        const PatchCorners::Numbers& t = corners_.triangles()[keys_.index(i)];
        const Box8::D4 d;
        const auto at = [&](size_t k) {
            return Box8(hn::LoadU(d, corners_.coordinates() + size_t{3} * t[k]));
        };
        Box8 box = at(0);
        box.extend(at(1));
        box.extend(at(2));
        box.store(e.box.v);
        // In one piece, since it is loaded as one: three, if they differ.
        const DN dn;
        for (size_t p = 0; p < width; p += N) {
            const auto lane = hn::Iota(dn, uint32_t(p));
            const auto rest =
                hn::IfThenElse(hn::Eq(lane, hn::Set(dn, 2)), hn::Set(dn, t[2]), hn::Set(dn, t[0]));
            hn::Store(hn::IfThenElse(hn::Eq(lane, hn::Set(dn, 1)), hn::Set(dn, t[1]), rest), dn,
                      e.corner + p);
        }
        uint32_t n = 3;
        if (HWY_UNLIKELY(t[0] == t[1] || t[1] == t[2] || t[2] == t[0])) {
            n = 1 + uint32_t(t[1] != t[0]);
            e.corner[n] = t[2];
            n += t[2] != t[0] && t[2] != t[1];
            std::fill(e.corner + n, e.corner + width, t[0]);
        }
        e.corners = n;
        e.count = 1;
        e.first = uint32_t(i);
    }
    /// Joins what shares more bits than the last key and the next do.
    /// @param differ  their exclusive or
    void settle(uint64_t differ) {
        while (size_ > 1 && differ_[size_ - 2] < differ) merge();
        differ_[size_ - 1] = differ;
    }

    void merge() {
        QuickEntry& l = stack_[size_ - 2];
        QuickEntry& r = stack_[size_ - 1];
        --size_;
        if (l.count > 0 && r.count > 0 && l.count + r.count <= most_ && fit(l, r)) return;
        const uint32_t left = close(l), right = close(r);
        Box8 box(l.box);
        box.extend(Box8(r.box));
        box.store(l.box.v);
        BinaryTree::Node& node = add_node(l);
        node.bounds = l.box.bounds();
        node.make_inner(left, right);
    }
    BinaryTree::Node& add_node(QuickEntry& e) {
        e.node = uint32_t(out_.tree.nodes.size());
        return out_.tree.nodes.emplace_back();
    }

    /// Joins both in l if they are better off in one patch, and have room there.
    bool fit(QuickEntry& l, const QuickEntry& r) const {
        const Box8 left(l.box), right(r.box);
        Box8 both = left;
        both.extend(right);
        alignas(16) float area[4];
        hn::Store(areas_.of(left, right, both), Box8::D4(), area);
        if (one_block_ * area[2] > block_ * (area[0] + area[1])) return false;
        if (!add_corners(l, r)) return false;
        l.count += r.count;
        both.store(l.box.v);
        return true;
    }

    /// Puts those corners of r that l has not behind those of l, if there is room.
    static HWY_INLINE bool add_corners(QuickEntry& l, const QuickEntry& r) {
        const DN d;
        // Compressed in a register: some machines are slow to do it on the way to memory.
        const auto others_of = [&](size_t p, size_t& n) HWY_ATTR {
            const auto mine = hn::Load(d, r.corner + p);
            auto found = hn::Not(hn::FirstN(d, r.corners > p ? r.corners - p : 0));
            for (uint32_t i = 0; i < width; ++i)
                found = hn::Or(found, hn::Eq(mine, hn::Set(d, l.corner[i])));
            const auto others = hn::Not(found);
            n = hn::CountTrue(d, others);
            return hn::IfThenElse(hn::FirstN(d, n), hn::Compress(mine, others),
                                  hn::Set(d, l.corner[0]));
        };
        size_t n;
        if constexpr (N == width) {
            // In one piece, since it is loaded as one.
            const auto others = others_of(0, n);
            if (l.corners + n > width) return false;
            const auto place =
                hn::And(hn::Sub(hn::Iota(d, 0), hn::Set(d, l.corners)), hn::Set(d, width - 1));
            const auto moved = hn::TableLookupLanes(others, hn::IndicesFromVec(d, place));
            hn::Store(hn::IfThenElse(hn::FirstN(d, l.corners), hn::Load(d, l.corner), moved), d,
                      l.corner);
            l.corners += uint32_t(n);
            return true;
        } else {
            uint32_t corners = l.corners;
            for (size_t p = 0; p < width; p += N) {
                const auto others = others_of(p, n);
                hn::StoreU(others, d, l.corner + std::min(corners, width));
                corners += uint32_t(n);
            }
            if (corners > width) {
                std::fill(l.corner + l.corners, l.corner + width, l.corner[0]);
                return false;
            }
            l.corners = corners;
            return true;
        }
    }

    void write_patch(QuickEntry& e) {
        const auto index = uint32_t(out_.patches.size());
        TrianglePatch& patch = out_.patches.emplace_back();
        for (uint32_t i = 0; i < width; ++i) {
            const float* const at = corners_.coordinates() + size_t{3} * e.corner[i];
            for (size_t a = 0; a < 3; ++a) patch.v[a][i] = at[a];
        }
        uint32_t ids[width];
        for (uint32_t i = 0; i < e.count; ++i) {
            const uint32_t id = keys_.index(e.first + i);
            uint32_t to = i;
            for (; to > 0 && ids[to - 1] > id; --to) ids[to] = ids[to - 1];
            ids[to] = id;
        }
        std::memset(patch.corner, 0, sizeof patch.corner);
        for (uint32_t i = 0; i < e.count; ++i) {
            const PatchCorners::Numbers& t = corners_.triangles()[ids[i]];
            for (size_t k = 0; k < 3; ++k) patch.corner[k][i] = uint8_t(place_of_corner(e, t[k]));
        }
        patch.count = e.count;
        patch.first_id = 0;
        if (e.count > TrianglePatch::own_ids) {
            patch.first_id = uint32_t(out_.ids.size());
            out_.ids.insert(out_.ids.end(), ids, ids + e.count);
        } else {
            for (uint32_t i = 0; i < e.count; ++i) patch.set_own_id(i, ids[i]);
        }
        BinaryTree::Node& node = add_node(e);
        node.make_leaf(index, e.count);
        node.blocks() = 1;
        const Box8 corners(e.box);
        const SlackBox larger = with_slack(corners.lower(), corners.upper());
        Box8 box(larger.lower);
        box.extend(Box8(larger.upper));
        box.store(e.box.v);
        node.bounds = e.box.bounds();
        e.count = 0;
    }
    static HWY_INLINE size_t place_of_corner(const QuickEntry& e, uint32_t number) {
        const DN d;
        for (size_t p = 0;; p += N) {
            const auto equal = hn::Eq(hn::Load(d, e.corner + p), hn::Set(d, number));
            if (p + N == width || !hn::AllFalse(d, equal))
                return p + hn::FindKnownFirstTrue(d, equal);
        }
    }

    const PatchCorners& corners_;
    const MortonKeys& keys_;
    float block_, one_block_;
    ScaledAreas areas_;
    uint32_t most_;
    QuickTree& out_;
    /// Keys of two neighbours differ in a lower bit than those of the two below them: there are no
    /// more than bits, and one.
    QuickEntry stack_[66];
    uint64_t differ_[66];  ///< between an entry and the next
    size_t size_ = 0;
};

/// Where runs of keys begin that share their highest bits, each of `most` keys at the most.
inline std::vector<size_t> split_keys(const MortonKeys& keys, size_t most) {
    struct Range {
        size_t begin, end;
    };
    std::vector<size_t> begins;
    std::vector<Range> open{{0, keys.size()}};
    while (!open.empty()) {
        const Range r = open.back();
        open.pop_back();
        if (r.end - r.begin <= most) {
            begins.push_back(r.begin);
            continue;
        }
        const size_t at = keys.split(r.begin, r.end);
        open.push_back({at, r.end});
        open.push_back({r.begin, at});
    }
    return begins;
}

/// Puts trees behind one another. @param roots  of each; become nodes of the whole
inline void append(std::span<QuickTree> parts, std::span<QuickEntry> roots, QuickTree& out) {
    struct Place {
        size_t node = 0, patch = 0, id = 0;
    };
    std::vector<Place> places(parts.size() + 1);
    places[0].node = out.tree.nodes.size();
    for (size_t i = 0; i < parts.size(); ++i)
        places[i + 1] = {places[i].node + parts[i].tree.nodes.size(),
                         places[i].patch + parts[i].patches.size(),
                         places[i].id + parts[i].ids.size()};
    out.tree.nodes.resize(places.back().node);
    out.patches.resize(places.back().patch);
    out.ids.resize(places.back().id);
    parallel_for(parts.size(), 1, [&](size_t from, size_t to) {
        for (size_t i = from; i < to; ++i) {
            const Place& place = places[i];
            QuickTree& part = parts[i];
            for (BinaryTree::Node& n : part.tree.nodes) {
                if (n.leaf()) {
                    n.first += uint32_t(place.patch);
                } else {
                    n.left += uint32_t(place.node);
                    n.right += uint32_t(place.node);
                }
            }
            for (TrianglePatch& p : part.patches)
                if (p.count > TrianglePatch::own_ids) p.first_id += uint32_t(place.id);
            std::copy(part.tree.nodes.begin(), part.tree.nodes.end(),
                      out.tree.nodes.begin() + ptrdiff_t(place.node));
            std::copy(part.patches.begin(), part.patches.end(),
                      out.patches.begin() + ptrdiff_t(place.patch));
            std::copy(part.ids.begin(), part.ids.end(), out.ids.begin() + ptrdiff_t(place.id));
            roots[i].node += uint32_t(place.node);
            part = {};
        }
    });
}

QuickTree build_quick_tree(const PatchCorners& corners, const MortonKeys& keys,
                           const TreeCosts& costs, uint32_t most) {
    constexpr size_t least_part = 4096, most_parts = 64;
    StoredBox all;
    const Bounds3 bounds = keys.bounds();
    for (int a = 0; a < 3; ++a) all.v[a] = bounds.lower[a], all.v[4 + a] = -bounds.upper[a];
    const ScaledAreas areas(all);
    const std::vector<size_t> begins =
        split_keys(keys, std::max(least_part, keys.size() / most_parts));
    const auto end = [&](size_t i) { return i + 1 < begins.size() ? begins[i + 1] : keys.size(); };
    std::vector<QuickEntry> roots(begins.size());
    QuickTree out;
    out.tree.nodes.resize(1);  // the root's place
    QuickBuilder builder(corners, keys, costs, areas, most, out);
    const auto make_room = [](QuickTree& tree, size_t triangles) {
        tree.patches.reserve(triangles / 4);
        tree.tree.nodes.reserve(triangles / 2);
    };
    if (threads() == 1 || begins.size() == 1) {
        make_room(out, keys.size());
        for (size_t i = 0; i < begins.size(); ++i) roots[i] = builder.build(begins[i], end(i));
    } else {
        std::vector<QuickTree> parts(begins.size());
        parallel_for(begins.size(), 1, [&](size_t from, size_t to) {
            for (size_t i = from; i < to; ++i) {
                make_room(parts[i], end(i) - begins[i]);
                roots[i] = QuickBuilder(corners, keys, costs, areas, most, parts[i])
                               .build(begins[i], end(i));
            }
        });
        append(parts, roots, out);
    }
    QuickEntry root = builder.join(roots, begins);
    out.tree.nodes[0] = out.tree.nodes[builder.close(root)];
    out.triangles = uint32_t(keys.size());
    return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include "accelerators/morton.h"

namespace crofton {
HWY_EXPORT(build_quick_tree);

namespace {
/// Boxes of the triangles' corners; none of those that have corners at infinity or nowhere.
MortonKeys keys_of(const TriangleSet& set) {
    return morton_keys(set.size(), [&set](size_t i, Box4& box) {
        const Box4::D d;
        const TriangleSet::Indices& t = set.triangles()[i];
        const auto at = [&](size_t k) {
            return hn::LoadU(d, set.coordinates() + size_t{3} * t[k]);
        };
        const auto a = at(0), b = at(1), c = at(2);
        box = Box4(hn::Min(hn::Min(a, b), c), hn::Max(hn::Max(a, b), c));
        const auto zero = hn::Zero(d);
        const auto nothing = hn::Add(hn::Add(hn::Mul(a, zero), hn::Mul(b, zero)), hn::Mul(c, zero));
        return hn::AllTrue(d, hn::Or(hn::Eq(nothing, zero), hn::Not(hn::FirstN(d, 3))));
    });
}

}  // namespace

QuickTree build_quick_tree(const TriangleSet& set, const PatchCorners& corners,
                           const TreeCosts& costs, int max_leaf_size) {
    const MortonKeys keys = keys_of(set);
    if (keys.size() == 0) return {};
    const uint32_t most = std::min(uint32_t(max_leaf_size), TrianglePatch::width);
    return HWY_DYNAMIC_DISPATCH(build_quick_tree)(corners, keys, costs, most);
}

}  // namespace crofton
#endif
