#include "experiments/results.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cctype>
#include <chrono>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "framework/calibration.h"
#include "framework/error.h"
#include "framework/registry.h"
#include "revision.h"

namespace crofton {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string now_text(const char* format) {
    const std::time_t now = std::time(nullptr);
    std::tm local{};
    localtime_r(&now, &local);
    char text[64];
    return {text, std::strftime(text, sizeof text, format, &local)};
}

std::string default_folder(const std::string& stem) {
    const std::string base = "results/" + file_name_of(stem) + "-" + now_text("%Y%m%d-%H%M%S");
    std::string folder = base;
    for (int i = 2; fs::exists(folder); ++i) folder = fmt::format("{}-{}", base, i);
    return folder;
}

Json load_average() {
    double load[3];
    if (getloadavg(load, 3) != 3) return nullptr;
    return Json::array({load[0], load[1], load[2]});
}

}  // namespace

Results::Results(const std::string& folder, const std::string& stem)
    : folder_(folder.empty() ? default_folder(stem) : folder) {
    std::error_code error;
    fs::create_directories(folder_, error);
    rows_ = std::fopen(path("rows.jsonl").c_str(), "w");
    if (!rows_) throw InputError(folder_ + ": cannot be written");
}

Results::~Results() {
    if (rows_) std::fclose(rows_);
}

void Results::write_text(const std::string& file, const std::string& text) const {
    std::ofstream out(path(file), std::ios::binary);
    out << text;
    out.close();
    if (!out) throw InputError(path(file) + ": cannot be written");
}

void Results::add(const Row& row) {
    const std::string line = to_json_line(row) + "\n";
    if (std::fwrite(line.data(), 1, line.size(), rows_) != line.size() || std::fflush(rows_) != 0)
        throw InputError(path("rows.jsonl") + ": cannot be written");
}

std::string manifest_json(const std::string& config,
                          const std::map<std::string, std::string>& inputs,
                          const std::map<std::string, uint64_t>& seeds) {
    Json json;
    json["crofton"] = CROFTON_VERSION;
    json["date"] = now_text("%Y-%m-%dT%H:%M:%S%z");
    json["config"] = config;
    json["revision"] = CROFTON_REVISION;
    json["dirty"] = bool(CROFTON_DIRTY);
    json["compiler"] = CROFTON_COMPILER;
    json["build_type"] = CROFTON_BUILD_TYPE;
    json["flags"] = CROFTON_FLAGS;
    json["host"] = host_name();
    json["cpu"] = cpu_model();
    json["cores"] = std::thread::hardware_concurrency();
    json["load_average"] = load_average();
    json["isa"] = active_isa();
    json["isas_available"] = available_isas();
    json["packages"] = Json::parse(CROFTON_PACKAGES);
    json["seeds"] = seeds;
    json["inputs"] = inputs;
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string version_text() { return fmt::format("{} ({})", CROFTON_VERSION, CROFTON_REVISION); }

std::string revision_text() {
    return std::string(CROFTON_REVISION) + (CROFTON_DIRTY ? "-dirty" : "");
}

std::string host_name() {
    char name[256] = "";
    gethostname(name, sizeof name - 1);
    return name;
}

std::string file_name_of(const std::string& name) {
    std::string out;
    for (const char c : name) {
        const bool plain =
            std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-' || c == '.';
        out += plain ? c : '_';
    }
    return out.empty() || out.front() == '.' ? "_" + out : out;
}

}  // namespace crofton
