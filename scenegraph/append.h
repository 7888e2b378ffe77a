#pragma once

#include <string>

#include "scenegraph/scene.h"

namespace crofton {

/// Adds all of `other` to `scene`: its roots become children of one new root node, its cameras and
/// lights move with it, and every index is shifted. Geometries without a material stay so.
/// @param world_from_other  placed before the new node's children
/// @param node_name         of the new root
/// @return                  index of the new root node
uint32_t append(Scene& scene, Scene other, const Transform& world_from_other,
                const std::string& node_name);

}  // namespace crofton
