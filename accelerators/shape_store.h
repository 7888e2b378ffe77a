#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "accelerators/cell_blocks.h"
#include "framework/aligned.h"
#include "framework/object_set.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"

namespace crofton {

/// What the references of a grid mean. Shapes of most sets are read where they are.
template <class Set>
class ShapeStore {
  public:
    static constexpr bool keeps_set = true;
    explicit ShapeStore(const Set&) {}
    ShapeStore() = default;

    /// The reference to a shape.
    uint32_t place(const Set&, uint32_t shape) { return shape; }
    void place(const Set&, std::span<uint32_t>) {}
    /// Called after the last `place`.
    void finish() {}
    template <class A>
    void archive(A&) {}
    uint64_t bytes() const { return 0; }
};

/// A triangle with its corners, so that a test loads one place, not three after the indices.
///
///   byte  0  x, y, z of corner 0        12  of corner 1        24  of corner 2
///        36  index in the set
using TriangleRecord = TriangleBlock<1>;
static_assert(sizeof(TriangleRecord) == 40);

/// Triangles are copied, once each, in the order in which cells first name them: neighbours in
/// space are then neighbours in memory.
template <>
class ShapeStore<TriangleSet> {
  public:
    static constexpr bool keeps_set = false;
    explicit ShapeStore(const TriangleSet& set) : places_(set.size(), none) {}
    ShapeStore() = default;

    uint32_t place(const TriangleSet& set, uint32_t shape) {
        uint32_t& place = places_[shape];
        if (place != none) return place;
        place = uint32_t(records_.size());
        TriangleRecord& record = records_.emplace_back();
        for (int k = 0; k < 3; ++k) {
            const Vec3f& v = set.vertex(shape, k);
            for (int a = 0; a < 3; ++a) record.v[k][a][0] = v[a];
        }
        record.id[0] = shape;
        return place;
    }
    void place(const TriangleSet& set, std::span<uint32_t> shapes) {
        for (uint32_t& shape : shapes) shape = place(set, shape);
    }
    void finish() {
        places_ = {};
        records_.shrink_to_fit();
    }
    template <class A>
    void archive(A& a) {
        a(records_);
    }
    const TriangleRecord* records() const { return records_.data(); }
    uint64_t bytes() const { return records_.size() * sizeof(TriangleRecord); }

  private:
    static constexpr uint32_t none = ~0u;
    AlignedVector<TriangleRecord> records_;
    std::vector<uint32_t> places_;  ///< while building
};

/// Replaces the shapes of a leaf by references to them.
/// @param value  where the leaf's list begins in `references`, or, if it has one shape, that one
template <class Set>
void place_leaf(const Set& set, uint32_t& value, uint32_t count,
                AlignedVector<uint32_t>& references, ShapeStore<Set>& shapes) {
    if (count == 1)
        value = shapes.place(set, value);
    else
        shapes.place(set, std::span(references).subspan(value, count));
}

/// A list of references in one array of words, by a code in one word:
///   single_flag | r   the list of reference r alone
///   i                 at words[i] the number of references, then they
namespace list_code {
inline constexpr uint32_t single_flag = 1u << 30;
}

/// Calls test(references, their number) for the list behind a code.
template <class Test>
bool test_list(uint32_t code, const uint32_t* words, Test&& test) {
    if (code & list_code::single_flag) {
        const uint32_t reference = code & ~list_code::single_flag;
        return test(&reference, 1);
    }
    return test(words + code + 1, words[code]);
}

inline uint32_t list_length(uint32_t code, const uint32_t* words) {
    return code & list_code::single_flag ? 1 : words[code];
}

/// Writes the lists of a block's cells into the words right behind their codes, so that a ray finds
/// both at one place in memory.
template <class Set>
class ListWriter {
  public:
    ListWriter(const Set& set, AlignedVector<uint32_t>& words, ShapeStore<Set>& shapes)
        : set_(set), words_(words), shapes_(shapes) {}

    /// Begins a block. @param begins  of the items of its 64 cells, and the end of the last
    void begin(CellBlock& block, std::span<const uint32_t> begins) {
        for (size_t i = 0; i < 64; ++i)
            if (begins[i] != begins[i + 1]) block.occupied |= uint64_t(1) << i;
        block.first = uint32_t(words_.size());
        code_ = words_.size();
        words_.resize(words_.size() + size_t(std::popcount(block.occupied)));
    }
    /// The next cell's code is `code`. @return its place
    size_t put(uint32_t code) {
        words_[code_] = code;
        return code_++;
    }
    /// The next cell has a list of shapes.
    void add(std::span<const uint32_t> items) {
        if (items.size() == 1 && put_single(shapes_.place(set_, items[0]))) return;
        put(uint32_t(words_.size()));
        words_.push_back(uint32_t(items.size()));
        for (const uint32_t item : items) words_.push_back(shapes_.place(set_, item));
    }

  private:
    bool put_single(uint32_t reference) {
        if (reference >= list_code::single_flag) return false;
        put(list_code::single_flag | reference);
        return true;
    }

    const Set& set_;
    AlignedVector<uint32_t>& words_;
    ShapeStore<Set>& shapes_;
    size_t code_ = 0;
};

}  // namespace crofton
