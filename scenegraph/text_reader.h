#pragma once

#include <charconv>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>

#include "framework/error.h"
#include "framework/vec.h"

namespace crofton {

/// The bytes of a regular file, read in one go.
/// @throws InputError  "path: why" if it is missing, not a regular file, or cannot be read
std::string read_file(const std::string& path);

/// A cursor over text that knows its line. Words are separated by blanks, tabs and carriage
/// returns; lines end with a line feed. Numbers do not depend on the locale. Keeps no copy: the
/// text must outlive it.
class TextReader {
  public:
    struct Syntax {
        bool comments = true;        ///< '#' at the start of a word ends the line
        bool continuations = false;  ///< a backslash at the end of a line joins it with the next
    };

    TextReader(std::string path, std::string_view text, Syntax syntax)
        : path_(std::move(path)), text_(text), syntax_(syntax) {}
    TextReader(std::string path, std::string_view text) : TextReader(path, text, Syntax{}) {}

    /// The next word of this line; empty at its end.
    std::string_view word() {
        skip_blanks();
        const size_t begin = at_;
        while (at_ < text_.size() && !is_blank(text_[at_]) && text_[at_] != '\n' && !continued())
            ++at_;
        return text_.substr(begin, at_ - begin);
    }
    /// The next word of this or a later line; empty at the end of the text.
    std::string_view word_across_lines() {
        std::string_view w = word();
        while (w.empty() && !at_end()) {
            next_line();
            w = word();
        }
        return w;
    }
    /// What is left of this line, as it stands, without blanks around it; then the next line.
    std::string_view rest_of_line();

    void next_line() {
        const size_t end = text_.find('\n', at_);
        at_ = end == std::string_view::npos ? text_.size() : end + 1;
        ++line_;
    }
    bool at_end() const { return at_ >= text_.size(); }
    bool at_line_end() {
        skip_blanks();
        return at_end() || text_[at_] == '\n';
    }
    size_t line() const { return line_; }
    size_t offset() const { return at_; }                    ///< bytes before the cursor
    size_t remaining() const { return text_.size() - at_; }  ///< bytes after it

    /// The number that a whole word spells: decimal, with an exponent, inf or nan; a leading plus,
    /// and a sign before the e of an exponent (3.1+e2, as some exporters write), are accepted. A
    /// float that overflows is infinite.
    /// @throws InputError  "path:line: WHAT: 'word' is not a number"
    template <class T>
    T number(std::string_view word, const char* what) const;

    /// The next number of this line, or of this or a later line.
    /// @throws InputError  also if there is none
    float real(const char* what) { return number<float>(word(), what); }
    float real_across_lines(const char* what) { return number<float>(word_across_lines(), what); }
    Vec3f point(const char* what) {
        const float x = real(what), y = real(what), z = real(what);
        return {x, y, z};
    }

    [[noreturn]] void fail(const std::string& what) const { fail_at(line_, what); }
    [[noreturn]] void fail_at(size_t line, const std::string& what) const {
        throw InputError(path_ + ":" + std::to_string(line) + ": " + what);
    }

  private:
    static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
    /// Bytes of a continuation (backslash, line end) at the cursor, or 0.
    size_t continued() const {
        if (!syntax_.continuations || text_[at_] != '\\') return 0;
        if (text_.substr(at_ + 1, 1) == "\n") return 2;
        return text_.substr(at_ + 1, 2) == "\r\n" ? 3 : 0;
    }
    void skip_blanks();
    [[noreturn]] void fail_number(std::string_view word, const char* what) const;

    std::string path_;
    std::string_view text_;
    Syntax syntax_;
    size_t at_ = 0;
    size_t line_ = 1;
};

extern template float TextReader::number<float>(std::string_view, const char*) const;
extern template double TextReader::number<double>(std::string_view, const char*) const;
extern template int64_t TextReader::number<int64_t>(std::string_view, const char*) const;

}  // namespace crofton
