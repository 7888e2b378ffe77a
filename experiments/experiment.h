#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "experiments/plan.h"
#include "experiments/scene_source.h"
#include "framework/config.h"

/// From a config to what is to be done: everything is checked before anything is loaded or built.
namespace crofton {

/// The rays of one workload; see workload.h for what each type does.
struct WorkloadSpec {
    std::string name;
    std::string type;
    bool any = false;  ///< query: any hit rather than the closest
    int64_t rays = 0;
    int64_t width = 0, height = 0;  ///< 0: chosen to match `rays`
    int64_t camera = 0;             ///< index; beyond the scene's cameras: a fitted one
    uint64_t seed = 1;
    double distance = 0;  ///< ambient occlusion: t_max as a fraction of the scene's diagonal
    bool shuffle = false;
    std::string file;
};

struct RunSpec {
    int64_t repeats = 7;
    int64_t builds = 1;  ///< of each structure; its time is their median
    int64_t threads = 1;
    bool pin = true;
    std::string isa;  ///< "" = the widest of this machine
    bool check = true;
    bool pictures = true;
    int64_t picture_width = 480, picture_height = 360;
    double max_pass_s = 0.5;
    double max_check_s = 20;
    Mode mode = Mode::robust;     ///< of variants without their own
    int64_t oracle = 0;           ///< rays of each workload to compare with the oracle; 0: none
    bool plot = false;            ///< time against error
    std::vector<double> budgets;  ///< rays; for each a row of the total time, see README
    bool predict = false;         ///< costs of every variant, before and after its build
    int64_t first_image = 0;  ///< times to build anew and trace a workload once; 0: not measured
};

/// What `auto` is to choose for.
struct ObjectiveSpec {
    std::optional<double> rays;  ///< expected; nothing: those of the workload
    double memory = 0;           ///< bytes at most; 0: no limit
    Priority priority = Priority::total;
    double max_error = 0;  ///< pixels; above 0, rays may end early
    bool clock = true;     ///< see AutoOptions
};

/// Variants that share a scene, the rays and the settings of a run.
struct Experiment {
    SceneSpec scene;
    std::vector<Variant> variants;
    std::vector<WorkloadSpec> workloads;
    RunSpec run;
    ObjectiveSpec objective;
    std::string scene_canonical, run_canonical;
    std::vector<std::string> workload_canonical;
    ConfigValue resolved;  ///< with every default filled in
};

/// Valid first keys of a config.
const std::vector<std::string>& config_sections();

/// Checks a config without [sweep].
/// @param folder  relative paths of the config are resolved against it
/// @throws InputError  one line with file, line, column and the nearest valid name
Experiment parse_experiment(ConfigValue config, const std::string& folder);

/// A config file with its sweeps expanded and `settings` ("path=value") applied before.
struct ExperimentFile {
    std::string stem;
    ConfigValue resolved;                 ///< to write down: defaults filled in, [sweep] kept
    std::vector<Experiment> experiments;  ///< one per distinct scene, workloads and run
};
ExperimentFile load_experiments(const std::string& path, const std::vector<std::string>& settings);
/// The same from a config in memory.
ExperimentFile make_experiments(ConfigValue config, const std::string& stem,
                                const std::string& folder,
                                const std::vector<std::string>& settings);

/// Types of workload with one sentence each, for `crofton list`.
const std::vector<std::pair<std::string, std::string>>& workload_types();

}  // namespace crofton
