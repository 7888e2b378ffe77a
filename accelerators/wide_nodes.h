#pragma once

#include <hwy/cache_control.h>

#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

#include "framework/aligned.h"
#include "framework/bounds.h"
#include "framework/triangle_patches.h"

namespace crofton {

/// Most children of a wide node.
inline constexpr int max_wide_width = 16;

/// A child: where an inner node is, see node_at; or, with bit 31, a leaf: count - 1 in bits 26 …
/// 30, where its patches or references begin in bits 0 … 25.
struct WideChild {
    static constexpr uint32_t leaf_bit = 1u << 31, first_bits = 26;
    static constexpr uint32_t max_first = (1u << first_bits) - 1, max_count = 32;
    /// No children: `first` of a leaf is below max_first. Where a stack ends, or had to.
    static constexpr uint32_t end = ~0u, overflow = end - (1u << first_bits);
    static bool is_none(uint32_t child) { return child >= overflow && first(child) == max_first; }
    static uint32_t leaf(uint32_t first, uint32_t count) {
        return leaf_bit | (count - 1) << first_bits | first;
    }
    static bool is_leaf(uint32_t child) { return child & leaf_bit; }
    static uint32_t first(uint32_t child) { return child & max_first; }
    static uint32_t count(uint32_t child) { return (child >> first_bits & 31) + 1; }
};

/// W children side by side, W being 4, 8 or 16.
///
///   byte      0  planes[0]: lower x, y, z of all children, W floats each
///           12·W  planes[1]: upper x, y, z likewise
///           24·W  child[W]
/// Unused children have lower = +inf, upper = -inf, which no ray meets.
template <int W>
struct alignas(4 * W) WideNode {
    static constexpr int width = W;
    float planes[2][3][W];
    uint32_t child[W];
};
static_assert(sizeof(WideNode<8>) == 224);

/// The same with bytes: plane = origin + scale·byte, rounded outwards (after Ylitie, Karras, Laine
/// 2017).
///
///   byte   0  origin x, y, z     12  scale x, y, z (floats)
///         24  planes[0]: lower x, y, z of all children, W bytes each     24 + 3·W  planes[1]:
///         upper 24 + 6·W  child[W]     24 + 10·W  count of children
template <int W>
struct alignas(8) QuantisedNode {
    static constexpr int width = W;
    float origin[3];
    float scale[3];
    uint8_t planes[2][3][W];
    uint32_t child[W];
    uint32_t children;
    uint32_t unused;
};
static_assert(sizeof(QuantisedNode<8>) == 112);

/// Places of nodes are counted in steps of their alignment, which makes an address of a place by a
/// shift.
template <class Node>
uint32_t place_of(size_t index) {
    return uint32_t(index * (sizeof(Node) / alignof(Node)));
}
template <class Node>
const Node& node_at(const Node* nodes, uint32_t place) {
    return *reinterpret_cast<const Node*>(reinterpret_cast<const char*>(nodes) +
                                          size_t(place) * alignof(Node));
}

/// Asks for what a child needs when it is visited: a node, or a leaf's first patch.
template <class Node, class Leaves>
HWY_INLINE void prefetch_child(const Node* nodes, const Leaves& leaves, uint32_t child) {
    // All in one function: GCC takes one that does no more than prefetch for one without effects,
    // and drops calls of it.
    // Of known lengths, both loops are unrolled.
    if (!WideChild::is_leaf(child)) {
        const auto* const begin = reinterpret_cast<const char*>(&node_at(nodes, child));
        for (size_t i = 0; i < sizeof(Node); i += 64) hwy::Prefetch(begin + i);
    } else if constexpr (std::is_same_v<Leaves, TrianglePatches>) {
        const auto* const begin =
            reinterpret_cast<const char*>(leaves.patches() + WideChild::first(child));
        for (size_t i = 0; i < sizeof(TrianglePatch); i += 64) hwy::Prefetch(begin + i);
    }
}

/// Box of child i as traversal sees it; empty if there is none.
template <int W>
Bounds3 child_bounds(const WideNode<W>& node, int i) {
    Bounds3 b;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = node.planes[0][a][i];
        b.upper[a] = node.planes[1][a][i];
    }
    return b;
}
template <int W>
Bounds3 child_bounds(const QuantisedNode<W>& node, int i) {
    Bounds3 b;
    if (i >= int(node.children)) return b;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = float(node.origin[a] + double(node.scale[a]) * node.planes[0][a][i]);
        b.upper[a] = float(node.origin[a] + double(node.scale[a]) * node.planes[1][a][i]);
    }
    return b;
}

enum class WideFormat { full, quantised };

/// The nodes of a structure, all of one form and width; the root comes first.
class WideNodes {
  public:
    WideNodes() = default;
    /// @param width  4, 8 or 16
    WideNodes(WideFormat format, int width) : format_(format), width_(width) {}

    WideFormat format() const { return format_; }
    int width() const { return width_; }
    size_t bytes() const { return memory_.size(); }

    /// f(const Node*), the root, or null if there is none; the type tells form and width. Becomes
    /// part of the caller, which may be compiled for another instruction set.
    template <class F>
    HWY_INLINE decltype(auto) visit(const F& f) const {
        return format_ == WideFormat::full ? visit_full(f) : visit_width<QuantisedNode>(f);
    }
    /// The same, of nodes that are known to be full.
    template <class F>
    HWY_INLINE decltype(auto) visit_full(const F& f) const {
        return visit_width<WideNode>(f);
    }
    /// @return  `count` nodes to be written
    template <class Node>
    std::span<Node> resize(size_t count) {
        memory_.resize(count * sizeof(Node));
        return {reinterpret_cast<Node*>(memory_.data()), count};
    }
    template <class A>
    void archive(A& a) {
        a(format_, width_, memory_);
    }

  private:
    template <template <int> class Node, class F>
    HWY_INLINE decltype(auto) visit_width(const F& f) const {
        switch (width_) {
            case 4:
                return f(first<Node<4>>());
            case 16:
                return f(first<Node<16>>());
            default:
                return f(first<Node<8>>());
        }
    }
    template <class Node>
    const Node* first() const {
        return reinterpret_cast<const Node*>(memory_.data());
    }

    WideFormat format_ = WideFormat::full;
    int width_ = 8;
    RawAlignedVector<std::byte> memory_;
};

}  // namespace crofton
