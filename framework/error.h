#pragma once

#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace crofton {

/// Input that cannot be used: a config, a scene, a ray file, a command line. The text is one line,
/// "file:line:column: what; nearest valid name", with the parts that apply. The command line
/// prints it and exits with 2.
class InputError : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// The candidate closest to `name` by edit distance (insert, delete, replace, swap), or "" if none
/// is near enough to be a plausible typing error.
std::string nearest_name(std::string_view name, const std::vector<std::string>& candidates);

/// "unknown KIND 'NAME'; did you mean 'X'?" or, with nothing near, "; valid: a, b, c".
std::string unknown_name(std::string_view kind, std::string_view name,
                         const std::vector<std::string>& candidates);

}  // namespace crofton
