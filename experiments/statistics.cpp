#include "experiments/statistics.h"

#include <algorithm>
#include <cmath>

namespace crofton {
namespace {

/// P(X <= k) of a binomial distribution with n trials of probability 1/2.
double binomial_cdf(int k, int n) {
    double sum = 0;
    for (int i = 0; i <= k; ++i)
        sum += std::exp(std::lgamma(n + 1.0) - std::lgamma(i + 1.0) - std::lgamma(n - i + 1.0) -
                        n * std::log(2.0));
    return sum;
}

}  // namespace

MedianInterval median_interval(std::vector<double> values, double level) {
    std::sort(values.begin(), values.end());
    const int n = int(values.size());
    MedianInterval out;
    out.median =
        n % 2 ? values[size_t(n / 2)] : 0.5 * (values[size_t(n / 2 - 1)] + values[size_t(n / 2)]);
    // [x_k, x_(n-1-k)], counted from 0, misses the median with probability 2·P(X <= k).
    int k = 0;
    while (2 * (k + 1) < n && 1 - 2 * binomial_cdf(k + 1, n) >= level) ++k;
    out.low = values[size_t(k)];
    out.high = values[size_t(n - 1 - k)];
    out.coverage = std::max(0.0, 1 - 2 * binomial_cdf(k, n));
    return out;
}

}  // namespace crofton
