#include "framework/archive.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cstdio>
#include <unordered_set>

#include "framework/error.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/parts.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

/// Version of everything in a file: raised when any structure or set changes what it stores.
constexpr uint32_t archive_version = 4;
constexpr char magic[8] = {'c', 'r', 'o', 'f', 't', 'o', 'n', '\n'};

/// byte 0 magic, 8 version, 12 byte order, 16 size of the rest, 24 its checksum
struct FileHeader {
    char name[8];
    uint32_t version = archive_version;
    uint32_t byte_order = 0x01020304;
    uint64_t bytes = 0;
    uint64_t checksum = 0;
};
static_assert(sizeof(FileHeader) == 32);

struct CloseFile {
    void operator()(std::FILE* f) const { std::fclose(f); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

template <class Set>
void write_set(StructureWriter& out, const Set& set) {
    const_cast<Set&>(set).archive(out);
}
void write_set(StructureWriter& out, const ObjectSet& set) {
    out(set.size());
    for (uint32_t i = 0; i < set.size(); ++i) {
        out.object(set.object(i));
        out(set.entry(i).instance);
    }
}

template <class Set>
PrimitiveSet read_set(StructureReader& in) {
    auto set = std::make_shared<Set>();
    set->archive(in);
    return std::shared_ptr<const Set>(std::move(set));
}
template <>
PrimitiveSet read_set<ObjectSet>(StructureReader& in) {
    uint32_t size;
    in(size);
    std::vector<ObjectSet::Object> objects;
    for (uint32_t i = 0; i < size; ++i) {
        auto object = in.object();
        uint32_t instance;
        in(instance);
        objects.push_back({std::move(object), instance});
    }
    return std::make_shared<const ObjectSet>(std::move(objects));
}

/// Everything inside `root` that is not known yet, children first; no recursion, since structures
/// nest as deep as a scene graph does.
template <class Visit>
void children_first(const Primitive& root, const StructureWriter& out, const Visit& visit) {
    std::vector<std::pair<const Primitive*, bool>> open{{&root.resolved(), false}};
    std::unordered_set<const Primitive*> entered;
    while (!open.empty()) {
        const auto [object, done] = open.back();
        open.pop_back();
        if (done) {
            visit(*object);
        } else if (entered.insert(object).second) {
            open.push_back({object, true});
            object->children([&](const Primitive& child) {
                const Primitive& inner = child.resolved();
                if (!out.known(inner)) open.push_back({&inner, false});
            });
        }
    }
}

std::shared_ptr<const Primitive> load_part(StructureReader& in) {
    const std::shared_ptr<const Primitive> whole = in.object();
    Bounds3 box;
    TraversalStart start;
    in(box, start);
    std::shared_ptr<const Primitive> part = whole->part(whole, box, start);
    if (!part) in.refuse("names a part of what has none");
    return part;
}

}  // namespace

void ArchiveWriter::raw(const void* data, size_t size) {
    const char* p = static_cast<const char*>(data);
    buffer_.insert(buffer_.end(), p, p + size);
}

void ArchiveReader::raw(void* data, size_t size) {
    if (size > buffer_.size() - at_) refuse("ends early");
    if (size > 0) std::memcpy(data, buffer_.data() + at_, size);
    at_ += size;
}

size_t ArchiveReader::count(size_t size) {
    uint64_t n;
    raw(&n, sizeof n);
    if (n > (buffer_.size() - at_) / size) refuse("ends early");
    return size_t(n);
}

void ArchiveReader::refuse(const std::string& what) const { throw InputError(name_ + ": " + what); }

void StructureWriter::set(const PrimitiveSet& set) {
    std::visit(
        [&](const auto& s) {
            const auto [it, fresh] = sets_.try_emplace(s.get(), uint32_t(sets_.size()));
            (*this)(uint32_t(set.index()), it->second);
            if (fresh) write_set(*this, *s);
        },
        set);
}

void StructureWriter::object(const Primitive& object) { (*this)(numbers_.at(&object.resolved())); }

PrimitiveSet StructureReader::set() {
    uint32_t kind, number;
    (*this)(kind, number);
    if (number == sets_.size()) {
        switch (kind) {
            case 0:
                sets_.push_back(read_set<TriangleSet>(*this));
                break;
            case 1:
                sets_.push_back(read_set<QuadricSet>(*this));
                break;
            case 2:
                sets_.push_back(read_set<PolygonSet>(*this));
                break;
            case 3:
                sets_.push_back(read_set<ObjectSet>(*this));
                break;
            default:
                break;
        }
    }
    if (number >= sets_.size() || sets_[number].index() != kind) refuse("names a set it lacks");
    return sets_[number];
}

std::shared_ptr<const Primitive> StructureReader::object() {
    uint32_t number;
    (*this)(number);
    if (number >= objects_.size()) refuse("names an object it lacks");
    return objects_[number];
}

void save_structure(const Primitive& root, const std::string& path, const std::string& subject) {
    StructureWriter out;
    out(subject);
    children_first(root, out, [&](const Primitive& object) {
        out(object.type_name());
        object.archive(out);
        out.number(object);
    });
    FileHeader header;
    std::memcpy(header.name, magic, sizeof magic);
    header.bytes = out.buffer().size();
    header.checksum = XXH3_64bits(out.buffer().data(), out.buffer().size());
    const File file(std::fopen(path.c_str(), "wb"));
    if (!file || std::fwrite(&header, sizeof header, 1, file.get()) != 1 ||
        std::fwrite(out.buffer().data(), 1, out.buffer().size(), file.get()) !=
            out.buffer().size() ||
        std::fflush(file.get()) != 0)
        throw InputError(path + ": cannot be written");
}

SavedStructure load_structure(const std::string& path) {
    const File file(std::fopen(path.c_str(), "rb"));
    if (!file) throw InputError(path + ": cannot be opened");
    FileHeader header;
    if (std::fread(&header, sizeof header, 1, file.get()) != 1 ||
        std::memcmp(header.name, magic, sizeof magic) != 0)
        throw InputError(path + ": not a saved structure");
    if (header.byte_order != FileHeader().byte_order)
        throw InputError(path + ": saved on a machine of another byte order");
    if (header.version != archive_version)
        throw InputError(path + ": saved as version " + std::to_string(header.version) +
                         ", this program reads version " + std::to_string(archive_version));
    // The size is checked before memory is asked for: a damaged one may be anything.
    std::fseek(file.get(), 0, SEEK_END);
    if (uint64_t(std::ftell(file.get())) != sizeof header + header.bytes)
        throw InputError(path + ": damaged: not as long as it says");
    std::fseek(file.get(), sizeof header, SEEK_SET);
    std::vector<char> data(header.bytes);
    if (std::fread(data.data(), 1, data.size(), file.get()) != data.size() ||
        XXH3_64bits(data.data(), data.size()) != header.checksum)
        throw InputError(path + ": damaged: the checksum differs");

    StructureReader in(std::move(data), path);
    std::string subject;
    in(subject);
    while (!in.at_end()) {
        std::string type;
        in(type);
        if (type == part_name) {
            in.add(load_part(in));
            continue;
        }
        in.add(type == Instance::registry_name ? Instance::load(in) : load_accelerator(type, in));
    }
    if (in.objects().empty()) in.refuse("holds no structure");
    return {in.objects().back(), subject};
}

}  // namespace crofton
