#pragma once

#include <string>

#include "framework/registry.h"
#include "tests/catch.h"

namespace crofton {

/// Calls f() under every instruction set.
template <class F>
void for_each_isa(const F& f) {
    const std::string before = active_isa();
    for (const std::string& isa : available_isas()) {
        INFO(isa);
        set_isa(isa);
        f();
    }
    set_isa(before);
}

}  // namespace crofton
