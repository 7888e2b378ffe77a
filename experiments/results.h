#pragma once

#include <cstdio>
#include <map>
#include <string>

#include "experiments/row.h"
#include "framework/config.h"

namespace crofton {

/// The folder of a run: resolved.toml, manifest.json, rows.jsonl and pictures.
class Results {
  public:
    /// @param folder  "" = results/STEM-TIME in the working folder; otherwise replaced if it holds
    /// a run
    /// @throws InputError  cannot be written
    Results(const std::string& folder, const std::string& stem);
    ~Results();
    Results(const Results&) = delete;
    Results& operator=(const Results&) = delete;

    const std::string& folder() const { return folder_; }
    std::string path(const std::string& file) const { return folder_ + "/" + file; }
    void write_text(const std::string& file, const std::string& text) const;
    /// Appends a line and flushes it, so that a run that fails keeps its rows.
    void add(const Row& row);

  private:
    std::string folder_;
    std::FILE* rows_ = nullptr;
};

/// Revision, compiler, machine, inputs: what a reader needs to judge or repeat a run, as JSON.
/// @param inputs  hash by file
std::string manifest_json(const std::string& config,
                          const std::map<std::string, std::string>& inputs,
                          const std::map<std::string, uint64_t>& seeds);

/// Version of crofton, e.g. "0.1.0 (a1b2c3d)".
std::string version_text();
/// Revision of the source the program was built from; "unknown" outside of a repository.
std::string revision_text();
std::string host_name();

/// A name with everything but letters, digits and _ - . replaced by '_'.
std::string file_name_of(const std::string& name);

}  // namespace crofton
