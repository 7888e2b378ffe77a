#pragma once

#include <string>

#include "scenegraph/scene.h"

namespace crofton {

/// Loads a Stanford PLY file (Greg Turk, "The PLY Polygon File Format", 1994): ascii, binary
/// little-endian or big-endian, with any further elements and properties, which are skipped.
/// Faces (vertex_indices or vertex_index) are triangulated, tristrips unrolled; a file without
/// either gives Points. Declared counts are checked against the size of the file before any
/// memory is taken.
/// @throws InputError  "path:line: what" in the header or an ascii body, "path: what" else
Scene load_ply(const std::string& path);

}  // namespace crofton
