#include "experiments/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

namespace crofton {
namespace {

bool no_color() {
    const char* value = std::getenv("NO_COLOR");
    return value && *value;
}

}  // namespace

Progress::Progress(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {}

Progress::~Progress() { clear(); }

void Progress::step(const std::string& text, bool minor) {
    const size_t now = std::min(done_++, total_);
    if (quiet_) return;
    if (!terminal_) {
        if (!minor) fmt::print(stderr, "{}\n", text);
        return;
    }
    constexpr size_t width = 24;
    const size_t filled = total_ ? width * now / total_ : 0;
    const std::string bar = std::string(filled, '#') + std::string(width - filled, '.');
    const char* begin = no_color() ? "" : "\033[36m";
    const char* end = no_color() ? "" : "\033[0m";
    // Back to the start of the line, and the rest of the old one erased.
    fmt::print(stderr, "\r\033[K{}[{}]{} {}/{} {:.70}", begin, bar, end, now, total_, text);
    std::fflush(stderr);
    shown_ = true;
}

void Progress::clear() {
    if (!shown_) return;
    fmt::print(stderr, "\r\033[K");
    std::fflush(stderr);
    shown_ = false;
}

bool color_on_stdout() { return isatty(STDOUT_FILENO) != 0 && !no_color(); }

}  // namespace crofton
