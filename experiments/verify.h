#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "experiments/progress.h"
#include "framework/exact.h"
#include "framework/mode.h"
#include "framework/ray.h"
#include "scenegraph/scene.h"

namespace crofton {

struct VerifyOptions {
    std::string scene;  ///< as scene_source takes it, or "catalogue:NAME"; empty: the catalogue
    std::vector<std::string> accelerators;  ///< empty: all
    std::vector<std::string> recipes;       ///< of rays; empty: all
    uint64_t rays = 100000;  ///< in all, spread evenly over scenes and recipes; at least one each
    uint64_t seed = 1;
    /// Of the queries. For `exact` the oracle gets triangles as they are placed, which is what that
    /// mode is exact about. In `fast` bits may differ.
    Mode mode = Mode::robust;
};

/// Counts of errors in t, in ulp: see exact::Judgement.
class UlpCounts {
  public:
    void add(double ulps);
    UlpCounts& operator+=(const UlpCounts& o);
    bool operator==(const UlpCounts&) const = default;
    /// Smallest error that so large a share of all does not exceed; beyond 63 rounded up to a power
    /// of two. 0 if there are none.
    double quantile(double share) const;
    double largest() const { return largest_; }

  private:
    std::array<uint64_t, 64> exact_{};   ///< by ulp
    std::array<uint64_t, 40> beyond_{};  ///< by power of two
    double largest_ = 0;
};

/// What happened to the rays of one case in one accelerator. Closest and any hits count alike.
struct VerifyTally {
    struct Split {
        uint64_t inside = 0;   ///< the leaf tests' stated bounds allow it
        uint64_t outside = 0;  ///< a fault
        bool operator==(const Split&) const = default;
    };
    uint64_t rays = 0, hits = 0;
    uint64_t leaks = 0;  ///< misses from the inside of closed surfaces; always faults
    Split false_misses, false_hits, wrong_primitives, wrong_t;
    uint64_t disagreements = 0;  ///< closest hits whose bits differ from the first accelerator's
    UlpCounts t_ulp;

    void add(const exact::Judgement& judgement);
    VerifyTally& operator+=(const VerifyTally& o);
    bool operator==(const VerifyTally&) const = default;
    uint64_t faults() const {
        return leaks + false_misses.outside + false_hits.outside + wrong_primitives.outside +
               wrong_t.outside + disagreements;
    }
};

struct VerifyCase {
    std::string scene, recipe;
    std::vector<std::string> accelerators;
    std::vector<VerifyTally> tallies;  ///< of each accelerator
};

/// A ray that made a fault, with all that is needed to see it again.
struct FailingRay {
    std::string scene, recipe, accelerator, kind;
    Ray ray;
    bool must_hit = false;
    Mode mode = Mode::robust;
};

struct VerifyReport {
    uint64_t rays = 0;
    std::vector<VerifyCase> cases;
    std::vector<FailingRay> failing;  ///< at most `most_failing` of them
    std::vector<std::string> notes;

    static constexpr size_t most_failing = 10000;
    uint64_t faults() const;
};

/// What `verify` calls a scene.
/// @throws InputError  unknown, with the nearest valid name
Scene verify_scene(const std::string& name);

/// Traces hard rays with every accelerator and compares each answer with the oracle's.
/// @throws InputError  unknown scene, accelerator or recipe, with the nearest valid name
VerifyReport verify(const VerifyOptions& options, Progress& progress);

/// The same with the rays of a file that `write_failing` made.
/// @throws InputError  no such file, a line that cannot be read (with its number)
VerifyReport replay(const std::string& file, Progress& progress);
VerifyReport replay(const std::vector<FailingRay>& rays, Progress& progress);
/// @throws InputError  the file cannot be read, or not written
std::vector<FailingRay> read_failing(const std::string& file);
void write_failing(const std::string& file, const std::vector<FailingRay>& rays);

/// A table, and the totals of each accelerator.
/// @param by_scene  a row for each scene, or else for each recipe
std::string verify_text(const VerifyReport& report, bool by_scene);
std::string verify_json(const VerifyReport& report);

}  // namespace crofton
