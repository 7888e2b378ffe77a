#include "experiments/row.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <unordered_map>

namespace crofton {
namespace {

using Json = nlohmann::ordered_json;

Json json_of(const ConfigValue& value) {
    switch (value.type) {
        case ConfigValue::Type::boolean:
            return value.boolean;
        case ConfigValue::Type::integer:
            return value.integer;
        case ConfigValue::Type::real:
            return value.real;
        case ConfigValue::Type::string:
            return value.text;
        default:
            break;
    }
    Json out = value.is_array() ? Json::array() : Json::object();
    for (const ConfigValue& item : value.items) {
        if (value.is_array())
            out.push_back(json_of(item));
        else
            out[item.key] = json_of(item);
    }
    return out;
}

void put_structure(Json& json, const StructureStatistics& s) {
    json["bytes"] = s.bytes;
    json["N_IN"] = s.N_IN;
    json["N_V"] = s.N_V;
    json["N_EV"] = s.N_EV;
    json["N_OIV"] = s.N_OIV;
    json["structure_depth"] = s.depth;
}

/// Averages per ray.
void put_counters(Json& json, const Counters& c, uint64_t rays) {
    const double n = double(rays);
    json["N_IT"] = double(c.N_IT) / n;
    json["N_TS"] = double(c.N_TS) / n;
    json["N_ETS"] = double(c.N_ETS) / n;
    json["N_EETS"] = double(c.N_EETS) / n;
}

void put_timing(Json& json, const Row& row) {
    json["ns_per_ray"] = row.ns_per_ray.median;
    json["ns_per_ray_low"] = row.ns_per_ray.low;
    json["ns_per_ray_high"] = row.ns_per_ray.high;
    json["interval_coverage"] = row.ns_per_ray.coverage;
    json["ns_per_ray_raw"] = row.ns_per_ray_raw;
    json["expected_ns"] = row.expected_ns;
    json["repeats"] = row.repeats;
    json["rays_timed"] = row.rays_timed;
    json["threads"] = row.threads;
    json["core"] = row.core;
    json["isa"] = row.isa;
    json["host"] = row.host;
}

/// Against the oracle; rates per 10^9 rays.
void put_errors(Json& json, const VerifyTally& t) {
    const double each = 1e9 / double(t.rays);
    const auto sum = [](const VerifyTally::Split& s) { return s.inside + s.outside; };
    json["oracle_rays"] = t.rays;
    json["misses_per_1e9"] = double(sum(t.false_misses)) * each;
    json["false_hits_per_1e9"] = double(sum(t.false_hits)) * each;
    json["wrong_primitives_per_1e9"] = double(sum(t.wrong_primitives)) * each;
    json["outside_margin"] = t.false_misses.outside + t.false_hits.outside +
                             t.wrong_primitives.outside + t.wrong_t.outside;
    json["t_ulp_p50"] = t.t_ulp.quantile(0.5);
    json["t_ulp_p99_9"] = t.t_ulp.quantile(0.999);
    json["t_ulp_max"] = t.t_ulp.largest();
}

/// Nested structures as text; deeper than `levels` only an ellipsis.
class Description {
  public:
    std::string of(const Primitive& primitive, int levels) {
        if (const auto found = memo_.find(&primitive); found != memo_.end()) return found->second;
        if (levels == 0) return "…";
        std::vector<std::string> inside;
        primitive.children([&](const Primitive& child) {
            const std::string text = of(child, levels - 1);
            if (std::find(inside.begin(), inside.end(), text) == inside.end())
                inside.push_back(text);
        });
        std::sort(inside.begin(), inside.end());
        std::string joined;
        for (const std::string& text : inside) joined += (joined.empty() ? "" : " ") + text;
        const std::string type = primitive.type_name();
        const bool wrapper = type == "instance" || type == "part";
        std::string text = wrapper ? joined : type;
        if (!wrapper && !joined.empty()) text += "(" + joined + ")";
        if (!wrapper) memo_[&primitive] = text;
        return text;
    }

  private:
    std::unordered_map<const Primitive*, std::string> memo_;
};

}  // namespace

std::string describe(const Primitive& root) { return Description().of(root, 12); }

std::string to_json_line(const Row& row) {
    Json json;
    json["scene"] = row.scene;
    json["variant"] = row.variant;
    json["accelerator"] = row.accelerator;
    json["mode"] = row.mode;
    json["single"] = row.single;
    json["workload"] = row.workload;
    json["query"] = row.query;
    json["rays"] = row.rays;
    json["hits"] = row.hits;
    json["rays_checked"] = row.rays_checked;
    json["hits_checksum"] = row.hits_checksum;
    json["mismatches"] = row.mismatches;
    json["checked_against"] = row.checked_against;
    json["depth_error"] = nullptr;
    if (row.depth_error)
        json["depth_error"] = {{"rms", row.depth_error->rms},
                               {"max", row.depth_error->max},
                               {"hit_or_miss", row.depth_error->hit_or_miss}};
    json["triangles"] = row.triangles;
    json["triangles_instanced"] = row.triangles_instanced;
    json["shapes"] = row.shapes;
    json["instances"] = row.instances;
    json["build_s"] = row.build_s;
    if (row.first_image_s > 0) {
        json["first_image_s"] = row.first_image_s;
        json["first_image_bytes"] = row.first_image_bytes;
    }
    if (row.budget) {
        json["budget_rays"] = row.budget->rays;
        json["choose_s"] = row.budget->choose_s;
        json["total_s"] = row.budget->total_s;
    }
    if (row.predicted) {
        if (!row.budget) json["choose_s"] = row.predicted->choose_s;
        json["predicted_build_s"] = row.predicted->build_s;
        json["predicted_bytes"] = row.predicted->bytes;
        json["predicted_ns_per_ray"] = row.predicted->ns_per_ray;
        json["expected_ns_per_ray"] = row.predicted->expected_ns;
    }
    put_structure(json, row.structure);
    put_counters(json, row.counters, row.rays_checked);
    put_timing(json, row);
    if (row.oracle.rays > 0) put_errors(json, row.oracle);
    json["seed"] = row.seed;
    json["key"] = row.key;
    json["sweep"] = Json::object();
    for (const auto& [path, value] : row.sweep) json["sweep"][path] = json_of(value);
    // Names come from files: what is not UTF-8 is replaced rather than refused.
    return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace crofton
