// Box tests of all children of a wide node; included once per target.
#if defined(CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#undef CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#else
#define CROFTON_ACCELERATORS_WIDE_CHILDREN_TEST_H_
#endif

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

/// Tests all children of a node, as many at once as a vector has lanes.
/// @param t_near  Node::width floats: where the ray enters each child
/// @return bit i: child i may be hit within [t_low, t_cull]
template <class Test, class Node>
HWY_INLINE uint32_t test_children(const Test& test, const Node& node, float t_low, float t_cull,
                                  float* HWY_RESTRICT t_near) {
    uint32_t hits = 0;
    const NodeLanes<Node> d;
    for (size_t i = 0; i < Node::width; i += hn::MaxLanes(d)) {
        ChildLanes<Node> enter;
        hits |= mask_bits(d, test.lanes(node, i, t_low, t_cull, enter)) << i;
        hn::Store(enter, d, t_near + i);
    }
    return hits;
}

/// Which planes a ray meets first is an offset into the node.
/// @param size  bytes of the planes of an axis
struct PlaneOffsets {
    size_t enter[3], leave[3];
    HWY_INLINE PlaneOffsets(const LocalRay& ray, size_t begin, size_t size) {
        for (size_t a = 0; a < 3; ++a) {
            const size_t upper = std::signbit(ray.rcp[a]) ? 3 * size : 0;
            enter[a] = begin + a * size + upper;
            leave[a] = begin + (a + 3) * size - upper;
        }
    }
};

/// Where a ray enters and leaves some children of a node, as many as a vector has lanes, by one
/// fused operation a plane: see LocalRay for its error. The ray's numbers come from memory each
/// time: they are operands of the arithmetic, and leaf tests would have emptied the registers.
template <class Node>
class ChildrenTest;

template <int W>
class ChildrenTest<WideNode<W>> {
    using Node = WideNode<W>;

  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(ray, offsetof(Node, planes), W * sizeof(float)) {
        const hn::FixedTag<float, 4> f4;
        hn::Store(hn::Mul(hn::LoadU(f4, ray.near_origin), hn::LoadU(f4, ray.rcp)), f4, enter_);
        hn::Store(hn::Mul(hn::LoadU(f4, ray.far_origin), hn::LoadU(f4, ray.far_rcp)), f4, leave_);
    }

    /// Of the children from `first` on, as many as a vector has lanes: where the ray enters each.
    /// @return  which may be hit within [t_low, t_cull]
    HWY_INLINE ChildMask<Node> lanes(const Node& node, size_t first, float t_low, float t_cull,
                                     ChildLanes<Node>& enter) const {
        const NodeLanes<Node> d;
        const auto* const bytes = reinterpret_cast<const char*>(&node);
        const auto at = [&](size_t offset, const float& base, const float& rcp) HWY_ATTR {
            const auto plane = hn::Load(d, reinterpret_cast<const float*>(bytes + offset) + first);
            return hn::MulSub(plane, hn::Set(d, rcp), hn::Set(d, base));
        };
        const auto x0 = at(offsets_.enter[0], enter_[0], ray_.rcp[0]);
        const auto y0 = at(offsets_.enter[1], enter_[1], ray_.rcp[1]);
        const auto z0 = at(offsets_.enter[2], enter_[2], ray_.rcp[2]);
        const auto x1 = at(offsets_.leave[0], leave_[0], ray_.far_rcp[0]);
        const auto y1 = at(offsets_.leave[1], leave_[1], ray_.far_rcp[1]);
        const auto z1 = at(offsets_.leave[2], leave_[2], ray_.far_rcp[2]);
        enter = hn::Max(hn::Max(x0, y0), hn::Max(z0, hn::Set(d, t_low)));
        const auto leave = hn::Min(hn::Min(x1, y1), hn::Min(z1, hn::Set(d, t_cull)));
        return hn::Le(enter, leave);
    }

  private:
    const LocalRay& ray_;
    PlaneOffsets offsets_;
    alignas(16) float enter_[4], leave_[4];  ///< near_origin·rcp, far_origin·far_rcp
};

/// One multiplication and addition a plane: the node's grid is moved to the ray first. The error of
/// that, some u of the node's extent, is what `quantise` leaves room for.
template <int W>
class ChildrenTest<QuantisedNode<W>> {
    using Node = QuantisedNode<W>;

  public:
    explicit HWY_INLINE ChildrenTest(const LocalRay& ray)
        : ray_(ray), offsets_(ray, offsetof(Node, planes), W) {}

    /// Of the children from `first` on, as above.
    HWY_INLINE ChildMask<Node> lanes(const Node& node, size_t first, float t_low, float t_cull,
                                     ChildLanes<Node>& enter) const {
        const NodeLanes<Node> d;
        const hn::Rebind<uint8_t, NodeLanes<Node>> d8;
        const hn::Rebind<int32_t, NodeLanes<Node>> d32;
        const auto* const bytes = reinterpret_cast<const uint8_t*>(&node) + first;
        const auto at = [&](size_t offset, int a, const float* origin, const float* rcp) HWY_ATTR {
            const auto plane = hn::ConvertTo(d, hn::PromoteTo(d32, hn::LoadU(d8, bytes + offset)));
            return hn::MulAdd(plane, hn::Set(d, node.scale[a] * rcp[a]),
                              hn::Set(d, (node.origin[a] - origin[a]) * rcp[a]));
        };
        enter = hn::Set(d, t_low);
        auto leave = hn::Set(d, t_cull);
        for (int a = 0; a < 3; ++a) {
            enter = hn::Max(enter, at(offsets_.enter[a], a, ray_.near_origin, ray_.rcp));
            leave = hn::Min(leave, at(offsets_.leave[a], a, ray_.far_origin, ray_.far_rcp));
        }
        const auto used = hn::FirstN(d, node.children > first ? node.children - first : 0);
        return hn::And(hn::Le(enter, leave), used);
    }

  private:
    const LocalRay& ray_;
    PlaneOffsets offsets_;
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
