#include "experiments/runner.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <list>
#include <optional>
#include <set>

#include "experiments/budget.h"
#include "experiments/calibrate.h"
#include "experiments/hash.h"
#include "experiments/image.h"
#include "experiments/measure.h"
#include "experiments/plot.h"
#include "experiments/random.h"
#include "experiments/workload.h"
#include "framework/clock.h"
#include "framework/error.h"
#include "framework/parallel.h"
#include "framework/registry.h"
#include "scenegraph/auto_plan.h"
#include "scenegraph/exact_scene.h"

namespace crofton {
namespace {

constexpr double shortest_pass_s =
    2e-3;                          ///< shorter passes are repeated within, for the clock's sake
constexpr double picture_s = 2.0;  ///< aim for one heat map

struct Built {
    const Variant* spec;
    Assembly assembly;
};

/// One variant on one workload.
struct Trial {
    const Built* built;
    double pilot = 0;             ///< ns per ray
    std::vector<size_t> timed;    ///< indices of the rays of a pass; empty = all
    std::vector<Ray> timed_rays;  ///< these rays; empty = all
    int inner = 1;                ///< times a pass repeats its rays
    bool check_all = true;
    std::vector<double> pass_ns;
    Row row;
};

/// What `auto` chose for one number of rays of a workload.
struct Chosen {
    const Variant* variant;
    double rays;
    Selection selection;
    Variant spec;                  ///< of the plan that was chosen
    std::vector<double> choose_s;  ///< that choosing took, each time
    size_t trial = 0;  ///< that measures it: its own, or that of a variant with the same plan
    bool shared = false;
};

bool same_hit(const Hit& a, const Hit& b) {
    return a.primitive == b.primitive && a.geometry == b.geometry && a.instance == b.instance &&
           std::bit_cast<uint32_t>(a.t) == std::bit_cast<uint32_t>(b.t);
}

std::string checksum(const std::vector<Hit>& hits) {
    Fnv1a hash;
    for (const Hit& hit : hits) {
        // Written out, so that no padding can come in.
        const float numbers[3] = {hit.t, hit.u, hit.v};
        const uint32_t ids[3] = {hit.primitive, hit.geometry, hit.instance};
        hash.add(numbers, sizeof numbers);
        hash.add(ids, sizeof ids);
    }
    return hash.hex();
}

void write_hits(const std::string& path, const std::vector<Hit>& hits) {
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(hits.data()),
               std::streamsize(hits.size() * sizeof(Hit)));
    file.close();
    if (!file) throw InputError(path + ": cannot be written");
}

std::string hit_text(const Hit& h) {
    if (!h.is_hit()) return "a miss";
    return fmt::format("t {} at primitive {} of geometry {} of instance {}", h.t, h.primitive,
                       h.geometry, h.instance);
}

class Run {
  public:
    Run(const Experiment& experiment, const std::string& hits_path, Results& results,
        Progress& progress, RunOutput& output)
        : spec_(experiment),
          hits_path_(hits_path),
          results_(results),
          progress_(progress),
          output_(output) {}

    void all() {
        set_isa(spec_.run.isa.empty() ? available_isas().back() : spec_.run.isa);
        progress_.step("loading the scene");
        load();
        if (needs_calibration()) ensure_calibration();
        for (const Variant& variant : spec_.variants)
            if (!variant.chooses) build(variant);
        if (spec_.run.builds > 1) build_again();
        for (size_t i = 0; i < spec_.workloads.size(); ++i) run_workload(i);
        if (!output_.explanations.empty()) {
            std::string text;
            for (const std::string& e : output_.explanations) text += e + "\n";
            results_.write_text("choices.txt", text);
        }
        if (spec_.run.pictures) draw();
        if (spec_.run.plot) plot();
    }

  private:
    void load() {
        scene_ = make_scene(spec_.scene);
        inputs_ = file_hashes(spec_.scene);
        instances_ = mesh_instances(scene_);
        statistics_ = statistics(scene_);
        sphere_ = bounding_sphere(statistics_.bounds_min, statistics_.bounds_max);
        // Structures are built once: for the pixels of the first image there is.
        int64_t height = 0;
        for (const WorkloadSpec& w : spec_.workloads) height = height ? height : w.height;
        pixel_ = pixel_angle(choose_camera(spec_.scene.camera, scene_, sphere_),
                             int(height ? height : spec_.run.picture_height));
        constexpr size_t most = 5;
        for (size_t i = 0; i < std::min(most, scene_.warnings.size()); ++i)
            output_.notes.push_back(scene_.name + ": " + scene_.warnings[i]);
        if (scene_.warnings.size() > most)
            output_.notes.push_back(
                fmt::format("{}: {} more warnings", scene_.name, scene_.warnings.size() - most));
    }

    bool needs_calibration() const {
        return spec_.run.predict ||
               std::any_of(spec_.variants.begin(), spec_.variants.end(), [](const Variant& v) {
                   return canonical(v.plan).find("auto{") != std::string::npos;
               });
    }

    Objective objective(double rays) const {
        return {spec_.objective.rays.value_or(rays), spec_.objective.memory,
                spec_.objective.priority, Coherence::unknown};
    }

    Assembly assembled(const Variant& variant) const {
        const Objective o = objective(double(spec_.workloads.front().rays));
        return assemble(scene_, with_objective(with_pixel_angle(variant.plan, pixel_), o));
    }

    void build(const Variant& variant) {
        progress_.step("building " + variant.name);
        if (!variant.available) {
            output_.notes.push_back(variant.name +
                                    ": left out; this program was built without the peer");
            return;
        }
        Built built{&variant, assembled(variant)};
        if (spec_.run.predict) built.assembly.build_s = median_build_s(variant);
        for (const std::string& warning : built.assembly.warnings)
            output_.notes.push_back(variant.name + ": " + warning);
        built_.push_back(std::move(built));
    }

    /// All of them in turns: what a program builds first is dearer.
    void build_again() {
        progress_.step("building again");
        std::vector<std::vector<double>> seconds(built_.size());
        for (int64_t i = 0; i < spec_.run.builds; ++i)
            for (size_t k = 0; k < built_.size(); ++k)
                seconds[k].push_back(i == 0 ? built_[k].assembly.build_s
                                            : assembled(*built_[k].spec).build_s);
        for (size_t k = 0; k < built_.size(); ++k)
            built_[k].assembly.build_s = median_interval(seconds[k]).median;
    }

    double median_build_s(const Variant& variant) const {
        std::vector<double> seconds;
        // Short ones vary most.
        constexpr double enough_s = 0.02;
        constexpr int64_t most = 15;
        double sum = 0;
        for (int64_t i = 0; i < spec_.run.repeats || (i < most && sum < enough_s); ++i) {
            seconds.push_back(assembled(variant).build_s);
            sum += seconds.back();
        }
        return median_interval(seconds).median;
    }

    /// A bvh of its own, so that rays do not depend on the variants.
    const Primitive& reference() {
        if (!reference_) reference_ = assemble(scene_, uniform_plan("bvh"));
        return *reference_->root;
    }

    void run_workload(size_t index) {
        const WorkloadSpec& workload = spec_.workloads[index];
        progress_.step("making rays: " + workload.name);
        const bool secondary = workload.type == "shadow" || workload.type == "ambient_occlusion" ||
                               workload.type == "diffuse";
        const Primitive& from =
            secondary || built_.empty() ? reference() : *built_.front().assembly.root;
        rays_ = make_rays(workload, {scene_, instances_, from, sphere_, spec_.scene.camera});
        if (rays_.empty()) throw InputError("workload '" + workload.name + "': there are no rays");
        any_ = workload.any;
        std::vector<Trial> trials;
        for (const Built& built : built_) trials.push_back(plan_trial(built, workload));
        choose(workload, trials);
        if (trials.empty()) return;
        if (spec_.run.predict) predict(trials);
        if (spec_.run.first_image > 0) time_first_images(trials);
        check(trials, workload);
        time(trials, workload);
        for (Trial& trial : trials) finish(trial, index);
        finish_chosen(trials);
        if (!spec_.run.budgets.empty()) time_budgets(trials);
    }

    RaySample sample() const { return {rays_, any_, spec_.run.mode}; }

    std::vector<double> budgets() const {
        return spec_.run.budgets.empty() ? std::vector<double>{objective(double(rays_.size())).rays}
                                         : spec_.run.budgets;
    }

    /// Lets every variant that is `auto` choose for each budget. A choice that is also a variant's
    /// plan is measured there; others get trials of their own.
    void choose(const WorkloadSpec& workload, std::vector<Trial>& trials) {
        chosen_.clear();
        chosen_built_.clear();
        for (const Variant& variant : spec_.variants) {
            if (!variant.chooses) continue;
            progress_.step(fmt::format("choosing for {}: {}", workload.name, variant.name), true);
            for (const double rays : budgets()) choose(variant, rays, workload, trials);
        }
    }

    Selection selected(const Chosen& c) const {
        AutoOptions options;
        options.objective = objective(c.rays);
        options.objective.rays = c.rays;
        options.max_error = spec_.objective.max_error;
        options.pixel_angle = pixel_;
        options.clock = spec_.objective.clock;
        RaySample sample = this->sample();
        sample.mode = *c.variant->mode;
        return choose_assembly(scene_, options, sample, calibration());
    }

    void choose(const Variant& variant, double rays, const WorkloadSpec& workload,
                std::vector<Trial>& trials) {
        Chosen& c = chosen_.emplace_back(Chosen{&variant, rays, {}, variant, {}, 0, false});
        c.selection = selected(c);
        c.choose_s.push_back(c.selection.choose_s);
        c.spec.plan = plan_of(c.selection.choice().choice);
        c.spec.canonical = canonical(c.spec.plan);
        c.spec.exact = spec_.objective.max_error <= 0;
        if (!spec_.run.budgets.empty()) c.spec.name += fmt::format(" [{:g}]", rays);
        for (size_t t = 0; t < trials.size(); ++t)
            if (trials[t].built->spec->canonical == c.spec.canonical &&
                trials[t].built->spec->mode == c.spec.mode &&
                trials[t].built->spec->single == c.spec.single) {
                c.trial = t;
                c.shared = true;
                c.selection.assembly = {};
                return;
            }
        c.trial = trials.size();
        Assembly assembly = std::move(c.selection.assembly);
        c.selection.assembly.build_s = assembly.build_s;
        chosen_built_.push_back({&c.spec, std::move(assembly)});
        trials.push_back(plan_trial(chosen_built_.back(), workload));
    }

    /// Costs of every trial's plan before its build, from a pilot, and after it, from counters, too.
    void predict(std::vector<Trial>& trials) {
        progress_.step("predicting", true);
        // At most a quarter of the shapes, so that it is before the build.
        constexpr double pilot_shapes = 16384, least_factor = 4;
        constexpr size_t pilot_rays = 8192;
        constexpr int pilot_builds = 5;
        AutoOptions options;
        options.objective = objective(double(rays_.size()));
        options.objective.coherence = coherence_of(rays_);
        options.clock = spec_.objective.clock;
        if (!counts_) {
            counts_ = count_shapes(scene_);
            counts_->weight = test_weight(scene_, counts_->main_kind());
            pilot_.emplace(scene_, *counts_,
                           std::min(pilot_shapes, counts_->unique() / least_factor));
        }
        const std::vector<Ray> some = some_of(rays_, pilot_rays);
        for (Trial& trial : trials) {
            const PlanChoice choice = plan_choice_of(trial.built->spec->plan);
            RaySample sample = this->sample();
            sample.rays = some;
            sample.mode = *trial.built->spec->mode;
            const auto start = Clock::now();
            double factor = 1;
            const CostEstimate e = pilot_->estimate(choice, trial.built->spec->plan, sample,
                                                    options, calibration(), pilot_builds, &factor);
            PredictedCosts p;
            p.choose_s = seconds_since(start);
            p.build_s = e.build_s, p.bytes = e.bytes, p.ns_per_ray = e.ns_per_ray;
            // Two estimates, each as good as the other: what the pilot says of more shapes, and
            // what the structure's own counters say.
            p.expected_ns =
                std::sqrt(e.ns_per_ray * factor *
                          counted_ns(*trial.built->assembly.root, choice.structure, *counts_,
                                     sample, calibration()));
            trial.row.predicted = p;
        }
    }

    /// Rows of choices that another variant's trial measures, predictions of all, and why.
    void finish_chosen(std::vector<Trial>& trials) {
        for (Chosen& c : chosen_) {
            const CostEstimate& e = c.selection.choice().predicted;
            Row row = trials[c.trial].row;
            row.variant = c.spec.name;
            row.chosen = true;
            row.predicted = PredictedCosts{c.selection.choose_s, e.build_s, e.bytes, e.ns_per_ray,
                                           c.selection.expected_ns};
            constexpr size_t shown = 5;
            output_.explanations.push_back(fmt::format(
                "{}, {}, {}: {}  measured: {:.1f} ns/ray, built in {:.4f} s\n", row.scene,
                row.workload, row.variant,
                explanation(c.selection, {c.rays, spec_.objective.memory, {}, {}}, shown),
                row.ns_per_ray.median, row.build_s));
            if (spec_.run.budgets.empty() && c.shared) {
                results_.add(row);
                output_.rows.push_back(row);
            }
            trials[c.trial].row.chosen |= !c.shared;
        }
    }

    /// A row for each variant and budget with its total time.
    void time_budgets(std::vector<Trial>& trials) {
        std::map<std::string, TotalTime> totals;
        const auto total = [&](const Trial& trial) -> TotalTime& {
            const Variant& spec = *trial.built->spec;
            return totals
                .try_emplace(
                    spec.canonical, [this, &spec] { return assembled(spec); }, rays_,
                    timed_tracing(*trial.built))
                .first->second;
        };
        // Those with as many rays in fact are one measurement.
        std::set<double> measured;
        for (const double rays : spec_.run.budgets)
            measured.insert(std::min(rays, double(rays_.size())));
        // What takes a moment is timed as often as builds are; of what takes longer, once says
        // enough.
        constexpr double long_s = 0.02;
        constexpr int passes = 3;
        for (int pass = 0; pass < passes; ++pass) {
            progress_.step(fmt::format("timing totals: pass {} of {}", pass + 1, passes), true);
            for (const double rays : measured)
                for (const Trial& trial : trials) total(trial).measure(rays);
            for (Chosen& c : chosen_)
                if (c.choose_s.front() < long_s) c.choose_s.push_back(selected(c).choose_s);
        }
        const auto add = [&](const Trial& trial, Row row, double rays, double choose_s) {
            TotalTime& time = total(trial);
            row.budget = BudgetTotal{rays, choose_s, choose_s + time.seconds(rays)};
            row.build_s = time.build_s();
            row.ns_per_ray.median = time.ns_per_ray();
            results_.add(row);
            output_.budget_rows.push_back(std::move(row));
        };
        for (const Trial& trial : trials)
            if (!trial.row.chosen)
                for (const double rays : spec_.run.budgets) add(trial, trial.row, rays, 0);
        for (const Chosen& c : chosen_) {
            Row row = trials[c.trial].row;
            const CostEstimate& e = c.selection.choice().predicted;
            row.variant = c.variant->name;
            row.chosen = true;
            const double choose_s = median_interval(c.choose_s).median;
            row.predicted =
                PredictedCosts{choose_s, e.build_s, e.bytes, e.ns_per_ray, c.selection.expected_ns};
            add(trials[c.trial], row, c.rays, choose_s);
        }
    }

    Tracing timed_tracing(const Built& built) const {
        return {any_, int(spec_.run.threads), *built.spec->mode, built.spec->single};
    }

    Trial plan_trial(const Built& built, const WorkloadSpec& workload) {
        Trial trial;
        trial.built = &built;
        trial.pilot = std::max(1e-3, pilot_ns(*built.assembly.root, rays_, timed_tracing(built)));
        double most = std::max(1.0, spec_.run.max_pass_s * 1e9 / trial.pilot);
        if (built.spec->max_rays) most = std::min(most, double(*built.spec->max_rays));
        if (most < double(rays_.size())) {
            trial.timed = strided_sample(rays_.size(), size_t(most), workload.seed);
            for (const size_t i : trial.timed) trial.timed_rays.push_back(rays_[i]);
        }
        const double pass_s = trial.pilot * 1e-9 * double(timed_rays(trial).size());
        trial.inner = int(std::clamp(std::ceil(shortest_pass_s / pass_s), 1.0, 1e4));
        trial.check_all = trial.pilot * 1e-9 * double(rays_.size()) <= spec_.run.max_check_s;
        return trial;
    }

    std::span<const Ray> timed_rays(const Trial& trial) const {
        return trial.timed.empty() ? std::span<const Ray>(rays_) : trial.timed_rays;
    }
    std::span<const Ray> checked_rays(const Trial& trial) const {
        return trial.check_all ? std::span<const Ray>(rays_) : timed_rays(trial);
    }

    /// Builds every variant anew and traces all rays once, in turns.
    void time_first_images(std::vector<Trial>& trials) {
        progress_.step("timing first images", true);
        std::vector<std::vector<double>> seconds(trials.size());
        for (int64_t pass = 0; pass < spec_.run.first_image; ++pass)
            for (size_t i = 0; i < trials.size(); ++i) {
                const Assembly fresh = assembled(*trials[i].built->spec);
                seconds[i].push_back(fresh.build_s + timed_pass(*fresh.root, rays_,
                                                                timed_tracing(*trials[i].built)));
                trials[i].row.first_image_bytes = total_statistics(*fresh.root).bytes;
            }
        for (size_t i = 0; i < trials.size(); ++i)
            trials[i].row.first_image_s = median_interval(seconds[i]).median;
    }

    /// Whether a variant's hits must have the same bits as those of others in its mode.
    static bool promises_bits(const Built& built) {
        return *built.spec->mode != Mode::fast && !built.spec->peer && built.spec->exact;
    }

    /// Traces every variant once, which also warms it up, and compares with the fastest of its
    /// mode that is exact about what is hit.
    void check(std::vector<Trial>& trials, const WorkloadSpec& workload) {
        progress_.step("checking hits: " + workload.name);
        for (const Mode mode : {Mode::fast, Mode::robust, Mode::double_precision, Mode::exact}) {
            std::vector<Trial*> group;
            for (Trial& trial : trials)
                if (*trial.built->spec->mode == mode) group.push_back(&trial);
            check_mode(group, {any_, 0, mode}, workload);
        }
        if (spec_.run.oracle > 0) judge(trials, workload);
    }

    void check_mode(const std::vector<Trial*>& trials, const Tracing& tracing,
                    const WorkloadSpec& workload) {
        Trial* reference = nullptr;
        for (Trial* trial : trials)
            if (promises_bits(*trial->built) && (!reference || trial->pilot < reference->pilot))
                reference = trial;
        if (trials.empty()) return;
        if (reference) reference->check_all = true;
        const std::string against = reference ? reference->built->spec->name : "a bvh";
        const std::vector<Hit> expected = trace_hits(
            reference ? *reference->built->assembly.root : this->reference(), rays_, tracing);
        for (Trial* trial : trials) {
            const std::vector<Hit> hits =
                trial == reference
                    ? expected
                    : trace_hits(*trial->built->assembly.root, checked_rays(*trial), tracing);
            trial->row.rays_checked = hits.size();
            trial->row.hits = uint64_t(
                std::count_if(hits.begin(), hits.end(), [](const Hit& h) { return h.is_hit(); }));
            trial->row.hits_checksum = checksum(hits);
            const bool bits = promises_bits(*trial->built), coarse = !trial->built->spec->exact;
            if (!spec_.run.check || (!bits && !coarse)) continue;
            trial->row.checked_against = against;
            if (coarse)
                trial->row.depth_error = depth_error(*trial, hits, expected);
            else if (trial != reference)
                compare(*trial, hits, expected, against, workload);
        }
    }

    /// Compares all variants with the truth on a sample of the rays.
    void judge(std::vector<Trial>& trials, const WorkloadSpec& workload) {
        progress_.step("asking the oracle: " + workload.name, true);
        if (!oracle_) oracle_ = make_oracle(scene_, PlacementTruth::as_placed);
        std::vector<Ray> rays;
        for (const size_t i :
             strided_sample(rays_.size(), size_t(spec_.run.oracle), workload.seed + 1))
            rays.push_back(rays_[i]);
        std::vector<exact::Answer> truths(rays.size());
        parallel_for(rays.size(), 64, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) truths[i] = oracle_->closest(rays[i]);
        });
        for (Trial& trial : trials) {
            const std::vector<Hit> hits =
                trace_hits(*trial.built->assembly.root, rays, {any_, 0, *trial.built->spec->mode});
            VerifyTally& tally = trial.row.oracle;
            for (size_t i = 0; i < rays.size(); ++i) {
                const exact::Judgement j =
                    any_ ? oracle_->judge(rays[i], hits[i].is_hit(), truths[i])
                         : oracle_->judge(rays[i], hits[i], truths[i], *trial.built->spec->mode);
                tally.add(j);
                const bool right =
                    j.kind == exact::Judgement::Kind::right && hits[i].is_hit() && !any_;
                if (right) tally.t_ulp.add(j.t_ulp);
            }
            tally.rays = rays.size();
        }
    }

    /// Index in rays_ of the i-th ray that a trial is checked on.
    static size_t ray_index(const Trial& trial, size_t i) {
        return trial.check_all || trial.timed.empty() ? i : trial.timed[i];
    }

    static DepthError depth_error(const Trial& trial, const std::vector<Hit>& hits,
                                  const std::vector<Hit>& expected) {
        DepthError error;
        double sum = 0;
        uint64_t both = 0;
        for (size_t i = 0; i < hits.size(); ++i) {
            const Hit &a = hits[i], &b = expected[ray_index(trial, i)];
            error.hit_or_miss += a.is_hit() != b.is_hit();
            // An any-hit query has no t.
            if (!a.is_hit() || !b.is_hit() || !std::isfinite(a.t) || b.t == 0) continue;
            const double relative = std::abs((double(a.t) - b.t) / b.t);
            sum += relative * relative;
            error.max = std::max(error.max, relative);
            ++both;
        }
        error.rms = both ? std::sqrt(sum / double(both)) : 0;
        return error;
    }

    void compare(Trial& trial, const std::vector<Hit>& hits, const std::vector<Hit>& expected,
                 const std::string& against, const WorkloadSpec& workload) {
        std::string first;
        for (size_t i = 0; i < hits.size(); ++i) {
            const size_t ray = ray_index(trial, i);
            if (same_hit(hits[i], expected[ray])) continue;
            if (trial.row.mismatches++ == 0)
                first = fmt::format("ray {}: {}, but {} in {}", ray, hit_text(hits[i]),
                                    hit_text(expected[ray]), against);
        }
        if (trial.row.mismatches)
            output_.mismatches.push_back(fmt::format("{} on {}: {} of {} hits differ; {}",
                                                     trial.built->spec->name, workload.name,
                                                     trial.row.mismatches, hits.size(), first));
    }

    void time(std::vector<Trial>& trials, const WorkloadSpec& workload) {
        const PinnedThread pinned(spec_.run.pin && spec_.run.threads == 1);
        for (int64_t pass = 0; pass < spec_.run.repeats; ++pass) {
            progress_.step(fmt::format("timing {}: {} passes", workload.name, spec_.run.repeats),
                           pass > 0);
            for (Trial& trial : trials) {
                const auto rays = timed_rays(trial);
                double s = 0;
                for (int i = 0; i < trial.inner; ++i)
                    s += timed_pass(*trial.built->assembly.root, rays, timed_tracing(*trial.built));
                trial.pass_ns.push_back(s * 1e9 / (double(rays.size()) * trial.inner));
                trial.row.core = pinned.core();
            }
        }
        progress_.step("counting: " + workload.name, true);
    }

    void finish(Trial& trial, size_t index) {
        const WorkloadSpec& workload = spec_.workloads[index];
        const Primitive& root = *trial.built->assembly.root;
        Row& row = trial.row;
        row.counters = counted_pass(root, checked_rays(trial), any_, *trial.built->spec->mode);
        row.ns_per_ray_raw = trial.pass_ns;
        row.ns_per_ray = median_interval(trial.pass_ns);
        row.rays = rays_.size();
        row.rays_timed = timed_rays(trial).size();
        row.workload = workload.name;
        row.query = workload.any ? "any" : "closest";
        row.seed = workload.seed;
        describe_variant(*trial.built, row);
        row.key = key_of(*trial.built, index);
        results_.add(row);
        dump_hits(trial, workload);
        output_.rows.push_back(row);
    }

    void describe_variant(const Built& built, Row& row) const {
        row.scene = scene_.name;
        row.variant = built.spec->name;
        row.mode = name_of(*built.spec->mode);
        row.single = built.spec->single;
        row.peer = built.spec->peer;
        row.accelerator = describe(*built.assembly.root);
        row.triangles = statistics_.triangles_unique;
        row.triangles_instanced = statistics_.triangles_instanced;
        row.shapes = statistics_.shapes_unique;
        row.instances = statistics_.mesh_instances;
        row.build_s = built.assembly.build_s;
        row.structure = total_statistics(*built.assembly.root);
        row.expected_ns = built.assembly.root->expected_cost();
        row.repeats = spec_.run.repeats;
        row.threads = spec_.run.threads;
        row.isa = active_isa();
        row.host = host_name();
        row.sweep = built.spec->sweep;
    }

    std::string key_of(const Built& built, size_t workload) const {
        Fnv1a hash;
        for (const std::string& text :
             {spec_.scene_canonical, built.spec->canonical, spec_.workload_canonical[workload],
              spec_.run_canonical, revision_text(),
              std::to_string(built.spec->max_rays.value_or(0)), name_of(*built.spec->mode),
              std::string(built.spec->single ? "single" : "span")})
            hash.add(text);
        for (const auto& [file, value] : inputs_) hash.add(value);
        return hash.hex();
    }

    void dump_hits(const Trial& trial, const WorkloadSpec& workload) {
        if (hits_path_.empty()) return;
        const auto paths =
            hits_paths(hits_path_, trial.built->spec->name, workload.name, output_.rows.empty(),
                       spec_.variants.size() * spec_.workloads.size() > 1);
        const std::vector<Hit> hits =
            trace_hits(*trial.built->assembly.root, rays_, {false, 0, *trial.built->spec->mode});
        for (const std::string& path : paths) write_hits(path, hits);
    }

    /// A picture by normals (of each variant that ends rays early, too), and one of the costs of
    /// every variant, all on the same scale.
    void draw() {
        const int width = int(spec_.run.picture_width), height = int(spec_.run.picture_height);
        const Camera camera = choose_camera(spec_.scene.camera, scene_, sphere_);
        progress_.step("drawing normals");
        save("normal-" + file_name_of(scene_.name),
             normal_image(scene_, reference(), camera, width, height));
        // And what was chosen for the last workload.
        std::vector<const Built*> drawn;
        for (const Built& built : built_) drawn.push_back(&built);
        for (const Built& built : chosen_built_) drawn.push_back(&built);
        for (const Built* built : drawn) {
            if (built->spec->exact) continue;
            progress_.step("drawing normals of " + built->spec->name, true);
            save("normal-" + file_name_of(scene_.name + "-" + built->spec->name),
                 normal_image(scene_, *built->assembly.root, camera, width, height));
        }
        std::vector<CostMap> maps;
        double highest = 0;
        for (const Built* built : drawn) {
            progress_.step("drawing the cost of " + built->spec->name);
            maps.push_back(cost_map(*built->assembly.root, camera, width, height, picture_s));
            highest = std::max(highest, maps.back().highest);
        }
        for (size_t i = 0; i < maps.size(); ++i)
            save("cost-" + file_name_of(scene_.name + "-" + drawn[i]->spec->name),
                 heat_image(maps[i], highest));
    }

    /// Time against error, over all workloads.
    void plot() {
        std::vector<Row> rows;
        for (const Row& row : output_.rows)
            if (row.scene == scene_.name && row.oracle.rays > 0) rows.push_back(row);
        save("time-vs-error-" + file_name_of(scene_.name), error_plot(rows));
    }

    /// Several experiments of one run may share the names of scene and variant.
    void save(const std::string& stem, const Image& image) {
        std::string file = stem + ".png";
        const auto taken = [&] {
            return std::find(output_.pictures.begin(), output_.pictures.end(), file) !=
                   output_.pictures.end();
        };
        for (int i = 2; taken(); ++i) file = fmt::format("{}-{}.png", stem, i);
        write_png(results_.path(file), image);
        output_.pictures.push_back(file);
    }

    const Experiment& spec_;
    const std::string& hits_path_;
    Results& results_;
    Progress& progress_;
    RunOutput& output_;
    Scene scene_;
    std::map<std::string, std::string> inputs_;
    std::vector<MeshInstance> instances_;
    SceneStatistics statistics_;
    BoundingSphere sphere_;
    double pixel_ = 0;  ///< angle of a pixel, radians
    std::vector<Built> built_;
    std::list<Chosen> chosen_;       ///< for the current workload
    std::list<Built> chosen_built_;  ///< those without a variant of the same plan
    std::optional<SceneCounts> counts_;
    std::optional<Pilot> pilot_;
    std::optional<Assembly> reference_;
    std::optional<exact::Oracle> oracle_;
    std::vector<Ray> rays_;
    bool any_ = false;
};

}  // namespace

void run_experiment(const Experiment& experiment, const std::string& hits_path, Results& results,
                    Progress& progress, RunOutput& output) {
    Run(experiment, hits_path, results, progress, output).all();
}

size_t step_count(const Experiment& experiment) {
    const size_t variants = experiment.variants.size();
    const auto early = size_t(std::count_if(experiment.variants.begin(), experiment.variants.end(),
                                            [](const Variant& v) { return !v.exact; }));
    const size_t pictures = experiment.run.pictures ? 1 + early + variants : 0;
    return 1 + variants + size_t(experiment.run.builds > 1) +
           experiment.workloads.size() * (3 + size_t(experiment.run.repeats)) + pictures;
}

std::vector<std::string> hits_paths(const std::string& path, const std::string& variant,
                                    const std::string& workload, bool first, bool several) {
    std::string filled = path;
    for (const auto& [key, value] : {std::pair{"{variant}", variant}, {"{workload}", workload}}) {
        const size_t at = filled.find(key);
        if (at != std::string::npos)
            filled.replace(at, std::string(key).size(), file_name_of(value));
    }
    if (filled != path) return {filled};
    std::vector<std::string> paths;
    if (first) paths.push_back(path);
    if (several) {
        const std::filesystem::path p = path;
        const std::string name = p.stem().string() + "-" + file_name_of(variant) + "-" +
                                 file_name_of(workload) + p.extension().string();
        paths.push_back((p.parent_path() / name).string());
    }
    return paths;
}

}  // namespace crofton
