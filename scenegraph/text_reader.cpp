#include "scenegraph/text_reader.h"

#include <filesystem>
#include <fstream>

namespace crofton {
namespace {

/// Writes "3.1+e2" as "3.1e+2"; empty if the word does not have this form.
std::string with_exponent_in_order(std::string_view word) {
    const size_t sign = word.find_first_of("+-", 1);
    if (sign == std::string_view::npos || sign + 2 >= word.size()) return {};
    if (word[sign + 1] != 'e' && word[sign + 1] != 'E') return {};
    std::string text(word);
    std::swap(text[sign], text[sign + 1]);
    return text;
}

/// How far a conversion got: all of the word, some of it, or a value out of range.
enum class Parsed { kAll, kNotAll, kOutOfRange };

template <class T>
Parsed parse(std::string_view word, T& value) {
    if (word.size() > 1 && word[0] == '+' && word[1] != '-') word.remove_prefix(1);
    const char* const end = word.data() + word.size();
    const std::from_chars_result result = std::from_chars(word.data(), end, value);
    if (result.ptr != end || word.empty() || result.ec == std::errc::invalid_argument)
        return Parsed::kNotAll;
    return result.ec == std::errc() ? Parsed::kAll : Parsed::kOutOfRange;
}

}  // namespace

std::string read_file(const std::string& path) {
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) throw InputError(path + ": no such file");
    if (!std::filesystem::is_regular_file(status)) throw InputError(path + ": not a regular file");
    const uintmax_t size = std::filesystem::file_size(path, error);
    std::ifstream in(path, std::ios::binary);
    if (error || !in) throw InputError(path + ": cannot be opened");
    std::string text(size, '\0');
    in.read(text.data(), std::streamsize(size));
    if (uintmax_t(in.gcount()) != size) throw InputError(path + ": cannot be read");
    return text;
}

void TextReader::skip_blanks() {
    while (at_ < text_.size()) {
        if (is_blank(text_[at_])) {
            ++at_;
        } else if (const size_t joined = continued()) {
            at_ += joined;
            ++line_;
        } else {
            break;
        }
    }
    if (syntax_.comments && at_ < text_.size() && text_[at_] == '#')
        at_ = std::min(text_.find('\n', at_), text_.size());
}

std::string_view TextReader::rest_of_line() {
    while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
    const size_t end = std::min(text_.find('\n', at_), text_.size());
    std::string_view rest = text_.substr(at_, end - at_);
    while (!rest.empty() && is_blank(rest.back())) rest.remove_suffix(1);
    next_line();
    return rest;
}

void TextReader::fail_number(std::string_view word, const char* what) const {
    if (word.empty()) fail(std::string(what) + ": a number is missing");
    fail(std::string(what) + ": '" + std::string(word.substr(0, 40)) + "' is not a number");
}

template <class T>
T TextReader::number(std::string_view word, const char* what) const {
    T value{};
    Parsed parsed = parse(word, value);
    if constexpr (std::is_floating_point_v<T>) {
        if (parsed == Parsed::kNotAll)
            if (const std::string repaired = with_exponent_in_order(word); !repaired.empty())
                parsed = parse(repaired, value);
        // Beyond the range of T, a double may still tell infinity from zero.
        double wide = 0;
        if (parsed == Parsed::kOutOfRange && (parsed = parse(word, wide)) == Parsed::kAll)
            value = static_cast<T>(wide);
    }
    if (parsed == Parsed::kOutOfRange)
        fail(std::string(what) + ": '" + std::string(word.substr(0, 40)) + "' is out of range");
    if (parsed != Parsed::kAll) fail_number(word, what);
    return value;
}

template float TextReader::number<float>(std::string_view, const char*) const;
template double TextReader::number<double>(std::string_view, const char*) const;
template int64_t TextReader::number<int64_t>(std::string_view, const char*) const;

}  // namespace crofton
