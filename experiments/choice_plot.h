#pragma once

#include <span>

#include "experiments/image.h"
#include "experiments/row.h"

namespace crofton {

/// Predicted against measured: a panel each for nanoseconds per ray before the build and after it,
/// seconds of the build, and bytes. Logarithmic; to the right what was measured, upwards what was
/// predicted, the diagonal and 20 % to both sides of it. A dot for each row, in the colour of its
/// variant in the list below.
/// @param rows  those without predictions are passed over
Image prediction_plot(std::span<const Row> rows);

/// Total time of each choice over the least of all fixed variants, for each budget: a dot for each
/// scene and workload, of variants that choose beside the fixed one that is best over all; the
/// lines are geometric means. Above 2.5, dots stand at the top.
/// @param rows  with budgets
Image regret_plot(std::span<const Row> rows);

}  // namespace crofton
