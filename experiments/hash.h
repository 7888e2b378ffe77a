#pragma once

#include <fmt/format.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace crofton {

/// FNV-1a, 64 bits (Fowler, Noll, Vo 1991): names inputs and results, not meant against attackers.
class Fnv1a {
  public:
    void add(const void* data, size_t bytes) {
        const auto* p = static_cast<const unsigned char*>(data);
        for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 0x100000001b3ull;
    }
    void add(std::string_view text) {
        add(text.data(), text.size());
        add("\0", 1);
    }
    uint64_t value() const { return value_; }
    std::string hex() const { return fmt::format("{:016x}", value_); }

  private:
    uint64_t value_ = 0xcbf29ce484222325ull;
};

}  // namespace crofton
