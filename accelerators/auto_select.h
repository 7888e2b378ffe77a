#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "framework/calibration.h"
#include "framework/registry.h"

namespace crofton {

/// A structure with its parameters, as a choice is made among.
struct StructureChoice {
    std::string name;  ///< e.g. "wide_bvh/lbvh": what a calibration knows it by
    std::string type;  ///< registry name
    ParameterValues parameters;
};

/// Those that the registry accepts, each a compromise between build and rays that none of the
/// others makes; always in the same order.
const std::vector<StructureChoice>& structure_choices();

/// What is wanted of a choice.
enum class Priority {
    total,  ///< least seconds for build and rays together
    trace,  ///< least ns per ray, however long the build takes
    build,  ///< least build, of those whose rays take at most `slowest` times as long as the best
};
inline constexpr double slowest = 4;

/// How rays follow each other: from one point and near each other, as from a camera, or not.
enum class Coherence { unknown, together, apart };

struct Objective {
    double rays = 1e6;  ///< expected
    double memory = 0;  ///< bytes at most; 0: no limit
    Priority priority = Priority::total;
    Coherence coherence = Coherence::unknown;
};

/// What a structure is expected to cost over some shapes.
struct CostEstimate {
    double build_s = 0;  ///< parts that rays make lazily included
    double bytes = 0;
    double ns_per_ray = 0;
    double total_s = 0;     ///< expected: build_s + rays·ns_per_ray·exp(spread²/2)
    double ray_spread = 0;  ///< standard deviation of ln(ns_per_ray); 0: seen, not estimated
    bool fits = true;       ///< into the memory
};

/// From counts alone, before anything is built.
/// @param shapes  kind as in StructureCosts
/// @return  total_s = infinity if the calibration has nothing about the structure
CostEstimate estimate(const StructureChoice& choice, double count, const std::string& shapes,
                      const Objective& objective, const Calibration& calibration);

/// The same for costs that were found before. @param costs  null: nothing is known
CostEstimate estimate(const StructureCosts* costs, bool lazy, double count,
                      const Objective& objective);
const StructureCosts* costs_of(const StructureChoice& choice, const std::string& shapes,
                               const Calibration& calibration);
bool is_lazy(const StructureChoice& choice);
/// Whether the order of the shapes in their file makes it good or bad: see OrderCost.
bool uses_order(const StructureChoice& choice);
/// Built without a look at surface areas: from the shapes' order, along a curve, or at medians.
bool is_blind(const StructureChoice& choice);

/// Sets total_s and fits from the rest.
void set_total(CostEstimate& estimate, const Objective& objective);

/// What the objective is least for; smaller is better, infinity: not to be chosen.
/// @param best_ns  least ns per ray of all that fit
double score(const CostEstimate& estimate, const Objective& objective, double best_ns);

/// Index of the least score; of equal ones the first.
/// @throws InputError  if none fits into the memory: what the smallest would take
size_t best_of(const std::vector<CostEstimate>& estimates, const Objective& objective);

/// "triangles", "quadrics", "polygons" or "objects".
std::string kind_of(const PrimitiveSet& set);
uint64_t size_of(const PrimitiveSet& set);

/// "binned_sah" for its default, "lazy" and so on: parameters that differ from a structure's
/// defaults, for people.
std::string parameters_text(const StructureChoice& choice);

}  // namespace crofton
