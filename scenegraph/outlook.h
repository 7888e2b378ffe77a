#pragma once

#include <optional>
#include <string>
#include <vector>

#include "scenegraph/plan_estimate.h"

namespace crofton {

/// What is known about one candidate.
struct Candidate {
    PlanChoice choice;
    CostEstimate predicted;             ///< before its build
    std::string basis = "counts";       ///< of the prediction: "counts" or "pilot"
    std::optional<CostEstimate> tried;  ///< from its own structure, once built
    const CostEstimate& known() const { return tried ? *tried : predicted; }
};

/// What is known of all candidates, what one that is looked at says of the others, and what it
/// would be worth to build another. Nothing here is built or timed.
class Outlook {
  public:
    /// @param sample_size  rays that there are to try
    Outlook(std::vector<Candidate> candidates, const AutoOptions& options, size_t sample_size);

    const std::vector<Candidate>& candidates() const { return candidates_; }
    const CostEstimate& operator[](size_t i) const { return now_[i]; }
    size_t size() const { return now_.size(); }
    /// @throws InputError  nothing fits into the memory
    size_t best() const { return best_of(now_, options_.objective); }
    /// Seconds that are expected of the best.
    double total() const { return now_[best()].total_s; }
    /// Seconds that choosing may still take. The total is an estimate; a part is kept back for
    /// that.
    double allowed() const { return kept_within * options_.share * total() - spent_; }
    double spent() const { return spent_; }
    /// Seconds that choosing has taken so far.
    void set_spent(double seconds) { spent_ = seconds; }

    /// A thinned scene showed this factor on what counts say of ns per ray.
    void learn_from_pilot(double factor);
    /// A thinned scene showed that rays take so many times as long where objects are nested as in
    /// one structure for all.
    void learn_placing(double ratio);
    /// A thinned scene showed this for candidate i, a default build, and the quickest one. How much
    /// is lost there by a build that is blind (see is_blind), as where shapes are of all sizes, is
    /// about the same for all.
    void learn_builder(size_t i, size_t quickest, double ratio);
    /// A thinned scene showed that candidate i's rays take so many times as long as those of
    /// candidate `other`.
    void learn_from_pilots(size_t i, size_t other, double ratio);
    bool piloted(size_t i) const { return piloted_[i]; }
    /// Candidate i was built. @param seen  its costs  @param rays  that were timed; 0: none
    void learn(size_t i, const CostEstimate& seen, size_t rays);

    /// Rays to try a structure on that takes so long: a small share of the total.
    size_t trial_rays(double ns_per_ray) const;
    double trial_s(double ns_per_ray) const {
        return 1e-9 * ns_per_ray * double(trial_rays(ns_per_ray));
    }
    /// What to build first: the best estimate; or, if one that is built in no time would teach how
    /// dear rays are here before that, this one.
    size_t first() const;
    /// What to build beside what is held; size() if nothing would pay.
    size_t next(size_t held) const;

    /// Candidates by expected total, best first. @param i  becomes its index among these
    std::vector<Candidate> sorted(size_t& i) &&;

  private:
    static constexpr double kept_within = 0.8;  ///< of the share, for totals that come out smaller

    double spread_of(size_t i) const;
    double deviation(size_t i, size_t held) const;
    double gain(size_t i, size_t held) const;
    double trial_s(size_t i, size_t held) const {
        return trial_s(now_[i].ns_per_ray + now_[held].ns_per_ray);
    }
    bool is_same_but_careful(size_t i, size_t held) const;
    bool affordable(size_t i, size_t held) const;
    void scale(double factor, double spread);

    std::vector<Candidate> candidates_;
    std::vector<CostEstimate> now_;  ///< of each candidate, with all that is known
    const AutoOptions& options_;
    std::vector<bool> piloted_;  ///< beside another one
    size_t sample_size_;
    double scene_variance_ = 0.6;  ///< of ln(ns per ray), common to all structures
    double placing_spread_ = placing_spread;
    double spent_ = 0;  ///< seconds of choosing so far
};

}  // namespace crofton
