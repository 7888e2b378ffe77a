#pragma once

#include <cstddef>
#include <functional>

namespace crofton {

/// Threads that parallel loops may use; 0 = one per core. Applies to calls made after it.
void set_threads(int threads);
int threads();

/// Calls body(begin, end) on disjoint chunks of [0, n) of at least `grain` elements, possibly at
/// once. What a body computes for an index must not depend on the chunks.
void parallel_for(size_t n, size_t grain, const std::function<void(size_t, size_t)>& body);

/// Runs both, possibly at once, and waits.
void parallel_invoke(const std::function<void()>& a, const std::function<void()>& b);

/// Runs `body`; while a loop inside waits, this thread takes up no work from outside `body`. For
/// work done under a lock that the work outside may ask for, too.
void parallel_isolated(const std::function<void()>& body);

/// Runs `body` with loops inside limited to threads().
void parallel_arena(const std::function<void()>& body);

}  // namespace crofton
