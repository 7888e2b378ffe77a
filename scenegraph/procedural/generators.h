#pragma once

#include "scenegraph/procedural/procedural.h"

/// The generators behind the registry. Each expects all of its parameters, in range.
namespace crofton::procedural {

Scene stadium(const ProceduralValues& values);
Scene cornell_box(const ProceduralValues& values);
Scene menger(const ProceduralValues& values);

Scene terrain(const ProceduralValues& values);
Scene hairball(const ProceduralValues& values);
Scene thicket(const ProceduralValues& values);
Scene random_triangles(const ProceduralValues& values);

Scene grid_of_spheres(const ProceduralValues& values);
Scene sphereflake(const ProceduralValues& values);
Scene jacks(const ProceduralValues& values);
Scene lattice(const ProceduralValues& values);
Scene tetra(const ProceduralValues& values);

}  // namespace crofton::procedural
