#include "scenegraph/gltf_container.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstring>
#include <fstream>

#include "framework/error.h"

namespace crofton::gltf {
namespace {

namespace fs = std::filesystem;

constexpr size_t header_size = 12;
constexpr size_t chunk_header_size = 8;
constexpr uint32_t json_chunk = 0x4E4F534A;
constexpr uint32_t bin_chunk = 0x004E4942;

uint32_t little_endian(const Bytes& bytes, size_t offset) {
    return uint32_t(bytes[offset]) | uint32_t(bytes[offset + 1]) << 8 |
           uint32_t(bytes[offset + 2]) << 16 | uint32_t(bytes[offset + 3]) << 24;
}

uint64_t regular_file_size(const fs::path& file) {
    std::error_code error;
    const fs::file_status status = fs::status(file, error);
    if (!fs::exists(status)) throw InputError("no such file");
    if (!fs::is_regular_file(status)) throw InputError("not a regular file");
    const uint64_t size = fs::file_size(file, error);
    if (error) throw InputError("cannot be read: " + error.message());
    return size;
}

bool is_glb(const Bytes& bytes) {
    return bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0;
}

/// Where the GLB's content ends, by its header.
size_t checked_glb_length(const Bytes& bytes, std::vector<std::string>& warnings) {
    if (bytes.size() < header_size) throw InputError("GLB header is cut short");
    const uint32_t version = little_endian(bytes, 4);
    if (version != 2)
        throw InputError("GLB container version " + std::to_string(version) +
                         " is not supported, only 2");
    const size_t length = little_endian(bytes, 8);
    if (length > bytes.size())
        throw InputError("GLB header gives " + std::to_string(length) + " bytes, the file has " +
                         std::to_string(bytes.size()));
    if (length < header_size + chunk_header_size) throw InputError("GLB has no JSON chunk");
    if (length < bytes.size())
        warnings.push_back("GLB: " + std::to_string(bytes.size() - length) +
                           " bytes after its end are ignored");
    return length;
}

struct Chunk {
    uint32_t type;
    size_t begin;
    size_t size;
};

Chunk chunk_at(const Bytes& bytes, size_t offset, size_t end, size_t number) {
    const std::string name = "GLB chunk " + std::to_string(number);
    if (end - offset < chunk_header_size) throw InputError(name + ": header is cut short");
    const size_t size = little_endian(bytes, offset);
    if (size > end - offset - chunk_header_size)
        throw InputError(name + ": " + std::to_string(size) + " bytes do not fit in the file");
    return {little_endian(bytes, offset + 4), offset + chunk_header_size, size};
}

Container split_glb(const Bytes& bytes) {
    Container result;
    const size_t end = checked_glb_length(bytes, result.warnings);
    bool has_binary = false;
    size_t number = 0;
    for (size_t offset = header_size; offset < end; ++number) {
        const Chunk chunk = chunk_at(bytes, offset, end, number);
        const unsigned char* data = bytes.data() + chunk.begin;
        if ((number == 0) != (chunk.type == json_chunk))
            throw InputError("GLB chunk " + std::to_string(number) +
                             (number == 0 ? ": must be JSON" : ": a second JSON chunk"));
        if (number == 0) result.json.assign(data, data + chunk.size);
        if (chunk.type == bin_chunk && !has_binary) {
            result.binary.assign(data, data + chunk.size);
            has_binary = true;
        }
        offset = chunk.begin + chunk.size;
    }
    return result;
}

/// Value of a base64 digit, or -1.
int base64_digit(char c) {
    static constexpr std::string_view alphabet =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    static const std::array<int8_t, 256> values = [] {
        std::array<int8_t, 256> table;
        table.fill(-1);
        for (size_t i = 0; i < alphabet.size(); ++i)
            table[static_cast<unsigned char>(alphabet[i])] = int8_t(i);
        return table;
    }();
    return values[static_cast<unsigned char>(c)];
}

Bytes decode_base64(std::string_view text) {
    size_t digits = text.size();
    while (digits > 0 && text[digits - 1] == '=' && text.size() - digits < 2) --digits;
    Bytes out;
    out.reserve(digits / 4 * 3 + 2);
    uint32_t bits = 0;
    for (size_t i = 0; i < digits; ++i) {
        const int value = base64_digit(text[i]);
        if (value < 0)
            throw InputError("illegal character in base64 data at offset " + std::to_string(i));
        bits = bits << 6 | uint32_t(value);
        if (i % 4 != 0) out.push_back(static_cast<unsigned char>(bits >> (6 - 2 * (i % 4))));
    }
    // Padding must complete the last group of four; it may be left out altogether.
    if (digits % 4 == 1 || (digits < text.size() && text.size() % 4 != 0))
        throw InputError("base64 data has a wrong length");
    return out;
}

int hex_digit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const char lower = char(c | 0x20);
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
}

/// A percent sign that no two hexadecimal digits follow stands for itself.
std::string percent_decoded(std::string_view uri) {
    std::string out;
    for (size_t i = 0; i < uri.size(); ++i) {
        const int high = uri[i] == '%' && i + 2 < uri.size() ? hex_digit(uri[i + 1]) : -1;
        const int low = high >= 0 ? hex_digit(uri[i + 2]) : -1;
        out += low >= 0 ? char(high * 16 + low) : uri[i];
        if (low >= 0) i += 2;
    }
    return out;
}

bool has_scheme(std::string_view uri) {
    const size_t colon = uri.find(':');
    if (colon == std::string_view::npos || colon == 0) return false;
    return std::all_of(uri.begin(), uri.begin() + ptrdiff_t(colon), [](unsigned char c) {
        return std::isalnum(c) || c == '+' || c == '-' || c == '.';
    });
}

bool has_parent_step(const std::string& path) {
    for (size_t begin = 0; begin <= path.size();) {
        const size_t end = std::min(path.find_first_of("/\\", begin), path.size());
        if (path.compare(begin, end - begin, "..") == 0) return true;
        begin = end + 1;
    }
    return false;
}

}  // namespace

Container read_container(const std::string& path) {
    Bytes bytes = read_file(path, regular_file_size(path));
    if (bytes.empty()) throw InputError("the file is empty");
    if (!is_glb(bytes) && path.ends_with(".glb"))
        throw InputError("not a GLB file: it does not start with glTF");
    Container result;
    if (is_glb(bytes))
        result = split_glb(bytes);
    else
        result.json.assign(bytes.begin(), bytes.end());
    if (result.json.starts_with("\xEF\xBB\xBF")) {
        result.json.erase(0, 3);
        result.warnings.push_back("a byte-order mark before the JSON text is ignored");
    }
    return result;
}

void check_json_depth(std::string_view text, int limit) {
    int depth = 0;
    bool in_string = false;
    for (size_t i = 0; i < text.size(); ++i) {
        const char c = text[i];
        if (in_string && c == '\\')
            ++i;
        else if (c == '"')
            in_string = !in_string;
        else if (!in_string && (c == '[' || c == '{') && ++depth > limit)
            throw InputError("JSON nests deeper than " + std::to_string(limit) +
                             " levels at offset " + std::to_string(i));
        else if (!in_string && (c == ']' || c == '}'))
            --depth;
    }
}

bool is_data_uri(std::string_view uri) {
    constexpr std::string_view scheme = "data:";
    return uri.size() >= scheme.size() &&
           std::equal(scheme.begin(), scheme.end(), uri.begin(), [](char a, char b) {
               return a == std::tolower(static_cast<unsigned char>(b));
           });
}

Bytes decode_data_uri(std::string_view uri) {
    constexpr std::string_view marker = ";base64";
    const std::string_view head = uri.substr(0, uri.find(','));
    if (head.size() == uri.size() || !head.ends_with(marker))
        throw InputError("data URI is not base64");
    return decode_base64(uri.substr(head.size() + 1));
}

fs::path confined_path(const fs::path& folder, std::string_view uri) {
    const std::string name = percent_decoded(uri);
    const std::string shown = "URI '" + std::string(uri.substr(0, 100)) + "'";
    if (name.empty()) throw InputError("URI is empty");
    if (name.find('\0') != std::string::npos) throw InputError(shown + " contains a zero byte");
    if (has_scheme(uri)) throw InputError(shown + " has a scheme; only relative paths are read");
    if (name.front() == '/' || name.front() == '\\' || fs::path(name).is_absolute())
        throw InputError(shown + " is an absolute path");
    if (has_parent_step(name)) throw InputError(shown + " leaves the folder of the scene");

    // Symbolic links are followed before the comparison.
    std::error_code error;
    const fs::path root = fs::weakly_canonical(folder.empty() ? fs::path(".") : folder, error);
    const fs::path file = error ? fs::path() : fs::weakly_canonical(root / name, error);
    if (error) throw InputError(shown + " cannot be resolved: " + error.message());
    const auto mismatch = std::mismatch(root.begin(), root.end(), file.begin(), file.end());
    if (mismatch.first != root.end())
        throw InputError(shown + " leaves the folder of the scene by a symbolic link");
    return file;
}

Bytes read_file(const fs::path& file, uint64_t length) {
    const uint64_t size = regular_file_size(file);
    if (size < length)
        throw InputError("the file has " + std::to_string(size) + " bytes, " +
                         std::to_string(length) + " are needed");
    std::ifstream stream(file, std::ios::binary);
    if (!stream) throw InputError("cannot be opened");
    Bytes bytes(length);
    stream.read(reinterpret_cast<char*>(bytes.data()), std::streamsize(length));
    if (uint64_t(stream.gcount()) != length) throw InputError("cannot be read");
    return bytes;
}

}  // namespace crofton::gltf
