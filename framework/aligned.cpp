#include "framework/aligned.h"

#include <sys/mman.h>

namespace crofton {

void* allocate_for_traversal(size_t bytes) {
    constexpr size_t line = 64, huge = size_t{2} << 20;
    const size_t alignment = bytes >= huge ? huge : line;
    const size_t rounded = (bytes + alignment - 1) / alignment * alignment;
    void* p = std::aligned_alloc(alignment, rounded == 0 ? line : rounded);
    if (!p) throw std::bad_alloc();
    // Best effort: fewer TLB misses where transparent huge pages are on for those who ask.
    if (alignment == huge) madvise(p, rounded, MADV_HUGEPAGE);
    return p;
}

}  // namespace crofton
