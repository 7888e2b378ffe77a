// How much larger the boxes of triangles are than their corners; included once per target.
#if defined(CROFTON_FRAMEWORK_TRIANGLE_SLACK_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_TRIANGLE_SLACK_H_
#undef CROFTON_FRAMEWORK_TRIANGLE_SLACK_H_
#else
#define CROFTON_FRAMEWORK_TRIANGLE_SLACK_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Lower and upper corner of a box, in lanes 0 to 2.
struct SlackBox {
    using D = hn::FixedTag<float, 4>;
    using V = hn::Vec<D>;
    V lower, upper;
};

/// As grown(box, slack of it), see TriangleSet::bounds, with the axes side by side. It contains
/// what it returns for a smaller box.
HWY_INLINE SlackBox with_slack(SlackBox::V lower, SlackBox::V upper) {
    const SlackBox::D d;
    const auto ulp = hn::Set(d, 0x1p-24f);
    const auto u = hn::Sub(hn::Mul(upper, ulp), hn::Mul(lower, ulp));
    alignas(16) float e[4];
    hn::Store(u, d, e);
    const auto most = hn::Set(d, std::max({e[0], e[1], e[2]}) * 2.6f);
    const auto slack = hn::Add(hn::Mul(u, hn::Set(d, 1.1f)), most);
    const auto share = hn::Set(d, 0x1p-23f), limit = hn::Set(d, std::numeric_limits<float>::max());
    const auto low = hn::Sub(lower, hn::Add(hn::Mul(hn::Abs(lower), share), slack));
    const auto high = hn::Add(upper, hn::Add(hn::Mul(hn::Abs(upper), share), slack));
    return {hn::Max(low, hn::Neg(limit)), hn::Min(high, limit)};
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
