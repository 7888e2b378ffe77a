#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>

#include "framework/clock.h"
#include "framework/ray_crowd.h"

namespace crofton {

/// Which of two ways takes less time, found by trying both in turns, now and then. Pairs of turns
/// are over different rays and so tell little each: logarithms of what one took over the other are
/// added up, none for more than a quarter. The way that is not taken is taken where it has gained a
/// whole, and left where it has lost a third. Where it is left it is tried again after twice as
/// long. What is large for a machine's caches, and what is gained by having several steps
/// under way, is different for every machine, structure and stream; results are the same either
/// way.
class FasterWay {
  public:
    /// @return  whether to take the second way next
    bool second() const { return (trying_ && turn_ % 2 == 1) != taken_; }
    /// @return  whether it matters how long the next takes: to ask a clock takes time, too
    bool trying() const { return trying_; }
    /// The way named by `second` took so long. @param time  anything, unless `trying`
    void took(double time) {
        if (trying_) {
            if (turn_ % 2 == 1) decide(std::log(before_ / time));
            before_ = time;
        }
        if (++turn_ >= period_ && !trying_) {
            turn_ = 0;
            trying_ = true;
        }
    }

  private:
    static constexpr int least_period = 256, most_period = 2048;
    static constexpr double to_win = 1, to_lose = -0.3, most_of_pair = 0.25;

    void decide(double won) {
        score_ += std::clamp(won, -most_of_pair, most_of_pair);
        if (score_ > to_lose && score_ < to_win) return;
        const bool wins = score_ >= to_win;
        taken_ ^= wins;
        period_ = wins ? least_period : std::min(2 * period_, most_period);
        score_ = 0;
        trying_ = false;
    }

    bool taken_ = false;  ///< the second way
    bool trying_ = true;  ///< the other one, every second turn
    int turn_ = 0, period_ = least_period;
    double score_ = 0;
    double before_ = 0;
};

/// Traces rays of a stream that do not go together, in crowds where that is faster.
/// @tparam One    (i): traces ray i by itself, where prepare refuses it
/// @tparam Local  (local, query): traces a ray that is prepared; whether a query for any hit has
/// one
/// @tparam Trace  (crowd): traces a crowd
/// @tparam Keep   (i, query, scale, found): keeps what ray i has found, see crofton::prepare
template <class One, class Local, class Trace, class Keep>
class Crowds {
  public:
    /// @param magnitude, mode  see crofton::prepare and RayQuery
    /// @param way              what is known of which way is faster: the second are crowds
    Crowds(std::span<const Ray> rays, float magnitude, Mode mode, const One& one,
           const Local& local, const Trace& trace, const Keep& keep, FasterWay& way)
        : rays_(rays),
          magnitude_(magnitude),
          mode_(mode),
          one_(one),
          local_(local),
          trace_(trace),
          keep_(keep),
          way_(way) {}

    void add(size_t i) {
        waiting_[count_++] = i;
        if (count_ < RayCrowd::most) return;
        const bool timed = way_.trying();
        const auto begin = timed ? Clock::now() : Clock::time_point();
        way_.second() ? trace_crowd() : trace_each();
        way_.took(timed ? seconds_since(begin) : 0);
    }
    /// Traces those that are left.
    void finish() { way_.second() && count_ >= least ? trace_crowd() : trace_each(); }

  private:
    static constexpr size_t least = 16;  ///< in a crowd, for the turns to be worth it
    struct Single {
        LocalRay local;
        RayQuery query;
        float scale;
        size_t index;
    };

    /// Prepares those from `begin` to `end` that wait; traces those that are refused.
    /// @return  how many are ready
    size_t prepare_some(size_t begin, size_t end) {
        size_t ready = 0;
        for (size_t k = begin; k < end; ++k) {
            Single& s = single_[ready];
            s.index = waiting_[k];
            if (prepare(rays_[s.index], magnitude_, s.query, s.local, s.scale)) {
                s.query.mode = mode_;
                ++ready;
            } else {
                one_(s.index);
            }
        }
        return ready;
    }
    /// Some are prepared before any of them is traced: else the first node of each would wait until
    /// its ray is ready.
    void trace_each() {
        constexpr size_t some = 16;
        for (size_t begin = 0; begin < count_; begin += some) {
            const size_t ready = prepare_some(begin, std::min(count_, begin + some));
            for (size_t k = 0; k < ready; ++k) {
                Single& s = single_[k];
                const bool found = local_(s.local, s.query);
                keep_(s.index, s.query, s.scale, found);
            }
        }
        count_ = 0;
    }
    void trace_crowd() {
        RayCrowd crowd;
        const size_t ready = prepare_some(0, count_);
        for (size_t k = 0; k < ready; ++k) crowd.add(single_[k].local, single_[k].query);
        if (crowd.size > 0) trace_(crowd);
        for (size_t k = 0; k < ready; ++k)
            keep_(single_[k].index, single_[k].query, single_[k].scale, crowd.found >> k & 1);
        count_ = 0;
    }

    std::span<const Ray> rays_;
    float magnitude_;
    Mode mode_;
    const One& one_;
    const Local& local_;
    const Trace& trace_;
    const Keep& keep_;
    FasterWay& way_;
    size_t count_ = 0;
    size_t waiting_[RayCrowd::most];
    Single single_[RayCrowd::most];
};

}  // namespace crofton
