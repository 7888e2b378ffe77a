// The leaf test of TrianglePatches; included once per target, after simd.h.
#if defined(CROFTON_FRAMEWORK_PATCH_TEST_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef CROFTON_FRAMEWORK_PATCH_TEST_H_
#undef CROFTON_FRAMEWORK_PATCH_TEST_H_
#else
#define CROFTON_FRAMEWORK_PATCH_TEST_H_
#endif

#include "framework/simd.h"
#include "framework/triangle_patches.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// One number for each of a patch's eight corners, in one vector or two.
struct PatchTable {
    using D = Lanes<8>;
    using V = hn::Vec<D>;
    static constexpr size_t N = hn::MaxLanes(D()), parts = 8 / N;
    V part[parts];

    /// Of N triangles the numbers of one corner. @param corner  N indices
    HWY_INLINE V lookup(const uint8_t* corner) const {
        const D d;
        const hn::Rebind<uint8_t, D> d8;
        const hn::RebindToSigned<D> d32;
        const auto corners = hn::PromoteTo(d32, hn::LoadU(d8, corner));
        const auto last = hn::Set(d32, int32_t(N) - 1);
        if constexpr (parts == 1) {
            // Of spare triangles the bytes may be anything. The permutation reads the lower three
            // bits; only Highway's check in debug builds minds the others.
            const auto index = HWY_IS_DEBUG_BUILD ? hn::And(corners, last) : corners;
            return hn::TableLookupLanes(part[0], hn::IndicesFromVec(d, index));
        } else {
            const auto index = hn::IndicesFromVec(d, hn::And(corners, last));
            return hn::IfThenElse(hn::RebindMask(d, hn::Gt(corners, last)),
                                  hn::TableLookupLanes(part[1], index),
                                  hn::TableLookupLanes(part[0], index));
        }
    }
};

/// A patch's corners in world space, sheared as `shear` does it: the same operations in the same
/// order, so the same bits.
template <bool Framed>
struct ShearedPatch {
    using D = PatchTable::D;
    PatchTable x, y, z;

    template <class Patch>
    HWY_INLINE ShearedPatch(const Patch& patch, const RayQuery& q, const InstanceFrame* frame) {
        const D d;
        const auto sx = hn::Set(d, q.shear_x), sy = hn::Set(d, q.shear_y);
        for (size_t p = 0; p < PatchTable::parts; ++p) {
            const auto relative = [&](int axis) HWY_ATTR {
                return hn::Sub(world_coordinate<Framed>(d, patch.v, p * PatchTable::N, axis, frame),
                               hn::Set(d, q.origin[axis]));
            };
            z.part[p] = relative(q.kz);
            x.part[p] = hn::Sub(relative(q.kx), hn::Mul(sx, z.part[p]));
            y.part[p] = hn::Sub(relative(q.ky), hn::Mul(sy, z.part[p]));
        }
    }
};

template <bool Framed, class Patch>
HWY_NOINLINE SolvedLane refine_triangle_of(const Patch& patch, uint32_t triangle, const RayQuery& q,
                                           const InstanceFrame* frame) {
    const Vec3f corner[3] = {patch.vertex(triangle, 0), patch.vertex(triangle, 1),
                             patch.vertex(triangle, 2)};
    return refine_corners<Framed>(corner, q, frame);
}

/// N triangles of a patch (a TrianglePatch or a FetchedPatch), for test_corners.
template <bool Framed, class Patch>
struct PatchLanes {
    using D = PatchTable::D;
    const Patch& patch;
    const uint32_t* ids;  ///< of all patches
    size_t lane;
    const InstanceFrame* frame;

    HWY_INLINE float world(uint32_t i, int k, int axis) const {
        return world_coordinate<Framed>(patch.v, patch.corner[k][lane + i], axis, frame);
    }
    HWY_INLINE uint32_t used(uint32_t lanes) const {
        return lanes & ((1u << (patch.count - uint32_t(lane))) - 1);
    }
    HWY_INLINE SolvedLane refine(uint32_t i, const RayQuery& q) const {
        return refine_triangle_of<Framed>(patch, uint32_t(lane) + i, q, frame);
    }
    HWY_INLINE uint32_t id(uint32_t i) const { return patch.id(uint32_t(lane) + i, ids); }
};

template <Query Q, bool Framed, class Patch>
HWY_INLINE bool test_patch(const Patch& patch, const uint32_t* ids, const LocalRay& ray,
                           RayQuery& q, const IdTable& table) {
    using D = PatchTable::D;
    const ShearedPatch<Framed> s(patch, q, ray.frame);
    for (size_t lane = 0; lane < patch.count; lane += PatchTable::N) {
        hn::Vec<D> x[3], y[3];
        for (int k = 0; k < 3; ++k) {
            x[k] = s.x.lookup(patch.corner[k] + lane);
            y[k] = s.y.lookup(patch.corner[k] + lane);
        }
        const auto depth = [&](int k) HWY_ATTR { return s.z.lookup(patch.corner[k] + lane); };
        const PatchLanes<Framed, Patch> source{patch, ids, lane, ray.frame};
        if (test_corners<Q>(D(), x, y, depth, source, q, table)) return true;
    }
    return false;
}

template <Query Q, class Patch>
HWY_NOINLINE bool test_patch_exactly(const Patch& patch, const uint32_t* ids, const LocalRay& ray,
                                     RayQuery& q, const IdTable& table) {
    for (uint32_t i = 0; i < patch.count; ++i) {
        Vec3f v[3];
        for (int k = 0; k < 3; ++k)
            v[k] = apply(ray.frame->world_from_object_f, patch.vertex(i, k));
        if (exact::test_triangle(Q, v, table, patch.id(i, ids), q)) return true;
    }
    return false;
}

/// See test_framed_block.
template <Query Q, class Patch>
HWY_NOINLINE bool test_framed_patch(const Patch& patch, const uint32_t* ids, const LocalRay& ray,
                                    RayQuery& q, const IdTable& table) {
    if (HWY_UNLIKELY(q.mode == Mode::exact))
        return test_patch_exactly<Q>(patch, ids, ray, q, table);
    return test_patch<Q, true>(patch, ids, ray, q, table);
}

/// The leaf test of all forms of patches.
/// @param patch_at  (i): patch i, or a reference to it
/// @param count     of patches
template <Query Q, class F, class C>
HWY_INLINE bool test_patches(const TriangleSet& set, const F& patch_at, const uint32_t* ids,
                             uint32_t first, uint32_t count, const LocalRay& ray, RayQuery& q,
                             C& counters) {
    for (uint32_t i = first; i < first + count; ++i) {
        const auto& patch = patch_at(i);
        counters.test(patch.count);
        const bool found = HWY_UNLIKELY(ray.frame != nullptr)
                               ? test_framed_patch<Q>(patch, ids, ray, q, set.ids())
                               : test_patch<Q, false>(patch, ids, ray, q, set.ids());
        if (Q == Query::any && found) return true;
    }
    return false;
}

HWY_INLINE const TrianglePatch& patch_at(const TrianglePatches& leaves, uint32_t i) {
    return leaves.patches()[i];
}

template <Query Q, class C>
HWY_INLINE bool test_leaf(const TriangleSet& set, const TrianglePatches& leaves, uint32_t first,
                          uint32_t count, const LocalRay& ray, RayQuery& q, C& counters) {
    const auto at = [&](uint32_t i)
                        HWY_ATTR -> const TrianglePatch& { return patch_at(leaves, i); };
    return test_patches<Q>(set, at, leaves.ids(), first, count, ray, q, counters);
}

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

#endif
