#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "framework/bounds.h"
#include "framework/ray.h"

namespace crofton {

/// Finds an order for rays in which neighbours go through the same parts of a structure, so that
/// these are still in the cache (after Boulos et al. 2008, "Adaptive ray packet reordering"; Costa,
/// Pereira, Jorge 2015, "Accelerating occlusion rendering on a GPU via ray classification"). Keeps
/// its memory from one batch to the next.
class RayOrder {
  public:
    static constexpr size_t least_batch = 4096;      ///< fewer are not worth it
    static constexpr size_t most_batch = 1u << 17u;  ///< more would push each other out

    /// Bytes from which on it pays: beside a miss of the second cache that the third one serves,
    /// sorting costs as much as it saves.
    static constexpr uint64_t large_structure = uint64_t{16} << 20u;

    /// Whether most rays follow one that starts elsewhere: judged by a sample of neighbours.
    /// @param box  of what is traced; finite, not empty
    static bool are_scattered(std::span<const Ray> rays, const Bounds3& box);

    /// Sorts by where a ray enters the box, then by its direction. O(N).
    /// @param rays  at most most_batch
    /// @return a permutation of their indices, valid until the next call
    std::span<const uint32_t> sort(std::span<const Ray> rays, const Bounds3& box);

  private:
    struct Item {
        uint32_t key, ray;
    };
    std::vector<Item> items_, other_;
    std::vector<uint32_t> order_;
};

}  // namespace crofton
