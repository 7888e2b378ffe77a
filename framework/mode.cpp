#include "framework/mode.h"

#include <algorithm>

namespace crofton {

std::span<const std::string> mode_names() {
    static const std::string names[] = {"fast", "robust", "double", "exact"};
    return names;
}

const std::string& name_of(Mode mode) { return mode_names()[size_t(mode)]; }

std::optional<Mode> mode_named(std::string_view name) {
    const auto names = mode_names();
    const auto it = std::find(names.begin(), names.end(), name);
    if (it == names.end()) return std::nullopt;
    return Mode(it - names.begin());
}

}  // namespace crofton
