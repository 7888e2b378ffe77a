#pragma once

#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "framework/bounds.h"
#include "framework/primitive_sets.h"
#include "framework/transform.h"

namespace crofton {

class Primitive;

/// Plain data goes into an archive as its bytes; a type with `template <class A> void archive(A& a)
/// { a(member, member, …); }` as its members, the same function for both directions.
template <class T>
concept Archived = requires(T& t, void (&a)(int)) {
    t.archive(a);
};
template <class T>
concept EigenFixed = requires {
    T::RowsAtCompileTime;
    T::ColsAtCompileTime;
};
template <class T>
concept PlainData = std::is_trivially_copyable_v<T> && !EigenFixed<T> && !std::is_pointer_v<T>;

/// Appends values to a buffer of bytes in this machine's byte order. Every run of plain data begins
/// with the size of its element, so that a file of another layout is noticed.
class ArchiveWriter {
  public:
    static constexpr bool reads = false;
    template <class... T>
    void operator()(const T&... values) {
        (write(values), ...);
    }
    void raw(const void* data, size_t size);
    const std::vector<char>& buffer() const { return buffer_; }

  private:
    template <class T>
    void write(const T& value) {
        if constexpr (EigenFixed<T>) {
            raw(value.data(), sizeof(typename T::Scalar) * size_t(T::SizeAtCompileTime));
        } else if constexpr (PlainData<T>) {
            raw(&value, sizeof(T));
        } else {
            const_cast<T&>(value).archive(*this);
        }
    }
    void write(const Bounds3& b) { (*this)(b.lower, b.upper); }
    void write(const Transform& t) { (*this)(t.linear, t.translation); }
    void write(const std::string& s) {
        (*this)(uint64_t(s.size()));
        raw(s.data(), s.size());
    }
    template <class T, class Allocator>
    void write(const std::vector<T, Allocator>& v) {
        (*this)(uint32_t(sizeof(T)), uint64_t(v.size()));
        if constexpr (PlainData<T> || EigenFixed<T>) {
            raw(v.data(), v.size() * sizeof(T));
        } else {
            for (const T& x : v) (*this)(x);
        }
    }

    std::vector<char> buffer_;
};

/// Reads what an ArchiveWriter wrote.
/// Every function @throws InputError  "NAME: what", if the data end early or have another layout
class ArchiveReader {
  public:
    static constexpr bool reads = true;
    /// @param name  of the file, for messages
    ArchiveReader(std::vector<char> buffer, std::string name)
        : buffer_(std::move(buffer)), name_(std::move(name)) {}

    template <class... T>
    void operator()(T&... values) {
        (read(values), ...);
    }
    void raw(void* data, size_t size);
    bool at_end() const { return at_ == buffer_.size(); }
    [[noreturn]] void refuse(const std::string& what) const;

  private:
    template <class T>
    void read(T& value) {
        if constexpr (EigenFixed<T>) {
            raw(value.data(), sizeof(typename T::Scalar) * size_t(T::SizeAtCompileTime));
        } else if constexpr (PlainData<T>) {
            raw(&value, sizeof(T));
        } else {
            value.archive(*this);
        }
    }
    void read(Bounds3& b) { (*this)(b.lower, b.upper); }
    void read(Transform& t) { (*this)(t.linear, t.translation); }
    void read(std::string& s) {
        s.resize(count(1));
        raw(s.data(), s.size());
    }
    template <class T, class Allocator>
    void read(std::vector<T, Allocator>& v) {
        uint32_t element;
        (*this)(element);
        if (element != sizeof(T)) refuse("was written with another layout");
        if constexpr (PlainData<T> || EigenFixed<T>) {
            v.resize(count(sizeof(T)));
            raw(v.data(), v.size() * sizeof(T));
        } else {
            v.resize(count(1));
            for (T& x : v) (*this)(x);
        }
    }
    /// A number of elements of at least `size` bytes that the rest of the data can hold.
    size_t count(size_t size);

    std::vector<char> buffer_;
    std::string name_;
    size_t at_ = 0;
};

/// Writes sets and structures; each set once, however many structures share it.
class StructureWriter : public ArchiveWriter {
  public:
    void set(const PrimitiveSet& set);
    /// @pre object was written before
    void object(const Primitive& object);
    void number(const Primitive& object) { numbers_.emplace(&object, uint32_t(numbers_.size())); }
    bool known(const Primitive& object) const { return numbers_.contains(&object); }

  private:
    std::map<const void*, uint32_t> sets_;
    std::map<const Primitive*, uint32_t> numbers_;
};

class StructureReader : public ArchiveReader {
  public:
    using ArchiveReader::ArchiveReader;
    PrimitiveSet set();
    std::shared_ptr<const Primitive> object();
    void add(std::shared_ptr<const Primitive> object) { objects_.push_back(std::move(object)); }
    const std::vector<std::shared_ptr<const Primitive>>& objects() const { return objects_; }

  private:
    std::vector<PrimitiveSet> sets_;
    std::vector<std::shared_ptr<const Primitive>> objects_;
};

/// Writes a built structure with everything inside it (sets, nested structures, instances) to a
/// file; shared objects once. Subtrees that were to be built on demand are built first.
/// @param subject  what it was built over, e.g. a fingerprint; given back by load_structure
/// @throws InputError  the file cannot be written
void save_structure(const Primitive& root, const std::string& path,
                    const std::string& subject = "");

struct SavedStructure {
    std::shared_ptr<const Primitive> root;
    std::string subject;
};

/// Reads it back: the same hits, and the same memory within a few bytes. Kernels are those of the
/// instruction set that is active now. The checksum (XXH3, 64 bits) guards against damage, not
/// against forgery.
/// @throws InputError  not such a file, of another version or layout, damaged, or it names an
///                     accelerator that this program lacks
SavedStructure load_structure(const std::string& path);

}  // namespace crofton
