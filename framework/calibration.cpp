#include "framework/calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "framework/config.h"
#include "framework/error.h"
#include "framework/parallel.h"
#include "framework/registry.h"

namespace crofton {
namespace {

namespace fs = std::filesystem;

constexpr int64_t file_version = 4;
constexpr double most = 1e300;

/// Between two points on logarithmic axes, and beyond them.
double interpolated(double x, double x0, double y0, double x1, double y1) {
    if (!(y0 > 0) || !(y1 > 0) || x0 == x1) return y1;
    const double slope = std::log(y1 / y0) / std::log(x1 / x0);
    return y0 * std::pow(x / x0, slope);
}

ConfigValue array_of(const std::vector<double>& numbers) {
    ConfigValue value;
    value.type = ConfigValue::Type::array;
    for (const double x : numbers) value.items.push_back(ConfigValue::of(x));
    return value;
}

ConfigValue value_of(const MeasuredCost& cost) { return array_of({cost.ns, cost.low, cost.high}); }

ConfigValue value_of(const StructureCosts& s) {
    ConfigValue table;
    table.set("structure", ConfigValue::of(s.structure));
    table.set("shapes", ConfigValue::of(s.shapes));
    table.set("spread", array_of({s.ray_spread, s.build_spread}));
    table.set("thinned", array_of({s.thin_apart, s.thin_build, s.thin_together}));
    table.set("test_share", ConfigValue::of(s.test_share));
    table.set("counted", array_of({s.per_ray, s.per_step, s.per_test, s.per_doubling, s.fit_error,
                                   s.counted_together}));
    ConfigValue growth;
    growth.type = ConfigValue::Type::array;
    for (const GrowthPoint& p : s.growth)
        growth.items.push_back(
            array_of({p.shapes, p.build_ns, p.bytes, p.ray_ns, p.together, p.apart}));
    table.set("growth", std::move(growth));
    return table;
}

ConfigValue value_of(const MemoryLevel& level) {
    ConfigValue table;
    table.set("name", ConfigValue::of(level.name));
    table.set("bytes", ConfigValue::of(level.bytes));
    table.set("load", value_of(level.load));
    return table;
}

template <class T>
ConfigValue list_of(const std::vector<T>& values) {
    ConfigValue list;
    list.type = ConfigValue::Type::array;
    for (const T& v : values) list.items.push_back(value_of(v));
    return list;
}

std::vector<double> required(ConfigTable& table, const std::string& key, size_t count) {
    auto numbers = table.reals(key, count);
    if (!numbers) table.fail(key, table.what() + ": missing key '" + key + "'");
    return *numbers;
}

MeasuredCost read_cost(ConfigTable& table, const std::string& key) {
    const std::vector<double> v = required(table, key, 3);
    return {v[0], v[1], v[2]};
}

StructureCosts read_structure(ConfigTable& table) {
    StructureCosts s;
    s.structure = table.string("structure", "");
    s.shapes = table.string("shapes", "");
    const std::vector<double> spread = required(table, "spread", 2);
    s.ray_spread = spread[0], s.build_spread = spread[1];
    const std::vector<double> thinned = required(table, "thinned", 3);
    s.thin_apart = thinned[0], s.thin_build = thinned[1], s.thin_together = thinned[2];
    s.test_share = table.real("test_share", 0, 0, 1);
    const std::vector<double> c = required(table, "counted", 6);
    s.per_ray = c[0], s.per_step = c[1], s.per_test = c[2], s.per_doubling = c[3];
    s.fit_error = c[4], s.counted_together = c[5];
    ConfigValue* growth = table.value("growth");
    if (!growth || !growth->is_array() || growth->items.empty())
        table.fail("growth", table.what() + ": growth: expected an array of points");
    for (ConfigValue& item : growth->items) {
        ConfigValue wrapper;
        wrapper.place = item.place;
        wrapper.set("point", item);
        ConfigTable point(wrapper, "growth");
        const std::vector<double> v = required(point, "point", 6);
        s.growth.push_back({v[0], v[1], v[2], v[3], v[4], v[5]});
    }
    table.finish();
    return s;
}

Calibration& current() {
    static Calibration calibration = Calibration::nominal();
    return calibration;
}

}  // namespace

std::string cpu_model() {
    std::ifstream file("/proc/cpuinfo");
    for (std::string line; std::getline(file, line);)
        if (line.starts_with("model name"))
            return line.substr(std::min(line.size(), line.find(':') + 2));
    return "unknown";
}

MachineIdentity MachineIdentity::here(const std::string& version) {
    return {cpu_model(), active_isa(), version, crofton::threads()};
}

std::string MachineIdentity::hash() const {
    uint64_t h = 14695981039346656037ull;  // FNV-1a
    for (const std::string& part : {cpu, isa, version, std::to_string(threads)}) {
        for (const char c : part + '\n') h = (h ^ static_cast<unsigned char>(c)) * 1099511628211ull;
    }
    return fmt::format("{:016x}", h);
}

GrowthPoint StructureCosts::at(double shapes) const {
    const double n = std::max(1.0, shapes);
    if (growth.size() == 1 || n <= growth.front().shapes) {
        // Below the first point only the count is known to matter.
        GrowthPoint p = growth.front();
        p.shapes = n;
        return p;
    }
    size_t i = 1;
    while (i + 1 < growth.size() && growth[i].shapes < n) ++i;
    const GrowthPoint &a = growth[i - 1], &b = growth[i];
    const auto between = [&](double y0, double y1) {
        return interpolated(n, a.shapes, y0, b.shapes, y1);
    };
    GrowthPoint p = b;
    p.shapes = n;
    p.build_ns = between(a.build_ns, b.build_ns);
    p.bytes = between(a.bytes, b.bytes);
    p.ray_ns = between(a.ray_ns, b.ray_ns);
    if (n < b.shapes) {  // beyond the last point no slope goes on in these
        p.together = between(a.together, b.together);
        p.apart = between(a.apart, b.apart);
    }
    return p;
}

double StructureCosts::counted_ns(double steps, double tests, double bytes,
                                  double cache_bytes) const {
    const double doublings = std::max(0.0, std::log2(bytes / cache_bytes));
    return per_ray + (per_step * steps + per_test * tests) * (1 + per_doubling * doublings);
}

const StructureCosts* Calibration::find(const std::string& structure,
                                        const std::string& shapes) const {
    for (const StructureCosts& s : structures)
        if (s.structure == structure && s.shapes == shapes) return &s;
    return nullptr;
}

std::string calibration_path(const MachineIdentity& machine) {
    const char* cache = std::getenv("XDG_CACHE_HOME");
    const char* home = std::getenv("HOME");
    const fs::path base = cache && *cache ? fs::path(cache)
                          : home && *home ? fs::path(home) / ".cache"
                                          : fs::temp_directory_path();
    return (base / "crofton" / ("calibration-" + machine.hash() + ".toml")).string();
}

std::string to_toml(const Calibration& c) {
    ConfigValue root;
    root.set("version", ConfigValue::of(file_version));
    ConfigValue& machine = root.set("machine", ConfigValue{});
    machine.set("cpu", ConfigValue::of(c.machine.cpu));
    machine.set("isa", ConfigValue::of(c.machine.isa));
    machine.set("crofton", ConfigValue::of(c.machine.version));
    machine.set("threads", ConfigValue::of(int64_t(c.machine.threads)));
    root.set("measured_s", ConfigValue::of(c.measured_s));
    root.set("cache_bytes", ConfigValue::of(c.cache_bytes));
    ConfigValue& constants = root.set("constant", ConfigValue{});
    for (const auto& [name, cost] : c.constants) constants.set(name, value_of(cost));
    root.set("memory", list_of(c.memory));
    root.set("structure", list_of(c.structures));
    return to_toml_document(root);
}

Calibration read_calibration(const std::string& path) {
    ConfigValue config = read_config(path);
    ConfigTable root(config, path);
    Calibration c;
    if (!root.integer("version", file_version, file_version))
        root.fail("version", path + ": missing key 'version'");
    ConfigTable machine = root.table("machine");
    c.machine.cpu = machine.string("cpu", "");
    c.machine.isa = machine.string("isa", "");
    c.machine.version = machine.string("crofton", "");
    c.machine.threads = int(machine.integer("threads", 0, 0, 1 << 20));
    machine.finish();
    c.measured_s = root.real("measured_s", 0, 0, most);
    c.cache_bytes = root.real("cache_bytes", c.cache_bytes, 1, most);
    ConfigTable constants = root.table("constant");
    for (const ConfigValue& item : constants.raw().items)
        c.constants[item.key] = read_cost(constants, item.key);
    for (ConfigTable& level : root.tables("memory")) {
        MemoryLevel m{level.string("name", ""), level.real("bytes", 0, 0, most), {}};
        m.load = read_cost(level, "load");
        level.finish();
        c.memory.push_back(std::move(m));
    }
    for (ConfigTable& structure : root.tables("structure"))
        c.structures.push_back(read_structure(structure));
    root.finish();
    return c;
}

void write_calibration(const Calibration& calibration, const std::string& path) {
    std::error_code error;
    fs::create_directories(fs::path(path).parent_path(), error);
    // Written beside and moved, so that no one reads half of it.
    const std::string part = path + ".part";
    std::ofstream out(part, std::ios::binary);
    out << to_toml(calibration);
    out.close();
    if (out) fs::rename(part, path, error);
    if (!out || error) throw InputError(path + ": cannot be written");
}

void set_calibration(Calibration calibration) { current() = std::move(calibration); }
const Calibration& calibration() { return current(); }

}  // namespace crofton
