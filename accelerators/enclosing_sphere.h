#pragma once

#include <span>
#include <vector>

#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"

namespace crofton {

/// Part of a shape as spheres see it: a shape lies in the convex hull of its balls.
struct Ball {
    Vec3f center;
    float radius;  ///< >= 0
};

/// @name Appends the balls of shape i, which is active
/// Corners of triangles, polygons and boxes; the sphere itself; both ends of a cone; a disc's hull.
/// @{
void add_balls(const TriangleSet& set, uint32_t i, std::vector<Ball>& balls);
void add_balls(const QuadricSet& set, uint32_t i, std::vector<Ball>& balls);
void add_balls(const PolygonSet& set, uint32_t i, std::vector<Ball>& balls);
void add_balls(const ObjectSet& set, uint32_t i, std::vector<Ball>& balls);
/// @}

struct EnclosingSphere {
    Vec3d center = Vec3d::Zero();
    double radius = 0;
};

/// A sphere that contains all balls (and so, being convex, all shapes), rounded outwards. O(N): the
/// better of two, about the middle of the box, and about a centre that moves ever less towards the
/// farthest of a sample (Bădoiu & Clarkson 2003: "Smaller core-sets for balls"), which comes within
/// a few percent of the smallest. Deterministic. Empty: a point.
EnclosingSphere enclosing_sphere(std::span<const Ball> balls);

}  // namespace crofton
