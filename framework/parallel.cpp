#include "framework/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>
#include <tbb/task_arena.h>

#include <atomic>

#if defined(__SANITIZE_THREAD__)
extern "C" void __tsan_acquire(void*);
extern "C" void __tsan_release(void*);
#endif

namespace crofton {
namespace {
std::atomic<int> thread_limit{0};

/// Tells ThreadSanitizer what a library compiled without it hides: what was done before a loop
/// began is seen in it, and what was done in it is seen after it.
class ForkJoin {
  public:
    ForkJoin() { release(); }
    ~ForkJoin() { acquire(); }
    template <class Body>
    void run(const Body& body) {
        acquire();
        body();
        release();
    }

  private:
#if defined(__SANITIZE_THREAD__)
    void acquire() { __tsan_acquire(this); }
    void release() { __tsan_release(this); }
#else
    void acquire() {}
    void release() {}
#endif
};
}  // namespace

void set_threads(int n) { thread_limit = n; }

int threads() {
    const int n = thread_limit;
    return n > 0 ? n : tbb::info::default_concurrency();
}

void parallel_for(size_t n, size_t grain, const std::function<void(size_t, size_t)>& body) {
    if (n == 0) return;
    if (n <= grain || threads() == 1) return body(0, n);
    ForkJoin join;
    tbb::parallel_for(
        tbb::blocked_range<size_t>(0, n, grain),
        [&](const tbb::blocked_range<size_t>& r) { join.run([&] { body(r.begin(), r.end()); }); });
}

void parallel_invoke(const std::function<void()>& a, const std::function<void()>& b) {
    if (threads() == 1) {
        a();
        b();
    } else {
        ForkJoin join;
        tbb::parallel_invoke([&] { join.run(a); }, [&] { join.run(b); });
    }
}

void parallel_isolated(const std::function<void()>& body) { tbb::this_task_arena::isolate(body); }

void parallel_arena(const std::function<void()>& body) {
    tbb::task_arena arena(threads());
    arena.execute(body);
}

}  // namespace crofton
