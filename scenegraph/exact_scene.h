#pragma once

#include "framework/exact.h"
#include "scenegraph/scene.h"

namespace crofton {

/// What counts as the truth about a mesh that a transform places.
enum class PlacementTruth {
    composed,   ///< the corners under the exact product of the chain of maps
    as_placed,  ///< triangles with the corners that kernels test: mapped by the rounded product;
                ///< other kinds as `composed`
};

/// Gives every shape of a scene to an oracle, with the ids of `assemble`. As there, placements
/// without a finite inverse are left out, and points are no shapes.
/// @throws InputError  more than max_placements placements
/// Memory: about 100 bytes for each placed triangle.
exact::Oracle make_oracle(const Scene& scene, PlacementTruth truth = PlacementTruth::composed);

}  // namespace crofton
