#include "framework/lazy.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "framework/archive.h"
#include "framework/cost.h"
#include "framework/object_set.h"
#include "framework/parallel.h"
#include "framework/polygon_set.h"
#include "framework/quadric_set.h"
#include "framework/triangle_set.h"

namespace crofton {
namespace {

constexpr int halvings = 4;  ///< of a part into the parts below it: at most 16
constexpr size_t parallel_size = 1 << 15;

/// Shapes that stay together, as indices in the set.
struct Part {
    std::vector<uint32_t> shapes;
    Bounds3 bounds;
};

/// What a search structure costs before it is there: a descent of as many steps as it has levels.
double guessed_cost(uint64_t shapes, double mean_cost) {
    return cost_constants.node * std::log2(double(shapes) + 1) + 2 * mean_cost;
}

/// Cuts parts where their centres spread most, in the middle of their mean, until there are enough.
template <class Set>
class Partition {
  public:
    Partition(const Set& set, size_t whole_size) : set_(set), whole_size_(whole_size) {}

    std::vector<Part> run() {
        std::vector<Entry> entries;
        entries.resize(set_.size());
        parallel_for(entries.size(), parallel_size, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) {
                const uint32_t shape = uint32_t(i);
                const bool active = set_.active(shape);
                entries[i].shape = active ? shape : no_id;
                if (active) entries[i].center = set_.bounds(shape).center();
            }
        });
        std::erase_if(entries, [](const Entry& e) { return e.shape == no_id; });
        parts_.resize(size_t(1) << halvings);
        cut(entries, 0, parts_.size());
        std::erase_if(parts_, [](const Part& p) { return p.shapes.empty(); });
        return std::move(parts_);
    }

  private:
    struct Entry {
        Vec3f center;
        uint32_t shape;
    };

    /// @param first, count  the parts to fill
    void cut(std::span<Entry> entries, size_t first, size_t count) {
        if (count == 1 || entries.size() <= whole_size_) return fill(entries, parts_[first]);
        const size_t below = divide(entries);
        const auto left = [&] { cut(entries.first(below), first, count / 2); };
        const auto right = [&] { cut(entries.subspan(below), first + count / 2, count / 2); };
        if (entries.size() >= parallel_size) {
            parallel_invoke(left, right);
        } else {
            left();
            right();
        }
    }

    size_t divide(std::span<Entry> entries) const {
        Bounds3 spread;
        Vec3d sum = Vec3d::Zero();
        for (const Entry& e : entries) {
            spread.extend(e.center);
            sum += e.center.template cast<double>();
        }
        int axis;
        (spread.upper.cast<double>() - spread.lower.cast<double>()).maxCoeff(&axis);
        const float middle = float(sum[axis] / double(entries.size()));
        const auto end = std::partition(entries.begin(), entries.end(),
                                        [&](const Entry& e) { return e.center[axis] < middle; });
        const size_t below = size_t(end - entries.begin());
        // Few far away, or all in one place: by number.
        const bool lopsided = std::min(below, entries.size() - below) * 64 < entries.size();
        return lopsided ? entries.size() / 2 : below;
    }

    void fill(std::span<const Entry> entries, Part& part) const {
        part.shapes.reserve(entries.size());
        for (const Entry& e : entries) {
            part.shapes.push_back(e.shape);
            part.bounds.extend(set_.bounds(e.shape));
        }
        std::sort(part.shapes.begin(), part.shapes.end());
    }

    const Set& set_;
    size_t whole_size_;
    std::vector<Part> parts_;
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
