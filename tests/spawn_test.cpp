// Rays that leave surfaces: they do not hit what they leave, and do not get out of closed meshes.

#include <Eigen/Geometry>
#include <cmath>

#include "framework/registry.h"
#include "framework/surface_point.h"
#include "framework/triangle_set.h"
#include "scenegraph/assemble.h"
#include "scenegraph/shading.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

constexpr double pi = 3.14159265358979323846;

/// A unit direction at this angle to the normal.
Vec3d tilted(const Vec3d& normal, double angle, double around) {
    const Vec3d s = normal.unitOrthogonal(), t = normal.cross(s);
    return std::cos(angle) * normal +
           std::sin(angle) * (std::cos(around) * s + std::sin(around) * t);
}

struct ClosedMesh {
    std::string name;
    std::vector<Vec3f> p;
    std::vector<TriangleSet::Indices> t;
    bool convex;
};

/// A torus: closed, with all signs of curvature.
ClosedMesh torus() {
    ClosedMesh mesh{"torus", {}, {}, false};
    const uint32_t m = 40, n = 20;
    for (uint32_t i = 0; i < m; ++i)
        for (uint32_t j = 0; j < n; ++j) {
            const double a = 2 * pi * i / m, b = 2 * pi * j / n, r = 1 + 0.4 * std::cos(b);
            mesh.p.push_back(
                Vec3f(float(r * std::cos(a)), float(r * std::sin(a)), float(0.4 * std::sin(b))));
            const uint32_t k = (i + 1) % m, l = (j + 1) % n;
            mesh.t.push_back({i * n + j, k * n + j, k * n + l});
            mesh.t.push_back({i * n + j, k * n + l, i * n + l});
        }
    return mesh;
}

ClosedMesh cube() {
    ClosedMesh mesh{"cube", {}, {}, true};
    for (int i = 0; i < 8; ++i)
        mesh.p.push_back(Vec3f(i & 1 ? 1.f : -1.f, i & 2 ? 1.f : -1.f, i & 4 ? 1.f : -1.f));
    mesh.t = {{0, 1, 3}, {0, 3, 2}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
              {2, 3, 7}, {2, 7, 6}, {0, 2, 6}, {0, 6, 4}, {1, 3, 7}, {1, 7, 5}};
    return mesh;
}

std::vector<ClosedMesh> meshes() {
    ClosedMesh ball{"ball", {}, {}, true};
    test::icosphere(3, ball.p, ball.t);
    return {ball, torus(), cube()};
}

struct Tally {
    size_t rays = 0, self_hits = 0, leaks = 0;
};

/// Lets rays bounce about inside a closed mesh, from `start`. Each must hit something, and not the
/// triangle that it left.
void bounce_inside(const Primitive& object, const std::vector<Vec3f>& p,
                   const std::vector<TriangleSet::Indices>& t, const Vec3f& start, size_t count,
                   test::Random& random, Tally& tally) {
    Ray ray;
    Hit hit;
    for (size_t i = 0; i < count; ++i) {
        if (!hit.is_hit()) {
            ray.origin = start;
            ray.direction = random.direction();
            // Every other path starts at an edge or a corner.
            if (i & 1) {
                const auto& at = t[random.next() % t.size()];
                const float s = random.next() & 1 ? 0 : random.uniform();
                ray.direction = p[at[0]] + s * (p[at[1]] - p[at[0]]) - start;
            }
            hit = object.intersect(ray);
            REQUIRE(hit.is_hit());
        }
        const auto& at = t[hit.primitive];
        const Vec3f corners[3] = {p[at[0]], p[at[1]], p[at[2]]};
        const SurfacePoint from = triangle_point(corners, hit, ray.direction);
        // A third of them graze the surface at 89.99° and beyond.
        const double tilt = i % 3 ? std::acos(std::sqrt(double(random.uniform())))
                                  : pi / 2 - 2e-4 * double(random.uniform());
        ray = spawn_ray(from, tilted(from.normal, tilt, 2 * pi * double(random.uniform())));
        const Hit next = object.intersect(ray);
        ++tally.rays;
        tally.self_hits += next.primitive == hit.primitive;
        tally.leaks += !next.is_hit();
        hit = i % 8 == 7 ? Hit{} : next;
    }
}

/// From the outside of a convex mesh, a ray that leaves never comes back.
void leave_outside(const Primitive& object, const std::vector<Vec3f>& p,
                   const std::vector<TriangleSet::Indices>& t, const Vec3f& center, float size,
                   size_t count, test::Random& random, Tally& tally) {
    for (size_t i = 0; i < count; ++i) {
        const Vec3f origin = center + 4 * size * random.direction();
        const Ray ray{origin, 0, center + 0.9f * size * random.point(0.5f) - origin};
        const Hit hit = object.intersect(ray);
        if (!hit.is_hit()) continue;
        const auto& at = t[hit.primitive];
        const Vec3f corners[3] = {p[at[0]], p[at[1]], p[at[2]]};
        const SurfacePoint from = triangle_point(corners, hit, ray.direction);
        const double tilt = i % 3 ? std::acos(std::sqrt(double(random.uniform())))
                                  : pi / 2 - 2e-4 * double(random.uniform());
        const Ray next =
            spawn_ray(from, tilted(from.normal, tilt, 2 * pi * double(random.uniform())));
        ++tally.rays;
        tally.self_hits += object.occluded(next);
    }
}

}  // namespace

TEST_CASE(
    "spawn: a million rays in closed meshes of sizes 1e-6 to 1e6 hit neither what they leave "
    "nor nothing") {
    test::Random random(7);
    Tally total;
    for (const ClosedMesh& mesh : meshes())
        for (const float size : {1e-6f, 1e-3f, 1.0f, 1e3f, 1e6f})
            for (const float away : {0.0f, 3.0f, 100.0f}) {
                // Away from the world's origin coordinates have fewer digits for the same mesh.
                const Vec3f shift = away * size * Vec3f(1, -0.7f, 0.4f);
                std::vector<Vec3f> p = mesh.p;
                for (Vec3f& v : p) v = v * size + shift;
                const auto set = std::make_shared<const TriangleSet>(p, mesh.t);
                const auto object = accelerator("bvh").build(set, {});
                const Vec3f start = shift + (mesh.name == "torus" ? size : 0.0f) * Vec3f(1, 0, 0);
                Tally tally;
                bounce_inside(*object, p, mesh.t, start, 20000, random, tally);
                if (mesh.convex)
                    leave_outside(*object, p, mesh.t, shift, size, 10000, random, tally);
                INFO(mesh.name << " of size " << size << ", " << away << " sizes away");
                CHECK(tally.self_hits == 0);
                CHECK(tally.leaks == 0);
                total.rays += tally.rays;
            }
    CHECK(total.rays > 1000000);
}

TEST_CASE("spawn: rays leave instanced triangles, spheres, cones, discs and polygons") {
    Quadrics quadrics;
    quadrics.shapes = {Sphere{Vec3f::Zero(), 1}, Cone{Vec3f(3, 0, -1), 1, Vec3f(3, 0, 1), 0.5f},
                       Disc{Vec3f(6, 0, 0), 1, Vec3f(0, 0.3f, 1), 0}};
    Polygons polygons;
    polygons.positions = {{8, -1, 0.2f}, {10, -1, 0.2f}, {10, 1, -0.3f}, {8, 1, -0.3f}};
    polygons.first = {0, 4};
    ClosedMesh ball = meshes()[0];
    for (Vec3f& v : ball.p) v.x() += 12;
    for (const double size : {1e-5, 1.0, 1e5}) {
        Scene scene;
        Transform map = scaling(Vec3d(size, 1.3 * size, 0.8 * size)) *
                        rotation(Vec3d(1, 2, 3).normalized(), 0.7);
        map.translation = size * Vec3d(20, -5, 7);
        const auto add = [&](const char* name, auto shapes) {
            Geometry geometry;
            geometry.shapes = std::move(shapes);
            scene.add_object(name, geometry, map);
        };
        add("quadrics", quadrics);
        add("polygons", polygons);
        add("ball", TriangleMesh{ball.p, ball.t});
        const auto choice = std::make_shared<AcceleratorChoice>();
        choice->label = choice->type = "bvh";
        AssemblyPlan plan;
        plan.top = plan.objects = choice;
        plan.bake = false;
        const Assembly assembly = assemble(scene, plan);
        const auto instances = mesh_instances(scene);
        test::Random random(3);
        size_t self_hits = 0, spawned = 0, kinds = 0;
        for (int i = 0; i < 40000; ++i) {
            const Vec3d target =
                map.point(Vec3d(double(random.uniform(-1, 13)), double(random.uniform(-1, 1)),
                                double(random.uniform(-1, 1))));
            const Vec3d origin = target + 30 * size * random.direction().cast<double>();
            const Ray ray{origin.cast<float>(), 0, (target - origin).cast<float>()};
            const Hit hit = assembly.root->intersect(ray);
            const auto from = surface_point(scene, instances, hit, ray);
            if (!from) continue;
            kinds |= size_t{1} << (hit.instance * 3 + (hit.instance == 0 ? hit.primitive : 0));
            const double tilt = i % 3 ? std::acos(std::sqrt(double(random.uniform())))
                                      : pi / 2 - 2e-4 * double(random.uniform());
            const Ray next =
                spawn_ray(*from, tilted(from->normal, tilt, 2 * pi * double(random.uniform())));
            const Hit back = assembly.root->intersect(next);
            ++spawned;
            const bool same = back.primitive == hit.primitive && back.instance == hit.instance;
            // A cone's inside is seen through its open ends, and may well be hit from there.
            const bool may_return = hit.instance == 0 && hit.primitive == 1;
            const double nearby = 1e-3 * size / next.direction.cast<double>().norm();
            self_hits += same && (!may_return || double(back.t) < nearby);
        }
        INFO("size " << size);
        CHECK(spawned > 10000);
        CHECK(kinds == (1 | 2 | 4 | 8 | 64));
        CHECK(self_hits == 0);
    }
}

TEST_CASE("spawn: a ray to a target ends just short of it") {
    const Vec3f v[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    Hit hit;
    hit.u = hit.v = 0.25f;
    const SurfacePoint from = triangle_point(v, hit, Vec3f(0, 0, -1));
    CHECK(from.normal == Vec3d(0, 0, 1));
    CHECK((from.position - Vec3d(0.25, 0.25, 0)).norm() < 1e-12);
    CHECK(from.error < 1e-5);
    const Ray ray = spawn_ray_to(from, Vec3d(0.25, 0.25, 2));
    CHECK(ray.origin[2] > 0);
    CHECK(ray.origin[2] + ray.t_max * ray.direction[2] == Approx(2).epsilon(1e-3));
    CHECK(ray.t_max < 1);
    // To the other side it starts there.
    CHECK(spawn_ray(from, Vec3d(0, 0, -1)).origin[2] < 0);
}

}  // namespace crofton
