#include "scenegraph/outlook.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace crofton {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Standard deviation of one ray's time over its mean.
constexpr double ray_deviation = 0.8;

/// Standard deviation of ln(ratio) where two structures of a thinned scene were compared.
constexpr double piloted_spread = 0.12;

/// The standard normal distribution's share below x.
double normal_share(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

/// Expected value of max(0, known - x) where ln x is normal about ln(mean) with this deviation.
double expected_gain(double known, double mean, double deviation) {
    if (deviation <= 0) return std::max(0.0, known - mean);
    const double d = std::log(known / mean) / deviation;
    return known * normal_share(d) -
           mean * std::exp(deviation * deviation / 2) * normal_share(d - deviation);
}

}  // namespace

Outlook::Outlook(std::vector<Candidate> candidates, const AutoOptions& options, size_t sample_size)
    : candidates_(std::move(candidates)),
      options_(options),
      piloted_(candidates_.size()),
      sample_size_(sample_size) {
    for (const Candidate& c : candidates_) now_.push_back(c.predicted);
}

/// Rays cost so many times what was expected of one structure. How much of that is due to the
/// scene, and so holds for all that is not tried yet, follows from what is known of both
/// deviations.
/// @param spread  standard deviation of ln(factor) for this structure, in one scene
void Outlook::scale(double factor, double spread) {
    if (!std::isfinite(factor) || factor <= 0) return;
    const double own = std::max(spread * spread, 1e-4);
    const double common = std::pow(factor, scene_variance_ / (scene_variance_ + own));
    scene_variance_ *= own / (scene_variance_ + own);
    for (size_t i = 0; i < size(); ++i) {
        if (candidates_[i].tried || !std::isfinite(now_[i].total_s)) continue;
        now_[i].ns_per_ray *= common;
        set_total(now_[i], options_.objective);
    }
}

void Outlook::learn_from_pilot(double factor) {
    constexpr double thinning_spread = 0.35;
    scale(factor, thinning_spread);
    for (size_t i = 0; i < size(); ++i) {
        candidates_[i].predicted = now_[i];
        candidates_[i].basis = "pilot";
    }
}

void Outlook::learn_placing(double ratio) {
    if (!std::isfinite(ratio) || ratio <= 0) return;
    constexpr double spread = placing_spread_thinned;
    placing_spread_ = spread;
    for (size_t i = 0; i < size(); ++i) {
        const PlanChoice& choice = candidates_[i].choice;
        if (choice.placing == PlanChoice::Placing::flat) continue;
        now_[i].ns_per_ray *= nested_factor(choice.structure, ratio) /
                              nested_factor(choice.structure, options_.objective.coherence);
        now_[i].ray_spread = std::sqrt(std::max(0.0, now_[i].ray_spread * now_[i].ray_spread -
                                                         placing_spread * placing_spread) +
                                       spread * spread);
        set_total(now_[i], options_.objective);
        candidates_[i].predicted = now_[i];
    }
}

void Outlook::learn_builder(size_t i, size_t quickest, double ratio) {
    if (!std::isfinite(ratio) || ratio <= 0) return;
    // Few shapes show less of it than many: seen over the models that nested_factor is from.
    constexpr double power = 0.8, without_loss = 0.91;
    const double expected = now_[i].ns_per_ray / now_[quickest].ns_per_ray;
    const double factor = without_loss * std::pow(ratio, power) / expected;
    for (size_t k = 0; k < size(); ++k) {
        if (k == i || is_blind(candidates_[k].choice.structure)) continue;
        now_[k].ns_per_ray *= factor;
        set_total(now_[k], options_.objective);
        candidates_[k].predicted = now_[k];
    }
    learn_from_pilots(i, quickest, expected * factor);
}

void Outlook::learn_from_pilots(size_t i, size_t other, double ratio) {
    piloted_[i] = true;
    if (!std::isfinite(ratio) || ratio <= 0) return;
    now_[i].ns_per_ray = now_[other].ns_per_ray * ratio;
    now_[i].ray_spread = piloted_spread;
    set_total(now_[i], options_.objective);
    candidates_[i].predicted = now_[i];
    candidates_[i].basis = "pilot";
}

void Outlook::learn(size_t i, const CostEstimate& seen, size_t rays) {
    const double factor = seen.ns_per_ray / now_[i].ns_per_ray, spread = spread_of(i);
    now_[i] = seen;
    if (rays > 0) now_[i].ray_spread = ray_deviation / std::sqrt(double(rays));
    set_total(now_[i], options_.objective);
    candidates_[i].tried = now_[i];
    if (rays > 0) scale(factor, spread);
}

/// Few scenes were calibrated with, so that what they say of spreads is no more than a start; and
/// how good an order is, a sample hardly says.
double Outlook::spread_of(size_t i) const {
    const double least = uses_order(candidates_[i].choice.structure) ? order_spread : 0.1;
    return std::max(least, now_[i].ray_spread);
}

size_t Outlook::trial_rays(double ns_per_ray) const {
    // Each ray is traced once.
    constexpr double share = 0.003, most = 16384;
    const double rays = share * total() / (1e-9 * std::max(ns_per_ray, 1.0));
    return size_t(std::min({rays, most, double(sample_size_)}));
}

size_t Outlook::first() const {
    const size_t best = this->best();
    if (options_.objective.priority != Priority::total || sample_size_ == 0) return best;
    constexpr double as_good = 1.3;  // if nothing better fits, it is what is kept
    constexpr double part = 0.25;    // there is to be room for more
    const double most = part * allowed();
    size_t stone = best;
    double least = infinity;
    for (size_t i = 0; i < size(); ++i) {
        const CostEstimate& e = now_[i];
        const StructureChoice& s = candidates_[i].choice.structure;
        // An order's rays say little of those of other structures.
        if (!e.fits || is_lazy(s) || uses_order(s) || e.total_s > as_good * now_[best].total_s)
            continue;
        if (e.build_s + trial_s(e.ns_per_ray) <= most && e.total_s < least)
            least = e.total_s, stone = i;
    }
    return stone;
}

/// Of ln(ns per ray of candidate i over that of what is held).
double Outlook::deviation(size_t i, size_t held) const {
    const PlanChoice &a = candidates_[i].choice, &b = candidates_[held].choice;
    // How much worse an order is than a tree is not known, but it is never much better.
    if (uses_order(a.structure)) return 1e-3;
    // What a builder gains over another that looks at areas, too, differs little from model to
    // model (see auto_select.md).
    const bool one_type = a.structure.type == b.structure.type;
    const bool alike =
        one_type && a.placing == b.placing && !is_blind(a.structure) && !is_blind(b.structure);
    const double least = piloted_[i] ? piloted_spread : alike ? 0.08 : one_type ? 0.12 : 0.18;
    // What is not known of the scene is between a structure that was tried and those that were not.
    const double scene = piloted_[i] || alike ? 0 : std::sqrt(scene_variance_);
    const double own = std::hypot(std::max(least, now_[i].ray_spread), scene);
    // How nesting compares is in the spread of what is nested, and unknown likewise of what is
    // flat, once something nested has been tried.
    const double nesting =
        a.placing == PlanChoice::Placing::flat && b.placing != a.placing ? placing_spread_ : 0;
    return std::hypot(own, now_[held].ray_spread, nesting);
}

/// Expected seconds saved by building candidate i, too, less what that costs.
double Outlook::gain(size_t i, size_t held) const {
    const CostEstimate& e = now_[i];
    const Objective& objective = options_.objective;
    if (!e.fits || !std::isfinite(e.total_s)) return -infinity;
    const double saved = objective.rays * 1e-9 *
                         expected_gain(now_[held].ns_per_ray, e.ns_per_ray, deviation(i, held));
    const double build = objective.priority == Priority::trace ? 0 : e.build_s;
    return saved - build - trial_s(i, held);
}

/// Whether a careful build is compared with a blind one of the same structure: it is never worse.
bool Outlook::is_same_but_careful(size_t i, size_t held) const {
    const PlanChoice &a = candidates_[i].choice, &b = candidates_[held].choice;
    return a.structure.type == b.structure.type && a.placing == b.placing &&
           !is_blind(a.structure) && is_blind(b.structure);
}

/// Whether the time for choosing allows to build candidate i, too: of the two builds, the one that
/// is not used in the end is lost. That is what is held, as likely as candidate i is better.
bool Outlook::affordable(size_t i, size_t held) const {
    const double better = std::log(now_[held].ns_per_ray / now_[i].ns_per_ray);
    const double likely =
        is_same_but_careful(i, held) ? 1 : normal_share(better / deviation(i, held));
    const double lost = likely * now_[held].build_s + (1 - likely) * now_[i].build_s;
    return lost + trial_s(i, held) <= allowed();
}

size_t Outlook::next(size_t held) const {
    size_t best = size();
    if (sample_size_ == 0 || options_.objective.priority == Priority::build) return best;
    double most = 0;
    for (size_t i = 0; i < size(); ++i) {
        if (candidates_[i].tried || is_lazy(candidates_[i].choice.structure)) continue;
        if (const double g = gain(i, held); g > most && affordable(i, held)) most = g, best = i;
    }
    return best;
}

std::vector<Candidate> Outlook::sorted(size_t& i) && {
    std::vector<size_t> order(size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](size_t a, size_t b) { return now_[a].total_s < now_[b].total_s; });
    std::vector<Candidate> out;
    size_t found = 0;
    for (const size_t k : order) {
        if (k == i) found = out.size();
        out.push_back(std::move(candidates_[k]));
    }
    i = found;
    return out;
}

}  // namespace crofton
