// Box tests of all children of a wide node; included once per target.
#if defined(CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#undef CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#else
#define CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#endif

#include <array>

#include "accelerators/wide_nodes.h"
#include "framework/simd.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Children that are tested at once.
template <class Node>
using NodeLanes = hn::CappedTag<float, Node::width>;
template <class Node>
using ChildLanes = hn::Vec<NodeLanes<Node>>;
template <class Node>
using ChildMask = hn::Mask<NodeLanes<Node>>;

/// What became of a node's children, as many side by side as a vector has lanes.
template <class Node>
struct ChildrenMet {
    static constexpr size_t lanes = hn::MaxLanes(NodeLanes<Node>()), parts = Node::width / lanes;
    ChildLanes<Node> enter[parts];  ///< where the ray enters each
    ChildMask<Node> met[parts];     ///< which may be hit

    HWY_INLINE uint32_t bits() const {
        uint32_t bits = 0;
        for (size_t p = 0; p < parts; ++p)
            bits |= mask_bits(NodeLanes<Node>(), met[p]) << p * lanes;
        return bits;
    }
};

/// Tests all children of a node.
/// @param t_near  Node::width floats: where the ray enters each child
/// @return bit i: child i may be hit within [t_low, t_cull]
template <class Test, class Node>
HWY_INLINE uint32_t test_children(const Test& test, const Node& node, float t_low, float t_cull,
                                  float* HWY_RESTRICT t_near) {
    const ChildrenMet<Node> children = test(node, t_low, t_cull);
    for (size_t p = 0; p < children.parts; ++p)
        hn::Store(children.enter[p], NodeLanes<Node>(), t_near + p * children.lanes);
    return children.bits();
}

/// Which planes a ray meets first is an offset into the node.
struct PlaneOffsets {
    size_t enter[3], leave[3];
};
/// By octant; bit a: the ray goes down axis a.
template <class Node>
inline constexpr std::array<PlaneOffsets, 8> plane_offsets = [] {
    constexpr size_t begin = offsetof(Node, planes), size = sizeof(Node::planes) / 6;
    std::array<PlaneOffsets, 8> all{};
    for (size_t octant = 0; octant < 8; ++octant)
        for (size_t a = 0; a < 3; ++a) {
            const size_t upper = octant >> a & 1 ? 3 * size : 0;
            all[octant].enter[a] = begin + a * size + upper;
            all[octant].leave[a] = begin + (a + 3) * size - upper;
        }
    return all;
}();
template <class Node>
HWY_INLINE const PlaneOffsets& plane_offsets_for(const LocalRay& ray) {
    const hn::FixedTag<float, 4> d;
    const hn::RebindToSigned<decltype(d)> di;
    const auto down =
        hn::RebindMask(d, hn::Lt(hn::BitCast(di, hn::LoadU(d, ray.rcp)), hn::Zero(di)));
    return plane_offsets<Node>[mask_bits(d, down) & 7];
}

/// Tests all children of a node, by one fused operation a plane: see LocalRay for its error. The
/// ray's numbers come from memory each time, one load for all lanes: leaf tests would have emptied
/// the registers. Plane by plane, so that few of them are needed.
template <class Node>
class ChildrenTest;

template <int W>
class ChildrenTest<WideNode<W>> {
    using Node = WideNode<W>;
    using Met = ChildrenMet<Node>;

  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(plane_offsets_for<Node>(ray)) {}

    /// Which children may be hit within [t_low, t_cull].
    HWY_INLINE Met operator()(const Node& node, float t_low, float t_cull) const {
        const NodeLanes<Node> d;
        const auto* const bytes = reinterpret_cast<const char*>(&node);
        Met children;
        ChildLanes<Node> leave[Met::parts];
        for (size_t p = 0; p < Met::parts; ++p) {
            children.enter[p] = hn::Set(d, t_low);
            leave[p] = hn::Set(d, t_cull);
        }
        for (size_t a = 0; a < 3; ++a) {
            const auto in = reinterpret_cast<const float*>(bytes + offsets_.enter[a]);
            const auto rcp = hn::Set(d, ray_.rcp[a]), base = hn::Set(d, ray_.near_base[a]);
            for (size_t p = 0; p < Met::parts; ++p)
                children.enter[p] = hn::Max(
                    children.enter[p], hn::MulSub(hn::Load(d, in + p * Met::lanes), rcp, base));
        }
        for (size_t a = 0; a < 3; ++a) {
            const auto out = reinterpret_cast<const float*>(bytes + offsets_.leave[a]);
            const auto rcp = hn::Set(d, ray_.far_rcp[a]), base = hn::Set(d, ray_.far_base[a]);
            for (size_t p = 0; p < Met::parts; ++p)
                leave[p] =
                    hn::Min(leave[p], hn::MulSub(hn::Load(d, out + p * Met::lanes), rcp, base));
        }
        for (size_t p = 0; p < Met::parts; ++p)
            children.met[p] = hn::Le(children.enter[p], leave[p]);
        return children;
    }

  private:
    const LocalRay& ray_;
    const PlaneOffsets& offsets_;
};

/// One multiplication and addition a plane: the node's grid is moved to the ray first. The error of
/// that, some u of the node's extent, is what `quantise` leaves room for.
template <int W>
class ChildrenTest<QuantisedNode<W>> {
    using Node = QuantisedNode<W>;
    using Met = ChildrenMet<Node>;

  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(plane_offsets_for<Node>(ray)) {}

    /// As above.
    HWY_INLINE Met operator()(const Node& node, float t_low, float t_cull) const {
        const NodeLanes<Node> d;
        const hn::Rebind<uint8_t, NodeLanes<Node>> d8;
        const hn::Rebind<int32_t, NodeLanes<Node>> d32;
        const auto* const bytes = reinterpret_cast<const uint8_t*>(&node);
        Met children;
        ChildLanes<Node> leave[Met::parts];
        for (size_t p = 0; p < Met::parts; ++p) {
            children.enter[p] = hn::Set(d, t_low);
            leave[p] = hn::Set(d, t_cull);
        }
        const auto load = [&](size_t offset, size_t p) HWY_ATTR {
            const auto plane = hn::LoadU(d8, bytes + offset + p * Met::lanes);
            return hn::ConvertTo(d, hn::PromoteTo(d32, plane));
        };
        for (size_t a = 0; a < 3; ++a) {
            const auto in = hn::Set(d, node.scale[a] * ray_.rcp[a]),
                       base = hn::Set(d, (node.origin[a] - ray_.near_origin[a]) * ray_.rcp[a]);
            for (size_t p = 0; p < Met::parts; ++p)
                children.enter[p] =
                    hn::Max(children.enter[p], hn::MulAdd(load(offsets_.enter[a], p), in, base));
        }
        for (size_t a = 0; a < 3; ++a) {
            const auto out = hn::Set(d, node.scale[a] * ray_.far_rcp[a]),
                       base = hn::Set(d, (node.origin[a] - ray_.far_origin[a]) * ray_.far_rcp[a]);
            for (size_t p = 0; p < Met::parts; ++p)
                leave[p] = hn::Min(leave[p], hn::MulAdd(load(offsets_.leave[a], p), out, base));
        }
        for (size_t p = 0; p < Met::parts; ++p) {
            const size_t first = p * Met::lanes;
            const auto used = hn::FirstN(d, node.children > first ? node.children - first : 0);
            children.met[p] = hn::And(hn::Le(children.enter[p], leave[p]), used);
        }
        return children;
    }

  private:
    const LocalRay& ray_;
    const PlaneOffsets& offsets_;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
