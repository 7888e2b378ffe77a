#pragma once

#include <map>
#include <string>
#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// Values of a procedural scene's parameters by name.
using ProceduralValues = std::map<std::string, double>;

struct ProceduralParameter {
    std::string name;
    std::string summary;
    double default_value;
    double minimum;
    double maximum;
    bool integer;
};

/// An entry of the registry, as `crofton list` prints it.
struct ProceduralScene {
    std::string name;
    std::string summary;
    std::vector<ProceduralParameter> parameters;
    Scene (*make)(const ProceduralValues& values);  ///< needs every parameter, in range
};

/// All procedural scenes, by name.
const std::vector<ProceduralScene>& procedural_scenes();

/// Makes a procedural scene. The same name and parameters give the same bits on every platform:
/// only IEEE additions, products, quotients and square roots are used.
/// @param parameters   those that differ from the defaults
/// @throws InputError  on an unknown name or parameter, a value out of range, a fraction where an
///                     integer is needed
Scene make_scene(const std::string& name, const ProceduralValues& parameters = {});

}  // namespace crofton
