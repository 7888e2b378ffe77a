#include "scenegraph/plan_estimate.h"

#include <algorithm>
#include <cmath>

namespace crofton {
namespace {

std::shared_ptr<AcceleratorChoice> choice_of(const StructureChoice& structure) {
    auto choice = std::make_shared<AcceleratorChoice>();
    choice->label = structure.name;
    choice->type = structure.type;
    choice->parameters = structure.parameters;
    return choice;
}

constexpr double object_bytes = 400;

/// Of one structure over all shapes, whose kinds are in sets of their own; rays cost more where
/// shapes are dearer to test.
CostEstimate flat_estimate(const StructureChoice& structure, const SceneCounts& counts,
                           const Objective& objective, const Calibration& calibration) {
    CostEstimate sum;
    for (const SceneCounts::Kind& kind : counts.kinds) {
        const CostEstimate e = estimate(structure, kind.placed, kind.name, objective, calibration);
        if (!std::isfinite(e.total_s)) return e;
        if (&kind == &counts.kinds.front()) sum = e, sum.build_s = sum.bytes = 0;
        sum.build_s += e.build_s;
        sum.bytes += e.bytes;
    }
    if (const StructureCosts* costs = costs_of(structure, counts.main_kind(), calibration))
        sum.ns_per_ray *= 1 + (counts.weight - 1) * costs->test_share;
    return sum;
}

/// Builds and bytes of a structure over each mesh and one over `entries` objects.
CostEstimate nested_estimate(const StructureChoice& structure, const SceneCounts& counts,
                             double entries, const Objective& objective,
                             const Calibration& calibration) {
    const StructureCosts* costs = costs_of(structure, counts.main_kind(), calibration);
    CostEstimate sum = estimate(costs, is_lazy(structure), entries, objective);
    for (const auto& [shapes, meshes] : counts.meshes) {
        const CostEstimate e = estimate(costs, is_lazy(structure), shapes, objective);
        sum.build_s += e.build_s * meshes;
        sum.bytes += e.bytes * meshes;
    }
    sum.bytes += entries * object_bytes;
    return sum;
}

/// The choice that a plan's accelerator is, by type and parameters; else a structure of that type.
StructureChoice structure_of(const AcceleratorChoice& accelerator) {
    for (const StructureChoice& s : structure_choices())
        if (s.type == accelerator.type && s.parameters == accelerator.parameters) return s;
    return {accelerator.type, accelerator.type, accelerator.parameters};
}

/// @return  the first if there is none of this name
const StructureChoice& named(const std::string& name) {
    for (const StructureChoice& s : structure_choices())
        if (s.name == name) return s;
    return structure_choices().front();
}

/// Time of a ray in a tree over the shapes' own order over that in one that is built. No order is
/// better than a tree: rays end where they hit, and so leave most of what is behind; the worse an
/// order is, the less they do. Fitted to the models that are not judged (see auto_select.md).
/// @param over  what a line that ends nowhere costs in it, over what a ray does in what is built
double order_factor(double over) {
    constexpr double least = 1.6, as_much_again = 10;
    const double bad = over / as_much_again;
    return least + bad * bad;
}

/// Counts of shapes do not say how good their order is; a sample does: of the largest mesh, which
/// stands for all.
void use_order(CostEstimate& e, const SceneCounts& counts, const StructureCosts& costs,
               const Objective& objective, const Calibration& calibration) {
    Objective apart = objective;
    apart.coherence = Coherence::apart;
    const auto built_ns = [&](const Objective& o) {
        return flat_estimate(quickest(), counts, o, calibration).ns_per_ray;
    };
    const double line_ns = costs.counted_ns(counts.order.nodes, counts.weight * counts.order.tests,
                                            0, calibration.cache_bytes);
    const double over = line_ns / built_ns(apart), ns = built_ns(objective);
    if (!std::isfinite(over) || !std::isfinite(ns)) return;
    e.ns_per_ray = ns * order_factor(over);
    e.ray_spread = order_spread;
}

}  // namespace

PlanChoice plan_choice(const StructureChoice& structure, PlanChoice::Placing placing) {
    static constexpr const char* names[] = {"flat ", "nested ", "opened "};
    return {names[int(placing)] + structure.name, structure, placing};
}

double nested_factor(const StructureChoice& structure, Coherence coherence) {
    const bool together = coherence == Coherence::together;
    return is_blind(structure) ? (together ? 1.0 : 1.14) : (together ? 1.07 : 1.24);
}

double nested_factor(const StructureChoice& structure, double thinned_ratio) {
    return (is_blind(structure) ? 0.94 : 1.02) * std::pow(thinned_ratio, 0.62);
}

AssemblyPlan plan_of(const PlanChoice& choice) {
    AssemblyPlan plan;
    plan.top = plan.objects = choice_of(choice.structure);
    plan.flatten = choice.placing == PlanChoice::Placing::flat;
    if (choice.placing == PlanChoice::Placing::opened) plan.opening = 2;
    return plan;
}

std::vector<PlanChoice> plan_choices(const SceneCounts& counts, const AutoOptions& options) {
    using Placing = PlanChoice::Placing;
    constexpr double most_for_brute_force = 256, least_for_lazy = 16384;
    static const std::vector<std::string> nested_names = {
        "wide_bvh", "wide_bvh/lbvh", "wide_bvh/reinsertion", "wide_bvh/sbvh", "wide_bvh/lazy",
        "bvh",      "bvh/lbvh",      "model_hierarchy"};
    static const std::vector<std::string> opened_names = {"wide_bvh", "wide_bvh/reinsertion",
                                                          "wide_bvh/sbvh"};
    std::vector<PlanChoice> out;
    const double placed = counts.placed();
    // What rays build later cannot be looked at before: it might not fit.
    const bool lazy_allowed = placed >= least_for_lazy && options.objective.memory <= 0;
    for (const StructureChoice& s : structure_choices()) {
        if (s.type == "brute_force" && placed > most_for_brute_force) continue;
        if (is_lazy(s) && !lazy_allowed) continue;
        // They save memory, not time.
        if (s.name == "wide_bvh/quantised" && options.objective.memory <= 0) continue;
        out.push_back(plan_choice(s, Placing::flat));
    }
    if (counts.placements > 1)
        for (const StructureChoice& s : structure_choices()) {
            if (is_lazy(s) && options.objective.memory > 0) continue;
            for (const Placing placing : {Placing::nested, Placing::opened}) {
                const auto& list = placing == Placing::nested ? nested_names : opened_names;
                if (std::find(list.begin(), list.end(), s.name) != list.end())
                    out.push_back(plan_choice(s, placing));
            }
        }
    if (options.max_error > 0) {
        StructureChoice lod{"sphere_hierarchy", "sphere_hierarchy", {}};
        lod.parameters["lod"] = options.max_error;
        if (options.pixel_angle > 0) lod.parameters["pixel_angle"] = options.pixel_angle;
        out.push_back(plan_choice(lod, Placing::flat));
        out.back().name += "/lod";
    }
    return out;
}

const std::vector<PlanChoice>& quick_choices(bool several) {
    using Placing = PlanChoice::Placing;
    static const auto made = [](bool nested) {
        std::vector<PlanChoice> out;
        for (const StructureChoice& s : structure_choices()) {
            if (s.name != "model_hierarchy" && s.name != "bvh/lbvh" && s.name != "wide_bvh/lbvh")
                continue;
            out.push_back(plan_choice(s, Placing::flat));
            if (nested) out.push_back(plan_choice(s, Placing::nested));
        }
        return out;
    };
    static const std::vector<PlanChoice> lists[2] = {made(false), made(true)};
    return lists[several];
}

CostEstimate estimate(const PlanChoice& choice, const SceneCounts& counts,
                      const AutoOptions& options, const Calibration& calibration) {
    CostEstimate e;
    if (counts.kinds.empty()) return e;
    const Objective& objective = options.objective;
    e = flat_estimate(choice.structure, counts, objective, calibration);
    if (!std::isfinite(e.total_s)) return e;
    if (uses_order(choice.structure) && counts.order.known)
        if (const auto* costs = costs_of(choice.structure, counts.main_kind(), calibration))
            use_order(e, counts, *costs, objective, calibration);
    if (choice.placing != PlanChoice::Placing::flat) {
        const bool opened = choice.placing == PlanChoice::Placing::opened;
        const CostEstimate nested = nested_estimate(
            choice.structure, counts, counts.placements * (opened ? 2 : 1), objective, calibration);
        e.build_s = nested.build_s;
        e.bytes = nested.bytes;
        e.ns_per_ray *= nested_factor(choice.structure, objective.coherence);
        e.ray_spread = std::hypot(e.ray_spread, placing_spread);
    }
    set_total(e, options.objective);
    return e;
}

PlanChoice plan_choice_of(const AssemblyPlan& plan) {
    const StructureChoice structure = structure_of(plan.flatten ? *plan.top : *plan.objects);
    using Placing = PlanChoice::Placing;
    return plan_choice(structure, plan.flatten       ? Placing::flat
                                  : plan.opening > 1 ? Placing::opened
                                                     : Placing::nested);
}

const StructureChoice& quickest() {
    static const StructureChoice& choice = named("wide_bvh/lbvh");
    return choice;
}

const StructureChoice& default_structure() {
    static const StructureChoice& choice = named("wide_bvh");
    return choice;
}

bool chooses_all(const AssemblyPlan& plan) {
    return plan.top->type == "auto" && plan.objects->type == "auto" && !plan.flatten &&
           plan.opening <= 1 && plan.bake && plan.rules.empty() && plan.top->parameters.empty() &&
           plan.objects->parameters.empty();
}

}  // namespace crofton
