#pragma once

#include <span>
#include <string>
#include <vector>

#include "framework/bounds.h"
#include "framework/primitive.h"
#include "framework/primitive_sets.h"
#include "framework/ray.h"

namespace crofton::test {

/// PCG32 (O'Neill 2014): the same numbers on every platform.
class Random {
  public:
    explicit Random(uint64_t seed) : state_(seed * 2 + 1) { next(); }
    uint32_t next();
    float uniform() { return float(next() >> 8) * 0x1p-24f; }  ///< [0, 1)
    float uniform(float a, float b) { return a + (b - a) * uniform(); }
    Vec3f point(float radius);  ///< in a cube
    Vec3f direction();          ///< unit, isotropic

  private:
    uint64_t state_;
};

/// A set of shapes with rays that are hard for it.
struct HardScene {
    std::string name;
    PrimitiveSet set;
    std::vector<Ray> rays;
    bool closed = false;  ///< a ray from `inside` always hits
    Vec3f inside = Vec3f::Zero();
    std::vector<Vec3f> vertices;
};

/// Triangles, quadrics, polygons, and objects (of triangles), each with hard rays; see the .cpp for
/// what makes each of them hard.
std::vector<HardScene> hard_scenes();

/// Rays for a scene with these bounds and vertices: random, axis-parallel (with both zeros), aimed
/// at vertices and edges, from vertices, nearly parallel to axes, far, short, long and invalid
/// ones.
std::vector<Ray> hard_rays(const Bounds3& bounds, const std::vector<Vec3f>& vertices,
                           uint64_t seed);

Bounds3 bounds_of(const PrimitiveSet& set);

/// Rays for which the two differ in any bit of the closest hit, or in whether anything is hit.
size_t different_hits(const Primitive& a, const Primitive& b, std::span<const Ray> rays);

/// A closed sphere of 20·4^level triangles.
void icosphere(int level, std::vector<Vec3f>& positions,
               std::vector<std::array<uint32_t, 3>>& triangles);

}  // namespace crofton::test
