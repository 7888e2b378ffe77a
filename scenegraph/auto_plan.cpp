#include "scenegraph/auto_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

namespace crofton {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

std::vector<Candidate> candidates_for(const SceneCounts& counts, const AutoOptions& options,
                                      const Calibration& calibration) {
    std::vector<Candidate> out;
    for (PlanChoice& choice : plan_choices(counts, options)) {
        Candidate& c = out.emplace_back();
        c.predicted = estimate(choice, counts, options, calibration);
        c.choice = std::move(choice);
    }
    return out;
}

const StructureChoice& quickest() {
    for (const StructureChoice& s : structure_choices())
        if (s.name == "wide_bvh/lbvh") return s;
    return structure_choices().front();
}

/// The search of choose_assembly: builds and looks, as the outlook says.
class Chooser {
  public:
    Chooser(const Scene& scene, const AutoOptions& options, const RaySample& sample,
            const Calibration& calibration)
        : scene_(scene),
          options_(options),
          sample_(sample),
          calibration_(calibration),
          counts_(count_shapes(scene)),
          outlook_(candidates_for(counts_, options, calibration), options, sample.rays.size()) {}

    /// @param start  of all that choosing takes
    Selection run(Clock::time_point start) {
        outlook_.best();  // refuses where nothing fits
        pilot();
        for (size_t next = outlook_.first(); next != outlook_.size();) {
            try_out(next);
            // What was built does not fit: the next best, if there is one.
            next = holds_one_ ? next_after_pilots() : outlook_.best();
        }
        out_.choose_s = seconds_since(start) - out_.assembly.build_s;
        finish();
        return std::move(out_);
    }

  private:
    /// Scales every estimate to this scene by what a thinned one shows, if that is cheap enough.
    void pilot() {
        constexpr double shapes = 1024, per_shape_s = 12e-9;
        constexpr size_t rays = 256;
        const double all = counts_.kinds.empty() ? 0 : counts_.kinds.front().unique;
        if (sample_.rays.empty() || all < 4 * shapes) return;
        const CostEstimate cheap = estimate(quickest(), shapes, counts_.kinds.front().name,
                                            options_.objective, calibration_);
        const double ns = outlook_[outlook_.best()].ns_per_ray;
        const double cost = all * per_shape_s + cheap.build_s + 1e-9 * double(rays) * ns;
        if (cost > 0.3 * outlook_.allowed()) return;
        outlook_.spend(cost);
        const std::vector<Ray> some = some_of(sample_.rays, rays);
        const Pilot pilot(scene_, counts_, shapes);
        const PlanChoice choice = plan_choice(quickest(), PlanChoice::Placing::flat);
        const CostEstimate seen = pilot.estimate(
            choice, plan_of(choice), {some, sample_.any, sample_.mode}, options_, calibration_);
        const CostEstimate counted = estimate(choice, counts_, options_, calibration_);
        outlook_.learn_from_pilot(seen.ns_per_ray / counted.ns_per_ray);
    }

    /// What the outlook would build next, after this has been seen on a thinned scene if that is
    /// much cheaper: how much better a dear build is differs from scene to scene.
    size_t next_after_pilots() {
        constexpr double most_of_build = 0.2, per_shape_s = 12e-9;
        constexpr size_t rays = 2048;
        while (true) {
            const size_t next = outlook_.next(held_);
            if (next == outlook_.size() || outlook_.piloted(next)) return next;
            const double all = counts_.kinds.front().unique, shapes = std::min(2048.0, all / 8),
                         share = shapes / all;
            const CostEstimate &e = outlook_[next], &h = outlook_[held_];
            const double cost = share * (e.build_s + h.build_s) + (all * per_shape_s) +
                                1e-9 * double(rays) * (e.ns_per_ray + h.ns_per_ray);
            if (shapes < 128 || cost > most_of_build * e.build_s || cost > outlook_.allowed())
                return next;
            outlook_.spend(cost);
            if (!dear_pilot_) dear_pilot_.emplace(scene_, counts_, shapes);
            const double a = piloted_ns(next, rays), b = piloted_ns(held_, rays);
            outlook_.learn_from_pilots(next, held_, a / b);
        }
    }

    double piloted_ns(size_t i, size_t rays) const {
        const PlanChoice& choice = outlook_.candidates()[i].choice;
        const std::vector<Ray> some = some_of(sample_.rays, rays);
        return dear_pilot_
            ->estimate(choice, plan_of(choice), {some, sample_.any, sample_.mode}, options_,
                       calibration_)
            .ns_per_ray;
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
        size_t rays = is_lazy(structure) ? 0 : outlook_.trial_rays(seen);
        if (rays < least_rays) rays = 0;
        if (rays > 0) {
            const std::vector<Ray> some = some_of(sample_.rays, rays);
            const RaySample part{some, sample_.any, sample_.mode};
            seen.ns_per_ray =
                options_.clock ? observed_ns(*assembly.root, part)
                               : counted_ns(*assembly.root, structure, counts_, part, calibration_);
            outlook_.spend(1e-9 * seen.ns_per_ray * double(rays));
        }
        outlook_.learn(i, seen, rays);
        keep(i, std::move(assembly));
    }

    void keep(size_t i, Assembly assembly) {
        const bool better =
            outlook_[i].fits && (!holds_one_ || tried_score(i) < tried_score(held_));
        if (holds_one_ || !better) outlook_.spend(outlook_[better ? held_ : i].build_s);
        if (!better) return;
        out_.assembly = std::move(assembly);
        held_ = i;
        holds_one_ = true;
    }

    /// The build is spent by now, whichever is kept.
    double tried_score(size_t i) const {
        return options_.objective.priority == Priority::build ? outlook_[i].build_s
                                                              : outlook_[i].ns_per_ray;
    }

    void finish() {
        const PlanChoice& chosen = outlook_.candidates()[held_].choice;
        if (!sample_.rays.empty()) {
            const std::vector<Ray> some = some_of(sample_.rays, 512);
            counts_.weight = test_weight(scene_, counts_.main_kind());
            out_.expected_ns = counted_ns(*out_.assembly.root, chosen.structure, counts_,
                                          {some, sample_.any, sample_.mode}, calibration_);
        }
        const auto tried = std::count_if(outlook_.candidates().begin(), outlook_.candidates().end(),
                                         [](const Candidate& c) { return c.tried.has_value(); });
        out_.reason = fmt::format(
            "{}: of {} candidates {} built and looked at; another build would not pay within "
            "{:.0f} % of the total",
            chosen.name, outlook_.size(), tried, 100 * options_.share);
        out_.chosen = held_;
        out_.candidates = std::move(outlook_).sorted(out_.chosen);
    }

    const Scene& scene_;
    const AutoOptions& options_;
    const RaySample& sample_;
    const Calibration& calibration_;
    SceneCounts counts_;
    Outlook outlook_;
    Selection out_;
    std::optional<Pilot> dear_pilot_;  ///< for what is not built lightly
    size_t held_ = 0;                  ///< whose assembly is kept
    bool holds_one_ = false;
};

std::string estimate_text(const CostEstimate& e) {
    return fmt::format("{:>9.4f} {:>9.3f} {:>8.1f} {:>10.4f}", e.build_s, e.bytes / 1e6,
                       e.ns_per_ray, e.total_s);
}

}  // namespace

Selection choose_assembly(const Scene& scene, const AutoOptions& options, const RaySample& sample,
                          const Calibration& calibration) {
    const auto start = Clock::now();
    return Chooser(scene, options, sample, calibration).run(start);
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
