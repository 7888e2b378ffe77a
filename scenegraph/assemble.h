#pragma once

#include <memory>
#include <string>
#include <vector>

#include "framework/primitive.h"
#include "framework/registry.h"
#include "scenegraph/scene.h"

namespace crofton {

/// An accelerator as a config names it.
struct AcceleratorChoice {
    std::string label;  ///< the name in the config, e.g. "fine"
    std::string type;   ///< registry name
    ParameterValues parameters;
    /// What objects inside get unless a rule says otherwise; none: the plan's default.
    std::shared_ptr<const AcceleratorChoice> inside;
};

/// Which accelerator every part of a scene gets.
struct AssemblyPlan {
    std::shared_ptr<const AcceleratorChoice> top;      ///< over the objects of the whole scene
    std::shared_ptr<const AcceleratorChoice> objects;  ///< default of every mesh
    /// Bake transforms into the vertices and put all triangles in one set under `top` (quadrics and
    /// polygons likewise where no transform stands in the way; else they stay objects under it).
    bool flatten = false;
    /// Objects whose boxes overlap others are opened into parts, until the structures over objects
    /// hold this many times as many entries; at most 1: none. See open_overlapping.
    double opening = 0;
    /// A mesh of triangles that stands in one place gets its structure there, and rays need not be
    /// moved to enter it; unless its boxes would be much larger there than in its own space. false:
    /// every object is in its own space, as an instance.
    bool bake = true;
    /// A node matched by name, by path from a root ("Engine/Block/Piston"), or by glob over the
    /// path
    /// (`*`, `?`, `**` across levels). On a node with a mesh: the mesh's accelerator. On a node
    /// with children: a structure of its own over its subtree. The first match in the list wins.
    struct Rule {
        std::string match;
        std::shared_ptr<const AcceleratorChoice> accelerator;
        std::string place;  ///< "file:line:column" for messages
    };
    std::vector<Rule> rules;
};

/// An assembled scene. `root` is never null; an empty scene is a structure without objects.
struct Assembly {
    std::shared_ptr<const Primitive> root;
    double build_s = 0;               ///< wall seconds for all structures, sets included
    uint64_t triangles = 0;           ///< in distinct sets
    uint64_t instances = 0;           ///< mesh instances placed
    uint64_t inactive_instances = 0;  ///< left out: their transform cannot be inverted
    uint64_t inactive_shapes = 0;     ///< left out: NaN or infinite
    uint64_t opened = 0;              ///< objects that were opened
    uint64_t parts = 0;               ///< that stand for them
    std::vector<std::string> warnings;
    /// What each node got, for `crofton inspect`: path, accelerator label, type, shapes, bytes.
    struct Entry {
        std::string path;
        std::string label, type;
        uint64_t shapes = 0;
        uint64_t bytes = 0;
        uint32_t placements = 1;
    };
    std::vector<Entry> entries;
};

/// Builds children first; a mesh that several nodes share with the same choice is built once.
/// Ids: `instance` = index in mesh_instances(scene), `geometry` = index in scene.geometries,
/// `primitive` = index in that geometry's shapes.
/// @throws InputError  unknown accelerator or parameter; a rule that matches no node, with the
///                     nearest valid name
Assembly assemble(const Scene& scene, const AssemblyPlan& plan);

/// Whether a node with this name and path is matched: see AssemblyPlan::Rule.
bool matches(const std::string& pattern, const std::string& name, const std::string& path);

}  // namespace crofton
