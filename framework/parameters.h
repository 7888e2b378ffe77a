#pragma once

#include <array>
#include <string>
#include <vector>

#include "framework/error.h"
#include "framework/registry.h"

namespace crofton {

/// An accelerator declares its parameters once, as
/// `template <class V> void fields(V& v) { v.integer("bins", bins, 2, 64, "…"); … }`
/// in its parameter struct; the visitors below list them, or read them from a config.
class ParameterLister {
  public:
    explicit ParameterLister(std::vector<ParameterInfo>& infos) : infos_(infos) {}

    void integer(const char* name, int& field, int minimum, int maximum, const char* description) {
        infos_.push_back({name, int64_t(field), double(minimum), double(maximum), {}, description});
    }
    void real(const char* name, double& field, double minimum, double maximum,
              const char* description) {
        infos_.push_back({name, field, minimum, maximum, {}, description});
    }
    void boolean(const char* name, bool& field, const char* description) {
        infos_.push_back({name, field, 0, 0, {}, description});
    }
    /// `field` is an enum whose values count up from 0 in the order of `names`.
    template <class E>
    void choice(const char* name, E& field, std::vector<std::string> names,
                const char* description) {
        const std::string value = names[size_t(field)];
        infos_.push_back({name, value, 0, 0, std::move(names), description});
    }

  private:
    std::vector<ParameterInfo>& infos_;
};

class ParameterReader {
  public:
    explicit ParameterReader(const ParameterValues& values) : values_(values) {}

    void integer(const char* name, int& field, int, int, const char*) {
        if (const auto* v = find(name)) field = int(std::get<int64_t>(*v));
    }
    void real(const char* name, double& field, double, double, const char*) {
        if (const auto* v = find(name)) field = std::get<double>(*v);
    }
    void boolean(const char* name, bool& field, const char*) {
        if (const auto* v = find(name)) field = std::get<bool>(*v);
    }
    template <class E>
    void choice(const char* name, E& field, const std::vector<std::string>& names, const char*) {
        const auto* v = find(name);
        for (size_t i = 0; v && i < names.size(); ++i)
            if (names[i] == std::get<std::string>(*v)) field = E(i);
    }

  private:
    const ParameterValue* find(const char* name) const {
        const auto it = values_.find(name);
        return it == values_.end() ? nullptr : &it->second;
    }
    const ParameterValues& values_;
};

template <class Parameters>
std::vector<ParameterInfo> list_parameters() {
    std::vector<ParameterInfo> infos;
    Parameters defaults;
    ParameterLister lister(infos);
    defaults.fields(lister);
    return infos;
}

/// @throws InputError  an unknown name, a wrong type, a value out of range
template <class Parameters>
Parameters read_parameters(const ParameterValues& values) {
    const ParameterValues valid = checked(list_parameters<Parameters>(), values);
    Parameters parameters;
    ParameterReader reader(valid);
    parameters.fields(reader);
    return parameters;
}

}  // namespace crofton
