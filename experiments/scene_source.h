#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "framework/config.h"
#include "scenegraph/scene.h"

namespace crofton {

/// Where geometry comes from: a file, or else a procedural generator.
struct SceneSource {
    std::string file;  ///< exists; empty if procedural
    std::string procedural;
    std::map<std::string, double> parameters;
};

/// A scene put into another: rotated, scaled, moved.
struct ScenePlacement {
    std::string name;
    SceneSource source;
    Vec3d position = Vec3d::Zero();
    Vec3d scale = Vec3d::Ones();
    Vec3d rotate_deg = Vec3d::Zero();  ///< about x, then y, then z
    std::optional<double>
        fit_height;  ///< scales to this height (y), the middle of the base at `position`
};

/// What [camera] gives; without an eye the scene's own or a fitted camera serves.
struct CameraSpec {
    std::optional<Vec3d> eye, at;
    Vec3d up = Vec3d(0, 1, 0);
    std::optional<double> fov_deg;  ///< vertical, full angle; none: the scene's, or 45
};

struct SceneSpec {
    std::optional<SceneSource> base;
    std::vector<ScenePlacement> places;
    CameraSpec camera;
};

/// Reads [scene] and [camera] of the config's root.
/// @throws InputError  as the getters of ConfigTable, and for files that do not exist
SceneSpec parse_scene(ConfigTable& root, const std::string& folder);

/// What a command line calls a scene: a path, or "procedural:NAME".
/// @throws InputError  unknown generator, with the nearest valid name
SceneSource scene_source(const std::string& name);

/// Loads or generates everything and puts it together.
/// @throws InputError  a file that cannot be used, a parameter out of range
Scene make_scene(const SceneSpec& spec);

/// FNV-1a of all that a structure can depend on: shapes, meshes, nodes and their transforms.
std::string fingerprint(const Scene& scene);

/// FNV-1a of every file that the scene names, by path.
std::map<std::string, std::string> file_hashes(const SceneSpec& spec);

}  // namespace crofton
