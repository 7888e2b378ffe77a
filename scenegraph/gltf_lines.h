#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "framework/transform.h"

namespace crofton {

/// Line segments for a viewer, in runs of one colour.
struct LineMesh {
    struct Run {
        std::array<float, 3> color;  ///< linear RGB, 0 … 1
        std::vector<Vec3f> positions;
        std::vector<uint32_t> lines;  ///< two indices into positions a segment
    };
    std::string name;
    std::vector<Run> runs;  ///< those without positions are left out
};

struct LinePlacement {
    uint32_t mesh;
    Transform world_from_mesh;
};

/// Writes binary glTF 2.0: a mesh of lines for each that holds any, a node for each placement,
/// unlit colours.
/// @throws InputError  the file cannot be written
void write_lines_glb(const std::string& path, const std::vector<LineMesh>& meshes,
                     const std::vector<LinePlacement>& placements);

}  // namespace crofton
