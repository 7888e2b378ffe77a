#pragma once

#include <hwy/highway.h>

#include <array>

#include "accelerators/binary_tree.h"

namespace crofton {

namespace hn = hwy::HWY_NAMESPACE;

/// A reference in two vector registers, loaded as it is stored: a load across two stores waits for
/// both.
struct StoredReference {
    using D = hn::FixedTag<float, 4>;
    using V = hn::Vec<D>;
    V first, second;

    explicit StoredReference(const BuildReference& r)
        : first(hn::LoadU(D(), data(r))), second(hn::LoadU(D(), data(r) + 4)) {}
    void store(BuildReference& r) const {
        float* const to = const_cast<float*>(data(r));
        hn::StoreU(first, D(), to);
        hn::StoreU(second, D(), to + 4);
    }
    V upper() const { return hn::CombineShiftRightBytes<12>(D(), second, first); }

  private:
    static const float* data(const BuildReference& r) { return r.bounds.lower.data(); }
};

/// A box in two vector registers, for builders: they are compiled once, for the baseline. The
/// fourth lanes mean nothing.
struct Box4 {
    using D = hwy::HWY_NAMESPACE::FixedTag<float, 4>;
    using V = hwy::HWY_NAMESPACE::Vec<D>;
    V lower = hwy::HWY_NAMESPACE::Set(D(), std::numeric_limits<float>::infinity());
    V upper = hwy::HWY_NAMESPACE::Set(D(), -std::numeric_limits<float>::infinity());

    Box4() = default;
    Box4(V l, V u) : lower(l), upper(u) {}
    explicit Box4(const BuildReference& r) : Box4(StoredReference(r)) {}
    explicit Box4(const Bounds3& b)
        : lower(hwy::HWY_NAMESPACE::LoadU(D(), b.lower.data())),
          upper(hwy::HWY_NAMESPACE::ShiftRightLanes<1>(
              D(), hwy::HWY_NAMESPACE::LoadU(D(), b.lower.data() + 2))) {}
    explicit Box4(const StoredReference& r) : lower(r.first), upper(r.upper()) {}

    void extend(const Box4& b) {
        lower = hwy::HWY_NAMESPACE::Min(lower, b.lower);
        upper = hwy::HWY_NAMESPACE::Max(upper, b.upper);
    }
    void extend_point(V p) {
        lower = hwy::HWY_NAMESPACE::Min(lower, p);
        upper = hwy::HWY_NAMESPACE::Max(upper, p);
    }
    /// Not empty on any of the three axes.
    bool valid() const {
        namespace hn = hwy::HWY_NAMESPACE;
        uint8_t bits[8];
        hn::StoreMaskBits(D(), hn::Le(lower, upper), bits);
        return (bits[0] & 7) == 7;
    }
    V centroid2() const { return hwy::HWY_NAMESPACE::Add(lower, upper); }
    V extent() const { return hwy::HWY_NAMESPACE::Sub(upper, lower); }
    Bounds3 bounds() const {
        alignas(16) float l[4], u[4];
        hwy::HWY_NAMESPACE::Store(lower, D(), l);
        hwy::HWY_NAMESPACE::Store(upper, D(), u);
        return {{l[0], l[1], l[2]}, {u[0], u[1], u[2]}};
    }
    /// In double, so that no size overflows; an empty box must not be asked.
    double half_area() const {
        namespace hn = hwy::HWY_NAMESPACE;
        alignas(16) float l[4], u[4];
        hn::Store(lower, D(), l);
        hn::Store(upper, D(), u);
        const double x = double(u[0]) - double(l[0]), y = double(u[1]) - double(l[1]),
                     z = double(u[2]) - double(l[2]);
        return x * y + y * z + z * x;
    }
};

}  // namespace crofton
