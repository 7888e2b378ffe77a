#include "experiments/statistics.h"

#include "experiments/plot.h"
#include "experiments/random.h"
#include "tests/catch.h"

using namespace crofton;

TEST_CASE("statistics: the median of an odd and of an even sample") {
    CHECK(median_interval({3, 1, 2}).median == 2);
    CHECK(median_interval({4, 1, 2, 3}).median == 2.5);
    CHECK(median_interval({7}).median == 7);
}

TEST_CASE("statistics: fewer than six values give their range and its true coverage") {
    const MedianInterval five = median_interval({5, 4, 3, 2, 1});
    CHECK(five.low == 1);
    CHECK(five.high == 5);
    CHECK(five.coverage == Approx(0.9375));  // 1 - 2 / 2^5
}

TEST_CASE("statistics: order statistics for 95 % as in the binomial table") {
    std::vector<double> values;
    for (int i = 1; i <= 20; ++i) values.push_back(i);
    // n = 20: the 6th and the 15th value, 95.9 % (tables of the sign test).
    const MedianInterval interval = median_interval(values);
    CHECK(interval.low == 6);
    CHECK(interval.high == 15);
    CHECK(interval.coverage == Approx(0.9586).margin(1e-4));
}

TEST_CASE(
    "statistics: the interval covers the median of a skewed distribution as often as it says") {
    Pcg32 rng(7);
    const int trials = 4000;
    int covered = 0;
    double claimed = 0;
    for (int k = 0; k < trials; ++k) {
        std::vector<double> sample;
        for (int i = 0; i < 15; ++i) sample.push_back(-std::log(1 - rng.uniform()));
        const MedianInterval m = median_interval(sample);
        covered += m.low <= std::log(2.0) && std::log(2.0) <= m.high;
        claimed = m.coverage;
    }
    // Four standard deviations of a binomial with 4000 trials.
    CHECK(double(covered) / trials ==
          Approx(claimed).margin(4 * std::sqrt(claimed * (1 - claimed) / trials)));
}

TEST_CASE("statistics: the Pareto front holds what nothing beats in time and error") {
    using Point = Eigen::Vector2d;
    const std::vector<Point> points{{3, 0}, {1, 5}, {2, 5}, {2, 4}, {4, 0}, {5, 9}, {1, 7}};
    CHECK(pareto_front(points) == std::vector<size_t>{1, 3, 0});
    CHECK(pareto_front({}).empty());
}
