#include "experiments/peers.h"

namespace crofton {

void register_peers() {
    register_peer(embree_peer());
    register_peer(tinybvh_peer());
}

}  // namespace crofton
