#pragma once

#include <array>
#include <string>
#include <vector>

#include "experiments/random.h"
#include "framework/bounds.h"
#include "framework/exact.h"
#include "scenegraph/scene.h"

namespace crofton {

/// What recipes aim at: finite corners in world space, as placed and rounded.
struct AimPoints {
    std::vector<Vec3f> corners;
    std::vector<std::array<uint32_t, 3>> triangles;  ///< or any three points of a shape
    Bounds3 bounds;                                  ///< of the corners; never empty
    bool closed = false;        ///< every triangle's edges are shared, and there are only triangles
    std::vector<Vec3f> inside;  ///< points surely inside a closed surface

    /// @param limit  most triangles to keep, spread evenly
    AimPoints(const Scene& scene, size_t limit = 200000);
    /// Finds `inside` points of a closed scene.
    void find_inside(const exact::Oracle& oracle, Pcg32& rng);
};

/// A ray, and what must be true of it apart from the oracle's word.
struct AimedRay {
    Ray ray;
    bool must_hit = false;  ///< from inside a closed surface: a miss is a leak
};

/// One way to make hard rays.
struct Recipe {
    std::string name;
    std::string why;
    AimedRay (*make)(const AimPoints& aim, const exact::Oracle& oracle, Pcg32& rng);
};

const std::vector<Recipe>& recipes();

}  // namespace crofton
