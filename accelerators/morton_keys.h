#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>

#include "framework/aligned.h"
#include "framework/bounds.h"

namespace crofton {

/// Things in the order of the Morton codes of their boxes' centres, those of one code by index: see
/// morton.h for how they are made. 63 bits for both: as many for the index as it needs, the others
/// for the code.
class MortonKeys {
  public:
    /// Of those that exist.
    size_t size() const { return size_; }
    /// Of all boxes.
    const Bounds3& bounds() const { return bounds_; }
    uint32_t index(size_t i) const { return uint32_t(keys_[i] & index_mask_); }
    /// Code and index: different for any two.
    uint64_t key(size_t i) const { return keys_[i]; }
    uint64_t code(size_t i) const { return keys_[i] >> index_bits_; }
    /// Of two keys or more, the first whose highest bit that differs among [begin, end) is 1.
    size_t split(size_t begin, size_t end) const {
        const uint64_t bit = std::bit_floor(key(begin) ^ key(end - 1));
        return size_t(std::partition_point(keys_.data() + begin, keys_.data() + end,
                                           [bit](uint64_t key) { return (key & bit) == 0; }) -
                      keys_.data());
    }

  private:
    friend class MortonSorter;
    explicit MortonKeys(size_t n) : keys_(n) {
        index_bits_ = n > 1 ? int(std::bit_width(n - 1)) : 1;
        index_mask_ = (uint64_t{1} << index_bits_) - 1;
        axis_bits_ = std::min(21, (63 - index_bits_) / 3);
    }

    RawAlignedVector<uint64_t> keys_;
    size_t size_ = 0;
    Bounds3 bounds_;
    int index_bits_, axis_bits_;
    uint64_t index_mask_;
};

}  // namespace crofton
