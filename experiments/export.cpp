#include "experiments/export.h"

#include <map>

#include "framework/error.h"
#include "framework/instance.h"
#include "scenegraph/gltf_lines.h"

namespace crofton {
namespace {

constexpr uint64_t most_boxes = 1 << 22, most_placements = 1 << 20;

/// Levels differ in colour; after six they repeat. Distinguishable without red against green
/// (Okabe & Ito 2008), as linear RGB.
constexpr std::array<float, 3> palette[] = {{0.79f, 0.35f, 0.0f}, {0.09f, 0.46f, 0.81f},
                                            {0.0f, 0.34f, 0.17f}, {0.87f, 0.78f, 0.05f},
                                            {0.0f, 0.17f, 0.45f}, {0.6f, 0.19f, 0.39f}};
constexpr size_t colors = std::size(palette);

void add_box(const Bounds3& b, LineMesh::Run& run) {
    const uint32_t first = uint32_t(run.positions.size());
    for (uint32_t corner = 0; corner < 8; ++corner) {
        Vec3f p;
        for (int a = 0; a < 3; ++a) p[a] = corner >> a & 1 ? b.upper[a] : b.lower[a];
        run.positions.push_back(p);
    }
    for (uint32_t corner = 0; corner < 8; ++corner)
        for (uint32_t bit = 1; bit < 8; bit <<= 1)
            if (!(corner & bit)) {
                run.lines.push_back(first + corner);
                run.lines.push_back(first + (corner | bit));
            }
}

class BoxCollector {
  public:
    BoxCollector(const ExportOptions& options) : options_(options) {}

    void collect(const Primitive& root) {
        struct Open {
            const Primitive* object;
            Transform world_from_object;
        };
        std::vector<Open> open{{&root, {}}};
        while (!open.empty()) {
            const Open o = open.back();
            open.pop_back();
            if (placements.size() >= most_placements)
                throw InputError("more than 2^20 structures are placed: too many to draw");
            Transform inside = o.world_from_object;
            if (const auto* instance = dynamic_cast<const Instance*>(o.object))
                inside = inside * instance->parent_from_object();
            else
                placements.push_back({mesh_of(*o.object), o.world_from_object});
            o.object->children([&](const Primitive& child) { open.push_back({&child, inside}); });
        }
    }

    std::vector<LineMesh> meshes;
    std::vector<LinePlacement> placements;
    uint64_t boxes = 0;

  private:
    uint32_t mesh_of(const Primitive& structure) {
        const auto [it, fresh] = known_.try_emplace(&structure, uint32_t(meshes.size()));
        if (fresh) add_structure(structure);
        return it->second;
    }
    void add_structure(const Primitive& structure) {
        LineMesh& mesh = meshes.emplace_back();
        mesh.name = structure.type_name();
        for (const auto& color : palette) mesh.runs.push_back({color, {}, {}});
        structure.walk([&](const Bounds3& b, uint32_t depth, bool leaf, uint32_t references) {
            const bool hidden = leaf && references == 0 && !options_.empty_cells;
            if (hidden || b.empty() || int64_t(depth) > options_.depth) return;
            if (++boxes > most_boxes) throw InputError("more than 2^22 boxes: limit the depth");
            add_box(b, mesh.runs[depth % colors]);
        });
    }

    ExportOptions options_;
    std::map<const Primitive*, uint32_t> known_;
};

}  // namespace

ExportCount export_boxes(const Primitive& root, const std::string& path,
                         const ExportOptions& options) {
    BoxCollector collector(options);
    collector.collect(root);
    write_lines_glb(path, collector.meshes, collector.placements);
    return {collector.meshes.size(), collector.placements.size(), collector.boxes};
}

}  // namespace crofton
