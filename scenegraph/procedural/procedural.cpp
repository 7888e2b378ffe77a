#include "scenegraph/procedural/procedural.h"

#include <algorithm>
#include <cmath>
#include <locale>
#include <sstream>

#include "framework/error.h"
#include "scenegraph/procedural/generators.h"

namespace crofton {
namespace {

using procedural::cornell_box, procedural::grid_of_spheres, procedural::hairball, procedural::jacks,
    procedural::lattice, procedural::menger, procedural::random_triangles, procedural::sphereflake,
    procedural::stadium, procedural::terrain, procedural::tetra, procedural::thicket;

ProceduralParameter integer(const char* name, const char* summary, double value, double minimum,
                            double maximum) {
    return {name, summary, value, minimum, maximum, true};
}
ProceduralParameter real(const char* name, const char* summary, double value, double minimum,
                         double maximum) {
    return {name, summary, value, minimum, maximum, false};
}
ProceduralParameter seed() { return integer("seed", "of the random numbers", 1, 0, 0x1p53); }
ProceduralParameter tessellation() {
    return integer("tessellation",
                   "0: quadrics; n: instances of one icosphere of 20*4^(n-1) triangles", 0, 0, 7);
}

std::vector<ProceduralScene> make_registry() {
    return {
        {"cornell_box",
         "the Cornell box: walls, a light and two blocks, 32 triangles",
         {},
         cornell_box},
        {"grid_of_spheres",
         "n^3 spheres in the unit cube",
         {integer("n", "spheres along an edge", 10, 1, 200),
          real("fill", "diameter over spacing", 0.5, 1e-6, 2), tessellation()},
         grid_of_spheres},
        {"hairball",
         "curved hairs around a unit ball, as thin triangles",
         {integer("triangles", "rounded up to whole hairs of 96", 100000, 1, 3e6),
          real("thickness", "radius of a hair", 0.002, 1e-6, 0.1), seed()},
         hairball},
        {"jacks",
         "the SPD scene: nested jacks of 3 cylinders and 6 spheres",
         {integer("depth", "levels; sum of 8^i jacks", 4, 1, 7)},
         jacks},
        {"lattice",
         "the SPD scene: (n+1)^3 spheres joined by cylinders",
         {integer("n", "cells along an edge", 12, 1, 100)},
         lattice},
        {"menger",
         "Menger sponge of 20^depth cubes, a graph of shared nodes over one cube",
         {integer("depth", "levels of nesting", 3, 0, 5)},
         menger},
        {"random_triangles",
         "triangles spread evenly over the unit cube",
         {integer("n", "triangles", 10000, 1, 1e7),
          real("size", "edge of the cube that holds a triangle's corners", 0.05, 1e-9, 1e3),
          seed()},
         random_triangles},
        {"sphereflake",
         "the SPD scene balls: 9^n spheres at each level n, and a floor",
         {integer("depth", "levels below the first sphere", 4, 0, 7), tessellation()},
         sphereflake},
        {"stadium",
         "a huge, sparse ring of steps around a pedestal whose top is at the origin, y up",
         {real("size", "diameter", 1000, 10, 1e6), integer("rows", "steps", 20, 1, 1000),
          integer("segments", "around the ring", 64, 8, 1000),
          real("pedestal", "edge of the pedestal, a cube", 1, 1e-3, 1e3)},
         stadium},
        {"terrain",
         "fractal heights over a square, 2*n*n triangles, y up",
         {integer("n", "cells along an edge", 512, 1, 4096), real("size", "edge", 10, 1e-3, 1e6),
          real("height", "from about the lowest to the highest point", 2, 0, 1e6),
          integer("seed", "of the heights", 0, 0, 0x1p53)},
         terrain},
        {"tetra",
         "the SPD scene: 4^depth triangles of recursive tetrahedra",
         {integer("depth", "levels", 6, 1, 11)},
         tetra},
        {"thicket",
         "instances of one long, winding stem, turned at random, whose boxes all overlap",
         {integer("n", "stems, in two levels of groups", 200, 1, 1e6),
          integer("triangles", "of the stem, rounded up to whole segments of 12", 3000, 12, 1e6),
          real("length", "of a stem, in edges of the cube that holds their middles", 0.6, 1e-3, 10),
          seed()},
         thicket},
    };
}

const ProceduralScene& scene_named(const std::string& name) {
    std::vector<std::string> names;
    for (const ProceduralScene& scene : procedural_scenes()) {
        if (scene.name == name) return scene;
        names.push_back(scene.name);
    }
    throw InputError(unknown_name("procedural scene", name, names));
}

void check(const ProceduralScene& scene, const ProceduralParameter& parameter, double value) {
    const bool in_range = value >= parameter.minimum && value <= parameter.maximum;
    if (in_range && (!parameter.integer || value == std::floor(value))) return;
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text << "procedural scene '" << scene.name << "': " << parameter.name << " = " << value
         << "; it must be " << (parameter.integer ? "an integer" : "a number") << " from "
         << parameter.minimum << " to " << parameter.maximum;
    throw InputError(text.str());
}

}  // namespace

const std::vector<ProceduralScene>& procedural_scenes() {
    static const std::vector<ProceduralScene> registry = make_registry();
    return registry;
}

Scene make_scene(const std::string& name, const ProceduralValues& parameters) {
    const ProceduralScene& scene = scene_named(name);
    ProceduralValues values;
    std::vector<std::string> known;
    for (const ProceduralParameter& p : scene.parameters) {
        values[p.name] = p.default_value;
        known.push_back(p.name);
    }
    for (const auto& [key, value] : parameters) {
        const auto found = std::find(known.begin(), known.end(), key);
        if (found == known.end())
            throw InputError("procedural scene '" + name +
                             "': " + unknown_name("parameter", key, known));
        check(scene, scene.parameters[size_t(found - known.begin())], value);
        values[key] = value;
    }
    Scene result = scene.make(values);
    result.name = name;
    result.source = "procedural:" + name;
    return result;
}

}  // namespace crofton
