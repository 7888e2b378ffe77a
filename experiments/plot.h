#pragma once

#include <span>

#include "experiments/image.h"
#include "experiments/row.h"

namespace crofton {

/// Time against error: a column of two panels for each workload, nanoseconds per ray to the right,
/// upwards misses per 10^9 rays (false misses against the oracle) and the 99.9th percentile of t's
/// error in ulp. Logarithmic; what has none stands on the line "0". Points bear the numbers of the
/// variants in the list below and the colour of their mode; the line is the Pareto front: on it
/// nothing is both faster and at least as right.
/// @param rows  of one scene, compared with the oracle
Image error_plot(std::span<const Row> rows);

/// Which points no other beats in both coordinates (with a tie in one, the smaller other).
std::vector<size_t> pareto_front(std::span<const Eigen::Vector2d> points);

}  // namespace crofton
