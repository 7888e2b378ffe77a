#pragma once

#include <algorithm>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "framework/primitive.h"
#include "scenegraph/plan_estimate.h"

namespace crofton {

/// Rays like those that will be traced, in world space, in the order in which they will be: rays
/// that follow each other may be alike, and then take less time.
struct RaySample {
    std::span<const Ray> rays;
    bool any = false;
    Mode mode = Mode::robust;
};

/// From a few neighbours among them. @param rays  in the order in which they are traced
Coherence coherence_of(std::span<const Ray> rays);

/// Before the scene's own structure is built: a thinned scene's is, and traces the sample; what was
/// seen is carried over to the scene's counts by the calibration's growth. See thinned.
/// @param shapes     about so many are left by thinning
/// @param looked_at  see thinned
class Pilot {
  public:
    Pilot(const Scene& scene, const SceneCounts& counts, double shapes,
          size_t looked_at = std::numeric_limits<size_t>::max());
    /// @param plan    that the choice stands for
    /// @param builds  so many are timed; 1 or more
    /// @param factor  if not null: becomes what the thinned structure's rays took over what their
    ///                counts say (see counted_ns); what neighbours among rays save, and what tests
    ///                of this scene's shapes cost, is in it
    CostEstimate estimate(const PlanChoice& choice, const AssemblyPlan& plan,
                          const RaySample& sample, const AutoOptions& options,
                          const Calibration& calibration, int builds = 1,
                          double* factor = nullptr) const;

    /// What rays are expected to take in one structure of the scene over what they take in another:
    /// as over the thinned scene, timed in turns, or counted where options.clock is false.
    double ratio(const PlanChoice& choice, const PlanChoice& other, const RaySample& sample,
                 const AutoOptions& options, const Calibration& calibration);

  private:
    double growth() const;
    const Assembly& built(const PlanChoice& choice);

    std::map<std::string, Assembly> built_;  ///< by the choices' names
    Scene thin_;
    SceneCounts counts_, thin_counts_;
};

/// About `count` rays in runs that follow each other as they do in `rays`, the runs spread evenly,
/// and in such an order that the quarters of the result are so, too.
std::vector<Ray> some_of(std::span<const Ray> rays, size_t count);

/// Nanoseconds of a ray by what is counted on the sample and by the calibration's constants.
double counted_ns(const Primitive& root, const StructureChoice& structure,
                  const SceneCounts& counts, const RaySample& sample,
                  const Calibration& calibration);

/// Nanoseconds per ray, timed. No ray is traced twice: a processor that has seen a ray's branches
/// foretells them the second time, and what is to be known is the time of rays that it has not
/// seen. The first quarter of the sample warms up; of the others the mean counts, and of what took
/// far longer than the others not all.
/// @param sample  from some_of
double observed_ns(const Primitive& root, const RaySample& sample);

/// What two structures took for some rays.
struct RunSeconds {
    double own, others;
    /// What it counts for. The machine may have done something else meanwhile, hardly twice.
    double weight() const { return std::min(own, others); }
};
/// Sum of `own` over that of `others`, of the middle half of the runs by ratio, where each counts
/// for as long as it took: rays that hit nothing tell little, and may be most.
/// @param seconds  of one run or more
double middle_ratio(std::vector<RunSeconds> seconds);

/// What rays take in one structure over what they take in another, timed in turns, so that what
/// else the machine does falls on both. Of short runs of rays, see middle_ratio.
/// @param sample  from some_of; not empty
double time_ratio(const Primitive& root, const Primitive& other, const RaySample& sample);

}  // namespace crofton
