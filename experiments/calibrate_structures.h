#pragma once

#include "framework/calibration.h"

namespace crofton {

/// Appends what every structure that can be chosen costs over each kind of shape, from builds and
/// rays over calibration_scenes.
void measure_structures(Calibration& calibration);

}  // namespace crofton
