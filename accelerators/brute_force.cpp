#include "accelerators/brute_force.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/brute_force.cpp"
#include <hwy/foreach_target.h>

#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

struct BruteForceTraversal {
    template <Query Q, class Set, class C>
    static bool run(const BruteForce<Set>& all, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        float t_near, t_far;
        if (all.count == 0 || !meets_box(all.box, ray, q, t_near, t_far)) return false;
        counters.step();
        counters.cell(false);
        return test_leaf<Q>(set, all.leaves, 0, all.count, ray, q, counters);
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(BruteForce, BruteForceTraversal, BruteForceParameters)

#if HWY_ONCE
namespace crofton {

template <class Set>
BruteForce<Set> BruteForce<Set>::build(const Set& set, const BruteForceParameters&) {
    BruteForce all;
    std::vector<uint32_t> shapes;
    double sum = 0;
    for (uint32_t i = 0; i < set.size(); ++i) {
        if (!set.active(i)) continue;
        shapes.push_back(i);
        all.box.extend(set.bounds(i));
        sum += set.cost(i);
    }
    all.count = uint32_t(shapes.size());
    all.leaves.add(set, shapes);
    all.cost = Leaves<Set>::cost(sum, all.count);
    return all;
}

template <class Set>
StructureStatistics BruteForce<Set>::statistics() const {
    StructureStatistics s;
    s.N_V = count > 0 ? 1 : 0;
    s.N_OIV = count;
    s.bytes = leaves.bytes();
    return s;
}

template <class Set>
void BruteForce<Set>::walk(const BoxVisitor& visit) const {
    if (count > 0) visit(box, 0, true, count);
}

CROFTON_REGISTER_ACCELERATOR(BruteForce, BruteForceParameters, "brute_force",
                             "no structure: every shape is tested", "-");

}  // namespace crofton
#endif
