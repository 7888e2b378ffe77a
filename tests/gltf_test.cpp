#include "scenegraph/gltf.h"

#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "framework/error.h"
#include "tests/catch.h"

namespace crofton {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using Bytes = std::vector<unsigned char>;

// --- Making files ---------------------------------------------------------------------------

/// A folder of its own for a test, removed at the end.
class TemporaryFolder {
  public:
    TemporaryFolder() {
        static int number = 0;
        path_ = fs::temp_directory_path() /
                ("crofton-gltf-test-" + std::to_string(getpid()) + "-" + std::to_string(number++));
        fs::create_directories(path_);
    }
    ~TemporaryFolder() { fs::remove_all(path_); }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;

    fs::path operator/(const std::string& name) const { return path_ / name; }
    const fs::path& path() const { return path_; }
    std::string write(const std::string& name, const std::string& content) const {
        fs::create_directories((path_ / name).parent_path());
        std::ofstream(path_ / name, std::ios::binary) << content;
        return (path_ / name).string();
    }

  private:
    fs::path path_;
};

template <typename T>
Bytes bytes_of(const std::vector<T>& values) {
    Bytes out(values.size() * sizeof(T));
    if (!out.empty()) std::memcpy(out.data(), values.data(), out.size());
    return out;
}

std::string base64(const Bytes& bytes) {
    static const char* alphabet =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    for (size_t i = 0; i < bytes.size(); i += 3) {
        uint32_t bits = 0;
        for (size_t k = 0; k < 3; ++k) bits = bits << 8 | (i + k < bytes.size() ? bytes[i + k] : 0);
        for (size_t k = 0; k < 4; ++k)
            out += i + k > bytes.size() ? '=' : alphabet[bits >> (18 - 6 * k) & 63];
    }
    return out;
}

void append_u32(std::string& out, uint32_t value) {
    for (int shift = 0; shift < 32; shift += 8) out += char(value >> shift & 255);
}

constexpr int kInt8 = 5120, kUint8 = 5121, kInt16 = 5122, kUint16 = 5123, kUint32 = 5125,
              kFloat = 5126;

/// A glTF document and the one buffer that it uses.
struct Asset {
    json document = {{"asset", {{"version", "2.0"}}}};
    Bytes buffer;

    int add(const char* array, json value) {
        document[array].push_back(std::move(value));
        return int(document[array].size()) - 1;
    }
    int add_view(const Bytes& bytes, int stride = 0) {
        buffer.resize((buffer.size() + 3) / 4 * 4);
        json view = {{"buffer", 0}, {"byteOffset", buffer.size()}, {"byteLength", bytes.size()}};
        if (stride) view["byteStride"] = stride;
        buffer.insert(buffer.end(), bytes.begin(), bytes.end());
        return add("bufferViews", view);
    }
    int add_accessor(int view, int component_type, size_t count, const char* type) {
        return add("accessors", {{"bufferView", view},
                                 {"componentType", component_type},
                                 {"count", count},
                                 {"type", type}});
    }
    int add_positions(const std::vector<float>& values) {
        return add_accessor(add_view(bytes_of(values)), kFloat, values.size() / 3, "VEC3");
    }
    template <typename T>
    int add_indices(const std::vector<T>& values) {
        const int type = sizeof(T) == 1 ? kUint8 : sizeof(T) == 2 ? kUint16 : kUint32;
        return add_accessor(add_view(bytes_of(values)), type, values.size(), "SCALAR");
    }
    int add_mesh(json primitive) {
        json mesh = {{"name", "mesh"}, {"primitives", json::array()}};
        mesh["primitives"].push_back(std::move(primitive));
        return add("meshes", mesh);
    }
    int add_node(json node) { return add("nodes", std::move(node)); }
    void set_scene(const std::vector<int>& roots) { add("scenes", {{"nodes", roots}}); }

    std::string text() {
        const std::string head = "data:application/octet-stream;base64,";
        if (!document.contains("buffers") && !buffer.empty())
            add("buffers", {{"byteLength", buffer.size()}, {"uri", head + base64(buffer)}});
        return document.dump();
    }
    std::string glb() {
        json with_buffer = document;
        with_buffer["buffers"].push_back({{"byteLength", buffer.size()}});
        std::string text = with_buffer.dump();
        text.resize((text.size() + 3) / 4 * 4, ' ');
        std::string binary(buffer.begin(), buffer.end());
        binary.resize((binary.size() + 3) / 4 * 4);
        std::string out = "glTF";
        append_u32(out, 2);
        append_u32(out, uint32_t(28 + text.size() + binary.size()));
        append_u32(out, uint32_t(text.size()));
        out += "JSON" + text;
        append_u32(out, uint32_t(binary.size()));
        out += std::string("BIN\0", 4) + binary;
        return out;
    }
};

const std::vector<float> kSquare = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};

/// A unit square of two triangles under one node: accessors 0 (positions) and 1 (indices).
Asset square() {
    Asset asset;
    const int positions = asset.add_positions(kSquare);
    const int indices = asset.add_indices<uint16_t>({0, 1, 2, 0, 2, 3});
    asset.add_mesh({{"attributes", {{"POSITION", positions}}}, {"indices", indices}});
    asset.add_node({{"mesh", 0}});
    asset.set_scene({0});
    return asset;
}

Scene load_text(const std::string& text, const std::string& name = "scene.gltf") {
    const TemporaryFolder folder;
    return load_gltf(folder.write(name, text));
}
Scene load(Asset asset) { return load_text(asset.text()); }

/// The message of the error, which must be one line that begins with the path; "" if none is
/// thrown.
std::string rejection_of_file(const std::string& path,
                              const std::function<Scene(const std::string&)>& loader = load_gltf) {
    try {
        loader(path);
    } catch (const InputError& error) {
        const std::string what = error.what();
        CHECK(what.starts_with(path));
        CHECK(what.find('\n') == std::string::npos);
        CHECK(what.size() < path.size() + 500);
        return what;
    }
    return "";
}
std::string rejection(const std::string& text, const std::string& name = "scene.gltf") {
    const TemporaryFolder folder;
    return rejection_of_file(folder.write(name, text));
}
std::string rejection(Asset asset) { return rejection(asset.text()); }

bool contains(const std::string& text, const std::string& part) {
    INFO("'" << text << "' should contain '" << part << "'");
    CHECK(text.find(part) != std::string::npos);
    return text.find(part) != std::string::npos;
}

const TriangleMesh& triangles(const Scene& scene, size_t geometry = 0) {
    REQUIRE(geometry < scene.geometries.size());
    return std::get<TriangleMesh>(scene.geometries[geometry].shapes);
}

using Corners = std::vector<std::array<uint32_t, 3>>;

// --- Features -------------------------------------------------------------------------------

TEST_CASE("gltf: a text file and a binary file give the same square") {
    for (const bool is_binary : {false, true}) {
        Asset asset = square();
        const Scene scene = is_binary ? load_text(asset.glb(), "scene.glb") : load(asset);
        CHECK(scene.name == "scene");
        CHECK(scene.roots == std::vector<uint32_t>{0});
        CHECK(scene.meshes.size() == 1);
        CHECK(scene.geometries.at(0).name == "mesh");
        CHECK(triangles(scene).positions.size() == 4);
        CHECK(triangles(scene).positions[2] == Vec3f(1, 1, 0));
        CHECK(triangles(scene).triangles == Corners{{0, 1, 2}, {0, 2, 3}});
        CHECK(scene.warnings.empty());
    }
}

TEST_CASE("gltf: indices of 8, 16 and 32 bits and no indices are read") {
    for (const int bits : {8, 16, 32, 0}) {
        Asset asset;
        const int positions = asset.add_positions({0, 0, 0, 1, 0, 0, 0, 1, 0});
        json primitive = {{"attributes", {{"POSITION", positions}}}};
        if (bits == 8) primitive["indices"] = asset.add_indices<uint8_t>({2, 0, 1});
        if (bits == 16) primitive["indices"] = asset.add_indices<uint16_t>({2, 0, 1});
        if (bits == 32) primitive["indices"] = asset.add_indices<uint32_t>({2, 0, 1});
        asset.add_mesh(primitive);
        asset.add_node({{"mesh", 0}});
        const Corners expected = bits ? Corners{{2, 0, 1}} : Corners{{0, 1, 2}};
        CHECK(triangles(load(asset)).triangles == expected);
    }
}

TEST_CASE("gltf: strips turn every second triangle and fans share their first corner") {
    Asset asset = square();
    asset.document["accessors"][1]["count"] = 5;
    json& primitive = asset.document["meshes"][0]["primitives"][0];
    primitive.erase("indices");
    primitive["mode"] = 5;
    CHECK(triangles(load(asset)).triangles == Corners{{0, 1, 2}, {1, 3, 2}});
    asset = square();
    asset.document["meshes"][0]["primitives"][0].erase("indices");
    asset.document["meshes"][0]["primitives"][0]["mode"] = 6;
    CHECK(triangles(load(asset)).triangles == Corners{{1, 2, 0}, {2, 3, 0}});
}

TEST_CASE("gltf: points and lines give a mesh without geometry and an unknown mode is refused") {
    for (const int mode : {0, 1, 2, 3}) {
        Asset asset = square();
        asset.document["meshes"][0]["primitives"][0]["mode"] = mode;
        const Scene scene = load(asset);
        CHECK(scene.meshes.size() == 1);
        CHECK(scene.geometries.empty());
        CHECK(scene.nodes.at(0).mesh == 0u);
    }
    Asset asset = square();
    asset.document["meshes"][0]["primitives"][0]["mode"] = 7;
    contains(rejection(asset), "meshes/0/primitives/0/mode");
}

TEST_CASE("gltf: an incomplete last triangle is dropped with a warning") {
    Asset asset = square();
    asset.document["accessors"][1]["count"] = 5;
    const Scene scene = load(asset);
    CHECK(triangles(scene).triangles.size() == 1);
    CHECK(scene.warnings.size() == 1);
}

TEST_CASE("gltf: interleaved positions honour the stride") {
    Asset asset;
    const int view =
        asset.add_view(bytes_of<float>({0, 0, 0, 9, 9, 9, 1, 0, 0, 9, 9, 9, 0, 1, 0, 9, 9, 9}), 24);
    asset.add_accessor(view, kFloat, 3, "VEC3");
    asset.add_mesh({{"attributes", {{"POSITION", 0}}}});
    CHECK(triangles(load(asset)).positions[2] == Vec3f(0, 1, 0));
    asset.document["bufferViews"][0]["byteStride"] = 8;
    contains(rejection(asset), "byteStride");
}

TEST_CASE("gltf: sparse accessors replace elements of a base or of zeros") {
    for (const bool has_base : {true, false}) {
        Asset asset = square();
        const int indices = asset.add_view(bytes_of<uint8_t>({1, 3}));
        const int values = asset.add_view(bytes_of<float>({5, 0, 0, 0, 6, 0}));
        json& accessor = asset.document["accessors"][0];
        if (!has_base) accessor.erase("bufferView");
        accessor["sparse"] = {{"count", 2},
                              {"indices", {{"bufferView", indices}, {"componentType", kUint8}}},
                              {"values", {{"bufferView", values}}}};
        const Scene scene = load(asset);
        CHECK(triangles(scene).positions[1] == Vec3f(5, 0, 0));
        CHECK(triangles(scene).positions[2] == (has_base ? Vec3f(1, 1, 0) : Vec3f(0, 0, 0)));
        CHECK(triangles(scene).positions[3] == Vec3f(0, 6, 0));
        asset.document["meshes"][0]["primitives"][0].erase("indices");
        accessor["count"] = 3;
        contains(rejection(asset), "accessors/0/sparse");
    }
}

TEST_CASE("gltf: an accessor without a buffer view is zero but cannot fill the memory") {
    Asset asset = square();
    asset.document["accessors"][0].erase("bufferView");
    CHECK(triangles(load(asset)).positions[2] == Vec3f(0, 0, 0));
    asset = square();
    asset.document["accessors"][1].erase("bufferView");
    CHECK(triangles(load(asset)).triangles == Corners{{0, 0, 0}, {0, 0, 0}});

    // Few of many declared vertices are made if few are used.
    asset = square();
    asset.document["accessors"][0].erase("bufferView");
    asset.document["accessors"][0]["count"] = 4000000000u;
    CHECK(triangles(load(asset)).positions.size() == 4);
    asset.document["meshes"][0]["primitives"][0].erase("indices");
    contains(rejection(asset), "out of proportion");
}

TEST_CASE("gltf: only the used part of a large shared vertex array is kept") {
    Asset asset;
    std::vector<float> positions(300);
    for (size_t i = 0; i < positions.size(); ++i) positions[i] = float(i);
    asset.add_positions(positions);
    asset.add_indices<uint16_t>({90, 10, 50});
    asset.add_mesh({{"attributes", {{"POSITION", 0}}}, {"indices", 1}});
    const Scene scene = load(asset);
    CHECK(triangles(scene).triangles == Corners{{2, 0, 1}});
    CHECK(triangles(scene).positions.size() == 3);
    CHECK(triangles(scene).positions[2] == Vec3f(270, 271, 272));
}

TEST_CASE("gltf: quantised positions are scaled if normalised and kept if not") {
    for (const bool is_normalized : {true, false}) {
        Asset asset;
        const int view =
            asset.add_view(bytes_of<int8_t>({127, 0, -128, 0, 0, 127, 0, 0, 0, 0, -127, 0}), 4);
        asset.add_accessor(view, kInt8, 3, "VEC3");
        asset.document["accessors"][0]["normalized"] = is_normalized;
        asset.document["extensionsUsed"] = {"KHR_mesh_quantization"};
        asset.document["extensionsRequired"] = {"KHR_mesh_quantization"};
        asset.add_mesh({{"attributes", {{"POSITION", 0}}}});
        const Scene scene = load(asset);
        CHECK(scene.warnings.empty());
        CHECK(triangles(scene).positions[0] ==
              (is_normalized ? Vec3f(1, 0, -1) : Vec3f(127, 0, -128)));
    }
    Asset asset;
    asset.add_accessor(asset.add_view(bytes_of<uint16_t>(std::vector<uint16_t>(12, 65535)), 8),
                       kUint16, 3, "VEC3");
    asset.document["accessors"][0]["normalized"] = true;
    asset.add_mesh({{"attributes", {{"POSITION", 0}}}});
    CHECK(triangles(load(asset)).positions[1] == Vec3f(1, 1, 1));
}

TEST_CASE("gltf: a node composes translation, rotation and scale, or takes its matrix") {
    const double half = std::sqrt(0.5);
    Asset asset = square();
    asset.document["nodes"][0].update(
        json{{"translation", {1, 2, 3}}, {"rotation", {0, 0, half, half}}, {"scale", {2, 3, 4}}});
    const Transform t = load(asset).nodes[0].parent_from_node;
    CHECK((t.point(Vec3d(1, 1, 1)) - Vec3d(-2, 4, 7)).norm() < 1e-12);

    asset = square();
    asset.document["nodes"][0]["matrix"] = {1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0, 10, 11, 12, 1};
    const Transform m = load(asset).nodes[0].parent_from_node;
    CHECK(m.point(Vec3d(1, 0, 0)) == Vec3d(11, 13, 15));
    asset.document["nodes"][0]["matrix"].erase(15);
    contains(rejection(asset), "nodes/0/matrix");
}

TEST_CASE("gltf: instancing attributes give one placement per entry") {
    Asset asset = square();
    const int t = asset.add_positions({1, 0, 0, 2, 0, 0});
    const int s = asset.add_positions({1, 1, 1, 2, 2, 2});
    const int r = asset.add_accessor(
        asset.add_view(bytes_of<int16_t>({0, 0, 0, 32767, 0, 0, 32767, 0})), kInt16, 2, "VEC4");
    asset.document["accessors"][size_t(r)]["normalized"] = true;
    json& attributes =
        asset.document["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
    attributes = {{"TRANSLATION", t}, {"SCALE", s}, {"ROTATION", r}};
    asset.document["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
    const Scene scene = load(asset);
    REQUIRE(scene.nodes[0].node_from_instance.size() == 2);
    CHECK(scene.nodes[0].node_from_instance[0].point(Vec3d(1, 1, 0)) == Vec3d(2, 1, 0));
    CHECK(scene.nodes[0].node_from_instance[1].point(Vec3d(1, 1, 0)) == Vec3d(0, -2, 0));
    const SceneStatistics counts = statistics(scene);
    CHECK(counts.mesh_instances == 2);
    CHECK(counts.triangles_instanced == 4);
    attributes["SCALE"] = 0;
    contains(rejection(asset), "nodes/0/extensions/EXT_mesh_gpu_instancing");
}

TEST_CASE("gltf: perspective cameras come in world space and orthographic ones with a warning") {
    Asset asset = square();
    asset.add("cameras", {{"type", "perspective"},
                          {"perspective", {{"yfov", 0.5}, {"aspectRatio", 2}, {"znear", 0.1}}}});
    asset.add("cameras", {{"type", "orthographic"}, {"orthographic", json::object()}});
    asset.add_node({{"camera", 0}, {"rotation", {0, 1, 0, 0}}, {"scale", {3, 3, 3}}});
    asset.add_node({{"camera", 1}});
    asset.document["nodes"][0].update(json{{"children", {1, 2}}, {"translation", {0, 0, 7}}});
    const Scene scene = load(asset);
    REQUIRE(scene.cameras.size() == 1);
    CHECK(scene.cameras[0].eye == Vec3d(0, 0, 7));
    CHECK(scene.cameras[0].at == Vec3d(0, 0, 8));
    CHECK(scene.cameras[0].up == Vec3d(0, 1, 0));
    CHECK(scene.cameras[0].fov_y == 0.5);
    CHECK(scene.cameras[0].aspect == 2.0);
    CHECK(scene.warnings.size() == 1);
}

TEST_CASE("gltf: materials give their base colour and primitives name them") {
    Asset asset = square();
    asset.add("materials", {{"name", "plain"}});
    asset.add("materials", {{"pbrMetallicRoughness", {{"baseColorFactor", {0.25, 0.5, 0.75, 1}}}}});
    json& primitives = asset.document["meshes"][0]["primitives"];
    primitives.push_back(primitives[0]);
    primitives[1]["material"] = 1;
    const Scene scene = load(asset);
    REQUIRE(scene.geometries.size() == 2);
    CHECK(scene.materials.at(0).name == "plain");
    CHECK(scene.materials.at(1).color == std::array<float, 3>{0.25f, 0.5f, 0.75f});
    CHECK(scene.geometries[0].name == "mesh/0");
    CHECK(scene.geometries[0].material >= scene.materials.size());
    CHECK(scene.geometries[1].name == "mesh/1");
    CHECK(scene.geometries[1].material == 1);
    primitives[1]["material"] = 2;
    contains(rejection(asset), "meshes/0/primitives/1/material");
}

TEST_CASE("gltf: roots come from the named scene, the first scene or the graph") {
    Asset asset = square();
    asset.add_node({{"children", {0}}});
    asset.add_node({{"mesh", 0}});
    asset.set_scene({2});
    CHECK(load(asset).roots == std::vector<uint32_t>{0});
    asset.document["scene"] = 1;
    CHECK(load(asset).roots == std::vector<uint32_t>{2});
    asset.document.erase("scene");
    asset.document.erase("scenes");
    CHECK(load(asset).roots == std::vector<uint32_t>{1, 2});
}

TEST_CASE("gltf: a node with two parents is placed twice") {
    Asset asset = square();
    asset.add_node({{"children", {0}}, {"translation", {2, 0, 0}}});
    asset.add_node({{"children", {0}}, {"translation", {-2, 0, 0}}});
    asset.document["scenes"][0]["nodes"] = {1, 2};
    const SceneStatistics counts = statistics(load(asset));
    CHECK(counts.mesh_instances == 2);
    CHECK(counts.bounds_min == Vec3d(-2, 0, 0));
    CHECK(counts.bounds_max == Vec3d(3, 1, 0));
}

TEST_CASE("gltf: chains of 30,000 nodes do not recurse") {
    Asset asset = square();
    const int count = 30000;
    for (int i = 1; i < count; ++i)
        asset.add_node({{"children", {i - 1}}, {"translation", {1, 0, 0}}});
    asset.document["scenes"][0]["nodes"] = {count - 1};
    const SceneStatistics counts = statistics(load(asset));
    CHECK(counts.depth == uint64_t(count));
    CHECK(counts.bounds_max == Vec3d(count, 1, 0));
}

TEST_CASE("gltf: shared nodes with a camera do not multiply the work") {
    Asset asset = square();
    asset.document["nodes"] = json::array();
    asset.add("cameras", {{"type", "perspective"}, {"perspective", {{"yfov", 1}, {"znear", 1}}}});
    asset.add_node({{"camera", 0}});
    for (int i = 0; i < 200; ++i) asset.add_node({{"children", {i, i}}});
    asset.document["scenes"][0]["nodes"] = {200};
    CHECK(load(asset).cameras.size() == 1);
}

// --- Buffers --------------------------------------------------------------------------------

/// The square with its buffer in a file named by `uri`.
std::string external_square(const TemporaryFolder& folder, const std::string& uri) {
    Asset asset = square();
    asset.add("buffers", {{"byteLength", asset.buffer.size()}, {"uri", uri}});
    return folder.write("inner/scene.gltf", asset.text());
}

std::string square_bytes() {
    const Asset asset = square();
    return std::string(asset.buffer.begin(), asset.buffer.end());
}

TEST_CASE("gltf: external buffers are read from the scene's folder and below") {
    const TemporaryFolder folder;
    folder.write("inner/plain.bin", square_bytes());
    folder.write("inner/my data/one#two%.bin", square_bytes() + "more");
    for (const char* uri :
         {"plain.bin", "./plain.bin", "my%20data/one%23two%.bin", "my data/one#two%25.bin"})
        CHECK(triangles(load_gltf(external_square(folder, uri))).positions.size() == 4);
}

TEST_CASE("gltf: buffers outside of the scene's folder are refused") {
    const TemporaryFolder folder;
    const std::string outside = folder.write("outside.bin", square_bytes());
    folder.write("inner2/outside.bin", square_bytes());
    folder.write("inner/inside.bin", square_bytes());
    fs::create_symlink(outside, folder / "inner/link.bin");
    fs::create_directory_symlink(folder.path(), folder / "inner/up");
    fs::create_symlink("inside.bin", folder / "inner/harmless.bin");
    for (const std::string& uri :
         {std::string("../outside.bin"), std::string("%2e%2e/outside.bin"),
          std::string("..%2Foutside.bin"), std::string("a/../../outside.bin"),
          std::string("../inner2/outside.bin"), std::string("..\\outside.bin"), outside,
          "file://" + outside, std::string("http://localhost/a.bin"), std::string("link.bin"),
          std::string("up/outside.bin"), std::string("inside.bin%00.txt"), std::string("")}) {
        INFO(uri);
        contains(rejection_of_file(external_square(folder, uri)), "buffers/0");
    }
    CHECK(triangles(load_gltf(external_square(folder, "harmless.bin"))).positions.size() == 4);
}

TEST_CASE("gltf: missing, short and irregular buffer files are refused") {
    const TemporaryFolder folder;
    folder.write("inner/short.bin", square_bytes().substr(1));
    fs::create_directory(folder / "inner/folder.bin");
    contains(rejection_of_file(external_square(folder, "missing.bin")), "no such file");
    contains(rejection_of_file(external_square(folder, "short.bin")), "bytes");
    contains(rejection_of_file(external_square(folder, "folder.bin")), "not a regular file");
}

TEST_CASE("gltf: data URIs must be clean base64") {
    const std::string good = base64(square().buffer);
    const auto with_uri = [](const std::string& uri) {
        Asset asset = square();
        asset.add("buffers", {{"byteLength", asset.buffer.size()}, {"uri", uri}});
        return asset;
    };
    for (const char* head : {"data:application/octet-stream;base64,", "data:;base64,",
                             "DATA:application/gltf-buffer;base64,", "data:a/b;charset=x;base64,"})
        CHECK(triangles(load(with_uri(head + good))).positions.size() == 4);
    const std::string head = "data:application/octet-stream;base64,";
    contains(rejection(with_uri("data:application/octet-stream," + good)), "not base64");
    contains(rejection(with_uri(head + "!" + good.substr(1))), "illegal character");
    contains(rejection(with_uri(head + "=" + good.substr(1))), "illegal character");
    contains(rejection(with_uri(head + good.substr(4))), "byteLength");
    contains(rejection(with_uri(head + good + "A")), "length");
    contains(rejection(with_uri(head + good + "A===")), "base64");
    contains(rejection(with_uri(head)), "byteLength");
}

TEST_CASE("gltf: files that only images or animations use are not opened") {
    Asset asset = square();
    asset.text();
    asset.add("buffers", {{"byteLength", 1000}, {"uri", "absent.bin"}});
    asset.add("bufferViews", {{"buffer", 1}, {"byteLength", 1000}});
    asset.add("images", {{"uri", "absent.png"}});
    asset.add("images", {{"bufferView", 2}, {"mimeType", "image/png"}});
    asset.add("textures", {{"source", 0}});
    CHECK(triangles(load(asset)).positions.size() == 4);
}

// --- Traps ----------------------------------------------------------------------------------

TEST_CASE("gltf: a GLB with wrong sizes is refused wherever it is cut") {
    Asset asset = square();
    const std::string good = asset.glb();
    for (size_t size = 0; size < good.size(); size += 3)
        CHECK(rejection(good.substr(0, size), "scene.glb") != "");
    // Each of the header's and the chunk headers' words is replaced by large and small numbers.
    const size_t bin_header = 20 + (uint8_t(good[12]) | size_t(uint8_t(good[13])) << 8);
    for (const size_t word :
         {size_t(0), size_t(4), size_t(8), size_t(12), size_t(16), bin_header}) {
        for (const uint32_t value : {0xFFFFFFFFu, 0x7FFFFFFFu, uint32_t(good.size())}) {
            std::string bad = good;
            for (size_t i = 0; i < 4; ++i) bad[word + i] = char(value >> (8 * i) & 255);
            INFO(word << " " << value);
            if (bad != good) CHECK(rejection(bad, "scene.glb") != "");
        }
    }
}

TEST_CASE("gltf: text that is not a JSON object is refused") {
    for (const std::string& text :
         {std::string(), std::string("[]"), std::string("1"), std::string("{"),
          std::string("{\"asset\": {\"version\": \"2.0\"}, \"extras\": NaN}"),
          std::string("{\"asset\": {\"version\": \"2.0\"}} trailing"), std::string("\xFF\xFE{}"),
          std::string("{\"asset\": {\"version\": \"2.0\"}, \"extras\": \"\xC3\x28\"}"),
          std::string("{\"asset\":\n\n{\"version\": 2}}"), std::string("{\"nodes\": []}")})
        CHECK(rejection(text) != "");
    CHECK(load_text("\xEF\xBB\xBF{\"asset\": {\"version\": \"2.0\"}}").nodes.empty());
}

TEST_CASE("gltf: deep JSON nesting is refused before it can exhaust the stack") {
    const std::string head = "{\"asset\": {\"version\": \"2.0\"}, \"extras\": ";
    const auto nested = [&](size_t depth, char open, char close) {
        return head + std::string(depth, open) + std::string(depth, close) + "}";
    };
    CHECK(load_text(nested(200, '[', ']')).nodes.empty());
    contains(rejection(nested(1000000, '[', ']')), "nests deeper");
    contains(rejection(head + std::string(1000000, '[')), "nests deeper");
    std::string objects = head;
    for (int i = 0; i < 1000; ++i) objects += "{\"a\":";
    contains(rejection(objects), "nests deeper");
    CHECK(load_text(head + "\"" + std::string(1000, '[') + "\\\"[\"}").nodes.empty());
}

TEST_CASE("gltf: versions other than 2 are refused") {
    for (const json& version : {json("1.0"), json("3.0"), json("2"), json(2.0), json(nullptr),
                                json("x"), json("2.0.0"), json("99999999999999999999.0")}) {
        Asset asset = square();
        asset.document["asset"]["version"] = version;
        contains(rejection(asset), "asset/version");
    }
    Asset asset = square();
    asset.document["asset"]["minVersion"] = "2.1";
    contains(rejection(asset), "asset/minVersion");
}

TEST_CASE("gltf: required extensions that change the geometry are refused by name") {
    for (const char* name : {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_new"}) {
        Asset asset = square();
        asset.document["extensionsRequired"] = {name};
        contains(rejection(asset), name);
    }
    Asset asset = square();
    asset.document["extensionsRequired"] = {"KHR_materials_unlit"};
    CHECK(load(asset).geometries.size() == 1);
}

TEST_CASE("gltf: cycles of nodes are refused") {
    Asset asset = square();
    asset.document["nodes"][0]["children"] = {0};
    contains(rejection(asset), "nodes/0");
    asset.document["nodes"][0]["children"] = {1};
    asset.add_node({{"children", {2}}});
    asset.add_node({{"children", {0}}});
    asset.document["scenes"][0]["nodes"] = json::array();
    contains(rejection(asset), "cycle");
}

/// Sets the value at a JSON pointer of the square's document.
std::string rejection_with(const std::string& pointer, const json& value) {
    Asset asset = square();
    asset.text();
    asset.document[json::json_pointer(pointer)] = value;
    return rejection(asset);
}

TEST_CASE("gltf: values of a wrong type or out of range are refused with their place") {
    const std::vector<std::string> integers = {"/scene",
                                               "/scenes/0/nodes/0",
                                               "/nodes/0/mesh",
                                               "/nodes/0/camera",
                                               "/nodes/0/children/0",
                                               "/meshes/0/primitives/0/attributes/POSITION",
                                               "/meshes/0/primitives/0/indices",
                                               "/meshes/0/primitives/0/material",
                                               "/meshes/0/primitives/0/mode",
                                               "/accessors/0/bufferView",
                                               "/accessors/0/byteOffset",
                                               "/accessors/0/componentType",
                                               "/accessors/0/count",
                                               "/bufferViews/0/buffer",
                                               "/bufferViews/0/byteOffset",
                                               "/bufferViews/0/byteLength",
                                               "/bufferViews/0/byteStride",
                                               "/buffers/0/byteLength"};
    const json wrong = {
        "0",  nullptr, json::array(),       json::object(),        true,       -1, 0.5,
        1e30, -1e30,   9223372036854775807, 18446744073709551615u, 4294967296u};
    for (const std::string& pointer : integers) {
        for (const json& value : wrong) {
            INFO(pointer << " = " << value);
            // Some huge lengths are refused where they are first used.
            CHECK(rejection_with(pointer, value) != "");
        }
        contains(rejection_with(pointer, "0"), pointer.substr(1));
    }
    for (const char* pointer : {"/asset",
                                "/scenes",
                                "/nodes",
                                "/meshes",
                                "/accessors",
                                "/bufferViews",
                                "/buffers",
                                "/extensionsRequired",
                                "/scenes/0",
                                "/nodes/0",
                                "/meshes/0",
                                "/accessors/0",
                                "/meshes/0/primitives",
                                "/meshes/0/primitives/0",
                                "/nodes/0/matrix",
                                "/nodes/0/rotation",
                                "/accessors/0/type",
                                "/accessors/0/normalized",
                                "/accessors/0/sparse",
                                "/nodes/0/name",
                                "/buffers/0/uri",
                                "/nodes/0/extensions"})
        for (const json& value : {json(3), json(nullptr)})
            contains(rejection_with(pointer, value), std::string(pointer).substr(1));
    contains(rejection_with("/nodes/0/scale", {1, "2", 3}), "nodes/0/scale/1");
    // Also where the loader does not look.
    contains(rejection_with("/scenes/0/name", 42), "scenes/0/name");
    contains(rejection_with("/materials/0/normalTexture/scale", "x"), "normalTexture/scale");
}

TEST_CASE("gltf: integers written with a fraction of zero are accepted") {
    Asset asset = square();
    asset.document["accessors"][0]["count"] = 4.0;
    asset.document["nodes"][0]["mesh"] = 0.0;
    CHECK(triangles(load(asset)).positions.size() == 4);
}

TEST_CASE("gltf: accessors must fit in their views and views in their buffers") {
    contains(rejection_with("/accessors/0/count", 5), "accessors/0");
    contains(rejection_with("/accessors/0/byteOffset", 1), "accessors/0");
    contains(rejection_with("/accessors/0/byteOffset", 9223372036854775807), "accessors/0");
    contains(rejection_with("/accessors/0/count", 4294967295u), "accessors/0");
    contains(rejection_with("/bufferViews/1/byteLength", 13), "bufferViews/1");
    contains(rejection_with("/bufferViews/1/byteOffset", 9223372036854775807), "bufferViews/1");
    contains(rejection_with("/buffers/0/byteLength", 61), "buffers/0");
    contains(rejection_with("/accessors/0/type", "VEC2"), "accessors/0");
    contains(rejection_with("/accessors/1/componentType", kFloat), "accessors/1");
    contains(rejection_with("/accessors/0/componentType", kUint32), "accessors/0");
}

TEST_CASE("gltf: an index beyond the vertices is refused, a restart value in range is an index") {
    Asset asset = square();
    asset.document["accessors"][0]["count"] = 3;
    contains(rejection(asset), "meshes/0/primitives/0");

    Asset full;
    full.add_positions(std::vector<float>(256 * 3, 1.0f));
    full.add_indices<uint8_t>({0, 1, 255});
    full.add_mesh({{"attributes", {{"POSITION", 0}}}, {"indices", 1}});
    CHECK(triangles(load(full)).triangles.size() == 1);
}

TEST_CASE("gltf: many primitives over the same data cannot fill the memory") {
    // 16 bytes a vertex would make 144 MB out of 200 kB.
    Asset asset;
    asset.add_positions(std::vector<float>(3 * 3000, 1.0f));
    json primitives = json::array();
    for (int i = 0; i < 3000; ++i) primitives.push_back({{"attributes", {{"POSITION", 0}}}});
    asset.add("meshes", {{"primitives", primitives}});
    contains(rejection(asset.glb(), "scene.glb"), "out of proportion");
}

TEST_CASE("gltf: random damage never does worse than an InputError") {
    Asset asset = square();
    const std::string good = asset.glb();
    const TemporaryFolder folder;
    uint32_t random = 12345;
    const auto next = [&] { return random = random * 1664525u + 1013904223u; };
    for (int round = 0; round < 1000; ++round) {
        std::string bad = good;
        for (int i = 0; i < 3; ++i) bad[(next() >> 8) % bad.size()] = char(next() >> 24);
        rejection_of_file(folder.write("scene.glb", bad));
    }
    SUCCEED();
}

// --- The shared scenes ----------------------------------------------------------------------

fs::path shared_scenes() { return fs::path(CROFTON_SOURCE_DIR) / "../shared/scenes"; }

bool has_shared_scenes() {
    if (fs::exists(shared_scenes())) return true;
    WARN("skipped: ../shared is absent");
    return false;
}

/// Compares a corner of the bounds; null stands for a coordinate that no vertex gives.
void check_bound(const json& expected, const Vec3d& actual, double tolerance) {
    for (int axis = 0; axis < 3; ++axis)
        if (!expected[size_t(axis)].is_null())
            CHECK(std::abs(actual[axis] - expected[size_t(axis)].get<double>()) <= tolerance);
}

void check_statistics(const json& expected, const SceneStatistics& actual) {
    CHECK(actual.triangles_unique == expected["triangles_unique"]);
    CHECK(actual.triangles_instanced == expected["triangles_instanced"]);
    CHECK(actual.mesh_instances == expected["mesh_instances"]);
    CHECK(actual.depth == expected["depth"]);
    CHECK(actual.zero_area_triangles_object_space == expected["zero_area_triangles_object_space"]);
    CHECK(actual.mirrored_instances == expected["mirrored_instances"]);
    if (expected["bounds_min"][0].is_null()) {
        CHECK(!(actual.bounds_min.array() <= actual.bounds_max.array()).all());
        return;
    }
    // Relative to the largest coordinate: positions are floats in the files.
    double magnitude = 0;
    for (const char* key : {"bounds_min", "bounds_max"})
        for (const json& x : expected[key])
            magnitude = std::max(magnitude, std::abs(x.get<double>()));
    check_bound(expected["bounds_min"], actual.bounds_min, 1e-5 * magnitude);
    check_bound(expected["bounds_max"], actual.bounds_max, 1e-5 * magnitude);
}

void check_manifest_case(const json& entry, const fs::path& folder) {
    const std::string path = (folder / entry["file"].get<std::string>()).string();
    const std::string expect = entry["expect"];
    INFO(path << ": " << entry["note"]);
    const auto start = std::chrono::steady_clock::now();
    std::string rejected = rejection_of_file(path, [&](const std::string& file) {
        const Scene scene = load_scene(file);
        const SceneStatistics counts = statistics(scene);
        CHECK(expect != "reject");
        if (entry.contains("if_loaded") && !entry["if_loaded"].is_null())
            check_statistics(entry["if_loaded"], counts);
        return scene;
    });
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    INFO(rejected);
    if (expect == "ok") CHECK(rejected == "");
    if (expect == "reject") CHECK(rejected != "");
    CHECK(seconds.count() < 2.0);
}

TEST_CASE("gltf: every file of the edge manifests loads or is refused as its entry says") {
    if (!has_shared_scenes()) return;
    const fs::path edge = shared_scenes() / "edge";
    for (const auto& [manifest, folder] : {std::pair("crafted/MANIFEST.json", "crafted"),
                                           std::pair("MANIFEST-third-party.json", "")}) {
        std::ifstream stream(edge / manifest);
        const json entries = json::parse(stream);
        REQUIRE(entries.size() > 50);
        for (const json& entry : entries) check_manifest_case(entry, edge / folder);
    }
}

struct ExpectedScene {
    const char* file;
    uint64_t unique, instanced, mesh_instances, depth;
};

// The table of ../shared/scenes/README.md.
constexpr ExpectedScene kScenes[] = {
    {"gltf/2CylinderEngine.glb", 75730, 121496, 67, 6},
    {"gltf/CesiumMilkTruck.glb", 2856, 3624, 3, 4},
    {"gltf/R250-receiver.glb", 64223, 64223, 37, 8},
    {"gltf/retroufo.glb", 16428, 16428, 77, 7},
    {"gltf/viva-balloon.glb", 35698, 35698, 37, 3},
    {"gltf/pine-tree.glb", 1650, 1650, 2, 5},
    {"gltf/low-poly-jungle.glb", 18515, 18515, 16, 1},
    {"gltf/dutch-ship-medium.glb", 69162, 69162, 3, 1},
    {"gltf/zdm2-map.glb", 58772, 58772, 1, 1},
    {"gltf/FlightHelmet.glb", 94722, 94722, 6, 1},
    {"gltf/ToyCar.glb", 108936, 108936, 3, 1},
    {"gltf/MetalRoughSpheresNoTextures.glb", 1040409, 1040409, 102, 3},
    {"gltf/subpass-scene-opaque.glb", 11132, 23388, 70, 1},
    {"gltf/chess-board.glb", 178848, 178848, 8, 3},
    {"gltf/dream-apartment.glb", 177934, 177934, 1, 1},
    {"gltf/grey-white-room.glb", 143163, 143163, 65, 3},
    {"gltf/coffee-maker.glb", 235271, 235271, 23, 3},
    {"gltf/FZK-Haus.glb", 32588, 35906, 110, 8},
    {"gltf-features/Box.glb", 12, 12, 1, 2},
    {"gltf-features/BoxInterleaved.glb", 12, 12, 1, 2},
    {"gltf-features/BoxVertexColors.glb", 12, 12, 1, 1},
    {"gltf-features/SimpleInstancing.glb", 12, 1500, 125, 1},
    {"gltf-features/NegativeScaleTest.glb", 3884, 7724, 11, 2},
    {"gltf-features/RecursiveSkeletons.glb", 76, 6384, 84, 30},
    {"gltf-features/AnimatedMorphCube-Quantized/AnimatedMorphCube.gltf", 12, 12, 1, 2},
    {"gltf-features/Lantern.glb", 5394, 5394, 3, 2},
    {"gltf-features/Lantern-Quantized.glb", 5394, 5394, 1, 1},
    {"gltf-features/MultipleScenes/MultipleScenes.gltf", 3, 2, 1, 1},
    {"gltf-features/SimpleMeshes/SimpleMeshes.gltf", 1, 2, 2, 1},
    {"gltf-features/SimpleSparseAccessor/SimpleSparseAccessor.gltf", 12, 12, 1, 1},
    {"gltf-features/TriangleWithoutIndices/TriangleWithoutIndices.gltf", 1, 1, 1, 1},
    {"gltf-features/MeshPrimitiveModes/MeshPrimitiveModes.gltf", 16, 16, 7, 1},
    {"gltf-features/Box-With-Spaces/Box With Spaces.gltf", 12, 12, 1, 1},
};

TEST_CASE("gltf: the shared scenes have the triangles, instances and depth of their table") {
    if (!has_shared_scenes()) return;
    for (const ExpectedScene& expected : kScenes) {
        INFO(expected.file);
        const Scene scene = load_scene((shared_scenes() / expected.file).string());
        const SceneStatistics counts = statistics(scene);
        CHECK(counts.triangles_unique == expected.unique);
        CHECK(counts.triangles_instanced == expected.instanced);
        CHECK(counts.mesh_instances == expected.mesh_instances);
        CHECK(counts.depth == expected.depth);
    }
}

TEST_CASE("gltf: compressed scenes are refused with the name of the compression") {
    if (!has_shared_scenes()) return;
    const fs::path folder = shared_scenes() / "gltf-features";
    contains(rejection_of_file((folder / "Lantern-Draco.glb").string()),
             "KHR_draco_mesh_compression");
    contains(rejection_of_file((folder / "BoxMeshopt.glb").string()), "EXT_meshopt_compression");
}

}  // namespace
}  // namespace crofton
