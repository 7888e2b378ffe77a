#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace crofton {

/// BVH8_CPU of tinybvh, compiled by itself: it chooses its instructions when it is compiled, and
/// what our own headers define must not be compiled for them.
class TinyBvh {
  public:
    struct Ray {
        float origin[3], direction[3], t;
    };
    struct Hit {
        float t, u, v;
        uint32_t triangle;
    };
    /// @param vertices   three floats each; read while it is built
    /// @param triangles  three indices each; likewise
    /// @param high       by BuildHQ (spatial splits), not Build (binned)
    TinyBvh(const float* vertices, size_t vertex_count, const uint32_t* triangles,
            uint32_t triangle_count, bool high);
    ~TinyBvh();
    /// The nearest hit in front of the ray's t; there, if there is none.
    Hit intersect(const Ray& ray) const;
    bool occluded(const Ray& ray) const;
    /// What rays read; the trees that it was made from stay for its Refit, which nothing calls.
    uint64_t bytes() const;

  private:
    struct Data;
    std::unique_ptr<Data> data_;
};

}  // namespace crofton
