#include "experiments/workload.h"

#include <filesystem>
#include <fstream>

#include "experiments/measure.h"
#include "experiments/random.h"
#include "framework/error.h"
#include "scenegraph/assemble.h"
#include "scenegraph/shading.h"
#include "tests/catch.h"

using namespace crofton;

namespace {

std::string temporary(const std::string& name) {
    return (std::filesystem::temp_directory_path() / name).string();
}

/// Whether the whole line meets the box; slabs in double.
bool meets(const Ray& ray, const Vec3d& lower, const Vec3d& upper) {
    double enter = -1e30, leave = 1e30;
    for (int a = 0; a < 3; ++a) {
        const double r = 1.0 / double(ray.direction[a]);
        const double s = (lower[a] - double(ray.origin[a])) * r,
                     t = (upper[a] - double(ray.origin[a])) * r;
        enter = std::max(enter, std::min(s, t));
        leave = std::min(leave, std::max(s, t));
    }
    return enter <= leave;
}

/// Four standard deviations of the mean of `n` draws that hit with probability p.
double margin(double p, double n) { return 4 * std::sqrt(p * (1 - p) / n); }

/// A unit cube of two triangles a side, from -1/2 to 1/2.
Scene cube_scene() {
    TriangleMesh mesh;
    for (int i = 0; i < 8; ++i)
        mesh.positions.emplace_back(i & 1 ? 0.5f : -0.5f, i & 2 ? 0.5f : -0.5f,
                                    i & 4 ? 0.5f : -0.5f);
    for (const auto& [a, b, c, d] : {std::array<uint32_t, 4>{0, 1, 3, 2},
                                     {4, 5, 7, 6},
                                     {0, 1, 5, 4},
                                     {2, 3, 7, 6},
                                     {0, 2, 6, 4},
                                     {1, 3, 7, 5}}) {
        mesh.triangles.push_back({a, b, c});
        mesh.triangles.push_back({a, c, d});
    }
    Geometry geometry;
    geometry.shapes = mesh;
    Scene scene;
    scene.name = "cube";
    scene.add_object("cube", geometry);
    return scene;
}

struct Cube {
    Scene scene = cube_scene();
    std::vector<MeshInstance> instances = mesh_instances(scene);
    Assembly assembly = assemble(scene, uniform_plan("bvh"));
    RaySource source{scene, instances, *assembly.root, {Vec3d::Zero(), std::sqrt(0.75)}, {}};
};

WorkloadSpec spec_of(const std::string& type, int64_t rays) {
    WorkloadSpec spec;
    spec.name = spec.type = type;
    spec.rays = rays;
    spec.distance = 0.25;
    return spec;
}

}  // namespace

TEST_CASE("workload: random lines meet an inner sphere as often as the ratio of the areas") {
    const BoundingSphere sphere{Vec3d(3, -2, 5), 2};
    const int64_t n = 200000;
    const Vec3d center = sphere.center + Vec3d(0.7, -0.4, 0.5);  // anywhere inside
    const double radius = 0.6;
    int64_t met = 0;
    for (const Ray& ray : random_lines(sphere, n, 11)) {
        const Vec3d d = ray.direction.cast<double>().normalized();
        const Vec3d o = ray.origin.cast<double>() - center;
        met += (o - d * o.dot(d)).norm() <= radius;
    }
    const double p = radius * radius / (sphere.radius * sphere.radius);
    CHECK(double(met) / double(n) == Approx(p).margin(margin(p, double(n))));
}

TEST_CASE("workload: random lines meet an inner box as often as the ratio of the areas") {
    const BoundingSphere sphere{Vec3d(0, 0, 0), 2};
    const int64_t n = 200000;
    const Vec3d lower(-1, 0.2, -0.3), upper(0.5, 0.9, 1.2);
    int64_t met = 0;
    for (const Ray& ray : random_lines(sphere, n, 12)) met += meets(ray, lower, upper);
    const Vec3d e = upper - lower;
    const double area = 2 * (e.x() * e.y() + e.y() * e.z() + e.z() * e.x());
    const double p = area / (4 * pi * sphere.radius * sphere.radius);
    CHECK(double(met) / double(n) == Approx(p).margin(margin(p, double(n))));
}

TEST_CASE("workload: random lines run through the whole sphere and have a mean chord of 4V/S") {
    const BoundingSphere sphere{Vec3d(1, 1, 1), 3};
    double chords = 0;
    const int64_t n = 100000;
    for (const Ray& ray : random_lines(sphere, n, 13)) {
        const Vec3d o = ray.origin.cast<double>() - sphere.center;
        const Vec3d d = ray.direction.cast<double>();
        REQUIRE(o.norm() >= sphere.radius * 0.9999);
        REQUIRE((o + d * double(ray.t_max)).norm() >= sphere.radius * 0.9999);
        const double across = (o - d * o.dot(d)).squaredNorm();
        chords += 2 * std::sqrt(std::max(0.0, sphere.radius * sphere.radius - across));
    }
    // The chord of a sphere under this measure: mean 4r/3, variance (2 - 16/9) r².
    const double error = 4 * std::sqrt((2.0 - 16.0 / 9.0) / double(n)) * sphere.radius;
    CHECK(chords / double(n) == Approx(4.0 / 3.0 * sphere.radius).margin(error));
}

TEST_CASE("workload: cosine directions lie about their normal with mean cosine 2/3") {
    Pcg32 rng(3);
    const Vec3d normal = Vec3d(0.3, -0.8, -0.5).normalized();
    const int n = 100000;
    double sum = 0;
    Vec3d mean = Vec3d::Zero();
    for (int i = 0; i < n; ++i) {
        const Vec3d d = cosine_direction(normal, rng);
        REQUIRE(d.norm() == Approx(1.0).epsilon(1e-12));
        REQUIRE(d.dot(normal) >= 0);
        sum += d.dot(normal);
        mean += d / n;
    }
    // cos has variance 1/2 - 4/9 = 1/18; each tangent has variance 1/4.
    CHECK(sum / n == Approx(2.0 / 3.0).margin(4 * std::sqrt(1.0 / 18 / n)));
    CHECK((mean - normal * (2.0 / 3.0)).cwiseAbs().maxCoeff() <= 5 * std::sqrt(0.25 / n));
}

TEST_CASE("workload: a file of rays reads back bit for bit") {
    const std::string path = temporary("crofton_rays_test.bin");
    const std::vector<Ray> rays = random_lines({}, 37, 5);
    write_rays(path, rays);
    CHECK(std::filesystem::file_size(path) == 37 * 32);
    const std::vector<Ray> again = read_rays(path);
    REQUIRE(again.size() == rays.size());
    for (size_t i = 0; i < rays.size(); ++i) {
        CHECK(again[i].origin == rays[i].origin);
        CHECK(again[i].t_min == rays[i].t_min);
        CHECK(again[i].direction == rays[i].direction);
        CHECK(again[i].t_max == rays[i].t_max);
    }
    std::filesystem::remove(path);
}

TEST_CASE("workload: a file whose size is not a multiple of a ray is refused") {
    const std::string path = temporary("crofton_rays_bad.bin");
    std::ofstream(path, std::ios::binary) << std::string(33, 'x');
    CHECK_THROWS_AS(read_rays(path), InputError);
    std::filesystem::remove(path);
    CHECK_THROWS_AS(read_rays(path), InputError);
}

TEST_CASE("workload: primary rays go through pixel centres, rows from the top") {
    Camera camera;
    camera.eye = {0, 0, 5};
    camera.at = {0, 0, 0};
    const std::vector<Ray> rays = camera_rays(camera, 4, 2);
    REQUIRE(rays.size() == 8);
    CHECK(rays[0].direction.x() < 0);
    CHECK(rays[0].direction.y() > 0);
    CHECK(rays[7].direction.x() > 0);
    CHECK(rays[7].direction.y() < 0);
    CHECK(rays[0].direction.x() == -rays[3].direction.x());
    // The lower of two rows passes half way between the axis and the edge of the field.
    CHECK(-rays[5].direction.y() / -rays[5].direction.z() ==
          Approx(0.5 * std::tan(camera.fov_y / 2)).epsilon(1e-5));
}

TEST_CASE("workload: secondary rays start on the surface and leave it") {
    Cube cube;
    for (const char* type : {"shadow", "ambient_occlusion", "diffuse"}) {
        const std::vector<Ray> rays = make_rays(spec_of(type, 2000), cube.source);
        REQUIRE(rays.size() == 2000);
        size_t occluded = 0;
        for (const Ray& ray : rays) {
            CHECK(ray.origin.cwiseAbs().maxCoeff() == Approx(0.5).margin(1e-4));
            occluded += cube.assembly.root->occluded(ray);
        }
        INFO(type);
        // A cube is convex: nothing that leaves it comes back, but shadow rays start on dark sides
        // too.
        if (std::string(type) != "shadow") CHECK(occluded == 0);
    }
}

TEST_CASE("workload: the same seed gives the same rays, another seed others") {
    Cube cube;
    WorkloadSpec spec = spec_of("diffuse", 500);
    const std::vector<Ray> a = make_rays(spec, cube.source), b = make_rays(spec, cube.source);
    spec.seed = 2;
    const std::vector<Ray> c = make_rays(spec, cube.source);
    CHECK(std::memcmp(a.data(), b.data(), a.size() * sizeof(Ray)) == 0);
    CHECK(std::memcmp(a.data(), c.data(), a.size() * sizeof(Ray)) != 0);
}

TEST_CASE("workload: shuffled rays are the same rays in another order") {
    Cube cube;
    WorkloadSpec spec = spec_of("random", 300);
    const std::vector<Ray> plain = make_rays(spec, cube.source);
    spec.shuffle = true;
    const std::vector<Ray> shuffled = make_rays(spec, cube.source);
    const auto sum = [](const std::vector<Ray>& rays) {
        double s = 0;
        for (const Ray& ray : rays) s += double(ray.origin.x());
        return s;
    };
    CHECK(sum(plain) == Approx(sum(shuffled)).epsilon(1e-9));
    CHECK(std::memcmp(plain.data(), shuffled.data(), plain.size() * sizeof(Ray)) != 0);
}

TEST_CASE("workload: no primary ray that hits is an error, not a crash") {
    Cube cube;
    cube.source.camera.eye = Vec3d(0, 0, 9);
    cube.source.camera.at = Vec3d(0, 0, 99);
    CHECK_THROWS_AS(make_rays(spec_of("diffuse", 10), cube.source), InputError);
}

TEST_CASE("workload: normals of every shape under a sheared, mirrored transform") {
    Quadrics quadrics;
    quadrics.shapes = {Sphere{Vec3f::Zero(), 1}, Cone{Vec3f::Zero(), 1, Vec3f(0, 0, 2), 0},
                       Disc{Vec3f::Zero(), 1, Vec3f(0, 0, 3), 0}};
    Geometry geometry;
    geometry.shapes = quadrics;
    Scene scene;
    Transform world_from_object;
    world_from_object.linear << -2, 0.5, 0, 0, 1, 0, 0, 0, 3;
    scene.add_object("shapes", geometry, world_from_object);
    const auto instances = mesh_instances(scene);
    // Object-space points with known normals; a covector maps by the inverse transpose.
    const struct {
        uint32_t primitive;
        Vec3d point, normal;
    } cases[] = {{0, Vec3d(0, 0.6, 0.8), Vec3d(0, 0.6, 0.8)},
                 {1, Vec3d(0.5, 0, 1), Vec3d(1, 0, 0.5)},
                 {2, Vec3d(0.3, 0.2, 0), Vec3d(0, 0, 1)}};
    for (const auto& c : cases) {
        const Vec3d p = world_from_object.point(c.point);
        const Vec3d n = (world_from_object.linear.inverse().transpose() * c.normal).normalized();
        Ray ray;
        ray.origin = (p + n).cast<float>();
        ray.direction = (-n).cast<float>();
        Hit hit;
        hit.t = 1, hit.primitive = c.primitive, hit.geometry = 0, hit.instance = 0;
        const auto normal = surface_normal(scene, instances, hit, ray);
        REQUIRE(normal);
        CHECK((*normal - n).norm() < 1e-5);
    }
}

TEST_CASE("measure: a strided sample has one index in every stride") {
    const auto sample = strided_sample(1000, 30, 4);
    REQUIRE(sample.size() == 30);
    for (size_t i = 0; i < sample.size(); ++i) {
        CHECK(sample[i] >= i * 1000 / 30);
        CHECK(sample[i] < (i + 1) * 1000 / 30);
    }
    CHECK(strided_sample(5, 9, 1) == std::vector<size_t>{0, 1, 2, 3, 4});
}
