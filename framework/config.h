#pragma once

#include <cstdint>
#include <list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "framework/registry.h"

/// Strict reading of TOML: every key that nobody asked for is an error, and every error says where.
namespace crofton {

/// One value of a config: a tree of our own, so that a single file knows the TOML library, and so
/// that sweeps and command lines can replace values before anything is checked.
struct ConfigValue {
    enum class Type { boolean, integer, real, string, array, table };
    Type type = Type::table;
    bool boolean = false;
    int64_t integer = 0;
    double real = 0;
    std::string text;
    std::string key;                 ///< of an item of a table
    std::list<ConfigValue> items;    ///< of an array or a table; a list, so that addresses stay
    std::string place;               ///< "file:line:column" of the value
    std::string key_place;           ///< the same of its key, if it has one
    bool from_command_line = false;  ///< relative paths are then relative to the working folder

    static ConfigValue of(const ParameterValue& value, std::string place = {});
    bool is_table() const { return type == Type::table; }
    bool is_array() const { return type == Type::array; }
    /// Item of a table, or null.
    ConfigValue* find(std::string_view key);
    const ConfigValue* find(std::string_view key) const;
    /// Adds or replaces an item of a table.
    ConfigValue& set(const std::string& key, ConfigValue value);
    /// "an integer", "a string", "a table", …, for messages.
    std::string type_text() const;
    /// Nothing for arrays and tables.
    std::optional<ParameterValue> scalar() const;
};

/// @throws InputError  "file: cannot be read", or "file:line:column: what" for a syntax error
ConfigValue read_config(const std::string& path);
/// The same from a text; `name` stands for the file in messages.
ConfigValue parse_config(std::string_view text, const std::string& name);
/// One value in TOML syntax; a bare word (letters, digits and _ - . / * ? :) is a string.
/// @param place  stands before messages, and becomes the place of the value
/// @throws InputError  not a value
ConfigValue parse_config_value(std::string_view text, const std::string& place);

/// The value in TOML syntax, on one line.
std::string to_toml(const ConfigValue& value);
/// A whole document: tables two levels deep get headers of their own, deeper ones stand inline.
std::string to_toml_document(const ConfigValue& table);

/// Reads one table. Getters check type and range, note that the key is known, and write defaults
/// back into the table, so that what was read is afterwards the resolved config.
class ConfigTable {
  public:
    /// @param what  name of the table for messages, e.g. "accelerator.fine"
    /// @throws InputError  if the value is not a table
    ConfigTable(ConfigValue& table, std::string what);

    bool has(std::string_view key) const { return table_->find(key) != nullptr; }
    bool boolean(const std::string& key, bool fallback);
    int64_t integer(const std::string& key, int64_t fallback, int64_t minimum, int64_t maximum);
    std::optional<int64_t> integer(const std::string& key, int64_t minimum, int64_t maximum);
    double real(const std::string& key, double fallback, double minimum, double maximum);
    std::optional<double> real(const std::string& key, double minimum, double maximum);
    /// With `choices`, any other value is an error that names the nearest.
    std::string string(const std::string& key, const std::string& fallback,
                       const std::vector<std::string>& choices = {});
    std::optional<std::string> string(const std::string& key);
    /// An array of `count` finite numbers.
    std::optional<std::vector<double>> reals(const std::string& key, size_t count);
    /// A key that stands for a table: created empty if it is missing.
    ConfigTable table(const std::string& key);
    /// An array of tables; none if the key is missing.
    std::vector<ConfigTable> tables(const std::string& key);
    /// The raw value, or null; the key counts as known.
    ConfigValue* value(const std::string& key);

    /// @throws InputError  for the first key that no getter asked for: "file:line:column: unknown
    /// key
    ///                     'x'; did you mean 'y'?"
    void finish() const;
    /// @throws InputError  always: "place of the key, or of the table if it is missing: message"
    [[noreturn]] void fail(const std::string& key, const std::string& message) const;

    const std::string& what() const { return what_; }
    const std::string& place() const { return table_->place; }
    ConfigValue& raw() { return *table_; }

  private:
    ConfigValue* find_typed(const std::string& key, ConfigValue::Type type, const char* expected);
    void know(const std::string& key);
    void check_range(const std::string& key, double value, double minimum, double maximum) const;

    ConfigValue* table_;
    std::string what_;
    std::vector<std::string> known_;
};

}  // namespace crofton
