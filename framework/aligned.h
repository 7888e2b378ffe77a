#pragma once

#include <cstddef>
#include <cstdlib>
#include <new>
#include <vector>

namespace crofton {

/// Allocator for nodes: on cache lines, and from 2 MiB on, on huge pages where the system gives
/// them.
template <class T>
struct CacheLineAllocator {
    using value_type = T;
    CacheLineAllocator() = default;
    template <class U>
    CacheLineAllocator(const CacheLineAllocator<U>&) {}

    T* allocate(size_t n);
    void deallocate(T* p, size_t) { std::free(p); }
    bool operator==(const CacheLineAllocator&) const { return true; }
};

/// @return `bytes` bytes aligned to 64, or to 2 MiB and advised for huge pages if there are so many
/// @throws std::bad_alloc
void* allocate_for_traversal(size_t bytes);

template <class T>
T* CacheLineAllocator<T>::allocate(size_t n) {
    return static_cast<T*>(allocate_for_traversal(n * sizeof(T)));
}

template <class T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

}  // namespace crofton
