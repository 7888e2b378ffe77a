#pragma once

#include <string>
#include <utility>
#include <vector>

#include "framework/config.h"

namespace crofton {

/// Splits "accelerator.fine.max_leaf_size" at its dots; a part in double quotes is taken whole.
/// @throws InputError  for an empty part, or a quote that does not close
std::vector<std::string> split_path(const std::string& path, const std::string& place);

/// Puts a value where `path` says. Elements of arrays of tables are named by their `name`, `type`
/// or `match`, or by their index. Keys that are missing in a table are added, to be checked when
/// the table is read; elements of arrays and accelerators must exist.
/// @param sections  valid first parts
/// @throws InputError  "place: unknown … 'x'; did you mean 'y'?"
void set_path(ConfigValue& root, const std::string& path, ConfigValue value,
              const std::vector<std::string>& sections);

/// Applies one "path=value" of the command line.
void apply_setting(ConfigValue& root, const std::string& setting,
                   const std::vector<std::string>& sections);

/// One combination of the values of a sweep, applied to the config.
struct SweepPoint {
    ConfigValue config;                                       ///< without [sweep]
    std::vector<std::pair<std::string, ConfigValue>> values;  ///< path and value
};

/// All combinations of [sweep], the last key fastest; the keys of [sweep.zip] advance together and
/// count as one. Without a sweep: one point.
/// @throws InputError  a value that is not an array, empty arrays, zipped arrays of unequal length,
/// more
///                     than 10,000 combinations, and as set_path
std::vector<SweepPoint> expand_sweep(const ConfigValue& root,
                                     const std::vector<std::string>& sections);

}  // namespace crofton
