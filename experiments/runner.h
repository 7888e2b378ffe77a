#pragma once

#include <string>
#include <vector>

#include "experiments/experiment.h"
#include "experiments/progress.h"
#include "experiments/results.h"
#include "experiments/row.h"

namespace crofton {

struct RunOutput {
    std::vector<Row> rows;
    std::vector<Row> budget_rows;           ///< one for each variant, workload and budget
    std::vector<std::string> explanations;  ///< of what `auto` chose
    std::vector<std::string> pictures;      ///< files in the results' folder
    std::vector<std::string> mismatches;    ///< one line a variant whose hits differ
    std::vector<std::string> notes;         ///< what a reader of the table must know
};

/// Runs one experiment: loads the scene, builds every variant once, and for every workload checks
/// that all variants' hits agree ray by ray, times passes in turns (A B C A B C …), and counts.
/// Rows are written as they are made, and added to `output`.
/// @param hits_path  if not empty, hits are dumped; see hits_paths
void run_experiment(const Experiment& experiment, const std::string& hits_path, Results& results,
                    Progress& progress, RunOutput& output);

/// Steps that run_experiment tells the progress.
size_t step_count(const Experiment& experiment);

/// Where the hits of a row go: the template with {variant} and {workload} replaced; without these,
/// the first row's go to the path itself, and if there are several rows, every row's to the path
/// with
/// "-VARIANT-WORKLOAD" before its ending.
std::vector<std::string> hits_paths(const std::string& path, const std::string& variant,
                                    const std::string& workload, bool first, bool several);

}  // namespace crofton
