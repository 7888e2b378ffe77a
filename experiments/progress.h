#pragma once

#include <cstddef>
#include <string>

namespace crofton {

/// Says on stderr what is being done: a bar on a terminal, plain lines elsewhere.
class Progress {
  public:
    /// @param quiet  says nothing
    explicit Progress(bool quiet = false);
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    void set_total(size_t steps) { total_ = steps; }
    /// Begins the next step. A minor one moves the bar, but is no line of its own.
    void step(const std::string& text, bool minor = false);
    /// Removes the bar; a later step shows it again.
    void clear();

  private:
    bool quiet_, terminal_;
    size_t done_ = 0, total_ = 0;
    bool shown_ = false;
};

/// Whether text on stdout may be coloured: a terminal, and NO_COLOR not set.
bool color_on_stdout();

}  // namespace crofton
