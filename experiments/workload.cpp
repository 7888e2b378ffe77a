#include "experiments/workload.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "experiments/catalogue/recipes.h"
#include "experiments/random.h"
#include "framework/error.h"
#include "scenegraph/shading.h"

namespace crofton {
namespace {

static_assert(std::endian::native == std::endian::little, "ray files are little-endian");

struct ImageSize {
    int width, height;
};

ImageSize image_size(const WorkloadSpec& spec, const Camera& camera) {
    if (spec.width > 0) return {int(spec.width), int(spec.height)};
    const double aspect = camera.aspect > 0 && std::isfinite(camera.aspect) ? camera.aspect : 1.0;
    const double height =
        std::clamp(std::round(std::sqrt(double(spec.rays) / aspect)), 1.0, double(spec.rays));
    return {int(std::max(1.0, std::round(double(spec.rays) / height))), int(height)};
}

std::vector<Ray> primary_rays(const WorkloadSpec& spec, const RaySource& source) {
    const Camera camera =
        choose_camera(source.camera, source.scene, source.sphere, size_t(spec.camera));
    const ImageSize size = image_size(spec, camera);
    return camera_rays(camera, size.width, size.height);
}

std::vector<SurfacePoint> seen_points(const WorkloadSpec& spec, const RaySource& source) {
    const std::vector<Ray> rays = primary_rays(spec, source);
    std::vector<Hit> hits(rays.size());
    source.reference.intersect(rays, hits);
    std::vector<SurfacePoint> points;
    for (size_t i = 0; i < rays.size(); ++i)
        if (const auto p = surface_point(source.scene, source.instances, hits[i], rays[i]))
            points.push_back(*p);
    if (points.empty())
        throw InputError("workload '" + spec.name + "': no primary ray hits the scene");
    return points;
}

Ray make_ray(const Vec3d& origin, const Vec3d& direction, double t_max) {
    Ray ray;
    ray.origin = origin.cast<float>();
    ray.direction = direction.cast<float>();
    ray.t_max = float(t_max);
    return ray;
}

std::vector<Vec3d> light_positions(const RaySource& source) {
    std::vector<Vec3d> lights;
    for (const Light& light : source.scene.lights)
        if (light.position.cast<float>().allFinite()) lights.push_back(light.position);
    if (lights.empty()) {
        const Vec3d& up = source.camera.up;
        const Vec3d above = up.norm() > 0 ? up.normalized() : Vec3d(0, 1, 0);
        lights.push_back(source.sphere.center + above * (2 * source.sphere.radius));
    }
    return lights;
}

/// `spec.rays` rays, spread evenly over the points in their order.
std::vector<Ray> secondary_rays(const WorkloadSpec& spec, const RaySource& source) {
    const std::vector<SurfacePoint> points = seen_points(spec, source);
    const std::vector<Vec3d> lights = light_positions(source);
    Pcg32 rng(spec.seed, 1);
    const double infinity = std::numeric_limits<double>::infinity();
    const double reach =
        spec.type == "diffuse" ? infinity : spec.distance * 2 * source.sphere.radius;
    std::vector<Ray> rays;
    rays.reserve(size_t(spec.rays));
    for (int64_t i = 0; i < spec.rays; ++i) {
        const auto at = static_cast<size_t>(static_cast<unsigned __int128>(i) * points.size() /
                                            static_cast<uint64_t>(spec.rays));
        const SurfacePoint& p = points[at];
        if (spec.type == "shadow") {
            // The light itself is not a surface, but may lie in one.
            rays.push_back(spawn_ray_to(p, lights[size_t(i) % lights.size()]));
        } else {
            rays.push_back(spawn_ray(p, cosine_direction(p.normal, rng), float(reach)));
        }
    }
    return rays;
}

/// From anywhere between one and two radii off the scene's sphere, at corners or points of edges.
std::vector<Ray> aimed_rays(const WorkloadSpec& spec, const RaySource& source) {
    const AimPoints aim(source.scene);
    Pcg32 rng(spec.seed, 4);
    std::vector<Ray> rays;
    rays.reserve(size_t(spec.rays));
    for (int64_t i = 0; i < spec.rays; ++i) {
        const double distance = source.sphere.radius * (1 + rng.uniform());
        const Vec3d from = source.sphere.center + distance * uniform_direction(rng);
        Vec3f target = aim.corners[rng.below(aim.corners.size())];
        if (spec.type == "edge" && !aim.triangles.empty()) {
            const auto& t = aim.triangles[rng.below(aim.triangles.size())];
            const size_t k = rng.below(3);
            const Vec3d a = aim.corners[t[k]].cast<double>();
            const Vec3d b = aim.corners[t[(k + 1) % 3]].cast<double>();
            target = (a + rng.uniform() * (b - a)).cast<float>();
        }
        Ray ray;
        ray.origin = from.cast<float>();
        ray.direction = target - ray.origin;
        rays.push_back(ray);
    }
    return rays;
}

void shuffle_rays(std::vector<Ray>& rays, uint64_t seed) {
    Pcg32 rng(seed, 2);
    for (size_t i = rays.size(); i > 1; --i) std::swap(rays[i - 1], rays[rng.below(i)]);
}

}  // namespace

std::vector<Ray> random_lines(const BoundingSphere& sphere, int64_t count, uint64_t seed) {
    Pcg32 rng(seed, 0);
    std::vector<Ray> rays;
    rays.reserve(size_t(count));
    for (int64_t i = 0; i < count; ++i) {
        const Vec3d direction = uniform_direction(rng);
        const double r = sphere.radius * std::sqrt(rng.uniform());
        const double angle = 2 * pi * rng.uniform();
        Vec3d s, t;
        perpendicular(direction, s, t);
        const Vec3d middle = sphere.center + s * (r * std::cos(angle)) + t * (r * std::sin(angle));
        // A little longer than the diameter, so that no rounding cuts the sphere.
        const double half = sphere.radius * (1 + 0x1p-10);
        rays.push_back(make_ray(middle - direction * half, direction, 2 * half));
    }
    return rays;
}

std::vector<Ray> make_rays(const WorkloadSpec& spec, const RaySource& source) {
    std::vector<Ray> rays;
    if (spec.type == "primary")
        rays = primary_rays(spec, source);
    else if (spec.type == "random")
        rays = random_lines(source.sphere, spec.rays, spec.seed);
    else if (spec.type == "vertex" || spec.type == "edge")
        rays = aimed_rays(spec, source);
    else if (spec.type == "file")
        rays = read_rays(spec.file);
    else
        rays = secondary_rays(spec, source);
    if (spec.shuffle) shuffle_rays(rays, spec.seed);
    return rays;
}

std::vector<Ray> read_rays(const std::string& path) {
    std::error_code error;
    const uintmax_t size = std::filesystem::file_size(path, error);
    std::ifstream file(path, std::ios::binary);
    if (error || !file) throw InputError(path + ": cannot be read");
    if (size % sizeof(Ray) != 0)
        throw InputError(fmt::format("{}: {} bytes are not a multiple of {}, the size of a ray",
                                     path, size, sizeof(Ray)));
    std::vector<Ray> rays(size / sizeof(Ray));
    file.read(reinterpret_cast<char*>(rays.data()), std::streamsize(size));
    if (file.gcount() != std::streamsize(size)) throw InputError(path + ": cannot be read");
    return rays;
}

void write_rays(const std::string& path, std::span<const Ray> rays) {
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(rays.data()), std::streamsize(rays.size_bytes()));
    file.close();
    if (!file) throw InputError(path + ": cannot be written");
}

}  // namespace crofton
