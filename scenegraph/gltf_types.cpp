#include "scenegraph/gltf_types.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "framework/error.h"

namespace crofton::gltf {
namespace {

using nlohmann::json;

enum class Type {
    String,
    Integer,
    Number,
    Boolean,
    Object,
    Map,
    Strings,
    Integers,
    Numbers,
    Objects,
    Maps
};

struct Property {
    std::string_view key;
    Type type;
    std::string_view kind = "";  ///< of the object or of the array's objects
};
using Schema = std::map<std::string_view, std::vector<Property>>;

const Schema& scene_schema() {
    static const Schema schema = {
        {"root",
         {{"asset", Type::Object, "asset"},
          {"extensionsUsed", Type::Strings},
          {"extensionsRequired", Type::Strings},
          {"scene", Type::Integer},
          {"scenes", Type::Objects, "scene"},
          {"nodes", Type::Objects, "node"},
          {"meshes", Type::Objects, "mesh"},
          {"accessors", Type::Objects, "accessor"},
          {"bufferViews", Type::Objects, "bufferView"},
          {"buffers", Type::Objects, "buffer"},
          {"cameras", Type::Objects, "camera"},
          {"materials", Type::Objects, "material"},
          {"textures", Type::Objects, "texture"},
          {"images", Type::Objects, "image"},
          {"samplers", Type::Objects, "sampler"},
          {"skins", Type::Objects, "skin"},
          {"animations", Type::Objects, "animation"}}},
        {"asset",
         {{"version", Type::String},
          {"minVersion", Type::String},
          {"generator", Type::String},
          {"copyright", Type::String}}},
        {"scene", {{"nodes", Type::Integers}}},
        {"node",
         {{"children", Type::Integers},
          {"mesh", Type::Integer},
          {"camera", Type::Integer},
          {"skin", Type::Integer},
          {"matrix", Type::Numbers},
          {"translation", Type::Numbers},
          {"rotation", Type::Numbers},
          {"scale", Type::Numbers},
          {"weights", Type::Numbers}}},
        {"camera",
         {{"type", Type::String},
          {"perspective", Type::Object, "perspective"},
          {"orthographic", Type::Object, "orthographic"}}},
        {"perspective",
         {{"aspectRatio", Type::Number},
          {"yfov", Type::Number},
          {"znear", Type::Number},
          {"zfar", Type::Number}}},
        {"orthographic",
         {{"xmag", Type::Number},
          {"ymag", Type::Number},
          {"znear", Type::Number},
          {"zfar", Type::Number}}},
        {"skin",
         {{"inverseBindMatrices", Type::Integer},
          {"skeleton", Type::Integer},
          {"joints", Type::Integers}}},
        {"animation",
         {{"channels", Type::Objects, "channel"}, {"samplers", Type::Objects, "animationSampler"}}},
        {"channel", {{"sampler", Type::Integer}, {"target", Type::Object, "target"}}},
        {"target", {{"node", Type::Integer}, {"path", Type::String}}},
        {"animationSampler",
         {{"input", Type::Integer}, {"interpolation", Type::String}, {"output", Type::Integer}}}};
    return schema;
}

const Schema& data_schema() {
    static const Schema schema = {
        {"mesh", {{"primitives", Type::Objects, "primitive"}, {"weights", Type::Numbers}}},
        {"primitive",
         {{"attributes", Type::Map},
          {"indices", Type::Integer},
          {"material", Type::Integer},
          {"mode", Type::Integer},
          {"targets", Type::Maps}}},
        {"accessor",
         {{"bufferView", Type::Integer},
          {"byteOffset", Type::Integer},
          {"componentType", Type::Integer},
          {"normalized", Type::Boolean},
          {"count", Type::Integer},
          {"type", Type::String},
          {"min", Type::Numbers},
          {"max", Type::Numbers},
          {"sparse", Type::Object, "sparse"}}},
        {"sparse",
         {{"count", Type::Integer},
          {"indices", Type::Object, "sparsePart"},
          {"values", Type::Object, "sparsePart"}}},
        {"sparsePart",
         {{"bufferView", Type::Integer},
          {"byteOffset", Type::Integer},
          {"componentType", Type::Integer}}},
        {"bufferView",
         {{"buffer", Type::Integer},
          {"byteOffset", Type::Integer},
          {"byteLength", Type::Integer},
          {"byteStride", Type::Integer},
          {"target", Type::Integer}}},
        {"buffer", {{"uri", Type::String}, {"byteLength", Type::Integer}}},
        {"material",
         {{"pbrMetallicRoughness", Type::Object, "pbr"},
          {"normalTexture", Type::Object, "textureInfo"},
          {"occlusionTexture", Type::Object, "textureInfo"},
          {"emissiveTexture", Type::Object, "textureInfo"},
          {"emissiveFactor", Type::Numbers},
          {"alphaMode", Type::String},
          {"alphaCutoff", Type::Number},
          {"doubleSided", Type::Boolean}}},
        {"pbr",
         {{"baseColorFactor", Type::Numbers},
          {"baseColorTexture", Type::Object, "textureInfo"},
          {"metallicFactor", Type::Number},
          {"roughnessFactor", Type::Number},
          {"metallicRoughnessTexture", Type::Object, "textureInfo"}}},
        {"textureInfo",
         {{"index", Type::Integer},
          {"texCoord", Type::Integer},
          {"scale", Type::Number},
          {"strength", Type::Number}}},
        {"texture", {{"sampler", Type::Integer}, {"source", Type::Integer}}},
        {"image",
         {{"uri", Type::String}, {"mimeType", Type::String}, {"bufferView", Type::Integer}}},
        {"sampler",
         {{"magFilter", Type::Integer},
          {"minFilter", Type::Integer},
          {"wrapS", Type::Integer},
          {"wrapT", Type::Integer}}}};
    return schema;
}

const std::vector<Property>& properties_of(std::string_view kind) {
    const auto it = scene_schema().find(kind);
    return it != scene_schema().end() ? it->second : data_schema().at(kind);
}

const Property* find_property(std::string_view kind, std::string_view key) {
    // Any object may have these.
    static constexpr Property name{"name", Type::String};
    static constexpr Property extensions{"extensions", Type::Object};
    const std::vector<Property>& properties = properties_of(kind);
    const auto it = std::find_if(properties.begin(), properties.end(),
                                 [&](const Property& p) { return p.key == key; });
    if (it != properties.end()) return &*it;
    if (key == name.key && kind != "root" && kind != "asset") return &name;
    return key == extensions.key ? &extensions : nullptr;
}

/// A path into the document, kept on the stack and spelled out only for an error.
struct Place {
    const Place* parent;
    std::string_view key;  ///< empty: `index` counts
    size_t index;

    std::string text() const {
        const std::string own = key.empty() ? std::to_string(index) : std::string(key);
        return parent ? parent->text() + "/" + own : own;
    }
};

void expect(bool is_right, const char* type, const json& value, const Place& place) {
    if (is_right) return;
    throw InputError(place.text() + ": must be " + type + ", not " +
                     (value.is_number() ? value.dump() : value.type_name()));
}

void check_object(const json& object, std::string_view kind, const Place* place);

void check_scalar(const json& value, Type type, const Place& place) {
    if (type == Type::String) return expect(value.is_string(), "a string", value, place);
    if (type == Type::Boolean) return expect(value.is_boolean(), "a boolean", value, place);
    if (type == Type::Number) return expect(value.is_number(), "a number", value, place);
    const bool is_whole = value.is_number_float()
                              ? std::trunc(value.get<double>()) == value.get<double>()
                              : value.is_number_integer();
    expect(is_whole, "an integer", value, place);
}

void check_map(const json& value, const Place& place) {
    expect(value.is_object(), "an object", value, place);
    for (auto it = value.begin(); it != value.end(); ++it)
        check_scalar(it.value(), Type::Integer, Place{&place, it.key(), 0});
}

void check_element(const json& value, const Property& property, const Place& place) {
    switch (property.type) {
        case Type::Strings:
            return check_scalar(value, Type::String, place);
        case Type::Integers:
            return check_scalar(value, Type::Integer, place);
        case Type::Numbers:
            return check_scalar(value, Type::Number, place);
        case Type::Maps:
            return check_map(value, place);
        default:
            expect(value.is_object(), "an object", value, place);
            return check_object(value, property.kind, &place);
    }
}

void check_property(const json& value, const Property& property, const Place& place) {
    switch (property.type) {
        case Type::String:
        case Type::Integer:
        case Type::Number:
        case Type::Boolean:
            return check_scalar(value, property.type, place);
        case Type::Map:
            return check_map(value, place);
        case Type::Object:
            expect(value.is_object(), "an object", value, place);
            if (!property.kind.empty()) check_object(value, property.kind, &place);
            return;
        default:
            expect(value.is_array(), "an array", value, place);
            for (size_t i = 0; i < value.size(); ++i)
                check_element(value[i], property, Place{&place, "", i});
    }
}

void check_object(const json& object, std::string_view kind, const Place* place) {
    for (auto it = object.begin(); it != object.end(); ++it)
        if (const Property* property = find_property(kind, it.key()))
            check_property(it.value(), *property, Place{place, property->key, 0});
}

}  // namespace

void check_types(const json& document) {
    if (!document.is_object())
        throw InputError(std::string("must be an object, not ") + document.type_name());
    check_object(document, "root", nullptr);
}

}  // namespace crofton::gltf
