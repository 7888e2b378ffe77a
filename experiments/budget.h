#pragma once

#include <algorithm>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "experiments/measure.h"
#include "experiments/row.h"
#include "scenegraph/assemble.h"

namespace crofton {

/// Seconds from nothing built to a number of rays traced, for one plan: measured as far as there
/// are rays, so that what rays build lazily and cold caches are in it, and from there on with the
/// time per ray of warm passes. Everything is built anew for each measurement, and medians are
/// taken over them: how fast a structure is depends on where its memory comes to lie, too.
class TotalTime {
  public:
    /// @param assembled  builds anew
    TotalTime(std::function<Assembly()> assembled, std::span<const Ray> rays,
              const Tracing& tracing)
        : assembled_(std::move(assembled)), rays_(rays), tracing_(tracing) {}

    /// Adds one measurement for a budget, unless there have been some and builds are slow. Those of
    /// several plans should take turns, so that what else the machine does falls on all of them.
    void measure(double budget);
    /// Medians over all measurements. @pre  measured for this budget
    double seconds(double budget) const;
    double build_s() const;
    double ns_per_ray() const;

  private:
    size_t rays_for(double budget) const { return size_t(std::min(budget, double(rays_.size()))); }
    double warm_ns(const Primitive& root) const;

    std::function<Assembly()> assembled_;
    std::span<const Ray> rays_;
    Tracing tracing_;
    std::map<size_t, std::vector<double>> cold_;  ///< seconds by number of rays
    std::vector<double> builds_, warm_;
};

/// A row's total time over the least total of any variant that does not choose, for the same scene,
/// workload and budget.
struct RowRegret {
    const Row* row;
    double regret;
};
/// Of all rows that there is such a variant for. @param rows  with budgets; they must outlive these
std::vector<RowRegret> regrets_of(std::span<const Row> rows);

/// For people: regret of every variant (its total over the least total of any that does not choose,
/// for the same scene, workload and budget), by budget and over all.
std::string budget_text(std::span<const Row> rows);

/// For people: predicted against measured, by variant: medians of the absolute errors of ns per ray
/// before and after the build, of build time and bytes, and the rank correlation over variants.
/// Empty without predictions.
std::string prediction_text(std::span<const Row> rows);

/// Spearman's coefficient; of equal values the mean rank. @param a, b  as long, at least 2
double rank_correlation(std::span<const double> a, std::span<const double> b);

}  // namespace crofton
