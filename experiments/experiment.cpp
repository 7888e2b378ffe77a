#include "experiments/experiment.h"

#include <algorithm>
#include <filesystem>

#include "experiments/sweep.h"
#include "framework/error.h"
#include "framework/registry.h"

namespace crofton {
namespace {

namespace fs = std::filesystem;

constexpr int64_t most_rays = int64_t{1} << 28;  ///< 8 GiB of rays

bool any_by_default(const std::string& type) {
    return type == "shadow" || type == "ambient_occlusion";
}

void read_image_size(ConfigTable& table, WorkloadSpec& spec) {
    const auto width = table.integer("width", 1, 1 << 15);
    const auto height = table.integer("height", 1, 1 << 15);
    const auto rays = table.integer("rays", 1, most_rays);
    if (width.has_value() != height.has_value())
        table.fail("width", table.what() + ": 'width' and 'height' belong together");
    if (width && rays && spec.type == "primary")
        table.fail("rays", table.what() + ": either 'rays' or 'width' and 'height', not both");
    spec.width = width.value_or(0);
    spec.height = height.value_or(0);
    spec.rays = rays.value_or(width ? *width * *height : 250000);
    if (!width && !rays) table.raw().set("rays", ConfigValue::of(spec.rays));
}

std::string ray_file(ConfigTable& table, const std::string& folder) {
    if (!table.string("file")) table.fail("file", table.what() + ": missing key 'file'");
    ConfigValue& value = *table.value("file");
    fs::path path = value.text;
    if (path.is_relative() && !value.from_command_line) path = fs::path(folder) / path;
    if (std::error_code error; !fs::is_regular_file(path, error))
        table.fail("file", "file: '" + path.string() + "' does not exist");
    return value.text = fs::absolute(path).lexically_normal().string();
}

WorkloadSpec read_workload(ConfigTable& table, const std::string& folder) {
    WorkloadSpec spec;
    std::vector<std::string> types;
    for (const auto& [type, text] : workload_types()) types.push_back(type);
    if (!table.has("type")) table.fail("type", table.what() + ": missing key 'type'");
    spec.type = table.string("type", "", types);
    spec.name = table.string("name", spec.type);
    const std::string query = any_by_default(spec.type) ? "any" : "closest";
    spec.any = table.string("query", query, {"closest", "any"}) == "any";
    spec.shuffle = table.boolean("shuffle", false);
    spec.seed = uint64_t(table.integer("seed", 1, 0, int64_t{1} << 62));
    if (spec.type == "file") {
        spec.file = ray_file(table, folder);
    } else if (spec.type == "random" || spec.type == "vertex" || spec.type == "edge") {
        spec.rays = table.integer("rays", 100000, 1, most_rays);
    } else {
        read_image_size(table, spec);
        spec.camera = table.integer("camera", 0, 0, 1 << 20);
    }
    if (spec.type == "ambient_occlusion") spec.distance = table.real("distance", 0.1, 1e-6, 1e6);
    table.finish();
    return spec;
}

std::vector<WorkloadSpec> read_workloads(ConfigTable& root, const std::string& folder) {
    if (!root.has("workload")) {
        ConfigValue one;
        one.set("type", ConfigValue::of(std::string("primary")));
        ConfigValue list;
        list.type = ConfigValue::Type::array;
        list.items.push_back(std::move(one));
        root.raw().set("workload", std::move(list));
    }
    std::vector<WorkloadSpec> out;
    for (ConfigTable& table : root.tables("workload")) {
        out.push_back(read_workload(table, folder));
        for (size_t i = 0; i + 1 < out.size(); ++i)
            if (out[i].name == out.back().name)
                table.fail("name", "two workloads are named '" + out[i].name +
                                       "'; give one another 'name'");
    }
    if (out.empty()) root.fail("workload", "no workloads");
    return out;
}

/// Ascending numbers of rays.
std::vector<double> read_budgets(ConfigTable& table) {
    const ConfigValue* list = table.value("budgets");
    if (!list) return {};
    if (!list->is_array()) table.fail("budgets", "budgets: expected an array of numbers");
    const auto budgets = table.reals("budgets", list->items.size());
    for (size_t i = 0; i < budgets->size(); ++i)
        if (!((*budgets)[i] >= 1 && (*budgets)[i] <= 1e15) ||
            (i > 0 && (*budgets)[i] <= (*budgets)[i - 1]))
            table.fail("budgets", "budgets: expected ascending numbers of rays, 1 … 1e15");
    return *budgets;
}

ObjectiveSpec read_objective(ConfigTable table) {
    ObjectiveSpec objective;
    objective.rays = table.real("rays", 1, 1e15);
    objective.memory = table.real("memory", objective.memory, 0, 1e15);
    const std::string priority = table.string("priority", "total", {"total", "trace", "build"});
    objective.priority = priority == "trace"   ? Priority::trace
                         : priority == "build" ? Priority::build
                                               : Priority::total;
    objective.max_error = table.real("max_error", objective.max_error, 0, 64);
    objective.clock = table.boolean("clock", objective.clock);
    table.finish();
    return objective;
}

RunSpec read_run(ConfigTable table) {
    RunSpec run;
    run.repeats = table.integer("repeats", run.repeats, 1, 10000);
    run.builds = table.integer("builds", run.builds, 1, 10000);
    run.threads = table.integer("threads", run.threads, 0, 4096);
    run.pin = table.boolean("pin", run.pin);
    std::vector<std::string> isas = available_isas();
    isas.emplace_back("");
    run.isa = table.string("isa", run.isa, isas);
    run.check = table.boolean("check", run.check);
    run.pictures = table.boolean("pictures", run.pictures);
    run.picture_width = table.integer("picture_width", run.picture_width, 64, 8192);
    run.picture_height = table.integer("picture_height", run.picture_height, 64, 8192);
    run.max_pass_s = table.real("max_pass_s", run.max_pass_s, 1e-3, 1e6);
    run.max_check_s = table.real("max_check_s", run.max_check_s, 0, 1e6);
    const auto modes = mode_names();
    run.mode = *mode_named(table.string("mode", name_of(run.mode), {modes.begin(), modes.end()}));
    run.oracle = table.integer("oracle", run.oracle, 0, 1 << 24);
    run.plot = table.boolean("plot", run.plot);
    if (run.plot && run.oracle == 0)
        table.fail("plot", "plot: needs 'oracle', the number of rays to judge");
    run.budgets = read_budgets(table);
    run.predict = table.boolean("predict", run.predict);
    run.first_image = table.integer("first_image", run.first_image, 0, 1000);
    table.finish();
    return run;
}

std::string text_of(const ConfigValue& root, const std::string& key) {
    const ConfigValue* value = root.find(key);
    return value ? to_toml(*value) : std::string();
}

bool same_runs(const Experiment& a, const Experiment& b) {
    return a.scene_canonical == b.scene_canonical && a.run_canonical == b.run_canonical &&
           a.workload_canonical == b.workload_canonical;
}

bool same_variant(const Variant& a, const Variant& b) {
    return a.name == b.name && a.canonical == b.canonical && a.max_rays == b.max_rays &&
           a.mode == b.mode && a.single == b.single;
}

/// Adds an experiment to the list, or its variants to one that shares all the rest.
void merge(std::vector<Experiment>& list, Experiment experiment) {
    const auto found = std::find_if(list.begin(), list.end(), [&](const Experiment& other) {
        return same_runs(other, experiment);
    });
    if (found == list.end()) {
        list.push_back(std::move(experiment));
        return;
    }
    for (Variant& variant : experiment.variants) {
        const bool known = std::any_of(found->variants.begin(), found->variants.end(),
                                       [&](const Variant& v) { return same_variant(v, variant); });
        if (!known) found->variants.push_back(std::move(variant));
    }
}

std::string sweep_suffix(const Variant& variant) {
    std::string text;
    for (const auto& [path, value] : variant.sweep) {
        const std::string shown =
            value.type == ConfigValue::Type::string ? value.text : to_toml(value);
        text += (text.empty() ? "[" : ",") + path.substr(path.rfind('.') + 1) + "=" + shown;
    }
    return text.empty() ? text : text + "]";
}

/// Variants of one name from several points of a sweep get their values into the name.
void name_apart(Experiment& experiment) {
    std::map<std::string, int> uses;
    for (const Variant& variant : experiment.variants) ++uses[variant.name];
    for (Variant& variant : experiment.variants)
        if (uses[variant.name] > 1) variant.name += sweep_suffix(variant);
}

}  // namespace

const std::vector<std::string>& config_sections() {
    static const std::vector<std::string> sections = {
        "description", "scene",     "camera",   "accelerator", "assign",
        "variant",     "objective", "workload", "run",         "sweep"};
    return sections;
}

const std::vector<std::pair<std::string, std::string>>& workload_types() {
    static const std::vector<std::pair<std::string, std::string>> types = {
        {"primary", "rays from the scene's camera, or one fitted to it, through pixel centres"},
        {"shadow", "from what primary rays hit to the lights, or to one above a scene without any"},
        {"ambient_occlusion", "cosine-distributed short rays from what primary rays hit"},
        {"diffuse", "cosine-distributed rays from what primary rays hit: one diffuse bounce"},
        {"random", "isotropic lines, uniform over the bounding sphere: the Crofton measure"},
        {"vertex", "from around the scene to its vertices, exactly: d = fl(vertex - o)"},
        {"edge", "from around the scene to points of its edges, as near as floats are"},
        {"file", "rays from a file: little-endian float32 x 8: origin, t_min, direction, t_max"},
    };
    return types;
}

Experiment parse_experiment(ConfigValue config, const std::string& folder) {
    Experiment experiment;
    ConfigTable root(config, "");
    for (const std::string& section : config_sections()) root.value(section);
    root.finish();
    root.string("description", "");
    experiment.scene = parse_scene(root, folder);
    experiment.variants = parse_variants(root);
    experiment.workloads = read_workloads(root, folder);
    experiment.run = read_run(root.table("run"));
    experiment.objective = read_objective(root.table("objective"));
    for (Variant& variant : experiment.variants)
        if (!variant.mode) variant.mode = experiment.run.mode;
    experiment.scene_canonical = text_of(config, "scene") + text_of(config, "camera");
    experiment.run_canonical = text_of(config, "run") + text_of(config, "objective");
    for (const ConfigValue& item : config.find("workload")->items)
        experiment.workload_canonical.push_back(to_toml(item));
    experiment.resolved = std::move(config);
    return experiment;
}

ExperimentFile make_experiments(ConfigValue config, const std::string& stem,
                                const std::string& folder,
                                const std::vector<std::string>& settings) {
    for (const std::string& setting : settings) apply_setting(config, setting, config_sections());
    ExperimentFile file;
    file.stem = stem;
    for (SweepPoint& point : expand_sweep(config, config_sections())) {
        Experiment experiment = parse_experiment(std::move(point.config), folder);
        for (Variant& variant : experiment.variants) variant.sweep = point.values;
        if (file.experiments.empty()) file.resolved = experiment.resolved;
        merge(file.experiments, std::move(experiment));
    }
    for (Experiment& experiment : file.experiments) name_apart(experiment);
    if (const ConfigValue* sweep = config.find("sweep")) file.resolved.set("sweep", *sweep);
    return file;
}

ExperimentFile load_experiments(const std::string& path, const std::vector<std::string>& settings) {
    const fs::path file = path;
    return make_experiments(read_config(path), file.stem().string(), file.parent_path().string(),
                            settings);
}

}  // namespace crofton
