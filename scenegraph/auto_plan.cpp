#include "scenegraph/auto_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>

#include "framework/cost.h"
#include "framework/error.h"
#include "scenegraph/thinned.h"

namespace crofton {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double infinity = std::numeric_limits<double>::infinity();

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

struct ShapeSize {
    double operator()(const TriangleMesh& m) const { return double(m.triangles.size()); }
    double operator()(const Quadrics& q) const { return double(q.shapes.size()); }
    double operator()(const Polygons& p) const { return double(p.size()); }
    double operator()(const Points& p) const { return double(p.positions.size()); }
};

/// Points are traced as quadrics.
const char* kind_of_shapes(const Geometry& geometry) {
    static constexpr const char* names[] = {"triangles", "quadrics", "polygons", "quadrics"};
    return names[geometry.shapes.index()];
}

/// Meshes within a factor of four of each other count as equal ones.
void add_mesh(SceneCounts& counts, double shapes) {
    for (auto& [size, meshes] : counts.meshes)
        if (shapes < 2 * size && size < 2 * shapes) {
            size += (shapes - size) / (meshes + 1);
            meshes += 1;
            return;
        }
    counts.meshes.emplace_back(shapes, 1.0);
}

/// How often every mesh is placed. Paths are counted, not walked: O(nodes) however often shared.
std::vector<double> placements_of_meshes(const Scene& scene) {
    std::vector<double> paths(scene.nodes.size(), 0), meshes(scene.meshes.size(), 0);
    std::vector<uint32_t> parents(scene.nodes.size(), 0), open;
    std::vector<bool> reached(scene.nodes.size(), false);
    // Nodes in topological order from the roots: each after all of its parents.
    for (const uint32_t r : scene.roots) {
        paths[r] += 1;
        if (!reached[r]) open.push_back(r), reached[r] = true;
    }
    std::vector<uint32_t> found = open;
    while (!found.empty()) {
        const uint32_t n = found.back();
        found.pop_back();
        for (const uint32_t c : scene.nodes[n].children) {
            ++parents[c];
            if (!reached[c]) found.push_back(c), reached[c] = true;
        }
    }
    std::erase_if(open, [&](uint32_t r) { return parents[r] > 0; });
    while (!open.empty()) {
        const uint32_t n = open.back();
        open.pop_back();
        const Node& node = scene.nodes[n];
        if (node.mesh)
            meshes[*node.mesh] +=
                paths[n] * double(std::max<size_t>(1, node.node_from_instance.size()));
        for (const uint32_t c : node.children) {
            paths[c] += paths[n];
            if (--parents[c] == 0) open.push_back(c);
        }
    }
    return meshes;
}

std::shared_ptr<AcceleratorChoice> choice_of(const StructureChoice& structure) {
    auto choice = std::make_shared<AcceleratorChoice>();
    choice->label = structure.name;
    choice->type = structure.type;
    choice->parameters = structure.parameters;
    return choice;
}

PlanChoice plan_choice(const StructureChoice& structure, PlanChoice::Placing placing) {
    static constexpr const char* names[] = {"flat ", "nested ", "opened "};
    return {names[int(placing)] + structure.name, structure, placing};
}

/// Rays meet several objects where boxes overlap, and a call and a transform each: what nesting
/// and opening cost a ray over one structure for all, in scenes with several placements.
constexpr double nested_factor = 1.25, opened_factor = 1.12, object_bytes = 400;

/// Of one structure over all shapes, whose kinds are in sets of their own.
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

/// The standard normal distribution's share below x.
double normal_share(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

/// Expected value of max(0, known - x) where ln x is normal about ln(mean) with this deviation.
double expected_gain(double known, double mean, double deviation) {
    if (deviation <= 0) return std::max(0.0, known - mean);
    const double d = std::log(known / mean) / deviation;
    return known * normal_share(d) -
           mean * std::exp(deviation * deviation / 2) * normal_share(d - deviation);
}

std::vector<Ray> some_of(std::span<const Ray> rays, size_t count) {
    std::vector<Ray> out;
    count = std::min(count, rays.size());
    for (size_t i = 0; i < count; ++i) out.push_back(rays[i * rays.size() / count]);
    return out;
}

double traced_seconds(const Primitive& root, std::span<const Ray> rays, const RaySample& like) {
    const auto start = Clock::now();
    if (like.any) {
        std::vector<uint8_t> results(rays.size());
        root.occluded(rays, results, like.mode);
    } else {
        std::vector<Hit> hits(rays.size());
        root.intersect(rays, hits, like.mode);
    }
    return seconds_since(start);
}

double counted_ns(const Primitive& root, const StructureChoice& structure,
                  const SceneCounts& counts, const RaySample& sample,
                  const Calibration& calibration) {
    Counters sum;
    for (const Ray& ray : sample.rays) {
        Counters c;
        sample.any ? void(root.occluded(ray, c, sample.mode))
                   : void(root.intersect(ray, c, sample.mode));
        sum += c;
    }
    const StructureCosts* costs = costs_of(structure, counts.main_kind(), calibration);
    if (!costs) return infinity;
    const double n = double(sample.rays.size());
    return costs->counted_ns(double(sum.N_TS) / n, counts.weight * double(sum.N_IT) / n,
                             double(total_statistics(root).bytes), calibration.cache_bytes);
}

/// Middle and area of every kind of shape; the area in any unit.
struct ShapeView {
    const Geometry& geometry;
    size_t size() const { return size_t(std::visit(ShapeSize{}, geometry.shapes)); }
    Vec3f middle(size_t i) const {
        if (const auto* m = std::get_if<TriangleMesh>(&geometry.shapes))
            return m->positions[m->triangles[i][0]];
        if (const auto* p = std::get_if<Polygons>(&geometry.shapes))
            return p->positions[p->first[i]];
        if (const auto* p = std::get_if<Points>(&geometry.shapes)) return p->positions[i];
        const Quadric& q = std::get<Quadrics>(geometry.shapes).shapes[i];
        if (const Sphere* s = std::get_if<Sphere>(&q)) return s->center;
        if (const Cone* c = std::get_if<Cone>(&q)) return c->base;
        return std::get<Disc>(q).center;
    }
    /// Area and nominal cost of a test over that of calibrations: quads, spheres and cones.
    std::pair<double, double> area_and_cost(size_t i) const {
        const CostConstants& c = cost_constants;
        if (const auto* p = std::get_if<Polygons>(&geometry.shapes)) {
            const uint32_t first = p->first[i], end = p->first[i + 1];
            Bounds3 box;
            for (uint32_t k = first; k < end; ++k) box.extend(p->positions[k]);
            const double quad = c.polygon + 4 * c.polygon_corner;
            return {half_area(box), (c.polygon + (end - first) * c.polygon_corner) / quad};
        }
        if (const auto* q = std::get_if<Quadrics>(&geometry.shapes)) {
            const double mean = 0.5 * (c.sphere + c.cone);
            if (const Sphere* s = std::get_if<Sphere>(&q->shapes[i]))
                return {4.0 * s->radius * s->radius, c.sphere / mean};
            if (const Cone* k = std::get_if<Cone>(&q->shapes[i]))
                return {(double(k->base_radius) + k->apex_radius) * (k->base - k->apex).norm(),
                        c.cone / mean};
            return {1.0, c.disc / mean};
        }
        return {1.0, 1.0};
    }
};

const Geometry* largest_geometry(const Scene& scene) {
    const Geometry* largest = nullptr;
    for (const Geometry& g : scene.geometries)
        if (!largest || ShapeView{g}.size() > ShapeView{*largest}.size()) largest = &g;
    return largest;
}

/// Half area of the box of eight shapes spread evenly over a run.
double run_area(const ShapeView& shapes, double first, double count) {
    Bounds3 box;
    for (int k = 0; k < 8; ++k) {
        const Vec3f p = shapes.middle(size_t(first + (k + 0.5) * count / 8));
        if (p.allFinite()) box.extend(p);
    }
    return half_area(box);
}

/// The search of choose_assembly.
class Chooser {
  public:
    Chooser(const Scene& scene, const AutoOptions& options, const RaySample& sample,
            const Calibration& calibration)
        : scene_(scene),
          options_(options),
          objective_(options.objective),
          sample_(sample),
          calibration_(calibration),
          counts_(count_shapes(scene)) {}

    Selection run() {
        const auto start = Clock::now();
        for (PlanChoice& choice : plan_choices(counts_, options_)) {
            Candidate c;
            c.predicted = estimate(choice, counts_, options_, calibration_);
            c.choice = std::move(choice);
            now_.push_back(c.predicted);
            out_.candidates.push_back(std::move(c));
        }
        best_of(now_, objective_);  // refuses where nothing fits
        pilot();
        search();
        out_.choose_s = seconds_since(start) - out_.assembly.build_s;
        finish();
        return std::move(out_);
    }

  private:
    double total() const { return now_[best_of(now_, objective_)].total_s; }
    double allowed() const { return options_.share * total() - spent_; }

    /// Scales every estimate to this scene by what a thinned one shows, if that is cheap enough.
    void pilot() {
        constexpr double shapes = 1024, per_shape_s = 12e-9;
        constexpr size_t rays = 96;
        const double all = counts_.kinds.empty() ? 0 : counts_.kinds.front().unique;
        if (sample_.rays.empty() || all < 4 * shapes) return;
        const CostEstimate cheap =
            estimate(quickest(), shapes, counts_.kinds.front().name, objective_, calibration_);
        const double ns = now_[best_of(now_, objective_)].ns_per_ray;
        const double cost = all * per_shape_s + cheap.build_s + 4e-9 * double(rays) * ns;
        if (cost > 0.3 * allowed()) return;
        spent_ += cost;
        const std::vector<Ray> some = some_of(sample_.rays, rays);
        const Pilot pilot(scene_, counts_, shapes);
        const PlanChoice choice = plan_choice(quickest(), PlanChoice::Placing::flat);
        const CostEstimate seen = pilot.estimate(
            choice, plan_of(choice), {some, sample_.any, sample_.mode}, options_, calibration_);
        const CostEstimate counted = estimate(choice, counts_, options_, calibration_);
        constexpr double thinning_spread = 0.5;
        scale(seen.ns_per_ray / counted.ns_per_ray, thinning_spread);
        for (size_t i = 0; i < now_.size(); ++i) {
            out_.candidates[i].predicted = now_[i];
            out_.candidates[i].basis = "pilot";
        }
    }

    static const StructureChoice& quickest() {
        for (const StructureChoice& s : structure_choices())
            if (s.name == "wide_bvh/lbvh") return s;
        return structure_choices().front();
    }

    /// Rays cost so many times what was expected of one structure. How much of that is due to the
    /// scene, and so holds for all that is not tried yet, follows from what is known of both
    /// deviations.
    /// @param spread  standard deviation of ln(factor) for this structure, in one scene
    void scale(double factor, double spread) {
        if (!std::isfinite(factor) || factor <= 0) return;
        const double own = std::max(spread * spread, 1e-4);
        const double common = std::pow(factor, scene_variance_ / (scene_variance_ + own));
        scene_variance_ *= own / (scene_variance_ + own);
        for (size_t i = 0; i < now_.size(); ++i) {
            if (out_.candidates[i].tried || !std::isfinite(now_[i].total_s)) continue;
            now_[i].ns_per_ray *= common;
            set_total(now_[i], objective_);
        }
    }

    void search() {
        for (size_t next = first(); next != now_.size();) {
            try_out(next);
            // What was built does not fit: the next best, if there is one.
            next = holds_one_ ? most_promising() : best_of(now_, objective_);
        }
    }

    /// The best estimate; or, if one that is built in no time would teach how dear rays are here
    /// before that, this one.
    size_t first() const {
        const size_t best = best_of(now_, objective_);
        if (objective_.priority != Priority::total || sample_.rays.empty()) return best;
        const double most = 0.4 * allowed();
        size_t stone = best;
        double least = infinity;
        for (size_t i = 0; i < now_.size(); ++i) {
            const CostEstimate& e = now_[i];
            if (!e.fits || is_lazy(out_.candidates[i].choice.structure)) continue;
            if (e.build_s + trial_s(e) <= most && e.total_s < least) least = e.total_s, stone = i;
        }
        return stone;
    }

    size_t trial_rays(const CostEstimate& e) const {
        // At most a small share of the total, each ray traced three times.
        constexpr double share = 0.004, most = 8192;
        const double rays = share * total() / (3e-9 * std::max(e.ns_per_ray, 1.0));
        return size_t(std::min({rays, most, double(sample_.rays.size())}));
    }
    double trial_s(const CostEstimate& e) const {
        return 3e-9 * e.ns_per_ray * double(trial_rays(e));
    }

    /// Of ln(ns per ray of candidate i over that of what is held). Few scenes were calibrated with,
    /// so that what they say of spreads is no more than a start.
    double deviation(size_t i) const {
        const StructureChoice &a = out_.candidates[i].choice.structure,
                              &b = out_.candidates[held_].choice.structure;
        const double least = a.type == b.type ? 0.1 : 0.2;
        return std::max(least, now_[i].ray_spread);
    }

    /// Expected seconds saved by building candidate i, too, less what that costs.
    double gain(size_t i) const {
        const CostEstimate& e = now_[i];
        if (!e.fits || !std::isfinite(e.total_s)) return -infinity;
        const double saved = objective_.rays * 1e-9 *
                             expected_gain(now_[held_].ns_per_ray, e.ns_per_ray, deviation(i));
        const double build = objective_.priority == Priority::trace ? 0 : e.build_s;
        return saved - build - trial_s(e);
    }

    /// Whether the time for choosing allows to build candidate i, too: of the two builds, the one
    /// that is not used in the end is lost, and which one that is has a probability.
    bool affordable(size_t i) const {
        const CostEstimate &e = now_[i], &held = now_[held_];
        const double wins_below = held.ns_per_ray - e.build_s * 1e9 / objective_.rays;
        const double wins =
            wins_below > 0 ? normal_share(std::log(wins_below / e.ns_per_ray) / deviation(i)) : 0;
        const double lost = wins * held.build_s + (1 - wins) * e.build_s;
        return lost + trial_s(e) <= allowed();
    }

    size_t most_promising() const {
        size_t best = now_.size();
        if (sample_.rays.empty() || objective_.priority == Priority::build) return best;
        double most = 0;
        for (size_t i = 0; i < now_.size(); ++i) {
            if (out_.candidates[i].tried || is_lazy(out_.candidates[i].choice.structure)) continue;
            if (const double g = gain(i); g > most && affordable(i)) most = g, best = i;
        }
        return best;
    }

    /// Builds candidate i, looks at it, and keeps the better of it and what was held.
    void try_out(size_t i) {
        Candidate& c = out_.candidates[i];
        Assembly assembly = assemble(scene_, plan_of(c.choice));
        const CostEstimate before = now_[i];
        CostEstimate seen = before;
        if (!is_lazy(c.choice.structure)) {
            seen.build_s = options_.clock ? assembly.build_s : seen.build_s;
            if (objective_.memory > 0) seen.bytes = double(total_statistics(*assembly.root).bytes);
        }
        const size_t rays = trial_rays(seen);
        constexpr size_t least_rays = 64;
        const bool looks = rays >= least_rays && !is_lazy(c.choice.structure);
        if (looks) {
            const std::vector<Ray> some = some_of(sample_.rays, rays);
            const RaySample sample{some, sample_.any, sample_.mode};
            seen.ns_per_ray = observed_ns(*assembly.root, c.choice.structure, counts_, sample,
                                          options_.clock, calibration_);
            seen.ray_spread = 0;
            spent_ += trial_s(seen);
        }
        set_total(seen, objective_);
        const double factor = seen.ns_per_ray / now_[i].ns_per_ray;
        c.tried = now_[i] = seen;
        if (looks) scale(factor, std::max(0.1, before.ray_spread));
        keep(i, std::move(assembly));
    }

    void keep(size_t i, Assembly assembly) {
        const bool better = now_[i].fits && (!holds_one_ || tried_score(i) < tried_score(held_));
        if (holds_one_ || !better) spent_ += now_[better ? held_ : i].build_s;
        if (!better) return;
        out_.assembly = std::move(assembly);
        held_ = i;
        holds_one_ = true;
    }

    double tried_score(size_t i) const {
        return objective_.priority == Priority::trace ? now_[i].ns_per_ray
               : objective_.priority == Priority::build
                   ? now_[i].build_s
                   // The build is spent by now, whichever is kept.
                   : now_[i].ns_per_ray;
    }

    void finish() {
        const std::string name = out_.candidates[held_].choice.name;
        if (!sample_.rays.empty()) {
            const std::vector<Ray> some = some_of(sample_.rays, 512);
            counts_.weight = test_weight(scene_, counts_.main_kind());
            out_.expected_ns =
                counted_ns(*out_.assembly.root, out_.candidates[held_].choice.structure, counts_,
                           {some, sample_.any, sample_.mode}, calibration_);
        }
        const auto tried = std::count_if(out_.candidates.begin(), out_.candidates.end(),
                                         [](const Candidate& c) { return c.tried.has_value(); });
        out_.reason = fmt::format(
            "{}: of {} candidates {} built and looked at; another build would not pay within "
            "{:.0f} "
            "% of the total",
            name, out_.candidates.size(), tried, 100 * options_.share);
        std::vector<size_t> order(now_.size());
        std::iota(order.begin(), order.end(), size_t{0});
        std::stable_sort(order.begin(), order.end(),
                         [&](size_t a, size_t b) { return now_[a].total_s < now_[b].total_s; });
        std::vector<Candidate> sorted;
        for (const size_t i : order) {
            if (i == held_) out_.chosen = sorted.size();
            sorted.push_back(std::move(out_.candidates[i]));
        }
        out_.candidates = std::move(sorted);
    }

    const Scene& scene_;
    const AutoOptions& options_;
    const Objective& objective_;
    const RaySample& sample_;
    const Calibration& calibration_;
    SceneCounts counts_;
    Selection out_;
    std::vector<CostEstimate> now_;  ///< of each candidate, with all that is known
    double scene_variance_ = 0.4;    ///< of ln(ns per ray), common to all structures
    double spent_ = 0;               ///< seconds of choosing so far, as estimated
    size_t held_ = 0;                ///< whose assembly is kept
    bool holds_one_ = false;
};

/// The choice that a plan's accelerator is, by type and parameters; else a structure of that type.
StructureChoice structure_of(const AcceleratorChoice& accelerator) {
    for (const StructureChoice& s : structure_choices())
        if (s.type == accelerator.type && s.parameters == accelerator.parameters) return s;
    return {accelerator.type, accelerator.type, accelerator.parameters};
}

std::string estimate_text(const CostEstimate& e) {
    return fmt::format("{:>9.4f} {:>9.3f} {:>8.1f} {:>10.4f}", e.build_s, e.bytes / 1e6,
                       e.ns_per_ray, e.total_s);
}

}  // namespace

const std::string& SceneCounts::main_kind() const {
    static const std::string none = "triangles";
    return kinds.empty() ? none : kinds.front().name;
}

AssemblyPlan plan_of(const PlanChoice& choice) {
    AssemblyPlan plan;
    plan.top = plan.objects = choice_of(choice.structure);
    plan.flatten = choice.placing == PlanChoice::Placing::flat;
    if (choice.placing == PlanChoice::Placing::opened) plan.opening = 2;
    return plan;
}

SceneCounts count_shapes(const Scene& scene) {
    SceneCounts counts;
    for (const char* name : {"triangles", "quadrics", "polygons"}) counts.kinds.push_back({name});
    const std::vector<double> placements = placements_of_meshes(scene);
    for (size_t m = 0; m < scene.meshes.size(); ++m) {
        if (placements[m] == 0) continue;
        double shapes = 0;
        for (const uint32_t g : scene.meshes[m].geometries) {
            const Geometry& geometry = scene.geometries[g];
            const double n = std::visit(ShapeSize{}, geometry.shapes);
            for (SceneCounts::Kind& kind : counts.kinds)
                if (kind.name == kind_of_shapes(geometry))
                    kind.unique += n, kind.placed += n * placements[m];
            shapes += n;
        }
        add_mesh(counts, shapes);
        counts.placements += placements[m];
    }
    std::erase_if(counts.kinds, [](const SceneCounts::Kind& k) { return k.unique == 0; });
    std::stable_sort(counts.kinds.begin(), counts.kinds.end(),
                     [](const auto& a, const auto& b) { return a.placed > b.placed; });
    counts.order = order_visits(scene);
    return counts;
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
    double placed = 0;
    for (const SceneCounts::Kind& kind : counts.kinds) placed += kind.placed;
    for (const StructureChoice& s : structure_choices()) {
        if (s.type == "brute_force" && placed > most_for_brute_force) continue;
        if (is_lazy(s) && placed < least_for_lazy) continue;
        out.push_back(plan_choice(s, Placing::flat));
    }
    if (counts.placements > 1)
        for (const StructureChoice& s : structure_choices())
            for (const Placing placing : {Placing::nested, Placing::opened}) {
                const auto& list = placing == Placing::nested ? nested_names : opened_names;
                if (std::find(list.begin(), list.end(), s.name) != list.end())
                    out.push_back(plan_choice(s, placing));
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

CostEstimate estimate(const PlanChoice& choice, const SceneCounts& counts,
                      const AutoOptions& options, const Calibration& calibration) {
    CostEstimate e;
    if (counts.kinds.empty()) return e;
    const Objective& objective = options.objective;
    e = flat_estimate(choice.structure, counts, objective, calibration);
    if (!std::isfinite(e.total_s)) return e;
    if (uses_order(choice.structure))
        if (const auto* costs = costs_of(choice.structure, counts.main_kind(), calibration))
            e.ns_per_ray *= std::sqrt(counts.order / costs->order);
    if (choice.placing != PlanChoice::Placing::flat) {
        const bool opened = choice.placing == PlanChoice::Placing::opened;
        const CostEstimate nested = nested_estimate(
            choice.structure, counts, counts.placements * (opened ? 2 : 1), objective, calibration);
        e.build_s = nested.build_s;
        e.bytes = nested.bytes;
        e.ns_per_ray *= opened ? opened_factor : nested_factor;
        e.ray_spread = std::hypot(e.ray_spread, opened ? 0.12 : 0.2);
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

bool chooses_all(const AssemblyPlan& plan) {
    return plan.top->type == "auto" && plan.objects->type == "auto" && !plan.flatten &&
           plan.opening <= 1 && plan.rules.empty() && plan.top->parameters.empty() &&
           plan.objects->parameters.empty();
}

Pilot::Pilot(const Scene& scene, const SceneCounts& counts, double shapes) : counts_(counts) {
    double unique = 0;
    for (const SceneCounts::Kind& kind : counts.kinds) unique += kind.unique;
    thin_ = thinned(scene, std::max(1.0, unique / shapes));
    thin_counts_ = count_shapes(thin_);
}

CostEstimate Pilot::estimate(const PlanChoice& choice, const AssemblyPlan& plan,
                             const RaySample& sample, const AutoOptions& options,
                             const Calibration& calibration) const {
    const CostEstimate thin = crofton::estimate(choice, thin_counts_, options, calibration);
    CostEstimate full = crofton::estimate(choice, counts_, options, calibration);
    const Assembly assembly = assemble(thin_, plan);
    const double ns = observed_ns(*assembly.root, choice.structure, thin_counts_, sample,
                                  options.clock, calibration);
    full.ns_per_ray *= ns / thin.ns_per_ray;
    if (options.clock && !is_lazy(choice.structure))
        full.build_s *= assembly.build_s / thin.build_s;
    // A thinned mesh shares few corners, and on shared ones the patches of wide_bvh live.
    if (choice.structure.type != "wide_bvh")
        full.bytes *= double(total_statistics(*assembly.root).bytes) / thin.bytes;
    set_total(full, options.objective);
    return full;
}

double observed_ns(const Primitive& root, const StructureChoice& structure,
                   const SceneCounts& counts, const RaySample& sample, bool clock,
                   const Calibration& calibration) {
    if (!clock) return counted_ns(root, structure, counts, sample, calibration);
    traced_seconds(root, sample.rays, sample);  // warms up
    const double s = std::min(traced_seconds(root, sample.rays, sample),
                              traced_seconds(root, sample.rays, sample));
    return s * 1e9 / double(sample.rays.size());
}

double order_visits(const Scene& scene) {
    const Geometry* geometry = largest_geometry(scene);
    if (!geometry) return 1;
    const ShapeView shapes{*geometry};
    const double n = double(shapes.size());
    Bounds3 all;
    constexpr int points = 64, runs = 12;
    if (n < points) return 1;
    for (int k = 0; k < points; ++k)
        if (const Vec3f p = shapes.middle(size_t((k + 0.5) * n / points)); p.allFinite())
            all.extend(p);
    const double whole = half_area(all);
    if (!(whole > 0)) return 1;
    double visits = 0;
    int levels = 0;
    for (double count = 8; count * 4 <= n; count *= 8, ++levels) {
        double area = 0;
        for (int k = 0; k < runs; ++k) area += run_area(shapes, k * (n - count) / runs, count);
        visits += n / count * (area / runs) / whole;
    }
    return levels > 0 ? std::max(visits / levels, 1e-3) : 1;
}

double test_weight(const Scene& scene, const std::string& kind) {
    constexpr size_t most = 512;
    double sum = 0, areas = 0;
    for (const Geometry& g : scene.geometries) {
        const ShapeView shapes{g};
        if (kind != kind_of_shapes(g)) continue;
        const size_t n = shapes.size(), step = std::max<size_t>(1, n / most);
        for (size_t i = 0; i < n; i += step) {
            const auto [area, cost] = shapes.area_and_cost(i);
            if (!std::isfinite(area)) continue;
            sum += double(step) * area * cost, areas += double(step) * area;
        }
    }
    return areas > 0 ? sum / areas : 1;
}

Selection choose_assembly(const Scene& scene, const AutoOptions& options, const RaySample& sample,
                          const Calibration& calibration) {
    return Chooser(scene, options, sample, calibration).run();
}

std::string explanation(const Selection& selection, const Objective& objective, size_t limit) {
    std::string text = fmt::format(
        "Chosen for {:g} rays{}: {}\n  choosing took {:.4f} s\n", objective.rays,
        objective.memory > 0 ? fmt::format(" in {:g} bytes", objective.memory) : std::string(),
        selection.reason, selection.choose_s);
    text += fmt::format("  {:32} {:>9} {:>9} {:>8} {:>10}   {}\n", "candidate", "build s", "MB",
                        "ns/ray", "total s", "from");
    size_t lines = 0;
    for (size_t i = 0; i < selection.candidates.size(); ++i) {
        const Candidate& c = selection.candidates[i];
        if (lines++ >= limit && i != selection.chosen) continue;
        if (!std::isfinite(c.known().total_s)) continue;
        const std::string mark = i == selection.chosen ? "*" : c.known().fits ? " " : "-";
        text += fmt::format("{} {:32} {}   {}\n", mark, c.choice.name, estimate_text(c.predicted),
                            c.basis);
        if (c.tried) text += fmt::format("  {:32} {}   built\n", "", estimate_text(*c.tried));
    }
    return text;
}

}  // namespace crofton
