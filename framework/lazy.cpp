#include "framework/lazy.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "framework/archive.h"
#include "framework/cost.h"
#include "framework/object_set.h"
#include "framework/parallel.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/ray_crowd.h"
#include "framework/ray_packet.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

constexpr int halvings = 4;  ///< of a part into the parts below it: at most 16

/// Shapes that stay together, as indices in the set.
struct Part {
    std::vector<uint32_t> shapes;
    Bounds3 bounds;
};

/// What a search structure costs before it is there: a descent of as many steps as it has levels.
double guessed_cost(uint64_t shapes, double mean_cost) {
    return cost_constants.node * std::log2(double(shapes) + 1) + 2 * mean_cost;
}

/// Planes that cut space into parts, each where centres spread most, in the middle of their mean.
class Planes {
  public:
    /// @param centers  of a sample of the shapes
    Planes(std::vector<Vec3f> centers, int levels)
        : levels_(levels), planes_((size_t(1) << levels) - 1) {
        cut(centers, 0);
    }
    size_t parts() const { return planes_.size() + 1; }
    size_t part_of(const Vec3f& center) const {
        size_t i = 0;
        for (int level = 0; level < levels_; ++level)
            i = 2 * i + 1 + (center[planes_[i].axis] >= planes_[i].position ? 1 : 0);
        return i - planes_.size();
    }

  private:
    struct Plane {
        int axis = 0;
        float position = std::numeric_limits<float>::infinity();  ///< all is below
    };

    void cut(std::span<Vec3f> centers, size_t i) {
        if (i >= planes_.size() || centers.empty()) return;
        Bounds3 spread;
        Vec3d sum = Vec3d::Zero();
        for (const Vec3f& c : centers) {
            spread.extend(c);
            sum += c.cast<double>();
        }
        int axis;
        (spread.upper.cast<double>() - spread.lower.cast<double>()).maxCoeff(&axis);
        float middle = float(sum[axis] / double(centers.size()));
        size_t below = divide(centers, axis, middle);
        // Few far away: by number.
        if (std::min(below, centers.size() - below) * 64 < centers.size()) {
            const auto half = centers.begin() + ptrdiff_t(centers.size() / 2);
            std::nth_element(centers.begin(), half, centers.end(),
                             [&](const Vec3f& p, const Vec3f& q) { return p[axis] < q[axis]; });
            middle = (*half)[axis];
            below = divide(centers, axis, middle);
        }
        planes_[i] = {axis, middle};
        cut(centers.first(below), 2 * i + 1);
        cut(centers.subspan(below), 2 * i + 2);
    }
    static size_t divide(std::span<Vec3f> centers, int axis, float middle) {
        const auto end = std::partition(centers.begin(), centers.end(),
                                        [&](const Vec3f& c) { return c[axis] < middle; });
        return size_t(end - centers.begin());
    }

    int levels_;
    std::vector<Plane> planes_;  ///< a heap: those of plane i are 2i + 1, below it, and 2i + 2
};

/// Puts every active shape into one of at most sixteen parts, shapes ascending. One pass over the
/// shapes finds each one's part by planes between those of a sample, a second one writes them down.
template <class Set>
class Partition {
  public:
    Partition(const Set& set, size_t whole_size)
        : set_(set), planes_(sample(), levels(whole_size)) {}

    std::vector<Part> run() {
        chunks_.resize((set_.size() + chunk_size - 1) / chunk_size);
        part_of_.resize(set_.size());
        sort_out([&](uint32_t, const Bounds3& b) { return planes_.part_of(b.center()); });
        const size_t most = *std::max_element(sizes_.begin(), sizes_.end());
        const size_t all = std::accumulate(sizes_.begin(), sizes_.end(), size_t{0});
        // All in one place, or next to it: by number.
        if (most * 4 > all * 3)
            sort_out([&](uint32_t i, const Bounds3&) { return i * planes_.parts() / set_.size(); });
        std::vector<Part> parts = write();
        std::erase_if(parts, [](const Part& p) { return p.shapes.empty(); });
        return parts;
    }

  private:
    static constexpr size_t chunk_size = 1 << 15, sample_size = 1 << 12;
    static constexpr size_t most_parts = size_t(1) << halvings;
    static constexpr uint8_t nowhere = 255;  ///< of what is not active
    struct Chunk {
        std::array<Bounds3, most_parts> bounds;
        std::array<size_t, most_parts> count{};  ///< then where the chunk's shapes go in the part
    };

    int levels(size_t whole_size) const {
        const double parts = double(set_.size()) / double(whole_size);
        return std::clamp(int(std::ceil(std::log2(parts))), 1, halvings);
    }
    std::vector<Vec3f> sample() const {
        const size_t n = std::min<size_t>(set_.size(), sample_size);
        std::vector<Vec3f> centers;
        for (size_t k = 0; k < n; ++k) {
            const uint32_t i = uint32_t(k * set_.size() / n);
            if (set_.active(i)) centers.push_back(set_.bounds(i).center());
        }
        return centers;
    }
    template <class Body>
    void for_chunks(const Body& body) {
        parallel_for(chunks_.size(), 1, [&](size_t begin, size_t end) {
            for (size_t c = begin; c < end; ++c)
                body(chunks_[c], uint32_t(c * chunk_size),
                     uint32_t(std::min<size_t>(set_.size(), (c + 1) * chunk_size)));
        });
    }
    /// @param part_of  of a shape by its index and bounds
    template <class PartOf>
    void sort_out(const PartOf& part_of) {
        for_chunks([&](Chunk& chunk, uint32_t begin, uint32_t end) {
            chunk = {};
            for (uint32_t i = begin; i < end; ++i) {
                part_of_[i] = nowhere;
                if (!set_.active(i)) continue;
                const Bounds3 b = set_.bounds(i);
                const size_t part = part_of(i, b);
                part_of_[i] = uint8_t(part);
                chunk.bounds[part].extend(b);
                ++chunk.count[part];
            }
        });
        sizes_ = {};
        for (const Chunk& chunk : chunks_)
            for (size_t p = 0; p < most_parts; ++p) sizes_[p] += chunk.count[p];
    }
    std::vector<Part> write() {
        std::vector<Part> parts(most_parts);
        for (size_t p = 0; p < most_parts; ++p) {
            parts[p].shapes.resize(sizes_[p]);
            size_t at = 0;
            for (Chunk& chunk : chunks_) {
                parts[p].bounds.extend(chunk.bounds[p]);
                at += std::exchange(chunk.count[p], at);
            }
        }
        for_chunks([&](Chunk& chunk, uint32_t begin, uint32_t end) {
            for (uint32_t i = begin; i < end; ++i)
                if (const size_t p = part_of_[i]; p != nowhere)
                    parts[p].shapes[chunk.count[p]++] = i;
        });
        return parts;
    }

    const Set& set_;
    Planes planes_;
    std::vector<Chunk> chunks_;
    std::vector<uint8_t> part_of_;
    std::array<size_t, most_parts> sizes_{};
};

struct Extent {
    Bounds3 bounds;
    uint64_t shapes = 0;  ///< active ones
    double cost = 0;
};

template <class Set>
Extent extent_of(const Set& set) {
    constexpr size_t range = 1 << 15;
    std::vector<Extent> parts((set.size() + range - 1) / range);
    parallel_for(parts.size(), 1, [&](size_t begin, size_t end) {
        for (size_t part = begin; part < end; ++part) {
            const size_t last = std::min<size_t>(set.size(), (part + 1) * range);
            for (size_t i = part * range; i < last; ++i) {
                if (!set.active(uint32_t(i))) continue;
                parts[part].bounds.extend(set.bounds(uint32_t(i)));
                parts[part].cost += set.cost(uint32_t(i));
                ++parts[part].shapes;
            }
        }
    });
    Extent all;
    for (const Extent& part : parts) {
        all.bounds.extend(part.bounds);
        all.shapes += part.shapes;
        all.cost += part.cost;
    }
    return all;
}

template <class Set>
std::unique_ptr<Primitive> build_upper(const std::shared_ptr<const Set>& set,
                                       const LazyBuild& build, size_t whole_size,
                                       double mean_cost) {
    if (set->size() <= whole_size) return build(set);
    std::vector<ObjectSet::Object> objects;
    for (Part& part : Partition<Set>(*set, whole_size).run()) {
        const size_t n = part.shapes.size();
        objects.push_back({std::make_shared<const LazyObject>(
            part.bounds, n, guessed_cost(n, mean_cost), n * sizeof(uint32_t),
            [set, build, whole_size, mean_cost, shapes = std::move(part.shapes)] {
                const auto inner = std::make_shared<const Set>(set->subset(shapes));
                return build_upper(inner, build, whole_size, mean_cost);
            })});
    }
    return build(std::make_shared<const ObjectSet>(std::move(objects)));
}

}  // namespace

const Primitive& LazyObject::build_now() const {
    const std::lock_guard lock(mutex_);
    if (const Primitive* p = built()) return *p;
    // A build waits for its own loops only: a ray taken up meanwhile could ask for this very lock.
    parallel_isolated([&] { owner_ = build_(); });
    build_ = nullptr;
    built_.store(owner_.get(), std::memory_order_release);
    return *owner_;
}

void LazyObject::closest_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const {
    packet.enter<Query::closest>(object(), space, rays);
}

void LazyObject::any_packet(RayPacket& packet, LocalPacket& space, uint32_t rays) const {
    packet.enter<Query::any>(object(), space, rays);
}

void LazyObject::closest_crowd(RayCrowd& crowd) const {
    if (object().takes_crowds()) return object().closest_crowd(crowd);
    for (uint32_t i = 0; i < crowd.size; ++i)
        object().closest_local(*crowd.local[i], *crowd.query[i]);
}

void LazyObject::any_crowd(RayCrowd& crowd) const {
    if (object().takes_crowds()) return object().any_crowd(crowd);
    for (uint32_t i = 0; i < crowd.size; ++i)
        if (object().any_local(*crowd.local[i], *crowd.query[i])) crowd.found |= uint64_t(1) << i;
}

double LazyObject::expected_cost() const { return built() ? built()->expected_cost() : cost_; }

StructureStatistics LazyObject::statistics() const {
    StructureStatistics s;
    s.bytes = sizeof(LazyObject) + bytes_;
    if (!built()) s.N_V = 1, s.N_OIV = shapes_;
    return s;
}

void LazyObject::walk(const BoxVisitor& visit) const {
    if (!built()) visit(bounds(), 0, true, uint32_t(shapes_));
}

void LazyObject::children(const std::function<void(const Primitive&)>& visit) const {
    if (built()) visit(*built());
}

void LazyObject::archive(StructureWriter& out) const { object().archive(out); }

std::unique_ptr<Primitive> build_lazily(const PrimitiveSet& any_set, const LazyBuild& build,
                                        int whole_size) {
    return std::visit(
        [&]<class Set>(const std::shared_ptr<const Set>& set) -> std::unique_ptr<Primitive> {
            // What is wrong with a parameter must be said now, not by a ray.
            build(std::make_shared<const Set>(set->subset({})));
            const Extent all = extent_of(*set);
            if (all.shapes == 0) return build(set);
            const double mean_cost = all.cost / double(all.shapes);
            return std::make_unique<LazyObject>(
                all.bounds, all.shapes, guessed_cost(all.shapes, mean_cost), set->bytes(),
                [set, build, whole_size, mean_cost] {
                    return build_upper(set, build, size_t(whole_size), mean_cost);
                });
        },
        any_set);
}

}  // namespace crofton
