#pragma once

#include <string>

namespace crofton {

/// What there is to choose from: accelerators with parameters, ranges, defaults and sources;
/// workloads; procedural scenes with parameters; file endings; instruction sets.
std::string catalog_text();
std::string catalog_json();

}  // namespace crofton
