#pragma once

#include <memory>
#include <span>
#include <vector>

#include "framework/primitive.h"
#include "framework/shape_groups.h"

namespace crofton {

/// A primitive set whose shapes are Primitives: nesting happens here, and only here.
class ObjectSet {
  public:
    using Object = PlacedPrimitive;
    /// @param groups  of the scene graph that the objects come from
    explicit ObjectSet(std::vector<Object> objects, ShapeGroups groups = {});
    /// The objects named, ascending, with what is left of their groups.
    ObjectSet subset(std::span<const uint32_t> objects) const;

    uint32_t size() const { return uint32_t(objects_.size()); }
    bool active(uint32_t i) const { return !entries_[i].bounds.empty(); }
    const Bounds3& bounds(uint32_t i) const { return entries_[i].bounds; }
    Bounds3 clipped_bounds(uint32_t i, const Bounds3& box) const {
        return intersection(bounds(i), box);
    }
    /// What the object expects of a ray that meets its bounds, and the price of entering it.
    double cost(uint32_t i) const;
    const std::vector<Object>& objects() const { return objects_; }
    const ShapeGroups& groups() const { return groups_; }
    const Primitive& object(uint32_t i) const { return *entries_[i].primitive; }
    uint64_t bytes() const { return entries_.size() * (sizeof(Entry) + sizeof(Object)); }

    /// What a leaf reads of an object before it calls it.
    struct Entry {
        Bounds3 bounds;
        uint32_t instance;
        const Primitive* primitive;
    };
    const Entry& entry(uint32_t i) const { return entries_[i]; }

  private:
    std::vector<Object> objects_;  ///< owns
    std::vector<Entry> entries_;
    ShapeGroups groups_;
};

/// Leaves of one structure over shapes that are not packed: references in the order of the leaves.
class ReferenceLeaves {
  public:
    template <typename Set>
    uint32_t add(const Set&, std::span<const uint32_t> shapes) {
        references_.insert(references_.end(), shapes.begin(), shapes.end());
        return uint32_t(references_.size() - shapes.size());
    }
    void reserve(size_t references) { references_.reserve(references); }
    /// Makes room; `put` fills it, in any order.
    void resize(size_t references) { references_.resize(references); }
    void put(std::span<const uint32_t> shapes, uint32_t first) {
        std::copy(shapes.begin(), shapes.end(), references_.begin() + first);
    }
    template <typename Set>
    void put(const Set&, std::span<const uint32_t> shapes, uint32_t first) {
        put(shapes, first);
    }
    /// What a leaf of so many takes.
    static uint32_t room(uint32_t shapes) { return shapes; }
    template <class A>
    void archive(A& a) {
        a(references_);
    }
    const uint32_t* references() const { return references_.data(); }
    uint64_t bytes() const { return references_.size() * sizeof(uint32_t); }
    static double cost(double sum, uint32_t) { return sum; }
    static constexpr bool keeps_set = true;

  private:
    std::vector<uint32_t> references_;
};

}  // namespace crofton
