#include "experiments/report.h"

#include <fmt/format.h>

#include <algorithm>

#include "experiments/budget.h"

namespace crofton {
namespace {

/// Columns as wide as their widest cell; the first `left` of them flush left.
class Table {
  public:
    explicit Table(size_t left) : left_(left) {}
    void add(std::vector<std::string> cells) { rows_.push_back(std::move(cells)); }

    /// Lines without ends.
    std::vector<std::string> lines() const {
        std::vector<size_t> widths;
        for (const auto& row : rows_) {
            widths.resize(std::max(widths.size(), row.size()));
            for (size_t c = 0; c < row.size(); ++c) widths[c] = std::max(widths[c], length(row[c]));
        }
        std::vector<std::string> out;
        for (const auto& row : rows_) {
            std::string line;
            for (size_t c = 0; c < row.size(); ++c) {
                const std::string gap(widths[c] - length(row[c]), ' ');
                line += (c ? "  " : "") + (c < left_ ? row[c] + gap : gap + row[c]);
            }
            line.erase(line.find_last_not_of(' ') + 1);
            out.push_back(std::move(line));
        }
        return out;
    }

  private:
    /// Characters of UTF-8.
    static size_t length(const std::string& text) {
        return size_t(
            std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }));
    }
    size_t left_;
    std::vector<std::vector<std::string>> rows_;
};

/// Three to four significant digits, without an exponent.
std::string short_number(double value) {
    const int decimals = value >= 100 ? 0 : value >= 10 ? 1 : value >= 1 ? 2 : 3;
    return fmt::format("{:.{}f}", value, decimals);
}

bool same_part(const Row& a, const Row& b) {
    return a.scene == b.scene && a.workload == b.workload && a.query == b.query && a.rays == b.rays;
}

std::string cut(const std::string& text, size_t most) {
    return text.size() <= most ? text : text.substr(0, most - 3) + "...";
}

std::vector<std::string> cells(const Row& row, double best) {
    const double n = double(std::max<uint64_t>(row.rays_checked, 1));
    const bool partial = row.rays_timed < row.rays;
    std::vector<std::string> cells{row.variant,
                                   cut(row.accelerator, 44),
                                   short_number(1e3 / row.ns_per_ray.median),
                                   short_number(row.ns_per_ray.median) + (partial ? "*" : ""),
                                   fmt::format("[{}, {}]", short_number(row.ns_per_ray.low),
                                               short_number(row.ns_per_ray.high)),
                                   short_number(double(row.counters.N_IT) / n),
                                   short_number(double(row.counters.N_TS) / n),
                                   short_number(row.build_s),
                                   short_number(double(row.structure.bytes) / 1e6),
                                   short_number(row.ns_per_ray.median / best)};
    if (row.first_image_s > 0) {
        cells.push_back(short_number(row.first_image_s));
        cells.push_back(short_number(double(row.first_image_bytes) / 1e6));
    }
    if (row.oracle.rays > 0) {
        const auto rate = [&](const VerifyTally::Split& s) {
            const double each = 1e9 / double(row.oracle.rays);
            return fmt::format("{:.4g}", double(s.inside + s.outside) * each);
        };
        cells.insert(cells.end(), {rate(row.oracle.false_misses), rate(row.oracle.false_hits),
                                   rate(row.oracle.wrong_primitives),
                                   fmt::format("{:g}", row.oracle.t_ulp.quantile(0.5)),
                                   fmt::format("{:g}", row.oracle.t_ulp.quantile(0.999)),
                                   fmt::format("{:.4g}", row.oracle.t_ulp.largest())});
    }
    return cells;
}

std::string part_text(std::span<const Row> rows, bool color) {
    const Row& first = rows.front();
    const auto best = std::min_element(rows.begin(), rows.end(), [](const Row& a, const Row& b) {
        return a.ns_per_ray.median < b.ns_per_ray.median;
    });
    Table table(2);
    std::vector<std::string> head{"variant", "accelerator", "M rays/s", "ns/ray", "interval",
                                  "N_IT",    "N_TS",        "build s",  "MB",     "x best"};
    if (first.first_image_s > 0) head.insert(head.end(), {"first image s", "MB then"});
    if (first.oracle.rays > 0)
        head.insert(head.end(),
                    {"f.miss/1e9", "f.hit/1e9", "wr.prim/1e9", "ulp p50", "p99.9", "max"});
    table.add(std::move(head));
    for (const Row& row : rows) table.add(cells(row, best->ns_per_ray.median));
    const std::vector<std::string> lines = table.lines();
    std::string text = fmt::format("{}, {}: {} rays, {} hit, {} hit{}\n", first.scene,
                                   first.workload, first.rays, first.query, best->hits,
                                   best->rays_checked < best->rays ? " of those checked" : "");
    for (size_t i = 0; i < lines.size(); ++i) {
        const char* code = i == 0 ? "\033[2m" : &rows[i - 1] == &*best ? "\033[1m" : "";
        text += color && *code ? "  " + (code + lines[i]) + "\033[0m\n" : "  " + lines[i] + "\n";
    }
    if (first.oracle.rays > 0)
        text +=
            fmt::format("  against the oracle on {} rays; ulp: error of t\n", first.oracle.rays);
    for (const Row& row : rows) {
        if (row.rays_timed < row.rays)
            text += fmt::format("  * {}: timed on {} of {} rays, one at random in every {:.1f}\n",
                                row.variant, row.rays_timed, row.rays,
                                double(row.rays) / double(row.rays_timed));
        if (row.rays_checked < row.rays)
            text += fmt::format("    {}: hits and counters on {} of {} rays\n", row.variant,
                                row.rays_checked, row.rays);
        if (row.depth_error)
            text += fmt::format(
                "    {}: ends rays early; t is off by {:.3g} % rms, {:.3g} % at most, and {} of {} "
                "rays hit or miss otherwise than in {}\n",
                row.variant, 100 * row.depth_error->rms, 100 * row.depth_error->max,
                row.depth_error->hit_or_miss, row.rays_checked, row.checked_against);
    }
    return text;
}

}  // namespace

std::string table_text(std::span<const Row> rows, bool color) {
    std::string text;
    for (size_t begin = 0, end = 0; begin < rows.size(); begin = end) {
        for (end = begin; end < rows.size() && same_part(rows[begin], rows[end]); ++end) {
        }
        text += part_text(rows.subspan(begin, end - begin), color) + "\n";
    }
    if (rows.empty()) return text;
    const double coverage = rows.front().ns_per_ray.coverage;
    text += fmt::format(
        "ns/ray: median of {} passes, with an interval that holds the median with {:.1f} %; {} "
        "thread{}, {}.\n"
        "N_IT, N_TS: intersection tests and traversal steps per ray.\n",
        rows.front().repeats, 100 * coverage, rows.front().threads,
        rows.front().threads == 1 ? "" : "s", rows.front().isa);
    return text;
}

std::string report_text(const RunOutput& output, const std::string& folder, bool color) {
    std::string text = "\n" + table_text(output.rows, color);
    for (const std::string& part : {budget_text(output.budget_rows), prediction_text(output.rows)})
        if (!part.empty()) text += part + "\n";
    constexpr size_t most = 12;
    for (size_t i = 0; i < std::min(most, output.explanations.size()); ++i)
        text += output.explanations[i] + "\n";
    if (output.explanations.size() > most)
        text += fmt::format("… and {} more choices; see choices.txt\n\n",
                            output.explanations.size() - most);
    for (const std::string& note : output.notes) text += "Note: " + note + "\n";
    const bool checked = std::any_of(output.rows.begin(), output.rows.end(),
                                     [](const Row& row) { return !row.checked_against.empty(); });
    if (!output.mismatches.empty()) {
        text += "Check FAILED: hits differ between variants.\n";
        for (const std::string& line : output.mismatches) text += "  " + line + "\n";
    } else if (checked) {
        const bool all = std::none_of(output.rows.begin(), output.rows.end(),
                                      [](const Row& row) { return row.depth_error.has_value(); });
        text +=
            fmt::format("Check passed: {} hits agree ray by ray, in ids and in every bit of t.\n",
                        all ? "all variants'" : "all exact variants'");
        if (std::any_of(output.rows.begin(), output.rows.end(),
                        [&](const Row& row) { return row.mode != output.rows[0].mode; }))
            text += "(Those of one mode with each other; not those in mode fast, nor of peers.)\n";
    }
    if (!output.pictures.empty()) {
        text += "Pictures:";
        for (const std::string& picture : output.pictures) text += " " + picture;
        text += "\n";
    }
    return text + "Results: " + folder + "\n";
}

}  // namespace crofton
