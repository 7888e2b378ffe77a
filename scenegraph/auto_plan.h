#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "accelerators/auto_select.h"
#include "scenegraph/assemble.h"

namespace crofton {

/// Rays like those that will be traced, in world space.
struct RaySample {
    std::span<const Ray> rays;
    bool any = false;
    Mode mode = Mode::robust;
};

/// How a scene's structures are to be chosen.
struct AutoOptions {
    Objective objective;
    /// Above 0, structures that end rays early may be chosen: within so many pixels.
    double max_error = 0;
    double pixel_angle = 0;  ///< radians, for max_error
    /// Times of sampled rays and of builds decide; otherwise counts times the calibration's
    /// constants, so that the same calibration, scene and sample always give the same choice.
    bool clock = true;
    /// Choosing may take at most this share of the total that is expected.
    double share = 0.05;
};

/// A whole scene's structures, as a candidate.
struct PlanChoice {
    std::string name;  ///< e.g. "flat wide_bvh/lbvh"
    StructureChoice structure;
    enum class Placing { flat, nested, opened } placing = Placing::flat;
};
AssemblyPlan plan_of(const PlanChoice& choice);

/// Counts of shapes that estimates start from.
struct SceneCounts {
    struct Kind {
        std::string name;  ///< see kind_of
        double unique = 0, placed = 0;
    };
    std::vector<Kind> kinds;               ///< those that there are, most placed first
    const std::string& main_kind() const;  ///< the first, or "triangles"
    /// Meshes that are placed, put together where they are of similar size: shapes in each, and how
    /// many there are of these.
    std::vector<std::pair<double, double>> meshes;
    double placements = 0;
    double order = 1;   ///< order_visits of the scene
    double weight = 1;  ///< test_weight of the main kind
};
SceneCounts count_shapes(const Scene& scene);

/// How good the order of the shapes in the largest mesh's file is as a hierarchy: Crofton's
/// expected number of boxes that a line meets, of boxes around runs of 8, 64, 512, … shapes, for
/// each level; about 1 where runs are patches that lie side by side, more where they are scattered.
/// From a sample: O(log N).
double order_visits(const Scene& scene);

/// Nominal cost of a test of the scene's main kind of shapes, the mean over their areas, relative
/// to that of the shapes that calibrations are measured with. From a sample.
double test_weight(const Scene& scene, const std::string& kind);

/// All ways to assemble a scene that are compared: every structure over everything at once, and,
/// where several meshes are placed, structures of each mesh's own under a wide_bvh, opened or not.
std::vector<PlanChoice> plan_choices(const SceneCounts& counts, const AutoOptions& options);

/// A plan as a candidate: what estimates of it are made from.
PlanChoice plan_choice_of(const AssemblyPlan& plan);

/// Whether a plan leaves everything open: `auto` without parameters on top and for objects, and
/// nothing else. Then choose_assembly decides for the scene as a whole, with rays at hand; where
/// only a part is `auto`, that accelerator chooses for its own shapes.
bool chooses_all(const AssemblyPlan& plan);

/// Before anything is built, from counts alone.
CostEstimate estimate(const PlanChoice& choice, const SceneCounts& counts,
                      const AutoOptions& options, const Calibration& calibration);

/// Before the scene's own structure is built: a thinned scene's is, and traces the sample; what was
/// seen is carried over to the scene's counts by the calibration's growth. See thinned.
/// @param shapes  about so many are left by thinning
class Pilot {
  public:
    Pilot(const Scene& scene, const SceneCounts& counts, double shapes);
    /// @param plan  that the choice stands for
    CostEstimate estimate(const PlanChoice& choice, const AssemblyPlan& plan,
                          const RaySample& sample, const AutoOptions& options,
                          const Calibration& calibration) const;

  private:
    Scene thin_;
    SceneCounts counts_, thin_counts_;
};

/// Nanoseconds per ray of a built structure: timed, or else from counters on the sample.
double observed_ns(const Primitive& root, const StructureChoice& structure,
                   const SceneCounts& counts, const RaySample& sample, bool clock,
                   const Calibration& calibration);

/// What is known about one candidate.
struct Candidate {
    PlanChoice choice;
    CostEstimate predicted;             ///< before its build
    std::string basis = "counts";       ///< of the prediction: "counts" or "pilot"
    std::optional<CostEstimate> tried;  ///< from its own structure, once built
    const CostEstimate& known() const { return tried ? *tried : predicted; }
};

struct Selection {
    Assembly assembly;
    std::vector<Candidate> candidates;  ///< best first
    size_t chosen = 0;
    double choose_s = 0;     ///< seconds for all but the build of what was chosen
    double expected_ns = 0;  ///< per ray, from the built structure's counters; 0: no sample
    std::string reason;
    const Candidate& choice() const { return candidates[chosen]; }
};

/// Chooses and builds. Estimates from counts come first; if the time allowed for choosing has room,
/// a pilot scales them to this scene; then the best is built, tried on the sample, and replaced as
/// long as another could gain more than its own build and trial cost.
/// @param sample  may be empty: counts alone decide
/// @throws InputError  nothing fits into the memory
Selection choose_assembly(const Scene& scene, const AutoOptions& options, const RaySample& sample,
                          const Calibration& calibration);

/// A table of the candidates, and why one was chosen. @param limit  lines at most
std::string explanation(const Selection& selection, const Objective& objective,
                        size_t limit = 1000);

}  // namespace crofton
