#include "scenegraph/obj.h"

#include <algorithm>
#include <filesystem>
#include <unordered_map>
#include <utility>

#include "scenegraph/text_reader.h"
#include "scenegraph/triangulate.h"

namespace crofton {
namespace {

/// One object or group. Vertices are numbered in the order in which its faces use them.
struct Group {
    std::string name;
    TriangleMesh mesh;
};

class ObjReader {
  public:
    ObjReader(const std::string& path, std::string_view text)
        : in_(path, text, {.comments = true, .continuations = true}) {
        name_ = std::filesystem::path(path).stem().string();
    }

    Scene read() {
        for (; !in_.at_end(); in_.next_line()) read_line(in_.word());
        Scene scene;
        for (Group& group : groups_)
            if (!group.mesh.triangles.empty())
                scene.add_object(group.name, {group.name, 0, std::move(group.mesh)});
        if (scene.geometries.empty()) add_points(scene);
        add_warnings(scene);
        return scene;
    }

  private:
    void read_line(std::string_view keyword) {
        if (keyword == "v") {
            positions_.push_back(in_.point("vertex"));
        } else if (keyword == "f" || keyword == "fo") {
            read_face();
        } else if (keyword == "o" || keyword == "g") {
            read_name();
        } else if (!keyword.empty()) {
            if (!is_ignored(keyword) && ++unknown_lines_ == 1)
                first_unknown_ = "line " + std::to_string(in_.line()) + ": '" +
                                 std::string(keyword.substr(0, 40)) + "'";
            // The line may go on behind a backslash.
            while (!in_.word().empty()) continue;
        }
    }

    static bool is_ignored(std::string_view keyword) {
        static const std::vector<std::string_view> keywords = {
            "vt",       "vn",     "vp",     "l",    "p",          "s",        "usemtl",
            "mtllib",   "usemap", "maplib", "mg",   "cstype",     "deg",      "bmat",
            "step",     "curv",   "curv2",  "surf", "parm",       "trim",     "hole",
            "scrv",     "sp",     "end",    "con",  "bevel",      "lod",      "c_interp",
            "d_interp", "ctech",  "stech",  "call", "shadow_obj", "trace_obj"};
        return std::find(keywords.begin(), keywords.end(), keyword) != keywords.end();
    }

    void read_name() {
        name_.clear();
        for (std::string_view word = in_.word(); !word.empty(); word = in_.word()) {
            if (!name_.empty()) name_ += ' ';
            name_ += word;
        }
        group_ = kNone;
    }

    void read_face() {
        corners_.clear();
        for (std::string_view word = in_.word(); !word.empty(); word = in_.word())
            corners_.push_back(vertex_index(word));
        if (corners_.size() < 3) {
            ++small_faces_;
            return;
        }
        enter_group();
        TriangleMesh& mesh = groups_[group_].mesh;
        const size_t first = mesh.triangles.size();
        if (!triangulate(positions_, corners_, mesh.triangles))
            in_.fail("a concave face of " + std::to_string(corners_.size()) + " corners; at most " +
                     std::to_string(kMaxConcaveCorners));
        for (size_t i = first; i < mesh.triangles.size(); ++i)
            for (uint32_t& corner : mesh.triangles[i]) corner = local_index(mesh, corner);
    }

    /// The vertex of a corner "v", "v/t", "v//n" or "v/t/n"; negative ones count from the end.
    uint32_t vertex_index(std::string_view word) {
        const std::string_view first = word.substr(0, word.find('/'));
        const int64_t index = in_.number<int64_t>(first, "face");
        const int64_t count = int64_t(positions_.size());
        if (word.find_first_not_of("-+/0123456789", first.size()) != std::string_view::npos)
            in_.fail("face: '" + std::string(word.substr(0, 40)) + "' is not a corner");
        if (index == 0 || index > count || index < -count)
            in_.fail("face: vertex " + std::to_string(index) + " of " + std::to_string(count));
        return uint32_t(index > 0 ? index - 1 : count + index);
    }

    /// Makes the group of the current name the one that faces go to.
    void enter_group() {
        if (group_ != kNone) return;
        const auto [entry, is_new] = group_of_name_.emplace(name_, uint32_t(groups_.size()));
        if (is_new) groups_.push_back({name_, {}});
        group_ = entry->second;
        ++visit_;
    }

    /// The group's own number for a vertex of the file, given on first use in this run of faces.
    uint32_t local_index(TriangleMesh& mesh, uint32_t vertex) {
        if (local_.size() < positions_.size()) local_.resize(positions_.size());
        Local& local = local_[vertex];
        if (local.visit != visit_) {
            local = {visit_, uint32_t(mesh.positions.size())};
            mesh.positions.push_back(positions_[vertex]);
        }
        return local.index;
    }

    void add_points(Scene& scene) {
        if (positions_.empty()) in_.fail("the file has no vertices");
        scene.add_object(name_, {name_, 0, Points{std::move(positions_)}});
        scene.warnings.push_back("no faces: read as points");
    }

    void add_warnings(Scene& scene) const {
        if (small_faces_ > 0)
            scene.warnings.push_back(std::to_string(small_faces_) +
                                     " faces of fewer than 3 corners ignored");
        if (unknown_lines_ > 0)
            scene.warnings.push_back(std::to_string(unknown_lines_) +
                                     " lines with unknown keywords ignored, first " +
                                     first_unknown_);
    }

    static constexpr uint32_t kNone = ~uint32_t{0};
    struct Local {
        uint32_t visit = 0;
        uint32_t index = 0;
    };

    TextReader in_;
    std::vector<Vec3f> positions_;
    std::vector<Group> groups_;
    std::unordered_map<std::string, uint32_t> group_of_name_;
    std::string name_;          ///< of the group that the next face belongs to
    uint32_t group_ = kNone;    ///< its index, once it has a face
    uint32_t visit_ = 0;        ///< numbers the runs of faces of one group
    std::vector<Local> local_;  ///< per vertex of the file
    std::vector<uint32_t> corners_;
    size_t small_faces_ = 0;
    size_t unknown_lines_ = 0;
    std::string first_unknown_;
};

}  // namespace

Scene load_obj(const std::string& path) {
    const std::string text = read_file(path);
    return ObjReader(path, text).read();
}

}  // namespace crofton
