#include "experiments/catalogue/scenes.h"

#include <Eigen/Geometry>
#include <cmath>
#include <limits>

#include "experiments/random.h"
#include "framework/error.h"
#include "scenegraph/procedural/mesh_builder.h"

namespace crofton {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

Vec3f cube_point(Pcg32& rng, double size) {
    const double x = 2 * rng.uniform() - 1, y = 2 * rng.uniform() - 1;
    return (size * Vec3d(x, y, 2 * rng.uniform() - 1)).cast<float>();
}

void add(TriangleMesh& mesh, const Vec3f& a, const Vec3f& b, const Vec3f& c) {
    const uint32_t n = uint32_t(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), {a, b, c});
    mesh.triangles.push_back({n, n + 1, n + 2});
}

Scene scene_of(TriangleMesh mesh, const Transform& world_from_object = {}) {
    Scene scene;
    scene.add_object("mesh", {"mesh", 0, std::move(mesh)}, world_from_object);
    return scene;
}

/// A closed ball, its corners mapped in double and rounded once.
TriangleMesh ball(uint32_t level, const Transform& map = {}) {
    TriangleMesh mesh = procedural::icosphere(level);
    for (Vec3f& p : mesh.positions) p = map.point(p.cast<double>()).cast<float>();
    return mesh;
}

TriangleMesh soup(int n, double size) {
    TriangleMesh mesh;
    Pcg32 rng(7);
    for (int i = 0; i < n; ++i) {
        const Vec3f c = cube_point(rng, 1), p = cube_point(rng, size), q = cube_point(rng, size);
        add(mesh, c + p, c + q, c + cube_point(rng, size));
    }
    return mesh;
}

/// Thin wedges around one corner, waved so that none is coplanar with the next.
TriangleMesh fan(int n) {
    TriangleMesh mesh;
    mesh.positions.emplace_back(0.1f, 0.2f, 0.3f);
    for (int i = 0; i < n; ++i) {
        const double a = 2 * pi * i / n;
        mesh.positions.push_back(
            Vec3d(std::cos(a), std::sin(a), 0.2 * std::sin(5 * a)).cast<float>());
    }
    for (int i = 0; i < n; ++i)
        mesh.triangles.push_back({0, uint32_t(1 + i), uint32_t(1 + (i + 1) % n)});
    return mesh;
}

/// Third corner on the line of the others, or `off` beside it.
TriangleMesh slivers(int n, double off) {
    TriangleMesh mesh;
    Pcg32 rng(11);
    for (int i = 0; i < n; ++i) {
        const Vec3f a = cube_point(rng, 1), d = uniform_direction(rng).cast<float>() * 2;
        const Vec3f side = (off * uniform_direction(rng)).cast<float>();
        add(mesh, a, a + d, a + 0.5f * d + side);
    }
    return mesh;
}

/// Integer heights on an integer grid: exact edges, corners and planes.
TriangleMesh steps(int n) {
    TriangleMesh mesh;
    for (int y = 0; y <= n; ++y)
        for (int x = 0; x <= n; ++x)
            mesh.positions.emplace_back(float(x), float(y), float((x * 7 + y * 3) % 4));
    for (int y = 0; y < n; ++y)
        for (int x = 0; x < n; ++x) {
            const uint32_t i = uint32_t(y * (n + 1) + x), j = i + uint32_t(n) + 1;
            mesh.triangles.push_back({i, i + 1, j + 1});
            mesh.triangles.push_back({i, j + 1, j});
        }
    return mesh;
}

/// Squares at one height after another: each a given number of floats above the last.
TriangleMesh sheets(int count, int ulps, float height, float size) {
    TriangleMesh mesh;
    float z = height;
    for (int i = 0; i < count; ++i) {
        const float s = size * (1 + 0.125f * float(i));
        add(mesh, {-s, -s, z}, {s, -s, z}, {s, s, z});
        add(mesh, {-s, -s, z}, {s, s, z}, {-s, s, z});
        for (int k = 0; k < ulps; ++k) z = std::nextafter(z, infinity);
    }
    return mesh;
}

/// One plane of many axis-aligned triangles, and every square twice.
TriangleMesh coplanar(int n) {
    TriangleMesh mesh;
    for (int copy = 0; copy < 2; ++copy)
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x) {
                const Vec3f a(float(x), float(y), 1), b(float(x + 1), float(y), 1),
                    c(float(x + 1), float(y + 1), 1), d(float(x), float(y + 1), 1);
                add(mesh, a, b, c);
                add(mesh, a, c, d);
            }
    return mesh;
}

TriangleMesh duplicates(int n) {
    TriangleMesh mesh;
    mesh.positions = {{-1, -1, 0}, {1, -1, 0.25f}, {0, 1, 0}};
    mesh.triangles.assign(size_t(n), {0, 1, 2});
    return mesh;
}

TriangleMesh nested_sizes(int n) {
    TriangleMesh mesh;
    for (int i = 1; i <= n; ++i) {
        const float s = float(i);
        add(mesh, {-s, -s, 0}, {s, -s, 0}, {0, 2 * s, 0});
    }
    return mesh;
}

TriangleMesh broken() {
    TriangleMesh mesh = soup(60, 0.4);
    add(mesh, {0, 0, 0}, {0, 0, 0}, {0, 0, 0});
    add(mesh, {0, 0, 0}, {1, 1, 1}, {0.5f, 0.5f, 0.5f});
    add(mesh, {0, 0, 0}, {1, 0, 0}, {1, 0, 0});
    add(mesh, {nan, 0, 0}, {1, 0, 0}, {0, 1, 0});
    add(mesh, {0, 0, infinity}, {1, 0, 0}, {0, 1, 0});
    add(mesh, {0, 0, 0}, {1, 0, 0}, {0.5f, 1e-38f, 0});
    add(mesh, {-1, -1, 0}, {1, -1, 1e-7f}, {0, 1, 0});
    return mesh;
}

TriangleMesh powers_of_two() {
    TriangleMesh mesh;
    for (int e = -60; e <= 58; ++e) {
        const float s = std::ldexp(1.0f, e);
        add(mesh, {s, 0, 0}, {s * 1.5f, s * 0.3f, 0}, {s, 0, s * 0.5f});
    }
    return mesh;
}

/// A detailed ball of size 1 in a ring of size 1e6.
TriangleMesh ball_in_stadium() {
    TriangleMesh mesh = ball(2);
    for (int i = 0; i < 48; ++i) {
        const double a = 2 * pi * i / 48, b = 2 * pi * (i + 1) / 48;
        const Vec3f p = Vec3d(1e6 * std::cos(a), 1e6 * std::sin(a), -10).cast<float>(),
                    q = Vec3d(1e6 * std::cos(b), 1e6 * std::sin(b), -10).cast<float>();
        const Vec3f up(0, 0, 3e5f);
        add(mesh, p, q, p + up);
        add(mesh, q, q + up, p + up);
    }
    return mesh;
}

Transform shear(double amount) {
    Transform t;
    t.linear(0, 1) = amount;
    t.linear(2, 0) = -amount / 2;
    return t;
}

/// 32 maps above a ball: turns, shears, mirrors, scales of 1e3 and 1e-3 in turns.
Scene nested_maps() {
    Scene scene;
    std::optional<uint32_t> parent;
    for (int i = 0; i < 32; ++i) {
        Transform t = translation({0.1 * i, -0.05, 0.02 * i}) *
                      rotation(Vec3d(1, i % 3, 0.5).normalized(), 0.3 + 0.1 * i) *
                      scaling(Vec3d::Constant(i % 2 ? 1e-3 : 1e3));
        if (i % 5 == 0) t = t * shear(0.1);
        if (i % 7 == 0) t = t * scaling({1, -1, 1});
        parent = scene.add_node("n", {}, t, parent);
    }
    const uint32_t leaf = scene.add_object("ball", {"ball", 0, ball(1)}, {}, parent);
    scene.add_node("second", scene.nodes[leaf].mesh, translation({3, 0, 0}), parent);
    return scene;
}

/// Placements that meet: turned, mirrored, squeezed, and one beside another at its surface.
Scene instances() {
    Scene scene;
    const uint32_t first = scene.add_object("ball", {"ball", 0, ball(1)});
    const uint32_t mesh = *scene.nodes[first].mesh;
    scene.add_node("turned", mesh, translation({2, 0, 0}) * rotation(Vec3d::UnitZ(), 1));
    scene.add_node("mirrored", mesh, translation({0, 2, 0}) * scaling({-1, 1, 1}));
    scene.add_node("squeezed", mesh, translation({0, 0, 3}) * scaling({1e3, 1, 1e-3}));
    scene.add_node("sheared", mesh, translation({-3, 0, 0}) * shear(2));
    scene.add_node("again", mesh);
    return scene;
}

Scene ill_conditioned() {
    return scene_of(ball(2), rotation(Vec3d(1, 1, 0).normalized(), 0.4) * scaling({1e4, 1, 1e-3}) *
                                 rotation(Vec3d::UnitX(), 0.3));
}

/// Maps without an inverse leave their objects out; the ball in the middle stays.
Scene singular_maps() {
    Scene scene = scene_of(ball(1));
    const uint32_t mesh = *scene.nodes[0].mesh;
    scene.add_node("flat", mesh, scaling({1, 0, 1}));
    scene.add_node("line", mesh, scaling({1, 0, 0}));
    scene.add_node("nan", mesh, translation({nan, 0, 0}));
    scene.add_node("vast", mesh, scaling({1e200, 1, 1}));
    return scene;
}

Scene quadrics_of(std::vector<Quadric> shapes, const Transform& map = {}) {
    Scene scene;
    scene.add_object("quadrics", {"quadrics", 0, Quadrics{std::move(shapes)}}, map);
    return scene;
}

std::vector<Quadric> quadric_soup() {
    Pcg32 rng(21);
    std::vector<Quadric> shapes;
    for (int i = 0; i < 60; ++i) {
        const Vec3f c = cube_point(rng, 2), e = c + cube_point(rng, 0.8);
        const float r = float(0.02 + 0.38 * rng.uniform());
        if (i % 3 == 0) shapes.push_back(Sphere{c, r});
        if (i % 3 == 1) shapes.push_back(Cone{c, r, e, i % 6 == 1 ? r : i % 6 == 4 ? 0 : r / 3});
        if (i % 3 == 2)
            shapes.push_back(
                Disc{c, r, uniform_direction(rng).cast<float>(), i % 6 == 2 ? 0 : r / 3});
    }
    return shapes;
}

/// Axis-parallel and integer, with every kind of end: what rays can touch exactly.
std::vector<Quadric> exact_quadrics() {
    return {Sphere{{0, 0, 0}, 5},
            Sphere{{0, 0, 0}, 0},
            Cone{{12, 0, -2}, 1, {12, 0, 2}, 1},
            Cone{{-12, 0, -2}, 3, {-12, 0, 1}, 0},
            Cone{{0, 12, 0}, 2, {4, 12, 0}, 2},
            Cone{{0, -12, 0}, 0, {0, -12, 1}, 0},
            Cone{{5, 5, 5}, 1, {5, 5, 5}, 1},
            Disc{{0, 0, 9}, 5, {0, 0, 2}, 3},
            Disc{{0, 0, -9}, 4, {1, 0, 0}},
            Disc{{9, 9, 9}, 0, {0, 0, 1}}};
}

Scene far_spheres() {
    return quadrics_of({Sphere{{1e4f, 0, 0}, 1e-3f}, Sphere{{0, 1e4f, 1}, 1e-2f},
                        Sphere{{0, 0, -1e6f}, 1e6f}, Sphere{{0, 0, 1}, 1}});
}

Scene polygons() {
    Polygons shapes;
    shapes.first.push_back(0);
    Pcg32 rng(31);
    const auto end = [&] { shapes.first.push_back(uint32_t(shapes.positions.size())); };
    // Stars in integer planes, where corners are exact and the axis-parallel rays meet edges.
    constexpr int star[8][2] = {{-3, 0}, {-1, -1}, {0, -3}, {1, -1},
                                {3, 0},  {1, 1},   {0, 3},  {-1, 1}};
    for (int i = 0; i < 9; ++i) {
        for (const auto& [x, y] : star) {
            const float a = float(x + 4 * (i / 3)), b = float(y), c = float(i);
            shapes.positions.push_back(i % 3 == 0   ? Vec3f(a, b, c)
                                       : i % 3 == 1 ? Vec3f(c, a, b)
                                                    : Vec3f(a, b, a + 2 * b));
        }
        end();
    }
    for (int i = 0; i < 30; ++i) {
        const Vec3d n = uniform_direction(rng), c = cube_point(rng, 3).cast<double>();
        const Vec3d u = n.unitOrthogonal(), v = n.cross(u);
        const int corners = 3 + int(rng.below(9));
        for (int k = 0; k < corners; ++k) {
            const double angle = 2 * pi * k / corners, r = k % 2 ? 0.5 : 0.2;
            shapes.positions.push_back(
                (c + r * (u * std::cos(angle) + v * std::sin(angle))).cast<float>());
        }
        end();
    }
    Scene scene;
    scene.add_object("polygons", {"polygons", 0, std::move(shapes)});
    return scene;
}

Scene everything() {
    Scene scene = instances();
    const Transform map = translation({0, -4, 0}) * rotation(Vec3d(1, 2, 3).normalized(), 0.5) *
                          scaling({1, 0.5, -1.5});
    scene.add_object("quadrics", {"quadrics", 0, Quadrics{quadric_soup()}}, map);
    Scene other = polygons();
    scene.add_object("polygons", other.geometries[0], map);
    return scene;
}

Scene empty() {
    Scene scene;
    scene.add_object("nothing", {"nothing", 0, TriangleMesh{}});
    return scene;
}

std::vector<CatalogueScene> make_list() {
    std::vector<CatalogueScene> list;
    const auto add_case = [&](std::string name, std::string why, std::function<Scene()> make) {
        list.push_back({std::move(name), std::move(why), std::move(make)});
    };
    const auto mesh_case = [&](std::string name, std::string why, auto make) {
        add_case(std::move(name), std::move(why), [make] { return scene_of(make()); });
    };
    mesh_case("ball", "closed; every corner and edge is inside", [] { return ball(3); });
    mesh_case("soup", "random triangles", [] { return soup(400, 0.3); });
    mesh_case("steps", "integer corners: exact edges, corners, planes and ties",
              [] { return steps(12); });
    for (int n : {3, 17, 128, 1024})
        mesh_case("fan_" + std::to_string(n), "wedges that share one corner",
                  [n] { return fan(n); });
    mesh_case("slivers", "aspect 1e7", [] { return slivers(200, 1e-7); });
    mesh_case("collinear", "no area, but for rounding", [] { return slivers(200, 0); });
    mesh_case("duplicates", "one triangle 2000 times", [] { return duplicates(2000); });
    mesh_case("nested_sizes", "one centroid, one plane, growing sizes",
              [] { return nested_sizes(400); });
    mesh_case("coplanar", "axis-aligned triangles in one plane, every one twice",
              [] { return coplanar(16); });
    for (int ulps : {1, 4, 16})
        mesh_case("sheets_" + std::to_string(ulps), "squares that many floats apart",
                  [ulps] { return sheets(6, ulps, 1, 1); });
    for (int e : {-20, -12, -6, 6, 12, 18})
        mesh_case("ball_1e" + std::to_string(e), "a closed ball of this radius",
                  [e] { return ball(2, scaling(Vec3d::Constant(std::pow(10.0, e)))); });
    mesh_case("anisotropic", "a closed ball, 1e3 by 1 by 1e-3", [] {
        return ball(2, scaling({1e3, 1, 1e-3}));
    });
    for (int e : {4, 6, 8})
        mesh_case("moved_1e" + std::to_string(e), "a ball so far out, corners rounded there", [e] {
            return ball(2, translation(Vec3d(1, -1.5, 0.7) * std::pow(10.0, e)) *
                               scaling(Vec3d::Constant(std::pow(10.0, e - 4))));
        });
    mesh_case("stadium", "a ball of size 1 in a ring of size 1e6",
              [] { return ball_in_stadium(); });
    mesh_case("powers_of_two", "one triangle at every power of two from 2^-60 to 2^58",
              [] { return powers_of_two(); });
    mesh_case("broken", "no area, NaN, infinity among good ones", [] { return broken(); });
    mesh_case("one", "a single triangle", [] { return duplicates(1); });
    add_case("empty", "nothing to hit", empty);
    add_case("instances", "turned, mirrored, sheared, squeezed, twice in one place", instances);
    add_case("nested_maps", "32 maps in a chain, scales of 1e3 and 1e-3", nested_maps);
    add_case("ill_conditioned", "a map of condition 1e7", ill_conditioned);
    add_case("singular_maps", "maps without an inverse", singular_maps);
    add_case("quadrics", "spheres, cones, cylinders, discs",
             [] { return quadrics_of(quadric_soup()); });
    add_case("quadrics_mapped", "the same, sheared and squeezed", [] {
        return quadrics_of(quadric_soup(), shear(0.7) * scaling({3, 1, 0.1}));
    });
    add_case("quadrics_exact", "integer quadrics: touched, ended, of radius 0",
             [] { return quadrics_of(exact_quadrics()); });
    add_case("far_spheres", "radius 1e-3 at 1e4; a ground of radius 1e6", far_spheres);
    add_case("polygons", "stars in integer and random planes", polygons);
    add_case("everything", "all kinds of shapes, instanced", everything);
    return list;
}

}  // namespace

const std::vector<CatalogueScene>& catalogue_scenes() {
    static const std::vector<CatalogueScene> list = make_list();
    return list;
}

Scene catalogue_scene(const std::string& name) {
    std::vector<std::string> names;
    for (const CatalogueScene& c : catalogue_scenes()) {
        names.push_back(c.name);
        if (c.name != name) continue;
        Scene scene = c.make();
        scene.name = name;
        scene.source = "catalogue:" + name;
        return scene;
    }
    throw InputError(unknown_name("catalogue scene", name, names));
}

}  // namespace crofton
