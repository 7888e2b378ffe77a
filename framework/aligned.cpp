#include "framework/aligned.h"

#include <sys/mman.h>

#include <atomic>
#include <string_view>

namespace crofton {
namespace {

std::atomic<bool>& huge_pages() {
    static std::atomic<bool> on = [] {
        const char* given = std::getenv("CROFTON_HUGE_PAGES");
        return !given || std::string_view(given) != "0";
    }();
    return on;
}

}  // namespace

void set_huge_pages(bool on) { huge_pages() = on; }

void* allocate_for_traversal(size_t bytes) {
    constexpr size_t line = 64, huge = size_t{2} << 20;
    const size_t alignment = bytes >= huge ? huge : line;
    const size_t lines = (bytes + line - 1) / line * line;
    void* p = nullptr;
    if (posix_memalign(&p, alignment, lines == 0 ? line : lines) != 0) throw std::bad_alloc();
    // Best effort: fewer TLB misses where transparent huge pages are on for those who ask. What
    // does not fill one has small pages: up to 2 MiB would be taken for nothing.
    if (alignment == huge)
        madvise(p, bytes / huge * huge, huge_pages() ? MADV_HUGEPAGE : MADV_NOHUGEPAGE);
    return p;
}

}  // namespace crofton
