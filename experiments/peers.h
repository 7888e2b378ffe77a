#pragma once

#include "framework/registry.h"

namespace crofton {

/// Structures of other libraries, to compare with. Those that were not found when Crofton was built
/// have no `build`: a run leaves their variants out and says so.

/// "embree", over triangles, or over its own structures over triangles and instances of them. Needs
/// Embree 3 or 4 (Wald et al. 2014).
AcceleratorInfo embree_peer();
/// "tinybvh", BVH8_CPU over triangles. Needs tiny_bvh.h (Bikker 2024).
AcceleratorInfo tinybvh_peer();

/// Puts all of them into the registry (see `peers`).
void register_peers();

}  // namespace crofton
