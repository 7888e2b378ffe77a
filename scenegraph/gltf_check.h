#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

/// Validation of glTF JSON before a parser that believes everything sees it. Internal to the glTF
/// loader. Errors are InputErrors of the form "place: what".
namespace crofton::gltf {

/// Remarks on what was ignored or repaired. Equal remarks about many places become one line.
class Remarks {
  public:
    void add(const std::string& what, const std::string& place);
    /// One line per kind of remark, in order of first appearance.
    std::vector<std::string> lines() const;

  private:
    struct Kind {
        std::string what, first_place;
        uint64_t count;
    };
    std::vector<Kind> kinds_;
    std::map<std::string, size_t> kind_of_;
};

/// How a buffer's bytes are to be had.
struct BufferSource {
    uint64_t byte_length = 0;
    bool has_uri = false;
    std::string uri;
    bool used = false;  ///< by geometry; other buffers need not be read
};

/// Attribute under which `CheckedDocument::json` refers to an index accessor without a buffer view.
/// The parser refuses such an accessor under "indices", although the format allows it.
inline constexpr const char* viewless_indices = "_CROFTON_INDICES";

/// A document that holds only what the loader reads, all of it checked: types, index ranges,
/// acyclic nodes, and every accessor that geometry uses inside its view and buffer.
/// Buffer i has the URI buffer_name(i); unused buffers have length 1.
struct CheckedDocument {
    std::string json;
    std::vector<BufferSource> buffers;
};
std::string buffer_name(size_t index);
/// The inverse of buffer_name; SIZE_MAX for any other text.
size_t buffer_index(const std::string& name);

/// Checks a whole document. Does not recurse deeper than the fixed limit on JSON nesting; linear in
/// the text's size.
/// @param has_binary  whether buffer 0 without a URI stands for the container's BIN chunk
/// @throws InputError  at the first thing that cannot be used
CheckedDocument check_document(const std::string& text, bool has_binary, Remarks& remarks);

}  // namespace crofton::gltf
