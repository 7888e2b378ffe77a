#include "experiments/fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace crofton {
namespace {

/// Least squares without negative unknowns: of all subsets of columns, the best whose solution has
/// none (Lawson & Hanson 1974 need fewer subsets; of three columns there are seven).
Eigen::Vector3d non_negative_fit(const Eigen::MatrixX3d& a, const Eigen::VectorXd& b) {
    Eigen::Vector3d best = Eigen::Vector3d::Zero();
    double least = b.squaredNorm();
    for (int subset = 1; subset < 8; ++subset) {
        std::vector<int> columns;
        for (int k = 0; k < 3; ++k)
            if (subset >> k & 1) columns.push_back(k);
        const Eigen::MatrixXd part = a(Eigen::all, columns);
        const Eigen::VectorXd x = part.colPivHouseholderQr().solve(b);
        if (!x.allFinite() || (x.array() < 0).any()) continue;
        const double error = (part * x - b).squaredNorm();
        if (error >= least) continue;
        least = error;
        best.setZero();
        for (size_t i = 0; i < columns.size(); ++i) best[columns[i]] = x[Eigen::Index(i)];
    }
    return best;
}

double doublings(double bytes, double cache_bytes) {
    return std::max(0.0, std::log2(bytes / cache_bytes));
}

double median(std::vector<double> values) {
    if (values.empty()) return 0;
    std::nth_element(values.begin(), values.begin() + long(values.size() / 2), values.end());
    return values[values.size() / 2];
}

/// per_test alone, given the rest.
void fit_tests(StructureCosts& costs, std::span<const CountedRay> rays, double cache_bytes) {
    double xy = 0, xx = 0;
    for (const CountedRay& r : rays) {
        costs.per_test = 0;
        const double rest =
            r.ray.ns - costs.counted_ns(r.ray.steps, r.ray.tests, r.bytes, cache_bytes);
        costs.per_test = 1;
        const double one = costs.counted_ns(0, r.ray.tests, r.bytes, cache_bytes) - costs.per_ray;
        xy += one * rest / (r.ray.ns * r.ray.ns);
        xx += one * one / (r.ray.ns * r.ray.ns);
    }
    costs.per_test = xx > 0 ? std::max(0.0, xy / xx) : 0;
}

/// All but per_doubling from structures within the cache, and this from the others.
void fit_all(StructureCosts& costs, std::span<const CountedRay> rays, double cache_bytes) {
    std::vector<const CountedRay*> near, far;
    for (const CountedRay& r : rays)
        (doublings(r.bytes, cache_bytes) > 0 ? far : near).push_back(&r);
    if (near.empty()) near.swap(far);
    Eigen::MatrixX3d a(near.size(), 3);
    for (size_t i = 0; i < near.size(); ++i) {
        const RayCost& r = near[i]->ray;
        a.row(Eigen::Index(i)) << 1 / r.ns, r.steps / r.ns, r.tests / r.ns;
    }
    const Eigen::Vector3d x = non_negative_fit(a, Eigen::VectorXd::Ones(Eigen::Index(near.size())));
    costs.per_ray = x[0], costs.per_step = x[1], costs.per_test = x[2], costs.per_doubling = 0;
    std::vector<double> slopes;
    for (const CountedRay* r : far) {
        const double work =
            costs.counted_ns(r->ray.steps, r->ray.tests, 0, cache_bytes) - costs.per_ray;
        const double factor = (r->ray.ns - costs.per_ray) / work;
        if (work > 0) slopes.push_back((factor - 1) / doublings(r->bytes, cache_bytes));
    }
    costs.per_doubling = std::max(0.0, median(slopes));
}

}  // namespace

void fit_counted(StructureCosts& costs, std::span<const CountedRay> rays, double cache_bytes,
                 const StructureCosts* nodes) {
    if (nodes) {
        costs.per_ray = nodes->per_ray, costs.per_step = nodes->per_step;
        costs.per_doubling = nodes->per_doubling;
        fit_tests(costs, rays, cache_bytes);
    } else {
        fit_all(costs, rays, cache_bytes);
    }
    std::vector<double> errors;
    for (const CountedRay& r : rays)
        errors.push_back(std::abs(
            costs.counted_ns(r.ray.steps, r.ray.tests, r.bytes, cache_bytes) / r.ray.ns - 1));
    costs.fit_error = median(errors);
}

double geometric_mean(std::span<const double> values) {
    if (values.empty()) return 0;
    double sum = 0;
    for (const double v : values) sum += std::log(v);
    return std::exp(sum / double(values.size()));
}

double geometric_mean_ns(std::span<const RayCost> rays) {
    std::vector<double> ns;
    for (const RayCost& r : rays) ns.push_back(r.ns);
    return geometric_mean(ns);
}

double root_mean_square(std::span<const double> values) {
    if (values.empty()) return 0;
    double sum = 0;
    for (const double v : values) sum += v * v;
    return std::sqrt(sum / double(values.size()));
}

}  // namespace crofton
