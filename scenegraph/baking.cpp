#include "scenegraph/baking.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

namespace crofton {
namespace {

/// Half the area of what a map makes of a box with these edges.
double mapped_area(const Eigen::Matrix3d& map, const Vec3d& edges) {
    const Eigen::Matrix3d e = map * edges.asDiagonal();
    return e.col(0).cross(e.col(1)).norm() + e.col(1).cross(e.col(2)).norm() +
           e.col(2).cross(e.col(0)).norm();
}

/// Edges of the box of a triangle's corners under a map.
Vec3d extent(const TriangleMesh& mesh, size_t triangle, const Eigen::Matrix3d& map) {
    Vec3d low = Vec3d::Constant(std::numeric_limits<double>::infinity()), high = -low;
    for (const uint32_t corner : mesh.triangles[triangle]) {
        const Vec3d p = map * mesh.positions[corner].cast<double>();
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
    }
    return high - low;
}

/// But for what rounding may have left.
bool nearly_keeps_axes(const Eigen::Matrix3d& map) {
    const double least = 1e-6 * map.cwiseAbs().maxCoeff();
    return ((map.array().abs() > least).rowwise().count() <= 1).all();
}

}  // namespace

std::vector<bool> standing_nodes(const Scene& scene) {
    std::vector<uint32_t> ways(scene.nodes.size(), 0), users(scene.meshes.size(), 0), open;
    std::vector<bool> standing(scene.nodes.size(), false), seen(scene.nodes.size(), false);
    const auto come_to = [&](uint32_t n) {
        ++ways[n];
        if (seen[n]) return;
        seen[n] = true;
        open.push_back(n);
    };
    for (const uint32_t root : scene.roots) come_to(root);
    std::vector<uint32_t> order;
    while (!open.empty()) {
        const uint32_t n = open.back();
        open.pop_back();
        order.push_back(n);
        const Node& node = scene.nodes[n];
        if (node.mesh)
            users[*node.mesh] += uint32_t(std::max<size_t>(1, node.node_from_instance.size()));
        for (const uint32_t child : node.children) come_to(child);
    }
    // A node with one way to it comes after its parent.
    for (const uint32_t root : scene.roots) standing[root] = ways[root] == 1;
    for (const uint32_t n : order)
        for (const uint32_t child : scene.nodes[n].children)
            standing[child] = standing[n] && ways[child] == 1;
    for (const uint32_t n : order)
        if (const Node& node = scene.nodes[n];
            node.mesh && (users[*node.mesh] > 1 || !node.node_from_instance.empty()))
            standing[n] = false;
    return standing;
}

double area_ratio(const Scene& scene, uint32_t mesh, const Transform& world_from_object) {
    constexpr size_t most_looked_at = 32;  // of a geometry
    const Eigen::Matrix3d &map = world_from_object.linear, own = Eigen::Matrix3d::Identity();
    const bool keeps_axes = nearly_keeps_axes(map);
    double in_world = 0, in_own = 0;
    for (const uint32_t g : scene.meshes[mesh].geometries) {
        const auto* triangles = std::get_if<TriangleMesh>(&scene.geometries[g].shapes);
        if (!triangles) return std::numeric_limits<double>::infinity();
        if (keeps_axes) continue;
        const size_t size = triangles->triangles.size(), looked_at = std::min(size, most_looked_at);
        for (size_t i = 0; i < looked_at; ++i) {
            const size_t t = i * size / looked_at;
            const double world = mapped_area(own, extent(*triangles, t, map)),
                         object = mapped_area(map, extent(*triangles, t, own));
            if (!(world + object < std::numeric_limits<double>::infinity())) continue;
            // For the share of a geometry of which not all are looked at.
            const double share = double(size) / double(looked_at);
            in_world += share * world;
            in_own += share * object;
        }
    }
    return in_own > 0 ? in_world / in_own : 1;
}

}  // namespace crofton
