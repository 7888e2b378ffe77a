#include "framework/config.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <toml++/toml.h>

#include "framework/error.h"

namespace crofton {
namespace {

std::string place_of(const std::string& name, const toml::source_region& source) {
    return fmt::format("{}:{}:{}", name, source.begin.line, source.begin.column);
}

ConfigValue converted(const toml::node& node, const std::string& name);

ConfigValue converted_table(const toml::table& table, const std::string& name) {
    ConfigValue value;
    for (const auto& [key, child] : table) {
        value.items.push_back(converted(child, name));
        value.items.back().key = std::string(key.str());
        value.items.back().key_place = place_of(name, key.source());
    }
    return value;
}

/// Depth is bounded by the parser's own limit on nested values.
ConfigValue converted(const toml::node& node, const std::string& name) {
    ConfigValue value;
    const std::string place = place_of(name, node.source());
    if (const auto* table = node.as_table()) {
        value = converted_table(*table, name);
    } else if (const auto* array = node.as_array()) {
        value.type = ConfigValue::Type::array;
        for (const toml::node& item : *array) value.items.push_back(converted(item, name));
    } else if (const auto* text = node.as_string()) {
        value.type = ConfigValue::Type::string;
        value.text = text->get();
    } else if (const auto* integer = node.as_integer()) {
        value.type = ConfigValue::Type::integer;
        value.integer = integer->get();
    } else if (const auto* real = node.as_floating_point()) {
        value.type = ConfigValue::Type::real;
        value.real = real->get();
    } else if (const auto* boolean = node.as_boolean()) {
        value.type = ConfigValue::Type::boolean;
        value.boolean = boolean->get();
    } else {
        throw InputError(place + ": dates and times have no use here");
    }
    value.place = place;
    return value;
}

/// The library's description, on one line.
std::string one_line(std::string_view text) {
    std::string line(text);
    std::replace(line.begin(), line.end(), '\n', ' ');
    return line;
}

/// The table {x = text}, or nothing if the text is not one value.
std::optional<toml::table> parsed_value(std::string_view text) {
    try {
        toml::table table = toml::parse("x = " + std::string(text) + "\n");
        if (table.size() == 1) return table;
    } catch (const toml::parse_error&) {
    }
    return std::nullopt;
}

bool is_bare_word(std::string_view text) {
    const auto valid = [](char c) {
        return std::isalnum(static_cast<unsigned char>(c)) ||
               std::string_view("_-./*?:").find(c) != std::string_view::npos;
    };
    return !text.empty() && std::all_of(text.begin(), text.end(), valid);
}

void mark_command_line(ConfigValue& value, const std::string& place) {
    value.place = value.key_place = place;
    value.from_command_line = true;
    for (ConfigValue& item : value.items) mark_command_line(item, place);
}

std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\')
            out += {'\\', c};
        else if (static_cast<unsigned char>(c) < 0x20)
            out += fmt::format("\\u{:04X}", int(c));
        else
            out += c;
    }
    return out + "\"";
}

std::string key_text(const std::string& key) {
    const auto bare = [](char c) {
        return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-';
    };
    const bool plain = !key.empty() && std::all_of(key.begin(), key.end(), bare);
    return plain ? key : quoted(key);
}

std::string real_text(double value) {
    if (std::isnan(value)) return "nan";
    if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
    std::string text = fmt::format("{}", value);
    if (text.find_first_of(".e") == std::string::npos) text += ".0";
    return text;
}

bool is_array_of_tables(const ConfigValue& value) {
    return value.is_array() && !value.items.empty() &&
           std::all_of(value.items.begin(), value.items.end(),
                       [](const ConfigValue& item) { return item.is_table(); });
}

/// Items of a table in the order of their keys, so that equal tables have equal texts.
std::vector<const ConfigValue*> sorted_items(const ConfigValue& value) {
    std::vector<const ConfigValue*> items;
    for (const ConfigValue& item : value.items) items.push_back(&item);
    if (value.is_table())
        std::sort(items.begin(), items.end(),
                  [](const ConfigValue* a, const ConfigValue* b) { return a->key < b->key; });
    return items;
}

/// Scalars and arrays first, then the tables that get headers.
void write_table(const ConfigValue& table, const std::string& prefix, int depth, std::string& out) {
    const auto has_header = [&](const ConfigValue& item) {
        return depth < 2 && (item.is_table() || is_array_of_tables(item));
    };
    const std::vector<const ConfigValue*> items = sorted_items(table);
    for (const ConfigValue* item : items)
        if (!has_header(*item)) out += key_text(item->key) + " = " + to_toml(*item) + "\n";
    for (const ConfigValue* pointer : items) {
        const ConfigValue& item = *pointer;
        if (!has_header(item)) continue;
        const std::string path = prefix + (prefix.empty() ? "" : ".") + key_text(item.key);
        if (item.is_table()) {
            out += "\n[" + path + "]\n";
            write_table(item, path, depth + 1, out);
            continue;
        }
        for (const ConfigValue& element : item.items) {
            out += "\n[[" + path + "]]\n";
            write_table(element, path, 2, out);
        }
    }
}

}  // namespace

ConfigValue ConfigValue::of(const ParameterValue& value, std::string place) {
    ConfigValue out;
    out.place = std::move(place);
    if (const bool* b = std::get_if<bool>(&value)) {
        out.type = Type::boolean;
        out.boolean = *b;
    } else if (const int64_t* i = std::get_if<int64_t>(&value)) {
        out.type = Type::integer;
        out.integer = *i;
    } else if (const double* d = std::get_if<double>(&value)) {
        out.type = Type::real;
        out.real = *d;
    } else {
        out.type = Type::string;
        out.text = std::get<std::string>(value);
    }
    return out;
}

ConfigValue* ConfigValue::find(std::string_view key) {
    return const_cast<ConfigValue*>(std::as_const(*this).find(key));
}

const ConfigValue* ConfigValue::find(std::string_view key) const {
    for (const ConfigValue& item : items)
        if (item.key == key) return &item;
    return nullptr;
}

ConfigValue& ConfigValue::set(const std::string& key, ConfigValue value) {
    value.key = key;
    if (ConfigValue* old = find(key)) return *old = std::move(value);
    items.push_back(std::move(value));
    return items.back();
}

std::string ConfigValue::type_text() const {
    switch (type) {
        case Type::boolean:
            return "a boolean";
        case Type::integer:
            return "an integer";
        case Type::real:
            return "a real number";
        case Type::string:
            return "a string";
        case Type::array:
            return "an array";
        case Type::table:
            return "a table";
    }
    return "nothing";
}

std::optional<ParameterValue> ConfigValue::scalar() const {
    switch (type) {
        case Type::boolean:
            return boolean;
        case Type::integer:
            return integer;
        case Type::real:
            return real;
        case Type::string:
            return text;
        default:
            return std::nullopt;
    }
}

ConfigValue parse_config(std::string_view text, const std::string& name) {
    try {
        ConfigValue value = converted_table(toml::parse(text), name);
        value.place = name;
        return value;
    } catch (const toml::parse_error& error) {
        throw InputError(place_of(name, error.source()) + ": " + one_line(error.description()));
    }
}

ConfigValue read_config(const std::string& path) {
    std::error_code error;
    std::ifstream file(path, std::ios::binary);
    // A folder opens, but reading it throws.
    if (!file.is_open() || std::filesystem::is_directory(path, error))
        throw InputError(path + ": cannot be read");
    const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
    return parse_config(text, path);
}

ConfigValue parse_config_value(std::string_view text, const std::string& place) {
    ConfigValue value;
    if (const auto parsed = parsed_value(text)) {
        value = converted(*parsed->get("x"), place);
    } else if (is_bare_word(text)) {
        value.type = ConfigValue::Type::string;
        value.text = text;
    } else {
        throw InputError(place + ": '" + std::string(text) + "' is not a value in TOML syntax");
    }
    mark_command_line(value, place);
    return value;
}

std::string to_toml(const ConfigValue& value) {
    switch (value.type) {
        case ConfigValue::Type::boolean:
            return value.boolean ? "true" : "false";
        case ConfigValue::Type::integer:
            return fmt::format("{}", value.integer);
        case ConfigValue::Type::real:
            return real_text(value.real);
        case ConfigValue::Type::string:
            return quoted(value.text);
        default:
            break;
    }
    std::string out;
    for (const ConfigValue* item : sorted_items(value)) {
        out += out.empty() ? "" : ", ";
        if (value.is_table()) out += key_text(item->key) + " = ";
        out += to_toml(*item);
    }
    if (value.is_array()) return "[" + out + "]";
    return out.empty() ? "{}" : "{ " + out + " }";
}

std::string to_toml_document(const ConfigValue& table) {
    std::string out;
    write_table(table, "", 0, out);
    return out;
}

ConfigTable::ConfigTable(ConfigValue& table, std::string what)
    : table_(&table), what_(std::move(what)) {
    if (!table.is_table())
        throw InputError(table.place + ": " + what_ + ": expected a table, found " +
                         table.type_text());
}

void ConfigTable::know(const std::string& key) {
    if (std::find(known_.begin(), known_.end(), key) == known_.end()) known_.push_back(key);
}

ConfigValue* ConfigTable::value(const std::string& key) {
    know(key);
    return table_->find(key);
}

ConfigValue* ConfigTable::find_typed(const std::string& key, ConfigValue::Type type,
                                     const char* expected) {
    ConfigValue* found = value(key);
    if (found && found->type != type)
        throw InputError(fmt::format("{}: {}: expected {}, found {}", found->place, key, expected,
                                     found->type_text()));
    return found;
}

void ConfigTable::check_range(const std::string& key, double number, double minimum,
                              double maximum) const {
    if (number >= minimum && number <= maximum) return;
    throw InputError(fmt::format("{}: {}: {} is outside {} … {}", table_->find(key)->place, key,
                                 number, minimum, maximum));
}

bool ConfigTable::boolean(const std::string& key, bool fallback) {
    if (const auto* found = find_typed(key, ConfigValue::Type::boolean, "a boolean"))
        return found->boolean;
    table_->set(key, ConfigValue::of(fallback));
    return fallback;
}

std::optional<int64_t> ConfigTable::integer(const std::string& key, int64_t minimum,
                                            int64_t maximum) {
    const auto* found = find_typed(key, ConfigValue::Type::integer, "an integer");
    if (!found) return std::nullopt;
    check_range(key, double(found->integer), double(minimum), double(maximum));
    return found->integer;
}

int64_t ConfigTable::integer(const std::string& key, int64_t fallback, int64_t minimum,
                             int64_t maximum) {
    if (const auto found = integer(key, minimum, maximum)) return *found;
    table_->set(key, ConfigValue::of(fallback));
    return fallback;
}

std::optional<double> ConfigTable::real(const std::string& key, double minimum, double maximum) {
    ConfigValue* found = value(key);
    if (!found) return std::nullopt;
    if (found->type == ConfigValue::Type::integer) {
        found->type = ConfigValue::Type::real;
        found->real = double(found->integer);
    }
    find_typed(key, ConfigValue::Type::real, "a number");
    check_range(key, found->real, minimum, maximum);
    return found->real;
}

double ConfigTable::real(const std::string& key, double fallback, double minimum, double maximum) {
    if (const auto found = real(key, minimum, maximum)) return *found;
    table_->set(key, ConfigValue::of(fallback));
    return fallback;
}

std::optional<std::string> ConfigTable::string(const std::string& key) {
    const auto* found = find_typed(key, ConfigValue::Type::string, "a string");
    return found ? std::optional(found->text) : std::nullopt;
}

std::string ConfigTable::string(const std::string& key, const std::string& fallback,
                                const std::vector<std::string>& choices) {
    const auto found = string(key);
    if (!found) {
        table_->set(key, ConfigValue::of(fallback));
        return fallback;
    }
    if (!choices.empty() && std::find(choices.begin(), choices.end(), *found) == choices.end())
        throw InputError(table_->find(key)->place + ": " + unknown_name(key, *found, choices));
    return *found;
}

std::optional<std::vector<double>> ConfigTable::reals(const std::string& key, size_t count) {
    const auto* found = find_typed(key, ConfigValue::Type::array, "an array of numbers");
    if (!found) return std::nullopt;
    if (found->items.size() != count)
        throw InputError(fmt::format("{}: {}: expected {} numbers, found {}", found->place, key,
                                     count, found->items.size()));
    std::vector<double> out;
    for (const ConfigValue& item : found->items) {
        const bool integer = item.type == ConfigValue::Type::integer;
        if (!integer && item.type != ConfigValue::Type::real)
            throw InputError(fmt::format("{}: {}: expected a number, found {}", item.place, key,
                                         item.type_text()));
        out.push_back(integer ? double(item.integer) : item.real);
        if (!std::isfinite(out.back()))
            throw InputError(item.place + ": " + key + ": not a finite number");
    }
    return out;
}

ConfigTable ConfigTable::table(const std::string& key) {
    ConfigValue* found = value(key);
    if (!found) {
        found = &table_->set(key, ConfigValue{});
        found->place = table_->place;
    }
    return ConfigTable(*found, what_.empty() ? key : what_ + "." + key);
}

std::vector<ConfigTable> ConfigTable::tables(const std::string& key) {
    std::vector<ConfigTable> out;
    ConfigValue* found = find_typed(key, ConfigValue::Type::array, "an array of tables");
    if (!found) return out;
    for (ConfigValue& item : found->items)
        out.emplace_back(item, what_.empty() ? key : what_ + "." + key);
    return out;
}

void ConfigTable::finish() const {
    for (const ConfigValue& item : table_->items) {
        if (std::find(known_.begin(), known_.end(), item.key) != known_.end()) continue;
        throw InputError((item.key_place.empty() ? item.place : item.key_place) + ": " +
                         unknown_name("key", item.key, known_));
    }
}

void ConfigTable::fail(const std::string& key, const std::string& message) const {
    const ConfigValue* found = table_->find(key);
    throw InputError((found && !found->place.empty() ? found->place : table_->place) + ": " +
                     message);
}

}  // namespace crofton
