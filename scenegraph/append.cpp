#include "scenegraph/append.h"

#include <iterator>
#include <utility>

namespace crofton {
namespace {

template <class T>
void move_all(std::vector<T>& from, std::vector<T>& to) {
    to.insert(to.end(), std::make_move_iterator(from.begin()), std::make_move_iterator(from.end()));
}

/// Shifts material indices, and makes those beyond the list stay beyond a longer one.
void shift_materials(std::vector<Geometry>& geometries, size_t count, size_t shift) {
    for (Geometry& g : geometries)
        g.material = g.material < count ? uint32_t(g.material + shift) : ~uint32_t{0};
}

void shift(std::vector<uint32_t>& indices, size_t by) {
    for (uint32_t& index : indices) index += uint32_t(by);
}

void place(Camera& camera, const Transform& t) {
    camera.eye = t.point(camera.eye);
    camera.at = t.point(camera.at);
    camera.up = t.vector(camera.up);
}

}  // namespace

uint32_t append(Scene& scene, Scene other, const Transform& world_from_other,
                const std::string& node_name) {
    shift_materials(scene.geometries, scene.materials.size(), 0);
    shift_materials(other.geometries, other.materials.size(), scene.materials.size());
    for (Mesh& mesh : other.meshes) shift(mesh.geometries, scene.geometries.size());
    for (Node& node : other.nodes)
        if (node.mesh) *node.mesh += uint32_t(scene.meshes.size());
    for (Camera& camera : other.cameras) place(camera, world_from_other);
    for (Light& light : other.lights) light.position = world_from_other.point(light.position);

    const uint32_t root = scene.add_node(node_name, {}, world_from_other);
    for (Node& node : other.nodes) shift(node.children, scene.nodes.size());
    shift(other.roots, scene.nodes.size());
    scene.nodes[root].children = std::move(other.roots);

    move_all(other.geometries, scene.geometries);
    move_all(other.meshes, scene.meshes);
    move_all(other.nodes, scene.nodes);
    move_all(other.cameras, scene.cameras);
    move_all(other.lights, scene.lights);
    move_all(other.materials, scene.materials);
    move_all(other.warnings, scene.warnings);
    return root;
}

}  // namespace crofton
