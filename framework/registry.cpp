#include "framework/registry.h"

#include <hwy/targets.h>

#include <algorithm>
#include <cstdlib>

#include "framework/error.h"
#include "framework/lazy.h"
#include "framework/parameters.h"

namespace crofton {
namespace {

std::map<std::string, AcceleratorInfo>& table() {
    static std::map<std::string, AcceleratorInfo> entries;
    return entries;
}

std::map<std::string, AcceleratorInfo>& peer_table() {
    static std::map<std::string, AcceleratorInfo> entries;
    return entries;
}

const char* type_name(const ParameterValue& v) {
    static constexpr const char* names[] = {"a boolean", "an integer", "a number", "a string"};
    return names[v.index()];
}

std::string number(double x) {
    std::string s = std::to_string(x);
    s.erase(s.find_last_not_of('0') + 1);
    if (s.back() == '.') s.pop_back();
    return s;
}

struct Isa {
    const char* name;
    int64_t target;
};
constexpr Isa isas[] = {{"sse4", HWY_SSE4}, {"avx2", HWY_AVX2}, {"avx512", HWY_AVX3}};

int64_t& active_target() {
    static int64_t target = 0;
    return target;
}

/// Those of `values` that `infos` names, or all others.
ParameterValues part_of(const ParameterValues& values, const std::vector<ParameterInfo>& infos,
                        bool named) {
    ParameterValues part;
    for (const auto& value : values)
        if (named == std::any_of(infos.begin(), infos.end(), [&](const ParameterInfo& info) {
                return info.name == value.first;
            }))
            part.insert(value);
    return part;
}

/// Widest one at first use; the environment variable CROFTON_ISA narrows it.
int64_t ensure_target() {
    if (active_target() == 0) {
        const char* wanted = std::getenv("CROFTON_ISA");
        set_isa(wanted && *wanted ? wanted : available_isas().back());
    }
    return active_target();
}

}  // namespace

std::string to_string(const ParameterValue& value) {
    if (const bool* b = std::get_if<bool>(&value)) return *b ? "true" : "false";
    if (const int64_t* i = std::get_if<int64_t>(&value)) return std::to_string(*i);
    if (const double* d = std::get_if<double>(&value)) return number(*d);
    return '"' + std::get<std::string>(value) + '"';
}

ParameterValue checked(const ParameterInfo& info, const ParameterValue& value) {
    ParameterValue v = value;
    if (const int64_t* i = std::get_if<int64_t>(&v)) {
        if (std::holds_alternative<double>(info.default_value)) v = double(*i);
        if (!info.choices.empty()) v = std::to_string(*i);
    }
    if (v.index() != info.default_value.index())
        throw InputError(info.name + ": expected " + type_name(info.default_value) + ", found " +
                         type_name(v));
    if (const std::string* s = std::get_if<std::string>(&v)) {
        if (std::find(info.choices.begin(), info.choices.end(), *s) == info.choices.end())
            throw InputError(info.name + ": " + unknown_name("value", *s, info.choices));
        return v;
    }
    if (std::holds_alternative<bool>(v)) return v;
    const double x =
        std::holds_alternative<int64_t>(v) ? double(std::get<int64_t>(v)) : std::get<double>(v);
    if (!(x >= info.minimum && x <= info.maximum))
        throw InputError(info.name + ": " + to_string(v) + " is outside " + number(info.minimum) +
                         " ... " + number(info.maximum));
    return v;
}

ParameterValues checked(const std::vector<ParameterInfo>& infos, const ParameterValues& values) {
    ParameterValues valid;
    for (const auto& [name, value] : values) {
        const ParameterInfo* info = nullptr;
        std::vector<std::string> names;
        for (const ParameterInfo& i : infos) {
            names.push_back(i.name);
            if (i.name == name) info = &i;
        }
        if (!info) throw InputError(unknown_name("parameter", name, names));
        valid[name] = checked(*info, value);
    }
    return valid;
}

const ParameterInfo* AcceleratorInfo::find(const std::string& parameter) const {
    for (const ParameterInfo& info : parameters)
        if (info.name == parameter) return &info;
    return nullptr;
}

const std::map<std::string, AcceleratorInfo>& accelerators() { return table(); }
const std::map<std::string, AcceleratorInfo>& peers() { return peer_table(); }

void register_peer(AcceleratorInfo info) {
    if (info.build)
        info.build = [inner = std::move(info.build), all = info.parameters](
                         const PrimitiveSet& set, const ParameterValues& values) {
            return inner(set, checked(all, values));
        };
    const std::string name = info.name;
    peer_table().emplace(name, std::move(info));
}

std::vector<std::string> accelerator_names() {
    std::vector<std::string> names;
    for (const auto& [name, info] : table()) names.push_back(name);
    return names;
}

const AcceleratorInfo& accelerator(const std::string& name) {
    if (const auto peer = peer_table().find(name); peer != peer_table().end()) return peer->second;
    const auto it = table().find(name);
    if (it == table().end())
        throw InputError(unknown_name("accelerator", name, accelerator_names()));
    return it->second;
}

std::shared_ptr<const Primitive> load_accelerator(const std::string& name, StructureReader& in) {
    ensure_target();
    const AcceleratorInfo& info = accelerator(name);
    if (!info.load) throw InputError("'" + name + "' is no structure of its own");
    return info.load(in);
}

std::vector<ParameterInfo> common_parameters() { return list_parameters<LazyOptions>(); }

bool register_accelerator(AcceleratorInfo info) {
    const std::string name = info.name;
    const std::vector<ParameterInfo> common = common_parameters();
    info.parameters.insert(info.parameters.end(), common.begin(), common.end());
    // Every build first makes sure that an instruction set is chosen.
    info.build = [inner = std::move(info.build), all = info.parameters, common](
                     const PrimitiveSet& set, const ParameterValues& values) {
        ensure_target();
        const ParameterValues valid = checked(all, values);
        const LazyOptions options = read_parameters<LazyOptions>(part_of(valid, common, true));
        const LazyBuild build = [inner, own = part_of(valid, common, false)](
                                    const PrimitiveSet& s) { return inner(s, own); };
        return options.lazy ? build_lazily(set, build, options.lazy_size) : build(set);
    };
    return table().emplace(name, std::move(info)).second;
}

std::vector<std::string> available_isas() {
    std::vector<std::string> names;
    for (const Isa& isa : isas)
        if (hwy::SupportedTargets() & HWY_TARGETS & isa.target) names.push_back(isa.name);
    return names;
}

std::string active_isa() {
    const int64_t target = ensure_target();
    for (const Isa& isa : isas)
        if (isa.target == target) return isa.name;
    return "";
}

void set_isa(const std::string& name) {
    const std::vector<std::string> names = available_isas();
    if (std::find(names.begin(), names.end(), name) == names.end())
        throw InputError(unknown_name("instruction set", name, names));
    for (const Isa& isa : isas)
        if (name == isa.name) active_target() = isa.target;
    hwy::GetChosenTarget().Update(active_target());
}

}  // namespace crofton
