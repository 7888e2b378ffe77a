// Gathering of triangles by reference into blocks, in the code of the baseline instruction set.

#include <cmath>
#include <vector>

#include "framework/simd.h"
#include "tests/catch.h"

namespace crofton {

TEST_CASE("gathered by reference, a triangle stands in one lane, and spare lanes cannot be hit") {
    const std::vector<Vec3f> p{{0, 0, 1}, {1, 0, 2}, {0, 1, 3}, {5, 4, 6}};
    const TriangleSet set(p, {{0, 1, 2}, {1, 3, 2}, {0, 3, 1}});
    const uint32_t references[] = {2, 0, 1, 2};
    for (uint32_t count = 1; count <= 4; ++count) {
        TriangleBlock<4> block;
        HWY_STATIC_DISPATCH(gather_block)(set, references, count, block);
        for (uint32_t lane = 0; lane < 4; ++lane) {
            INFO(count << " references, lane " << lane);
            CHECK(block.id[lane] == (lane < count ? references[lane] : no_id));
            for (int k = 0; k < 3; ++k)
                for (int a = 0; a < 3; ++a) {
                    const float x = block.v[k][a][lane];
                    if (lane < count)
                        CHECK(x == set.vertex(references[lane], k)[a]);
                    else
                        CHECK(std::isnan(x));
                }
        }
    }
}

}  // namespace crofton
