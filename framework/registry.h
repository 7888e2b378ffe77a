#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "framework/primitive.h"
#include "framework/primitive_sets.h"

namespace crofton {

class StructureReader;

/// The value of one parameter of an accelerator.
using ParameterValue = std::variant<bool, int64_t, double, std::string>;
using ParameterValues = std::map<std::string, ParameterValue>;

/// One parameter as `crofton list` shows it and as a config is checked against.
struct ParameterInfo {
    std::string name;
    ParameterValue default_value;      ///< its alternative is the parameter's type
    double minimum = 0, maximum = 0;   ///< numbers only, both ends valid
    std::vector<std::string> choices;  ///< strings only: the valid values
    std::string description;
};

/// Text of a value as TOML would write it.
std::string to_string(const ParameterValue& value);

/// Checks one value against `info` and converts an integer where a real is asked for.
/// @throws InputError  without a file: "leaf_size: 99 is outside 1 … 64", "…: expected an integer,
/// found a
///                     string", "unknown value 'x'; did you mean 'y'?"
ParameterValue checked(const ParameterInfo& info, const ParameterValue& value);

/// Checks all of them. @throws InputError  as above, or for an unknown name with the nearest valid
ParameterValues checked(const std::vector<ParameterInfo>& infos, const ParameterValues& values);

struct AcceleratorInfo {
    std::string name;     ///< registry name = file stem
    std::string summary;  ///< one sentence
    std::string source;   ///< authors, year, title
    std::vector<ParameterInfo> parameters;
    /// Builds over any set. Parameters that are missing take their default.
    /// @throws InputError  as `checked`, or for an unknown parameter with the nearest valid name
    std::function<std::unique_ptr<Primitive>(const PrimitiveSet&, const ParameterValues&)> build;
    /// Reads what a built one wrote: see load_structure. Empty: builds others, and is none itself.
    std::function<std::unique_ptr<Primitive>(StructureReader&)> load;

    const ParameterInfo* find(const std::string& parameter) const;
};

/// All accelerators linked into the program, by name; peers are not among them.
const std::map<std::string, AcceleratorInfo>& accelerators();
/// Structures of other libraries to compare with, by name, if the program was built with them. They
/// can stand wherever an accelerator can but promise nothing: neither our bits nor our modes.
const std::map<std::string, AcceleratorInfo>& peers();
void register_peer(AcceleratorInfo info);

/// An accelerator or a peer.
/// @throws InputError  unknown accelerator, with the nearest valid name
const AcceleratorInfo& accelerator(const std::string& name);
std::vector<std::string> accelerator_names();
/// Those that every accelerator has behind its own.
std::vector<ParameterInfo> common_parameters();

/// Reads one of the named type. @throws InputError  an unknown name, or as StructureReader
std::shared_ptr<const Primitive> load_accelerator(const std::string& name, StructureReader& in);

/// Adds an accelerator at program start; used through CROFTON_REGISTER_ACCELERATOR.
bool register_accelerator(AcceleratorInfo info);

/// Name of the instruction set that kernels built from now on use: "sse4", "avx2" or "avx512".
std::string active_isa();
/// Instruction sets that kernels were compiled for and this machine can run, widest last.
std::vector<std::string> available_isas();
/// Restricts kernels built from now on. @throws InputError  unknown or not available here
void set_isa(const std::string& name);

}  // namespace crofton
