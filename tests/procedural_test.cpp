#include "scenegraph/procedural/procedural.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <filesystem>

#include "framework/error.h"
#include "scenegraph/nff.h"
#include "scenegraph/procedural/deterministic.h"
#include "tests/catch.h"

using namespace crofton;

namespace {

using Catch::Matchers::ContainsSubstring;
using Row = std::array<double, 9>;

const std::string kSpd = CROFTON_SOURCE_DIR "/../shared/scenes/spd/";

bool shared_is_absent() {
    if (std::filesystem::exists(kSpd)) return false;
    WARN("skipped: ../shared is absent");
    return true;
}

Row row_of(const Quadric& quadric) {
    if (const Sphere* s = std::get_if<Sphere>(&quadric))
        return {s->center.x(), s->center.y(), s->center.z(), s->radius, 0, 0, 0, 0, 1};
    const Cone& c = std::get<Cone>(quadric);
    return {c.base.x(), c.base.y(),    c.base.z(), c.base_radius, c.apex.x(), c.apex.y(),
            c.apex.z(), c.apex_radius, 2};
}

std::vector<Row> rows_of(const Quadrics& quadrics) {
    std::vector<Row> rows;
    for (const Quadric& q : quadrics.shapes) rows.push_back(row_of(q));
    return rows;
}

/// Three corners, the lowest first, with their orientation.
Row row_of(std::array<Vec3f, 3> corners) {
    const auto less = [](const Vec3f& a, const Vec3f& b) {
        return std::lexicographical_compare(a.data(), a.data() + 3, b.data(), b.data() + 3);
    };
    std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end(), less),
                corners.end());
    Row row;
    for (int i = 0; i < 9; ++i) row[size_t(i)] = corners[size_t(i / 3)][i % 3];
    return row;
}

bool near(const Row& a, const Row& b, double tolerance) {
    for (size_t k = 0; k < a.size(); ++k)
        if (!(std::abs(a[k] - b[k]) <= tolerance)) return false;
    return true;
}

/// How many rows of `a` have a partner of their own in `b` within `tolerance`.
size_t matches(const std::vector<Row>& a, std::vector<Row> b, double tolerance) {
    std::sort(b.begin(), b.end());
    std::vector<bool> taken(b.size());
    size_t count = 0;
    for (const Row& row : a) {
        Row low = row;
        low[0] -= 2 * tolerance;
        for (auto it = std::lower_bound(b.begin(), b.end(), low);
             it != b.end() && (*it)[0] <= row[0] + 2 * tolerance; ++it) {
            const size_t index = size_t(it - b.begin());
            if (taken[index] || !near(row, *it, tolerance)) continue;
            taken[index] = true;
            ++count;
            break;
        }
    }
    return count;
}

/// FNV-1a over the bits of all positions.
uint64_t fingerprint(const Scene& scene) {
    uint64_t hash = 14695981039346656037u;
    for (const Geometry& g : scene.geometries)
        if (const TriangleMesh* mesh = std::get_if<TriangleMesh>(&g.shapes))
            for (const Vec3f& p : mesh->positions)
                for (int axis = 0; axis < 3; ++axis)
                    hash = (hash ^ std::bit_cast<uint32_t>(p[axis])) * 1099511628211u;
    return hash;
}

const Quadrics& quadrics_of(const Scene& scene) {
    return std::get<Quadrics>(scene.geometries.at(0).shapes);
}

}  // namespace

TEST_CASE("procedural: every scene of the registry is made from its defaults") {
    for (const ProceduralScene& entry : procedural_scenes()) {
        INFO(entry.name);
        const Scene scene = make_scene(entry.name);
        const SceneStatistics s = statistics(scene);
        CHECK(scene.name == entry.name);
        CHECK(scene.source == "procedural:" + entry.name);
        CHECK(s.shapes_instanced > 0);
        CHECK((s.bounds_min.array() < s.bounds_max.array()).any());
        CHECK(s.zero_area_triangles_object_space == 0);
        CHECK(scene.cameras.size() == 1);
        CHECK(!scene.lights.empty());
        for (const ProceduralParameter& p : entry.parameters) {
            CHECK(p.default_value >= p.minimum);
            CHECK(p.default_value <= p.maximum);
        }
    }
}

TEST_CASE("procedural: unknown names and values out of range are refused") {
    CHECK_THROWS_WITH(make_scene("stadion"), ContainsSubstring("did you mean 'stadium'?"));
    CHECK_THROWS_WITH(make_scene("terrain", {{"sise", 3}}),
                      ContainsSubstring("did you mean 'size'?"));
    CHECK_THROWS_WITH(make_scene("cornell_box", {{"n", 3}}),
                      ContainsSubstring("unknown parameter 'n'"));
    CHECK_THROWS_WITH(make_scene("terrain", {{"n", 0}}),
                      ContainsSubstring("n = 0; it must be an integer from 1 to 4096"));
    CHECK_THROWS_AS(make_scene("terrain", {{"n", 2.5}}), InputError);
    CHECK_THROWS_AS(make_scene("terrain", {{"size", std::nan("")}}), InputError);
}

TEST_CASE("procedural: counts follow from the parameters") {
    const auto counts = [](const char* name, const ProceduralValues& values) {
        return statistics(make_scene(name, values));
    };
    CHECK(counts("terrain", {{"n", 7}}).triangles_unique == 98);
    CHECK(counts("hairball", {{"triangles", 1000}}).triangles_unique == 1056);
    CHECK(counts("random_triangles", {{"n", 17}}).triangles_unique == 17);
    CHECK(counts("grid_of_spheres", {{"n", 3}}).shapes_unique == 27);
    CHECK(counts("cornell_box", {}).triangles_unique == 32);
    CHECK(counts("menger", {{"depth", 3}}).triangles_unique == 12);
    CHECK(counts("menger", {{"depth", 3}}).mesh_instances == 8000);
    CHECK(counts("menger", {{"depth", 3}}).depth == 7);
    CHECK(counts("thicket", {{"n", 7}, {"triangles", 100}}).triangles_unique == 108);
    CHECK(counts("thicket", {{"n", 7}}).mesh_instances == 7);
    const SceneStatistics flake = counts("sphereflake", {{"depth", 2}, {"tessellation", 3}});
    CHECK(flake.triangles_unique == 320 + 2);
    CHECK(flake.mesh_instances == 91 + 1);
}

TEST_CASE("procedural: the stadium is as wide as asked, with the pedestal's top at the origin") {
    const Scene scene = make_scene("stadium", {{"size", 1000}});
    const SceneStatistics s = statistics(scene);
    CHECK(s.triangles_instanced >= 1000);
    CHECK(s.triangles_instanced <= 10000);
    CHECK(s.bounds_max.x() - s.bounds_min.x() <= 1000.001);
    CHECK(s.bounds_max.x() - s.bounds_min.x() >= 700);
    Scene pedestal = scene;
    pedestal.roots.clear();
    for (uint32_t i = 0; i < scene.nodes.size(); ++i)
        if (scene.nodes[i].name == "pedestal") pedestal.roots.push_back(i);
    CHECK(statistics(pedestal).bounds_max == Vec3d(0.5, 0, 0.5));
}

TEST_CASE("procedural: closed meshes face outwards") {
    for (const char* name : {"menger", "grid_of_spheres"}) {
        ProceduralValues values;
        if (name == std::string("grid_of_spheres")) values["tessellation"] = 4;
        const Scene scene = make_scene(name, values);
        const auto& mesh = std::get<TriangleMesh>(scene.geometries.at(0).shapes);
        double volume = 0;
        for (const auto& [a, b, c] : mesh.triangles)
            volume += mesh.positions[a].cross(mesh.positions[b]).dot(mesh.positions[c]) / 6.0;
        // A cube of 1 and an icosphere just short of the ball's 4.19.
        CHECK(volume == Approx(name == std::string("menger") ? 1.0 : 4.15).epsilon(0.02));
    }
}

TEST_CASE("procedural: the bits do not depend on the platform") {
    CHECK(fingerprint(make_scene("stadium")) == 0x662b3db8708dd88bu);
    CHECK(fingerprint(make_scene("terrain", {{"n", 64}})) == 0xa2b2bf5539b8720eu);
    CHECK(fingerprint(make_scene("hairball", {{"triangles", 9600}})) == 0x160e2536dfa7c2c2u);
    CHECK(fingerprint(make_scene("random_triangles", {{"n", 1000}})) == 0x86b4321a965c09a5u);
    CHECK(fingerprint(make_scene("random_triangles", {{"seed", 2}})) !=
          fingerprint(make_scene("random_triangles")));
}

TEST_CASE("procedural: cosine and sine agree with the library within 1e-15") {
    for (int i = -400; i <= 400; ++i) {
        const double turns = i / 137.0;
        const procedural::CosSin a = procedural::cos_sin(turns);
        const double angle = 2 * 3.141592653589793 * (turns - std::floor(turns));
        CHECK(std::abs(a.cos - std::cos(angle)) < 2e-15);
        CHECK(std::abs(a.sin - std::sin(angle)) < 2e-15);
    }
}

TEST_CASE("procedural: generators give the shapes of the Standard Procedural Databases") {
    if (shared_is_absent()) return;
    // The files have six significant digits.
    const std::pair<const char*, const char*> pairs[] = {
        {"sphereflake", "balls"}, {"lattice", "lattice"}, {"jacks", "jacks"}};
    for (const auto& [name, file] : pairs) {
        INFO(name);
        const Scene expected = load_nff(kSpd + file + ".nff");
        const Scene made = make_scene(name);
        const std::vector<Row> shapes = rows_of(quadrics_of(expected));
        REQUIRE(quadrics_of(made).shapes.size() == shapes.size());
        // Below one of the spheres that point straight down, balls.nff turns 9 + 81 otherwise.
        const size_t free = name == std::string("sphereflake") ? 90 : 0;
        CHECK(matches(rows_of(quadrics_of(made)), shapes, 6e-6) >= shapes.size() - free);
        CHECK((made.cameras[0].eye - expected.cameras[0].eye).norm() < 1e-5);
        CHECK((made.cameras[0].at - expected.cameras[0].at).norm() < 1e-5);
        CHECK(made.cameras[0].fov_y == Approx(expected.cameras[0].fov_y));
        CHECK(made.lights.size() == expected.lights.size());
    }
    const Scene expected = load_nff(kSpd + "tetra.nff"), made = make_scene("tetra");
    const auto& polygons = std::get<Polygons>(expected.geometries.at(0).shapes);
    const auto& mesh = std::get<TriangleMesh>(made.geometries.at(0).shapes);
    std::vector<Row> a, b;
    for (uint32_t i = 0; i < polygons.size(); ++i) {
        const Vec3f* p = &polygons.positions[polygons.first[i]];
        a.push_back(row_of({p[0], p[1], p[2]}));
    }
    for (const auto& t : mesh.triangles)
        b.push_back(row_of({mesh.positions[t[0]], mesh.positions[t[1]], mesh.positions[t[2]]}));
    CHECK(a.size() == b.size());
    CHECK(matches(a, b, 6e-6) == a.size());
}
