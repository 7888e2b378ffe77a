#pragma once

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>

namespace crofton {

/// A file in the temporary directory, removed at the end of the test.
class ScratchFile {
  public:
    ScratchFile(const std::string& name, std::string_view content) {
        const std::string unique =
            "crofton_" + std::to_string(getpid()) + "_" + std::to_string(counter()++);
        directory_ = std::filesystem::temp_directory_path() / unique;
        std::filesystem::create_directories(directory_);
        path_ = (directory_ / name).string();
        std::ofstream(path_, std::ios::binary) << content;
    }
    ~ScratchFile() {
        std::error_code ignored;
        std::filesystem::remove_all(directory_, ignored);
    }
    ScratchFile(const ScratchFile&) = delete;
    ScratchFile& operator=(const ScratchFile&) = delete;

    const std::string& path() const { return path_; }

  private:
    static int& counter() {
        static int count = 0;
        return count;
    }
    std::filesystem::path directory_;
    std::string path_;
};

}  // namespace crofton
