#pragma once

#include <optional>
#include <string>

#include "framework/calibration.h"

namespace crofton {

/// Measures this machine: constants in a traversal's terms, memory levels, and every structure
/// choice's build, bytes and rays over procedural scenes of several sizes. Rays run on one thread;
/// builds use as many as builds do. Takes 10 to 30 seconds.
Calibration measure_calibration();

/// @param damage  becomes what is wrong with the file, if it cannot be used
/// @return        nothing if there is none that can be used
std::optional<Calibration> cached_calibration(const std::string& path, std::string& damage);

/// Makes the calibration of this machine current: from its cached file, or measured now and cached.
/// Says on stderr when it measures. The environment variable CROFTON_CALIBRATION names another file
/// to use, or is "nominal": then choices without a clock are the same on every machine.
/// A cached file that is damaged is measured anew, one that is named is not.
/// @throws InputError  the named file cannot be used, or the cached one not be written
void ensure_calibration();

/// For people: constants with intervals, memory levels, and a line for each structure.
std::string calibration_text(const Calibration& calibration);
std::string calibration_json(const Calibration& calibration);

}  // namespace crofton
