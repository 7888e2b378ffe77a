#pragma once

#include <Eigen/Core>
#include <cstdint>

/// Fixed-size vectors. Aliases of Eigen types, for set-up code, transforms and tests; traversal
/// kernels and node layouts use plain floats, so that no Eigen type stands in a packed structure.
namespace crofton {

using Vec3f = Eigen::Vector3f;
using Vec3d = Eigen::Vector3d;
using Vec3i = Eigen::Vector3i;

}  // namespace crofton
