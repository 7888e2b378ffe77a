#include "framework/ray_order.h"

#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace crofton {
namespace {

constexpr int cell_bits = 5;       ///< of the box, per axis
constexpr int direction_bits = 3;  ///< per axis

// Keys are cheap beside a ray only if nothing branches: compiled once, for the baseline.
namespace hn = hwy::HWY_NAMESPACE;
constexpr hn::FixedTag<float, 4> f4;
constexpr hn::FixedTag<int32_t, 4> i4;
using Float4 = hn::Vec<decltype(f4)>;

/// x with two zeros between its bits.
constexpr std::array<uint16_t, 1 << cell_bits> make_spread() {
    std::array<uint16_t, 1 << cell_bits> table{};
    for (unsigned x = 0; x < table.size(); ++x)
        for (int b = 0; b < cell_bits; ++b) table[x] |= uint16_t((x >> b & 1) << (3 * b));
    return table;
}
constexpr auto spread = make_spread();

/// Morton code of lanes 0 to 2, each cut to [0, count - 1].
uint32_t morton(Float4 v, float count) {
    const auto index = hn::Min(hn::Max(v, hn::Zero(f4)), hn::Set(f4, count - 1));
    alignas(16) int32_t i[4];
    hn::Store(hn::ConvertTo(i4, index), i4, i);
    return uint32_t(spread[size_t(i[0])] | spread[size_t(i[1])] << 1 | spread[size_t(i[2])] << 2);
}

/// Where rays start: cells of a box, along a Morton curve; and directions likewise.
class RayKeys {
  public:
    explicit RayKeys(const Bounds3& box) {
        for (int a = 0; a < 3; ++a) {
            const float extent = box.upper[a] - box.lower[a];
            center_[a] = box.lower[a] + 0.5f * extent;
            half_[a] = 0.5f * extent;
            per_unit_[a] = extent > 0 ? float(1 << cell_bits) / extent : 0.0f;
        }
    }
    /// The cell in which the ray enters the box, 15 bits. Of a ray that misses it, any.
    uint32_t cell(const Ray& ray) const {
        const auto o = hn::LoadU(f4, ray.origin.data()), d = hn::LoadU(f4, ray.direction.data());
        const auto half = hn::Load(f4, half_);
        const auto plane = hn::Sub(hn::Load(f4, center_), hn::CopySign(half, d));
        alignas(16) float at[4];
        hn::Store(hn::Div(hn::Sub(plane, o), d), f4, at);
        const float t =
            std::max(std::max(at[0], at[1]), std::max(at[2], std::max(ray.t_min, 0.0f)));
        const auto p = hn::Add(hn::Sub(o, hn::Load(f4, center_)), hn::Mul(hn::Set(f4, t), d));
        return morton(hn::Mul(hn::Add(p, half), hn::Load(f4, per_unit_)), 1 << cell_bits);
    }
    /// 9 bits; a sign each first.
    static uint32_t direction(const Ray& ray) {
        constexpr float half = 1 << (direction_bits - 1);
        const float largest =
            std::max(std::max(std::abs(ray.direction[0]), std::abs(ray.direction[1])),
                     std::abs(ray.direction[2]));
        const auto d = hn::LoadU(f4, ray.direction.data());
        return morton(hn::Add(hn::Mul(d, hn::Set(f4, half / largest)), hn::Set(f4, half)),
                      2 * half);
    }

  private:
    alignas(16) float center_[4] = {}, half_[4] = {}, per_unit_[4] = {};
};

}  // namespace

bool RayOrder::are_scattered(std::span<const Ray> rays, const Bounds3& box) {
    constexpr size_t samples = 128;
    const RayKeys keys(box);
    const size_t step = std::max<size_t>(rays.size() / samples, 2);
    size_t pairs = 0, near = 0;
    for (size_t i = 1; i < rays.size(); i += step, ++pairs)
        near += keys.cell(rays[i]) == keys.cell(rays[i - 1]);
    return 2 * near < pairs;
}

std::span<const uint32_t> RayOrder::sort(std::span<const Ray> rays, const Bounds3& box) {
    constexpr int digit_bits = 12, digits = 1 << digit_bits;
    static_assert(3 * (cell_bits + direction_bits) == 2 * digit_bits, "two passes");
    const RayKeys keys(box);
    items_.resize(rays.size());
    other_.resize(rays.size());
    order_.resize(rays.size());
    std::array<uint32_t, digits> low{}, high{};
    for (size_t i = 0; i < rays.size(); ++i) {
        const uint32_t key =
            keys.cell(rays[i]) << (3 * direction_bits) | RayKeys::direction(rays[i]);
        items_[i] = {key, uint32_t(i)};
        ++low[key % digits];
        ++high[key / digits];
    }
    uint32_t before_low = 0, before_high = 0;
    for (int d = 0; d < digits; ++d) {
        before_low += std::exchange(low[size_t(d)], before_low);
        before_high += std::exchange(high[size_t(d)], before_high);
    }
    for (const Item& item : items_) other_[low[item.key % digits]++] = item;
    for (const Item& item : other_) order_[high[item.key / digits]++] = item.ray;
    return order_;
}

}  // namespace crofton
