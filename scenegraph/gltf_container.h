#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

/// The bytes of a glTF asset: container, data URIs and external files. Internal to the glTF loader.
/// Errors are InputErrors without the path of the scene, which load_gltf puts in front.
namespace crofton::gltf {

using Bytes = std::vector<unsigned char>;

/// A .gltf or .glb file taken apart.
struct Container {
    std::string json;  ///< without byte-order mark
    Bytes binary;      ///< the first BIN chunk; empty if there is none
    std::vector<std::string> warnings;
};

/// Reads a regular file and, if it starts with "glTF", checks the header and every chunk.
/// @throws InputError  if it cannot be read, is cut short, or is not version 2
Container read_container(const std::string& path);

/// Fails if brackets nest deeper than `limit`, so that no recursive parser can exhaust the stack.
/// Iterative; brackets in strings do not count. @throws InputError
void check_json_depth(std::string_view text, int limit);

/// Whether a URI starts with "data:" in any case of letters.
bool is_data_uri(std::string_view uri);

/// The bytes of a base64 data URI. Missing padding is accepted, any other irregularity is not.
/// @throws InputError  if it is not base64 or has characters outside of its alphabet
Bytes decode_data_uri(std::string_view uri);

/// The file that a relative URI names, percent-decoded.
/// @throws InputError  if it has a scheme, is absolute, or leaves `folder`, also by a symbolic link
std::filesystem::path confined_path(const std::filesystem::path& folder, std::string_view uri);

/// The first `length` bytes of a regular file. @throws InputError  if it is missing or shorter
Bytes read_file(const std::filesystem::path& file, uint64_t length);

}  // namespace crofton::gltf
