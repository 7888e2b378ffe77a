#pragma once

#include <nlohmann/json_fwd.hpp>

namespace crofton::gltf {

/// Checks that every property that glTF 2.0 defines has the JSON type that it must have, also those
/// that the loader ignores: a file that is wrong there cannot be trusted elsewhere. Unknown
/// properties, extras and the contents of extensions are left alone; missing ones are not noticed.
/// Linear in the size of the document; recursion is as deep as the format's own structure, 6.
/// @throws InputError  "place: what" for the first wrong type
void check_types(const nlohmann::json& document);

}  // namespace crofton::gltf
