#pragma once

#include <optional>
#include <string>

#include "scenegraph/assemble.h"
#include "scenegraph/scene.h"

namespace crofton {

struct InspectOptions {
    bool json = false;
    bool all = false;  ///< every line of the tree, however many
};

/// What a scene holds: counts, bounds, memory, the tree of nodes; with an assembly also what every
/// node got. Time and memory are linear in the scene's nodes and shapes, however often nodes are
/// shared.
std::string inspect_text(const Scene& scene, const Assembly* assembly,
                         const InspectOptions& options);

/// Bytes of the shapes as the scene holds them.
uint64_t shape_bytes(const Scene& scene);

}  // namespace crofton
