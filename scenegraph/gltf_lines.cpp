#include "scenegraph/gltf_lines.h"

#include <tiny_gltf.h>

#include "framework/bounds.h"
#include "framework/error.h"

namespace crofton {
namespace {

class LineWriter {
  public:
    LineWriter() { model_.buffers.resize(1); }

    void add_mesh(const LineMesh& lines) {
        tinygltf::Mesh mesh;
        mesh.name = lines.name;
        for (const LineMesh::Run& run : lines.runs)
            if (!run.positions.empty()) mesh.primitives.push_back(primitive(run));
        // A mesh without primitives would not be valid: its placements are left out, too.
        mesh_of_.push_back(mesh.primitives.empty() ? -1 : int(model_.meshes.size()));
        if (!mesh.primitives.empty()) model_.meshes.push_back(std::move(mesh));
    }
    void add_placement(const LinePlacement& placement) {
        if (mesh_of_[placement.mesh] < 0) return;
        tinygltf::Node node;
        node.mesh = mesh_of_[placement.mesh];
        const Transform& t = placement.world_from_mesh;
        if (!t.is_identity()) {
            for (int column = 0; column < 3; ++column) {
                for (int row = 0; row < 3; ++row) node.matrix.push_back(t.linear(row, column));
                node.matrix.push_back(0);
            }
            for (int row = 0; row < 3; ++row) node.matrix.push_back(t.translation[row]);
            node.matrix.push_back(1);
        }
        scene_.nodes.push_back(int(model_.nodes.size()));
        model_.nodes.push_back(std::move(node));
    }
    void write(const std::string& path) {
        model_.asset.version = "2.0";
        model_.asset.generator = "crofton";
        model_.extensionsUsed = {"KHR_materials_unlit"};
        model_.scenes.push_back(scene_);
        model_.defaultScene = 0;
        if (!tinygltf::TinyGLTF().WriteGltfSceneToFile(&model_, path, true, true, false, true))
            throw InputError(path + ": cannot be written");
    }

  private:
    tinygltf::Primitive primitive(const LineMesh::Run& run) {
        Bounds3 bounds;
        for (const Vec3f& p : run.positions) bounds.extend(p);
        tinygltf::Primitive primitive;
        primitive.mode = TINYGLTF_MODE_LINE;
        primitive.attributes["POSITION"] = accessor(
            run.positions.data(), run.positions.size(), sizeof(Vec3f),
            TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, TINYGLTF_TARGET_ARRAY_BUFFER);
        tinygltf::Accessor& positions = model_.accessors.back();
        positions.minValues.assign(bounds.lower.data(), bounds.lower.data() + 3);
        positions.maxValues.assign(bounds.upper.data(), bounds.upper.data() + 3);
        primitive.indices = accessor(run.lines.data(), run.lines.size(), sizeof(uint32_t),
                                     TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR,
                                     TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER);
        primitive.material = material(run.color);
        return primitive;
    }
    int accessor(const void* data, size_t count, size_t size, int component, int type, int target) {
        std::vector<unsigned char>& buffer = model_.buffers[0].data;
        tinygltf::BufferView view;
        view.buffer = 0;
        view.byteOffset = buffer.size();
        view.byteLength = count * size;
        view.target = target;
        const auto* bytes = static_cast<const unsigned char*>(data);
        buffer.insert(buffer.end(), bytes, bytes + count * size);
        tinygltf::Accessor a;
        a.bufferView = int(model_.bufferViews.size());
        a.count = count;
        a.componentType = component;
        a.type = type;
        model_.bufferViews.push_back(std::move(view));
        model_.accessors.push_back(std::move(a));
        return int(model_.accessors.size() - 1);
    }
    int material(const std::array<float, 3>& color) {
        const std::vector<double> factor{color[0], color[1], color[2], 1};
        for (size_t i = 0; i < model_.materials.size(); ++i)
            if (model_.materials[i].pbrMetallicRoughness.baseColorFactor == factor) return int(i);
        tinygltf::Material m;
        m.pbrMetallicRoughness.baseColorFactor = factor;
        m.extensions["KHR_materials_unlit"] = tinygltf::Value(tinygltf::Value::Object());
        model_.materials.push_back(std::move(m));
        return int(model_.materials.size() - 1);
    }

    tinygltf::Model model_;
    tinygltf::Scene scene_;
    std::vector<int> mesh_of_;
};

}  // namespace

void write_lines_glb(const std::string& path, const std::vector<LineMesh>& meshes,
                     const std::vector<LinePlacement>& placements) {
    LineWriter writer;
    for (const LineMesh& mesh : meshes) writer.add_mesh(mesh);
    for (const LinePlacement& placement : placements) writer.add_placement(placement);
    writer.write(path);
}

}  // namespace crofton
