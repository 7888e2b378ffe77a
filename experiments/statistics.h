#pragma once

#include <vector>

namespace crofton {

/// Median of a sample with an interval that holds the true median, from order statistics alone.
struct MedianInterval {
    double median = 0;
    double low = 0, high = 0;
    double coverage = 0;  ///< probability that the interval holds the median of the distribution
};

/// The narrowest symmetric pair of order statistics that covers with at least `level`; with fewer
/// than 6 values none reaches 95 %, and the interval is the whole range with the coverage it has.
/// @param values  not empty
/// Source: Hoefler & Belli 2015, Scientific Benchmarking of Parallel Computing Systems, rule 5; the
///         binomial order-statistic interval without the normal approximation.
MedianInterval median_interval(std::vector<double> values, double level = 0.95);

}  // namespace crofton
