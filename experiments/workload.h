#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "experiments/camera.h"
#include "experiments/experiment.h"
#include "framework/primitive.h"
#include "scenegraph/scene.h"

namespace crofton {

/// A scene with what rays are made from. Secondary rays start where a reference structure is hit;
/// it is the same for all variants, so that all trace the same rays.
struct RaySource {
    const Scene& scene;
    std::span<const MeshInstance> instances;  ///< mesh_instances(scene)
    const Primitive& reference;
    BoundingSphere sphere;
    CameraSpec camera;
};

/// Makes the rays of a workload; the same ones on every machine for a seed and a scene.
/// @throws InputError  a ray file that cannot be used; secondary rays where no primary ray hits
std::vector<Ray> make_rays(const WorkloadSpec& spec, const RaySource& source);

/// `count` isotropic lines that are uniform over the sphere (the Crofton measure): a uniform
/// direction, and a uniform point of the disc perpendicular to it. Each runs through the whole
/// sphere, from t_min = 0 outside of it; directions have unit length.
std::vector<Ray> random_lines(const BoundingSphere& sphere, int64_t count, uint64_t seed);

/// Reads a file of rays: little-endian float32 x 8: origin, t_min, direction, t_max.
/// @throws InputError  cannot be read, or its size is not a multiple of 32 bytes
std::vector<Ray> read_rays(const std::string& path);
/// @throws InputError  cannot be written
void write_rays(const std::string& path, std::span<const Ray> rays);

}  // namespace crofton
