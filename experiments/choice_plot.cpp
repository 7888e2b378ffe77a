#include "experiments/choice_plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "experiments/budget.h"
#include "experiments/chart.h"
#include "experiments/fit.h"

namespace crofton {
namespace {

using chart::Point;

constexpr int panel_width = 420, panel_height = 340, left = 62, top = 30, bottom = 36, right = 16;

/// Where a panel's values come to stand. Upper left corner of the panel; x and y from 0 to 1.
struct Panel {
    int x0, y0, width, height;
    Point place(double x, double y) const {
        return {x0 + left + (width - left - right) * x,
                y0 + top + (height - top - bottom) * (1 - y)};
    }
};

Vec3d variant_color(size_t i, size_t count) {
    return heat_color(0.25 + 0.7 * double(i) / double(std::max<size_t>(count, 2) - 1));
}

struct Pair {
    double measured, predicted;
    Vec3d color;
};

void draw_pairs(Image& image, const Panel& panel, const std::string& title,
                const std::vector<Pair>& pairs) {
    std::vector<double> values;
    for (const Pair& p : pairs) values.push_back(p.measured), values.push_back(p.predicted);
    const chart::Axis axis(values, false);
    draw_text(image, panel.x0 + left, panel.y0 + 8, title);
    for (double e = axis.low; e <= axis.high; ++e) {
        const double at = axis.at(std::pow(10, e));
        chart::line(image, panel.place(at, 0), panel.place(at, 1), chart::grey);
        chart::line(image, panel.place(0, at), panel.place(1, at), chart::grey);
        const Point x = panel.place(at, 0), y = panel.place(0, at);
        draw_text(image, int(x.x()) - 12, int(x.y()) + 6, fmt::format("1e{:g}", e));
        draw_text(image, panel.x0 + 6, int(y.y()) - 4, fmt::format("1e{:g}", e));
    }
    draw_text(image, int(panel.place(1, 0).x()) - 64, panel.y0 + panel.height - 14, "measured");
    const double fifth = std::log10(1.2) / (axis.high - axis.low);
    for (const double off : {-fifth, 0.0, fifth})
        chart::line(image, panel.place(std::max(0.0, -off), std::max(0.0, off)),
                    panel.place(1 - std::max(0.0, off), 1 - std::max(0.0, -off)),
                    off == 0 ? chart::white : chart::grey);
    for (const Pair& p : pairs)
        chart::dot(image, panel.place(axis.at(p.measured), axis.at(p.predicted)), p.color);
}

/// Names in columns of a third of the width each.
int legend_height(size_t names) { return 14 * int((names + 2) / 3) + 12; }

void draw_legend(Image& image, int y0, const std::vector<std::string>& names,
                 const std::vector<Vec3d>& colors) {
    for (size_t i = 0; i < names.size(); ++i) {
        const int x = 14 + int(i % 3) * (image.width / 3), y = y0 + int(i / 3) * 14;
        chart::dot(image, Point(x, y + 4), colors[i]);
        draw_text(image, x + 10, y, names[i]);
    }
}

std::vector<std::string> names_of(std::span<const Row> rows) {
    std::vector<std::string> names;
    for (const Row& row : rows)
        if (std::find(names.begin(), names.end(), row.variant) == names.end())
            names.push_back(row.variant);
    return names;
}

// --- regret ---

constexpr double least_regret = 0.5, most_regret = 2.5;

double regret_height(double regret) {
    return std::clamp(std::log(regret / least_regret) / std::log(most_regret / least_regret), 0.0,
                      1.0);
}

void draw_regrets(Image& image, const Panel& panel,
                  const std::map<double, std::vector<double>>& by_budget, int shift,
                  const std::vector<double>& budgets, const Vec3d& color) {
    Point last;
    for (size_t b = 0; b < budgets.size(); ++b) {
        const auto found = by_budget.find(budgets[b]);
        if (found == by_budget.end()) continue;
        const double x = (double(b) + 0.5) / double(budgets.size());
        for (size_t i = 0; i < found->second.size(); ++i) {
            // Side by side in the order of the cells, so that they do not hide each other.
            const double spread = (double(i) / double(found->second.size()) - 0.5) * 0.06;
            const Point p = panel.place(x + spread, regret_height(found->second[i]));
            chart::dot(image, p + Point(shift, 0), color);
        }
        const Point mean =
            panel.place(x, regret_height(geometric_mean(found->second))) + Point(shift, 0);
        if (b > 0) chart::line(image, last, mean, color);
        last = mean;
    }
}

}  // namespace

Image prediction_plot(std::span<const Row> rows) {
    std::vector<Row> predicted;
    for (const Row& row : rows)
        if (row.predicted) predicted.push_back(row);
    const std::vector<std::string> names = names_of(predicted);
    std::vector<Vec3d> colors;
    for (size_t i = 0; i < names.size(); ++i) colors.push_back(variant_color(i, names.size()));
    std::vector<Pair> panels[4];
    for (const Row& row : predicted) {
        const PredictedCosts& p = *row.predicted;
        const size_t i = size_t(std::find(names.begin(), names.end(), row.variant) - names.begin());
        const double ns = row.ns_per_ray.median;
        panels[0].push_back({ns, p.ns_per_ray, colors[i]});
        panels[1].push_back({ns, p.expected_ns, colors[i]});
        panels[2].push_back({row.build_s, p.build_s, colors[i]});
        panels[3].push_back({double(row.structure.bytes), p.bytes, colors[i]});
    }
    Image image = chart::blank(2 * panel_width, 2 * panel_height + legend_height(names.size()));
    static constexpr const char* titles[] = {"ns per ray, predicted before the build",
                                             "ns per ray, predicted after the build",
                                             "build, predicted seconds", "predicted bytes"};
    for (int i = 0; i < 4; ++i)
        draw_pairs(image, {i % 2 * panel_width, i / 2 * panel_height, panel_width, panel_height},
                   titles[i], panels[i]);
    draw_legend(image, 2 * panel_height + 4, names, colors);
    return image;
}

Image regret_plot(std::span<const Row> rows) {
    std::map<std::string, std::map<double, std::vector<double>>> regrets;
    std::map<std::string, std::vector<double>> all;
    std::set<double> budget_set;
    std::set<std::string> chooses;
    for (const RowRegret& r : regrets_of(rows)) {
        regrets[r.row->variant][r.row->budget->rays].push_back(r.regret);
        all[r.row->variant].push_back(r.regret);
        budget_set.insert(r.row->budget->rays);
        if (r.row->chosen) chooses.insert(r.row->variant);
    }
    const std::vector<double> budgets(budget_set.begin(), budget_set.end());
    std::string fixed;
    for (const auto& [name, list] : all)
        if (!chooses.contains(name) &&
            (fixed.empty() || geometric_mean(list) < geometric_mean(all[fixed])))
            fixed = name;
    std::vector<std::string> names(chooses.begin(), chooses.end());
    if (!fixed.empty()) names.push_back(fixed);
    const Panel panel{0, 0, 2 * panel_width, panel_height + 60};
    Image image = chart::blank(panel.width, panel.height + legend_height(names.size()));
    draw_text(image, left, 8, "total time over the least of all fixed choices");
    for (const double y : {0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 2.0, 2.5}) {
        const double at = regret_height(y);
        chart::line(image, panel.place(0, at), panel.place(1, at),
                    y == 1 ? chart::white : chart::grey);
        draw_text(image, 14, int(panel.place(0, at).y()) - 4, fmt::format("{:.1f}", y));
    }
    for (size_t b = 0; b < budgets.size(); ++b) {
        const Point p = panel.place((double(b) + 0.5) / double(budgets.size()), 0);
        draw_text(image, int(p.x()) - 30, int(p.y()) + 8, fmt::format("{:g} rays", budgets[b]));
    }
    const Vec3d orange(0.95, 0.55, 0.2), blue(0.35, 0.75, 1);
    std::vector<Vec3d> colors;
    for (size_t i = 0; i < names.size(); ++i) {
        colors.push_back(names[i] == fixed ? blue : orange);
        draw_regrets(image, panel, regrets[names[i]], names[i] == fixed ? 26 : -26, budgets,
                     colors.back());
    }
    draw_legend(image, panel.height + 4, names, colors);
    return image;
}

}  // namespace crofton
