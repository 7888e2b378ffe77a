#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "accelerators/auto_select.h"
#include "framework/config.h"
#include "framework/mode.h"
#include "scenegraph/assemble.h"

namespace crofton {

/// One way to assemble the scene.
struct Variant {
    std::string name;
    AssemblyPlan plan;
    std::optional<int64_t> max_rays;  ///< timed per pass
    std::optional<Mode> mode;         ///< nothing: what [run] says
    bool single = false;              ///< timed by one call a ray, instead of spans
    bool peer = false;      ///< holds another library's structure, which promises nothing of ours
    bool available = true;  ///< false: a peer that the program was built without
    std::string canonical;  ///< equal texts: equal structures
    bool chooses = false;   ///< see chooses_all
    bool exact = true;      ///< false: rays may end at something coarser than the shapes, see `lod`
    std::vector<std::pair<std::string, ConfigValue>> sweep;  ///< the values that led here
};

/// Reads [accelerator], [assign] and [[variant]] of the config's root. Without variants there is
/// one, "default", as [assign] says. A variant for which neither says anything is `auto`; where
/// they say something, what is missing is a bvh.
/// @throws InputError  unknown accelerator or parameter, a cycle of `inside`, two variants of one
/// name
std::vector<Variant> parse_variants(ConfigTable& root);

/// A plan that gives the whole scene one registered accelerator with its defaults.
AssemblyPlan uniform_plan(const std::string& accelerator_name);

/// The plan with the pixel angle of a camera wherever an accelerator has that parameter and no
/// value.
/// @param angle  radians
AssemblyPlan with_pixel_angle(const AssemblyPlan& plan, double angle);

/// Equal texts: equal structures.
std::string canonical(const AcceleratorChoice& choice);
std::string canonical(const AssemblyPlan& plan);

/// The plan with the objective's rays, memory and priority wherever an `auto` says none of its own.
AssemblyPlan with_objective(const AssemblyPlan& plan, const Objective& objective);

}  // namespace crofton
