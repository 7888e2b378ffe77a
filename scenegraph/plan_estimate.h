#pragma once

#include <string>
#include <vector>

#include "accelerators/auto_select.h"
#include "scenegraph/assemble.h"
#include "scenegraph/scene_counts.h"

namespace crofton {

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
PlanChoice plan_choice(const StructureChoice& structure, PlanChoice::Placing placing);

/// Rays meet several objects where boxes overlap; on the other hand a build that is blind (see
/// is_blind) keeps small objects apart then. What nesting costs a ray over one structure for all,
/// in scenes with several placements: means of twelve models, of which FZK-Haus, retroufo, subpass,
/// 2CylinderEngine and grey-white-room are in auto_selection.toml, the others not.
double nested_factor(const StructureChoice& structure, Coherence coherence);
/// The same, once a thinned scene has shown this ratio for the quickest structure: its objects have
/// few shapes, of which a ray's way to them is most.
double nested_factor(const StructureChoice& structure, double thinned_ratio);
/// Standard deviations of ln of both.
inline constexpr double placing_spread = 0.16, placing_spread_thinned = 0.12;
/// Standard deviation of ln of what an order's rays take, by a sample of the order.
inline constexpr double order_spread = 0.5;

AssemblyPlan plan_of(const PlanChoice& choice);

/// All ways to assemble a scene that are compared: every structure over everything at once, and,
/// where several meshes are placed, structures of each mesh's own under a wide_bvh, opened or not.
std::vector<PlanChoice> plan_choices(const SceneCounts& counts, const AutoOptions& options);

/// Those of them that are built fastest: for few rays one of these is right, and there is no time
/// to look at more.
/// Their list is made once. @param several  whether several meshes are placed
const std::vector<PlanChoice>& quick_choices(bool several);

/// A plan as a candidate: what estimates of it are made from.
PlanChoice plan_choice_of(const AssemblyPlan& plan);

/// The structure that is built fastest of those that rays are fast in, whatever the order of the
/// shapes.
const StructureChoice& quickest();
/// What is built if nothing else is said.
const StructureChoice& default_structure();

/// Whether a plan leaves everything open: `auto` without parameters on top and for objects, and
/// nothing else. Then choose_assembly decides for the scene as a whole, with rays at hand; where
/// only a part is `auto`, that accelerator chooses for its own shapes.
bool chooses_all(const AssemblyPlan& plan);

/// Before anything is built, from counts alone.
CostEstimate estimate(const PlanChoice& choice, const SceneCounts& counts,
                      const AutoOptions& options, const Calibration& calibration);

}  // namespace crofton
