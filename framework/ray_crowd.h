#pragma once

#include <cstdint>

#include "framework/ray_query.h"

namespace crofton {

/// Rays that go each its own way, but are traced a step each in turn: while one waits for memory,
/// or for what its comparisons say, others go on.
struct RayCrowd {
    static constexpr uint32_t most = 64;

    const LocalRay* local[most];
    RayQuery* query[most];
    uint32_t size = 0;
    uint64_t found = 0;  ///< bits of rays whose `any` query is answered: they are occluded
    /// Of the object that they are in, inside others. Where it is `deepest`, rays go on alone, so
    /// that objects may nest deeper than stacks have room for crowds.
    uint32_t depth = 0;
    static constexpr uint32_t deepest = 4;

    void add(const LocalRay& ray, RayQuery& ray_query) {
        local[size] = &ray;
        query[size++] = &ray_query;
    }
};

}  // namespace crofton
