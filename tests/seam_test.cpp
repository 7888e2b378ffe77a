// Proof that the seam costs nothing: looks at the machine code of the traversals over triangles in
// the program itself.

#include <hwy/detect_targets.h>

#include <algorithm>
#include <bit>
#include <cstdio>
#include <map>
#include <set>
#include <string>
#include <type_traits>
#include <vector>

#include "framework/counters.h"
#include "framework/registry.h"
#include "tests/catch.h"

namespace crofton {
namespace {

struct Function {
    std::vector<std::string> lines;  ///< disassembly
};

/// Every function of the program, by demangled name, clones apart.
std::map<std::string, Function> disassemble() {
    std::map<std::string, Function> functions;
    FILE* pipe = popen("objdump -d -C --no-show-raw-insn " CROFTON_BINARY " 2>/dev/null", "r");
    REQUIRE(pipe);
    std::string line;
    Function* current = nullptr;
    for (int c; (c = fgetc(pipe)) != EOF;) {
        if (c != '\n') {
            line += char(c);
            continue;
        }
        if (line.size() > 2 && line.compare(line.size() - 2, 2, ">:") == 0) {
            const size_t open = line.find('<');
            current = &functions[line.substr(open + 1, line.size() - open - 3)];
        } else if (current && line.find('\t') != std::string::npos) {
            current->lines.push_back(line);
        }
        line.clear();
    }
    pclose(pipe);
    return functions;
}

bool contains(const std::string& s, const std::string& part) {
    return s.find(part) != std::string::npos;
}

/// Names of the functions that this one calls or jumps to directly; `indirect` counts the others.
std::set<std::string> callees(const Function& f, int& indirect) {
    std::set<std::string> names;
    for (const std::string& line : f.lines) {
        const size_t mnemonic = line.rfind('\t') + 1;
        const std::string name_of = line.substr(mnemonic, line.find(' ', mnemonic) - mnemonic);
        if (name_of != "call" && name_of != "jmp" && name_of != "callq" && name_of != "jmpq")
            continue;
        const size_t operand = line.find_first_not_of(' ', mnemonic + name_of.size());
        if (operand != std::string::npos && line[operand] == '*') {
            ++indirect;
            continue;
        }
        const size_t open = line.find('<'), end = line.rfind('>');
        if (open == std::string::npos) continue;
        std::string name = line.substr(open + 1, end - open - 1);
        // <f+0x10> is a jump within f.
        if (const size_t plus = name.rfind("+0x"); plus != std::string::npos) continue;
        names.insert(name);
    }
    return names;
}

/// Indirect calls in `name` and in all that it calls, as far as it is code of this project.
int indirect_calls(const std::map<std::string, Function>& functions, const std::string& name) {
    std::set<std::string> seen{name}, open{name};
    int indirect = 0;
    while (!open.empty()) {
        const std::string next = *open.begin();
        open.erase(open.begin());
        const auto it = functions.find(next);
        if (it == functions.end()) continue;
        for (const std::string& callee : callees(it->second, indirect))
            if (contains(callee, "crofton::") && seen.insert(callee).second) open.insert(callee);
    }
    return indirect;
}

/// Integer additions to memory other than the stack: what counting compiles to, and nothing else in
/// a traversal.
int memory_increments(const Function& f) {
    int n = 0;
    for (const std::string& line : f.lines) {
        const size_t mnemonic = line.rfind('\t') + 1;
        const bool adds =
            line.compare(mnemonic, 3, "add") == 0 || line.compare(mnemonic, 3, "inc") == 0;
        const bool stack = contains(line, "(%rsp") || contains(line, "(%rbp");
        n += adds && line.back() == ')' && !stack;
    }
    return n;
}

}  // namespace

TEST_CASE("over triangles no traversal makes an indirect call, and over objects each does") {
    const auto functions = disassemble();
    if (functions.empty()) {
        WARN("skipped: objdump is absent");
        return;
    }
    int triangles = 0, objects = 0;
    for (const auto& [name, function] : functions) {
        if (!contains(name, "AcceleratedObject<") || contains(name, "Counters&")) continue;
        if (!contains(name, "closest_local(") && !contains(name, "any_local(")) continue;
        INFO(name);
        if (contains(name, "<crofton::TriangleSet>,")) {
            ++triangles;
            CHECK(indirect_calls(functions, name) == 0);
        } else if (contains(name, "<crofton::ObjectSet>,")) {
            ++objects;
            CHECK(indirect_calls(functions, name) > 0);
        }
    }
    // Two queries, every instruction set, every accelerator.
    const auto structures =
        std::count_if(accelerators().begin(), accelerators().end(),
                      [](const auto& entry) { return bool(entry.second.load); });
    const int expected = int(structures) * 2 * std::popcount(uint64_t(HWY_TARGETS));
    CHECK(triangles >= expected);
    CHECK(objects >= expected);
}

TEST_CASE("a timed kernel holds no counter, and a counted one does") {
    static_assert(std::is_empty_v<NoCounters>);
    const auto functions = disassemble();
    if (functions.empty()) {
        WARN("skipped: objdump is absent");
        return;
    }
    int timed = 0, counted = 0, increments = 0;
    for (const auto& [name, function] : functions) {
        if (!contains(name, "Traversal::run") || !contains(name, "crofton::TriangleSet")) continue;
        INFO(name);
        if (contains(name, "crofton::NoCounters")) {
            ++timed;
            CHECK(memory_increments(function) == 0);
        } else if (contains(name, "crofton::Counters")) {
            ++counted;
            increments += memory_increments(function);
        }
    }
    CHECK(timed > 0);
    CHECK(counted > 0);
    // Some clones hold only cold parts.
    CHECK(increments > counted / 2);
}

}  // namespace crofton
