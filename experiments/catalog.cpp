#include "experiments/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "experiments/experiment.h"
#include "framework/registry.h"
#include "scenegraph/procedural/procedural.h"

namespace crofton {
namespace {

using Json = nlohmann::ordered_json;

Json json_of(const ParameterValue& value) {
    return std::visit([](const auto& v) { return Json(v); }, value);
}

bool is_number(const ParameterInfo& p) {
    return std::holds_alternative<int64_t>(p.default_value) ||
           std::holds_alternative<double>(p.default_value);
}

std::string type_of(const ParameterInfo& p) {
    static const char* const names[] = {"boolean", "integer", "real", "string"};
    return names[p.default_value.index()];
}

Json json_of(const ParameterInfo& p) {
    Json json = {{"name", p.name},
                 {"type", type_of(p)},
                 {"default", json_of(p.default_value)},
                 {"description", p.description}};
    if (is_number(p)) json["minimum"] = p.minimum, json["maximum"] = p.maximum;
    if (!p.choices.empty()) json["choices"] = p.choices;
    return json;
}

Json json_of(const AcceleratorInfo& info) {
    Json parameters = Json::array();
    for (const ParameterInfo& p : info.parameters) parameters.push_back(json_of(p));
    return {{"name", info.name},
            {"summary", info.summary},
            {"source", info.source},
            {"parameters", parameters}};
}

Json json_of(const ProceduralScene& scene) {
    Json parameters = Json::array();
    for (const ProceduralParameter& p : scene.parameters)
        parameters.push_back({{"name", p.name},
                              {"type", p.integer ? "integer" : "real"},
                              {"default", p.default_value},
                              {"minimum", p.minimum},
                              {"maximum", p.maximum},
                              {"description", p.summary}});
    return {{"name", scene.name}, {"summary", scene.summary}, {"parameters", parameters}};
}

std::string range_text(const ParameterInfo& p) {
    if (is_number(p)) return fmt::format(", {} … {}", p.minimum, p.maximum);
    std::string text;
    for (const std::string& choice : p.choices)
        text += (text.empty() ? ", one of " : " | ") + choice;
    return text;
}

std::string text_of(const ParameterInfo& p) {
    return fmt::format("      {} = {} ({}{}): {}\n", p.name, to_string(p.default_value), type_of(p),
                       range_text(p), p.description);
}

bool is_common(const ParameterInfo& p) {
    return std::ranges::any_of(common_parameters(),
                               [&](const ParameterInfo& c) { return c.name == p.name; });
}

std::string text_of(const AcceleratorInfo& info) {
    std::string text =
        fmt::format("  {}: {}\n      source: {}\n", info.name, info.summary, info.source);
    for (const ParameterInfo& p : info.parameters)
        if (!is_common(p)) text += text_of(p);
    return text;
}

std::string text_of(const ProceduralScene& scene) {
    std::string text = fmt::format("  procedural:{}: {}\n", scene.name, scene.summary);
    for (const ProceduralParameter& p : scene.parameters)
        text += fmt::format("      {} = {} ({}, {} … {}): {}\n", p.name, p.default_value,
                            p.integer ? "integer" : "real", p.minimum, p.maximum, p.summary);
    return text;
}

}  // namespace

std::string catalog_json() {
    Json json;
    json["accelerators"] = Json::array();
    for (const auto& [name, info] : accelerators()) json["accelerators"].push_back(json_of(info));
    json["workloads"] = Json::array();
    for (const auto& [name, summary] : workload_types())
        json["workloads"].push_back({{"name", name}, {"summary", summary}});
    json["scenes"] = Json::array();
    for (const ProceduralScene& scene : procedural_scenes())
        json["scenes"].push_back(json_of(scene));
    json["file_endings"] = scene_endings();
    json["isas"] = available_isas();
    return json.dump(2) + "\n";
}

std::string catalog_text() {
    std::string text = "Accelerators:\n";
    for (const auto& [name, info] : accelerators()) text += text_of(info);
    text += "  and each of them:\n";
    for (const ParameterInfo& p : common_parameters()) text += text_of(p);
    text += "\nWorkloads:\n";
    for (const auto& [name, summary] : workload_types())
        text += "  " + name + ": " + summary + "\n";
    text += "\nScenes:\n  files:";
    for (const std::string& ending : scene_endings()) text += " ." + ending;
    text += "\n";
    for (const ProceduralScene& scene : procedural_scenes()) text += text_of(scene);
    text += "\nInstruction sets here:";
    for (const std::string& isa : available_isas()) text += " " + isa;
    return text + "\n";
}

}  // namespace crofton
