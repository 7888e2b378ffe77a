#pragma once

#include <span>
#include <vector>

#include "framework/calibration.h"

namespace crofton {

/// Time and counts of a ray, means over many.
struct RayCost {
    double ns = 0;
    double steps = 0;  ///< N_TS
    double tests = 0;  ///< N_IT
};

struct CountedRay {
    RayCost ray;
    double bytes = 0;  ///< of the structure
};

/// Sets per_ray, per_step, per_test (not negative), per_doubling and fit_error by least squares of
/// the relative error. Structures within the cache give the first three, the others the fourth.
/// @param cache_bytes  what the second cache holds
void fit_counted(StructureCosts& costs, std::span<const CountedRay> rays, double cache_bytes);

/// What those constants say of a ray, ns.
double counted_ns(const StructureCosts& costs, const RayCost& ray, double bytes,
                  double cache_bytes);

double geometric_mean(std::span<const double> values);
double geometric_mean_ns(std::span<const RayCost> rays);
double root_mean_square(std::span<const double> values);

}  // namespace crofton
