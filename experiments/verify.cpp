#include "experiments/verify.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <mutex>

#include "experiments/catalogue/recipes.h"
#include "experiments/catalogue/scenes.h"
#include "experiments/plan.h"
#include "experiments/scene_source.h"
#include "framework/error.h"
#include "framework/parallel.h"
#include "framework/registry.h"
#include "scenegraph/exact_scene.h"

namespace crofton {
namespace {

using exact::Judgement;

/// More shapes than this are too many for a ray that tests all of them, unless asked for.
constexpr size_t brute_force_limit = 20000;
constexpr size_t chunk_size = 256;
const std::string catalogue_prefix = "catalogue:";

std::vector<std::string> checked_accelerators(const std::vector<std::string>& names) {
    for (const std::string& name : names) accelerator(name);
    return names.empty() ? accelerator_names() : names;
}

std::vector<Recipe> checked_recipes(const std::vector<std::string>& wanted) {
    if (wanted.empty()) return recipes();
    std::vector<std::string> names;
    for (const Recipe& r : recipes()) names.push_back(r.name);
    std::vector<Recipe> found;
    for (const std::string& name : wanted) {
        const auto it = std::find(names.begin(), names.end(), name);
        if (it == names.end()) throw InputError(unknown_name("recipe", name, names));
        found.push_back(recipes()[size_t(it - names.begin())]);
    }
    return found;
}

/// A scene in every accelerator, with its oracle.
struct Bench {
    std::string name;
    exact::Oracle oracle;
    std::vector<std::string> accelerators;
    std::vector<Assembly> assemblies;
    Mode mode;

    Bench(std::string scene_name, const Scene& scene, std::vector<std::string> names, Mode m)
        : name(std::move(scene_name)),
          oracle(make_oracle(
              scene, m == Mode::exact ? PlacementTruth::as_placed : PlacementTruth::composed)),
          accelerators(std::move(names)),
          mode(m) {
        for (const std::string& a : accelerators) {
            AssemblyPlan plan = uniform_plan(a);
            plan.bake = false;  // instances are what is hard
            assemblies.push_back(assemble(scene, plan));
        }
    }
};

/// What one ray did in all accelerators.
class RayCheck {
  public:
    RayCheck(const Bench& bench, const AimedRay& aimed) : bench_(bench), aimed_(aimed) {
        truth_ = bench.oracle.closest(aimed.ray);
    }

    /// Adds to the tallies, and to `failing` where there is a fault.
    void run(const std::string& recipe, std::vector<VerifyTally>& tallies,
             std::vector<FailingRay>& failing) {
        Hit first;
        for (size_t a = 0; a < bench_.accelerators.size(); ++a) {
            const Primitive& root = *bench_.assemblies[a].root;
            const Hit hit = root.intersect(aimed_.ray, bench_.mode);
            const bool occluded = root.occluded(aimed_.ray, bench_.mode);
            VerifyTally tally;
            tally.rays = 1;
            tally.hits = hit.is_hit();
            tally.leaks = aimed_.must_hit && (!hit.is_hit() || !occluded);
            if (a == 0) first = hit;
            tally.disagreements = bench_.mode != Mode::fast && !(hit == first);
            const Judgement closest = judge(hit);
            const Judgement any = bench_.oracle.judge(aimed_.ray, occluded, truth_);
            tally.add(closest);
            tally.add(any);
            const bool right = closest.kind == Judgement::Kind::right && hit.is_hit();
            if (right) tally.t_ulp.add(closest.t_ulp);
            tallies[a] += tally;
            if (tally.faults() == 0) continue;
            const char* kind = tally.leaks          ? "leak"
                               : closest.is_fault() ? to_string(closest.kind)
                               : any.is_fault()     ? to_string(any.kind)
                                                    : "disagreement";
            failing.push_back({bench_.name, recipe, bench_.accelerators[a], kind, aimed_.ray,
                               aimed_.must_hit, bench_.mode});
        }
    }

  private:
    /// Most accelerators give one and the same hit, which is judged once.
    Judgement judge(const Hit& hit) {
        if (!judged_ || !(hit == judged_hit_)) {
            judged_ = bench_.oracle.judge(aimed_.ray, hit, truth_, bench_.mode);
            judged_hit_ = hit;
        }
        return *judged_;
    }

    const Bench& bench_;
    const AimedRay& aimed_;
    exact::Answer truth_;
    std::optional<Judgement> judged_;
    Hit judged_hit_;
};

/// Spreads a seed, so that neighbours share nothing (SplitMix64; Steele, Lea, Flood 2014).
uint64_t mix(uint64_t x) {
    x += 0x9e3779b97f4a7c15;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
    x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
    return x ^ (x >> 31);
}

class Verification {
  public:
    explicit Verification(VerifyReport& report) : report_(report) {}

    void run(const Bench& bench, const AimPoints& aim, const Recipe& recipe, uint64_t rays,
             uint64_t seed) {
        begin(bench, recipe.name);
        const size_t chunks = (rays + chunk_size - 1) / chunk_size;
        parallel_for(chunks, 1, [&](size_t begin, size_t end) {
            for (size_t c = begin; c < end; ++c) {
                // A chunk's rays depend on its number only, not on the thread.
                Pcg32 rng(mix(seed + c));
                std::vector<AimedRay> batch;
                const uint64_t left = rays - c * chunk_size;
                for (size_t i = 0; i < std::min<uint64_t>(chunk_size, left); ++i)
                    batch.push_back(recipe.make(aim, bench.oracle, rng));
                check(bench, recipe.name, batch);
            }
        });
    }

    void begin(const Bench& bench, const std::string& recipe) {
        report_.cases.push_back({bench.name, recipe, bench.accelerators,
                                 std::vector<VerifyTally>(bench.accelerators.size())});
    }

    void check(const Bench& bench, const std::string& recipe, const std::vector<AimedRay>& rays) {
        std::vector<VerifyTally> tallies(bench.accelerators.size());
        std::vector<FailingRay> failing;
        for (const AimedRay& ray : rays) RayCheck(bench, ray).run(recipe, tallies, failing);
        const std::lock_guard lock(mutex_);
        report_.rays += rays.size();
        VerifyCase& row = report_.cases.back();
        for (size_t a = 0; a < tallies.size(); ++a) row.tallies[a] += tallies[a];
        for (FailingRay& f : failing)
            if (report_.failing.size() < VerifyReport::most_failing)
                report_.failing.push_back(std::move(f));
    }

  private:
    VerifyReport& report_;
    std::mutex mutex_;
};

std::vector<std::string> scene_names(const VerifyOptions& options) {
    if (!options.scene.empty()) return {options.scene};
    std::vector<std::string> names;
    for (const CatalogueScene& c : catalogue_scenes()) names.push_back(catalogue_prefix + c.name);
    return names;
}

}  // namespace

Scene verify_scene(const std::string& name) {
    if (name.starts_with(catalogue_prefix))
        return catalogue_scene(name.substr(catalogue_prefix.size()));
    SceneSpec spec;
    spec.base = scene_source(name);
    return make_scene(spec);
}

void UlpCounts::add(double ulps) {
    largest_ = std::max(largest_, ulps);
    ulps = std::ceil(ulps);
    if (ulps < double(exact_.size()))
        ++exact_[size_t(ulps)];
    else
        ++beyond_[std::min(beyond_.size() - 1, size_t(std::ceil(std::log2(ulps))))];
}

UlpCounts& UlpCounts::operator+=(const UlpCounts& o) {
    for (size_t i = 0; i < exact_.size(); ++i) exact_[i] += o.exact_[i];
    for (size_t i = 0; i < beyond_.size(); ++i) beyond_[i] += o.beyond_[i];
    largest_ = std::max(largest_, o.largest_);
    return *this;
}

double UlpCounts::quantile(double share) const {
    uint64_t total = 0, seen = 0;
    for (uint64_t n : exact_) total += n;
    for (uint64_t n : beyond_) total += n;
    const uint64_t wanted = uint64_t(std::ceil(share * double(total)));
    if (total == 0) return 0;
    for (size_t i = 0; i < exact_.size(); ++i)
        if ((seen += exact_[i]) >= wanted) return double(i);
    for (size_t i = 0; i < beyond_.size(); ++i)
        if ((seen += beyond_[i]) >= wanted) return std::min(std::ldexp(1.0, int(i)), largest_);
    return largest_;
}

void VerifyTally::add(const Judgement& j) {
    const auto count = [&](Split& split) { ++(j.inside_margin ? split.inside : split.outside); };
    switch (j.kind) {
        case Judgement::Kind::right:
            break;
        case Judgement::Kind::false_miss:
            count(false_misses);
            break;
        case Judgement::Kind::false_hit:
            count(false_hits);
            break;
        case Judgement::Kind::wrong_primitive:
            count(wrong_primitives);
            break;
        case Judgement::Kind::wrong_t:
            count(wrong_t);
            break;
    }
}

VerifyTally& VerifyTally::operator+=(const VerifyTally& o) {
    const auto add_split = [](Split& a, const Split& b) {
        a.inside += b.inside;
        a.outside += b.outside;
    };
    rays += o.rays, hits += o.hits, leaks += o.leaks, disagreements += o.disagreements;
    add_split(false_misses, o.false_misses);
    add_split(false_hits, o.false_hits);
    add_split(wrong_primitives, o.wrong_primitives);
    add_split(wrong_t, o.wrong_t);
    t_ulp += o.t_ulp;
    return *this;
}

uint64_t VerifyReport::faults() const {
    uint64_t sum = 0;
    for (const VerifyCase& c : cases)
        for (const VerifyTally& t : c.tallies) sum += t.faults();
    return sum;
}

VerifyReport verify(const VerifyOptions& options, Progress& progress) {
    VerifyReport report;
    const std::vector<std::string> accelerators = checked_accelerators(options.accelerators);
    const std::vector<Recipe> used_recipes = checked_recipes(options.recipes);
    const std::vector<std::string> names = scene_names(options);
    progress.set_total(names.size());
    Verification verification(report);
    for (size_t s = 0; s < names.size(); ++s) {
        progress.step("verifying " + names[s]);
        const Scene scene = verify_scene(names[s]);
        std::vector<std::string> used = accelerators;
        const SceneStatistics statistics = crofton::statistics(scene);
        if (options.accelerators.empty() && statistics.shapes_instanced > brute_force_limit) {
            std::erase(used, "brute_force");
            report.notes.push_back(fmt::format("{}: brute_force left out of a scene of {} shapes",
                                               names[s], statistics.shapes_instanced));
        }
        const Bench bench(names[s], scene, used, options.mode);
        AimPoints aim(scene);
        Pcg32 rng(mix(options.seed), s);
        aim.find_inside(bench.oracle, rng);
        for (size_t r = 0; r < used_recipes.size(); ++r) {
            // The total comes out as asked for, the first cases taking what is left over.
            const uint64_t cases = names.size() * used_recipes.size();
            const uint64_t index = s * used_recipes.size() + r;
            const uint64_t rays = options.rays / cases + (index < options.rays % cases);
            verification.run(bench, aim, used_recipes[r], std::max<uint64_t>(1, rays),
                             mix(options.seed) + mix(index));
        }
    }
    progress.clear();
    return report;
}

VerifyReport replay(const std::vector<FailingRay>& rays, Progress& progress) {
    VerifyReport report;
    Verification verification(report);
    progress.set_total(rays.size());
    for (size_t begin = 0; begin < rays.size();) {
        // Neighbours mostly share a scene and an accelerator.
        const FailingRay& first = rays[begin];
        progress.step("replaying " + first.scene);
        const auto same = [&](const FailingRay& r) {
            return r.scene == first.scene && r.accelerator == first.accelerator &&
                   r.recipe == first.recipe && r.mode == first.mode;
        };
        std::vector<AimedRay> batch;
        size_t end = begin;
        for (; end < rays.size() && same(rays[end]); ++end)
            batch.push_back({rays[end].ray, rays[end].must_hit});
        std::vector<std::string> used{"brute_force"};
        if (first.accelerator != used[0]) used.push_back(first.accelerator);
        const Bench bench(first.scene, verify_scene(first.scene), checked_accelerators(used),
                          first.mode);
        verification.begin(bench, first.recipe);
        verification.check(bench, first.recipe, batch);
        begin = end;
    }
    progress.clear();
    return report;
}

}  // namespace crofton
