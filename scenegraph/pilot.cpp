#include "scenegraph/pilot.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "framework/clock.h"
#include "scenegraph/thinned.h"

namespace crofton {
namespace {

constexpr size_t observed_parts = 4;
constexpr double infinity = std::numeric_limits<double>::infinity();

double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + long(values.size() / 2), values.end());
    return values[values.size() / 2];
}

double traced_seconds(const Primitive& root, std::span<const Ray> rays, const RaySample& like) {
    std::vector<uint8_t> results(like.any ? rays.size() : 0);
    std::vector<Hit> hits(like.any ? 0 : rays.size());
    const auto start = Clock::now();
    if (like.any)
        root.occluded(rays, results, like.mode);
    else
        root.intersect(rays, hits, like.mode);
    return seconds_since(start);
}

}  // namespace

std::vector<Ray> some_of(std::span<const Ray> rays, size_t count) {
    constexpr size_t run = 16, parts = observed_parts;
    count = std::min(count, rays.size());
    // So many that every part has some.
    const size_t length = std::clamp<size_t>(count / (4 * parts), 1, run), runs = count / length;
    const double stretch = double(rays.size()) / double(std::max<size_t>(1, runs));
    std::vector<Ray> out;
    for (size_t part = 0; part < parts; ++part)
        for (size_t r = part; r < runs; r += parts) {
            // At steps of one length they might all be at one side of a picture.
            double whole;
            const double within = std::modf(double(r) * std::numbers::phi, &whole);
            const auto first =
                std::min(size_t(stretch * double(r) + within * (stretch - double(length))),
                         rays.size() - length);
            out.insert(out.end(), rays.begin() + long(first), rays.begin() + long(first + length));
        }
    return out;
}

Coherence coherence_of(std::span<const Ray> rays) {
    constexpr size_t pairs = 16;
    constexpr double near = 0.98;  // cosine
    if (rays.size() < 2) return Coherence::unknown;
    size_t together = 0;
    for (size_t i = 0; i < pairs; ++i) {
        const size_t at = i * (rays.size() - 2) / (pairs - 1);
        const Ray &a = rays[at], &b = rays[at + 1];
        const double dot = a.direction.dot(b.direction);
        together += a.origin == b.origin && dot > near * a.direction.norm() * b.direction.norm();
    }
    return together > pairs / 2 ? Coherence::together : Coherence::apart;
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
    const bool together = coherence_of(sample.rays) == Coherence::together;
    return (together ? costs->counted_together : 1) *
           costs->counted_ns(double(sum.N_TS) / n, counts.weight * double(sum.N_IT) / n,
                             double(total_statistics(root).bytes), calibration.cache_bytes);
}

Pilot::Pilot(const Scene& scene, const SceneCounts& counts, double shapes, size_t looked_at)
    : counts_(counts) {
    thin_ = thinned(scene, std::max(1.0, counts.unique() / shapes), looked_at);
    thin_counts_ = count_shapes(thin_);
    thin_counts_.weight = counts.weight;
}

namespace {

/// The power of shapes that ns per ray grow with from a thinned scene.
double thin_ray(const StructureCosts& costs, Coherence coherence) {
    return coherence == Coherence::together ? costs.thin_together : costs.thin_apart;
}

}  // namespace

/// Shapes of the scene for one of the thinned scene.
double Pilot::growth() const {
    return std::max(1.0, counts_.placed()) / std::max(1.0, thin_counts_.placed());
}

const Assembly& Pilot::built(const PlanChoice& choice) {
    const auto found = built_.find(choice.name);
    if (found != built_.end()) return found->second;
    return built_.emplace(choice.name, assemble(thin_, plan_of(choice))).first->second;
}

double Pilot::ratio(const PlanChoice& choice, const PlanChoice& other, const RaySample& sample,
                    const AutoOptions& options, const Calibration& calibration) {
    const auto costs = [&](const PlanChoice& c) {
        return costs_of(c.structure, counts_.main_kind(), calibration);
    };
    const StructureCosts *own = costs(choice), *others = costs(other);
    if (!own || !others) return infinity;
    const auto counted = [&](const PlanChoice& c) {
        return counted_ns(*built(c).root, c.structure, thin_counts_, sample, calibration);
    };
    const double thin = options.clock ? time_ratio(*built(choice).root, *built(other).root, sample)
                                      : counted(choice) / counted(other);
    const Coherence coherence = options.objective.coherence;
    return thin * std::pow(growth(), thin_ray(*own, coherence) - thin_ray(*others, coherence));
}

CostEstimate Pilot::estimate(const PlanChoice& choice, const AssemblyPlan& plan,
                             const RaySample& sample, const AutoOptions& options,
                             const Calibration& calibration, int builds, double* factor) const {
    const CostEstimate thin = crofton::estimate(choice, thin_counts_, options, calibration);
    CostEstimate full = crofton::estimate(choice, counts_, options, calibration);
    const StructureCosts* costs = costs_of(choice.structure, counts_.main_kind(), calibration);
    if (!costs) return full;
    Assembly assembly = assemble(thin_, plan);
    std::vector<double> seconds{assembly.build_s};
    while (seconds.size() < size_t(builds)) {
        assembly = {};  // never two at a time
        assembly = assemble(thin_, plan);
        seconds.push_back(assembly.build_s);
    }
    const auto counted = [&] {
        return counted_ns(*assembly.root, choice.structure, thin_counts_, sample, calibration);
    };
    const double ns = options.clock ? observed_ns(*assembly.root, sample) : counted();
    if (factor) *factor = ns / counted();
    full.ns_per_ray = ns * std::pow(growth(), thin_ray(*costs, options.objective.coherence));
    if (options.clock && !is_lazy(choice.structure))
        full.build_s = median(std::move(seconds)) * std::pow(growth(), costs->thin_build);
    // A thinned mesh shares few corners, and on shared ones the patches of wide_bvh live.
    if (choice.structure.type != "wide_bvh")
        full.bytes *= double(total_statistics(*assembly.root).bytes) / thin.bytes;
    set_total(full, options.objective);
    return full;
}

double middle_ratio(std::vector<RunSeconds> seconds) {
    std::sort(seconds.begin(), seconds.end(),
              [](const auto& a, const auto& b) { return a.own * b.others < b.own * a.others; });
    double all = 0, passed = 0, own = 0, others = 0;
    for (const RunSeconds& run : seconds) all += run.weight();
    for (const RunSeconds& run : seconds) {
        if (!(run.weight() > 0)) continue;
        const double from = std::max(passed, 0.25 * all);
        passed += run.weight();
        const double part = std::max(0.0, std::min(passed, 0.75 * all) - from) / run.weight();
        own += part * run.own, others += part * run.others;
    }
    return own / others;
}

double time_ratio(const Primitive& root, const Primitive& other, const RaySample& sample) {
    constexpr size_t least = 64, most_runs = 32;
    const size_t n = sample.rays.size(), runs = std::clamp<size_t>(n / least, 1, most_runs);
    std::vector<RunSeconds> seconds(runs);
    for (size_t r = 0; r < runs; ++r) {
        const size_t begin = n * r / runs;
        const std::span<const Ray> run = sample.rays.subspan(begin, n * (r + 1) / runs - begin);
        auto& [own, others] = seconds[r];
        // Who goes first finds the rays less warm.
        if (r % 2 == 0) own = traced_seconds(root, run, sample);
        others = traced_seconds(other, run, sample);
        if (r % 2 == 1) own = traced_seconds(root, run, sample);
    }
    return middle_ratio(std::move(seconds));
}

double observed_ns(const Primitive& root, const RaySample& sample) {
    const size_t part = std::max<size_t>(1, sample.rays.size() / observed_parts);
    std::vector<double> ns;
    for (size_t first = 0; first + part <= sample.rays.size(); first += part)
        ns.push_back(traced_seconds(root, sample.rays.subspan(first, part), sample) * 1e9 /
                     double(part));
    if (ns.size() > 1) ns.erase(ns.begin());  // it warmed up
    // Not their median: of a picture that shows little, that is too small.
    constexpr double most = 2.5;
    const double middle = median(ns);
    double sum = 0;
    for (const double part_ns : ns) sum += std::min(part_ns, most * middle);
    return sum / double(ns.size());
}

}  // namespace crofton
