#include "framework/error.h"

#include <algorithm>
#include <numeric>

namespace crofton {
namespace {

size_t edit_distance(std::string_view a, std::string_view b) {
    // Three rows of the optimal string alignment table.
    std::vector<size_t> before(b.size() + 1), previous(b.size() + 1), current(b.size() + 1);
    std::iota(previous.begin(), previous.end(), size_t{0});
    for (size_t i = 1; i <= a.size(); ++i) {
        current[0] = i;
        for (size_t j = 1; j <= b.size(); ++j) {
            const size_t replace = previous[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
            current[j] = std::min({previous[j] + 1, current[j - 1] + 1, replace});
            if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
                current[j] = std::min(current[j], before[j - 2] + 1);
        }
        std::swap(before, previous);
        std::swap(previous, current);
    }
    return previous[b.size()];
}

}  // namespace

std::string nearest_name(std::string_view name, const std::vector<std::string>& candidates) {
    std::string best;
    size_t best_distance = std::max<size_t>(2, name.size() / 3) + 1;
    for (const std::string& candidate : candidates) {
        size_t distance = edit_distance(name, candidate);
        // A prefix or a part of a valid name is a likely abbreviation of it.
        if (name.size() >= 3 && candidate.find(name) != std::string::npos)
            distance = std::min<size_t>(distance, 2);
        if (distance < best_distance) {
            best_distance = distance;
            best = candidate;
        }
    }
    return best;
}

std::string unknown_name(std::string_view kind, std::string_view name,
                         const std::vector<std::string>& candidates) {
    std::string text = "unknown " + std::string(kind) + " '" + std::string(name) + "'";
    if (const std::string near = nearest_name(name, candidates); !near.empty())
        return text + "; did you mean '" + near + "'?";
    if (candidates.empty()) return text;
    text += "; valid: ";
    for (size_t i = 0; i < candidates.size(); ++i) text += (i ? ", " : "") + candidates[i];
    return text;
}

}  // namespace crofton
