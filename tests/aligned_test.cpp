#include "framework/aligned.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "tests/catch.h"

namespace crofton {
namespace {

/// Flags of the mapping that holds an address, as the kernel names them: "rd wr … hg …".
std::string mapping_flags(const void* p) {
    const auto at = reinterpret_cast<uintptr_t>(p);
    std::ifstream in("/proc/self/smaps");
    bool here = false;
    for (std::string line; std::getline(in, line);) {
        uintptr_t begin, end;
        char dash;
        std::istringstream range(line);
        if (range >> std::hex >> begin >> dash >> end && dash == '-')
            here = at >= begin && at < end;
        else if (here && line.starts_with("VmFlags:"))
            return line + " ";
    }
    return "";
}

TEST_CASE("traversal memory lies on cache lines, large arrays on whole huge pages if switched on") {
    constexpr size_t huge = size_t{2} << 20;
    const auto aligned_to = [](const void* p, size_t to) {
        return reinterpret_cast<uintptr_t>(p) % to == 0;
    };
    for (const size_t bytes : {size_t{0}, size_t{1}, size_t{65}, huge - 1}) {
        void* const p = allocate_for_traversal(bytes);
        CHECK(aligned_to(p, 64));
        free_for_traversal(p);
    }
    const bool system_has_them = std::filesystem::exists("/sys/kernel/mm/transparent_hugepage");
    for (const bool on : {true, false}) {
        set_huge_pages(on);
        char* const p = static_cast<char*>(allocate_for_traversal(3 * huge + 100));
        CHECK(aligned_to(p, huge));
        p[3 * huge + 99] = 1;
        if (system_has_them) {
            INFO("switched " << (on ? "on" : "off") << ": " << mapping_flags(p));
            CHECK((mapping_flags(p).find(" hg ") != std::string::npos) == on);
            CHECK((mapping_flags(p).find(" nh ") != std::string::npos) == !on);
        }
        free_for_traversal(p);
    }
    set_huge_pages(true);
}

TEST_CASE("traversal memory of 2 MiB and more begins on a huge page, whatever was there before") {
    constexpr size_t huge = size_t{2} << 20;
    std::vector<void*> arrays;
    size_t wrong = 0;
    // Of all sizes about those that share pages.
    for (const size_t bytes :
         {size_t{900'000}, size_t{900'000}, huge, size_t{700'000}, 3 * huge, size_t{70'000},
          huge + 1, size_t{40'000}, 4 * huge - 1, 4 * huge, size_t{20'000}, huge}) {
        arrays.push_back(allocate_for_traversal(bytes));
        wrong += bytes >= huge && reinterpret_cast<uintptr_t>(arrays.back()) % huge != 0;
    }
    CHECK(wrong == 0);
    for (void* p : arrays) free_for_traversal(p);
}

TEST_CASE("traversal memory of any size is no other array's, by several threads, and comes back") {
    struct Array {
        uint8_t* p;
        size_t bytes;
        uint8_t mark;
    };
    const auto work = [](uint32_t seed) {
        std::mt19937 random(seed);
        std::vector<Array> arrays;
        size_t wrong = 0;
        const auto drop = [&](size_t i) {
            const Array a = arrays[i];
            wrong += size_t(std::count(a.p, a.p + a.bytes, a.mark) != ptrdiff_t(a.bytes));
            free_for_traversal(a.p);
            arrays[i] = arrays.back();
            arrays.pop_back();
        };
        for (int step = 0; step < 1500; ++step) {
            // Mostly what shares pages, from a slot to nearly 2 MiB; at most some 40 MB at a time.
            const size_t bytes = 1 + (random() % 8 ? random() % (1u << (12 + random() % 10))
                                                   : random() % (5u << 20));
            auto* const p = static_cast<uint8_t*>(allocate_for_traversal(bytes));
            wrong += reinterpret_cast<uintptr_t>(p) % 64 != 0;
            arrays.push_back({p, bytes, uint8_t(random())});
            std::fill_n(p, bytes, arrays.back().mark);
            while (arrays.size() > 40) drop(random() % arrays.size());
        }
        while (!arrays.empty()) drop(0);
        return wrong;
    };
    std::array<size_t, 3> wrong{};
    std::vector<std::thread> threads;
    for (size_t t = 0; t < wrong.size(); ++t)
        threads.emplace_back([&, t] { wrong[t] = work(uint32_t(t)); });
    for (std::thread& thread : threads) thread.join();
    CHECK(wrong == std::array<size_t, 3>{});
}

TEST_CASE("traversal memory that is free again is what the next array gets") {
    constexpr size_t bytes = 600'000;
    void* const first = allocate_for_traversal(bytes);
    void* const second = allocate_for_traversal(bytes);
    free_for_traversal(first);
    void* const third = allocate_for_traversal(bytes);
#ifndef __SANITIZE_ADDRESS__
    CHECK(third == first);
#endif
    CHECK(third != second);
    free_for_traversal(second);
    free_for_traversal(third);
    free_for_traversal(nullptr);
}

}  // namespace
}  // namespace crofton
