#include <algorithm>
#include <bit>
#include <cstring>
#include <filesystem>
#include <limits>

#include "framework/error.h"
#include "scenegraph/nff.h"
#include "scenegraph/obj.h"
#include "scenegraph/ply.h"
#include "scenegraph/text_reader.h"
#include "scenegraph/triangulate.h"
#include "tests/catch.h"
#include "tests/scratch_file.h"

using namespace crofton;

namespace {

using Catch::Matchers::ContainsSubstring;

const std::string kShared = CROFTON_SOURCE_DIR "/../shared";

bool shared_is_absent() {
    if (std::filesystem::exists(kShared + "/scenes")) return false;
    WARN("skipped: ../shared is absent");
    return true;
}

Scene obj(const std::string& text) { return load_obj(ScratchFile("t.obj", text).path()); }
Scene ply(const std::string& text) { return load_ply(ScratchFile("t.ply", text).path()); }
Scene nff(const std::string& text) { return load_nff(ScratchFile("t.nff", text).path()); }

const TriangleMesh& mesh_of(const Scene& scene, size_t geometry = 0) {
    return std::get<TriangleMesh>(scene.geometries.at(geometry).shapes);
}

/// Sum of the areas, signed by the direction of z.
double signed_area_z(const TriangleMesh& mesh) {
    double sum = 0;
    for (const auto& [a, b, c] : mesh.triangles) {
        const Vec3d u = (mesh.positions[b] - mesh.positions[a]).cast<double>();
        const Vec3d v = (mesh.positions[c] - mesh.positions[a]).cast<double>();
        sum += 0.5 * (u.x() * v.y() - u.y() * v.x());
    }
    return sum;
}

/// Sum of the areas, each positive.
double area_z(const TriangleMesh& mesh) {
    double sum = 0;
    for (const auto& triangle : mesh.triangles)
        sum += std::abs(signed_area_z({mesh.positions, {triangle}}));
    return sum;
}

const char* const kSquare = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

template <class T>
void put(std::string& bytes, T value, bool big_endian) {
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    if (big_endian != (std::endian::native == std::endian::big)) std::reverse(raw, raw + sizeof(T));
    bytes.append(raw, sizeof(T));
}

/// A quad with extra properties of several types, and an element that nobody knows before it.
std::string binary_quad(bool big_endian) {
    std::string text = std::string("ply\r\nformat ") +
                       (big_endian ? "binary_big_endian" : "binary_little_endian") +
                       " 1.0\r\ncomment made by hand\r\nelement odd 2\r\n"
                       "property list short double junk\r\nproperty uchar flag\r\n"
                       "element vertex 4\r\nproperty double y\r\nproperty uchar red\r\n"
                       "property float x\r\nproperty list uint short notes\r\nproperty int z\r\n"
                       "element face 1\r\nproperty uchar flags\r\n"
                       "property list int ushort vertex_index\r\nend_header\r\n";
    for (int16_t entries = 0; entries < 2; ++entries) {
        put(text, entries, big_endian);
        for (int i = 0; i < entries; ++i) put(text, 1.5, big_endian);
        put(text, uint8_t{7}, big_endian);
    }
    for (int i = 0; i < 4; ++i) {
        put(text, double(i / 2), big_endian);
        put(text, uint8_t{255}, big_endian);
        put(text, float((i + 1) / 2 % 2), big_endian);
        put(text, uint32_t{1}, big_endian);
        put(text, int16_t{-1}, big_endian);
        put(text, int32_t{-3}, big_endian);
    }
    put(text, uint8_t{0}, big_endian);
    put(text, int32_t{4}, big_endian);
    for (uint16_t i = 0; i < 4; ++i) put(text, i, big_endian);
    return text;
}

std::string ply_header(const std::string& elements, const std::string& format = "ascii") {
    return "ply\nformat " + format + " 1.0\n" + elements + "end_header\n";
}

const std::string kPlyVertices =
    "element vertex 4\nproperty float x\nproperty float y\n"
    "property float z\n";
const std::string kPlySquare = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

}  // namespace

// --- OBJ ------------------------------------------------------------------------------------

TEST_CASE("obj: corners may be v, v/t, v//n or v/t/n, counted from either end") {
    const Scene scene = obj(std::string(kSquare) + "vt 0 0\nvn 0 0 1\n" +
                            "f 1 2 3\nf 1/1 2/1 3/1\nf 1//1 2//1 3//1\nf 1/1/1 2/1/1 3/1/1\n"
                            "f -4 -3 -2\nf -4/-1/-1 2/1/1 -2/1/-1\n");
    const TriangleMesh& mesh = mesh_of(scene);
    REQUIRE(mesh.triangles.size() == 6);
    for (const auto& triangle : mesh.triangles) CHECK(triangle == mesh.triangles[0]);
    CHECK(mesh.positions.size() == 3);
}

TEST_CASE("obj: comments, CRLF, tabs, blanks, continued lines and colours are understood") {
    const Scene scene = obj(
        "# a comment \\\r\nv\t0   0 0  # origin\r\n  v 1 0 0 0.5 0.5 0.5\r\nv 1 \\\r\n 1 0 1.0\r\n"
        "s off\r\nusemtl none\r\nf 1 2 \\\r\n3\r\n");
    CHECK(mesh_of(scene).triangles.size() == 1);
    CHECK(scene.warnings.empty());
}

TEST_CASE("obj: every o and g with faces becomes an object of its name") {
    const Scene scene = obj(std::string("o empty\no left part\n") + kSquare +
                            "f 1 2 3\ng right\nf 1 3 4\no left part\nf 2 3 4\n");
    REQUIRE(scene.nodes.size() == 2);
    CHECK(scene.nodes[0].name == "left part");
    CHECK(scene.nodes[1].name == "right");
    CHECK(mesh_of(scene, 0).triangles.size() == 2);
    CHECK(mesh_of(scene, 1).triangles.size() == 1);
    CHECK(mesh_of(scene, 1).positions.size() == 3);
}

TEST_CASE("obj: numbers are read as any C library writes them, in any locale") {
    const Scene scene =
        obj("v .5 +1. -2e-1\nv 3.1+e2 1E2 1e+2\nv nan inf -Infinity\nv 1e39 1e-50 0\n"
            "f 1 2 3\nf 1 2 4\n");
    const TriangleMesh& mesh = mesh_of(scene);
    CHECK(mesh.positions[0] == Vec3f(0.5f, 1.0f, -0.2f));
    CHECK(mesh.positions[1] == Vec3f(310, 100, 100));
    CHECK(std::isnan(mesh.positions[2].x()));
    CHECK(mesh.positions[2].z() == -std::numeric_limits<float>::infinity());
    CHECK(mesh.positions[3].x() == std::numeric_limits<float>::infinity());
    CHECK(mesh.positions[3].y() == 0);
}

TEST_CASE("obj: malformed lines are refused with their number") {
    const std::pair<const char*, const char*> cases[] = {
        {"v 0 0\n", "t.obj:1: vertex: a number is missing"},
        {"v 0 0 zero\n", "t.obj:1: vertex: 'zero' is not a number"},
        {"v 0 0 1,5\n", "'1,5' is not a number"},
        {"v 0 0 0x10\n", "'0x10' is not a number"},
        {"v 0 0 1e999\n", "'1e999' is out of range"},
        {"\n\nv 0 0 0\nf 1 1 2\n", "t.obj:4: face: vertex 2 of 1"},
        {"v 0 0 0\nf 0 1 1\n", "t.obj:2: face: vertex 0 of 1"},
        {"v 0 0 0\nf -2 1 1\n", "t.obj:2: face: vertex -2 of 1"},
        {"v 0 0 0\nf 1 1 99999999999999999999\n", "out of range"},
        {"v 0 0 0\nf 1 1 1.5\n", "'1.5' is not a number"},
        {"v 0 0 0\nf 1/x 1 1\n", "'1/x' is not a corner"},
        {"", "t.obj:1: the file has no vertices"},
        {"f 1 2 3", "face: vertex 1 of 0"}};
    for (const auto& [text, what] : cases) {
        INFO(text);
        CHECK_THROWS_WITH(obj(text), ContainsSubstring(what));
    }
}

TEST_CASE("obj: lines, points and faces of two corners are left out, with a warning") {
    const Scene scene = obj(std::string(kSquare) + "l 1 2\np 1\nf 1 2\nf 1 2 3\nnonsense 1 2\n");
    CHECK(mesh_of(scene).triangles.size() == 1);
    REQUIRE(scene.warnings.size() == 2);
    CHECK_THAT(scene.warnings[0], ContainsSubstring("1 faces of fewer than 3 corners"));
    CHECK_THAT(scene.warnings[1], ContainsSubstring("'nonsense'"));
}

TEST_CASE("obj: a file with vertices only is a cloud of points") {
    const Scene scene = obj(kSquare);
    CHECK(std::get<Points>(scene.geometries.at(0).shapes).positions.size() == 4);
}

// --- Polygons with many corners -------------------------------------------------------------

TEST_CASE("triangulate: a convex polygon becomes a fan about its first corner") {
    const Scene scene = obj(std::string(kSquare) + "f 1 2 3 4\n");
    CHECK(mesh_of(scene).triangles ==
          std::vector<std::array<uint32_t, 3>>{{{0, 1, 2}}, {{0, 2, 3}}});
}

TEST_CASE("triangulate: concave polygons are covered once, whichever way they turn") {
    // A comb: teeth along the top of a bar.
    const int teeth = GENERATE(1, 2, 7, 200);
    std::vector<Vec3f> outline = {Vec3f(0, 0, 0), Vec3f(float(2 * teeth), 0, 0)};
    for (int i = teeth; i-- > 0;)
        for (const Vec3f& p : {Vec3f(2, 3, 0), Vec3f(1, 3, 0), Vec3f(1, 1, 0), Vec3f(0, 1, 0)})
            outline.push_back(p + Vec3f(float(2 * i), 0, 0));
    const bool reversed = GENERATE(false, true);
    std::vector<uint32_t> corners;
    for (uint32_t i = 0; i < outline.size(); ++i) corners.push_back(i);
    if (reversed) std::reverse(corners.begin(), corners.end());

    TriangleMesh mesh{outline, {}};
    REQUIRE(triangulate(mesh.positions, corners, mesh.triangles));
    CHECK(mesh.triangles.size() == outline.size() - 2);
    const double area = 2.0 * teeth + 2.0 * teeth;
    CHECK(area_z(mesh) == Approx(area));
    CHECK(signed_area_z(mesh) == Approx(reversed ? -area : area));
}

TEST_CASE("triangulate: outlines that are not simple still give n - 2 triangles") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const std::vector<std::vector<Vec3f>> outlines = {
        {Vec3f(0, 0, 0), Vec3f(1, 1, 0), Vec3f(1, 0, 0), Vec3f(0, 1, 0)},
        {Vec3f(0, 0, 0), Vec3f(0, 0, 0), Vec3f(0, 0, 0), Vec3f(0, 0, 0), Vec3f(0, 0, 0)},
        {Vec3f(0, 0, 0), Vec3f(1, 0, 0), Vec3f(2, 0, 0), Vec3f(3, 0, 0)},
        {Vec3f(0, 0, 0), Vec3f(1, nan, 0), Vec3f(2, 5, 0), Vec3f(3, 0, 0)},
        {Vec3f(0, 1, 0), Vec3f(0.6f, -0.8f, 0), Vec3f(-1, 0.3f, 0), Vec3f(1, 0.3f, 0),
         Vec3f(-0.6f, -0.8f, 0)}};
    for (const std::vector<Vec3f>& outline : outlines) {
        std::vector<uint32_t> corners(outline.size());
        for (uint32_t i = 0; i < corners.size(); ++i) corners[i] = i;
        std::vector<std::array<uint32_t, 3>> triangles;
        CHECK(triangulate(outline, corners, triangles));
        CHECK(triangles.size() == outline.size() - 2);
    }
}

TEST_CASE("triangulate: a huge face is a fan if convex, and refused if not") {
    std::string text = "v 0 0 0\nv 1 0 0\nv 0.2 0.2 0\nv 0 1 0\n", convex = text, concave = text;
    convex += "f", concave += "f";
    for (int i = 0; i < 200000; ++i) convex += i % 2 ? " 2" : " 2";
    for (int i = 0; i < 5000; ++i) concave += i % 2 ? " 3 4" : " 1 2";
    CHECK(mesh_of(obj(convex + "\n")).triangles.size() == 199998);
    CHECK_THROWS_WITH(obj(concave + "\n"), ContainsSubstring("at most 4096"));
}

// --- PLY ------------------------------------------------------------------------------------

TEST_CASE("ply: ascii and both binary orders give the same, whatever else is in the file") {
    const bool big_endian = GENERATE(false, true);
    const Scene scene = ply(binary_quad(big_endian));
    const TriangleMesh& mesh = mesh_of(scene);
    CHECK(mesh.positions ==
          std::vector<Vec3f>{Vec3f(0, 0, -3), Vec3f(1, 0, -3), Vec3f(1, 1, -3), Vec3f(0, 1, -3)});
    CHECK(mesh.triangles.size() == 2);

    const Scene text = ply(ply_header(kPlyVertices + "element face 1\n"
                                                     "property list uchar int vertex_indices\n") +
                           kPlySquare + "4 0 1 2 3\n");
    CHECK(mesh_of(text).triangles == mesh.triangles);
}

TEST_CASE("ply: a file cut anywhere is refused") {
    const std::string whole = binary_quad(false);
    for (size_t size = 0; size < whole.size(); ++size) {
        INFO(size);
        CHECK_THROWS_AS(ply(whole.substr(0, size)), InputError);
    }
}

TEST_CASE("ply: counts are checked against the file before memory is taken") {
    const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
    for (const char* count : {"4294967295", "9223372036854775807", "1000000000"})
        for (const char* format : {"ascii", "binary_little_endian"}) {
            const std::string text =
                ply_header(std::string("element vertex ") + count + "\n" + xyz, format);
            CHECK_THROWS_WITH(ply(text + kPlySquare),
                              ContainsSubstring("more than the file holds"));
        }
    std::string faces = ply_header(kPlyVertices +
                                   "element face 1\n"
                                   "property list uint int vertex_indices\n") +
                        kPlySquare + "4000000000 0 1 2 3\n";
    CHECK_THROWS_WITH(ply(faces), ContainsSubstring("a list of 4000000000 entries"));
}

TEST_CASE("ply: malformed files are refused with the reason") {
    const std::string faces = "element face 1\nproperty list uchar int vertex_indices\n";
    const std::pair<std::string, const char*> cases[] = {
        {"", "t.ply:1: not a PLY file"},
        {"plyx\n", "not a PLY file"},
        {"ply\nelement vertex 1\n", "no end_header"},
        {"ply\nend_header\n", "no format"},
        {"ply\nformat asci 1.0\n", "t.ply:2: unknown format 'asci'; did you mean 'ascii'?"},
        {"ply\nproperty float x\n", "a property before any element"},
        {ply_header("element vertex many\n"), "'many' is not a number"},
        {ply_header("element vertex -1\n"), "a negative count"},
        {ply_header("element vertex 1\nproperty flaot x\n"), "did you mean 'float'?"},
        {ply_header("element vertex 1\nproperty list float int x\n"), "must be an integer"},
        {ply_header("element vertex 1\nproperty float x\nproperty float y\n") + "0 0 0 0 0\n",
         "no property 'z'"},
        {ply_header(kPlyVertices) + "0 0 0\n1 0 zero\n 0 0 0 0 0 0 ", "t.ply:9: value: 'zero'"},
        {ply_header(kPlyVertices + faces) + kPlySquare + "3 0 1 4\n", "face: vertex 4"},
        {ply_header(kPlyVertices + faces) + kPlySquare + "3 0 1 -1\n", "face: vertex -1"},
        {ply_header(kPlyVertices + faces) + kPlySquare + "-3 0 1 2\n", "negative length"},
        {ply_header(kPlyVertices + faces) + kPlySquare + "3.5 0 1 2\n", "'3.5' is not a number"},
        {ply_header(kPlyVertices + "element face 1\nproperty int a\n") + kPlySquare + "3\n",
         "no list 'vertex_indices'"},
        {ply_header("element vertex 0\nproperty float x\nproperty float y\nproperty float z\n"),
         "no vertices"},
        {ply_header("comment nothing\n"), "no vertices"}};
    for (const auto& [text, what] : cases) {
        INFO(text);
        CHECK_THROWS_WITH(ply(text), ContainsSubstring(what));
    }
}

TEST_CASE("ply: triangle strips are unrolled with one orientation") {
    const Scene scene = ply(ply_header(kPlyVertices + "element tristrips 1\n"
                                                      "property list int int vertex_indices\n") +
                            "0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 1 2\n");
    const TriangleMesh& mesh = mesh_of(scene);
    CHECK(mesh.triangles.size() == 3);
    CHECK(signed_area_z(mesh) == Approx(1.5));
}

TEST_CASE("ply: without faces the vertices are points") {
    const Scene scene = ply(ply_header(kPlyVertices) + kPlySquare);
    CHECK(std::get<Points>(scene.geometries.at(0).shapes).positions.size() == 4);
    CHECK(statistics(scene).triangles_unique == 0);
}

TEST_CASE("ply: points keep their normals and radii, faces leave no use for them") {
    const std::string vertices =
        "element vertex 2\nproperty float nz\nproperty float x\nproperty float y\n"
        "property uchar red\nproperty float z\nproperty float nx\nproperty float ny\n"
        "property float radius\n";
    const std::string values = "3 10 20 255 30 1 2 0.5\n-1 11 21 0 31 0 0 0.25\n";
    const Scene scene = ply(ply_header(vertices) + values);
    const Points& points = std::get<Points>(scene.geometries.at(0).shapes);
    CHECK(points.positions == std::vector<Vec3f>{{10, 20, 30}, {11, 21, 31}});
    CHECK(points.normals == std::vector<Vec3f>{{1, 2, 3}, {0, 0, -1}});
    CHECK(points.radii == std::vector<float>{0.5f, 0.25f});
    const Scene mesh = ply(ply_header(vertices + "element face 1\n"
                                                 "property list uchar int vertex_indices\n") +
                           values + "3 0 1 0\n");
    CHECK(mesh_of(mesh).positions == std::vector<Vec3f>{{10, 20, 30}, {11, 21, 31}});
    // Two of three components are no normal.
    const Scene partial = ply(ply_header("element vertex 1\nproperty float x\nproperty float y\n"
                                         "property float z\nproperty float nx\n") +
                              "1 2 3 4\n");
    CHECK(std::get<Points>(partial.geometries.at(0).shapes).normals.empty());
}

// --- NFF ------------------------------------------------------------------------------------

TEST_CASE("nff: every entity of the format is read, comments anywhere") {
    const Scene scene =
        nff("# all of it\nb 0 0 0.5\nv\nfrom 1 2 3 # eye\nat 0 0 0\nup 0 0 1\nangle 90\nhither 1\n"
            "resolution 512 512\nl 1 1 1\nl 2 2 2 1 0.5 0\nf 1 0 0 0.5 0.5 3 0 1\ns 0 0 0 -2\n"
            "c\n0 0 0 1\n0 0 5 0\np 3\n0 0 0\n1 0 0\n0 1 0\nf 0 1 0 1 0 0 0 0\n"
            "pp 4 0 0 1 0 0 1\n1 0 1 0 0 1\n1 1 1 0 0 1\n0 1 1 0 0 1\ns 5 5 5 1");
    const Quadrics& quadrics = std::get<Quadrics>(scene.geometries.at(0).shapes);
    REQUIRE(quadrics.shapes.size() == 3);
    CHECK(std::get<Sphere>(quadrics.shapes[0]).radius == 2);
    CHECK(std::get<Cone>(quadrics.shapes[1]).apex.z() == 5);
    CHECK(std::get<Sphere>(quadrics.shapes[2]).center.x() == 5);
    const Polygons& polygons = std::get<Polygons>(scene.geometries.at(1).shapes);
    CHECK(polygons.first == std::vector<uint32_t>{0, 3, 7});
    REQUIRE(scene.cameras.size() == 1);
    CHECK(scene.cameras[0].eye == Vec3d(1, 2, 3));
    CHECK(scene.cameras[0].fov_y == Approx(1.5707963267948966));
    CHECK(scene.lights.size() == 2);
    CHECK(scene.materials.size() == 2);
    CHECK(statistics(scene).shapes_unique == 5);
}

TEST_CASE("nff: malformed files are refused with their line") {
    const std::pair<const char*, const char*> cases[] = {
        {"", "t.nff:1: the file has no shapes"},
        {"s 0 0 0", "t.nff:1: sphere: a number is missing"},
        {"s 0 0 0 nan", "not finite"},
        {"s 0 0 0 1\n\nq 1", "t.nff:3: unknown entity 'q'"},
        {"from 0 0 0", "'from' before 'v'"},
        {"v\nfrom 0 0", "a number is missing"},
        {"c 0 0 0 1 0 0 1 -1", "radii of different sign"},
        {"p 2 0 0 0 1 1 1", "fewer than 3 corners"},
        {"p 2000000000 0 0 0", "the file ends before its 2000000000 corners"},
        {"p three", "'three' is not a number"},
        {"p 3 0 0 0 1 0 0 0 1", "polygon: the file ends"}};
    for (const auto& [text, what] : cases) {
        INFO(text);
        CHECK_THROWS_WITH(nff(text), ContainsSubstring(what));
    }
}

// --- The shared files -----------------------------------------------------------------------

TEST_CASE("nff: the Standard Procedural Databases have their published counts") {
    if (shared_is_absent()) return;
    const std::pair<const char*, uint64_t> counts[] = {
        {"balls", 7382},  {"gears", 9345},  {"mount", 8196},   {"rings", 8401},
        {"teapot", 9264}, {"tetra", 4096},  {"tree", 8191},    {"lattice", 8281},
        {"jacks", 5265},  {"shells", 5761}, {"sombrero", 1922}};
    for (const auto& [name, count] : counts) {
        INFO(name);
        const Scene scene = load_scene(kShared + "/scenes/spd/" + name + ".nff");
        CHECK(statistics(scene).shapes_instanced == count);
        CHECK(scene.cameras.size() == 1);
        CHECK(!scene.lights.empty());
        CHECK(scene.warnings.empty());
    }
}

TEST_CASE("loaders: the shared meshes have the counts and bounds of their table") {
    if (shared_is_absent()) return;
    struct Row {
        const char* file;
        uint64_t triangles;
        Vec3d lower, upper;
    };
    const Row rows[] = {
        {"bun_zipper.ply", 69451, {-0.09469, 0.03299, -0.06187}, {0.06101, 0.1873, 0.0588}},
        {"dragon_vrip.ply", 871414, {-0.1083, 0.05273, -0.05041}, {0.09657, 0.1972, 0.04121}},
        {"spot.obj", 23062, {-0.4634, -0.7302, -0.6996}, {0.4642, 1.017, 1.078}},
        {"skull.obj", 100002, {-4.395, 0, -5.622}, {4.293, 13.9, 6.49}},
        {"mountain.obj", 50562, {-15.56, 7.056, -14.42}, {17.43, 24.91, 18.56}},
        {"teapot.obj", 25200, {-1.177, -0.5915, -0.8082}, {0.9902, 0.8746, 0.7915}},
        {"pond.0.ply", 0, {-1.502, 0.5714, -2.632}, {1.976, 1.092, 0.5099}}};
    for (const Row& row : rows) {
        INFO(row.file);
        const Scene scene = load_scene(kShared + "/scenes/meshes/" + row.file);
        const SceneStatistics s = statistics(scene);
        CHECK(s.triangles_unique == row.triangles);
        // The table rounds to four digits.
        for (int axis = 0; axis < 3; ++axis) {
            CHECK(s.bounds_min[axis] == Approx(row.lower[axis]).epsilon(5.1e-4).margin(1e-9));
            CHECK(s.bounds_max[axis] == Approx(row.upper[axis]).epsilon(5.1e-4).margin(1e-9));
        }
    }
}

TEST_CASE("loaders: the shared edge cases load or are refused as their manifest says") {
    if (shared_is_absent()) return;
    const std::string folder = kShared + "/scenes/edge/obj-ply/";
    const std::pair<const char*, uint64_t> loaded[] = {
        {"box.obj", 12},           {"concave_polygon.obj", 64},
        {"number_formats.obj", 1}, {"multiple_spaces.obj", 1},
        {"testmixed.obj", 12},     {"cube_with_vertexcolors.obj", 12},
        {"cube_binary.ply", 12},   {"cube_uv.ply", 12},
        {"points.ply", 0},         {"point_cloud.obj", 0}};
    for (const auto& [file, triangles] : loaded) {
        INFO(file);
        CHECK(statistics(load_scene(folder + file)).triangles_unique == triangles);
    }
    for (const char* file : {"empty.obj", "malformed.obj", "issue623.ply"})
        CHECK_THROWS_AS(load_scene(folder + file), InputError);
}
