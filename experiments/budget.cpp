#include "experiments/budget.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "experiments/fit.h"
#include "experiments/statistics.h"

namespace crofton {
namespace {

constexpr double slow_build_s = 0.3;

double median(std::vector<double> values) { return median_interval(std::move(values)).median; }

std::vector<double> ranks(std::span<const double> values) {
    std::vector<size_t> order(values.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::sort(order.begin(), order.end(),
              [&](size_t a, size_t b) { return values[a] < values[b]; });
    std::vector<double> out(values.size());
    for (size_t begin = 0, end = 0; begin < order.size(); begin = end) {
        while (end < order.size() && values[order[end]] == values[order[begin]]) ++end;
        for (size_t i = begin; i < end; ++i) out[order[i]] = 0.5 * double(begin + end - 1);
    }
    return out;
}

using Cell = std::tuple<std::string, std::string, double>;  ///< scene, workload, budget

Cell cell_of(const Row& row) { return {row.scene, row.workload, row.budget->rays}; }

struct Regrets {
    std::map<double, std::vector<double>> by_budget;
    std::vector<double> all;
    double worst = 0;
    std::string worst_at;
    double most_choosing = 0;  ///< share of the total
};

std::vector<std::string> names_in_order(std::span<const Row> rows) {
    std::vector<std::string> names;
    for (const Row& row : rows)
        if (std::find(names.begin(), names.end(), row.variant) == names.end())
            names.push_back(row.variant);
    return names;
}

double relative_error(double predicted, double measured) {
    return std::abs(predicted / measured - 1);
}

}  // namespace

/// On so many rays that they take some milliseconds.
double TotalTime::warm_ns(const Primitive& root) const {
    constexpr double pass_s = 8e-3;
    const double pilot =
        std::max(1.0, pilot_ns(root, rays_.first(std::min<size_t>(rays_.size(), 256)), tracing_));
    std::vector<Ray> sample;
    for (const size_t i : strided_sample(rays_.size(), size_t(pass_s * 1e9 / pilot) + 64, 12))
        sample.push_back(rays_[i]);
    timed_pass(root, sample, tracing_);
    return timed_pass(root, sample, tracing_) * 1e9 / double(sample.size());
}

void TotalTime::measure(double budget) {
    const size_t count = rays_for(budget);
    std::vector<double>& seconds = cold_[count];
    if (!seconds.empty() && build_s() > slow_build_s) return;
    std::vector<Ray> sample;
    for (const size_t i : strided_sample(rays_.size(), count, 11)) sample.push_back(rays_[i]);
    const Assembly fresh = assembled_();
    builds_.push_back(fresh.build_s);
    seconds.push_back(fresh.build_s + timed_pass(*fresh.root, sample, tracing_));
    warm_.push_back(warm_ns(*fresh.root));
}

double TotalTime::seconds(double budget) const {
    const size_t count = rays_for(budget);
    return median(cold_.at(count)) + (budget - double(count)) * ns_per_ray() * 1e-9;
}

double TotalTime::build_s() const { return median(builds_); }
double TotalTime::ns_per_ray() const { return median(warm_); }

double rank_correlation(std::span<const double> a, std::span<const double> b) {
    const std::vector<double> x = ranks(a), y = ranks(b);
    const double mean = 0.5 * double(x.size() - 1);
    double xy = 0, xx = 0, yy = 0;
    for (size_t i = 0; i < x.size(); ++i) {
        xy += (x[i] - mean) * (y[i] - mean);
        xx += (x[i] - mean) * (x[i] - mean);
        yy += (y[i] - mean) * (y[i] - mean);
    }
    return xx > 0 && yy > 0 ? xy / std::sqrt(xx * yy) : 0;
}

std::vector<RowRegret> regrets_of(std::span<const Row> rows) {
    std::map<Cell, double> best;
    for (const Row& row : rows) {
        if (row.chosen) continue;
        const auto [it, fresh] = best.try_emplace(cell_of(row), row.budget->total_s);
        if (!fresh) it->second = std::min(it->second, row.budget->total_s);
    }
    std::vector<RowRegret> out;
    for (const Row& row : rows)
        if (const auto found = best.find(cell_of(row)); found != best.end())
            out.push_back({&row, row.budget->total_s / found->second});
    return out;
}

std::string budget_text(std::span<const Row> rows) {
    if (rows.empty()) return "";
    std::map<std::string, Regrets> regrets;
    std::set<Cell> cells;
    for (const auto& [at, regret] : regrets_of(rows)) {
        const Row& row = *at;
        cells.insert(cell_of(row));
        Regrets& r = regrets[row.variant];
        r.by_budget[row.budget->rays].push_back(regret);
        r.all.push_back(regret);
        r.most_choosing = std::max(r.most_choosing, row.budget->choose_s / row.budget->total_s);
        if (regret > r.worst)
            r.worst = regret, r.worst_at = fmt::format("{}, {}, {:g} rays", row.scene, row.workload,
                                                       row.budget->rays);
    }
    if (regrets.empty()) return "";
    std::vector<std::string> names = names_in_order(rows);
    std::stable_sort(names.begin(), names.end(), [&](const auto& a, const auto& b) {
        return geometric_mean(regrets[a].all) < geometric_mean(regrets[b].all);
    });
    std::string text =
        "Total time (choosing, build, rays) over the least of all fixed variants, geometric "
        "means\n  ";
    text += fmt::format("{:28}", "variant");
    for (const auto& [rays, list] : regrets[names[0]].by_budget)
        text += fmt::format(" {:>7}", fmt::format("{:g}", rays));
    text += fmt::format(" {:>7} {:>7}   worst at\n", "all", "worst");
    for (const std::string& name : names) {
        const Regrets& r = regrets[name];
        text += fmt::format("  {:28}", name);
        for (const auto& [rays, list] : r.by_budget)
            text += fmt::format(" {:>7.3f}", geometric_mean(list));
        text +=
            fmt::format(" {:>7.3f} {:>7.2f}   {}\n", geometric_mean(r.all), r.worst, r.worst_at);
    }
    const auto chooses = [&](const std::string& name) {
        return std::any_of(rows.begin(), rows.end(),
                           [&](const Row& r) { return r.variant == name && r.chosen; });
    };
    const auto fixed = std::find_if_not(names.begin(), names.end(), chooses);
    for (const std::string& name : names) {
        if (!chooses(name) || fixed == names.end()) continue;
        text += fmt::format(
            "  {} takes {:.1f} % less time than {}, the best single variant; choosing took at most "
            "{:.1f} % of a total\n",
            name,
            100 * (1 - geometric_mean(regrets[name].all) / geometric_mean(regrets[*fixed].all)),
            *fixed, 100 * regrets[name].most_choosing);
    }
    return text + fmt::format("  over {} cells: scenes x workloads x budgets\n", cells.size());
}

std::string prediction_text(std::span<const Row> rows) {
    struct Errors {
        std::vector<double> before, after, build, bytes;
    };
    std::map<std::string, Errors> errors;
    Errors all;
    std::map<std::pair<std::string, std::string>,
             std::pair<std::vector<double>, std::vector<double>>>
        by_cell;
    for (const Row& row : rows) {
        if (!row.predicted) continue;
        const PredictedCosts& p = *row.predicted;
        for (Errors* e : {&errors[row.variant], &all}) {
            e->before.push_back(relative_error(p.ns_per_ray, row.ns_per_ray.median));
            e->after.push_back(relative_error(p.expected_ns, row.ns_per_ray.median));
            e->build.push_back(relative_error(p.build_s, row.build_s));
            e->bytes.push_back(relative_error(p.bytes, double(row.structure.bytes)));
        }
        auto& [predicted, measured] = by_cell[{row.scene, row.workload}];
        predicted.push_back(p.ns_per_ray);
        measured.push_back(row.ns_per_ray.median);
    }
    if (all.before.empty()) return "";
    std::string text =
        "Predicted against measured: median absolute error, %\n"
        "  variant                      ns/ray before   after the build   build time   bytes\n";
    const auto line = [&](const std::string& name, const Errors& e) {
        text += fmt::format("  {:28} {:>13.1f} {:>17.1f} {:>12.1f} {:>7.1f}\n", name,
                            100 * median(e.before), 100 * median(e.after), 100 * median(e.build),
                            100 * median(e.bytes));
    };
    for (const std::string& name : names_in_order(rows))
        if (errors.contains(name)) line(name, errors[name]);
    line("all", all);
    std::vector<double> correlations;
    for (const auto& [cell, lists] : by_cell)
        if (lists.first.size() > 2)
            correlations.push_back(rank_correlation(lists.first, lists.second));
    if (!correlations.empty())
        text += fmt::format(
            "  rank correlation of ns/ray before the build, over variants: median {:.3f} of {} "
            "scenes "
            "and workloads\n",
            median(correlations), correlations.size());
    return text;
}

}  // namespace crofton
