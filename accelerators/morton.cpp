#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/morton.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <cstddef>
#include <cstdint>

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Makes keys of three coordinates of 21 bits side by side; those with the highest bit stay. Below
/// a key's code is its index, which counts from `first` on.
void interleave(uint64_t* keys, size_t n, uint64_t first, int index_bits) {
    const hn::ScalableTag<uint64_t> d;
    const auto spread = [d](auto x) HWY_ATTR {
        const auto step = [d](auto v, auto shifted, uint64_t bits)
                              HWY_ATTR { return hn::And(hn::Or(v, shifted), hn::Set(d, bits)); };
        x = hn::And(x, hn::Set(d, 0x1fffff));
        x = step(x, hn::ShiftLeft<32>(x), 0x1f00000000ffffull);
        x = step(x, hn::ShiftLeft<16>(x), 0x1f0000ff0000ffull);
        x = step(x, hn::ShiftLeft<8>(x), 0x100f00f00f00f00full);
        x = step(x, hn::ShiftLeft<4>(x), 0x10c30c30c30c30c3ull);
        return step(x, hn::ShiftLeft<2>(x), 0x1249249249249249ull);
    };
    const auto none = hn::Set(d, uint64_t{1} << 63);
    const auto put = [&](auto packed, size_t i) HWY_ATTR {
        const auto x = spread(packed), y = spread(hn::ShiftRight<21>(packed)),
                   z = spread(hn::ShiftRight<42>(packed));
        const auto code = hn::Or(x, hn::Or(hn::ShiftLeft<1>(y), hn::ShiftLeft<2>(z)));
        const auto index = hn::Iota(d, first + i);
        const auto key = hn::ShiftLeftSame(code, index_bits);
        return hn::Or(index, hn::IfThenElse(hn::Eq(hn::And(packed, none), none), none, key));
    };
    const size_t N = hn::Lanes(d);
    size_t i = 0;
    for (; i + N <= n; i += N) hn::StoreU(put(hn::LoadU(d, keys + i), i), d, keys + i);
    alignas(64) uint64_t last[8] = {};
    for (size_t k = i; k < n; ++k) last[k - i] = keys[k];
    hn::Store(put(hn::Load(d, last), i), d, last);
    for (size_t k = i; k < n; ++k) keys[k] = last[k - i];
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <array>
#include <vector>

#include "accelerators/morton.h"

namespace crofton {
namespace {
HWY_EXPORT(interleave);

/// Sorts each run of keys that are equal from `bit` on.
void sort_runs(RawAlignedVector<uint64_t>& keys, int bit) {
    const size_t n = keys.size();
    const auto run = [&](size_t i) { return keys[i] >> bit; };
    const size_t size = chunk_size(n), chunks = (n + size - 1) / size;
    std::vector<size_t> begins(chunks + 1, n);
    for (size_t c = 0; c < chunks; ++c) {
        size_t& begin = begins[c] = std::min(n, c * size);
        while (begin > 0 && begin < n && run(begin) == run(begin - 1)) ++begin;
    }
    parallel_for(chunks, 1, [&](size_t from, size_t to) {
        for (size_t begin = begins[from]; begin < begins[to];) {
            size_t end = begin + 1;
            while (end < begins[to] && run(end) == run(begin)) ++end;
            if (end - begin > 1)
                std::sort(keys.begin() + ptrdiff_t(begin), keys.begin() + ptrdiff_t(end));
            begin = end;
        }
    });
}

}  // namespace

void MortonSorter::interleave(size_t first, std::span<uint64_t> keys) const {
    HWY_DYNAMIC_DISPATCH(interleave)(keys.data(), keys.size(), first, keys_.index_bits_);
}

/// The highest 33 bits by 11 at a time, in parallel by chunks that do not depend on the threads;
/// they leave short runs, or long ones of equal codes.
void MortonSorter::sort() {
    constexpr size_t digits = 2048, least = 8192, most_chunks = 16;
    constexpr int digit_bits = 11;
    RawAlignedVector<uint64_t>& keys = keys_.keys_;
    const size_t n = keys.size();
    const size_t chunks = std::clamp<size_t>(n / least, 1, most_chunks);
    const auto chunk_begin = [&](size_t c) { return n * c / chunks; };
    const int top = keys_.size() < n ? 64 : keys_.index_bits_ + 3 * keys_.axis_bits_;
    const int bottom = std::max(0, top - 3 * digit_bits);
    RawAlignedVector<uint64_t> other(n);
    std::vector<std::array<uint32_t, digits>> count(chunks);
    for (int shift = bottom; shift < top; shift += digit_bits) {
        const auto digit = [&](uint64_t k) { return size_t(k >> shift & (digits - 1)); };
        parallel_for(chunks, 1, [&](size_t from, size_t to) {
            for (size_t c = from; c < to; ++c) {
                count[c].fill(0);
                for (size_t i = chunk_begin(c); i < chunk_begin(c + 1); ++i)
                    ++count[c][digit(keys[i])];
            }
        });
        uint32_t sum = 0;
        for (size_t d = 0; d < digits; ++d)
            for (auto& c : count) {
                const uint32_t here = c[d];
                c[d] = sum;
                sum += here;
            }
        parallel_for(chunks, 1, [&](size_t from, size_t to) {
            for (size_t c = from; c < to; ++c)
                for (size_t i = chunk_begin(c); i < chunk_begin(c + 1); ++i)
                    other[count[c][digit(keys[i])]++] = keys[i];
        });
        keys.swap(other);
    }
    sort_runs(keys, bottom);
}

}  // namespace crofton
#endif
