#include "scenegraph/auto_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "framework/clock.h"

namespace crofton {
namespace {

std::vector<Candidate> candidates_for(std::vector<PlanChoice> choices, const SceneCounts& counts,
                                      const AutoOptions& options, const Calibration& calibration) {
    std::vector<Candidate> out;
    out.reserve(choices.size());
    for (PlanChoice& choice : choices) {
        Candidate& c = out.emplace_back();
        c.predicted = estimate(choice, counts, options, calibration);
        c.choice = std::move(choice);
    }
    return out;
}

/// What it takes to look at all candidates, seconds: about as long for few shapes as for many,
/// since little of what this needs is in a cache.
constexpr double look_s = 2.2e-4;

/// Of few rays: what is chosen from a short list, because to look at more would take too long.
const PlanChoice* quick_choice(const SceneCounts& counts, const AutoOptions& options,
                               const Calibration& calibration) {
    constexpr double least_shapes = 256;  // fewer may need no structure
    const Objective& objective = options.objective;
    if (objective.priority != Priority::total || objective.memory > 0 || options.max_error > 0 ||
        counts.placed() < least_shapes)
        return nullptr;
    const PlanChoice* best = nullptr;
    double least = look_s / options.share;
    for (const PlanChoice& choice : quick_choices(counts.placements > 1))
        if (const double s = estimate(choice, counts, options, calibration).total_s; s < least)
            best = &choice, least = s;
    return best;
}

/// Nanoseconds per ray of what was chosen, by what is counted on some of the rays; 0: there are
/// none.
double expected_ns(const Selection& selection, const SceneCounts& counts, const RaySample& sample,
                   const Calibration& calibration) {
    if (sample.rays.empty()) return 0;
    const std::vector<Ray> some = some_of(sample.rays, 512);
    return counted_ns(*selection.assembly.root, selection.choice().choice.structure, counts,
                      {some, sample.any, sample.mode}, calibration);
}

/// Builds what was chosen from the short list.
Selection quick_selection(const Scene& scene, const PlanChoice& choice, SceneCounts counts,
                          const AutoOptions& options, const RaySample& sample,
                          const Calibration& calibration, Clock::time_point start) {
    Selection out;
    out.assembly = assemble(scene, plan_of(choice));
    out.choose_s = seconds_since(start) - out.assembly.build_s;
    // What follows only tells of the choice.
    Outlook outlook(
        candidates_for(quick_choices(counts.placements > 1), counts, options, calibration), options,
        0);
    out.chosen = outlook.best();
    out.candidates = std::move(outlook).sorted(out.chosen);
    out.reason = fmt::format(
        "{}: of {} candidates that are built fast; to look at more would take more than {:.0f} % "
        "of the total",
        choice.name, out.candidates.size(), 100 * options.share);
    counts.weight = test_weight(scene, counts.main_kind());
    out.expected_ns = expected_ns(out, counts, sample, calibration);
    return out;
}

/// The search of choose_assembly: builds and looks, as the outlook says.
class Chooser {
  public:
    Chooser(const Scene& scene, const AutoOptions& options, const RaySample& sample,
            const Calibration& calibration, SceneCounts counts, Clock::time_point start)
        : start_(start),
          scene_(scene),
          options_(options),
          sample_(sample),
          calibration_(calibration),
          counts_(std::move(counts)),
          outlook_(candidates_for(plan_choices(counts_, options), counts_, options, calibration),
                   options, sample.rays.size()) {}

    Selection run() {
        outlook_.best();  // refuses where nothing fits
        pilot();
        for (size_t next = outlook_.first(); next != outlook_.size();) {
            try_out(next);
            // What was built does not fit: the next best, if there is one.
            next = holds_one_ ? next_after_pilots() : outlook_.best();
        }
        out_.choose_s = spent_s();
        finish();
        return std::move(out_);
    }

  private:
    /// Without the build of what is held.
    double spent_s() const { return seconds_since(start_) - out_.assembly.build_s; }
    /// Something was done. @param expected  seconds that it was to take: without a clock it did
    void spend(double expected) {
        outlook_.set_spent(options_.clock ? spent_s() : outlook_.spent() + expected);
    }

    /// Scales every estimate to this scene by what a thinned one shows, if that is cheap enough.
    void pilot() {
        constexpr double most_shapes = 1024, least_shapes = 256;
        constexpr size_t rays = 512;
        const double all = counts_.unique();
        if (sample_.rays.empty() || all < 4 * least_shapes) return;
        // An order that promises most is to be tried there, too.
        const bool ordered = uses_order(outlook_.candidates()[outlook_.best()].choice.structure);
        const double ns = outlook_[outlook_.best()].ns_per_ray;
        double shapes = most_shapes, cost = 0;
        for (;; shapes /= 2) {
            if (shapes < least_shapes) return;
            const double one = pilot_s(shapes, rays, ns),
                         most = most_of_pilots * outlook_.allowed();
            cost = thinning_s(shapes) + one;
            if (all >= 4 * shapes && cost + (ordered ? one : 0) <= most) break;
        }
        Pilot pilot(scene_, counts_, shapes, looked_at);
        const PlanChoice flat = plan_choice(quickest(), PlanChoice::Placing::flat);
        const std::vector<Ray> some = some_of(sample_.rays, rays);
        const double seen = pilot
                                .estimate(flat, plan_of(flat), {some, sample_.any, sample_.mode},
                                          options_, calibration_)
                                .ns_per_ray;
        spend(cost);
        outlook_.learn_from_pilot(seen /
                                  estimate(flat, counts_, options_, calibration_).ns_per_ray);
        const size_t best = outlook_.best();
        const double again = pilot_s(shapes, rays, seen);
        if (uses_order(outlook_.candidates()[best].choice.structure) &&
            again <= outlook_.allowed()) {
            // What a sample says of the order is not enough to build by, and no order that was seen
            // is as good as a tree that is built.
            constexpr double least = 1.2;
            const double ratio = compared(pilot, outlook_.candidates()[best].choice, flat, rays);
            spend(again);
            outlook_.learn_from_pilots(best, index_of(flat), std::max(least, ratio));
        }
        pilot_pairs(pilot, flat, 2 * pilot_s(shapes, rays_of_pairs, seen));
    }

    /// Compares a careful build and a nested one with what the pilot has built, as far as there is
    /// time.
    /// @param cost  of each, seconds
    void pilot_pairs(Pilot& pilot, const PlanChoice& flat, double cost) {
        if (cost > most_of_pilots * outlook_.allowed()) return;
        const PlanChoice careful = plan_choice(default_structure(), PlanChoice::Placing::flat);
        outlook_.learn_builder(index_of(careful), index_of(flat),
                               compared(pilot, careful, flat, rays_of_pairs));
        spend(cost);
        if (counts_.placements <= 1 || cost > most_of_pilots * outlook_.allowed()) return;
        const PlanChoice nested = plan_choice(quickest(), PlanChoice::Placing::nested);
        outlook_.learn_placing(compared(pilot, nested, flat, rays_of_pairs));
        spend(cost);
    }

    size_t index_of(const PlanChoice& choice) const {
        const std::vector<Candidate>& all = outlook_.candidates();
        return size_t(
            std::find_if(all.begin(), all.end(),
                         [&](const Candidate& c) { return c.choice.name == choice.name; }) -
            all.begin());
    }

    static constexpr size_t looked_at = 16;  ///< shapes, for each of a thinned scene
    static constexpr size_t rays_of_pairs = 1024;
    static constexpr double most_of_pilots = 0.5;  ///< of what is allowed, for the next of them

    /// Seconds to thin the scene to so many: for each that is looked at, for nodes, and for all
    /// that is not in the caches then.
    double thinning_s(double shapes) const {
        return 35e-9 * std::min(counts_.unique(), double(looked_at) * shapes) + 1e-4;
    }

    /// Seconds to build the quickest structure over a thinned scene, cold, and to trace rays.
    double pilot_s(double shapes, size_t rays, double ns_per_ray) const {
        constexpr double cold = 3.2, placement = 1e-6;
        const double placed = shapes * counts_.placed() / counts_.unique();
        const CostEstimate e = estimate(quickest(), placed, counts_.kinds.front().name,
                                        options_.objective, calibration_);
        return cold * (e.build_s + 1e-9 * double(rays) * ns_per_ray) +
               placement * counts_.placements + 1e-4;
    }

    /// What the outlook would build next, after this has been seen on a thinned scene if that is
    /// much cheaper: how much better a dear build is differs from scene to scene.
    size_t next_after_pilots() {
        constexpr double most_of_build = 0.2;
        constexpr size_t rays = 2048;
        while (true) {
            const size_t next = outlook_.next(held_);
            if (next == outlook_.size() || outlook_.piloted(next)) return next;
            const double all = counts_.unique(), shapes = std::min(2048.0, all / 8),
                         share = shapes / all;
            const CostEstimate &e = outlook_[next], &h = outlook_[held_];
            const double cost =
                dear_pilot_cold_ *
                (share * (e.build_s + h.build_s) + (dear_pilot_ ? 0 : thinning_s(shapes)) +
                 1e-9 * double(rays) * (e.ns_per_ray + h.ns_per_ray));
            if (shapes < 128 || cost > most_of_build * e.build_s || cost > outlook_.allowed())
                return next;
            if (!dear_pilot_) dear_pilot_.emplace(scene_, counts_, shapes, looked_at);
            const double ratio = compared(*dear_pilot_, outlook_.candidates()[next].choice,
                                          outlook_.candidates()[held_].choice, rays);
            outlook_.learn_from_pilots(next, held_, ratio);
            const double before = outlook_.spent();
            spend(cost);
            dear_pilot_cold_ *= std::clamp((outlook_.spent() - before) / cost, 0.5, 2.0);
        }
    }

    /// See Pilot::ratio.
    double compared(Pilot& pilot, const PlanChoice& choice, const PlanChoice& other,
                    size_t rays) const {
        const std::vector<Ray> some = some_of(sample_.rays, rays);
        return pilot.ratio(choice, other, {some, sample_.any, sample_.mode}, options_,
                           calibration_);
    }

    /// Builds candidate i, looks at it, and keeps the better of it and what was held.
    void try_out(size_t i) {
        const StructureChoice& structure = outlook_.candidates()[i].choice.structure;
        Assembly assembly = assemble(scene_, plan_of(outlook_.candidates()[i].choice));
        CostEstimate seen = outlook_[i];
        if (!is_lazy(structure)) {
            if (options_.clock) seen.build_s = assembly.build_s;
            if (options_.objective.memory > 0)
                seen.bytes = double(total_statistics(*assembly.root).bytes);
        }
        constexpr size_t least_rays = 64;
        const double both_ns = seen.ns_per_ray + (held_is_timed_ ? outlook_[held_].ns_per_ray : 0);
        size_t rays = is_lazy(structure) ? 0 : outlook_.trial_rays(both_ns);
        if (rays < least_rays || !matters(i, seen.build_s)) rays = 0;
        if (rays > 0) {
            const std::vector<Ray> some = some_of(sample_.rays, rays);
            const RaySample part{some, sample_.any, sample_.mode};
            seen.ns_per_ray = tried_ns(*assembly.root, structure, part);
        }
        outlook_.learn(i, seen, rays);
        const double lost_s = keep(i, std::move(assembly), rays > 0);
        spend(lost_s + 1e-9 * seen.ns_per_ray * double(rays));
    }

    /// Whether it is worth knowing how dear rays are in candidate i, which is built: not if it can
    /// be neither dropped for another, since that would cost more than choosing may, nor is another
    /// held.
    bool matters(size_t i, double build_s) const {
        return holds_one_ || !outlook_[i].fits || build_s <= outlook_.allowed();
    }

    /// Nanoseconds per ray of what was built, beside what is held if that was timed, too.
    double tried_ns(const Primitive& root, const StructureChoice& structure,
                    const RaySample& some) {
        if (!options_.clock) return counted_ns(root, structure, counts_, some, calibration_);
        if (!held_is_timed_) return observed_ns(root, some);
        return outlook_[held_].ns_per_ray * time_ratio(root, *out_.assembly.root, some);
    }

    /// @return  seconds of a build that is lost
    double keep(size_t i, Assembly assembly, bool timed) {
        const bool better =
            outlook_[i].fits && (!holds_one_ || tried_score(i) < tried_score(held_));
        const double lost_s = holds_one_ || !better ? outlook_[better ? held_ : i].build_s : 0;
        if (better) {
            out_.assembly = std::move(assembly);
            held_ = i;
            holds_one_ = true;
            held_is_timed_ = timed;
        }
        return lost_s;
    }

    /// The build is spent by now, whichever is kept.
    double tried_score(size_t i) const {
        return options_.objective.priority == Priority::build ? outlook_[i].build_s
                                                              : outlook_[i].ns_per_ray;
    }

    void finish() {
        const PlanChoice& chosen = outlook_.candidates()[held_].choice;
        const auto tried = std::count_if(outlook_.candidates().begin(), outlook_.candidates().end(),
                                         [](const Candidate& c) { return c.tried.has_value(); });
        out_.reason = fmt::format(
            "{}: of {} candidates {} built and looked at; another build would not pay within "
            "{:.0f} % of the total",
            chosen.name, outlook_.size(), tried, 100 * options_.share);
        out_.chosen = held_;
        out_.candidates = std::move(outlook_).sorted(out_.chosen);
        out_.expected_ns = expected_ns(out_, counts_, sample_, calibration_);
    }

    Clock::time_point start_;  ///< of all that choosing takes
    const Scene& scene_;
    const AutoOptions& options_;
    const RaySample& sample_;
    const Calibration& calibration_;
    SceneCounts counts_;
    Outlook outlook_;
    Selection out_;
    std::optional<Pilot> dear_pilot_;  ///< for what is not built lightly
    /// Its time over what warm builds of large scenes say: nothing is in the caches, and every
    /// object has its share.
    double dear_pilot_cold_ = 3.5;
    size_t held_ = 0;  ///< whose assembly is kept
    bool holds_one_ = false, held_is_timed_ = false;
};

std::string estimate_text(const CostEstimate& e) {
    return fmt::format("{:>9.4f} {:>9.3f} {:>8.1f} {:>10.4f}", e.build_s, e.bytes / 1e6,
                       e.ns_per_ray, e.total_s);
}

}  // namespace

Selection choose_assembly(const Scene& scene, const AutoOptions& given, const RaySample& sample,
                          const Calibration& calibration) {
    const auto start = Clock::now();
    AutoOptions options = given;
    options.objective.coherence = coherence_of(sample.rays);
    SceneCounts counts = count_shapes(scene);
    if (const PlanChoice* quick = quick_choice(counts, options, calibration))
        return quick_selection(scene, *quick, counts, options, sample, calibration, start);
    if (counts.largest) counts.order = order_cost(scene.geometries[*counts.largest]);
    counts.weight = test_weight(scene, counts.main_kind());
    return Chooser(scene, options, sample, calibration, std::move(counts), start).run();
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
        if (lines++ >= limit && i != selection.chosen && !c.tried) continue;
        if (!std::isfinite(c.known().total_s)) continue;
        const std::string mark = i == selection.chosen ? "*" : c.known().fits ? " " : "-";
        text += fmt::format("{} {:32} {}   {}\n", mark, c.choice.name, estimate_text(c.predicted),
                            c.basis);
        if (c.tried) text += fmt::format("  {:32} {}   built\n", "", estimate_text(*c.tried));
    }
    return text;
}

}  // namespace crofton
