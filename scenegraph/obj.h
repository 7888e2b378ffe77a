#pragma once

#include <string>

#include "scenegraph/scene.h"

namespace crofton {

/// Loads a Wavefront OBJ file (Wavefront Technologies, "Advanced Visualizer", appendix B1).
/// Reads v and f: positions with any extra numbers ignored, faces of any size with absolute or
/// negative indices, triangulated. One object per distinct name of o and g lines that has faces;
/// a file with vertices and no faces gives Points. Materials, lines, curves are ignored.
/// Reads the file once; memory is proportional to its size.
/// @throws InputError  "path:line: what" on malformed numbers or indices, or if there is nothing
///                     in it
Scene load_obj(const std::string& path);

}  // namespace crofton
