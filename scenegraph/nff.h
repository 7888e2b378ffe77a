#pragma once

#include <string>

#include "scenegraph/scene.h"

namespace crofton {

/// Loads a Neutral File Format scene (Eric Haines, "NFF", version 3.9, 1996), as the Standard
/// Procedural Databases write: camera, lights, spheres, cones and cylinders (one Quadrics
/// geometry), polygons and patches without their normals (one Polygons geometry), each in the
/// order of the file. A negative radius, which asks for the inside only, is read as positive. A
/// geometry carries the material of its first shape.
/// @throws InputError  "path:line: what" on unknown entities, malformed or infinite numbers, or
///                     if there are no shapes
Scene load_nff(const std::string& path);

}  // namespace crofton
