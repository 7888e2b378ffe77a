#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "framework/bounds.h"
#include "framework/shape_groups.h"
#include "framework/transform.h"

namespace crofton {

/// Triangles that share vertices. Object units. Vertices may be NaN or infinite, as a file gave
/// them: such triangles count, and are never hit.
struct TriangleMesh {
    std::vector<Vec3f> positions;
    std::vector<std::array<uint32_t, 3>> triangles;  ///< indices into positions, all in range
};

struct Sphere {
    Vec3f center;
    float radius;  ///< >= 0
};
/// Frustum of a cone without caps; a cylinder if both radii are equal, a full cone if one is 0.
struct Cone {
    Vec3f base;
    float base_radius;  ///< >= 0
    Vec3f apex;
    float apex_radius;  ///< >= 0
};
/// Flat disc, or a ring if inner_radius > 0.
struct Disc {
    Vec3f center;
    float radius;  ///< >= 0
    Vec3f normal;  ///< any length but 0
    float inner_radius = 0.0f;
};
using Quadric = std::variant<Sphere, Cone, Disc>;
struct Quadrics {
    std::vector<Quadric> shapes;
};

/// Simple planar polygons, convex or not, of any number of corners >= 3.
struct Polygons {
    std::vector<Vec3f> positions;
    std::vector<uint32_t> first;  ///< first corner of each polygon, then positions.size()
    uint32_t size() const { return first.empty() ? 0 : uint32_t(first.size() - 1); }
};

/// A cloud of points, each traced as a splat: a sphere, or a disc where a normal is known. See
/// scenegraph/splats.h.
struct Points {
    std::vector<Vec3f> positions;
    std::vector<Vec3f> normals = {};  ///< of any length, 0 for none; one a point, or empty
    std::vector<float> radii = {};    ///< >= 0; one a point, or empty: from the points' spacing
};

/// A run of shapes of one kind with one material: what a Hit calls a geometry.
struct Geometry {
    std::string name;
    uint32_t material = 0;  ///< index into Scene::materials, or beyond it for none
    std::variant<TriangleMesh, Quadrics, Polygons, Points> shapes;
};

/// Geometries that are placed together: what a node refers to.
struct Mesh {
    std::string name;
    std::vector<uint32_t> geometries;  ///< indices into Scene::geometries
};

struct Node {
    std::string name;  ///< as in the file; may be empty or repeated
    Transform parent_from_node;
    std::vector<uint32_t> children;  ///< indices into Scene::nodes; a node may have several parents
    std::optional<uint32_t> mesh;    ///< index into Scene::meshes
    /// If not empty, the mesh is placed once per entry (EXT_mesh_gpu_instancing), each under this
    /// node's own transform; if empty, once.
    std::vector<Transform> node_from_instance;
};

/// A perspective camera. World space; up need not be perpendicular to the view.
struct Camera {
    Vec3d eye = Vec3d::Zero();
    Vec3d at = Vec3d(0, 0, -1);
    Vec3d up = Vec3d(0, 1, 0);
    double fov_y = 0.7853981633974483;  ///< radians, full angle
    double aspect = 1.0;                ///< width / height
};

struct Light {
    Vec3d position = Vec3d::Zero();
};

struct Material {
    std::string name;
    std::array<float, 3> color = {0.8f, 0.8f, 0.8f};
};

/// What a file or a generator gives: a directed acyclic graph of nodes over shared meshes.
/// Loaders guarantee that every index is in range and that there is no cycle; transforms may be
/// singular or not finite.
struct Scene {
    std::string name;    ///< short: the file's stem or the generator's name
    std::string source;  ///< path, or "procedural:NAME"
    std::vector<Geometry> geometries;
    std::vector<Mesh> meshes;
    std::vector<Node> nodes;
    std::vector<uint32_t> roots;
    std::vector<Camera> cameras;
    std::vector<Light> lights;
    std::vector<Material> materials;
    std::vector<std::string> warnings;  ///< what was ignored or repaired, one line each

    uint32_t add_geometry(Geometry g) {
        geometries.push_back(std::move(g));
        return uint32_t(geometries.size() - 1);
    }
    /// Adds a mesh of one new geometry and a node that places it, under `parent` or as a root.
    uint32_t add_object(const std::string& object_name, Geometry g,
                        const Transform& parent_from_node = {},
                        std::optional<uint32_t> parent = {});
    /// Adds a node that places an existing mesh (or nothing), under `parent` or as a root.
    uint32_t add_node(const std::string& node_name, std::optional<uint32_t> mesh,
                      const Transform& parent_from_node = {}, std::optional<uint32_t> parent = {});
};

/// The name that a node is matched and shown by: its own, or else that of its mesh; may be empty.
inline const std::string& node_name(const Scene& scene, const Node& node) {
    return node.name.empty() && node.mesh ? scene.meshes[*node.mesh].name : node.name;
}

/// Loads a scene by the file's ending: .gltf .glb .obj .ply .nff. Reads geometry, hierarchy,
/// camera, lights and base colours; images and unused attributes are not opened.
/// @throws InputError  one line that names the file and what cannot be used
Scene load_scene(const std::string& path);

/// Endings that load_scene knows, without the dot.
const std::vector<std::string>& scene_endings();

/// Shared nodes can multiply the placements of a small file beyond any memory.
inline constexpr size_t max_placements = size_t{1} << 24;

/// One placement of a mesh: a path from a root to a node, and for EXT_mesh_gpu_instancing the
/// entry. `instance` ids of hits are indices of this list, which is in depth-first order.
struct MeshInstance {
    uint32_t node;
    uint32_t mesh;
    Transform world_from_object;
};
/// All placements, depth first. Does not recurse: chains of any depth are fine.
/// @throws InputError  if there are more than `limit` placements (shared nodes can multiply them)
std::vector<MeshInstance> mesh_instances(const Scene& scene, size_t limit = max_placements);

/// The groups that the graph makes of these placements: for each node, on each path to it, those
/// below it, itself included; left out where that is one or none.
ShapeGroups placement_groups(const Scene& scene);

/// The counts and bounds that `crofton inspect --json` prints; keys as there.
struct SceneStatistics {
    uint64_t triangles_unique = 0;     ///< of every mesh that an instance uses or not
    uint64_t triangles_instanced = 0;  ///< summed over mesh instances
    uint64_t shapes_unique = 0;        ///< triangles, quadrics, polygons and points
    uint64_t shapes_instanced = 0;
    uint64_t mesh_instances = 0;
    uint64_t depth = 0;  ///< nodes on the longest path from a root; 1 = roots only
    /// World bounds, in double, of the finite vertices that shapes use; lower > upper if none.
    Vec3d bounds_min, bounds_max;
    uint64_t zero_area_triangles_object_space = 0;
    uint64_t mirrored_instances = 0;  ///< with a negative determinant
};
SceneStatistics statistics(const Scene& scene);

}  // namespace crofton
