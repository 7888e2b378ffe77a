#pragma once

#include <cstdint>
#include <string>

#include "framework/primitive.h"

namespace crofton {

struct ExportOptions {
    /// Deepest level of each structure to draw; its root is level 0.
    int depth = 1 << 30;
    bool empty_cells = false;  ///< leaves and cells that hold nothing, too
};

/// What an export drew.
struct ExportCount {
    uint64_t structures = 0;  ///< distinct ones
    uint64_t placements = 0;
    uint64_t boxes = 0;  ///< in distinct structures
};

/// Writes the boxes of `root` and of all structures nested in it as wireframes (binary glTF): a
/// mesh for each distinct structure, a node for each placement of it, a colour for each level.
/// @throws InputError  the file cannot be written, or there would be more than 2^22 boxes or 2^20
///                     placements
ExportCount export_boxes(const Primitive& root, const std::string& path,
                         const ExportOptions& options);

}  // namespace crofton
