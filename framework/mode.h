#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace crofton {

/// How hard a query tries to be right. It is a property of the query: every structure answers in
/// every mode, with one and the same compiled traversal. Boxes and cells are conservative in all of
/// them; modes differ in what a leaf does with a shape that the ray may hit.
///
/// The truth is what the float bits say of ray and shapes as they stand in the world (triangles:
/// corners mapped by `apply`; polygons and quadrics: under the product of the maps in double).
enum class Mode : uint8_t {
    /// Triangles in single precision only. A ray that passes a triangle's edges at more than
    /// exact::triangle_bound (2^-21) of the distance of its corners is hit or missed rightly.
    /// Nearer to an edge, or if the triangle is seen edge-on, it may be missed, and t be that of
    /// any depth of the triangle; then the order of visits, and so the structure, may matter.
    /// Otherwise t is right within 2^-19. Products of two
    /// of a triangle's sheared coordinates must be floats: sizes from 1e-14 to 1e18. Polygons and
    /// quadrics as in `robust`.
    fast,
    /// Triangles watertight: no ray passes between two that share an edge. Hit or missed rightly
    /// outside the same margin; t, u and v of a hit in double, rounded to float once. Polygons and
    /// quadrics in double: hit class
    /// right outside exact::double_bound, t within a few float ulp. Every structure gives the same
    /// bits.
    robust,
    /// Hit or missed as in `robust`; t of a shape that is truly hit is at most 1 ulp from its exact
    /// value. Every structure gives the same bits.
    double_precision,
    /// The truth: hit class, t rounded to nearest, and of several shapes at the same exact t the
    /// one with the lowest ids. u and v are right within a few float ulp of 1. Every structure
    /// gives the same bits. (Kinds of shapes that the oracle does not know: as in `robust`.)
    exact,
};

/// Names in configs: "fast", "robust", "double", "exact", in this order.
std::span<const std::string> mode_names();
const std::string& name_of(Mode mode);
/// @return  nothing for an unknown name
std::optional<Mode> mode_named(std::string_view name);

}  // namespace crofton
