#include "scenegraph/scene.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <utility>

#include "framework/error.h"
#include "scenegraph/gltf.h"
#include "scenegraph/nff.h"
#include "scenegraph/obj.h"
#include "scenegraph/ply.h"

namespace crofton {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Axis-aligned box in double; empty by default.
struct Box {
    Vec3d lower = Vec3d::Constant(kInfinity);
    Vec3d upper = Vec3d::Constant(-kInfinity);

    bool empty() const { return !(lower.array() <= upper.array()).all(); }
    void extend(const Vec3d& p) { extend(p, Vec3d::Zero()); }
    void extend(const Vec3d& center, const Vec3d& half) {
        if (!center.allFinite() || !half.allFinite()) return;
        lower = lower.cwiseMin(center - half);
        upper = upper.cwiseMax(center + half);
    }
    bool contains(const Box& b) const {
        return (lower.array() <= b.lower.array()).all() && (upper.array() >= b.upper.array()).all();
    }
};

/// Box of the image of a box; NaN where the map is not finite.
Box transformed(const Transform& t, const Box& b) {
    const Vec3d center = t.point(0.5 * b.lower + 0.5 * b.upper);
    const Vec3d half = t.linear.cwiseAbs() * (0.5 * b.upper - 0.5 * b.lower);
    return {center - half, center + half};
}

// --- Counts and boxes of one geometry -------------------------------------------------------

/// What the statistics need of a geometry, whatever places it.
struct Summary {
    uint64_t triangles = 0;
    uint64_t shapes = 0;
    uint64_t zero_area = 0;
    std::vector<uint32_t> vertices;  ///< finite vertices that triangles, polygons and points use
    Box box;                         ///< object space
};

bool zero_area(const Vec3f& a, const Vec3f& b, const Vec3f& c) {
    const Vec3d u = b.cast<double>() - a.cast<double>();
    const Vec3d v = c.cast<double>() - a.cast<double>();
    return u.y() * v.z() == u.z() * v.y() && u.z() * v.x() == u.x() * v.z() &&
           u.x() * v.y() == u.y() * v.x();
}

void summarize(const TriangleMesh& mesh, Summary& s) {
    s.triangles = s.shapes = mesh.triangles.size();
    std::vector<bool> used(mesh.positions.size());
    for (const std::array<uint32_t, 3>& t : mesh.triangles) {
        const Vec3f &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
        if (!a.allFinite() || !b.allFinite() || !c.allFinite()) continue;
        if (zero_area(a, b, c)) ++s.zero_area;
        for (uint32_t corner : t) used[corner] = true;
    }
    for (uint32_t i = 0; i < used.size(); ++i)
        if (used[i]) s.vertices.push_back(i);
}

void summarize(const Quadrics& quadrics, Summary& s) { s.shapes = quadrics.shapes.size(); }

void summarize_positions(const std::vector<Vec3f>& positions, Summary& s) {
    for (uint32_t i = 0; i < positions.size(); ++i)
        if (positions[i].allFinite()) s.vertices.push_back(i);
}

void summarize(const Polygons& polygons, Summary& s) {
    s.shapes = polygons.size();
    summarize_positions(polygons.positions, s);
}

void summarize(const Points& points, Summary& s) {
    s.shapes = points.positions.size();
    summarize_positions(points.positions, s);
}

/// Half the extent, along the world axes, of the image of a circle. Each row of the linear map is
/// projected into the circle's plane; with a zero normal this is the image of a sphere.
Vec3d circle_half(const Transform& t, double radius, const Vec3d& normal) {
    const double square = normal.squaredNorm();
    Vec3d half;
    for (int axis = 0; axis < 3; ++axis) {
        Vec3d row = t.linear.row(axis);
        if (square > 0) row -= normal * (row.dot(normal) / square);
        half[axis] = radius * row.norm();
    }
    return half;
}

void extend(const Transform& t, const Sphere& s, Box& box) {
    box.extend(t.point(s.center.cast<double>()), circle_half(t, s.radius, Vec3d::Zero()));
}

void extend(const Transform& t, const Cone& c, Box& box) {
    const Vec3d base = c.base.cast<double>(), apex = c.apex.cast<double>();
    box.extend(t.point(base), circle_half(t, c.base_radius, apex - base));
    box.extend(t.point(apex), circle_half(t, c.apex_radius, apex - base));
}

void extend(const Transform& t, const Disc& d, Box& box) {
    box.extend(t.point(d.center.cast<double>()), circle_half(t, d.radius, d.normal.cast<double>()));
}

/// Extends `box` by the exact bounds of the image of a geometry.
void extend(const Transform& t, const Geometry& geometry, const Summary& summary, Box& box) {
    const auto extend_by_shapes = [&](const auto& shapes) {
        if constexpr (std::is_same_v<std::decay_t<decltype(shapes)>, Quadrics>) {
            for (const Quadric& q : shapes.shapes)
                std::visit([&](const auto& shape) { extend(t, shape, box); }, q);
        } else {
            for (uint32_t i : summary.vertices)
                box.extend(t.point(shapes.positions[i].template cast<double>()));
        }
    };
    std::visit(extend_by_shapes, geometry.shapes);
}

Summary summary_of(const Geometry& geometry) {
    Summary s;
    std::visit([&](const auto& shapes) { summarize(shapes, s); }, geometry.shapes);
    extend(Transform{}, geometry, s, s.box);
    return s;
}

// --- The graph ------------------------------------------------------------------------------

/// Nodes that can be reached from a root, children before parents, each once.
std::vector<uint32_t> children_first(const Scene& scene) {
    std::vector<uint32_t> order;
    std::vector<bool> seen(scene.nodes.size());
    std::vector<std::pair<uint32_t, size_t>> stack;  // node, next child
    const auto enter = [&](uint32_t node) {
        if (seen[node]) return;
        seen[node] = true;
        stack.emplace_back(node, 0);
    };
    for (uint32_t root : scene.roots) {
        enter(root);
        while (!stack.empty()) {
            const uint32_t node = stack.back().first;
            const std::vector<uint32_t>& children = scene.nodes[node].children;
            if (stack.back().second < children.size()) {
                enter(children[stack.back().second++]);
            } else {
                order.push_back(node);
                stack.pop_back();
            }
        }
    }
    return order;
}

/// Placements of meshes at each node and below it; sums stop at 2^62.
std::vector<uint64_t> placements_below(const Scene& scene) {
    constexpr uint64_t kMany = uint64_t{1} << 62;
    std::vector<uint64_t> count(scene.nodes.size(), 0);
    for (uint32_t index : children_first(scene)) {
        const Node& node = scene.nodes[index];
        if (node.mesh) count[index] = std::max<uint64_t>(1, node.node_from_instance.size());
        for (uint32_t child : node.children)
            count[index] = std::min(kMany, count[index] + count[child]);
    }
    return count;
}

/// Throws if there are more than `limit` placements, before anything is visited; else returns how
/// many there are.
uint64_t checked_placements(const Scene& scene, const std::vector<uint64_t>& below, size_t limit) {
    uint64_t total = 0;
    for (uint32_t root : scene.roots) {
        total += below[root];
        if (total > limit)
            throw InputError(scene.source + ": more than " + std::to_string(limit) +
                             " mesh instances; shared nodes multiply them");
    }
    return total;
}

/// Calls visit(node, world_from_object) for every placement, depth first, in the order of children.
/// Branches without a mesh are left out, so that the work is at most placements times depth.
template <class Visit>
void for_each_placement(const Scene& scene, const std::vector<uint64_t>& below, Visit visit) {
    struct Entry {
        uint32_t node;
        Transform world_from_parent;
    };
    std::vector<Entry> stack;
    const auto push_reversed = [&](const std::vector<uint32_t>& nodes, const Transform& parent) {
        for (auto it = nodes.rbegin(); it != nodes.rend(); ++it)
            if (below[*it] > 0) stack.push_back({*it, parent});
    };
    push_reversed(scene.roots, Transform{});
    while (!stack.empty()) {
        const Entry entry = stack.back();
        stack.pop_back();
        const Node& node = scene.nodes[entry.node];
        const Transform world_from_node = entry.world_from_parent * node.parent_from_node;
        if (node.mesh && node.node_from_instance.empty()) visit(entry.node, world_from_node);
        if (node.mesh)
            for (const Transform& t : node.node_from_instance)
                visit(entry.node, world_from_node * t);
        push_reversed(node.children, world_from_node);
    }
}

uint64_t longest_path(const Scene& scene) {
    std::vector<uint64_t> height(scene.nodes.size(), 0);
    uint64_t longest = 0;
    for (uint32_t index : children_first(scene)) {
        for (uint32_t child : scene.nodes[index].children)
            height[index] = std::max(height[index], height[child]);
        longest = std::max(longest, ++height[index]);
    }
    return longest;
}

std::string lower_case_ending(const std::string& path) {
    std::string ending = std::filesystem::path(path).extension().string();
    if (!ending.empty()) ending.erase(0, 1);
    for (char& c : ending)
        if (c >= 'A' && c <= 'Z') c = char(c - 'A' + 'a');
    return ending;
}

std::string unknown_ending(const std::string& path, const std::string& ending) {
    std::string text = path + ": " + unknown_name("file ending", ending, scene_endings());
    if (nearest_name(ending, scene_endings()).empty()) return text;
    text += " valid:";
    for (const std::string& valid : scene_endings()) text += " " + valid;
    return text;
}

}  // namespace

uint32_t Scene::add_node(const std::string& node_name, std::optional<uint32_t> mesh,
                         const Transform& parent_from_node, std::optional<uint32_t> parent) {
    const uint32_t index = uint32_t(nodes.size());
    nodes.push_back({node_name, parent_from_node, {}, mesh, {}});
    if (parent)
        nodes[*parent].children.push_back(index);
    else
        roots.push_back(index);
    return index;
}

uint32_t Scene::add_object(const std::string& object_name, Geometry g,
                           const Transform& parent_from_node, std::optional<uint32_t> parent) {
    const uint32_t geometry = add_geometry(std::move(g));
    meshes.push_back({object_name, {geometry}});
    return add_node(object_name, uint32_t(meshes.size() - 1), parent_from_node, parent);
}

const std::vector<std::string>& scene_endings() {
    static const std::vector<std::string> endings = {"gltf", "glb", "obj", "ply", "nff"};
    return endings;
}

Scene load_scene(const std::string& path) {
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) throw InputError(path + ": no such file");
    if (std::filesystem::is_directory(status))
        throw InputError(path + ": is a directory, not a scene file");
    const std::string ending = lower_case_ending(path);
    Scene scene;
    if (ending == "gltf" || ending == "glb")
        scene = load_gltf(path);
    else if (ending == "obj")
        scene = load_obj(path);
    else if (ending == "ply")
        scene = load_ply(path);
    else if (ending == "nff")
        scene = load_nff(path);
    else
        throw InputError(unknown_ending(path, ending));
    scene.name = std::filesystem::path(path).stem().string();
    scene.source = path;
    return scene;
}

std::vector<MeshInstance> mesh_instances(const Scene& scene, size_t limit) {
    const std::vector<uint64_t> below = placements_below(scene);
    std::vector<MeshInstance> instances;
    instances.reserve(checked_placements(scene, below, limit));
    for_each_placement(scene, below, [&](uint32_t node, const Transform& world_from_object) {
        instances.push_back({node, *scene.nodes[node].mesh, world_from_object});
    });
    return instances;
}

ShapeGroups placement_groups(const Scene& scene) {
    const std::vector<uint64_t> below = placements_below(scene);
    checked_placements(scene, below, max_placements);
    ShapeGroups groups;
    uint32_t placed = 0;
    std::vector<uint32_t> stack;
    const auto push_reversed = [&](const std::vector<uint32_t>& nodes) {
        for (auto it = nodes.rbegin(); it != nodes.rend(); ++it)
            if (below[*it] > 0) stack.push_back(*it);
    };
    push_reversed(scene.roots);
    while (!stack.empty()) {
        const Node& node = scene.nodes[stack.back()];
        const ShapeGroup group{placed, placed + uint32_t(below[stack.back()])};
        stack.pop_back();
        // Links of a chain are one group.
        const bool repeated =
            !groups.empty() && groups.back().first == group.first && groups.back().end == group.end;
        if (group.end - group.first > 1 && !repeated) groups.push_back(group);
        if (node.mesh) placed += uint32_t(std::max<size_t>(node.node_from_instance.size(), 1));
        push_reversed(node.children);
    }
    return groups;
}

SceneStatistics statistics(const Scene& scene) {
    SceneStatistics result;
    std::vector<Summary> geometries;
    for (const Geometry& g : scene.geometries) geometries.push_back(summary_of(g));
    std::vector<Summary> meshes(scene.meshes.size());
    for (size_t m = 0; m < meshes.size(); ++m) {
        for (uint32_t g : scene.meshes[m].geometries) {
            meshes[m].triangles += geometries[g].triangles;
            meshes[m].shapes += geometries[g].shapes;
            meshes[m].box.lower = meshes[m].box.lower.cwiseMin(geometries[g].box.lower);
            meshes[m].box.upper = meshes[m].box.upper.cwiseMax(geometries[g].box.upper);
            result.zero_area_triangles_object_space += geometries[g].zero_area;
        }
        result.triangles_unique += meshes[m].triangles;
        result.shapes_unique += meshes[m].shapes;
    }

    Box bounds;
    const auto visit = [&](uint32_t node, const Transform& world_from_object) {
        const uint32_t m = *scene.nodes[node].mesh;
        ++result.mesh_instances;
        result.triangles_instanced += meshes[m].triangles;
        result.shapes_instanced += meshes[m].shapes;
        result.mirrored_instances += world_from_object.mirrored();
        // Only an instance whose box sticks out can change the bounds.
        if (meshes[m].box.empty()) return;
        if (bounds.contains(transformed(world_from_object, meshes[m].box))) return;
        for (uint32_t g : scene.meshes[m].geometries)
            extend(world_from_object, scene.geometries[g], geometries[g], bounds);
    };
    const std::vector<uint64_t> below = placements_below(scene);
    checked_placements(scene, below, max_placements);
    for_each_placement(scene, below, visit);
    result.depth = longest_path(scene);
    result.bounds_min = bounds.lower;
    result.bounds_max = bounds.upper;
    return result;
}

}  // namespace crofton
