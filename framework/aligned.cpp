#include "framework/aligned.h"

#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <string_view>

namespace crofton {
namespace {

constexpr size_t line = 64, huge = size_t{2} << 20;

std::atomic<bool>& huge_pages() {
    static std::atomic<bool> on = [] {
        const char* given = std::getenv("CROFTON_HUGE_PAGES");
        return !given || std::string_view(given) != "0";
    }();
    return on;
}

/// @return  null if there is no memory
void* aligned(size_t alignment, size_t bytes) {
    void* p = nullptr;
    return posix_memalign(&p, alignment, bytes) == 0 ? p : nullptr;
}

void advise(void* p, size_t bytes) {
    // Best effort: fewer TLB misses where transparent huge pages are on for those who ask. What
    // does not fill one has small pages: up to 2 MiB would be taken for nothing.
    madvise(p, bytes / huge * huge, huge_pages() ? MADV_HUGEPAGE : MADV_NOHUGEPAGE);
}

/// Memory for arrays that do not fill huge pages, several in one, or fill few of them. A build has
/// dozens, and the first touch of each small page costs more than what is then written there.
///
/// Chunks are cut into slots; an array has the first slots in a row that are free, and begins on a
/// huge page if it fills one. The first chunk has small pages, since what a small scene needs would
/// not fill a huge one.
class SharedPages {
  public:
    static constexpr size_t slot = size_t{16} << 10, most = size_t{8} << 20;

    void* allocate(size_t bytes) {
        const size_t n = (bytes + slot - 1) / slot, step = bytes >= huge ? huge / slot : 1;
        const std::lock_guard lock(mutex_);
        for (Chunk& chunk : chunks_)
            if (chunk.base)
                if (void* p = chunk.take(n, step)) return p;
        for (Chunk& chunk : chunks_) {
            if (chunk.base) continue;
            if (!chunk.open(&chunk == chunks_.data())) return nullptr;
            if (void* p = chunk.take(n, step)) return p;
        }
        return nullptr;
    }
    /// @return  whether it was from here
    bool free(void* p) {
        const std::lock_guard lock(mutex_);
        for (Chunk& chunk : chunks_) {
            if (!chunk.give_back(p)) continue;
            if (chunk.used == 0) drop_idle(chunk);
            return true;
        }
        return false;
    }

  private:
    static constexpr size_t first_bytes = size_t{1} << 20, chunk_bytes = size_t{16} << 20;
    static constexpr size_t most_slots = chunk_bytes / slot;
    static constexpr size_t idle_kept = 2;  ///< chunks

    struct Chunk {
        char* base = nullptr;
        size_t slots = 0, used = 0;
        std::array<uint16_t, most_slots> length{};  ///< of the array that begins there
        std::array<bool, most_slots> taken{};

        /// @return  false if there is no memory for a chunk; for an array there may be some
        bool open(bool first) {
            const size_t bytes = first ? first_bytes : chunk_bytes;
            base = static_cast<char*>(aligned(huge, bytes));
            if (!base) return false;
            slots = bytes / slot;
            if (!first) advise(base, bytes);
            return true;
        }
        /// @param step  arrays begin at a multiple of it
        void* take(size_t n, size_t step) {
            if (slots - used < n) return nullptr;
            for (size_t begin = 0; begin + n <= slots;) {
                const auto first = taken.begin() + ptrdiff_t(begin), end = first + ptrdiff_t(n);
                const auto blocked = std::find(first, end, true);
                if (blocked == end) {
                    std::fill(first, end, true);
                    length[begin] = uint16_t(n);
                    used += n;
                    return base + begin * slot;
                }
                begin = (size_t(blocked - taken.begin()) / step + 1) * step;
            }
            return nullptr;
        }
        bool give_back(void* p) {
            const auto at = uintptr_t(p), from = uintptr_t(base);
            if (!base || at < from || at >= from + slots * slot) return false;
            const size_t begin = (at - from) / slot;
            std::fill_n(taken.begin() + ptrdiff_t(begin), length[begin], false);
            used -= length[begin];
            return true;
        }
    };

    void drop_idle(Chunk& chunk) {
        size_t idle = 0;
        for (const Chunk& c : chunks_) idle += c.base && c.used == 0;
        if (idle <= idle_kept) return;
        std::free(chunk.base);
        chunk.base = nullptr;
    }

    std::mutex mutex_;
    std::array<Chunk, 64> chunks_;
};

#ifdef __SANITIZE_ADDRESS__
constexpr bool shares = false;  // so that what reaches beyond an array is noticed
#else
constexpr bool shares = true;
#endif

/// Never destroyed: structures may outlive all else.
SharedPages& shared_pages() {
    static SharedPages& pages = *new SharedPages;
    return pages;
}

}  // namespace

void set_huge_pages(bool on) { huge_pages() = on; }

void* allocate_for_traversal(size_t bytes) {
    if (shares && bytes >= SharedPages::slot && bytes < SharedPages::most && huge_pages())
        if (void* p = shared_pages().allocate(bytes)) return p;
    const size_t lines = std::max(line, (bytes + line - 1) / line * line);
    void* const p = aligned(bytes < huge ? line : huge, lines);
    if (!p) throw std::bad_alloc();
    if (bytes >= huge) advise(p, bytes);
    return p;
}

void free_for_traversal(void* p) {
    // Arrays of whole slots only are on the boundary of one.
    if (p && uintptr_t(p) % SharedPages::slot == 0 && shared_pages().free(p)) return;
    std::free(p);
}

}  // namespace crofton
