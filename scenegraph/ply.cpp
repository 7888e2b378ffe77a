#include "scenegraph/ply.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <span>
#include <utility>

#include "scenegraph/text_reader.h"
#include "scenegraph/triangulate.h"

namespace crofton {
namespace {

enum class Type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

constexpr size_t size_of(Type type) {
    constexpr size_t sizes[] = {1, 1, 2, 2, 4, 4, 4, 8};
    return sizes[size_t(type)];
}
constexpr bool is_integer(Type type) { return type < Type::kFloat32; }

struct Property {
    std::string name;
    Type type;  ///< of the value, or of each entry of the list
    bool list = false;
    Type length_type{};  ///< of the length of the list
};

struct Element {
    std::string name;
    uint64_t count = 0;
    std::vector<Property> properties;
};

enum class Format { kAscii, kLittleEndian, kBigEndian };

struct Header {
    Format format = Format::kAscii;
    std::vector<Element> elements;
};

// --- Header ---------------------------------------------------------------------------------

class HeaderReader {
  public:
    explicit HeaderReader(TextReader& in) : in_(in) {}

    Header read() {
        if (in_.word() != "ply") in_.fail("not a PLY file: the first word must be 'ply'");
        bool has_format = false;
        for (in_.next_line(); !in_.at_end(); in_.next_line()) {
            const std::string keyword(in_.word());
            if (keyword == "end_header") {
                if (!has_format) in_.fail("the header has no format");
                in_.next_line();
                return std::move(header_);
            }
            has_format = has_format || keyword == "format";
            read_line(keyword);
        }
        in_.fail("the header has no end_header");
    }

  private:
    void read_line(const std::string& keyword) {
        static const std::vector<std::string> keywords = {"format",  "comment",  "obj_info",
                                                          "element", "property", "end_header"};
        if (keyword == "format")
            read_format();
        else if (keyword == "element")
            read_element();
        else if (keyword == "property")
            read_property();
        else if (!keyword.empty() && keyword != "comment" && keyword != "obj_info")
            in_.fail(unknown_name("header keyword", keyword.substr(0, 40), keywords));
    }

    void read_format() {
        static const std::vector<std::string> formats = {"ascii", "binary_little_endian",
                                                         "binary_big_endian"};
        const std::string name(in_.word().substr(0, 40));
        const auto found = std::find(formats.begin(), formats.end(), name);
        if (found == formats.end()) in_.fail(unknown_name("format", name, formats));
        header_.format = Format(found - formats.begin());
    }

    void read_element() {
        Element element;
        element.name = in_.word();
        const int64_t count = in_.number<int64_t>(in_.word(), "element count");
        if (count < 0) in_.fail("element '" + element.name + "': a negative count");
        element.count = uint64_t(count);
        header_.elements.push_back(std::move(element));
    }

    void read_property() {
        if (header_.elements.empty()) in_.fail("a property before any element");
        Property property;
        std::string_view type = in_.word();
        property.list = type == "list";
        if (property.list) {
            property.length_type = type_of(in_.word());
            if (!is_integer(property.length_type)) in_.fail("a list length must be an integer");
            type = in_.word();
        }
        property.type = type_of(type);
        property.name = in_.word();
        if (property.name.empty()) in_.fail("a property has no name");
        header_.elements.back().properties.push_back(std::move(property));
    }

    Type type_of(std::string_view name) {
        static const std::vector<std::string> names = {
            "int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64",
            "char", "uchar", "short", "ushort", "int",   "uint",   "float",   "double"};
        const auto found = std::find(names.begin(), names.end(), name);
        if (found == names.end())
            in_.fail(unknown_name("type", std::string(name.substr(0, 40)), names));
        return Type((found - names.begin()) % 8);
    }

    TextReader& in_;
    Header header_;
};

// --- Values ---------------------------------------------------------------------------------

/// Values of an ascii body.
class AsciiValues {
  public:
    explicit AsciiValues(TextReader& in) : in_(in) {}

    double next(Type type) {
        const std::string_view word = in_.word_across_lines();
        if (word.empty()) fail("the file ends");
        if (type == Type::kFloat32) return in_.number<float>(word, "value");
        if (type == Type::kFloat64) return in_.number<double>(word, "value");
        return double(in_.number<int64_t>(word, "integer"));
    }
    void skip(Type type, uint64_t count) {
        for (uint64_t i = 0; i < count; ++i) next(type);
    }
    size_t remaining() const { return in_.remaining(); }
    [[noreturn]] void fail(const std::string& what) const { in_.fail(what); }
    /// Fewest bytes of a value: a digit and what separates it from the next.
    static size_t least_bytes(Type) { return 2; }

  private:
    TextReader& in_;
};

/// Values of a binary body.
class BinaryValues {
  public:
    BinaryValues(const std::string& path, std::string_view bytes, bool big_endian)
        : path_(path),
          bytes_(bytes),
          swap_(big_endian != (std::endian::native == std::endian::big)) {}

    double next(Type type) {
        switch (type) {
            case Type::kInt8:
                return take<int8_t>();
            case Type::kUint8:
                return take<uint8_t>();
            case Type::kInt16:
                return take<int16_t>();
            case Type::kUint16:
                return take<uint16_t>();
            case Type::kInt32:
                return take<int32_t>();
            case Type::kUint32:
                return take<uint32_t>();
            case Type::kFloat32:
                return double(take<float>());
            case Type::kFloat64:
                return take<double>();
        }
        return 0;
    }
    void skip(Type type, uint64_t count) {
        if (count > remaining() / size_of(type)) fail("the file ends");
        at_ += count * size_of(type);
    }
    size_t remaining() const { return bytes_.size() - at_; }
    [[noreturn]] void fail(const std::string& what) const { throw InputError(path_ + ": " + what); }
    static size_t least_bytes(Type type) { return size_of(type); }

  private:
    template <class T>
    T take() {
        if (remaining() < sizeof(T)) fail("the file ends");
        char raw[sizeof(T)];
        std::memcpy(raw, bytes_.data() + at_, sizeof(T));
        if (swap_) std::reverse(raw, raw + sizeof(T));
        at_ += sizeof(T);
        T value;
        std::memcpy(&value, raw, sizeof(T));
        return value;
    }

    const std::string& path_;
    std::string_view bytes_;
    bool swap_;
    size_t at_ = 0;
};

// --- Body -----------------------------------------------------------------------------------

bool is_index_list(const Property& p) {
    return p.list && (p.name == "vertex_indices" || p.name == "vertex_index");
}

template <class Values>
class BodyReader {
  public:
    BodyReader(const Header& header, Values values) : header_(header), in_(std::move(values)) {}

    Scene read(const std::string& name) {
        for (const Element& element : header_.elements) {
            check_count(element);
            if (element.name == "vertex")
                read_vertices(element);
            else if (element.properties.empty())
                continue;
            else if (element.name == "face" || element.name == "tristrips")
                read_faces(element);
            else
                skip_element(element);
        }
        return scene(name);
    }

  private:
    /// Declared counts are worth nothing until the file is long enough for them.
    void check_count(const Element& element) const {
        uint64_t least = 0;
        for (const Property& p : element.properties)
            least += Values::least_bytes(p.list ? p.length_type : p.type);
        if (least > 0 && element.count > (in_.remaining() + 1) / least)
            in_.fail("element '" + element.name + "' declares " + std::to_string(element.count) +
                     " entries, more than the file holds");
        if (element.count > std::numeric_limits<uint32_t>::max())
            in_.fail("element '" + element.name + "': more than 2^32 - 1 entries");
    }

    void read_vertices(const Element& element) {
        if (!mesh_.positions.empty()) in_.fail("a second vertex element");
        const std::vector<Column> columns = vertex_columns(element);
        const auto has = [&](Column c) {
            return std::find(columns.begin(), columns.end(), c) != columns.end();
        };
        mesh_.positions.resize(element.count);
        if (has(kNormalX) && has(kNormalY) && has(kNormalZ)) normals_.resize(element.count);
        if (has(kRadius)) radii_.resize(element.count);
        for (size_t v = 0; v < element.count; ++v)
            for (size_t i = 0; i < columns.size(); ++i) {
                if (columns[i] == kOther) {
                    skip(element.properties[i]);
                    continue;
                }
                const float value = static_cast<float>(in_.next(element.properties[i].type));
                if (columns[i] <= kZ)
                    mesh_.positions[v][columns[i]] = value;
                else if (columns[i] == kRadius)
                    radii_[v] = value;
                else if (!normals_.empty())
                    normals_[v][columns[i] - kNormalX] = value;
            }
    }

    enum Column { kX, kY, kZ, kNormalX, kNormalY, kNormalZ, kRadius, kOther };

    /// What each property of a vertex is; normals and radii are of no use where there are faces.
    std::vector<Column> vertex_columns(const Element& element) const {
        static const char* const names[] = {"x", "y", "z", "nx", "ny", "nz", "radius"};
        std::vector<Column> columns(element.properties.size(), kOther);
        for (int c = kX; c <= (declares_faces() ? kZ : kRadius); ++c) {
            const auto found =
                std::find_if(element.properties.begin(), element.properties.end(),
                             [&](const Property& p) { return p.name == names[c] && !p.list; });
            if (found != element.properties.end())
                columns[size_t(found - element.properties.begin())] = Column(c);
            else if (c <= kZ)
                in_.fail("the vertex element has no property '" + std::string(names[c]) + "'");
        }
        return columns;
    }

    bool declares_faces() const {
        return std::any_of(header_.elements.begin(), header_.elements.end(), [](const Element& e) {
            return e.count > 0 && (e.name == "face" || e.name == "tristrips");
        });
    }

    void skip(const Property& p) { in_.skip(p.type, p.list ? length(p) : 1); }

    void skip_element(const Element& element) {
        for (uint64_t i = 0; i < element.count; ++i)
            for (const Property& p : element.properties) skip(p);
    }

    uint64_t length(const Property& p) {
        const double n = in_.next(p.length_type);
        if (n < 0) in_.fail("a list of negative length");
        if (uint64_t(n) > (in_.remaining() + 1) / Values::least_bytes(p.type))
            in_.fail("a list of " + std::to_string(uint64_t(n)) +
                     " entries, more than the file holds");
        return uint64_t(n);
    }

    void read_faces(const Element& element) {
        const bool strips = element.name == "tristrips";
        if (std::none_of(element.properties.begin(), element.properties.end(), is_index_list))
            in_.fail("element '" + element.name + "' has no list 'vertex_indices'");
        const uint64_t vertices = vertex_count();
        has_faces_ = has_faces_ || element.count > 0;
        if (!strips) mesh_.triangles.reserve(element.count);
        for (uint64_t i = 0; i < element.count; ++i) {
            for (const Property& p : element.properties) {
                if (!is_index_list(p)) {
                    skip(p);
                    continue;
                }
                read_indices(p, vertices, strips);
                strips ? add_strip() : add_face(element, i);
            }
        }
    }

    /// Faces may come before the vertices that they use.
    uint64_t vertex_count() const {
        for (const Element& element : header_.elements)
            if (element.name == "vertex") return element.count;
        return 0;
    }

    /// Fills indices_; kRestart stands for −1, which ends a strip.
    void read_indices(const Property& p, uint64_t vertices, bool strips) {
        indices_.resize(length(p));
        for (uint32_t& index : indices_) {
            const double value = in_.next(p.type);
            if (value >= 0 && value < double(vertices) && value == std::floor(value))
                index = uint32_t(value);
            else if (strips && value == -1)
                index = kRestart;
            else
                in_.fail("face: vertex " + std::to_string(value) + " of " +
                         std::to_string(vertices));
        }
    }

    void add_face(const Element& element, uint64_t face) {
        if (indices_.size() == 3) {
            mesh_.triangles.push_back({indices_[0], indices_[1], indices_[2]});
        } else if (indices_.size() < 3) {
            ++small_faces_;
        } else if (mesh_.positions.empty()) {
            in_.fail("faces of more than 3 corners stand before the vertices");
        } else if (!triangulate(mesh_.positions, indices_, mesh_.triangles)) {
            in_.fail(element.name + " " + std::to_string(face) + ": concave with " +
                     std::to_string(indices_.size()) + " corners; at most " +
                     std::to_string(kMaxConcaveCorners));
        }
    }

    /// Every other triangle of a strip is turned round, so that all face the same way.
    void add_strip() {
        size_t start = 0;
        for (size_t i = 0; i < indices_.size(); ++i) {
            if (indices_[i] == kRestart)
                start = i + 1;
            else if (i >= start + 2 && (i - start) % 2 == 0)
                mesh_.triangles.push_back({indices_[i - 2], indices_[i - 1], indices_[i]});
            else if (i >= start + 2)
                mesh_.triangles.push_back({indices_[i - 1], indices_[i - 2], indices_[i]});
        }
    }

    Scene scene(const std::string& name) {
        if (mesh_.positions.empty()) in_.fail("the file has no vertices");
        Scene scene;
        if (has_faces_)
            scene.add_object(name, {name, 0, std::move(mesh_)});
        else
            scene.add_object(
                name, {name, 0,
                       Points{std::move(mesh_.positions), std::move(normals_), std::move(radii_)}});
        if (!has_faces_) scene.warnings.push_back("no faces: read as points");
        if (small_faces_ > 0)
            scene.warnings.push_back(std::to_string(small_faces_) +
                                     " faces of fewer than 3 corners ignored");
        return scene;
    }

    static constexpr uint32_t kRestart = ~uint32_t{0};

    const Header& header_;
    Values in_;
    TriangleMesh mesh_;
    std::vector<Vec3f> normals_;  ///< of points, as are radii
    std::vector<float> radii_;
    std::vector<uint32_t> indices_;
    bool has_faces_ = false;
    size_t small_faces_ = 0;
};

}  // namespace

Scene load_ply(const std::string& path) {
    const std::string text = read_file(path);
    const std::string name = std::filesystem::path(path).stem().string();
    TextReader in(path, text, {.comments = false, .continuations = false});
    const Header header = HeaderReader(in).read();
    if (header.format == Format::kAscii) return BodyReader(header, AsciiValues(in)).read(name);
    const BinaryValues values(path, std::string_view(text).substr(in.offset()),
                              header.format == Format::kBigEndian);
    return BodyReader(header, values).read(name);
}

}  // namespace crofton
