#include "experiments/inspect.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "experiments/row.h"

namespace crofton {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t most_lines = 200;
constexpr uint64_t saturated = std::numeric_limits<uint64_t>::max();

struct ShapeCount {
    uint64_t operator()(const TriangleMesh& m) const { return m.triangles.size(); }
    uint64_t operator()(const Quadrics& q) const { return q.shapes.size(); }
    uint64_t operator()(const Polygons& p) const { return p.size(); }
    uint64_t operator()(const Points& p) const { return p.positions.size(); }
};

struct ShapeKind {
    const char* operator()(const TriangleMesh&) const { return "triangles"; }
    const char* operator()(const Quadrics&) const { return "quadrics"; }
    const char* operator()(const Polygons&) const { return "polygons"; }
    const char* operator()(const Points&) const { return "points"; }
};

struct ShapeBytes {
    uint64_t operator()(const TriangleMesh& m) const {
        return m.positions.size() * sizeof(Vec3f) + m.triangles.size() * sizeof(m.triangles[0]);
    }
    uint64_t operator()(const Quadrics& q) const { return q.shapes.size() * sizeof(Quadric); }
    uint64_t operator()(const Polygons& p) const {
        return p.positions.size() * sizeof(Vec3f) + p.first.size() * sizeof(uint32_t);
    }
    uint64_t operator()(const Points& p) const {
        return (p.positions.size() + p.normals.size()) * sizeof(Vec3f) +
               p.radii.size() * sizeof(float);
    }
};

std::string mesh_text(const Scene& scene, uint32_t mesh) {
    std::string text;
    uint64_t counts[4] = {};
    const char* kinds[4] = {"triangles", "quadrics", "polygons", "points"};
    for (const uint32_t g : scene.meshes[mesh].geometries) {
        const auto& shapes = scene.geometries[g].shapes;
        counts[shapes.index()] += std::visit(ShapeCount{}, shapes);
    }
    for (int k = 0; k < 4; ++k)
        if (counts[k])
            text += fmt::format("{}{} {}", text.empty() ? "" : ", ", counts[k], kinds[k]);
    return text.empty() ? "empty" : text;
}

std::string node_text(const Scene& scene, uint32_t index) {
    const Node& node = scene.nodes[index];
    std::string text = node_name(scene, node);
    if (text.empty()) text = fmt::format("#{}", index);
    if (node.mesh) text += ": " + mesh_text(scene, *node.mesh);
    if (!node.node_from_instance.empty())
        text += fmt::format(" x {}", node.node_from_instance.size());
    if (!node.parent_from_node.finite())
        text += ", transform not finite";
    else if (node.parent_from_node.mirrored())
        text += ", mirrored";
    return text;
}

/// Lines below every node, itself included, saturating; shared nodes count once per path.
std::vector<uint64_t> subtree_sizes(const Scene& scene) {
    std::vector<uint64_t> sizes(scene.nodes.size(), 0);
    // Depth first on a stack of our own; the second visit of an entry sums its children.
    std::vector<std::pair<uint32_t, bool>> stack;
    for (const uint32_t root : scene.roots) stack.emplace_back(root, false);
    while (!stack.empty()) {
        const auto [node, children_done] = stack.back();
        stack.pop_back();
        if (sizes[node]) continue;
        const std::vector<uint32_t>& children = scene.nodes[node].children;
        if (children_done) {
            uint64_t sum = 1;
            for (const uint32_t c : children)
                sum = sizes[c] > saturated - sum ? saturated : sum + sizes[c];
            sizes[node] = sum;
            continue;
        }
        stack.emplace_back(node, true);
        for (const uint32_t c : children) stack.emplace_back(c, false);
    }
    return sizes;
}

/// The tree, cut after `limit` lines with a note on how many were left out.
std::string tree_text(const Scene& scene, size_t limit) {
    const std::vector<uint64_t> sizes = subtree_sizes(scene);
    uint64_t total = 0;
    for (const uint32_t r : scene.roots)
        total = sizes[r] > saturated - total ? saturated : total + sizes[r];
    std::string text;
    size_t lines = 0;
    std::vector<std::pair<uint32_t, uint32_t>> stack;  // node and depth
    for (auto r = scene.roots.rbegin(); r != scene.roots.rend(); ++r) stack.emplace_back(*r, 1);
    while (!stack.empty() && lines < limit) {
        const auto [node, depth] = stack.back();
        stack.pop_back();
        // Deep chains are not indented for ever.
        text += std::string(2 * std::min<size_t>(depth, 40), ' ') + node_text(scene, node) + "\n";
        ++lines;
        const std::vector<uint32_t>& children = scene.nodes[node].children;
        for (auto c = children.rbegin(); c != children.rend(); ++c)
            stack.emplace_back(*c, depth + 1);
    }
    if (total > lines)
        text += fmt::format("  … and {}{} more lines (--all prints every one)\n",
                            total == saturated ? "at least " : "", total - lines);
    return text;
}

bool has_bounds(const SceneStatistics& s) {
    return (s.bounds_min.array() <= s.bounds_max.array()).all();
}

Json json_of(const Vec3d& v, bool valid) {
    if (!valid) return Json::array({nullptr, nullptr, nullptr});
    return Json::array({v.x(), v.y(), v.z()});
}

void put_assembly(Json& json, const Assembly& assembly) {
    const StructureStatistics s = total_statistics(*assembly.root);
    json["accelerator"] = describe(*assembly.root);
    json["build_s"] = assembly.build_s;
    json["structure_bytes"] = s.bytes;
    json["opened_objects"] = assembly.opened;
    json["parts"] = assembly.parts;
    json["inactive_instances"] = assembly.inactive_instances;
    json["inactive_shapes"] = assembly.inactive_shapes;
    json["nodes_assigned"] = Json::array();
    for (const Assembly::Entry& e : assembly.entries)
        json["nodes_assigned"].push_back({{"path", e.path},
                                          {"accelerator", e.label},
                                          {"type", e.type},
                                          {"shapes", e.shapes},
                                          {"bytes", e.bytes},
                                          {"placements", e.placements}});
}

std::string json_text(const Scene& scene, const SceneStatistics& s, const Assembly* assembly) {
    Json json;
    json["scene"] = scene.name;
    json["source"] = scene.source;
    json["triangles_unique"] = s.triangles_unique;
    json["triangles_instanced"] = s.triangles_instanced;
    json["shapes_unique"] = s.shapes_unique;
    json["shapes_instanced"] = s.shapes_instanced;
    json["nodes"] = scene.nodes.size();
    json["meshes"] = scene.meshes.size();
    json["geometries"] = scene.geometries.size();
    json["mesh_instances"] = s.mesh_instances;
    json["depth"] = s.depth;
    json["bounds_min"] = json_of(s.bounds_min, has_bounds(s));
    json["bounds_max"] = json_of(s.bounds_max, has_bounds(s));
    json["zero_area_triangles_object_space"] = s.zero_area_triangles_object_space;
    json["mirrored_instances"] = s.mirrored_instances;
    json["cameras"] = scene.cameras.size();
    json["lights"] = scene.lights.size();
    json["materials"] = scene.materials.size();
    json["shape_bytes"] = shape_bytes(scene);
    json["warnings"] = scene.warnings;
    if (assembly) put_assembly(json, *assembly);
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string summary_text(const Scene& scene, const SceneStatistics& s) {
    std::string text = fmt::format("{} ({})\n", scene.name, scene.source);
    text += fmt::format("  triangles      {}, instanced {}\n", s.triangles_unique,
                        s.triangles_instanced);
    if (s.shapes_unique != s.triangles_unique)
        text +=
            fmt::format("  all shapes     {}, instanced {}\n", s.shapes_unique, s.shapes_instanced);
    text += fmt::format("  nodes          {}, depth {}\n", scene.nodes.size(), s.depth);
    text += fmt::format("  meshes         {}, placed {} times, {} mirrored\n", scene.meshes.size(),
                        s.mesh_instances, s.mirrored_instances);
    if (s.zero_area_triangles_object_space)
        text += fmt::format("  zero area      {} triangles\n", s.zero_area_triangles_object_space);
    if (has_bounds(s))
        text += fmt::format("  bounds         ({:g}, {:g}, {:g}) … ({:g}, {:g}, {:g})\n",
                            s.bounds_min.x(), s.bounds_min.y(), s.bounds_min.z(), s.bounds_max.x(),
                            s.bounds_max.y(), s.bounds_max.z());
    else
        text += "  bounds         empty\n";
    text += fmt::format("  cameras        {}, lights {}, materials {}\n", scene.cameras.size(),
                        scene.lights.size(), scene.materials.size());
    text += fmt::format("  memory         {:.3f} MB of shapes\n", double(shape_bytes(scene)) / 1e6);
    return text;
}

std::string assembly_text(const Assembly& assembly, size_t limit) {
    const StructureStatistics s = total_statistics(*assembly.root);
    std::string text =
        fmt::format("\nAccelerators: {}, built in {:.3f} s, {:.3f} MB\n", describe(*assembly.root),
                    assembly.build_s, double(s.bytes) / 1e6);
    text += fmt::format("  {} inner nodes, {} cells ({} empty), {} references, depth {}\n", s.N_IN,
                        s.N_V, s.N_EV, s.N_OIV, s.depth);
    text += fmt::format("  expected: {:.1f} nominal ns for a line that meets the bounds\n",
                        assembly.root->expected_cost());
    if (assembly.opened > 0)
        text += fmt::format("  {} objects opened into {} parts\n", assembly.opened, assembly.parts);
    size_t lines = 0;
    for (const Assembly::Entry& e : assembly.entries) {
        if (lines++ == limit) {
            text += fmt::format("  … and {} more\n", assembly.entries.size() - limit);
            break;
        }
        text += fmt::format("  {}: {} ({}), {} shapes, {} bytes, placed {} times\n",
                            e.path.empty() ? "(top)" : e.path, e.label, e.type, e.shapes, e.bytes,
                            e.placements);
    }
    for (const std::string& warning : assembly.warnings) text += "  warning: " + warning + "\n";
    return text;
}

}  // namespace

uint64_t shape_bytes(const Scene& scene) {
    uint64_t bytes = 0;
    for (const Geometry& g : scene.geometries) bytes += std::visit(ShapeBytes{}, g.shapes);
    return bytes;
}

std::string inspect_text(const Scene& scene, const Assembly* assembly,
                         const InspectOptions& options) {
    const SceneStatistics s = statistics(scene);
    if (options.json) return json_text(scene, s, assembly);
    const size_t limit = options.all ? std::numeric_limits<size_t>::max() : most_lines;
    std::string text = summary_text(scene, s) + "\nNodes:\n" + tree_text(scene, limit);
    if (assembly) text += assembly_text(*assembly, limit);
    for (size_t i = 0; i < std::min(limit, scene.warnings.size()); ++i)
        text += "warning: " + scene.warnings[i] + "\n";
    if (scene.warnings.size() > limit)
        text += fmt::format("… and {} more warnings\n", scene.warnings.size() - limit);
    return text;
}

}  // namespace crofton
