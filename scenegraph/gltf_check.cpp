#include "scenegraph/gltf_check.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "framework/error.h"
#include "scenegraph/gltf_container.h"
#include "scenegraph/gltf_types.h"

namespace crofton::gltf {
namespace {

using nlohmann::json;

constexpr int nesting_limit = 256;
const std::string buffer_prefix = "buffer-";
/// The parser keeps indices and sparse offsets in int.
constexpr uint64_t int_limit = std::numeric_limits<int>::max();

[[noreturn]] void fail(const std::string& place, const std::string& what) {
    throw InputError(place.empty() ? what : place + ": " + what);
}

std::string join(const std::string& place, const std::string& key) {
    return place.empty() ? key : place + "/" + key;
}
std::string join(const std::string& place, size_t index) {
    return place + "/" + std::to_string(index);
}

// --- Typed access ---------------------------------------------------------------------------

const json* find(const json& object, const std::string& key) {
    const auto it = object.find(key);
    return it == object.end() ? nullptr : &*it;
}

const json& require(const json& object, const std::string& key, const std::string& place) {
    const json* value = find(object, key);
    if (!value) fail(place, "'" + key + "' is missing");
    return *value;
}

void expect(bool is_right, const char* type, const json& value, const std::string& place) {
    if (!is_right) fail(place, std::string("must be ") + type + ", not " + value.type_name());
}

const json& object_value(const json& value, const std::string& place) {
    expect(value.is_object(), "an object", value, place);
    return value;
}

const json& array_value(const json& value, const std::string& place) {
    expect(value.is_array(), "an array", value, place);
    return value;
}

/// A member that is an object, or an empty one if it is absent.
const json& object_member(const json& object, const std::string& key, const std::string& place) {
    static const json none = json::object();
    const json* value = find(object, key);
    return value ? object_value(*value, join(place, key)) : none;
}

const json& array_member(const json& object, const std::string& key, const std::string& place) {
    static const json none = json::array();
    const json* value = find(object, key);
    return value ? array_value(*value, join(place, key)) : none;
}

std::string string_value(const json& value, const std::string& place) {
    expect(value.is_string(), "a string", value, place);
    return value.get<std::string>();
}

std::string string_member(const json& object, const std::string& key, const std::string& place) {
    const json* value = find(object, key);
    return value ? string_value(*value, join(place, key)) : std::string();
}

double number_value(const json& value, const std::string& place) {
    expect(value.is_number(), "a number", value, place);
    return value.get<double>();
}

/// A whole number in [0, limit]; 3.0 counts as 3.
uint64_t whole_value(const json& value, const std::string& place,
                     uint64_t limit = std::numeric_limits<int64_t>::max()) {
    expect(value.is_number(), "an integer", value, place);
    constexpr double exact_limit = 9007199254740992.0;
    const double real = value.get<double>();
    uint64_t whole = 0;
    if (value.is_number_unsigned())
        whole = value.get<uint64_t>();
    else if (real >= 0 && real <= exact_limit && real == std::floor(real))
        whole = uint64_t(real);
    else
        fail(place, value.dump() + " is not an integer of 0 or more");
    if (whole > limit) fail(place, value.dump() + " is too large");
    return whole;
}

uint64_t whole_member(const json& object, const std::string& key, const std::string& place,
                      uint64_t fallback, uint64_t limit = std::numeric_limits<int64_t>::max()) {
    const json* value = find(object, key);
    return value ? whole_value(*value, join(place, key), limit) : fallback;
}

/// An index into an array of `size` things that `kind` names in the plural.
size_t index_value(const json& value, const std::string& place, size_t size, const char* kind) {
    if (value.is_number()) {
        const double real = value.get<double>();
        if (real < 0 || real >= double(size) || real > double(int_limit))
            fail(place,
                 value.dump() + " is out of range; there are " + std::to_string(size) + " " + kind);
    }
    return whole_value(value, place);
}

std::optional<size_t> index_member(const json& object, const std::string& key,
                                   const std::string& place, size_t size, const char* kind) {
    const json* value = find(object, key);
    if (!value) return std::nullopt;
    return index_value(*value, join(place, key), size, kind);
}

bool bool_member(const json& object, const std::string& key, const std::string& place) {
    const json* value = find(object, key);
    if (value) expect(value->is_boolean(), "a boolean", *value, join(place, key));
    return value && value->get<bool>();
}

/// A member that is an array of exactly `count` numbers, or null if it is absent.
json numbers_member(const json& object, const std::string& key, const std::string& place,
                    size_t count) {
    const json* value = find(object, key);
    if (!value) return nullptr;
    const std::string here = join(place, key);
    const json& array = array_value(*value, here);
    if (array.size() != count)
        fail(here, "must have " + std::to_string(count) + " numbers, not " +
                       std::to_string(array.size()));
    json numbers = json::array();
    for (size_t i = 0; i < count; ++i) numbers.push_back(number_value(array[i], join(here, i)));
    return numbers;
}

// --- Accessors ------------------------------------------------------------------------------

enum ComponentType : uint64_t { Int8 = 5120, Uint8, Int16, Uint16, Uint32 = 5125, Float = 5126 };

uint64_t component_size(uint64_t component_type) {
    switch (component_type) {
        case Int8:
        case Uint8:
            return 1;
        case Int16:
        case Uint16:
            return 2;
        case Uint32:
        case Float:
            return 4;
        default:
            return 0;
    }
}

/// Number of components, or 0 if there is no such type.
uint64_t component_count(const std::string& type) {
    static const std::map<std::string, uint64_t> counts = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3},
                                                           {"VEC4", 4},   {"MAT2", 4}, {"MAT3", 9},
                                                           {"MAT4", 16}};
    const auto it = counts.find(type);
    return it == counts.end() ? 0 : it->second;
}

struct View {
    size_t buffer;
    uint64_t offset, length, stride;  ///< stride 0: elements are packed
    bool compressed;
};

struct Sparse {
    uint64_t count;
    size_t index_view, value_view;
    uint64_t index_offset, value_offset, index_type;
};

struct Accessor {
    std::optional<size_t> view;
    uint64_t offset, component_type, count;
    std::string type;
    bool normalized;
    std::optional<Sparse> sparse;

    uint64_t element_size() const { return component_size(component_type) * component_count(type); }
};

// --- The document ---------------------------------------------------------------------------

class Checker {
  public:
    Checker(const json& document, bool has_binary, Remarks& remarks)
        : in_(document), has_binary_(has_binary), remarks_(remarks) {}

    CheckedDocument run();

  private:
    void check_asset();
    void check_extensions();
    void read_sizes();

    void check_buffers();
    void check_views();
    void check_accessors();
    Sparse checked_sparse(const json& sparse, const std::string& place, uint64_t count) const;
    void use_view(size_t view, uint64_t offset, uint64_t count, uint64_t element_size,
                  const std::string& place, bool may_stride);
    void use_accessor(size_t index);
    void use_positions(size_t accessor);
    void use_indices(size_t accessor);

    void check_materials();
    void check_cameras();
    void check_meshes();
    json checked_primitive(const json& primitive, const std::string& place);
    void check_nodes();
    json checked_node(const json& node, const std::string& place);
    void check_transform(const json& node, const std::string& place, json& out);
    json checked_instancing(const json& extension, const std::string& place);
    void use_instance_attribute(const std::string& name, size_t accessor);
    void check_acyclic() const;
    void check_scenes();

    void write_buffers();
    void write_accessors();

    const json& in_;
    const bool has_binary_;
    Remarks& remarks_;
    json out_ = json::object();
    size_t node_count_ = 0, mesh_count_ = 0, camera_count_ = 0, material_count_ = 0;
    std::vector<BufferSource> buffers_;
    std::vector<View> views_;
    std::vector<Accessor> accessors_;
    std::vector<std::vector<size_t>> children_;
};

CheckedDocument Checker::run() {
    object_value(in_, "");
    check_asset();
    check_types(in_);
    check_extensions();
    read_sizes();
    check_buffers();
    check_views();
    check_accessors();
    check_materials();
    check_cameras();
    check_meshes();
    check_nodes();
    check_scenes();
    write_buffers();
    write_accessors();
    return {out_.dump(), std::move(buffers_)};
}

/// The number before the dot of "2.0". Fails for text of any other form.
std::pair<int, int> version_value(const std::string& text, const std::string& place) {
    const size_t dot = text.find('.');
    const bool digits = std::all_of(text.begin(), text.end(),
                                    [](unsigned char c) { return std::isdigit(c) || c == '.'; });
    if (!digits || dot == std::string::npos || dot == 0 || dot + 1 == text.size() ||
        text.find('.', dot + 1) != std::string::npos || text.size() > 8)
        fail(place, "'" + text.substr(0, 40) + "' is not a version like 2.0");
    return {std::stoi(text), std::stoi(text.substr(dot + 1))};
}

void Checker::check_asset() {
    const json& asset = object_value(require(in_, "asset", ""), "asset");
    const std::string version = string_value(require(asset, "version", "asset"), "asset/version");
    if (version_value(version, "asset/version").first != 2)
        fail("asset/version", "glTF " + version + " is not supported, only 2.0");
    const std::string least = string_member(asset, "minVersion", "asset");
    if (!least.empty() && version_value(least, "asset/minVersion") > std::pair(2, 0))
        fail("asset/minVersion", "glTF " + least + " is not supported, only 2.0");
    out_["asset"]["version"] = version;
}

/// Whether geometry can be read without knowing the extension.
bool is_harmless_extension(const std::string& name) {
    static const std::vector<std::string> known = {"KHR_mesh_quantization",
                                                   "EXT_mesh_gpu_instancing",
                                                   "KHR_texture_transform",
                                                   "KHR_texture_basisu",
                                                   "KHR_lights_punctual",
                                                   "KHR_animation_pointer",
                                                   "KHR_xmp",
                                                   "KHR_xmp_json_ld",
                                                   "EXT_texture_webp",
                                                   "EXT_texture_avif",
                                                   "EXT_lights_image_based",
                                                   "MSFT_texture_dds"};
    return name.starts_with("KHR_materials_") ||
           std::find(known.begin(), known.end(), name) != known.end();
}

void Checker::check_extensions() {
    for (const char* key : {"extensionsUsed", "extensionsRequired"}) {
        const json& names = array_member(in_, key, "");
        for (size_t i = 0; i < names.size(); ++i) string_value(names[i], join(key, i));
    }
    const json& required = array_member(in_, "extensionsRequired", "");
    for (size_t i = 0; i < required.size(); ++i) {
        const std::string name = required[i].get<std::string>();
        if (!is_harmless_extension(name))
            fail(join("extensionsRequired", i),
                 "the extension " + name.substr(0, 100) + " is required but not supported");
    }
}

void Checker::read_sizes() {
    node_count_ = array_member(in_, "nodes", "").size();
    mesh_count_ = array_member(in_, "meshes", "").size();
    camera_count_ = array_member(in_, "cameras", "").size();
    material_count_ = array_member(in_, "materials", "").size();
}

void Checker::check_buffers() {
    const json& buffers = array_member(in_, "buffers", "");
    for (size_t i = 0; i < buffers.size(); ++i) {
        const std::string place = join("buffers", i);
        const json& buffer = object_value(buffers[i], place);
        BufferSource source;
        source.byte_length =
            whole_value(require(buffer, "byteLength", place), join(place, "byteLength"));
        source.has_uri = buffer.contains("uri");
        source.uri = string_member(buffer, "uri", place);
        buffers_.push_back(std::move(source));
    }
}

void Checker::check_views() {
    const json& views = array_member(in_, "bufferViews", "");
    for (size_t i = 0; i < views.size(); ++i) {
        const std::string place = join("bufferViews", i);
        const json& view = object_value(views[i], place);
        View v;
        v.buffer = index_value(require(view, "buffer", place), join(place, "buffer"),
                               buffers_.size(), "buffers");
        v.offset = whole_member(view, "byteOffset", place, 0);
        v.length = whole_value(require(view, "byteLength", place), join(place, "byteLength"));
        v.stride = whole_member(view, "byteStride", place, 0);
        if (v.stride > 252 || v.stride % 4 != 0)
            fail(join(place, "byteStride"),
                 std::to_string(v.stride) + " is not a multiple of 4 up to 252");
        const json& extensions = object_member(view, "extensions", place);
        v.compressed = extensions.contains("EXT_meshopt_compression") ||
                       extensions.contains("KHR_meshopt_compression");
        const uint64_t available = buffers_[v.buffer].byte_length;
        if (v.offset > available || v.length > available - v.offset)
            fail(place, "ends beyond the " + std::to_string(available) + " bytes of its buffer");
        views_.push_back(v);
    }
}

void Checker::check_accessors() {
    const json& accessors = array_member(in_, "accessors", "");
    for (size_t i = 0; i < accessors.size(); ++i) {
        const std::string place = join("accessors", i);
        const json& accessor = object_value(accessors[i], place);
        Accessor a;
        a.view = index_member(accessor, "bufferView", place, views_.size(), "bufferViews");
        a.offset = whole_member(accessor, "byteOffset", place, 0);
        a.component_type =
            whole_value(require(accessor, "componentType", place), join(place, "componentType"));
        if (component_size(a.component_type) == 0)
            fail(join(place, "componentType"), std::to_string(a.component_type) + " is unknown");
        a.count = whole_value(require(accessor, "count", place), join(place, "count"));
        a.type = string_value(require(accessor, "type", place), join(place, "type"));
        if (component_count(a.type) == 0)
            fail(join(place, "type"), "'" + a.type.substr(0, 40) + "' is unknown");
        a.normalized = bool_member(accessor, "normalized", place);
        if (const json* sparse = find(accessor, "sparse"))
            a.sparse = checked_sparse(*sparse, join(place, "sparse"), a.count);
        accessors_.push_back(std::move(a));
    }
}

Sparse Checker::checked_sparse(const json& sparse, const std::string& place, uint64_t count) const {
    object_value(sparse, place);
    Sparse s;
    s.count = whole_value(require(sparse, "count", place), join(place, "count"), int_limit);
    if (s.count > count)
        fail(join(place, "count"), std::to_string(s.count) + " is more than the accessor's " +
                                       std::to_string(count) + " elements");
    const std::string index_place = join(place, "indices"), value_place = join(place, "values");
    const json& indices = object_value(require(sparse, "indices", place), index_place);
    const json& values = object_value(require(sparse, "values", place), value_place);
    s.index_view = index_value(require(indices, "bufferView", index_place),
                               join(index_place, "bufferView"), views_.size(), "bufferViews");
    s.value_view = index_value(require(values, "bufferView", value_place),
                               join(value_place, "bufferView"), views_.size(), "bufferViews");
    s.index_offset = whole_member(indices, "byteOffset", index_place, 0, int_limit);
    s.value_offset = whole_member(values, "byteOffset", value_place, 0, int_limit);
    s.index_type = whole_value(require(indices, "componentType", index_place),
                               join(index_place, "componentType"));
    if (s.index_type != Uint8 && s.index_type != Uint16 && s.index_type != Uint32)
        fail(join(index_place, "componentType"),
             std::to_string(s.index_type) + " is not an unsigned integer type");
    return s;
}

/// Checks that elements lie inside their view, without overflow, and marks the buffer as used.
void Checker::use_view(size_t index, uint64_t offset, uint64_t count, uint64_t element_size,
                       const std::string& place, bool may_stride) {
    const View& view = views_[index];
    if (view.compressed && !buffers_[view.buffer].has_uri && !(has_binary_ && view.buffer == 0))
        fail(place, "its data is meshopt-compressed, which is not supported");
    const uint64_t stride = may_stride && view.stride != 0 ? view.stride : element_size;
    if (stride < element_size)
        fail(join("bufferViews", index), "byteStride " + std::to_string(stride) +
                                             " is less than the " + std::to_string(element_size) +
                                             " bytes of an element of " + place);
    if (count == 0) return;
    buffers_[view.buffer].used = true;
    const bool first_fits = offset <= view.length && view.length - offset >= element_size;
    if (!first_fits || (count - 1) > (view.length - offset - element_size) / stride)
        fail(place, std::to_string(count) + " elements run past the " +
                        std::to_string(view.length) + " bytes of bufferViews/" +
                        std::to_string(index));
}

void Checker::use_accessor(size_t index) {
    const Accessor& a = accessors_[index];
    const std::string place = join("accessors", index);
    if (a.count > std::numeric_limits<uint32_t>::max())
        fail(join(place, "count"), std::to_string(a.count) + " is too large");
    if (a.view) use_view(*a.view, a.offset, a.count, a.element_size(), place, true);
    if (!a.sparse) return;
    const Sparse& s = *a.sparse;
    use_view(s.index_view, s.index_offset, s.count, component_size(s.index_type),
             join(place, "sparse/indices"), false);
    use_view(s.value_view, s.value_offset, s.count, a.element_size(), join(place, "sparse/values"),
             false);
}

void Checker::use_positions(size_t index) {
    const Accessor& a = accessors_[index];
    const std::string here = join("accessors", index);
    if (a.type != "VEC3") fail(here, "POSITION must be VEC3, not " + a.type);
    if (a.component_type == Uint32) fail(here, "POSITION cannot be of 32-bit integers");
    const json& used = array_member(in_, "extensionsUsed", "");
    const bool is_quantized = a.component_type != Float;
    if (is_quantized && std::find(used.begin(), used.end(), "KHR_mesh_quantization") == used.end())
        remarks_.add("integer positions without the extension KHR_mesh_quantization", here);
    use_accessor(index);
}

void Checker::use_indices(size_t index) {
    const Accessor& a = accessors_[index];
    const std::string here = join("accessors", index);
    if (a.type != "SCALAR") fail(here, "indices must be SCALAR, not " + a.type);
    const uint64_t type = a.component_type;
    if (type != Uint8 && type != Uint16 && type != Uint32)
        fail(here,
             "indices must be of unsigned integers, not componentType " + std::to_string(type));
    use_accessor(index);
}

void Checker::check_materials() {
    const json& materials = array_member(in_, "materials", "");
    for (size_t i = 0; i < materials.size(); ++i) {
        const std::string place = join("materials", i);
        const json& material = object_value(materials[i], place);
        json out = {{"name", string_member(material, "name", place)}};
        const json& pbr = object_member(material, "pbrMetallicRoughness", place);
        const json color =
            numbers_member(pbr, "baseColorFactor", join(place, "pbrMetallicRoughness"), 4);
        if (!color.is_null()) out["pbrMetallicRoughness"]["baseColorFactor"] = color;
        out_["materials"].push_back(std::move(out));
    }
}

void Checker::check_cameras() {
    const json& cameras = array_member(in_, "cameras", "");
    for (size_t i = 0; i < cameras.size(); ++i) {
        const std::string place = join("cameras", i);
        const json& camera = object_value(cameras[i], place);
        const std::string type = string_value(require(camera, "type", place), join(place, "type"));
        json out;
        if (type == "perspective") {
            const std::string here = join(place, "perspective");
            const json& lens = object_value(require(camera, "perspective", place), here);
            const double y_fov = number_value(require(lens, "yfov", here), join(here, "yfov"));
            if (!(y_fov > 0)) fail(join(here, "yfov"), "must be greater than 0");
            const json* aspect = find(lens, "aspectRatio");
            const double ratio = aspect ? number_value(*aspect, join(here, "aspectRatio")) : 1.0;
            if (!(ratio > 0)) fail(join(here, "aspectRatio"), "must be greater than 0");
            out["perspective"] = {{"yfov", y_fov}, {"aspectRatio", ratio}, {"znear", 1.0}};
        } else if (type == "orthographic") {
            out["orthographic"] = {{"xmag", 1.0}, {"ymag", 1.0}, {"zfar", 1.0}, {"znear", 0.0}};
        } else {
            fail(join(place, "type"), "'" + type.substr(0, 40) + "' is unknown");
        }
        out["type"] = type;
        out_["cameras"].push_back(std::move(out));
    }
}

void Checker::check_meshes() {
    const json& meshes = array_member(in_, "meshes", "");
    for (size_t i = 0; i < meshes.size(); ++i) {
        const std::string place = join("meshes", i);
        const json& mesh = object_value(meshes[i], place);
        const std::string here = join(place, "primitives");
        const json& primitives = array_value(require(mesh, "primitives", place), here);
        json out = {{"name", string_member(mesh, "name", place)}, {"primitives", json::array()}};
        for (size_t k = 0; k < primitives.size(); ++k)
            out["primitives"].push_back(checked_primitive(primitives[k], join(here, k)));
        out_["meshes"].push_back(std::move(out));
    }
}

json Checker::checked_primitive(const json& primitive, const std::string& place) {
    object_value(primitive, place);
    constexpr const char* kind = "accessors";
    const size_t accessor_count = accessors_.size();
    const std::string attribute_place = join(place, "attributes");
    const json& attributes = object_value(require(primitive, "attributes", place), attribute_place);
    for (const auto& [name, accessor] : attributes.items())
        index_value(accessor, join(attribute_place, name), accessor_count, kind);
    const auto positions =
        index_member(attributes, "POSITION", attribute_place, accessor_count, kind);
    const auto indices = index_member(primitive, "indices", place, accessor_count, kind);
    const uint64_t mode = whole_member(primitive, "mode", place, 4);
    if (mode > 6) fail(join(place, "mode"), std::to_string(mode) + " is unknown");

    json out = {{"mode", mode}, {"attributes", json::object()}};
    const auto material = index_member(primitive, "material", place, material_count_, "materials");
    if (material) out["material"] = *material;
    if (mode < 4) return out;
    if (!positions) {
        remarks_.add("primitive without POSITION is skipped", place);
        return out;
    }
    const bool has_data = accessors_[*positions].view && (!indices || accessors_[*indices].view);
    if (!has_data &&
        object_member(primitive, "extensions", place).contains("KHR_draco_mesh_compression"))
        fail(place, "is Draco-compressed, which is not supported");
    use_positions(*positions);
    out["attributes"]["POSITION"] = *positions;
    if (!indices) return out;
    use_indices(*indices);
    if (accessors_[*indices].view)
        out["indices"] = *indices;
    else
        out["attributes"][viewless_indices] = *indices;
    return out;
}

void Checker::check_nodes() {
    const json& nodes = array_member(in_, "nodes", "");
    children_.resize(nodes.size());
    for (size_t i = 0; i < nodes.size(); ++i) {
        const std::string place = join("nodes", i);
        json out = checked_node(nodes[i], place);
        const std::string here = join(place, "children");
        const json& children = array_member(nodes[i], "children", place);
        for (size_t k = 0; k < children.size(); ++k)
            children_[i].push_back(index_value(children[k], join(here, k), node_count_, "nodes"));
        if (!children_[i].empty()) out["children"] = children_[i];
        out_["nodes"].push_back(std::move(out));
    }
    check_acyclic();
}

json Checker::checked_node(const json& node, const std::string& place) {
    object_value(node, place);
    json out = {{"name", string_member(node, "name", place)}};
    if (const auto mesh = index_member(node, "mesh", place, mesh_count_, "meshes"))
        out["mesh"] = *mesh;
    if (const auto camera = index_member(node, "camera", place, camera_count_, "cameras"))
        out["camera"] = *camera;
    check_transform(node, place, out);
    const char* instancing = "EXT_mesh_gpu_instancing";
    const std::string here = join(place, "extensions");
    const json& extensions = object_member(node, "extensions", place);
    if (const json* extension = find(extensions, instancing); extension && out.contains("mesh"))
        out["extensions"][instancing] = checked_instancing(*extension, join(here, instancing));
    return out;
}

void Checker::check_transform(const json& node, const std::string& place, json& out) {
    json matrix = numbers_member(node, "matrix", place, 16);
    bool has_trs = false;
    for (const auto& [key, count] :
         {std::pair("translation", 3), std::pair("rotation", 4), std::pair("scale", 3)}) {
        json numbers = numbers_member(node, key, place, size_t(count));
        if (numbers.is_null()) continue;
        has_trs = true;
        if (matrix.is_null()) out[key] = std::move(numbers);
    }
    if (matrix.is_null()) return;
    if (has_trs) remarks_.add("both a matrix and its parts are given; the matrix is used", place);
    if (matrix[3] != 0 || matrix[7] != 0 || matrix[11] != 0 || matrix[15] != 1)
        remarks_.add("the last row of the matrix is not 0 0 0 1 and is ignored", place);
    out["matrix"] = std::move(matrix);
}

json Checker::checked_instancing(const json& extension, const std::string& place) {
    const std::string here = join(place, "attributes");
    const json& attributes =
        object_value(require(object_value(extension, place), "attributes", place), here);
    if (attributes.empty()) fail(here, "has no attribute");
    std::optional<uint64_t> count;
    json out = json::object();
    for (const auto& [name, value] : attributes.items()) {
        const size_t accessor =
            index_value(value, join(here, name), accessors_.size(), "accessors");
        const uint64_t this_count = accessors_[accessor].count;
        if (count && *count != this_count)
            fail(here, "the attributes have different counts, " + std::to_string(*count) + " and " +
                           std::to_string(this_count));
        count = this_count;
        // Attributes of the application's own still tell the number of instances.
        if (name == "TRANSLATION" || name == "ROTATION" || name == "SCALE")
            use_instance_attribute(name, accessor);
        out[name] = accessor;
    }
    json result;
    result["attributes"] = std::move(out);
    return result;
}

void Checker::use_instance_attribute(const std::string& name, size_t index) {
    const Accessor& a = accessors_[index];
    const std::string place = join("accessors", index);
    const bool is_rotation = name == "ROTATION";
    const std::string type = is_rotation ? "VEC4" : "VEC3";
    if (a.type != type) fail(place, name + " must be " + type + ", not " + a.type);
    const bool is_small = (a.component_type == Int8 || a.component_type == Int16) && a.normalized;
    if (a.component_type != Float && !(is_rotation && is_small))
        fail(place, name + " cannot have componentType " + std::to_string(a.component_type));
    use_accessor(index);
}

/// Removes nodes without remaining parents until none is left (Kahn 1962): no recursion.
void Checker::check_acyclic() const {
    std::vector<size_t> parents(node_count_, 0);
    for (const auto& children : children_)
        for (size_t child : children) ++parents[child];
    std::vector<size_t> ready;
    for (size_t i = 0; i < node_count_; ++i)
        if (parents[i] == 0) ready.push_back(i);
    for (size_t done = 0; done < ready.size(); ++done)
        for (size_t child : children_[ready[done]])
            if (--parents[child] == 0) ready.push_back(child);
    if (ready.size() == node_count_) return;
    const auto in_cycle =
        std::find_if(parents.begin(), parents.end(), [](size_t count) { return count > 0; });
    fail(join("nodes", size_t(in_cycle - parents.begin())), "is in or below a cycle of nodes");
}

void Checker::check_scenes() {
    const json& scenes = array_member(in_, "scenes", "");
    for (size_t i = 0; i < scenes.size(); ++i) {
        const std::string place = join("scenes", i);
        const std::string here = join(place, "nodes");
        const json& nodes = array_member(object_value(scenes[i], place), "nodes", place);
        json out = {{"nodes", json::array()}};
        for (size_t k = 0; k < nodes.size(); ++k)
            out["nodes"].push_back(index_value(nodes[k], join(here, k), node_count_, "nodes"));
        out_["scenes"].push_back(std::move(out));
    }
    if (const auto scene = index_member(in_, "scene", "", scenes.size(), "scenes"))
        out_["scene"] = *scene;
    else if (scenes.size() > 1)
        remarks_.add("no default scene is named; the first is used", "scenes");
}

void Checker::write_buffers() {
    for (size_t i = 0; i < buffers_.size(); ++i) {
        const BufferSource& source = buffers_[i];
        const std::string place = join("buffers", i);
        if (source.used && source.byte_length == 0) fail(place, "byteLength must not be 0");
        if (source.used && !source.has_uri && !(i == 0 && has_binary_))
            fail(place, "has neither a URI nor a BIN chunk");
        out_["buffers"].push_back(
            {{"uri", buffer_name(i)}, {"byteLength", source.used ? source.byte_length : 1}});
    }
    for (const View& view : views_)
        out_["bufferViews"].push_back({{"buffer", view.buffer},
                                       {"byteOffset", view.offset},
                                       {"byteLength", view.length},
                                       {"byteStride", view.stride}});
}

void Checker::write_accessors() {
    for (const Accessor& a : accessors_) {
        json out = {{"byteOffset", a.offset},
                    {"componentType", a.component_type},
                    {"count", a.count},
                    {"type", a.type},
                    {"normalized", a.normalized}};
        if (a.view) out["bufferView"] = *a.view;
        if (a.sparse)
            out["sparse"] = {
                {"count", a.sparse->count},
                {"indices",
                 {{"bufferView", a.sparse->index_view},
                  {"byteOffset", a.sparse->index_offset},
                  {"componentType", a.sparse->index_type}}},
                {"values",
                 {{"bufferView", a.sparse->value_view}, {"byteOffset", a.sparse->value_offset}}}};
        out_["accessors"].push_back(std::move(out));
    }
}

json parsed(const std::string& text) {
    try {
        return json::parse(text);
    } catch (const json::exception& error) {
        // The library's text starts with an error number in brackets.
        const std::string what = error.what();
        const size_t bracket = what.find("] ");
        fail("JSON", bracket == std::string::npos ? what : what.substr(bracket + 2, 300));
    }
}

}  // namespace

void Remarks::add(const std::string& what, const std::string& place) {
    const auto [it, is_new] = kind_of_.emplace(what, kinds_.size());
    if (is_new) kinds_.push_back({what, place, 0});
    ++kinds_[it->second].count;
}

std::vector<std::string> Remarks::lines() const {
    std::vector<std::string> out;
    for (const Kind& kind : kinds_) {
        std::string line = kind.first_place + ": " + kind.what;
        if (kind.count > 1) line += " (and " + std::to_string(kind.count - 1) + " more like it)";
        out.push_back(std::move(line));
    }
    return out;
}

std::string buffer_name(size_t index) { return buffer_prefix + std::to_string(index); }

size_t buffer_index(const std::string& name) {
    size_t index = 0;
    const char* end = name.data() + name.size();
    const bool has_prefix = name.starts_with(buffer_prefix);
    const char* digits = name.data() + (has_prefix ? buffer_prefix.size() : name.size());
    const auto [rest, error] = std::from_chars(digits, end, index);
    return error == std::errc() && rest == end ? index : std::numeric_limits<size_t>::max();
}

CheckedDocument check_document(const std::string& text, bool has_binary, Remarks& remarks) {
    check_json_depth(text, nesting_limit);
    const json document = parsed(text);
    return Checker(document, has_binary, remarks).run();
}

}  // namespace crofton::gltf
