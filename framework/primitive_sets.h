#pragma once

#include <memory>
#include <variant>

namespace crofton {

class TriangleSet;
class QuadricSet;
class PolygonSet;
class ObjectSet;

/// A set of shapes of one kind: what a leaf works with. Immutable and shared.
using PrimitiveSet =
    std::variant<std::shared_ptr<const TriangleSet>, std::shared_ptr<const QuadricSet>,
                 std::shared_ptr<const PolygonSet>, std::shared_ptr<const ObjectSet>>;

}  // namespace crofton
