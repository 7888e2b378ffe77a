#include "accelerators/sparse_grid.h"

#include <nanovdb/NanoVDB.h>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/sparse_grid.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/grid_walk.h"
#include "framework/accelerator.h"

#ifndef CROFTON_ACCELERATORS_SPARSE_GRID_CPP_ONCE_
#define CROFTON_ACCELERATORS_SPARSE_GRID_CPP_ONCE_
namespace crofton {

using UpperNode = nanovdb::Int32Tree::Node2;
using LowerNode = nanovdb::Int32Tree::Node1;
using LeafNode = nanovdb::Int32Tree::Node0;

/// 2^log2_dim blocks per axis, each 2^log2_span voxels wide.
template <class Node>
struct NodeShape {
    static constexpr int log2_dim = int(Node::LOG2DIM);
    static constexpr int log2_span = int(Node::TOTAL) - log2_dim;
    static constexpr int dim = 1 << log2_dim, span = 1 << log2_span;
    static uint32_t offset(int x, int y, int z) {
        return (uint32_t(x) << (2 * log2_dim)) | (uint32_t(y) << log2_dim) | uint32_t(z);
    }
};
inline constexpr int root_span = NodeShape<UpperNode>::dim * NodeShape<UpperNode>::span;
static_assert(root_span == 4096);

inline const LowerNode* child(const UpperNode& node, uint32_t offset) {
    return node.childMask().isOn(offset) ? node.data()->getChild(offset) : nullptr;
}
inline const LeafNode* child(const LowerNode& node, uint32_t offset) {
    return node.childMask().isOn(offset) ? node.data()->getChild(offset) : nullptr;
}

}  // namespace crofton
#endif

namespace crofton {
const UpperNode& upper_node(const SparseVoxels& voxels);
}

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// One ray's way through the nodes of one class.
template <Query Q, class Test, class Set, class C>
class SparseGridWalk {
  public:
    SparseGridWalk(const GridSpace& space, const uint32_t* words, const LocalRay& ray,
                   const ExactRay& exact, RayQuery& q, C& counters, Test& test)
        : space_(space),
          words_(words),
          ray_(ray),
          exact_(exact),
          q_(q),
          counters_(counters),
          test_(test) {}

    bool run(const UpperNode& root) {
        if (HWY_UNLIKELY(!exact_.fits(space_))) {
            const int base[3] = {0, 0, 0};
            return enter_thick(root, base);
        }
        double t_enter;
        if (!meets_grid(space_, exact_, ray_, false, q_, t_enter, t_leave_)) return false;
        set_up();
        return enter(root, Triple::all(0), t_enter);
    }

  private:
    /// Voxels are counted the way the ray goes, from the corner of the root node that it meets
    /// first.
    HWY_INLINE void set_up() {
        const Triple none = Triple::all(0);
        const Triple beyond = Triple::all(root_span);
        const Triple origin = Triple::load(exact_.origin);
        const Triple direction = Triple::load(exact_.direction);
        const Triple lower = Triple::load(space_.lower), rate = Triple::load(space_.inverse_cell);
        const Triple inverse = Triple::load(exact_.inverse);
        const TripleMask down = less(direction, none);
        const Triple speed = magnitude_of(direction);
        const TripleMask moves = less(none, speed);

        const Triple zero = (lower - origin) * inverse;
        const Triple pace = Triple::load(space_.cell) * inverse;
        pace_ = moves.choose(magnitude_of(pace), none);
        zero_ = moves.choose(down.choose(zero + beyond * pace, zero),
                             Triple::all(std::numeric_limits<double>::infinity()));
        const Triple start = (origin - lower) * rate;
        start_ = down.choose(beyond - start, start);
        speed_ = speed * rate;
    }

    /// Walks the blocks of a node along the exact ray, as BlockWalk does. Where a block is empty,
    /// that is one step, whatever its size; planes are those of the voxels at its sides.
    /// @param base  the node's first voxel
    /// @param t     where the ray enters the node
    template <class Node>
    bool enter(const Node& node, const Triple& base, double t) {
        using Shape = NodeShape<Node>;
        using D = Triple::D;
        const D d;
        const Triple span = Triple::all(Shape::span);
        const Triple size = Triple::all(Shape::span * Shape::dim), none = Triple::all(0);
        const double exit = std::min((zero_ + (base + size) * pace_).least(), t_leave_);
        const Triple in_node = start_ + Triple::all(t) * speed_ - base;
        const Triple block =
            floor_of(least_of(greatest_of(in_node * Triple::all(1.0 / Shape::span), none),
                              Triple::all(Shape::dim - 1)));
        Triple plane = base + block * span + span;
        Triple next = zero_ + plane * pace_;
        constexpr int log2 = Shape::log2_dim;
        constexpr uint32_t last = Shape::dim - 1;
        const uint32_t flip =
            Shape::offset(exact_.down[0] & last, exact_.down[1] & last, exact_.down[2] & last);
        uint32_t offset =
            Shape::offset(int(hn::GetLane(block.xy)), int(hn::GetLane(hn::Shuffle01(block.xy))),
                          int(hn::GetLane(block.z)));
        while (true) {
            if (visit(node, plane - span, offset ^ flip, t)) return true;
            const Triple after_plane = plane + span;
            const Triple after = zero_ + after_plane * pace_;
            auto least = hn::Min(next.xy, next.z);
            least = hn::Min(least, hn::Shuffle01(least));
            t = hn::GetLane(least);
            // Nodes reach beyond the grid, up to 4096 voxels.
            if (t >= exit || t > double(q_.t_cull)) return false;
            const TripleMask passed = {hn::Eq(next.xy, least), hn::Eq(next.z, least)};
            next = passed.choose(after, next);
            plane = passed.choose(after_plane, plane);
            uint8_t xy[8], z[8];
            hn::StoreMaskBits(d, passed.xy, xy);
            hn::StoreMaskBits(d, passed.z, z);
            static constexpr uint32_t moves[4] = {0, 1u << (2 * log2), 1u << log2,
                                                  1u << (2 * log2) | 1u << log2};
            offset += moves[xy[0] & 3] + (z[0] & 1u);
        }
    }

    /// @param base  the block's first voxel
    template <class Node>
    HWY_INLINE bool visit(const Node& node, const Triple& base, uint32_t offset, double t) {
        counters_.step();
        if constexpr (std::is_same_v<Node, LeafNode>) {
            return test_voxel(node, offset);
        } else {
            const auto* inner = child(node, offset);
            if (!inner) {
                counters_.cell(true);
                return false;
            }
            return enter(*inner, base, t);
        }
    }
    HWY_INLINE bool test_voxel(const LeafNode& leaf, uint32_t offset) {
        const bool active = leaf.valueMask().isOn(offset);
        counters_.cell(!active);
        if (!active) return false;
        return test_list(uint32_t(leaf.getValue(offset)), words_, test_);
    }

    /// The same for a ray that is thicker than the margins: every node looks at all its blocks that
    /// the thick ray touches.
    template <class Node>
    bool enter_thick(const Node& node, const int (&base)[3]) {
        using Shape = NodeShape<Node>;
        GridSpace blocks = space_;
        for (int a = 0; a < 3; ++a) {
            blocks.lower[a] = space_.plane(a, base[a]);
            blocks.cell[a] = space_.cell[a] * Shape::span;
            blocks.inverse_cell[a] = 1 / blocks.cell[a];
            blocks.resolution[a] = std::min(
                Shape::dim, (space_.resolution[a] - base[a] + Shape::span - 1) >> Shape::log2_span);
            blocks.box.lower[a] = float(blocks.lower[a]);
            blocks.box.upper[a] = float(blocks.plane(a, blocks.resolution[a]));
        }
        double t_enter, t_leave;
        if (!meets_grid(blocks, exact_, ray_, true, q_, t_enter, t_leave)) return false;
        const auto visit_block = [&](int x, int y, int z) HWY_ATTR {
            const int i[3] = {x, y, z};
            return visit_thick(node, base, i);
        };
        const auto past = [&](double t) HWY_ATTR { return t > double(q_.t_cull); };
        return walk_cells_thick(blocks, ray_, t_enter, t_leave, visit_block, past);
    }
    template <class Node>
    bool visit_thick(const Node& node, const int (&base)[3], const int (&i)[3]) {
        using Shape = NodeShape<Node>;
        const uint32_t offset = Shape::offset(i[0], i[1], i[2]);
        counters_.step();
        if constexpr (std::is_same_v<Node, LeafNode>) {
            return test_voxel(node, offset);
        } else {
            const auto* inner = child(node, offset);
            if (!inner) {
                counters_.cell(true);
                return false;
            }
            int origin[3];
            for (int a = 0; a < 3; ++a) origin[a] = base[a] + (i[a] << Shape::log2_span);
            return enter_thick(*inner, origin);
        }
    }

    const GridSpace& space_;
    const uint32_t* words_;
    const LocalRay& ray_;
    const ExactRay& exact_;
    RayQuery& q_;
    C& counters_;
    Test& test_;
    double t_leave_;        ///< where the exact ray leaves the grid
    Triple zero_, pace_;    ///< t of plane i is zero + i·pace; d = 0: zero is infinity
    Triple start_, speed_;  ///< the ray's voxel at t is start + t·speed
};

struct SparseGridTraversal {
    template <Query Q, class Set, class C>
    static bool run(const SparseGrid<Set>& grid, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (grid.classes.empty()) return false;
        return grid.mailbox ? run_with<Q, Mailbox>(grid, set, ray, q, counters)
                            : run_with<Q, NoMailbox>(grid, set, ray, q, counters);
    }

  private:
    template <Query Q, class Box, class Set, class C>
    static bool run_with(const SparseGrid<Set>& grid, const Set& set, const LocalRay& ray,
                         RayQuery& q, C& counters) {
        Box mailbox;
        const auto test = [&](const uint32_t* shapes, uint32_t count) HWY_ATTR {
            return mailbox.test_fresh(
                shapes, count, [&](const uint32_t* fresh, uint32_t n) HWY_ATTR {
                    return test_stored<Q>(grid.shapes, set, fresh, n, ray, q, counters);
                });
        };
        return run_classes<Q>(grid, ray, q, counters, test);
    }
    template <Query Q, class Test, class Set, class C>
    static bool run_classes(const SparseGrid<Set>& grid, const LocalRay& ray, RayQuery& q,
                            C& counters, const Test& test) {
        const ExactRay exact(ray, q);
        for (const SparseGridClass& one : grid.classes) {
            SparseGridWalk<Q, const Test, Set, C> walk(one.space, grid.words.data(), ray, exact, q,
                                                       counters, test);
            if (walk.run(upper_node(*one.voxels))) return true;
        }
        return false;
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(SparseGrid, SparseGridTraversal, SparseGridParameters)

#if HWY_ONCE
#include <openvdb/openvdb.h>

#include <nanovdb/util/OpenToNanoVDB.h>

#include "accelerators/binary_tree.h"
#include "accelerators/leaves.h"
#include "framework/cost.h"
#include "framework/crofton.h"
#include "framework/parallel.h"

namespace crofton {

struct SparseVoxels {
    nanovdb::GridHandle<nanovdb::HostBuffer> handle;
    const UpperNode* root;

    explicit SparseVoxels(nanovdb::GridHandle<nanovdb::HostBuffer> h) : handle(std::move(h)) {
        root = handle.grid<int32_t>()->tree().template getFirstNode<2>();
    }
};
void archive_voxels(ArchiveWriter& out, std::shared_ptr<const SparseVoxels>& voxels) {
    out(uint64_t(voxels->handle.size()));
    out.raw(voxels->handle.data(), voxels->handle.size());
}
void archive_voxels(ArchiveReader& in, std::shared_ptr<const SparseVoxels>& voxels) {
    uint64_t size;
    in(size);
    auto buffer = nanovdb::HostBuffer::create(size);
    in.raw(buffer.data(), size);
    nanovdb::GridHandle<nanovdb::HostBuffer> handle(std::move(buffer));
    if (!handle.grid<int32_t>()) in.refuse("holds no grid of voxels where there should be one");
    voxels = std::make_shared<const SparseVoxels>(std::move(handle));
}
const UpperNode& upper_node(const SparseVoxels& voxels) { return *voxels.root; }

namespace {

constexpr double most_references = 24;       ///< per shape, in one class
constexpr size_t most_leaf_bytes = 1 << 10;  ///< of all leaf nodes, per shape, beyond 64 MiB
constexpr double enter_cost = 8.0;           ///< nominal ns to enter a node

/// A shape in a voxel. Keys sort by leaf node, then by place in it.
struct Entry {
    uint64_t key;
    uint32_t shape;
};
uint64_t voxel_key(int x, int y, int z) {
    const uint64_t leaf = (uint64_t(x >> 3) << 18) | (uint64_t(y >> 3) << 9) | uint64_t(z >> 3);
    return (leaf << 9) | NodeShape<LeafNode>::offset(x & 7, y & 7, z & 7);
}
openvdb::Coord voxel_of(uint64_t key) {
    const int leaf = int(key >> 9), voxel = int(key & 511);
    return {((leaf >> 18) << 3) | (voxel >> 6), (((leaf >> 9) & 511) << 3) | ((voxel >> 3) & 7),
            ((leaf & 511) << 3) | (voxel & 7)};
}

/// Stable, by key: three passes of 12 bits.
void radix_sort(std::vector<Entry>& entries) {
    std::vector<Entry> other(entries.size());
    for (int shift = 0; shift < 36; shift += 12) {
        std::vector<size_t> place(4097, 0);
        for (const Entry& e : entries) ++place[((e.key >> shift) & 4095) + 1];
        for (int i = 0; i < 4096; ++i) place[i + 1] += place[i];
        for (const Entry& e : entries) other[place[(e.key >> shift) & 4095]++] = e;
        entries.swap(other);
    }
}

template <class Set>
class SparseGridBuilder {
  public:
    SparseGridBuilder(const Set& set, const SparseGridParameters& p, SparseGrid<Set>& out)
        : set_(set), p_(p), out_(out) {}

    void build() {
        BuildReferences shapes = build_references(set_);
        if (shapes.empty()) return;
        double cost_sum = 0;
        for (const BuildReference& r : shapes) {
            out_.box.extend(r.bounds);
            cost_sum += r.cost;
        }
        const double active = double(shapes.size());
        out_.shapes = ShapeStore<Set>(set_);
        leaf_bytes_left_ = (size_t(64) << 20) + most_leaf_bytes * shapes.size();
        for (int left = p_.size_classes; !shapes.empty(); --left) {
            BuildReferences large = left > 1 ? split_off_large(shapes) : BuildReferences{};
            add_class(shapes, voxel_for(shapes, bounds_of(shapes)), p_.refinements);
            shapes = std::move(large);
        }
        std::reverse(out_.classes.begin(), out_.classes.end());
        out_.stats.depth = 3;
        out_.shapes.finish();
        out_.stats.bytes += out_.words.size() * sizeof(uint32_t) + out_.shapes.bytes();
        out_.mailbox =
            wants_mailbox(p_.mailbox, std::is_same_v<Set, ObjectSet>, double(out_.stats.N_OIV),
                          active, reference_cost<Set>(cost_sum / active));
    }

  private:
    static constexpr bool flat =
        std::is_same_v<Set, TriangleSet> || std::is_same_v<Set, PolygonSet>;

    static double extent_of(const Bounds3& b) {
        return (b.upper.cast<double>() - b.lower.cast<double>()).maxCoeff();
    }
    static Bounds3 bounds_of(const BuildReferences& shapes) {
        Bounds3 b;
        for (const BuildReference& r : shapes) b.extend(r.bounds);
        return b;
    }
    /// Edge of a voxel for these shapes, before memory limits it.
    double voxel_for(const BuildReferences& shapes, const Bounds3& content) const {
        std::vector<double> extents(shapes.size());
        for (size_t i = 0; i < shapes.size(); ++i) extents[i] = extent_of(shapes[i].bounds);
        std::nth_element(extents.begin(), extents.begin() + extents.size() / 2, extents.end());
        return std::max({extents[extents.size() / 2] / p_.density, finest(content),
                         double(std::numeric_limits<float>::min())});
    }
    /// Largest coordinate of the whole shapes, whatever part of them is meant.
    double magnitude_of(const BuildReferences& shapes) const {
        double magnitude = 0;
        for (const BuildReference& r : shapes)
            magnitude = std::max(magnitude, double(set_.bounds(r.shape).magnitude()));
        return magnitude;
    }
    static double references_of(const BuildReferences& shapes, double voxel) {
        double sum = 0;
        const Vec3d cell = Vec3d::Constant(voxel);
        for (const BuildReference& r : shapes) sum += cells_spanned(r.bounds, cell, flat);
        return sum;
    }

    /// Where few large shapes would fill most voxels, they are moved to a coarser grid.
    BuildReferences split_off_large(BuildReferences& shapes) const {
        const double voxel = voxel_for(shapes, bounds_of(shapes));
        BuildReferences large;
        if (references_of(shapes, voxel) <= most_references * double(shapes.size())) return large;
        const auto middle = std::stable_partition(
            shapes.begin(), shapes.end(),
            [&](const BuildReference& r) { return extent_of(r.bounds) <= 8 * voxel; });
        if (middle == shapes.begin()) return large;
        large.assign(middle, shapes.end());
        shapes.erase(middle, shapes.end());
        return large;
    }

    /// Shapes by voxel, at the finest resolution that memory allows.
    /// @param voxel  its edge, if so
    std::vector<Entry> entries_of(const BuildReferences& shapes, const Bounds3& content,
                                  double voxel, GridSpace& space) {
        while (references_of(shapes, voxel) > most_references * double(shapes.size()) + 4096 &&
               voxel < extent_of(content))
            voxel *= 1.25;
        while (true) {
            Vec3i n;
            for (int a = 0; a < 3; ++a) {
                const double extent = double(content.upper[a]) - content.lower[a];
                n[a] = int(std::clamp(std::ceil(extent / voxel), 1.0, double(p_.max_resolution)));
            }
            space = widened_space(content, n, magnitude_of(shapes), out_.box.magnitude());
            std::vector<Entry> entries = enter_all(shapes, space);
            radix_sort(entries);
            size_t leaves = 0;
            for (size_t i = 0; i < entries.size(); ++i)
                leaves += i == 0 || entries[i].key >> 9 != entries[i - 1].key >> 9;
            const size_t bytes = leaves * sizeof(LeafNode);
            if (bytes <= leaf_bytes_left_ || n.maxCoeff() == 1) {
                leaf_bytes_left_ -= std::min(bytes, leaf_bytes_left_);
                return entries;
            }
            voxel *= 2;
        }
    }
    std::vector<Entry> enter_all(const BuildReferences& shapes, const GridSpace& space) const {
        constexpr size_t range = 4096;
        std::vector<std::vector<Entry>> parts((shapes.size() + range - 1) / range);
        parallel_for(parts.size(), 1, [&](size_t begin, size_t end) {
            for (size_t part = begin; part < end; ++part)
                for (size_t i = part * range; i < std::min(shapes.size(), (part + 1) * range); ++i)
                    for_each_cell(space, set_, shapes[i].shape, shapes[i].bounds,
                                  [&](int x, int y, int z) {
                                      parts[part].push_back({voxel_key(x, y, z), shapes[i].shape});
                                  });
        });
        std::vector<Entry> all;
        for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
        return all;
    }

    /// Adds a grid for shapes, or for parts of them that fill voxels of another.
    void add_class(const BuildReferences& shapes, double voxel, int refinements) {
        const Bounds3 content = bounds_of(shapes);
        SparseGridClass one;
        const std::vector<Entry> entries =
            entries_of(shapes, content, std::max(voxel, finest(content)), one.space);
        const double finer = finer_voxel(entries, one.space, refinements);
        const auto tree = openvdb::Int32Grid::create(0);
        auto accessor = tree->getAccessor();
        BuildReferences crowd;
        std::vector<uint32_t> list;
        double cost = 0;
        size_t voxels = 0, references = 0;
        for (size_t i = 0, end; i < entries.size(); i = end) {
            list.clear();
            for (end = i; end < entries.size() && entries[end].key == entries[i].key; ++end)
                list.push_back(entries[end].shape);
            // Parts of a shape may come from two voxels.
            std::sort(list.begin(), list.end());
            list.erase(std::unique(list.begin(), list.end()), list.end());
            if (finer > 0 && end - i > size_t(p_.max_per_voxel)) {
                move_to(crowd, one.space, entries[i].key, list);
                continue;
            }
            accessor.setValueOn(voxel_of(entries[i].key), int32_t(write_list(list)));
            for (const uint32_t shape : list) cost += reference_cost<Set>(set_.cost(shape));
            references += list.size();
            ++voxels;
        }
        if (!crowd.empty()) add_class(crowd, finer, refinements - 1);
        if (voxels == 0) return;
        auto nano = std::make_shared<const SparseVoxels>(nanovdb::openToNanoVDB(
            *tree, nanovdb::StatsMode::Disable, nanovdb::ChecksumMode::Disable));
        const auto& nano_tree = nano->handle.template grid<int32_t>()->tree();
        count(one, content, nano_tree.nodeCount(1), nano_tree.nodeCount(0), voxels, references,
              cost);
        out_.stats.bytes += nano->handle.size();
        one.voxels = std::move(nano);
        out_.classes.push_back(std::move(one));
    }
    double finest(const Bounds3& content) const { return extent_of(content) / p_.max_resolution; }
    /// Edge of the voxels for what is in crowded ones; 0 if there are none, or if they could not be
    /// much finer.
    double finer_voxel(const std::vector<Entry>& entries, const GridSpace& space,
                       int refinements) const {
        if (refinements == 0) return 0;
        Bounds3 crowded;
        for (size_t i = 0, end; i < entries.size(); i = end) {
            for (end = i; end < entries.size() && entries[end].key == entries[i].key;) ++end;
            if (end - i <= size_t(p_.max_per_voxel)) continue;
            const openvdb::Coord at = voxel_of(entries[i].key);
            crowded.extend(space.cell_box(at[0], at[1], at[2]));
        }
        if (crowded.empty()) return 0;
        const double edge = std::max({space.cell[0], space.cell[1], space.cell[2]});
        const double finer = std::max(edge / 8, finest(crowded));
        return finer <= edge / 2 ? finer : 0;
    }
    /// @return  the list's code
    uint32_t write_list(const std::vector<uint32_t>& list) {
        const uint32_t first = out_.shapes.place(set_, list[0]);
        if (list.size() == 1 && first < list_code::single_flag)
            return list_code::single_flag | first;
        const uint32_t code = uint32_t(out_.words.size());
        out_.words.push_back(uint32_t(list.size()));
        for (const uint32_t shape : list) out_.words.push_back(out_.shapes.place(set_, shape));
        return code;
    }
    /// What a voxel holds of its shapes.
    void move_to(BuildReferences& crowd, const GridSpace& space, uint64_t key,
                 const std::vector<uint32_t>& list) const {
        const openvdb::Coord at = voxel_of(key);
        Bounds3 region = space.cell_box(at[0], at[1], at[2]);
        for (int a = 0; a < 3; ++a) {
            region.lower[a] = next_below(float(region.lower[a] - space.margin[a]));
            region.upper[a] = next_above(float(region.upper[a] + space.margin[a]));
        }
        for (const uint32_t shape : list) {
            const Bounds3 part = set_.clipped_bounds(shape, region);
            if (!part.empty()) crowd.push_back({part, shape, float(set_.cost(shape))});
        }
    }

    /// Statistics, and the expected cost: a line meets each node and voxel as its area says.
    void count(const SparseGridClass& one, const Bounds3& content, size_t lower, size_t leaves,
               size_t voxels, size_t references, double cost) {
        const Vec3i n = one.space.resolution;
        const Vec3i blocks = (n.array() + 127) / 128;
        const size_t empty =
            size_t(blocks.prod()) - lower + lower * 4096 - leaves + leaves * 512 - voxels;
        out_.stats.N_IN += 1 + lower + leaves;
        out_.stats.N_V += voxels + empty;
        out_.stats.N_EV += empty;
        out_.stats.N_OIV += references;

        const double all = std::max(half_area(out_.box), std::numeric_limits<double>::min());
        const auto met = [&](double edge) {
            Bounds3 b;
            b.lower = Vec3f::Zero();
            for (int a = 0; a < 3; ++a) b.upper[a] = float(edge * one.space.cell[a]);
            return std::min(1.0, half_area(b) / all);
        };
        const double step = cost_constants.cell;
        out_.cost += hit_probability(content, out_.box) *
                         (enter_cost + step * expected_cells(blocks, content)) +
                     double(lower) * met(128) * (enter_cost + 16 * step) +
                     double(leaves) * met(8) * (enter_cost + 8 * step) + met(1) * cost;
    }

    const Set& set_;
    const SparseGridParameters& p_;
    SparseGrid<Set>& out_;
    size_t leaf_bytes_left_ = 0;
};

/// Calls visit(block's first voxel, block's edge in voxels, child or null, offset) for blocks in
/// use.
template <class Node, class Visit>
void for_each_child(const Node& node, const Vec3i& base, Visit&& visit) {
    using Shape = NodeShape<Node>;
    for (int x = 0; x < Shape::dim; ++x)
        for (int y = 0; y < Shape::dim; ++y)
            for (int z = 0; z < Shape::dim; ++z)
                if (const auto* inner = child(node, Shape::offset(x, y, z)))
                    visit(*inner, Vec3i(base + Vec3i(x, y, z) * Shape::span));
}

}  // namespace

template <class Set>
SparseGrid<Set> SparseGrid<Set>::build(const Set& set, const SparseGridParameters& p) {
    SparseGrid grid;
    SparseGridBuilder<Set>(set, p, grid).build();
    return grid;
}

/// Empty blocks and voxels are not visited: there may be 2^36 of them.
template <class Set>
void SparseGrid<Set>::walk(const BoxVisitor& visit) const {
    for (const SparseGridClass& one : classes) {
        const auto box_of = [&](const Vec3i& first, int edge) {
            Bounds3 b;
            for (int a = 0; a < 3; ++a) {
                b.lower[a] = float(one.space.plane(a, first[a]));
                b.upper[a] = float(one.space.plane(a, first[a] + edge));
            }
            b = intersection(b, box);
            b.upper = b.upper.cwiseMax(b.lower);
            return b;
        };
        visit(box_of(Vec3i::Zero(), 4096), 0, false, 0);
        for_each_child(
            upper_node(*one.voxels), Vec3i::Zero(), [&](const LowerNode& lower, const Vec3i& at) {
                visit(box_of(at, 128), 1, false, 0);
                for_each_child(lower, at, [&](const LeafNode& leaf, const Vec3i& corner) {
                    visit(box_of(corner, 8), 2, false, 0);
                    for (uint32_t i = 0; i < 512; ++i)
                        if (leaf.valueMask().isOn(i))
                            visit(box_of(corner + Vec3i(i >> 6, (i >> 3) & 7, i & 7), 1), 3, true,
                                  list_length(uint32_t(leaf.getValue(i)), words.data()));
                });
            });
    }
}

CROFTON_REGISTER_ACCELERATOR(
    SparseGrid, SparseGridParameters, "sparse_grid",
    "sparse grid of fine voxels in a VDB tree, empty space skipped a node at a time",
    "Museth 2013: VDB; Museth 2021: NanoVDB; lists per voxel: Fujimoto, Tanaka, Iwata 1986");

}  // namespace crofton
#endif
