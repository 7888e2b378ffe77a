#pragma once

namespace crofton {

/// Puts the structures of other libraries into the registry (see `peers`): "embree", which can be
/// built if CMake found Embree 3 or 4. Those that cannot have no `build`: a run leaves their
/// variants out and says so.
void register_peers();

}  // namespace crofton
