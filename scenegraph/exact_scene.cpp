#include "scenegraph/exact_scene.h"

#include <algorithm>

#include "framework/instance.h"
#include "scenegraph/shape_sets.h"

namespace crofton {
namespace {

/// A map on the way to a root.
struct Link {
    Transform parent_from_this;
    int64_t parent;  ///< index of the link above, or -1
};

/// Whether a mesh is at or below each node. Nodes without one can be shared into more paths than
/// anyone can walk.
std::vector<bool> leads_to_mesh(const Scene& scene) {
    std::vector<std::vector<uint32_t>> parents(scene.nodes.size());
    std::vector<uint32_t> open;
    std::vector<bool> leads(scene.nodes.size(), false);
    const auto reach = [&](uint32_t n) {
        if (leads[n]) return;
        leads[n] = true;
        open.push_back(n);
    };
    for (uint32_t n = 0; n < scene.nodes.size(); ++n)
        for (uint32_t child : scene.nodes[n].children) parents[child].push_back(n);
    for (uint32_t n = 0; n < scene.nodes.size(); ++n)
        if (scene.nodes[n].mesh) reach(n);
    while (!open.empty()) {
        const uint32_t n = open.back();
        open.pop_back();
        for (uint32_t parent : parents[n]) reach(parent);
    }
    return leads;
}

/// The chains of all placements, in the order of mesh_instances.
class ChainWalk {
  public:
    explicit ChainWalk(const Scene& scene) : scene_(scene) {}

    template <class Visit>
    void run(const Visit& visit) {
        const std::vector<bool> leads = leads_to_mesh(scene_);
        std::vector<std::pair<uint32_t, int64_t>> open;  // node, link of its parent
        const auto push = [&](const std::vector<uint32_t>& nodes, int64_t parent) {
            for (auto it = nodes.rbegin(); it != nodes.rend(); ++it)
                if (leads[*it]) open.push_back({*it, parent});
        };
        push(scene_.roots, -1);
        while (!open.empty()) {
            const auto [n, parent] = open.back();
            open.pop_back();
            const Node& node = scene_.nodes[n];
            const int64_t link = add(node.parent_from_node, parent);
            if (node.mesh) {
                if (node.node_from_instance.empty()) visit(*node.mesh, chain(link));
                for (const Transform& t : node.node_from_instance)
                    visit(*node.mesh, chain(add(t, link)));
            }
            push(node.children, link);
        }
    }

  private:
    int64_t add(const Transform& t, int64_t parent) {
        if (t.is_identity()) return parent;
        links_.push_back({t, parent});
        return int64_t(links_.size()) - 1;
    }
    std::vector<Transform> chain(int64_t link) const {
        std::vector<Transform> maps;
        for (; link >= 0; link = links_[size_t(link)].parent)
            maps.push_back(links_[size_t(link)].parent_from_this);
        std::reverse(maps.begin(), maps.end());
        return maps;
    }

    const Scene& scene_;
    std::vector<Link> links_;
};

void add_triangles(exact::Oracle& oracle, const TriangleMesh& mesh,
                   exact::Oracle::Placement placement, const Transform* rounded_from) {
    if (!rounded_from) return oracle.add_triangles(mesh.positions, mesh.triangles, placement);
    const FloatTransform map = rounded(*rounded_from);
    std::vector<Vec3f> positions;
    for (const Vec3f& p : mesh.positions) positions.push_back(apply(map, p));
    placement.chain.clear();
    oracle.add_triangles(positions, mesh.triangles, placement);
}

void add_quadrics(exact::Oracle& oracle, const Quadrics& quadrics,
                  const exact::Oracle::Placement& placement) {
    std::vector<QuadricShape> shapes;
    for (const Quadric& q : quadrics.shapes) shapes.push_back(quadric_shape(q));
    oracle.add_quadrics(shapes, placement);
}

}  // namespace

exact::Oracle make_oracle(const Scene& scene, PlacementTruth truth) {
    exact::Oracle oracle;
    const std::vector<MeshInstance> placed = mesh_instances(scene);
    uint32_t instance = 0;
    ChainWalk(scene).run([&](uint32_t mesh, std::vector<Transform> chain) {
        const Transform& composed = placed[instance].world_from_object;
        exact::Oracle::Placement placement{std::move(chain), 0, instance++};
        if (!composed.is_identity() && !Instance::is_valid(composed)) return;
        const bool as_placed = truth == PlacementTruth::as_placed && !composed.is_identity();
        for (const uint32_t g : scene.meshes[mesh].geometries) {
            placement.geometry = g;
            const auto& shapes = scene.geometries[g].shapes;
            if (const auto* t = std::get_if<TriangleMesh>(&shapes))
                add_triangles(oracle, *t, placement, as_placed ? &composed : nullptr);
            else if (const auto* q = std::get_if<Quadrics>(&shapes))
                add_quadrics(oracle, *q, placement);
            else if (const auto* p = std::get_if<Polygons>(&shapes); p && p->size() > 0)
                oracle.add_polygons(p->positions, p->first, placement);
        }
    });
    oracle.finish();
    return oracle;
}

}  // namespace crofton
