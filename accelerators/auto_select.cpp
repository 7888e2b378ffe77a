#include "accelerators/auto_select.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "framework/error.h"
#include "framework/object_set.h"
#include "framework/parameters.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

std::vector<StructureChoice> all_choices() {
    const auto text = [](const char* t) { return ParameterValue(std::string(t)); };
    const auto number = [](int64_t i) { return ParameterValue(i); };
    const ParameterValue yes = true;
    return {
        {"wide_bvh", "wide_bvh", {}},
        {"wide_bvh/lbvh", "wide_bvh", {{"builder", text("lbvh")}}},
        {"wide_bvh/reinsertion", "wide_bvh", {{"reinsertion", number(2)}}},
        {"wide_bvh/sbvh", "wide_bvh", {{"builder", text("sbvh")}, {"reinsertion", number(2)}}},
        {"wide_bvh/ploc", "wide_bvh", {{"builder", text("ploc")}}},
        {"wide_bvh/quantised", "wide_bvh", {{"nodes", text("quantised")}}},
        {"wide_bvh/lazy", "wide_bvh", {{"builder", text("lbvh")}, {"lazy", yes}}},
        {"bvh", "bvh", {}},
        {"bvh/median", "bvh", {{"builder", text("median")}}},
        {"bvh/lbvh", "bvh", {{"builder", text("lbvh")}}},
        {"bvh/sbvh", "bvh", {{"builder", text("sbvh")}, {"reinsertion", number(2)}}},
        {"bvh/lazy", "bvh", {{"builder", text("median")}, {"lazy", yes}}},
        {"kdtree", "kdtree", {}},
        {"nested_grid", "nested_grid", {}},
        {"sparse_grid", "sparse_grid", {}},
        {"uniform_grid", "uniform_grid", {}},
        {"model_hierarchy", "model_hierarchy", {}},
        {"sphere_hierarchy", "sphere_hierarchy", {}},
        {"brute_force", "brute_force", {}},
    };
}

bool accepted(const StructureChoice& choice) {
    const auto found = accelerators().find(choice.type);
    if (found == accelerators().end()) return false;
    try {
        checked(found->second.parameters, choice.parameters);
    } catch (const InputError&) {
        return false;  // this program's structure has no such parameter
    }
    return true;
}

/// Shapes in a part that a lazy structure builds whole, and parts that a ray enters before it ends,
/// of which others have not been built for.
constexpr double lazy_part = 1024, parts_per_ray = 0.1;

/// Share of a lazy structure's parts that so many rays need.
double needed_share(double count, double rays) {
    const double parts = std::max(1.0, count / lazy_part);
    return 1 - std::exp(-rays * parts_per_ray / parts);
}

double coherence_factor(const GrowthPoint& costs, Coherence coherence) {
    if (coherence == Coherence::unknown) return 1;
    return coherence == Coherence::together ? costs.together : costs.apart;
}

struct AutoParameters {
    double rays = 1e6;
    double memory = 0;
    Priority priority = Priority::total;

    template <class V>
    void fields(V& v) {
        v.real("rays", rays, 0, 1e18, "expected to meet the object");
        v.real("memory", memory, 0, 1e18, "bytes at most; 0: no limit");
        v.choice("priority", priority, {"total", "trace", "build"},
                 "least time for build and rays together, least time per ray, or least build");
    }
};

/// The least costly structure over a set, by the current calibration; nothing is tried, but what
/// takes more memory than was expected, and than there is, is built again as the next best.
std::unique_ptr<Primitive> build_auto(const PrimitiveSet& set, const ParameterValues& values) {
    const AutoParameters p = read_parameters<AutoParameters>(values);
    const Objective objective{p.rays, p.memory, p.priority, {}};
    std::vector<StructureChoice> choices = structure_choices();
    // What rays build later cannot be looked at before: it might not fit.
    if (p.memory > 0) std::erase_if(choices, is_lazy);
    std::vector<CostEstimate> estimates;
    for (const StructureChoice& choice : choices)
        estimates.push_back(
            estimate(choice, double(size_of(set)), kind_of(set), objective, calibration()));
    while (true) {
        const size_t best = best_of(estimates, objective);  // refuses when none is left
        auto built = accelerator(choices[best].type).build(set, choices[best].parameters);
        if (p.memory <= 0) return built;
        estimates[best].bytes = double(built->statistics().bytes);
        if (estimates[best].bytes <= p.memory) return built;
        set_total(estimates[best], objective);
    }
}

bool registered = register_accelerator(
    {"auto", "the structure that is expected to cost least, see auto_select.md",
     "after Hapala, Karlík, Havran 2011: When it makes sense to use uniform grids for ray tracing",
     list_parameters<AutoParameters>(), build_auto, nullptr});

}  // namespace

const std::vector<StructureChoice>& structure_choices() {
    static const std::vector<StructureChoice> choices = [] {
        std::vector<StructureChoice> all = all_choices();
        std::erase_if(all, [](const StructureChoice& c) { return !accepted(c); });
        return all;
    }();
    return choices;
}

std::string kind_of(const PrimitiveSet& set) {
    static constexpr const char* names[] = {"triangles", "quadrics", "polygons", "objects"};
    return names[set.index()];
}

uint64_t size_of(const PrimitiveSet& set) {
    return std::visit([](const auto& s) { return uint64_t(s->size()); }, set);
}

bool is_lazy(const StructureChoice& choice) { return choice.parameters.contains("lazy"); }

bool uses_order(const StructureChoice& choice) { return choice.type == "model_hierarchy"; }

bool is_blind(const StructureChoice& choice) {
    const auto builder = choice.parameters.find("builder");
    return uses_order(choice) || (builder != choice.parameters.end() &&
                                  (builder->second == ParameterValue(std::string("lbvh")) ||
                                   builder->second == ParameterValue(std::string("median"))));
}

const StructureCosts* costs_of(const StructureChoice& choice, const std::string& shapes,
                               const Calibration& calibration) {
    // Boxes of objects are like those of triangles; what is inside costs the same under each.
    const StructureCosts* costs = calibration.find(choice.name, shapes);
    return costs ? costs : calibration.find(choice.name, "triangles");
}

CostEstimate estimate(const StructureChoice& choice, double count, const std::string& shapes,
                      const Objective& objective, const Calibration& calibration) {
    return estimate(costs_of(choice, shapes, calibration), is_lazy(choice), count, objective);
}

CostEstimate estimate(const StructureCosts* costs, bool lazy, double count,
                      const Objective& objective) {
    CostEstimate e;
    e.total_s = infinity;
    if (!costs) return e;
    const GrowthPoint p = costs->at(count);
    e.build_s = p.build_ns * count * 1e-9;
    if (lazy) {
        // What the growth holds is a build of all parts; the bounds alone take a tenth of it.
        constexpr double bounds_share = 0.1;
        e.build_s *= bounds_share + (1 - bounds_share) * needed_share(count, objective.rays);
    }
    e.bytes = p.bytes * count;
    e.ns_per_ray = p.ray_ns * coherence_factor(p, objective.coherence);
    e.ray_spread = costs->ray_spread;
    set_total(e, objective);
    return e;
}

void set_total(CostEstimate& e, const Objective& objective) {
    // The mean of a cost whose logarithm is normal. Spreads come from few scenes: no more than
    // this.
    const double spread = std::min(e.ray_spread, 0.6);
    const double mean = e.ns_per_ray * std::exp(0.5 * spread * spread);
    e.total_s = e.build_s + objective.rays * mean * 1e-9;
    e.fits = objective.memory <= 0 || e.bytes <= objective.memory;
}

double score(const CostEstimate& e, const Objective& objective, double best_ns) {
    if (!e.fits || !std::isfinite(e.total_s)) return infinity;
    switch (objective.priority) {
        case Priority::trace:
            return e.ns_per_ray;
        case Priority::build:
            return e.ns_per_ray <= slowest * best_ns ? e.build_s : infinity;
        case Priority::total:
            break;
    }
    return e.total_s;
}

size_t best_of(const std::vector<CostEstimate>& estimates, const Objective& objective) {
    double best_ns = infinity, least_bytes = infinity;
    for (const CostEstimate& e : estimates) {
        if (!std::isfinite(e.total_s)) continue;
        if (e.fits) best_ns = std::min(best_ns, e.ns_per_ray);
        least_bytes = std::min(least_bytes, e.bytes);
    }
    size_t best = estimates.size();
    double least = infinity;
    for (size_t i = 0; i < estimates.size(); ++i)
        if (const double s = score(estimates[i], objective, best_ns); s < least)
            least = s, best = i;
    if (best == estimates.size())
        throw InputError(fmt::format(
            "auto: no structure fits into {:.0f} bytes of memory; the smallest needs about {:.0f}",
            objective.memory, least_bytes));
    return best;
}

std::string parameters_text(const StructureChoice& choice) {
    std::string text;
    for (const auto& [name, value] : choice.parameters)
        text += (text.empty() ? "" : ", ") + name + " = " + to_string(value);
    return text;
}

}  // namespace crofton
