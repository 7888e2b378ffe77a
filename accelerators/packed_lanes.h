// Some lanes of a vector moved to its front; included once per target.
#if defined(CROFTON_ACCELERATORS_PACKED_LANES_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_ACCELERATORS_PACKED_LANES_H_
#undef CROFTON_ACCELERATORS_PACKED_LANES_H_
#else
#define CROFTON_ACCELERATORS_PACKED_LANES_H_
#endif

#include <array>
#include <cstdint>

#include "framework/simd.h"

#ifndef CROFTON_ACCELERATORS_SET_BITS_TABLE
#define CROFTON_ACCELERATORS_SET_BITS_TABLE
namespace crofton {
/// By eight bits, which of them are set.
inline constexpr auto set_bits_table = [] {
    std::array<std::array<uint8_t, 8>, 256> table{};
    for (size_t bits = 0; bits < 256; ++bits)
        for (size_t i = 0, n = 0; i < 8; ++i)
            if (bits >> i & 1) table[bits][n++] = uint8_t(i);
    return table;
}();
}  // namespace crofton
#endif

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// Moves the lanes of vectors of 32 bits that are named by bits to the front; what follows them
/// means nothing. There is an instruction for it in AVX-512. (For the others Highway's Compress
/// reads a table that GCC copies onto the stack with every call.)
template <class D>
class PackedLanes {
  public:
    explicit HWY_INLINE PackedLanes(uint32_t bits)
#if HWY_TARGET <= HWY_AVX3
        : mask_(bits_mask(D(), bits)) {
    }
    template <class V>
    HWY_INLINE V operator()(V v) const {
        return hn::Compress(v, hn::RebindMask(hn::DFromV<V>(), mask_));
    }

  private:
    hn::Mask<D> mask_;
#else
        : index_(hn::IndicesFromVec(
              D(), hn::PromoteTo(
                       hn::RebindToSigned<D>(),
                       hn::LoadU(hn::Rebind<uint8_t, D>(), set_bits_table.data()[bits].data())))) {
        static_assert(hn::MaxLanes(D()) <= 8);
    }
    template <class V>
    HWY_INLINE V operator()(V v) const {
        return hn::BitCast(hn::DFromV<V>(), hn::TableLookupLanes(hn::BitCast(D(), v), index_));
    }

  private:
    decltype(hn::IndicesFromVec(D(), hn::Zero(hn::RebindToSigned<D>()))) index_;
#endif
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
