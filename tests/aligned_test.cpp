#include "framework/aligned.h"

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

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
        std::free(p);
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
        std::free(p);
    }
    set_huge_pages(true);
}

}  // namespace
}  // namespace crofton
