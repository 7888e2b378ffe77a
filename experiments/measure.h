#pragma once

#include <sched.h>

#include <cstdint>
#include <span>
#include <vector>

#include "framework/primitive.h"

namespace crofton {

/// Binds the calling thread to the core it runs on, until destroyed.
class PinnedThread {
  public:
    explicit PinnedThread(bool pin);
    ~PinnedThread();
    PinnedThread(const PinnedThread&) = delete;
    PinnedThread& operator=(const PinnedThread&) = delete;
    int core() const { return core_; }  ///< -1 if not pinned

  private:
    cpu_set_t before_;
    int core_ = -1;
};

/// How a workload is traced.
struct Tracing {
    bool any = false;
    int threads = 1;  ///< 0 = one per core
    Mode mode = Mode::robust;
    bool single = false;  ///< one call a ray, instead of spans
};

/// Traces all rays once without counters. @return  wall seconds
double timed_pass(const Primitive& root, std::span<const Ray> rays, const Tracing& tracing);

/// Nanoseconds per ray, estimated from growing samples until they take 10 ms or are all rays.
double pilot_ns(const Primitive& root, std::span<const Ray> rays, const Tracing& tracing);

/// Hits of all rays, without counters. For an any-hit query only `primitive` tells: 0 or no_id.
std::vector<Hit> trace_hits(const Primitive& root, std::span<const Ray> rays,
                            const Tracing& tracing);

/// Sums over all rays, of a pass with counters on all cores; sums of integers, so always the same.
Counters counted_pass(const Primitive& root, std::span<const Ray> rays, bool any,
                      Mode mode = Mode::robust);

/// `count` of `total` indices, ascending: one at random in each of `count` equal strides, so that
/// the sample is unbiased and no stride falls in step with the rows of an image.
std::vector<size_t> strided_sample(size_t total, size_t count, uint64_t seed);

}  // namespace crofton
