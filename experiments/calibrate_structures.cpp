#include "experiments/calibrate_structures.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <span>

#include "accelerators/auto_select.h"
#include "experiments/calibration_scenes.h"
#include "experiments/fit.h"
#include "experiments/measure.h"
#include "experiments/statistics.h"
#include "framework/clock.h"
#include "scenegraph/assemble.h"
#include "scenegraph/pilot.h"
#include "scenegraph/thinned.h"

namespace crofton {
namespace {

AssemblyPlan flat_plan(const StructureChoice& choice) {
    return plan_of(plan_choice(choice, PlanChoice::Placing::flat));
}

/// One structure over one sample.
struct Observation {
    const CalibrationScene* sample = nullptr;
    double build_relative = 0;  ///< its time over that of the quickest structure
    double relative = 0;        ///< time of a ray over that of the reference
    double structure_bytes = 0;
    double build_ns = 0, bytes = 0;  ///< per shape
    double ray_ns = 0;
    std::vector<RayCost> rays;  ///< counters and time of each set of rays
    /// Powers that costs grow with from the scene thinned to the whole one; none for small scenes.
    std::optional<double> thin_apart, thin_build, thin_together;
};

/// Writes to more than the second cache holds: who builds a structure has most often done something
/// else before.
void forget() {
    static std::vector<uint64_t> others(size_t{4} << 17u);  // 4 MiB
    for (size_t i = 0; i < others.size(); i += 8) ++others[i];
}

/// Builds until the median is steady enough; what is dear, once.
/// @param beside  called after each build
template <class Beside>
double build_seconds(const Scene& scene, const AssemblyPlan& plan, Assembly& last,
                     const Beside& beside) {
    std::vector<double> seconds;
    double sum = 0;
    while (seconds.size() < 3 || (sum < 2e-3 && seconds.size() < 15)) {
        last = Assembly{};
        forget();
        last = assemble(scene, plan);
        seconds.push_back(last.build_s);
        beside();
        sum += last.build_s;
        if (sum > 0.02) break;
    }
    return median_interval(std::move(seconds)).median;
}

/// Rays of one kind. Processors remember the branches of some thousand rays, and of many more
/// rays no branch is known: so every structure is to be timed with rays that it has not seen.
struct RaySet {
    std::vector<Ray> timed, compared;  ///< beside the reference; beside a thinned scene
    std::vector<Ray> backwards;        ///< the same lines the other way
    bool view;                         ///< of a camera
    std::vector<double> ns = {};       ///< per ray, of the reference whenever it was timed

    /// @param size  of the scene
    RaySet(const std::vector<Ray>& rays, float size, bool of_camera)
        : backwards(rays), view(of_camera) {
        constexpr size_t run = 256;  // those of a camera follow each other
        for (size_t i = 0; i < rays.size(); ++i)
            (i / run % 2 == 0 ? timed : compared).push_back(rays[i]);
        for (Ray& ray : backwards) {
            const Vec3f direction = ray.direction.normalized();
            ray.origin += 2 * size * direction;
            ray.direction = -direction;
        }
    }
    /// Brings into the caches what so many rays will need: so it is for all but the first of many.
    void warm(const Primitive& root, size_t count) const {
        trace_hits(root, some_of(backwards, count), {false, 1});
    }
};

/// The first choice over a scene: what rays take in every other one is timed beside it, in turns,
/// since what else a machine does changes from second to second; and builds beside those of the
/// quickest one.
struct Reference {
    const Scene& scene;
    Assembly assembly;
    std::vector<RaySet> sets;     ///< those that there are
    std::vector<double> build_s;  ///< of the quickest, whenever it was timed

    Reference(const CalibrationScene& sample, const StructureChoice& choice)
        : scene(sample.scene), assembly(assemble(scene, flat_plan(choice))) {
        const float size = assembly.root->bounds().extent().norm();
        for (const std::vector<Ray>* rays : {&sample.lines, &sample.view, &sample.inside})
            if (!rays->empty()) sets.emplace_back(*rays, size, rays == &sample.view);
    }
    double build_quickest() {
        static const AssemblyPlan plan = flat_plan(quickest());
        forget();
        build_s.push_back(assemble(scene, plan).build_s);
        return build_s.back();
    }
};

/// So many rays that they take some milliseconds at most, however slow the structures.
std::vector<Ray> timed_rays(const std::vector<Ray>& rays, const Primitive& a, const Primitive& b) {
    const auto first = std::span(rays).first(std::min<size_t>(rays.size(), 64));
    const double ns = pilot_ns(a, first, {false, 1}) + pilot_ns(b, first, {false, 1});
    return some_of(rays, std::max<size_t>(64, size_t(3.5e6 / std::max(ns, 1.0))));
}

/// Counts, and times over those of the reference: see make_absolute.
std::vector<RayCost> ray_costs(const Primitive& root, Reference& reference) {
    std::vector<RayCost> costs;
    const Primitive& other = *reference.assembly.root;
    for (RaySet& set : reference.sets) {
        const std::vector<Ray> some = timed_rays(set.timed, root, other);
        const RaySample sample{some, false, Mode::robust};
        const Counters counters = counted_pass(root, some, false);
        const double n = double(some.size());
        for (const Primitive* p : {&root, &other}) set.warm(*p, some.size());
        costs.push_back({time_ratio(root, other, sample), double(counters.N_TS) / n,
                         double(counters.N_IT) / n, set.view});
        const std::vector<Ray> few = some_of(set.timed, some.size() / 4);
        set.ns.push_back(observed_ns(other, {few, false, Mode::robust}));
    }
    return costs;
}

/// Lazy structures are built by rays that meet every part.
void wake(const Primitive& root, const Reference& reference) {
    for (const RaySet& set : reference.sets)
        for (const auto* rays : {&set.timed, &set.compared}) trace_hits(root, *rays, {false, 1});
}

/// What pilots do, to scenes whose costs are known: rays are tried on few shapes, builds on more,
/// since the first thousand shapes of a build are dearer than others.
constexpr double least_to_thin = 4096, thin_shapes = 1024, thin_factor = 4;

struct Thinned {
    Assembly assembly;
    double seconds;  ///< of its build
    double powers;   ///< log of shapes of the whole scene for one of this
};
Thinned build_thinned(const AssemblyPlan& plan, const CalibrationScene& sample, double factor) {
    const Scene scene = thinned(sample.scene, factor);
    Thinned thin;
    thin.seconds = build_seconds(scene, plan, thin.assembly, [] {});
    thin.powers = std::log(double(sample.count) / double(statistics(scene).shapes_instanced));
    return thin;
}

/// @param whole    the structure over the whole scene
/// @param seconds  of its build
void observe_thinned(const AssemblyPlan& plan, Observation& o, const Primitive& whole,
                     const Reference& reference, double seconds) {
    const Thinned large = build_thinned(plan, *o.sample, thin_factor);
    o.thin_build = std::log(seconds / large.seconds) / large.powers;
    const Thinned small = build_thinned(plan, *o.sample, double(o.sample->count) / thin_shapes);
    const Primitive& thin = *small.assembly.root;
    std::vector<double> apart;
    for (const RaySet& set : reference.sets) {
        const std::vector<Ray> some = timed_rays(set.compared, whole, thin);
        for (const Primitive* p : {&whole, &thin}) set.warm(*p, some.size());
        const double ratio = time_ratio(whole, thin, {some, false, Mode::robust});
        if (set.view)
            o.thin_together = std::log(ratio) / small.powers;
        else
            apart.push_back(ratio);
    }
    o.thin_apart = std::log(geometric_mean(apart)) / small.powers;
}

Observation observe(const StructureChoice& choice, const CalibrationScene& sample,
                    Reference& reference) {
    const AssemblyPlan plan = flat_plan(choice);
    Observation o;
    o.sample = &sample;
    Assembly assembly;
    std::vector<double> quickest_s;
    double seconds = build_seconds(sample.scene, plan, assembly,
                                   [&] { quickest_s.push_back(reference.build_quickest()); });
    if (choice.parameters.contains("lazy")) {
        const auto start = Clock::now();
        wake(*assembly.root, reference);
        const double first = seconds_since(start);
        const auto again = Clock::now();
        wake(*assembly.root, reference);
        seconds += std::max(0.0, first - seconds_since(again));
    }
    o.build_relative = seconds / median_interval(std::move(quickest_s)).median;
    o.rays = ray_costs(*assembly.root, reference);
    o.relative = geometric_mean_ns(o.rays);
    o.structure_bytes = double(total_statistics(*assembly.root).bytes);
    o.bytes = o.structure_bytes / double(sample.count);
    if (sample.size >= least_to_thin) observe_thinned(plan, o, *assembly.root, reference, seconds);
    return o;
}

/// Makes nanoseconds of ratios, now that the reference has been timed often.
void make_absolute(Observation& o, const Reference& reference) {
    for (size_t k = 0; k < o.rays.size(); ++k)
        o.rays[k].ns *= median_interval(reference.sets[k].ns).median;
    o.ray_ns = geometric_mean_ns(o.rays);
    o.build_ns = o.build_relative * median_interval(reference.build_s).median * 1e9 /
                 double(o.sample->count);
}

/// What rays of the view take, and those of the other sets, over the mean of all.
void set_coherence(GrowthPoint& point, std::span<const Observation> observations) {
    std::vector<double> together, apart;
    for (const Observation& o : observations) {
        std::vector<RayCost> view, others;
        for (const RayCost& r : o.rays) (r.view ? view : others).push_back(r);
        if (view.empty() || others.empty()) continue;
        together.push_back(geometric_mean_ns(view) / o.ray_ns);
        apart.push_back(geometric_mean_ns(others) / o.ray_ns);
    }
    if (together.empty()) return;
    point.together = geometric_mean(together), point.apart = geometric_mean(apart);
}

void set_thinned(StructureCosts& costs, const std::vector<Observation>& observations) {
    const auto set = [&](double& power, const std::optional<double> Observation::*observed) {
        double sum = 0;
        int n = 0;
        for (const Observation& o : observations)
            if (o.*observed) sum += *(o.*observed), ++n;
        if (n > 0) power = sum / n;
    };
    set(costs.thin_apart, &Observation::thin_apart);
    set(costs.thin_build, &Observation::thin_build);
    set(costs.thin_together, &Observation::thin_together);
}

/// @param nodes  as in fit_counted
StructureCosts costs_of(const StructureChoice& choice, const std::string& kind,
                        const std::vector<Observation>& observations, double cache_bytes,
                        const StructureCosts* nodes) {
    StructureCosts costs;
    costs.structure = choice.name;
    costs.shapes = kind;
    std::vector<CountedRay> counted, viewed;  // what goes together takes less than it counts
    std::vector<double> ray_deviations, build_deviations;
    // Samples of a size become one point.
    for (size_t begin = 0, end = 0; begin < observations.size(); begin = end) {
        std::vector<double> shapes, build, bytes, ray, relative;
        for (end = begin; end < observations.size() &&
                          observations[end].sample->size == observations[begin].sample->size;
             ++end) {
            const Observation& o = observations[end];
            shapes.push_back(double(o.sample->count));
            build.push_back(o.build_ns);
            bytes.push_back(o.bytes);
            ray.push_back(o.ray_ns);
            relative.push_back(o.relative);
            for (const RayCost& r : o.rays)
                (r.view ? viewed : counted).push_back({r, o.structure_bytes});
        }
        costs.growth.push_back({geometric_mean(shapes), geometric_mean(build),
                                geometric_mean(bytes), geometric_mean(ray)});
        set_coherence(costs.growth.back(), std::span(observations).subspan(begin, end - begin));
        for (const double x : relative)
            ray_deviations.push_back(std::log(x / geometric_mean(relative)));
        for (const double x : build)
            build_deviations.push_back(std::log(x / costs.growth.back().build_ns));
    }
    set_thinned(costs, observations);
    costs.ray_spread = root_mean_square(ray_deviations);
    costs.build_spread = root_mean_square(build_deviations);
    fit_counted(costs, counted, cache_bytes, nodes);
    std::vector<double> over;
    for (const CountedRay& r : viewed)
        over.push_back(r.ray.ns / costs.counted_ns(r.ray.steps, r.ray.tests, r.bytes, cache_bytes));
    if (!over.empty()) costs.counted_together = geometric_mean(over);
    for (const CountedRay& c : counted)
        costs.test_share +=
            std::min(1.0, costs.per_test * c.ray.tests / c.ray.ns) / double(counted.size());
    return costs;
}

/// More shapes than this take a structure without hierarchy too long.
constexpr double most_for_brute_force = 4096;

/// Every structure over the samples of one kind of shape.
void measure_structures(Calibration& c, const std::string& kind,
                        const std::vector<CalibrationScene>& samples) {
    const std::vector<StructureChoice>& choices = structure_choices();
    std::map<const CalibrationScene*, Reference> references;
    for (const CalibrationScene& s : samples)
        if (s.shapes == kind) references.emplace(&s, Reference(s, choices.front()));
    std::vector<std::vector<Observation>> observations(choices.size());
    for (size_t i = 0; i < choices.size(); ++i)
        for (auto& [sample, reference] : references)
            if (choices[i].type != "brute_force" || sample->size <= most_for_brute_force)
                observations[i].push_back(observe(choices[i], *sample, reference));
    for (size_t i = 0; i < choices.size(); ++i) {
        for (Observation& o : observations[i]) make_absolute(o, references.at(o.sample));
        // Nodes cost the same whatever is in the leaves: as found over triangles, which come first.
        const StructureCosts* nodes = c.find(choices[i].name, "triangles");
        const StructureCosts costs =
            costs_of(choices[i], kind, observations[i], c.cache_bytes, nodes);
        c.structures.push_back(costs);
    }
}

}  // namespace

void measure_structures(Calibration& c) {
    const std::vector<CalibrationScene> samples = calibration_scenes();
    for (const char* kind : {"triangles", "quadrics", "polygons"})
        measure_structures(c, kind, samples);
}

}  // namespace crofton
