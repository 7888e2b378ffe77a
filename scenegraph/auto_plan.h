#pragma once

#include <string>
#include <vector>

#include "scenegraph/outlook.h"
#include "scenegraph/pilot.h"

namespace crofton {

struct Selection {
    Assembly assembly;
    std::vector<Candidate> candidates;  ///< best first
    size_t chosen = 0;
    double choose_s = 0;     ///< seconds for all but the build of what was chosen
    double expected_ns = 0;  ///< per ray, from the built structure's counters; 0: no sample
    std::string reason;
    const Candidate& choice() const { return candidates[chosen]; }
};

/// Chooses and builds. Estimates from counts come first; if the time allowed for choosing has room,
/// a pilot scales them to this scene; then the best is built, tried on the sample, and replaced as
/// long as another could gain more than its own build and trial cost.
/// @param sample  may be empty: counts alone decide
/// @throws InputError  nothing fits into the memory
Selection choose_assembly(const Scene& scene, const AutoOptions& options, const RaySample& sample,
                          const Calibration& calibration);

/// A table of the candidates, and why one was chosen. @param limit  lines at most
std::string explanation(const Selection& selection, const Objective& objective,
                        size_t limit = 1000);

}  // namespace crofton
