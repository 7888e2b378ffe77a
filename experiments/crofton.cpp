#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>

#include "experiments/calibrate.h"
#include "experiments/camera.h"
#include "experiments/catalog.h"
#include "experiments/choice_plot.h"
#include "experiments/experiment.h"
#include "experiments/export.h"
#include "experiments/image.h"
#include "experiments/inspect.h"
#include "experiments/minimise.h"
#include "experiments/peers.h"
#include "experiments/progress.h"
#include "experiments/random.h"
#include "experiments/report.h"
#include "experiments/results.h"
#include "experiments/runner.h"
#include "experiments/sweep.h"
#include "experiments/theorem.h"
#include "experiments/verify.h"
#include "framework/archive.h"
#include "framework/error.h"
#include "scenegraph/auto_plan.h"

namespace crofton {
namespace {

constexpr int check_failed = 1, bad_input = 2;

struct RunArguments {
    std::string config, out, hits;
    std::vector<std::string> settings;
    bool quiet = false;
};

/// A scene with one accelerator for everything, or with what a config's first variant says.
struct StructureArguments {
    std::string scene, accelerator, config, structure;
    std::vector<std::string> settings;
};

struct InspectArguments : StructureArguments {
    InspectOptions options;
    bool explain = false;
};

struct TheoremArguments {
    std::string scene;
    int64_t lines = 256000;
    uint64_t seed = 1;
};

struct BuildArguments : StructureArguments {
    std::string out;
};

struct ExportArguments : StructureArguments {
    std::string out = "boxes.glb";
    ExportOptions options;
};

struct RenderArguments : StructureArguments {
    std::string out = "out.png", shade = "normal";
    std::string eye, at, up;
    double fov = 0;
    int width = 640, height = 480;
};

struct CalibrateArguments {
    bool json = false, cached = false;
};

struct VerifyArguments {
    VerifyOptions options;
    std::string accelerators, recipes, mode = "robust", replay, minimised,
                                       failures = "verify_failures.jsonl";
    bool json = false, quiet = false;
};

std::map<std::string, uint64_t> seeds_of(const ExperimentFile& file) {
    std::map<std::string, uint64_t> seeds;
    for (const Experiment& e : file.experiments)
        for (const WorkloadSpec& w : e.workloads) seeds[w.name] = w.seed;
    return seeds;
}

std::map<std::string, std::string> inputs_of(const ExperimentFile& file) {
    std::map<std::string, std::string> inputs;
    for (const Experiment& e : file.experiments) inputs.merge(file_hashes(e.scene));
    return inputs;
}

/// Plots over all experiments of a run, where there is something to be shown.
void draw_choices(const Results& results, RunOutput& output) {
    const auto save = [&](const std::string& file, const Image& image) {
        write_png(results.path(file), image);
        output.pictures.push_back(file);
    };
    if (!output.budget_rows.empty()) save("regret.png", regret_plot(output.budget_rows));
    if (std::any_of(output.rows.begin(), output.rows.end(),
                    [](const Row& row) { return row.predicted.has_value(); }))
        save("prediction.png", prediction_plot(output.rows));
}

int run(const RunArguments& arguments) {
    const ExperimentFile file = load_experiments(arguments.config, arguments.settings);
    Results results(arguments.out, file.stem);
    results.write_text("resolved.toml", to_toml_document(file.resolved));
    results.write_text("manifest.json",
                       manifest_json(arguments.config, inputs_of(file), seeds_of(file)));
    RunOutput output;
    Progress progress(arguments.quiet);
    size_t steps = 0;
    for (const Experiment& experiment : file.experiments) steps += step_count(experiment);
    progress.set_total(steps);
    for (const Experiment& experiment : file.experiments)
        run_experiment(experiment, arguments.hits, results, progress, output);
    progress.clear();
    draw_choices(results, output);
    const std::string text = report_text(output, results.folder(), false);
    results.write_text("report.txt", text);
    fmt::print("{}", color_on_stdout() ? report_text(output, results.folder(), true) : text);
    return output.mismatches.empty() ? 0 : check_failed;
}

/// "x,y,z" as a TOML array.
ConfigValue vector_value(const std::string& text, const std::string& option) {
    return parse_config_value("[" + text + "]", option);
}

/// What the arguments say, as a config: a key without dots is a parameter of the accelerator.
ConfigValue structure_config(const StructureArguments& arguments) {
    const auto text = [](const std::string& t) { return ConfigValue::of(t, "command line"); };
    ConfigValue root;
    root.place = "command line";
    ConfigValue& scene = root.set("scene", ConfigValue{});
    const SceneSource source = scene_source(arguments.scene);
    ConfigValue& name = source.file.empty() ? scene.set("procedural", text(source.procedural))
                                            : scene.set("file", text(source.file));
    name.from_command_line = true;
    root.set("camera", ConfigValue{});
    ConfigValue& accelerator = root.set("accelerator", ConfigValue{}).set("main", ConfigValue{});
    const auto is_parameter = [](const std::string& setting) {
        return setting.substr(0, setting.find('=')).find('.') == std::string::npos;
    };
    const bool has_parameters =
        std::any_of(arguments.settings.begin(), arguments.settings.end(), is_parameter);
    accelerator.set("type", text(!arguments.accelerator.empty() ? arguments.accelerator
                                 : has_parameters               ? "bvh"
                                                                : "auto"));
    ConfigValue& assign = root.set("assign", ConfigValue{});
    assign.set("top", text("main"));
    assign.set("default", text("main"));
    for (std::string setting : arguments.settings) {
        if (is_parameter(setting)) setting = "accelerator.main." + setting;
        apply_setting(root, setting, config_sections());
    }
    return root;
}

AssemblyPlan plan_of(const StructureArguments& arguments, const Experiment& experiment) {
    if (arguments.config.empty()) return experiment.variants.front().plan;
    return load_experiments(arguments.config, {}).experiments.front().variants.front().plan;
}

/// Chooses for the rays of a camera.
Selection choose(const Experiment& experiment, const Scene& scene, double pixel) {
    ensure_calibration();
    const SceneStatistics s = statistics(scene);
    const BoundingSphere sphere = bounding_sphere(s.bounds_min, s.bounds_max);
    constexpr int width = 32, height = 24;
    const std::vector<Ray> rays =
        camera_rays(choose_camera(experiment.scene.camera, scene, sphere), width, height);
    const ObjectiveSpec& o = experiment.objective;
    AutoOptions options;
    options.objective = {o.rays.value_or(1e6), o.memory, o.priority};
    options.max_error = o.max_error;
    options.pixel_angle = pixel;
    options.clock = o.clock;
    return choose_assembly(scene, options, {rays, false, experiment.run.mode}, calibration());
}

/// Builds, or loads what was saved for this scene.
/// @param pixel  angle in radians for structures that end rays early; 0: their own default
Assembly assemble(const StructureArguments& arguments, const Experiment& experiment,
                  const Scene& scene, double pixel = 0) {
    if (arguments.structure.empty()) {
        const AssemblyPlan plan = plan_of(arguments, experiment);
        if (chooses_all(plan)) return choose(experiment, scene, pixel).assembly;
        if (canonical(plan).find("auto{") != std::string::npos) ensure_calibration();
        return assemble(scene, with_pixel_angle(plan, pixel));
    }
    SavedStructure saved = load_structure(arguments.structure);
    if (saved.subject != fingerprint(scene))
        throw InputError(arguments.structure + ": was saved for another scene than '" +
                         arguments.scene + "'");
    Assembly assembly;
    assembly.root = std::move(saved.root);
    return assembly;
}

/// What `auto` would choose, with all candidates.
int explain(const InspectArguments& arguments, const Experiment& experiment, const Scene& scene) {
    Selection selection = choose(experiment, scene, 0);
    const ObjectiveSpec& o = experiment.objective;
    fmt::print("{}\n{}", inspect_text(scene, &selection.assembly, arguments.options),
               explanation(selection, {o.rays.value_or(1e6), o.memory, o.priority}));
    return 0;
}

int inspect(const InspectArguments& arguments) {
    const Experiment experiment = parse_experiment(structure_config(arguments), "");
    const Scene scene = make_scene(experiment.scene);
    if (arguments.explain) return explain(arguments, experiment, scene);
    std::unique_ptr<Assembly> assembly;
    if (!arguments.config.empty() || !arguments.accelerator.empty())
        assembly = std::make_unique<Assembly>(assemble(arguments, experiment, scene));
    fmt::print("{}", inspect_text(scene, assembly.get(), arguments.options));
    return 0;
}

int build(const BuildArguments& arguments) {
    const Experiment experiment = parse_experiment(structure_config(arguments), "");
    const Scene scene = make_scene(experiment.scene);
    const Assembly assembly = assemble(arguments, experiment, scene);
    save_structure(*assembly.root, arguments.out, fingerprint(scene));
    fmt::print("{}: {} bytes, built in {:.3f} s\n", arguments.out,
               std::filesystem::file_size(arguments.out), assembly.build_s);
    return 0;
}

int export_wireframes(const ExportArguments& arguments) {
    const Experiment experiment = parse_experiment(structure_config(arguments), "");
    const Scene scene = make_scene(experiment.scene);
    const Assembly assembly = assemble(arguments, experiment, scene);
    const ExportCount count = export_boxes(*assembly.root, arguments.out, arguments.options);
    fmt::print("{}: {} boxes in {} structures, placed {} times\n", arguments.out, count.boxes,
               count.structures, count.placements);
    return 0;
}

/// What `render` does, as a config.
ConfigValue render_config(const RenderArguments& arguments) {
    ConfigValue root = structure_config(arguments);
    ConfigValue& camera = *root.find("camera");
    if (!arguments.eye.empty()) camera.set("eye", vector_value(arguments.eye, "--eye"));
    if (!arguments.at.empty()) camera.set("at", vector_value(arguments.at, "--at"));
    if (!arguments.up.empty()) camera.set("up", vector_value(arguments.up, "--up"));
    if (arguments.fov != 0) camera.set("fov", ConfigValue::of(arguments.fov, "--fov"));
    return root;
}

int render(const RenderArguments& arguments) {
    const Experiment experiment = parse_experiment(render_config(arguments), "");
    Progress progress;
    progress.set_total(3);
    progress.step("loading the scene");
    const Scene scene = make_scene(experiment.scene);
    const SceneStatistics s = statistics(scene);
    progress.step(arguments.structure.empty() ? "building" : "loading the structure");
    const BoundingSphere sphere = bounding_sphere(s.bounds_min, s.bounds_max);
    const Camera camera = choose_camera(experiment.scene.camera, scene, sphere);
    const Assembly assembly =
        assemble(arguments, experiment, scene, pixel_angle(camera, arguments.height));
    progress.step("drawing");
    const Primitive& root = *assembly.root;
    if (arguments.shade == "normal") {
        write_png(arguments.out,
                  normal_image(scene, root, camera, arguments.width, arguments.height));
    } else {
        constexpr double max_s = 60;
        const CostMap map = cost_map(root, camera, arguments.width, arguments.height, max_s);
        write_png(arguments.out, heat_image(map, map.highest));
    }
    progress.clear();
    fmt::print("{}\n", arguments.out);
    return 0;
}

std::vector<std::string> split_names(const std::string& text) {
    std::vector<std::string> names;
    for (size_t begin = 0; begin < text.size();) {
        const size_t end = std::min(text.find(',', begin), text.size());
        if (end > begin) names.push_back(text.substr(begin, end - begin));
        begin = end + 1;
    }
    return names;
}

int verify(VerifyArguments arguments) {
    Progress progress(arguments.quiet);
    arguments.options.accelerators = split_names(arguments.accelerators);
    arguments.options.recipes = split_names(arguments.recipes);
    arguments.options.mode = *mode_named(arguments.mode);
    const bool again = !arguments.replay.empty();
    if (!arguments.minimised.empty()) {
        if (!again) throw InputError("--minimise needs --replay FILE");
        fmt::print("{}\n", minimise_to_files(read_failing(arguments.replay), arguments.minimised));
        return 0;
    }
    const VerifyReport report =
        again ? replay(arguments.replay, progress) : verify(arguments.options, progress);
    const bool by_scene = again || arguments.options.scene.empty();
    fmt::print("{}", arguments.json ? verify_json(report) : verify_text(report, by_scene));
    if (report.faults() == 0) return 0;
    if (!again) write_failing(arguments.failures, report.failing);
    const std::string where = again ? arguments.replay : arguments.failures;
    fmt::print(stderr, "{} faults; to see them again: crofton verify --replay {}\n",
               report.faults(), where);
    return check_failed;
}

void add_verify(CLI::App& app, VerifyArguments& a) {
    CLI::App& sub = *app.add_subcommand(
        "verify", "Compare every accelerator with exact arithmetic over rays that are hard");
    sub.add_option("scene", a.options.scene,
                   "File, procedural:NAME or catalogue:NAME; otherwise all of the catalogue");
    sub.add_option("--accelerators", a.accelerators, "Names with commas between; otherwise all");
    sub.add_option("--recipes", a.recipes, "Kinds of rays, commas between; otherwise all");
    const auto modes = mode_names();
    sub.add_option("--mode", a.mode, "Of the queries; the truth is then that of the mode")
        ->capture_default_str()
        ->check(CLI::IsMember(std::vector<std::string>(modes.begin(), modes.end())));
    sub.add_option("--rays", a.options.rays, "In all, over scenes and recipes")
        ->capture_default_str()
        ->check(CLI::Range(uint64_t{1}, uint64_t{1} << 40));
    sub.add_option("--seed", a.options.seed, "Of the rays")->capture_default_str();
    sub.add_option("--failures", a.failures, "File for rays that made a fault, if there are any")
        ->capture_default_str();
    sub.add_option("--replay", a.replay, "Run the rays of such a file again");
    sub.add_option("--minimise", a.minimised,
                   "With --replay: shrink its first failing scene and ray; OBJ file to write");
    sub.add_flag("--json", a.json, "As JSON");
    sub.add_flag("--quiet", a.quiet, "No progress");
}

int calibrate(const CalibrateArguments& arguments) {
    if (arguments.cached) {
        ensure_calibration();
    } else {
        set_calibration(measure_calibration());
        write_calibration(calibration(), calibration_path(calibration().machine));
    }
    const Calibration& c = calibration();
    fmt::print("{}", arguments.json ? calibration_json(c) : calibration_text(c));
    if (!arguments.json) fmt::print("\nCached: {}\n", calibration_path(c.machine));
    return 0;
}

int theorem(const TheoremArguments& arguments) {
    StructureArguments structure;
    structure.scene = arguments.scene;
    const Experiment experiment = parse_experiment(structure_config(structure), "");
    fmt::print("{}", theorem_text(crofton_theorem(make_scene(experiment.scene), arguments.lines,
                                                  arguments.seed)));
    return 0;
}

void add_theorem(CLI::App& app, TheoremArguments& a) {
    CLI::App& sub = *app.add_subcommand(
        "theorem", "Show Crofton's theorem on a scene: areas and probabilities from random lines");
    sub.add_option("scene", a.scene, "File, or procedural:NAME")->required();
    sub.add_option("--lines", a.lines, "At most")
        ->capture_default_str()
        ->check(CLI::Range(int64_t{1000}, int64_t{1} << 28));
    sub.add_option("--seed", a.seed, "Of the lines")->capture_default_str();
}

void add_calibrate(CLI::App& app, CalibrateArguments& a) {
    CLI::App& sub = *app.add_subcommand(
        "calibrate", "Measure what this machine's rays, builds and memory cost, and cache it");
    sub.add_flag("--json", a.json, "As JSON");
    sub.add_flag("--cached", a.cached, "Show what is cached; measure only if nothing is");
}

void add_run(CLI::App& app, RunArguments& a) {
    CLI::App& sub =
        *app.add_subcommand("run", "Run an experiment: build, check, time, count, draw");
    sub.add_option("config", a.config, "Experiment (TOML)")->required();
    sub.add_option("--out", a.out, "Folder for the results; otherwise results/NAME-TIME");
    sub.add_option("--set", a.settings, "path=value: overrides a key, e.g. run.repeats=11")
        ->expected(1)
        ->take_all();
    sub.add_option("--hits", a.hits,
                   "File for the hits of each ray: float32 t, u, v, uint32 primitive, geometry, "
                   "instance; may contain {variant} and {workload}");
    sub.add_flag("--quiet", a.quiet, "No progress");
}

/// What says which structure is meant; `loads`: one that was saved will do.
void add_structure(CLI::App& sub, StructureArguments& a, bool loads) {
    sub.add_option("scene", a.scene, "File, or procedural:NAME")->required();
    CLI::Option* accelerator =
        sub.add_option("--accelerator", a.accelerator, "For everything; otherwise auto");
    CLI::Option* config =
        sub.add_option("--config", a.config, "As the first variant of this config says")
            ->excludes(accelerator);
    sub.add_option("--set", a.settings,
                   "key=value: a parameter of the accelerator, or of the scene as "
                   "scene.parameters.KEY=VALUE")
        ->expected(1)
        ->take_all();
    if (loads)
        sub.add_option("--structure", a.structure, "Not built, but loaded: a file of `build`")
            ->excludes(accelerator)
            ->excludes(config);
}

void add_inspect(CLI::App& app, InspectArguments& a) {
    CLI::App& sub = *app.add_subcommand("inspect", "Show what a scene holds");
    add_structure(sub, a, false);
    sub.add_flag("--json", a.options.json, "As JSON, without the tree of nodes");
    sub.add_flag("--all", a.options.all, "Every node, however many");
    sub.add_flag("--explain", a.explain,
                 "What auto chooses and why: every candidate with its expected costs, for the rays "
                 "of --set objective.rays=N (1e6)");
}

void add_build(CLI::App& app, BuildArguments& a) {
    CLI::App& sub = *app.add_subcommand("build", "Build a scene's structure and save it");
    add_structure(sub, a, false);
    sub.add_option("-o,--out", a.out, "File to write")->required();
}

void add_export(CLI::App& app, ExportArguments& a) {
    CLI::App& sub =
        *app.add_subcommand("export", "Write a structure's boxes as wireframes (binary glTF)");
    add_structure(sub, a, true);
    sub.add_option("-o,--out", a.out, "GLB to write")->capture_default_str();
    sub.add_option("--depth", a.options.depth, "Deepest level of each structure; 0: its root")
        ->check(CLI::NonNegativeNumber);
    sub.add_flag("--empty", a.options.empty_cells, "Empty leaves and cells, too");
}

void add_render(CLI::App& app, RenderArguments& a) {
    CLI::App& sub = *app.add_subcommand("render", "Draw a scene as a PNG");
    add_structure(sub, a, true);
    sub.add_option("-o,--out", a.out, "PNG to write")->capture_default_str();
    sub.add_option("--shade", a.shade, "normal, or cost: a heat map of steps and tests")
        ->capture_default_str()
        ->check(CLI::IsMember({"normal", "cost"}));
    sub.add_option("--width", a.width, "Pixels")
        ->capture_default_str()
        ->check(CLI::Range(1, 16384));
    sub.add_option("--height", a.height, "Pixels")
        ->capture_default_str()
        ->check(CLI::Range(1, 16384));
    sub.add_option("--eye", a.eye, "x,y,z: where the camera stands");
    sub.add_option("--at", a.at, "x,y,z: what it looks at");
    sub.add_option("--up", a.up, "x,y,z: otherwise 0,1,0");
    sub.add_option("--fov", a.fov,
                   "Vertical field of view in degrees; otherwise the camera's, or 45");
}

/// @return  exit code
int dispatch(int argc, char** argv) {
    register_peers();
    CLI::App app("Crofton: nested acceleration structures for ray intersection, and their costs");
    app.require_subcommand(1);
    app.set_version_flag("--version", version_text());
    RunArguments run_arguments;
    InspectArguments inspect_arguments;
    RenderArguments render_arguments;
    BuildArguments build_arguments;
    ExportArguments export_arguments;
    VerifyArguments verify_arguments;
    CalibrateArguments calibrate_arguments;
    TheoremArguments theorem_arguments;
    bool list_json = false;
    add_run(app, run_arguments);
    add_inspect(app, inspect_arguments);
    add_render(app, render_arguments);
    add_build(app, build_arguments);
    add_export(app, export_arguments);
    add_verify(app, verify_arguments);
    add_calibrate(app, calibrate_arguments);
    add_theorem(app, theorem_arguments);
    CLI::App& list = *app.add_subcommand("list", "List accelerators, workloads and scenes");
    list.add_flag("--json", list_json, "As JSON");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        // Help and the version are no errors; everything else is bad input.
        if (error.get_exit_code() == 0) return app.exit(error);
        throw InputError(error.what());
    }
    if (app.got_subcommand("run")) return run(run_arguments);
    if (app.got_subcommand("inspect")) return inspect(inspect_arguments);
    if (app.got_subcommand("render")) return render(render_arguments);
    if (app.got_subcommand("build")) return build(build_arguments);
    if (app.got_subcommand("export")) return export_wireframes(export_arguments);
    if (app.got_subcommand("verify")) return verify(verify_arguments);
    if (app.got_subcommand("calibrate")) return calibrate(calibrate_arguments);
    if (app.got_subcommand("theorem")) return theorem(theorem_arguments);
    fmt::print("{}", list_json ? catalog_json() : catalog_text());
    return 0;
}

std::string one_line(std::string text) {
    std::replace(text.begin(), text.end(), '\n', ' ');
    return text;
}

}  // namespace
}  // namespace crofton

int main(int argc, char** argv) {
    try {
        return crofton::dispatch(argc, argv);
    } catch (const crofton::InputError& error) {
        fmt::print(stderr, "crofton: error: {}\n", crofton::one_line(error.what()));
    } catch (const std::bad_alloc&) {
        fmt::print(stderr, "crofton: error: not enough memory for this input\n");
    } catch (const std::exception& error) {
        fmt::print(stderr, "crofton: error: {}\n", crofton::one_line(error.what()));
    }
    return crofton::bad_input;
}
