#pragma once

#include <span>
#include <vector>

#include "framework/calibration.h"

namespace crofton {

/// Time and counts of a ray, means over many.
struct RayCost {
    double ns = 0;
    double steps = 0;   ///< N_TS
    double tests = 0;   ///< N_IT
    bool view = false;  ///< of neighbours that go together
};

struct CountedRay {
    RayCost ray;
    double bytes = 0;  ///< of the structure
};

/// Sets per_ray, per_step, per_test (not negative), per_doubling and fit_error by least squares of
/// the relative error. Structures within the cache give the first three, the others the fourth.
/// @param cache_bytes  what the second cache holds
/// @param nodes        of the same structure over other shapes, whose per_ray, per_step and
///                     per_doubling hold here, too: then only per_test is fitted. Null: none
void fit_counted(StructureCosts& costs, std::span<const CountedRay> rays, double cache_bytes,
                 const StructureCosts* nodes = nullptr);

double geometric_mean(std::span<const double> values);
double geometric_mean_ns(std::span<const RayCost> rays);
double root_mean_square(std::span<const double> values);

}  // namespace crofton
