#pragma once

#include <cstdint>
#include <limits>

#include "framework/vec.h"

namespace crofton {

/// A ray o + t·d for t in the closed interval [t_min, t_max]. World units; the direction needs no
/// particular length, and t counts in units of it. A ray with a NaN, an infinite origin or
/// direction, a direction whose largest component is below 2^-126 (zero, for one) or at least
/// 2^127, or t_min > t_max is a defined miss. The layout is that of a ray file: eight little-endian
/// float32.
struct Ray {
    Vec3f origin = Vec3f::Zero();
    float t_min = 0.0f;
    Vec3f direction = Vec3f(0, 0, 1);
    float t_max = std::numeric_limits<float>::infinity();
};
static_assert(sizeof(Ray) == 32);

inline constexpr uint32_t no_id = 0xffffffffu;

/// The closest hit. On a miss every id is `no_id`, t is +inf and u = v = 0.
///
/// `u`, `v` are the barycentric weights of a triangle's second and third vertex; other shapes
/// say in their set what they put there. `primitive` counts within the geometry as in its file,
/// `geometry` within the scene, `instance` is the placement of an object in the scene.
/// The layout is that of a hit file: six 4-byte fields.
struct Hit {
    float t = std::numeric_limits<float>::infinity();
    float u = 0.0f;
    float v = 0.0f;
    uint32_t primitive = no_id;
    uint32_t geometry = no_id;
    uint32_t instance = no_id;

    bool is_hit() const { return primitive != no_id; }
    bool operator==(const Hit&) const = default;
};
static_assert(sizeof(Hit) == 24);

/// Order of ids that breaks ties between hits at the same t.
inline bool id_less(const Hit& a, const Hit& b) {
    if (a.instance != b.instance) return a.instance < b.instance;
    if (a.geometry != b.geometry) return a.geometry < b.geometry;
    return a.primitive < b.primitive;
}

}  // namespace crofton
