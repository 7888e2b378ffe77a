#pragma once

#include <string>
#include <vector>

#include "framework/ray.h"
#include "scenegraph/scene.h"

namespace crofton {

/// A scene to calibrate with, and the rays that are traced through it.
struct CalibrationScene {
    std::string shapes;  ///< kind, as in StructureCosts
    double size = 0;     ///< nominal number of shapes: equal ones make one point of the growth
    Scene scene;
    uint64_t count = 0;       ///< shapes in fact
    std::vector<Ray> lines;   ///< isotropic, in no order
    std::vector<Ray> view;    ///< of a camera, pixel after pixel along some lines of a picture
    std::vector<Ray> inside;  ///< from what these hit, in any direction
};

/// Terrains, and clutter as models have it: bumpy balls, boxes and cylinders over a floor, most of
/// them along the axes, with sizes from one to a hundred (many small ones for each large one) and
/// corners that are shared or, where faces have normals of their own, not; object after object. All
/// of them together have the same area, however fine they are. The same shapes as quadrics and as
/// polygons. Ascending in size. None of these is a scene that experiments judge predictions on.
std::vector<CalibrationScene> calibration_scenes();

}  // namespace crofton
