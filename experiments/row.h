#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "experiments/statistics.h"
#include "experiments/verify.h"
#include "framework/config.h"
#include "framework/counters.h"
#include "framework/primitive.h"

namespace crofton {

/// How far the hits of a variant that may end rays early (see Variant::exact) are from exact ones.
struct DepthError {
    double rms = 0;  ///< of t, relative to the exact t, over rays that hit in both
    double max = 0;
    uint64_t hit_or_miss = 0;  ///< rays that hit in one and miss in the other
};

/// Build and rays together, for a number of rays.
struct BudgetTotal {
    double rays = 0;
    double choose_s = 0;  ///< that `auto` took for all but its structure's build
    double total_s = 0;   ///< choosing, build, and rays
};

/// What was thought of the costs.
struct PredictedCosts {
    double choose_s = 0;                            ///< that it took
    double build_s = 0, bytes = 0, ns_per_ray = 0;  ///< before the build
    double expected_ns = 0;  ///< per ray, after it: from counters, and from a pilot if there was one
};

/// The result of one variant on one workload: a line of rows.jsonl.
struct Row {
    std::string key;  ///< hash of all that the result depends on but the machine
    std::string scene, variant, accelerator, mode, workload, query;
    uint64_t rays = 0;          ///< of the workload
    uint64_t rays_timed = 0;    ///< per pass; fewer than all for slow variants
    uint64_t rays_checked = 0;  ///< traced for `hits`, the check and the counters
    uint64_t hits = 0;          ///< of the rays checked
    std::string hits_checksum;
    bool peer = false;        ///< of another library
    bool single = false;      ///< timed by one call a ray
    uint64_t mismatches = 0;  ///< rays whose hit differs from the reference variant's
    std::string checked_against;
    std::optional<DepthError> depth_error;  ///< instead of mismatches
    uint64_t triangles = 0, triangles_instanced = 0, shapes = 0, instances = 0;
    double build_s = 0;
    /// Median seconds from nothing built to every ray of the workload traced once; 0: not measured.
    double first_image_s = 0;
    uint64_t first_image_bytes = 0;  ///< of what was built by then
    StructureStatistics structure;   ///< nested structures included
    Counters counters;               ///< sums over rays_checked
    MedianInterval ns_per_ray;
    std::vector<double> ns_per_ray_raw;  ///< one a pass
    VerifyTally oracle;                  ///< against the oracle; no rays: not compared
    std::optional<BudgetTotal> budget;
    bool chosen = false;  ///< by `auto`
    std::optional<PredictedCosts> predicted;
    double expected_ns = 0;  ///< Primitive::expected_cost
    int64_t repeats = 0, threads = 1;
    int core = -1;  ///< that timed passes were pinned to
    uint64_t seed = 0;
    std::string isa, host;
    std::vector<std::pair<std::string, ConfigValue>> sweep;
};

/// One line of JSON without the line's end. Numbers that are not finite become null.
std::string to_json_line(const Row& row);

/// Nesting as text from the structure itself, e.g. "bvh(uniform_grid)"; instances are passed
/// through, and equal children are named once.
std::string describe(const Primitive& root);

}  // namespace crofton
