#pragma once

#include "framework/ray_query.h"

namespace crofton {
class PolygonSet;
class QuadricSet;
}  // namespace crofton

/// The oracle's filter and exact stage as leaf tests: what Mode::exact and Mode::double_precision
/// do with the shapes that a traversal visits. Compiled once, for the baseline.
namespace crofton::exact {

/// Mode::exact: NearestHit::test_triangle of the query's.
/// @return  whether an `any` query is answered
bool test_triangle(Query kind, const Vec3f (&v)[3], const IdTable& ids, uint32_t shape,
                   RayQuery& query);

/// t of a triangle that refine_triangle accepted: at most 1 ulp from the exact one, in the query's
/// units, if the ray truly hits it. Otherwise the t given.
/// @param v  world-space corners
float refined_t(const float (&v)[3][3], const RayQuery& query, float t);

/// @name Leaf tests of the modes `double` and `exact`
/// @return  whether an `any` query is answered
/// @{
bool test_shapes(Query kind, const QuadricSet& set, const uint32_t* references, uint32_t count,
                 const LocalRay& ray, RayQuery& query);
bool test_shapes(Query kind, const PolygonSet& set, const uint32_t* references, uint32_t count,
                 const LocalRay& ray, RayQuery& query);
/// @}

}  // namespace crofton::exact
