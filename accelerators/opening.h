#pragma once

#include <vector>

#include "framework/object_set.h"

namespace crofton {

/// What a structure above is built over instead of the objects.
struct OpenedObjects {
    std::vector<ObjectSet::Object> objects;  ///< in the order given, parts in their object's place
    std::vector<uint32_t> origin;  ///< of each, the index of the object that it is part of
    uint32_t opened = 0;           ///< objects that were opened
};

/// When to stop.
enum class OpeningRule {
    where_it_pays,  ///< at the least expected cost of a tree over the entries, which must be a
                    ///< twentieth below that of the objects; else nothing is opened
    always,         ///< when the budget is spent or nothing that overlaps can be opened
};

/// Opens objects whose boxes overlap those of others, so that a structure over them can tell their
/// parts apart: hits keep their bits. What overlaps others most is opened first, again and again,
/// until there are `growth` times as many entries, or nothing that overlaps another object can be
/// opened further; what was cheapest on the way is the result. Overlap of an entry = Σ half areas
/// of its box's intersections with entries of other objects; where an entry meets thousands,
/// nearly. Deterministic.
///
/// Source: Benthin, Woop, Wald, Áfra 2017, "Improved two-level BVHs using partial re-braiding".
/// Departs from it: theirs opens within the builder of one kind of tree; this opens before any
/// build, for any structure, and asks for overlap with other objects rather than for extent.
/// @param growth  0 or at most 1: nothing is opened
OpenedObjects open_overlapping(std::vector<ObjectSet::Object> objects, double growth,
                               OpeningRule rule = OpeningRule::where_it_pays);

/// Groups over the objects given, moved to what they were opened to.
ShapeGroups moved_groups(const ShapeGroups& groups, const OpenedObjects& opened);

}  // namespace crofton
