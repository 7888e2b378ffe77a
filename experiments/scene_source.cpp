#include "experiments/scene_source.h"

#include <filesystem>
#include <fstream>

#include "experiments/hash.h"
#include "experiments/random.h"
#include "framework/archive.h"
#include "framework/error.h"
#include "scenegraph/append.h"
#include "scenegraph/procedural/procedural.h"

namespace crofton {
namespace {

struct ShapeBytes {
    ArchiveWriter& out;
    void operator()(const TriangleMesh& m) const { out(m.positions, m.triangles); }
    void operator()(const Points& p) const { out(p.positions, p.normals, p.radii); }
    void operator()(const Polygons& p) const { out(p.positions, p.first); }
    void operator()(const Quadrics& q) const {
        for (const Quadric& quadric : q.shapes) {
            out(uint32_t(quadric.index()));
            std::visit(*this, quadric);
        }
    }
    void operator()(const Sphere& s) const { out(s.center, s.radius); }
    void operator()(const Cone& c) const { out(c.base, c.base_radius, c.apex, c.apex_radius); }
    void operator()(const Disc& d) const { out(d.center, d.radius, d.normal, d.inner_radius); }
};

namespace fs = std::filesystem;

constexpr double largest = 1e12;  ///< of positions and scales: far inside the range of float

std::string resolved_path(const ConfigValue& value, const std::string& folder) {
    const fs::path path = value.text;
    if (path.is_absolute() || value.from_command_line) return path.string();
    return (fs::path(folder) / path).lexically_normal().string();
}

/// `file` is a path or an array of paths, of which the first that exists is taken. The config then
/// holds the absolute path, so that the resolved config can be run from elsewhere.
std::string read_file_key(ConfigTable& table, const std::string& folder) {
    ConfigValue& value = *table.value("file");
    std::vector<const ConfigValue*> candidates;
    if (value.is_array())
        for (const ConfigValue& item : value.items) candidates.push_back(&item);
    else
        candidates.push_back(&value);
    std::string tried;
    for (const ConfigValue* candidate : candidates) {
        if (candidate->type != ConfigValue::Type::string)
            throw InputError(candidate->place + ": file: expected a string, found " +
                             candidate->type_text());
        const std::string path = resolved_path(*candidate, folder);
        std::error_code error;
        if (fs::is_regular_file(path, error)) {
            ConfigValue chosen = ConfigValue::of(fs::absolute(path).string(), value.place);
            chosen.key_place = value.key_place;
            return table.raw().set("file", std::move(chosen)).text;
        }
        tried += (tried.empty() ? "'" : ", '") + path + "'";
    }
    if (candidates.empty()) table.fail("file", "file: no paths");
    table.fail("file",
               "file: " + tried + (candidates.size() > 1 ? ": none exists" : " does not exist"));
}

std::vector<std::string> generator_names() {
    std::vector<std::string> names;
    for (const ProceduralScene& generator : procedural_scenes()) names.push_back(generator.name);
    return names;
}

const ProceduralScene& find_generator(const std::string& name) {
    for (const ProceduralScene& generator : procedural_scenes())
        if (generator.name == name) return generator;
    throw InputError(unknown_name("procedural scene", name, generator_names()));
}

void read_procedural(ConfigTable& table, SceneSource& source) {
    source.procedural = table.string("procedural", "", generator_names());
    ConfigTable parameters = table.table("parameters");
    for (const ProceduralParameter& p : find_generator(source.procedural).parameters)
        source.parameters[p.name] =
            p.integer ? double(parameters.integer(p.name, int64_t(p.default_value),
                                                  int64_t(p.minimum), int64_t(p.maximum)))
                      : parameters.real(p.name, p.default_value, p.minimum, p.maximum);
    parameters.finish();
}

std::optional<SceneSource> read_source(ConfigTable& table, const std::string& folder) {
    SceneSource source;
    const bool file = table.has("file"), procedural = table.has("procedural");
    if (file && procedural)
        table.fail("procedural", table.what() + ": either 'file' or 'procedural', not both");
    if (file) source.file = read_file_key(table, folder);
    if (procedural) read_procedural(table, source);
    // Known in any case, so that a typing error is told apart.
    table.value("file"), table.value("procedural"), table.value("parameters");
    if (!procedural && table.has("parameters"))
        table.fail("parameters", table.what() + ": only procedural scenes have parameters");
    return file || procedural ? std::optional(source) : std::nullopt;
}

Vec3d vector_of(const std::vector<double>& v) { return {v[0], v[1], v[2]}; }

Vec3d read_scale(ConfigTable& table) {
    const ConfigValue* value = table.value("scale");
    if (value && value->is_array()) return vector_of(*table.reals("scale", 3));
    return Vec3d::Constant(table.real("scale", 1.0, -largest, largest));
}

ScenePlacement read_place(ConfigTable& table, const std::string& folder) {
    ScenePlacement place;
    const auto source = read_source(table, folder);
    if (!source) table.fail("file", table.what() + ": needs 'file' or 'procedural'");
    place.source = *source;
    const std::string stem =
        source->file.empty() ? source->procedural : fs::path(source->file).stem().string();
    place.name = table.string("name", stem);
    place.scale = read_scale(table);
    if (const auto position = table.reals("position", 3)) place.position = vector_of(*position);
    if (const auto angles = table.reals("rotate_deg", 3)) place.rotate_deg = vector_of(*angles);
    place.fit_height = table.real("fit_height", 1e-12, largest);
    table.finish();
    return place;
}

CameraSpec read_camera(ConfigTable table) {
    CameraSpec camera;
    if (const auto eye = table.reals("eye", 3)) camera.eye = vector_of(*eye);
    if (const auto at = table.reals("at", 3)) camera.at = vector_of(*at);
    if (const auto up = table.reals("up", 3)) camera.up = vector_of(*up);
    camera.fov_deg = table.real("fov", 0.01, 175);
    table.finish();
    if (camera.eye.has_value() != camera.at.has_value())
        table.fail("eye", "camera: 'eye' and 'at' belong together");
    if (camera.eye && (*camera.at - *camera.eye).isZero(0))
        table.fail("at", "camera: 'eye' and 'at' are the same point");
    return camera;
}

Scene load(const SceneSource& source) {
    return source.file.empty() ? make_scene(source.procedural, source.parameters)
                               : load_scene(source.file);
}

Transform placement_transform(const ScenePlacement& place, const Scene& scene) {
    Transform moved = translation(place.position);
    const double degree = pi / 180;
    Transform turned = rotation(Vec3d::UnitZ(), place.rotate_deg.z() * degree) *
                       rotation(Vec3d::UnitY(), place.rotate_deg.y() * degree) *
                       rotation(Vec3d::UnitX(), place.rotate_deg.x() * degree);
    if (place.rotate_deg.isZero(0)) turned = {};
    Transform sized = scaling(place.scale);
    if (place.fit_height) {
        const SceneStatistics s = statistics(scene);
        const double height = s.bounds_max.y() - s.bounds_min.y();
        if (!(height > 0) || !std::isfinite(height))
            throw InputError("scene.place '" + place.name +
                             "': fit_height: the scene has no height");
        const Vec3d middle = 0.5 * (s.bounds_min + s.bounds_max);
        const Vec3d base(middle.x(), s.bounds_min.y(), middle.z());
        sized = sized * scaling(Vec3d::Constant(*place.fit_height / height)) * translation(-base);
    }
    return moved * turned * sized;
}

void hash_file(const SceneSource& source, std::map<std::string, std::string>& out) {
    if (source.file.empty()) return;
    Fnv1a hash;
    std::ifstream file(source.file, std::ios::binary);
    std::vector<char> buffer(1 << 20);
    while (file.read(buffer.data(), std::streamsize(buffer.size())) || file.gcount() > 0)
        hash.add(buffer.data(), size_t(file.gcount()));
    out[source.file] = "fnv1a64:" + hash.hex();
}

}  // namespace

SceneSpec parse_scene(ConfigTable& root, const std::string& folder) {
    SceneSpec spec;
    ConfigTable table = root.table("scene");
    spec.base = read_source(table, folder);
    for (ConfigTable& place : table.tables("place"))
        spec.places.push_back(read_place(place, folder));
    table.finish();
    if (!spec.base && spec.places.empty())
        table.fail("file", "scene: needs 'file', 'procedural' or [[scene.place]]");
    spec.camera = read_camera(root.table("camera"));
    return spec;
}

SceneSource scene_source(const std::string& name) {
    SceneSource source;
    const std::string prefix = "procedural:";
    if (!name.starts_with(prefix)) {
        source.file = name;
        return source;
    }
    source.procedural = name.substr(prefix.size());
    find_generator(source.procedural);
    return source;
}

Scene make_scene(const SceneSpec& spec) {
    Scene scene;
    if (spec.base) scene = load(*spec.base);
    for (const ScenePlacement& place : spec.places) {
        Scene part = load(place.source);
        const Transform world_from_part = placement_transform(place, part);
        append(scene, std::move(part), world_from_part, place.name);
        scene.name += (scene.name.empty() ? "" : "+") + place.name;
    }
    return scene;
}

std::string fingerprint(const Scene& scene) {
    // The archive's own byte form of each part: plain data, sizes before contents.
    ArchiveWriter out;
    for (const Geometry& geometry : scene.geometries) {
        out(uint32_t(geometry.shapes.index()));
        std::visit(ShapeBytes{out}, geometry.shapes);
    }
    for (const Mesh& mesh : scene.meshes) out(mesh.geometries);
    for (const Node& node : scene.nodes)
        out(node.parent_from_node, node.children, node.mesh.value_or(UINT32_MAX),
            node.node_from_instance);
    out(scene.roots);
    Fnv1a hash;
    hash.add(out.buffer().data(), out.buffer().size());
    return hash.hex();
}

std::map<std::string, std::string> file_hashes(const SceneSpec& spec) {
    std::map<std::string, std::string> out;
    if (spec.base) hash_file(*spec.base, out);
    for (const ScenePlacement& place : spec.places) hash_file(place.source, out);
    return out;
}

}  // namespace crofton
