// What `crofton verify` prints and writes.

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <fstream>
#include <nlohmann/json.hpp>

#include "experiments/verify.h"
#include "framework/error.h"

namespace crofton {

namespace {

using Json = nlohmann::ordered_json;
using Split = VerifyTally::Split;

/// One row of the table: a case, or the sum of several.
struct Row {
    std::string name;
    std::vector<std::string> accelerators;
    std::vector<VerifyTally> tallies;

    void add(const VerifyCase& c) {
        for (size_t i = 0; i < c.accelerators.size(); ++i) {
            const auto it = std::find(accelerators.begin(), accelerators.end(), c.accelerators[i]);
            if (it == accelerators.end()) {
                accelerators.push_back(c.accelerators[i]);
                tallies.push_back(c.tallies[i]);
            } else {
                tallies[size_t(it - accelerators.begin())] += c.tallies[i];
            }
        }
    }
    bool uniform() const {
        return std::all_of(tallies.begin(), tallies.end(),
                           [&](const VerifyTally& t) { return t == tallies.front(); });
    }
};

Row& row_named(std::vector<Row>& rows, const std::string& name) {
    for (Row& row : rows)
        if (row.name == name) return row;
    rows.push_back({name, {}, {}});
    return rows.back();
}

std::string split_text(const Split& s) { return fmt::format("{}/{}", s.inside, s.outside); }

void print_line(std::string& text, const std::string& name, const std::string& accelerator,
                const VerifyTally& t) {
    text += fmt::format(
        "{:<26} {:<16} {:>9} {:>9} {:>5} {:>9} {:>9} {:>9} {:>7} {:>6} {:>4} {:>4} "
        "{:>6} {:>9.3g}\n",
        name, accelerator, t.rays, t.hits, t.leaks, split_text(t.false_misses),
        split_text(t.false_hits), split_text(t.wrong_primitives), split_text(t.wrong_t),
        t.disagreements, t.t_ulp.quantile(0.5), t.t_ulp.quantile(0.99), t.t_ulp.quantile(0.999),
        t.t_ulp.largest());
}

void print_row(std::string& text, const Row& row) {
    if (row.tallies.empty()) return;
    if (row.uniform() && row.tallies.size() > 1) {
        print_line(text, row.name, fmt::format("all {}", row.tallies.size()), row.tallies[0]);
        return;
    }
    for (size_t i = 0; i < row.tallies.size(); ++i)
        print_line(text, i == 0 ? row.name : "", row.accelerators[i], row.tallies[i]);
}

Json json_of(const Split& s) { return {{"inside", s.inside}, {"outside", s.outside}}; }

Json json_of(const VerifyTally& t) {
    return {{"rays", t.rays},
            {"hits", t.hits},
            {"leaks", t.leaks},
            {"false_misses", json_of(t.false_misses)},
            {"false_hits", json_of(t.false_hits)},
            {"wrong_primitives", json_of(t.wrong_primitives)},
            {"wrong_t", json_of(t.wrong_t)},
            {"disagreements", t.disagreements},
            {"t_ulp_p50", t.t_ulp.quantile(0.5)},
            {"t_ulp_p99", t.t_ulp.quantile(0.99)},
            {"t_ulp_p99_9", t.t_ulp.quantile(0.999)},
            {"t_ulp_max", t.t_ulp.largest()}};
}

Row totals(const VerifyReport& report) {
    Row row{"total", {}, {}};
    for (const VerifyCase& c : report.cases) row.add(c);
    return row;
}

/// The eight floats as the hexadecimal numbers of their bits: exact, NaN included.
Json bits_of(const Ray& ray) {
    Json list = Json::array();
    const auto put = [&](float f) {
        list.push_back(fmt::format("{:08x}", std::bit_cast<uint32_t>(f)));
    };
    for (int a = 0; a < 3; ++a) put(ray.origin[a]);
    put(ray.t_min);
    for (int a = 0; a < 3; ++a) put(ray.direction[a]);
    put(ray.t_max);
    return list;
}

Ray ray_of(const Json& list) {
    float f[8];
    for (size_t i = 0; i < 8; ++i) {
        const std::string text = list.at(i).get<std::string>();
        size_t used = 0;
        const unsigned long bits = std::stoul(text, &used, 16);
        if (used != text.size() || bits > 0xffffffff) throw std::invalid_argument("bits");
        f[i] = std::bit_cast<float>(uint32_t(bits));
    }
    return {{f[0], f[1], f[2]}, f[3], {f[4], f[5], f[6]}, f[7]};
}

}  // namespace

std::string verify_text(const VerifyReport& report, bool by_scene) {
    std::string text = fmt::format(
        "{:<26} {:<16} {:>9} {:>9} {:>5} {:>9} {:>9} {:>9} {:>7} {:>6} {:>4} {:>4} {:>6} {:>9}\n",
        "case", "accelerator", "rays", "hits", "leaks", "f.miss", "f.hit", "wr.prim", "wrong t",
        "bits", "p50", "p99", "p99.9", "max ulp");
    std::vector<Row> rows;
    for (const VerifyCase& c : report.cases) row_named(rows, by_scene ? c.scene : c.recipe).add(c);
    for (const Row& row : rows) print_row(text, row);
    const Row sum = totals(report);
    text += "\n";
    for (size_t i = 0; i < sum.tallies.size(); ++i)
        print_line(text, i == 0 ? "total" : "", sum.accelerators[i], sum.tallies[i]);
    text +=
        "\na/b: wrong within the leaf tests' stated margin / beyond it. bits: hits that differ "
        "from the first accelerator's.\nulp: error of t where the primitive is right.\n";
    for (const std::string& note : report.notes) text += "note: " + note + "\n";
    return text;
}

std::string verify_json(const VerifyReport& report) {
    Json json;
    json["rays"] = report.rays;
    json["faults"] = report.faults();
    const Row sum = totals(report);
    json["accelerators"] = Json::object();
    for (size_t i = 0; i < sum.tallies.size(); ++i)
        json["accelerators"][sum.accelerators[i]] = json_of(sum.tallies[i]);
    json["cases"] = Json::array();
    for (const VerifyCase& c : report.cases) {
        Json item{{"scene", c.scene}, {"recipe", c.recipe}, {"accelerators", Json::object()}};
        for (size_t i = 0; i < c.tallies.size(); ++i)
            item["accelerators"][c.accelerators[i]] = json_of(c.tallies[i]);
        json["cases"].push_back(std::move(item));
    }
    json["notes"] = report.notes;
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

void write_failing(const std::string& file, const std::vector<FailingRay>& rays) {
    std::ofstream out(file);
    for (const FailingRay& f : rays) {
        const Json json{
            {"scene", f.scene},       {"recipe", f.recipe},    {"accelerator", f.accelerator},
            {"kind", f.kind},         {"ray", bits_of(f.ray)}, {"must_hit", f.must_hit},
            {"mode", name_of(f.mode)}};
        out << json.dump(-1, ' ', false, Json::error_handler_t::replace) << "\n";
    }
    out.flush();
    if (!out) throw InputError(file + ": cannot be written");
}

std::vector<FailingRay> read_failing(const std::string& file) {
    std::ifstream in(file);
    if (!in) throw InputError(file + ": no such file, or it cannot be read");
    std::vector<FailingRay> rays;
    std::string line;
    for (size_t number = 1; std::getline(in, line); ++number) {
        if (line.empty()) continue;
        try {
            const Json json = Json::parse(line);
            rays.push_back({json.at("scene"), json.at("recipe"), json.at("accelerator"),
                            json.at("kind"), ray_of(json.at("ray")), json.at("must_hit"),
                            mode_named(json.value("mode", "robust")).value()});
        } catch (const std::exception&) {
            throw InputError(fmt::format("{}:{}: not a line of a file that `crofton verify` wrote",
                                         file, number));
        }
    }
    return rays;
}

VerifyReport replay(const std::string& file, Progress& progress) {
    return replay(read_failing(file), progress);
}

}  // namespace crofton
