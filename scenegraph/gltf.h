#pragma once

#include <string>

#include "scenegraph/scene.h"

namespace crofton {

/// Loads the default scene of a glTF 2.0 file, text or binary (told by its first bytes).
///
/// Every triangle mode, 8-, 16- and 32-bit indices or none, interleaved and sparse accessors,
/// accessors without data (zeros), KHR_mesh_quantization, EXT_mesh_gpu_instancing, perspective
/// cameras (world space) and base colours are read; points and lines give meshes without geometry;
/// skins, morph targets, animations, images and all other attributes are ignored. Draco and meshopt
/// compression are not supported. Positions stay in the units of the file (metres, by the format).
///
/// Buffers are looked for in the folder of the file and below it only. Memory is in proportion to
/// the size of the file and its buffers; no declared count is believed before it is checked.
/// Complexity: linear in the size of the file and of the geometry it makes.
/// @throws InputError  one line, "path: place: what", where place is like meshes/3/primitives/0
/// Source: Khronos Group, glTF 2.0 Specification (2021). Departs from it: an index equal to the
///         primitive-restart value is a plain index if it is in range; a non-unit rotation is used
///         as it stands; a node may have several parents.
Scene load_gltf(const std::string& path);

}  // namespace crofton
