#pragma once

#include <cstddef>
#include <memory>
#include <new>
#include <vector>

namespace crofton {

/// Whether large structures that are built from now on ask for huge pages; at first they do, unless
/// the environment variable CROFTON_HUGE_PAGES is 0. To measure what these are worth.
void set_huge_pages(bool on);

/// @return `bytes` bytes aligned to 64, or to 2 MiB if there are so many; the system is then asked
///         to back each whole 2 MiB by a huge page (or not to: see set_huge_pages)
/// @throws std::bad_alloc
void* allocate_for_traversal(size_t bytes);
/// @param p  from allocate_for_traversal, or null
void free_for_traversal(void* p);

/// Allocator for nodes, and for what builders work on: on cache lines, and from 2 MiB on, on huge
/// pages where the system gives them (/sys/kernel/mm/transparent_hugepage/enabled is `madvise` or
/// `always`). A build that touches fresh memory page by page may take half as long again, so what
/// is smaller than 8 MiB, down to 16 KiB, comes from memory that is kept for the next build (32 MiB
/// at most), and shares its huge pages.
template <class T>
struct CacheLineAllocator {
    using value_type = T;
    CacheLineAllocator() = default;
    template <class U>
    CacheLineAllocator(const CacheLineAllocator<U>&) {}

    T* allocate(size_t n) { return static_cast<T*>(allocate_for_traversal(n * sizeof(T))); }
    void deallocate(T* p, size_t) { free_for_traversal(p); }
    bool operator==(const CacheLineAllocator&) const { return true; }
};

template <class T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

/// Leaves new elements of a vector undefined, to be written by many threads at once; for types that
/// need no constructor.
template <class T, class Base>
struct RawAllocator : Base {
    template <class U>
    struct rebind {
        using other =
            RawAllocator<U, typename std::allocator_traits<Base>::template rebind_alloc<U>>;
    };
    RawAllocator() = default;
    template <class U, class B>
    RawAllocator(const RawAllocator<U, B>&) {}
    template <class U>
    void construct(U*) noexcept {}
    template <class U, class... Arguments>
    void construct(U* p, Arguments&&... arguments) {
        ::new (static_cast<void*>(p)) U(std::forward<Arguments>(arguments)...);
    }
};
template <class T>
using RawAlignedVector = std::vector<T, RawAllocator<T, CacheLineAllocator<T>>>;

}  // namespace crofton
