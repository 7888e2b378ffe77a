#pragma once

#include <array>
#include <concepts>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "framework/aligned.h"
#include "framework/bounds.h"
#include "framework/ray_query.h"

namespace crofton {

/// Triangles with shared vertices, in object space. Those with a vertex that is NaN or infinite are
/// inactive: they keep their index and are never referenced.
class TriangleSet {
  public:
    using Indices = std::array<uint32_t, 3>;
    using Positions = RawAlignedVector<Vec3f>;
    using Triangles = RawAlignedVector<Indices>;

    /// @param triangles  indices into `positions`
    /// @throws InputError  an index is out of range
    /// @param groups     of the model that the triangles come from; none: the runs of `ids`
    TriangleSet(Positions positions, Triangles triangles, IdTable ids = {},
                ShapeGroups groups = {});
    /// The same of copies of ordinary vectors.
    template <class P, class T = std::vector<Indices>>
        requires std::same_as<P, std::vector<Vec3f>> && std::same_as<T, std::vector<Indices>>
    TriangleSet(const P& positions, const T& triangles, IdTable ids = {}, ShapeGroups groups = {})
        : TriangleSet(Positions(positions.begin(), positions.end()),
                      Triangles(triangles.begin(), triangles.end()), std::move(ids),
                      std::move(groups)) {}
    TriangleSet() : TriangleSet(Positions(), Triangles()) {}
    /// The triangles named, ascending, with their ids in this set and what is left of its groups;
    /// vertices are shared.
    TriangleSet subset(std::span<const uint32_t> shapes) const;
    template <class A>
    void archive(A& a) {
        if constexpr (A::reads) {
            Positions positions;
            a(positions, triangles_, ids_);
            own(std::move(positions));
        } else {
            a(*positions_, triangles_, ids_);
        }
    }

    uint32_t size() const { return uint32_t(triangles_.size()); }
    bool active(uint32_t i) const;
    const Vec3f& vertex(uint32_t i, int k) const { return vertices_[triangles_[i][k]]; }
    /// Box of triangle i, larger by slack(i) on every side.
    Bounds3 bounds(uint32_t i) const;
    /// How far from a point of triangle i a ray may pass that its test accepts, per axis, beyond
    /// what grows with the distance (see LocalRay).
    Vec3f slack(uint32_t i) const;
    /// Box of the part of triangle i inside `box`, rounded outwards, without slack and within
    /// `box`; empty if there is none.
    Bounds3 clipped_bounds(uint32_t i, const Bounds3& box) const;
    /// Nominal nanoseconds of one test.
    double cost(uint32_t i) const;
    const IdTable& ids() const { return ids_; }
    /// Vertices shared with a larger set not included.
    uint64_t bytes() const;
    ShapeGroups groups() const { return groups_.empty() ? ids_.groups(size()) : groups_; }
    /// A set with the same ids and no shapes: what a structure with its own copy keeps.
    TriangleSet ids_only() const { return TriangleSet(Positions(), Triangles(), ids_); }

    const Indices* triangles() const { return triangles_.data(); }
    /// Of the mesh that it is, or is a part of.
    size_t vertices() const { return positions_->size() - 1; }
    /// Vertices as packed floats; one more may be read behind the last.
    const float* coordinates() const { return vertices_->data(); }

  private:
    Bounds3 corner_bounds(uint32_t i) const;
    /// @throws InputError  which triangle has an index too large
    void refuse_indices(size_t positions) const;
    void own(Positions positions) {
        positions_ = std::make_shared<const Positions>(std::move(positions));
        vertices_ = positions_->data();
    }
    std::shared_ptr<const Positions> positions_;  ///< and one dummy at the end
    const Vec3f* vertices_ = nullptr;
    bool part_ = false;  ///< the vertices are another set's
    Triangles triangles_;
    IdTable ids_;
    ShapeGroups groups_;
};

/// W triangles side by side, coordinate by coordinate. Unused lanes hold NaN, which no test
/// accepts.
template <int W>
struct alignas(sizeof(float) * W) TriangleBlock {
    float v[3][3][W];  ///< [vertex][axis][lane]
    uint32_t id[W];    ///< index in the set

    Vec3f corner(size_t lane, int k) const { return {v[k][0][lane], v[k][1][lane], v[k][2][lane]}; }
};
static_assert(sizeof(TriangleBlock<4>) == 160 && sizeof(TriangleBlock<8>) == 320);

/// Leaves of one structure over triangles: a copy in the order of the leaves, packed for SIMD.
class TriangleLeaves {
  public:
    static constexpr int width = 4;

    /// Room for about so many triangles, in leaves that are mostly full.
    void reserve(size_t triangles) { blocks_.reserve(triangles / width + triangles / 64 + 1); }
    /// Appends a leaf. @return its first block
    uint32_t add(const TriangleSet& set, std::span<const uint32_t> shapes);
    /// Makes room for so many blocks; `put` fills it, in any order.
    void resize(size_t blocks) { blocks_.resize(blocks); }
    void put(const TriangleSet& set, std::span<const uint32_t> shapes, uint32_t first);
    /// Blocks of a leaf of so many triangles.
    static uint32_t room(uint32_t triangles) { return (triangles + width - 1) / width; }
    template <class A>
    void archive(A& a) {
        a(blocks_);
    }
    const TriangleBlock<width>* blocks() const { return blocks_.data(); }
    uint64_t bytes() const { return blocks_.size() * sizeof(TriangleBlock<width>); }
    /// Nominal cost of a leaf, given the sum of its shapes' costs: blocks are tested whole.
    static double cost(double sum, uint32_t count);
    static constexpr bool keeps_set = false;  ///< the set itself is not read in traversal

  private:
    RawAlignedVector<TriangleBlock<width>> blocks_;
};

/// The watertight test of one triangle, with edge signs decided in double and t, u, v computed in
/// double: for the rays that graze an edge, or the plane. Sees the same rounded shear as the SIMD
/// test, whose arithmetic in double is this one's (solve_lanes).
/// @param v  world-space vertices
/// @return whether it is hit at any t. t, u, v are those of a point of the triangle that the ray
///         passes at no more than the rounding of the shear: t is within a float ulp, unless the
///         triangle is seen nearly edge-on
bool refine_triangle(const float (&v)[3][3], const RayQuery& query, float& t, float& u, float& w);

}  // namespace crofton
