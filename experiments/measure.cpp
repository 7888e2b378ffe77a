#include "experiments/measure.h"

#include <algorithm>
#include <atomic>
#include <mutex>
#include <numeric>
#include <thread>

#include "experiments/random.h"
#include "framework/clock.h"

namespace crofton {
namespace {

constexpr size_t chunk = 1024;  ///< rays at a time on several threads
/// On one: enough for the library to find an order for them, and their hits stay in the cache.
constexpr size_t long_chunk = 1u << 14u;

/// Where results go that nobody reads.
struct Scratch {
    std::vector<Hit> hits = std::vector<Hit>(long_chunk);
    std::vector<uint8_t> flags = std::vector<uint8_t>(long_chunk);
};

void trace_chunk(const Primitive& root, std::span<const Ray> rays, const Tracing& tracing,
                 Scratch& scratch) {
    if (tracing.single) {
        for (size_t i = 0; i < rays.size(); ++i) {
            if (tracing.any)
                scratch.flags[i] = root.occluded(rays[i], tracing.mode);
            else
                scratch.hits[i] = root.intersect(rays[i], tracing.mode);
        }
    } else if (tracing.any)
        root.occluded(rays, std::span(scratch.flags).first(rays.size()), tracing.mode);
    else
        root.intersect(rays, std::span(scratch.hits).first(rays.size()), tracing.mode);
}

/// Calls work(begin, end) over all chunks on as many threads as asked for.
template <class Work>
void for_chunks(size_t n, int threads, const Work& work) {
    std::atomic<size_t> next = 0;
    const auto loop = [&] {
        for (size_t begin = next.fetch_add(chunk); begin < n; begin = next.fetch_add(chunk))
            work(begin, std::min(begin + chunk, n));
    };
    const unsigned count = threads > 0 ? unsigned(threads) : std::thread::hardware_concurrency();
    std::vector<std::jthread> helpers;
    for (unsigned i = 1; i < count; ++i) helpers.emplace_back(loop);
    loop();
}

}  // namespace

PinnedThread::PinnedThread(bool pin) {
    if (!pin || sched_getaffinity(0, sizeof before_, &before_) != 0) return;
    const int core = sched_getcpu();
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(core, &one);
    if (core >= 0 && sched_setaffinity(0, sizeof one, &one) == 0) core_ = core;
}

PinnedThread::~PinnedThread() {
    if (core_ >= 0) sched_setaffinity(0, sizeof before_, &before_);
}

double timed_pass(const Primitive& root, std::span<const Ray> rays, const Tracing& tracing) {
    thread_local Scratch own;
    const auto start = Clock::now();
    if (tracing.threads == 1) {
        for (size_t begin = 0; begin < rays.size(); begin += long_chunk)
            trace_chunk(root, rays.subspan(begin, std::min(long_chunk, rays.size() - begin)),
                        tracing, own);
    } else {
        for_chunks(rays.size(), tracing.threads, [&](size_t begin, size_t end) {
            thread_local Scratch scratch;
            trace_chunk(root, rays.subspan(begin, end - begin), tracing, scratch);
        });
    }
    return seconds_since(start);
}

double pilot_ns(const Primitive& root, std::span<const Ray> rays, const Tracing& tracing) {
    if (rays.empty()) return 0;
    double ns = 0;
    for (size_t count = 64;; count *= 4) {
        std::vector<Ray> sample;
        for (const size_t i : strided_sample(rays.size(), count, count)) sample.push_back(rays[i]);
        // The first time builds what is lazy, and warms the cache.
        timed_pass(root, sample, tracing);
        const double s = timed_pass(root, sample, tracing);
        ns = s * 1e9 / double(sample.size());
        if (s >= 0.01 || sample.size() == rays.size()) return ns;
    }
}

std::vector<Hit> trace_hits(const Primitive& root, std::span<const Ray> rays,
                            const Tracing& tracing) {
    std::vector<Hit> hits(rays.size());
    for_chunks(rays.size(), tracing.threads, [&](size_t begin, size_t end) {
        const auto part = rays.subspan(begin, end - begin);
        const auto out = std::span(hits).subspan(begin, end - begin);
        if (!tracing.any) {
            root.intersect(part, out, tracing.mode);
            return;
        }
        std::vector<uint8_t> flags(part.size());
        root.occluded(part, flags, tracing.mode);
        for (size_t i = 0; i < flags.size(); ++i)
            if (flags[i]) out[i].primitive = 0;
    });
    return hits;
}

Counters counted_pass(const Primitive& root, std::span<const Ray> rays, bool any, Mode mode) {
    Counters sum;
    std::mutex mutex;
    for_chunks(rays.size(), 0, [&](size_t begin, size_t end) {
        Counters counters;
        for (size_t i = begin; i < end; ++i) {
            if (any)
                root.occluded(rays[i], counters, mode);
            else
                root.intersect(rays[i], counters, mode);
        }
        const std::lock_guard lock(mutex);
        sum += counters;
    });
    return sum;
}

std::vector<size_t> strided_sample(size_t total, size_t count, uint64_t seed) {
    count = std::min(count, total);
    std::vector<size_t> out(count);
    if (count == total) {
        std::iota(out.begin(), out.end(), size_t{0});
        return out;
    }
    Pcg32 rng(seed, 3);
    const auto border = [&](size_t i) {
        return static_cast<size_t>(static_cast<unsigned __int128>(i) * total / count);
    };
    for (size_t i = 0; i < count; ++i) out[i] = border(i) + rng.below(border(i + 1) - border(i));
    return out;
}

}  // namespace crofton
