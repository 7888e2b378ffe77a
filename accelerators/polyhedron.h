#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "framework/bounds.h"

namespace crofton {

/// A bounded convex polyhedron: the cell of a tree of planes. In double; may be flat.
struct Polyhedron {
    struct Face {
        uint32_t first, count;  ///< range of `corners`, around the face
        Vec3d normal;           ///< unit, outwards
    };
    std::vector<Vec3d> points;
    std::vector<uint32_t> corners;  ///< indices of points, face by face
    std::vector<Face> faces;        ///< empty: nothing

    /// @param bounds  not empty
    static Polyhedron box(const Bounds3& bounds);
    bool empty() const { return faces.empty(); }
    /// Box around it, rounded outwards.
    Bounds3 bounds() const;
    /// Least and largest n·x.
    std::array<double, 2> extent(const Vec3d& n) const;
    double area() const;
};

/// The part where n·x <= d. O(size).
/// @param n          not zero, of any length
/// @param tolerance  corners with |n·x − d| of no more than this count as in the plane
Polyhedron clipped(const Polyhedron& p, const Vec3d& n, double d, double tolerance);

/// A polyhedron's faces as triangles, for AreaProfile.
class CellAreas {
  public:
    explicit CellAreas(const Polyhedron& cell);
    double total() const { return total_; }

  private:
    friend class AreaProfile;
    struct Triangle {
        uint32_t corner[3], face;
        double area;
    };
    const Polyhedron& cell_;
    std::vector<Triangle> triangles_;
    double total_ = 0;
};

/// Surface areas of the two parts of a polyhedron on either side of planes of one direction,
/// without cutting it.
///
/// The faces' parts below a plane are sums over triangles. The cut's own area follows from them:
/// the outward areas of a closed surface sum to zero as vectors, so that it is −Σ aᵢ·(nᵢ·n) over
/// the parts aᵢ below. Nothing is divided by a small number, so no part is wrong by more than
/// rounding of the whole. O(size) for a direction, and for each plane.
class AreaProfile {
  public:
    /// @param n  not zero, of any length
    void look_along(const CellAreas& areas, const Vec3d& n);
    double lowest() const { return lowest_; }  ///< n·x over the polyhedron
    double highest() const { return highest_; }
    struct Parts {
        double below, above;  ///< areas, each with the cut's
    };
    /// For the plane n·x = d.
    Parts at(double d) const;

  private:
    struct Projected {
        double low, middle, high;  ///< n·x of a triangle's corners
        double area, along;        ///< along: face normal · n, unit
    };
    std::vector<Projected> projected_;
    std::vector<double> heights_;
    double total_ = 0, lowest_ = 0, highest_ = 0;
};

}  // namespace crofton
