#pragma once

#include <span>
#include <string>

#include "experiments/row.h"
#include "experiments/runner.h"

namespace crofton {

/// The rows as a table for people, a part for each scene and workload, with notes below.
/// @param color  emphasises with terminal colours
std::string table_text(std::span<const Row> rows, bool color);

/// The table, what differs, the notes, and where the results are.
std::string report_text(const RunOutput& output, const std::string& folder, bool color);

}  // namespace crofton
