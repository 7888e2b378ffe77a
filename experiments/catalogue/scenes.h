#pragma once

#include <functional>
#include <string>
#include <vector>

#include "scenegraph/scene.h"

namespace crofton {

/// A scene that is hard for some structure or leaf test, made on demand.
struct CatalogueScene {
    std::string name;
    std::string why;  ///< what is hard about it
    std::function<Scene()> make;
};

/// Fans, slivers, duplicates, stacks, sheets some ulp apart, extreme sizes and places, nested maps,
/// quadrics at their limits, broken input. The same on every machine.
const std::vector<CatalogueScene>& catalogue_scenes();

/// @throws InputError  unknown name, with the nearest valid one
Scene catalogue_scene(const std::string& name);

}  // namespace crofton
