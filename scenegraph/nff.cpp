#include "scenegraph/nff.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <utility>

#include "scenegraph/text_reader.h"

namespace crofton {
namespace {

const std::vector<std::string> kEntities = {
    "v", "b", "l", "f", "c", "s", "p", "pp", "from", "at", "up", "angle", "hither", "resolution"};

class NffReader {
  public:
    NffReader(const std::string& path, std::string_view text)
        : in_(path, text), name_(std::filesystem::path(path).stem().string()) {}

    Scene read() {
        std::string_view entity = in_.word_across_lines();
        for (; !entity.empty(); entity = in_.word_across_lines()) read_entity(std::string(entity));
        add_geometries();
        return std::move(scene_);
    }

  private:
    void read_entity(const std::string& entity) {
        if (entity == "s")
            read_sphere();
        else if (entity == "c")
            read_cone();
        else if (entity == "p" || entity == "pp")
            read_polygon(entity == "pp");
        else if (entity == "f")
            read_material();
        else if (entity == "l")
            read_light();
        else if (entity == "b")
            point("background");
        else if (entity == "v")
            scene_.cameras.emplace_back();
        else
            read_view(entity);
    }

    void read_view(const std::string& key) {
        if (std::find(kEntities.begin(), kEntities.end(), key) == kEntities.end())
            in_.fail(unknown_name("entity", key.substr(0, 40), kEntities));
        if (scene_.cameras.empty()) in_.fail("'" + key + "' before 'v'");
        Camera& camera = scene_.cameras.back();
        if (key == "from")
            camera.eye = point("from").cast<double>();
        else if (key == "at")
            camera.at = point("at").cast<double>();
        else if (key == "up")
            camera.up = point("up").cast<double>();
        else if (key == "angle")
            camera.fov_y = real("angle") * std::numbers::pi / 180.0;
        else if (key == "hither")
            real("hither");
        else
            for (int i = 0; i < 2; ++i) real("resolution");
    }

    void read_light() {
        scene_.lights.push_back({point("light").cast<double>()});
        in_.next_line();  // colour
    }

    void read_material() {
        const Vec3f color = point("fill colour");
        in_.next_line();  // shading parameters
        material_ = uint32_t(scene_.materials.size());
        scene_.materials.push_back({"", {color.x(), color.y(), color.z()}});
    }

    void read_sphere() {
        const Vec3f center = point("sphere");
        add_quadric(Sphere{center, std::abs(real("sphere"))});
    }

    void read_cone() {
        const Vec3f base = point("cone");
        const float base_radius = real("cone");
        const Vec3f apex = point("cone");
        const float apex_radius = real("cone");
        if ((base_radius < 0 && apex_radius > 0) || (base_radius > 0 && apex_radius < 0))
            in_.fail("cone: radii of different sign");
        add_quadric(Cone{base, std::abs(base_radius), apex, std::abs(apex_radius)});
    }

    void add_quadric(const Quadric& quadric) {
        if (quadrics_.shapes.empty()) quadrics_material_ = material_;
        quadrics_.shapes.push_back(quadric);
    }

    void read_polygon(bool with_normals) {
        const int64_t corners = in_.number<int64_t>(in_.word_across_lines(), "number of corners");
        // A number and what separates it from the next are two bytes at least.
        const size_t bytes_each = with_normals ? 12 : 6;
        if (corners < 3) in_.fail("polygon: fewer than 3 corners");
        if (uint64_t(corners) > (in_.remaining() + 1) / bytes_each)
            in_.fail("polygon: the file ends before its " + std::to_string(corners) + " corners");
        if (polygons_.first.empty()) {
            polygons_.first.push_back(0);
            polygons_material_ = material_;
        }
        for (int64_t i = 0; i < corners; ++i) {
            polygons_.positions.push_back(point("polygon"));
            if (with_normals) point("normal");
        }
        polygons_.first.push_back(uint32_t(polygons_.positions.size()));
    }

    void add_geometries() {
        Mesh mesh{name_, {}};
        if (!quadrics_.shapes.empty())
            mesh.geometries.push_back(scene_.add_geometry(
                {name_ + " quadrics", quadrics_material_, std::move(quadrics_)}));
        if (polygons_.size() > 0)
            mesh.geometries.push_back(scene_.add_geometry(
                {name_ + " polygons", polygons_material_, std::move(polygons_)}));
        if (mesh.geometries.empty()) in_.fail("the file has no shapes");
        scene_.meshes.push_back(std::move(mesh));
        scene_.add_node(name_, 0);
    }

    float real(const char* what) {
        const float value = in_.real_across_lines(what);
        if (!std::isfinite(value)) in_.fail(std::string(what) + ": a number is not finite");
        return value;
    }
    Vec3f point(const char* what) {
        const float x = real(what), y = real(what), z = real(what);
        return {x, y, z};
    }

    static constexpr uint32_t kNoMaterial = ~uint32_t{0};

    TextReader in_;
    std::string name_;
    Scene scene_;
    Quadrics quadrics_;
    Polygons polygons_;
    uint32_t material_ = kNoMaterial;
    uint32_t quadrics_material_ = kNoMaterial;
    uint32_t polygons_material_ = kNoMaterial;
};

}  // namespace

Scene load_nff(const std::string& path) {
    const std::string text = read_file(path);
    return NffReader(path, text).read();
}

}  // namespace crofton
