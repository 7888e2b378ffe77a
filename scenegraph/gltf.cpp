#include "scenegraph/gltf.h"

#include <tiny_gltf.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cctype>
#include <cstring>
#include <exception>
#include <filesystem>
#include <limits>
#include <new>
#include <set>

#include "framework/error.h"
#include "scenegraph/gltf_check.h"
#include "scenegraph/gltf_container.h"

namespace crofton {
namespace {

using gltf::Bytes;
using gltf::Remarks;

// --- The parser and its view of the file system ---------------------------------------------

/// Serves the buffers of a checked document to the parser, which knows them by buffer_name only.
/// The parser cannot pass exceptions on; the last one is kept here.
struct BufferServer {
    const std::vector<gltf::BufferSource>& sources;
    std::filesystem::path folder;
    Bytes binary;
    std::set<std::filesystem::path> files_read = {};
    uint64_t bytes_read_again = 0;
    std::exception_ptr error = nullptr;

    Bytes bytes(size_t index);
    Bytes external_bytes(const gltf::BufferSource& source);
};

Bytes BufferServer::external_bytes(const gltf::BufferSource& source) {
    // Many buffers that name one file would multiply its size in memory.
    constexpr uint64_t again_limit = uint64_t{64} << 20;
    const std::filesystem::path file = gltf::confined_path(folder, source.uri);
    if (!files_read.insert(file).second) bytes_read_again += source.byte_length;
    if (bytes_read_again > again_limit) throw InputError("names the same file as other buffers");
    return gltf::read_file(file, source.byte_length);
}

Bytes BufferServer::bytes(size_t index) {
    const gltf::BufferSource& source = sources[index];
    if (!source.used) return Bytes(1);
    Bytes bytes;
    if (!source.has_uri)
        bytes = std::move(binary);
    else if (gltf::is_data_uri(source.uri))
        bytes = gltf::decode_data_uri(source.uri);
    else
        bytes = external_bytes(source);
    if (bytes.size() < source.byte_length)
        throw InputError("has " + std::to_string(bytes.size()) +
                         " bytes, fewer than its byteLength " + std::to_string(source.byte_length));
    bytes.resize(source.byte_length);
    return bytes;
}

bool serve_buffer(std::vector<unsigned char>* out, std::string*, const std::string& name,
                  void* user_data) {
    BufferServer& server = *static_cast<BufferServer*>(user_data);
    const size_t index = gltf::buffer_index(name);
    try {
        *out = server.bytes(index);
        return true;
    } catch (const InputError& error) {
        const std::string place = "buffers/" + std::to_string(index) + ": ";
        server.error = std::make_exception_ptr(InputError(place + error.what()));
    } catch (...) {
        server.error = std::current_exception();
    }
    return false;
}

bool ignore_image(tinygltf::Image*, int, std::string*, std::string*, int, int, const unsigned char*,
                  int, void*) {
    return true;
}

tinygltf::FsCallbacks confined_files(BufferServer& server) {
    tinygltf::FsCallbacks files = {};
    files.FileExists = [](const std::string& name, void* user_data) {
        return gltf::buffer_index(name) < static_cast<BufferServer*>(user_data)->sources.size();
    };
    files.ExpandFilePath = [](const std::string& name, void*) { return name; };
    files.ReadWholeFile = serve_buffer;
    files.WriteWholeFile = [](std::string*, const std::string&, const std::vector<unsigned char>&,
                              void*) { return false; };
    files.user_data = &server;
    return files;
}

tinygltf::Model parse_model(const std::string& json, BufferServer& server) {
    if (json.size() > std::numeric_limits<unsigned>::max()) throw InputError("JSON: too long");
    tinygltf::TinyGLTF parser;
    parser.SetImageLoader(ignore_image, nullptr);
    parser.SetFsCallbacks(confined_files(server));
    tinygltf::Model model;
    std::string error, warning;
    const bool is_parsed = parser.LoadASCIIFromString(&model, &error, &warning, json.data(),
                                                      unsigned(json.size()), "");
    if (server.error) std::rethrow_exception(server.error);
    if (!is_parsed) throw InputError(error.empty() ? "cannot be parsed" : error);
    return model;
}

// --- Accessors ------------------------------------------------------------------------------

template <typename T>
T loaded(const unsigned char* from) {
    T value;
    std::memcpy(&value, from, sizeof value);
    return value;
}

template <typename T>
float integer_component(const unsigned char* from, bool is_normalized) {
    const T value = loaded<T>(from);
    if (!is_normalized) return float(value);
    return std::max(float(value) / float(std::numeric_limits<T>::max()), -1.0f);
}

float component(const unsigned char* from, int type, bool is_normalized) {
    switch (type) {
        case TINYGLTF_COMPONENT_TYPE_BYTE:
            return integer_component<int8_t>(from, is_normalized);
        case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
            return integer_component<uint8_t>(from, is_normalized);
        case TINYGLTF_COMPONENT_TYPE_SHORT:
            return integer_component<int16_t>(from, is_normalized);
        case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
            return integer_component<uint16_t>(from, is_normalized);
        default:
            return loaded<float>(from);
    }
}

uint32_t index_component(const unsigned char* from, int type) {
    switch (type) {
        case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
            return *from;
        case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
            return loaded<uint16_t>(from);
        default:
            return loaded<uint32_t>(from);
    }
}

size_t element_size(const tinygltf::Accessor& a) {
    return size_t(tinygltf::GetComponentSizeInBytes(uint32_t(a.componentType))) *
           size_t(tinygltf::GetNumComponentsInType(uint32_t(a.type)));
}

const unsigned char* view_data(const tinygltf::Model& model, int view, size_t offset) {
    const tinygltf::BufferView& v = model.bufferViews[size_t(view)];
    return model.buffers[size_t(v.buffer)].data.data() + v.byteOffset + offset;
}

/// Limits what a file can make of itself by naming the same data again and again.
class MemoryBudget {
  public:
    explicit MemoryBudget(uint64_t input_bytes)
        : left_((uint64_t{64} << 20) + amplification * std::min(input_bytes, uint64_t{1} << 48)) {}

    void spend(uint64_t count, uint64_t bytes_each, const std::string& place) {
        if (count > left_ / bytes_each)
            throw InputError(place + ": " + std::to_string(count) +
                             " elements are out of proportion to the size of the file");
        left_ -= count * bytes_each;
    }

  private:
    static constexpr uint64_t amplification = 128;
    uint64_t left_;
};

/// Reads elements of accessors that check_document has found to be inside their buffers.
class AccessorReader {
  public:
    AccessorReader(const tinygltf::Model& model, MemoryBudget& budget)
        : model_(model), budget_(budget) {}

    size_t count(int accessor) const { return model_.accessors[size_t(accessor)].count; }
    std::vector<uint32_t> indices(int accessor);
    /// Elements of N floats: all, or those that the ascending list `wanted` names, in its order.
    template <int N>
    std::vector<Eigen::Matrix<float, N, 1>> vectors(int accessor,
                                                    const std::vector<uint32_t>* wanted = nullptr);

  private:
    /// Calls put(element, address) for each element that the sparse part replaces.
    template <typename Put>
    void for_sparse(const tinygltf::Accessor& a, int accessor, Put put) const;

    const tinygltf::Model& model_;
    MemoryBudget& budget_;
};

std::string accessor_place(int accessor) { return "accessors/" + std::to_string(accessor); }

template <typename Put>
void AccessorReader::for_sparse(const tinygltf::Accessor& a, int accessor, Put put) const {
    if (!a.sparse.isSparse || a.sparse.count == 0) return;
    const auto& sparse = a.sparse;
    const int type = sparse.indices.componentType;
    const size_t index_size = size_t(tinygltf::GetComponentSizeInBytes(uint32_t(type)));
    const unsigned char* index =
        view_data(model_, sparse.indices.bufferView, size_t(sparse.indices.byteOffset));
    const unsigned char* value =
        view_data(model_, sparse.values.bufferView, size_t(sparse.values.byteOffset));
    for (int i = 0; i < sparse.count; ++i, index += index_size, value += element_size(a)) {
        const uint32_t element = index_component(index, type);
        if (element >= a.count)
            throw InputError(accessor_place(accessor) + "/sparse: index " +
                             std::to_string(element) + " of " + std::to_string(a.count) +
                             " elements");
        put(element, value);
    }
}

std::vector<uint32_t> AccessorReader::indices(int accessor) {
    const tinygltf::Accessor& a = model_.accessors[size_t(accessor)];
    budget_.spend(a.count, sizeof(uint32_t), accessor_place(accessor));
    std::vector<uint32_t> out(a.count, 0);
    if (a.bufferView >= 0 && a.count > 0) {
        const size_t view_stride = model_.bufferViews[size_t(a.bufferView)].byteStride;
        const size_t stride = view_stride ? view_stride : element_size(a);
        const unsigned char* data = view_data(model_, a.bufferView, a.byteOffset);
        for (size_t i = 0; i < a.count; ++i)
            out[i] = index_component(data + i * stride, a.componentType);
    }
    for_sparse(a, accessor, [&](uint32_t element, const unsigned char* value) {
        out[element] = index_component(value, a.componentType);
    });
    return out;
}

template <int N>
std::vector<Eigen::Matrix<float, N, 1>> AccessorReader::vectors(
    int accessor, const std::vector<uint32_t>* wanted) {
    using Vector = Eigen::Matrix<float, N, 1>;
    const tinygltf::Accessor& a = model_.accessors[size_t(accessor)];
    const size_t size = wanted ? wanted->size() : a.count;
    budget_.spend(size, sizeof(Vector), accessor_place(accessor));
    std::vector<Vector> out(size, Vector::Zero());
    const auto read = [&](Vector& to, const unsigned char* from) {
        const int step = tinygltf::GetComponentSizeInBytes(uint32_t(a.componentType));
        for (int i = 0; i < N; ++i)
            to[i] = component(from + i * step, a.componentType, a.normalized);
    };
    if (a.bufferView >= 0 && size > 0) {
        const size_t view_stride = model_.bufferViews[size_t(a.bufferView)].byteStride;
        const size_t stride = view_stride ? view_stride : element_size(a);
        const unsigned char* data = view_data(model_, a.bufferView, a.byteOffset);
        for (size_t i = 0; i < size; ++i) read(out[i], data + (wanted ? (*wanted)[i] : i) * stride);
    }
    for_sparse(a, accessor, [&](uint32_t element, const unsigned char* value) {
        if (!wanted) return read(out[element], value);
        const auto it = std::lower_bound(wanted->begin(), wanted->end(), element);
        if (it != wanted->end() && *it == element) read(out[size_t(it - wanted->begin())], value);
    });
    return out;
}

// --- Triangles ------------------------------------------------------------------------------

using Triangle = std::array<uint32_t, 3>;

/// Number of triangles of a primitive with this many corners.
uint64_t triangle_count(int mode, uint64_t corners) {
    if (mode == TINYGLTF_MODE_TRIANGLES) return corners / 3;
    return corners < 3 ? 0 : corners - 2;
}

/// The corners of triangle i, in the order of the specification: in a strip every second triangle
/// is turned, so that all face the same way.
Triangle triangle_corners(int mode, uint32_t i) {
    switch (mode) {
        case TINYGLTF_MODE_TRIANGLE_STRIP:
            return {i, i + 1 + i % 2, i + 2 - i % 2};
        case TINYGLTF_MODE_TRIANGLE_FAN:
            return {i + 1, i + 2, 0};
        default:
            return {3 * i, 3 * i + 1, 3 * i + 2};
    }
}

/// Renumbers corners so that they count only the vertices in use.
/// @return  the ascending old numbers of those vertices
std::vector<uint32_t> renumber(std::vector<Triangle>& triangles) {
    std::vector<uint32_t> used;
    used.reserve(triangles.size() * 3);
    for (const Triangle& t : triangles) used.insert(used.end(), t.begin(), t.end());
    std::sort(used.begin(), used.end());
    used.erase(std::unique(used.begin(), used.end()), used.end());
    for (Triangle& t : triangles)
        for (uint32_t& corner : t)
            corner = uint32_t(std::lower_bound(used.begin(), used.end(), corner) - used.begin());
    return used;
}

/// Makes the triangles of one checked primitive.
class PrimitiveReader {
  public:
    PrimitiveReader(const tinygltf::Primitive& primitive, AccessorReader& accessors,
                    MemoryBudget& budget, Remarks& remarks, std::string place)
        : primitive_(primitive),
          accessors_(accessors),
          budget_(budget),
          remarks_(remarks),
          place_(std::move(place)) {}

    TriangleMesh read();

  private:
    int attribute(const char* name) const {
        const auto it = primitive_.attributes.find(name);
        return it == primitive_.attributes.end() ? -1 : it->second;
    }
    std::vector<Triangle> triangles(int index_accessor, size_t vertex_count);

    const tinygltf::Primitive& primitive_;
    AccessorReader& accessors_;
    MemoryBudget& budget_;
    Remarks& remarks_;
    const std::string place_;
};

TriangleMesh PrimitiveReader::read() {
    TriangleMesh mesh;
    const int positions = attribute("POSITION");
    if (positions < 0) return mesh;
    const int indices =
        primitive_.indices >= 0 ? primitive_.indices : attribute(gltf::viewless_indices);
    const size_t vertex_count = accessors_.count(positions);
    mesh.triangles = triangles(indices, vertex_count);
    if (mesh.triangles.empty()) return mesh;

    // Primitives may use small parts of one large vertex array: each keeps only its part.
    const bool is_sparse_use = mesh.triangles.size() * 3 < vertex_count;
    if (is_sparse_use) {
        const std::vector<uint32_t> used = renumber(mesh.triangles);
        mesh.positions = accessors_.vectors<3>(positions, &used);
    } else {
        mesh.positions = accessors_.vectors<3>(positions);
    }
    return mesh;
}

std::vector<Triangle> PrimitiveReader::triangles(int index_accessor, size_t vertex_count) {
    const bool is_indexed = index_accessor >= 0;
    const uint64_t corners = is_indexed ? accessors_.count(index_accessor) : vertex_count;
    const int mode = primitive_.mode;
    if (mode == TINYGLTF_MODE_TRIANGLES ? corners % 3 != 0 : corners == 1 || corners == 2)
        remarks_.add("the incomplete last triangle is dropped", place_);
    const uint64_t count = triangle_count(mode, corners);
    budget_.spend(count, sizeof(Triangle), place_);
    std::vector<uint32_t> indices;
    if (is_indexed) indices = accessors_.indices(index_accessor);
    for (const uint32_t index : indices)
        if (index >= vertex_count)
            throw InputError(place_ + ": index " + std::to_string(index) + " of " +
                             std::to_string(vertex_count) + " vertices");
    std::vector<Triangle> out(count);
    for (uint32_t i = 0; i < count; ++i) {
        out[i] = triangle_corners(mode, i);
        if (is_indexed)
            for (uint32_t& corner : out[i]) corner = indices[corner];
    }
    return out;
}

// --- Transforms -----------------------------------------------------------------------------

Transform composed(const Vec3d& t, const Eigen::Quaterniond& rotation, const Vec3d& scale) {
    return {rotation.toRotationMatrix() * scale.asDiagonal(), t};
}

Transform local_transform(const tinygltf::Node& node) {
    if (node.matrix.size() == 16) {
        const Eigen::Matrix4d m = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
        return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
    }
    Vec3d t = Vec3d::Zero(), scale = Vec3d::Ones();
    Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
    if (node.translation.size() == 3) t = Eigen::Map<const Vec3d>(node.translation.data());
    if (node.scale.size() == 3) scale = Eigen::Map<const Vec3d>(node.scale.data());
    // The coefficients of Eigen are in the order x y z w, too.
    if (node.rotation.size() == 4)
        rotation.coeffs() = Eigen::Map<const Eigen::Vector4d>(node.rotation.data());
    return composed(t, rotation, scale);
}

// --- The scene ------------------------------------------------------------------------------

class SceneBuilder {
  public:
    SceneBuilder(const tinygltf::Model& model, MemoryBudget& budget, Remarks& remarks)
        : model_(model), budget_(budget), remarks_(remarks), accessors_(model, budget) {}

    Scene build();

  private:
    void add_materials();
    void add_meshes();
    void add_primitive(const tinygltf::Mesh& mesh, size_t mesh_index, size_t primitive_index);
    void add_nodes();
    std::vector<Transform> instances(const tinygltf::Value& attributes);
    void add_roots();
    void add_cameras();
    void add_camera(const tinygltf::Camera& camera, const Transform& world_from_node,
                    const std::string& place);

    const tinygltf::Model& model_;
    MemoryBudget& budget_;
    Remarks& remarks_;
    AccessorReader accessors_;
    Scene scene_;
};

Scene SceneBuilder::build() {
    add_materials();
    add_meshes();
    add_nodes();
    add_roots();
    add_cameras();
    return std::move(scene_);
}

void SceneBuilder::add_materials() {
    for (const tinygltf::Material& material : model_.materials) {
        Material m;
        m.name = material.name;
        m.color = {1.0f, 1.0f, 1.0f};
        const std::vector<double>& color = material.pbrMetallicRoughness.baseColorFactor;
        for (size_t i = 0; i < m.color.size() && i < color.size(); ++i)
            m.color[i] = float(color[i]);
        scene_.materials.push_back(std::move(m));
    }
}

void SceneBuilder::add_meshes() {
    for (size_t i = 0; i < model_.meshes.size(); ++i) {
        const tinygltf::Mesh& mesh = model_.meshes[i];
        scene_.meshes.push_back({mesh.name, {}});
        for (size_t k = 0; k < mesh.primitives.size(); ++k) add_primitive(mesh, i, k);
    }
}

void SceneBuilder::add_primitive(const tinygltf::Mesh& mesh, size_t mesh_index,
                                 size_t primitive_index) {
    const tinygltf::Primitive& primitive = mesh.primitives[primitive_index];
    const std::string place =
        "meshes/" + std::to_string(mesh_index) + "/primitives/" + std::to_string(primitive_index);
    TriangleMesh triangles =
        PrimitiveReader(primitive, accessors_, budget_, remarks_, place).read();
    if (triangles.triangles.empty()) return remarks_.add("primitive makes no triangles", place);
    Geometry geometry;
    geometry.name = mesh.name;
    if (mesh.primitives.size() > 1) geometry.name += "/" + std::to_string(primitive_index);
    geometry.material = primitive.material >= 0 ? uint32_t(primitive.material)
                                                : std::numeric_limits<uint32_t>::max();
    geometry.shapes = std::move(triangles);
    scene_.meshes[mesh_index].geometries.push_back(scene_.add_geometry(std::move(geometry)));
}

void SceneBuilder::add_nodes() {
    constexpr const char* instancing = "EXT_mesh_gpu_instancing";
    for (size_t i = 0; i < model_.nodes.size(); ++i) {
        const tinygltf::Node& in = model_.nodes[i];
        Node node;
        node.name = in.name;
        node.parent_from_node = local_transform(in);
        node.children.assign(in.children.begin(), in.children.end());
        if (in.mesh >= 0) node.mesh = uint32_t(in.mesh);
        const auto extension = in.extensions.find(instancing);
        if (extension != in.extensions.end()) {
            node.node_from_instance = instances(extension->second.Get("attributes"));
            if (node.node_from_instance.empty()) {
                remarks_.add("no instances: the mesh is not placed", "nodes/" + std::to_string(i));
                node.mesh.reset();
            }
        }
        scene_.nodes.push_back(std::move(node));
    }
}

std::vector<Transform> SceneBuilder::instances(const tinygltf::Value& attributes) {
    const auto accessor = [&](const std::string& name) {
        return attributes.Has(name) ? attributes.Get(name).GetNumberAsInt() : -1;
    };
    const int any = accessor(attributes.Keys().front());
    const size_t count = accessors_.count(any);
    budget_.spend(count, sizeof(Transform), accessor_place(any));
    const int t = accessor("TRANSLATION"), r = accessor("ROTATION"), s = accessor("SCALE");
    std::vector<Vec3f> translations(t < 0 ? count : 0, Vec3f::Zero());
    std::vector<Vec3f> scales(s < 0 ? count : 0, Vec3f::Ones());
    std::vector<Eigen::Vector4f> rotations(r < 0 ? count : 0, Eigen::Vector4f::Unit(3));
    if (t >= 0) translations = accessors_.vectors<3>(t);
    if (s >= 0) scales = accessors_.vectors<3>(s);
    if (r >= 0) rotations = accessors_.vectors<4>(r);
    std::vector<Transform> out(count);
    for (size_t i = 0; i < count; ++i)
        out[i] =
            composed(translations[i].cast<double>(),
                     Eigen::Quaterniond(rotations[i].cast<double>()), scales[i].cast<double>());
    return out;
}

/// The roots of the default scene, each once; without any scene, the nodes that are no child.
void SceneBuilder::add_roots() {
    std::vector<bool> is_taken(model_.nodes.size(), false);
    if (!model_.scenes.empty()) {
        for (int node : model_.scenes[size_t(std::max(model_.defaultScene, 0))].nodes) {
            if (is_taken[size_t(node)])
                remarks_.add("is named twice as a root of the scene",
                             "nodes/" + std::to_string(node));
            else
                scene_.roots.push_back(uint32_t(node));
            is_taken[size_t(node)] = true;
        }
        return;
    }
    if (!model_.nodes.empty()) remarks_.add("there are none; all root nodes are used", "scenes");
    for (const tinygltf::Node& node : model_.nodes)
        for (int child : node.children) is_taken[size_t(child)] = true;
    for (uint32_t i = 0; i < is_taken.size(); ++i)
        if (!is_taken[i]) scene_.roots.push_back(i);
}

/// Cameras of the nodes that the scene reaches. A node with several parents counts once, by the
/// path found first, so that shared nodes cannot multiply the work.
void SceneBuilder::add_cameras() {
    if (model_.cameras.empty()) return;
    std::vector<Transform> world_from_node(scene_.nodes.size());
    std::vector<bool> is_reached(scene_.nodes.size(), false);
    std::vector<uint32_t> queue;
    const auto reach = [&](uint32_t node, const Transform& world_from_parent) {
        if (is_reached[node]) return;
        is_reached[node] = true;
        world_from_node[node] = world_from_parent * scene_.nodes[node].parent_from_node;
        queue.push_back(node);
    };
    for (uint32_t root : scene_.roots) reach(root, Transform{});
    for (size_t done = 0; done < queue.size(); ++done) {
        const uint32_t node = queue[done];
        for (uint32_t child : scene_.nodes[node].children) reach(child, world_from_node[node]);
    }
    for (uint32_t i = 0; i < scene_.nodes.size(); ++i)
        if (is_reached[i] && model_.nodes[i].camera >= 0)
            add_camera(model_.cameras[size_t(model_.nodes[i].camera)], world_from_node[i],
                       "nodes/" + std::to_string(i));
}

void SceneBuilder::add_camera(const tinygltf::Camera& camera, const Transform& world_from_node,
                              const std::string& place) {
    if (camera.type != "perspective") return remarks_.add("orthographic camera is ignored", place);
    const Vec3d view = world_from_node.vector(-Vec3d::UnitZ()).stableNormalized();
    const Vec3d up = world_from_node.vector(Vec3d::UnitY()).stableNormalized();
    const bool is_usable = world_from_node.finite() && view.cross(up).squaredNorm() > 1e-12;
    if (!is_usable) return remarks_.add("camera with a singular transform is ignored", place);
    Camera out;
    out.eye = world_from_node.translation;
    out.at = out.eye + view;
    out.up = up;
    out.fov_y = camera.perspective.yfov;
    out.aspect = camera.perspective.aspectRatio;
    scene_.cameras.push_back(out);
}

// --- Assembly of the parts ------------------------------------------------------------------

uint64_t input_size(const tinygltf::Model& model) {
    uint64_t bytes = 0;
    for (const tinygltf::Buffer& buffer : model.buffers) bytes += buffer.data.size();
    return bytes;
}

Scene load(const std::string& path) {
    const std::filesystem::path file(path);
    gltf::Container container = gltf::read_container(path);
    Remarks remarks;
    const size_t text_size = container.json.size();
    const gltf::CheckedDocument document =
        gltf::check_document(container.json, !container.binary.empty(), remarks);
    container.json = std::string();
    BufferServer server{document.buffers, file.parent_path(), std::move(container.binary)};
    const tinygltf::Model model = parse_model(document.json, server);
    MemoryBudget budget(text_size + input_size(model));

    Scene scene = SceneBuilder(model, budget, remarks).build();
    scene.name = file.stem().string();
    scene.source = path;
    scene.warnings = std::move(container.warnings);
    for (std::string& line : remarks.lines()) scene.warnings.push_back(std::move(line));
    return scene;
}

/// What a terminal shows on one line.
std::string one_line(std::string text) {
    while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.pop_back();
    for (char& c : text)
        if (std::iscntrl(static_cast<unsigned char>(c))) c = ' ';
    return text;
}

}  // namespace

Scene load_gltf(const std::string& path) {
    try {
        return load(path);
    } catch (const std::bad_alloc&) {
        throw InputError(one_line(path + ": needs more memory than there is"));
    } catch (const std::exception& error) {
        throw InputError(one_line(path + ": " + error.what()));
    }
}

}  // namespace crofton
