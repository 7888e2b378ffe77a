#pragma once

#include <cstdint>

namespace crofton {

/// What a traversal did, after the Best Efficiency Scheme (Havran, Prikryl, Purgathofer 2000):
/// sums over rays. A nested object adds its own work to its parent's.
struct Counters {
    uint64_t N_IT = 0;    ///< ray-primitive intersection tests (an object entered is not one)
    uint64_t N_TS = 0;    ///< traversal steps: nodes or cells visited
    uint64_t N_ETS = 0;   ///< elementary cells visited: leaves of a tree, cells of a grid
    uint64_t N_EETS = 0;  ///< of these, the empty ones

    void test(uint64_t n) { N_IT += n; }
    void step() { ++N_TS; }
    void cell(bool empty) {
        ++N_ETS;
        N_EETS += empty ? 1 : 0;
    }
    Counters& operator+=(const Counters& o) {
        N_IT += o.N_IT, N_TS += o.N_TS, N_ETS += o.N_ETS, N_EETS += o.N_EETS;
        return *this;
    }
    bool operator==(const Counters&) const = default;
};

/// The same calls, doing nothing: what a timed kernel is compiled with.
struct NoCounters {
    void test(uint64_t) {}
    void step() {}
    void cell(bool) {}
};

}  // namespace crofton
