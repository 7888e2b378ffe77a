#include "experiments/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "experiments/chart.h"

namespace crofton {
namespace {

constexpr int panel_width = 420, panel_height = 300, left = 62, top = 34, line_height = 14;
using chart::Axis;
using chart::dot;
using chart::grey;
using chart::line;
using chart::Point;
using chart::white;

Vec3d mode_color(const std::string& mode) {
    if (mode == "fast") return {0.95, 0.55, 0.2};
    if (mode == "robust") return {0.35, 0.75, 1};
    if (mode == "double") return {0.45, 0.9, 0.45};
    return {0.95, 0.45, 0.85};
}

/// A peer's modes are not ours.
Vec3d color_of(const Row& row) { return row.peer ? Vec3d(0.95, 0.9, 0.4) : mode_color(row.mode); }

double metric(const Row& row, bool misses) {
    if (!misses) return row.oracle.t_ulp.quantile(0.999);
    const VerifyTally::Split& s = row.oracle.false_misses;
    return double(s.inside + s.outside) * 1e9 / double(row.oracle.rays);
}

struct Numbered {
    const Row* row;
    size_t number;
};

void draw_panel(Image& image, int x0, int y0, const std::vector<Numbered>& rows, bool misses) {
    const double width = panel_width - left - 16, height = panel_height - top - 40;
    std::vector<double> times, errors;
    for (const Numbered& n : rows) {
        times.push_back(n.row->ns_per_ray.median);
        errors.push_back(metric(*n.row, misses));
    }
    const Axis x_axis(times, false), y_axis(errors, true);
    const auto place = [&](double x, double y) {
        return Point(x0 + left + width * x, y0 + top + height * (1 - y));
    };
    draw_text(
        image, x0 + left, y0 + 6,
        rows[0].row->workload + ": " + (misses ? "misses per 10^9 rays" : "t error, ulp, p99.9"));
    draw_text(image, x0 + left + int(width) - 60, y0 + panel_height - 16, "ns per ray");
    for (double e = x_axis.low; e <= x_axis.high; ++e) {
        const double x = x_axis.at(std::pow(10, e));
        line(image, place(x, 0), place(x, 1), grey);
        const Point p = place(x, 0);
        draw_text(image, int(p.x()) - 8, int(p.y()) + 6, fmt::format("{:g}", std::pow(10, e)));
    }
    for (double e = y_axis.low; e <= y_axis.high; ++e) {
        const double y = y_axis.at(std::pow(10, e));
        line(image, place(0, y), place(1, y), grey);
        draw_text(image, x0 + 6, int(place(0, y).y()) - 4, fmt::format("1e{:g}", e));
    }
    line(image, place(0, y_axis.at(0)), place(1, y_axis.at(0)), grey);
    draw_text(image, x0 + 6, int(place(0, y_axis.at(0)).y()) - 4, "0");

    std::vector<Point> points;
    for (size_t i = 0; i < rows.size(); ++i) points.push_back({times[i], errors[i]});
    Point last = place(0, 1);
    for (const size_t i : pareto_front(points)) {
        const Point p = place(x_axis.at(times[i]), y_axis.at(errors[i]));
        const Point corner(p.x(), last.y());
        line(image, last.x() < place(0, 0).x() + 1 ? corner : last, corner, white);
        line(image, corner, p, white);
        last = p;
    }
    line(image, last, Point(place(1, 0).x(), last.y()), white);
    std::vector<Point> labels;
    for (size_t i = 0; i < rows.size(); ++i) {
        const Point p = place(x_axis.at(times[i]), y_axis.at(errors[i]));
        dot(image, p, color_of(*rows[i].row));
        // Labels that would overlap move up.
        Point at(p.x() + 5, p.y() - 9);
        while (std::any_of(labels.begin(), labels.end(), [&](const Point& q) {
            return std::abs(q.x() - at.x()) < 14 && std::abs(q.y() - at.y()) < 9;
        }))
            at.y() -= 9;
        labels.push_back(at);
        draw_text(image, int(at.x()), int(at.y()), std::to_string(rows[i].number));
    }
}

}  // namespace

std::vector<size_t> pareto_front(std::span<const Point> points) {
    std::vector<size_t> order(points.size()), front;
    for (size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
        return std::pair(points[a].x(), points[a].y()) < std::pair(points[b].x(), points[b].y());
    });
    double least = INFINITY;
    for (const size_t i : order) {
        if (!(points[i].y() < least)) continue;
        least = points[i].y();
        front.push_back(i);
    }
    return front;
}

Image error_plot(std::span<const Row> rows) {
    std::vector<std::string> workloads, variants;
    const auto index = [](std::vector<std::string>& names, const std::string& name) {
        const auto it = std::find(names.begin(), names.end(), name);
        if (it != names.end()) return size_t(it - names.begin());
        names.push_back(name);
        return names.size() - 1;
    };
    std::vector<std::vector<Numbered>> columns;
    std::vector<Vec3d> colors;
    for (const Row& row : rows) {
        const size_t column = index(workloads, row.workload);
        const size_t number = index(variants, row.variant);
        columns.resize(workloads.size());
        columns[column].push_back({&row, number + 1});
        if (colors.size() < variants.size()) colors.push_back(color_of(row));
    }
    const int columns_of_text = std::max(1, int(columns.size()) * 2);
    const int lines = (int(variants.size()) + columns_of_text - 1) / columns_of_text;
    Image image = chart::blank(std::max(1, int(columns.size())) * panel_width,
                               2 * panel_height + lines * line_height + 16);
    for (size_t c = 0; c < columns.size(); ++c)
        for (const bool misses : {true, false})
            draw_panel(image, int(c) * panel_width, misses ? 0 : panel_height, columns[c], misses);
    for (size_t i = 0; i < variants.size(); ++i) {
        const int x = int(i) / lines * (panel_width / 2) + 14;
        const int y = 2 * panel_height + 6 + int(i) % lines * line_height;
        dot(image, Point(x, y + 4), colors[i]);
        draw_text(image, x + 10, y, fmt::format("{} {}", i + 1, variants[i]));
    }
    return image;
}

}  // namespace crofton
