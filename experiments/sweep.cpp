#include "experiments/sweep.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "framework/error.h"

namespace crofton {
namespace {

/// What an element of an array of tables answers to.
std::string element_name(const ConfigValue& element) {
    for (const char* key : {"name", "type", "match"})
        if (const ConfigValue* found = element.find(key);
            found && found->type == ConfigValue::Type::string)
            return found->text;
    return {};
}

ConfigValue& element_of(ConfigValue& array, const std::string& part, const std::string& kind,
                        const std::string& place) {
    std::vector<std::string> names;
    for (ConfigValue& element : array.items) {
        names.push_back(element_name(element));
        if (names.back() == part) return element;
    }
    size_t index = 0;
    const auto end = part.data() + part.size();
    if (std::from_chars(part.data(), end, index).ptr == end && index < array.items.size())
        return *std::next(array.items.begin(), long(index));
    std::erase(names, "");
    throw InputError(place + ": " + unknown_name(kind, part, names));
}

std::vector<std::string> keys_of(const ConfigValue& table) {
    std::vector<std::string> keys;
    for (const ConfigValue& item : table.items) keys.push_back(item.key);
    return keys;
}

/// The item of a table that a part names, added if that is allowed.
ConfigValue& item_of(ConfigValue& table, const std::string& part, const std::string& kind,
                     const std::string& place) {
    if (ConfigValue* found = table.find(part)) return *found;
    if (kind == "accelerator")
        throw InputError(place + ": " + unknown_name(kind, part, keys_of(table)));
    ConfigValue& added = table.set(part, ConfigValue{});
    added.place = added.key_place = place;
    return added;
}

/// A group of paths that take their values together, e.g. one key of the grid, or the whole zip.
struct Axis {
    std::vector<std::string> paths;
    std::vector<std::vector<ConfigValue>> values;  ///< per path, all of one length
    size_t size() const { return values.front().size(); }
};

std::vector<ConfigValue> axis_values(const ConfigValue& array, const std::string& path) {
    if (!array.is_array())
        throw InputError(array.place + ": " + path + ": expected an array of values, found " +
                         array.type_text());
    if (array.items.empty()) throw InputError(array.place + ": " + path + ": no values");
    return {array.items.begin(), array.items.end()};
}

/// Keys of a sweep: quoted paths, or tables that spell them. Depth is bounded by the parser.
void collect(const ConfigValue& table, const std::string& prefix,
             std::vector<std::pair<std::string, std::vector<ConfigValue>>>& out) {
    for (const ConfigValue& item : table.items) {
        if (prefix.empty() && item.key == "zip" && item.is_table()) continue;
        const std::string path = prefix.empty() ? item.key : prefix + "." + item.key;
        if (item.is_table())
            collect(item, path, out);
        else
            out.emplace_back(path, axis_values(item, path));
    }
}

Axis zip_axis(const ConfigValue& zip) {
    std::vector<std::pair<std::string, std::vector<ConfigValue>>> keys;
    for (const ConfigValue& item : zip.items) {
        if (item.is_table())
            collect(item, item.key, keys);
        else
            keys.emplace_back(item.key, axis_values(item, item.key));
    }
    Axis axis;
    for (auto& [path, values] : keys) {
        axis.paths.push_back(path);
        axis.values.push_back(std::move(values));
        if (axis.values.back().size() != axis.size())
            throw InputError(fmt::format("{}: sweep.zip: '{}' has {} values, '{}' has {}",
                                         zip.place, axis.paths.front(), axis.size(), path,
                                         axis.values.back().size()));
    }
    return axis;
}

std::vector<Axis> axes_of(const ConfigValue& sweep) {
    if (!sweep.is_table())
        throw InputError(sweep.place + ": sweep: expected a table, found " + sweep.type_text());
    std::vector<std::pair<std::string, std::vector<ConfigValue>>> grid;
    collect(sweep, "", grid);
    std::vector<Axis> axes;
    for (auto& [path, values] : grid) axes.push_back({{path}, {std::move(values)}});
    if (const ConfigValue* zip = sweep.find("zip"); zip && zip->is_table())
        if (Axis axis = zip_axis(*zip); !axis.paths.empty()) axes.push_back(std::move(axis));
    return axes;
}

}  // namespace

std::vector<std::string> split_path(const std::string& path, const std::string& place) {
    std::vector<std::string> parts;
    std::string part;
    bool quoted = false, was_quoted = false;
    const auto finish = [&] {
        if (part.empty() && !was_quoted)
            throw InputError(place + ": '" + path + "' has an empty part");
        parts.push_back(std::move(part));
        part.clear();
        was_quoted = false;
    };
    for (const char c : path) {
        if (c == '"') {
            quoted = !quoted;
            was_quoted = true;
        } else if (c == '.' && !quoted) {
            finish();
        } else {
            part += c;
        }
    }
    if (quoted) throw InputError(place + ": '" + path + "' has a quote that does not close");
    finish();
    return parts;
}

void set_path(ConfigValue& root, const std::string& path, ConfigValue value,
              const std::vector<std::string>& sections) {
    const std::string place = value.place;
    const std::vector<std::string> parts = split_path(path, place);
    if (std::find(sections.begin(), sections.end(), parts.front()) == sections.end())
        throw InputError(place + ": " + unknown_name("key", parts.front(), sections));
    ConfigValue* at = &root;
    std::string kind;
    for (const std::string& part : parts) {
        if (at->is_array())
            at = &element_of(*at, part, kind, place);
        else if (at->is_table())
            at = &item_of(*at, part, kind, place);
        else
            throw InputError(place + ": '" + kind + "' is " + at->type_text() + ", not a table");
        kind = part;
    }
    value.key = at->key;
    value.key_place = place;
    *at = std::move(value);
}

void apply_setting(ConfigValue& root, const std::string& setting,
                   const std::vector<std::string>& sections) {
    const std::string place = "--set " + setting;
    const size_t equals = setting.find('=');
    if (equals == std::string::npos || equals == 0)
        throw InputError(place + ": expected path=value");
    set_path(root, setting.substr(0, equals), parse_config_value(setting.substr(equals + 1), place),
             sections);
}

std::vector<SweepPoint> expand_sweep(const ConfigValue& root,
                                     const std::vector<std::string>& sections) {
    SweepPoint base;
    base.config = root;
    std::erase_if(base.config.items, [](const ConfigValue& item) { return item.key == "sweep"; });
    const ConfigValue* sweep = root.find("sweep");
    if (!sweep) return {base};
    std::vector<SweepPoint> points = {base};
    for (const Axis& axis : axes_of(*sweep)) {
        std::vector<SweepPoint> next;
        if (points.size() * axis.size() > 10000)
            throw InputError(sweep->place + ": sweep: more than 10000 combinations");
        for (const SweepPoint& point : points) {
            for (size_t i = 0; i < axis.size(); ++i) {
                SweepPoint p = point;
                for (size_t k = 0; k < axis.paths.size(); ++k) {
                    set_path(p.config, axis.paths[k], axis.values[k][i], sections);
                    p.values.emplace_back(axis.paths[k], axis.values[k][i]);
                }
                next.push_back(std::move(p));
            }
        }
        points = std::move(next);
    }
    return points;
}

}  // namespace crofton
