#pragma once

#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// Of each node, whether it is in one place only, and so is its mesh if it has one: one path leads
/// to it, and no other node that is reached has the mesh.
std::vector<bool> standing_nodes(const Scene& scene);

/// How much larger boxes of a mesh's triangles are in the world than in the mesh's own space, by
/// the areas of some of them; infinite for a mesh that is not all triangles.
///
/// A turned wall has a thick box. It is 1 under maps that keep the axes.
double area_ratio(const Scene& scene, uint32_t mesh, const Transform& world_from_object);

}  // namespace crofton
