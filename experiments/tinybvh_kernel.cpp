#include "experiments/tinybvh_kernel.h"

#ifdef CROFTON_TINYBVH
#include <algorithm>
#include <vector>

#define TINYBVH_IMPLEMENTATION
#include <tiny_bvh.h>

namespace crofton {

struct TinyBvh::Data {
    tinybvh::BVH8_CPU bvh;
};

TinyBvh::TinyBvh(const float* vertices, size_t vertex_count, const uint32_t* triangles,
                 uint32_t triangle_count, bool high)
    : data_(std::make_unique<Data>()) {
    // Its vertices have four components.
    std::vector<tinybvh::bvhvec4> points(vertex_count);
    for (size_t i = 0; i < vertex_count; ++i)
        points[i] = {vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2], 0};
    const tinybvh::bvhvec4slice slice(points.data(), uint32_t(vertex_count),
                                      sizeof(tinybvh::bvhvec4));
    if (high)
        data_->bvh.BuildHQ(slice, triangles, triangle_count);
    else
        data_->bvh.Build(slice, triangles, triangle_count);
}

TinyBvh::~TinyBvh() = default;

/// Its own constructor would scale the direction to a length of one.
static tinybvh::Ray ray_of(const TinyBvh::Ray& ray) {
    tinybvh::Ray r;
    r.O = {ray.origin[0], ray.origin[1], ray.origin[2]};
    r.D = {ray.direction[0], ray.direction[1], ray.direction[2]};
    r.rD = tinybvh::tinybvh_rcp(r.D);
    r.hit.t = std::min(ray.t, BVH_FAR);
    return r;
}

TinyBvh::Hit TinyBvh::intersect(const Ray& ray) const {
    tinybvh::Ray r = ray_of(ray);
    data_->bvh.Intersect(r);
    return {r.hit.t, r.hit.u, r.hit.v, r.hit.prim};
}

bool TinyBvh::occluded(const Ray& ray) const { return data_->bvh.IsOccluded(ray_of(ray)); }

uint64_t TinyBvh::bytes() const { return uint64_t(data_->bvh.usedBlocks) * 64; }

}  // namespace crofton
#endif
