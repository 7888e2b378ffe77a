#include "framework/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>
#include <tbb/task_arena.h>

#include <atomic>

namespace crofton {
namespace {
std::atomic<int> thread_limit{0};
}

void set_threads(int n) { thread_limit = n; }

int threads() {
    const int n = thread_limit;
    return n > 0 ? n : tbb::info::default_concurrency();
}

void parallel_for(size_t n, size_t grain, const std::function<void(size_t, size_t)>& body) {
    if (n == 0) return;
    if (n <= grain || threads() == 1) return body(0, n);
    tbb::parallel_for(tbb::blocked_range<size_t>(0, n, grain),
                      [&](const tbb::blocked_range<size_t>& r) { body(r.begin(), r.end()); });
}

void parallel_invoke(const std::function<void()>& a, const std::function<void()>& b) {
    if (threads() == 1) {
        a();
        b();
    } else {
        tbb::parallel_invoke(a, b);
    }
}

void parallel_isolated(const std::function<void()>& body) { tbb::this_task_arena::isolate(body); }

void parallel_arena(const std::function<void()>& body) {
    tbb::task_arena arena(threads());
    arena.execute(body);
}

}  // namespace crofton
