#include "accelerators/nested_grid.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "accelerators/nested_grid.cpp"
#include <hwy/foreach_target.h>

#include "accelerators/grid_walk.h"
#include "framework/accelerator.h"

HWY_BEFORE_NAMESPACE();
namespace crofton {
namespace HWY_NAMESPACE {

/// One ray's way through all grids of a structure.
template <Query Q, bool UseMailbox, class Set, class C>
class NestedGridWalk {
  public:
    NestedGridWalk(const NestedGrid<Set>& nested, const Set& set, const LocalRay& ray, RayQuery& q,
                   C& counters)
        : nested_(nested), set_(set), ray_(ray), q_(q), counters_(counters), exact_(ray, q) {}

    /// Every grid decides for itself whether its margins hold the ray's thickness: fine grids have
    /// narrow margins. The depth of the recursion is that of the structure.
    bool enter(uint32_t index) {
        const NestedGridHeader& grid = nested_.grids[index];
        if (HWY_UNLIKELY(!exact_.fits(grid.space))) return enter_thick(grid);
        double t_enter, t_leave;
        if (!meets_grid(grid.space, exact_, ray_, false, q_, t_enter, t_leave)) return false;
        // The box is a margin larger than what is in it, so that the exact ray is inside it
        // wherever a shape may be hit.
        return BlockWalk(grid.space, nested_.blocks.data() + grid.first_block, exact_, t_enter)
            .run(true, q_, counters_, [&](uint32_t place) HWY_ATTR { return visit(place); });
    }

  private:
    HWY_NOINLINE bool enter_thick(const NestedGridHeader& grid) {
        double t_enter, t_leave;
        if (!meets_grid(grid.space, exact_, ray_, true, q_, t_enter, t_leave)) return false;
        return walk_blocks_thick(grid.space, nested_.blocks.data() + grid.first_block, ray_, q_,
                                 t_enter, t_leave, counters_,
                                 [&](uint32_t place) HWY_ATTR { return visit(place); });
    }
    HWY_INLINE bool visit(uint32_t place) {
        const uint32_t code = nested_.words[place];
        if (code & nested_cell::grid_flag) return enter(code & ~nested_cell::grid_flag);
        counters_.cell(false);
        // One call for a list and for a single shape, so that the test is compiled once.
        const uint32_t single = code & ~list_code::single_flag;
        const bool alone = code & list_code::single_flag;
        const uint32_t* list = nested_.words.data() + (alone ? 0 : code);
        const uint32_t count = alone ? 1 : *list & ~nested_cell::grid_flag;
        if (count > 0 && test_shapes_of(alone ? &single : list + 1, count)) return true;
        if (HWY_LIKELY(alone || !(*list & nested_cell::grid_flag))) return false;
        return enter_grids_of(list + 1 + count);
    }
    /// @param grids  their number, then they
    HWY_NOINLINE bool enter_grids_of(const uint32_t* grids) {
        for (uint32_t i = 1; i <= grids[0]; ++i) {
            // An object that stands in several cells is walked once, as a rule.
            uint32_t& seen = entered_[grids[i] % remembered];
            if (seen == grids[i]) continue;
            seen = grids[i];
            if (enter(grids[i])) return true;
        }
        return false;
    }
    HWY_INLINE bool test_shapes_of(const uint32_t* shapes, uint32_t count) {
        return mailbox_.test_fresh(shapes, count, [&](const uint32_t* fresh, uint32_t n) HWY_ATTR {
            return test_stored<Q>(nested_.shapes, set_, fresh, n, ray_, q_, counters_);
        });
    }

    static constexpr uint32_t remembered = 16;
    const NestedGrid<Set>& nested_;
    const Set& set_;
    const LocalRay& ray_;
    RayQuery& q_;
    C& counters_;
    const ExactRay exact_;
    [[no_unique_address]] std::conditional_t<UseMailbox, Mailbox, NoMailbox> mailbox_;
    uint32_t entered_[remembered] = {};  ///< 0, the root, never stands in a list
};

struct NestedGridTraversal {
    template <Query Q, class Set, class C>
    static bool run(const NestedGrid<Set>& nested, const Set& set, const LocalRay& ray, RayQuery& q,
                    C& counters) {
        if (nested.grids.empty()) return false;
        if (nested.mailbox)
            return NestedGridWalk<Q, true, Set, C>(nested, set, ray, q, counters).enter(0);
        return NestedGridWalk<Q, false, Set, C>(nested, set, ray, q, counters).enter(0);
    }
};

}  // namespace HWY_NAMESPACE
}  // namespace crofton
HWY_AFTER_NAMESPACE();

CROFTON_ACCELERATOR_KERNELS(NestedGrid, NestedGridTraversal, NestedGridParameters)

#if HWY_ONCE
#include "accelerators/leaves.h"
#include "accelerators/shape_clusters.h"
#include "framework/cost.h"
#include "framework/crofton.h"
#include "framework/parallel.h"

namespace crofton {
namespace {

using nested_cell::grid_flag;

constexpr double enter_cost = 40.0;          ///< nominal ns to enter a grid
constexpr double list_access = 8.0;          ///< and to find a list and ask the mailbox
constexpr double two_level_coarseness = 16;  ///< the top grid of two has so many fewer cells
constexpr double merge_ratio = 1.5;          ///< Havran & Sixta 1999: f of their adaptive grids
constexpr double most_per_shape = 32;        ///< references and cells of one grid, per shape in it
constexpr size_t most_words_per_shape = 64;  ///< of all cells and references, beyond the first 2^22

/// A grid in the making.
struct Draft {
    GridSpace space;
    Bounds3 content;  ///< of what stands in it
    std::vector<uint32_t> first,
        items;  ///< per cell, by blocks; items: shapes, or grid_flag | draft
    std::vector<std::pair<uint32_t, uint32_t>> children;  ///< cell, draft; by cell
    double cost = 0;                                      ///< of a line that meets the content
    int levels = 0;                                       ///< of grids that may still stand inside
    std::span<const uint32_t> in(size_t cell) const {
        return {items.data() + first[cell], items.data() + first[cell + 1]};
    }
};

template <class Set>
class NestedGridBuilder {
  public:
    NestedGridBuilder(const Set& set, const NestedGridParameters& p, NestedGrid<Set>& out)
        : set_(set), p_(p), out_(out) {}

    void build() {
        BuildReferences shapes = build_references(set_);
        if (shapes.empty()) return;
        for (const BuildReference& r : shapes) out_.box.extend(r.bounds);
        const size_t active = shapes.size();
        most_words_ = (size_t(1) << 22) + most_words_per_shape * active;
        double cost_sum = 0;
        for (const BuildReference& r : shapes) cost_sum += r.cost;

        uint32_t root = 0;
        switch (p_.method) {
            case NestedGridMethod::two_level:
                scene_of_its_own_ = std::max<size_t>(1024, active / 32);
                root = add(make(all(shapes), nullptr, p_.density / two_level_coarseness));
                refine({root}, 1);
                break;
            case NestedGridMethod::recursive:
                root = add(make(all(shapes), nullptr, p_.density));
                refine({root}, p_.max_depth - 1);
                break;
            case NestedGridMethod::adaptive:
                root = build_adaptive(std::move(shapes));
                break;
            case NestedGridMethod::hierarchy:
                root = build_hierarchy(shapes);
                break;
        }
        out_.shapes = ShapeStore<Set>(set_);
        write(root, 0);
        out_.shapes.finish();
        out_.cost = drafts_[root].cost;
        out_.stats.N_IN = out_.grids.size();
        out_.stats.bytes = out_.grids.size() * sizeof(NestedGridHeader) +
                           out_.blocks.size() * sizeof(CellBlock) +
                           out_.words.size() * sizeof(uint32_t) + out_.shapes.bytes();
        out_.mailbox =
            wants_mailbox(p_.mailbox, std::is_same_v<Set, ObjectSet>, double(out_.stats.N_OIV),
                          double(active), reference_cost<Set>(cost_sum / double(active)));
    }

  private:
    using Items = std::vector<uint32_t>;
    struct Part {
        uint32_t item;
        Bounds3 box;
    };

    static Items all(const BuildReferences& shapes) {
        Items items;
        items.reserve(shapes.size());
        for (const BuildReference& r : shapes) items.push_back(r.shape);
        return items;
    }
    uint32_t add(Draft draft) {
        drafts_.push_back(std::move(draft));
        return uint32_t(drafts_.size() - 1);
    }

    // What a shape and a grid that stands in cells have in common.
    double item_cost(uint32_t item) const {
        return item & grid_flag ? enter_cost + drafts_[item & ~grid_flag].cost : set_.cost(item);
    }
    /// Triangles are tested by fours: what spares a cell its second block gains, what only leaves
    /// lanes empty does not.
    double list_cost(std::span<const uint32_t> items) const {
        if (items.empty()) return 0;
        double sum = list_access;
        size_t triangles = 0;
        for (const uint32_t item : items) {
            if (std::is_same_v<Set, TriangleSet> && !(item & grid_flag))
                ++triangles;
            else
                sum += item_cost(item);
        }
        constexpr double block = cost_constants.triangle_block + cost_constants.triangle_gather;
        return sum + double((triangles + 3) / 4) * block;
    }
    Bounds3 item_box(uint32_t item) const {
        return item & grid_flag ? drafts_[item & ~grid_flag].content : set_.bounds(item);
    }
    double item_magnitude(uint32_t item) const {
        return item & grid_flag ? drafts_[item & ~grid_flag].space.magnitude
                                : double(set_.bounds(item).magnitude());
    }
    Bounds3 item_part(uint32_t item, const Bounds3& region) const {
        if (item & grid_flag) return intersection(item_box(item), region);
        const Bounds3 whole = set_.bounds(item);
        return region.contains(whole) ? whole : set_.clipped_bounds(item, region);
    }

    /// The rule's resolution, lowered until large shapes cannot fill the memory.
    Vec3i resolution_for(const std::vector<Part>& parts, const Bounds3& box, double density) const {
        UniformGridParameters rule;
        rule.resolution = p_.resolution;
        rule.density = density;
        Vec3i n = grid_resolution(rule, box, parts.size());
        const double most = most_per_shape * double(parts.size()) + 4096;
        const Vec3d extent = (box.upper.cast<double>() - box.lower.cast<double>())
                                 .cwiseMax(std::numeric_limits<float>::min());
        const size_t stride = std::max<size_t>(1, parts.size() / 1024);
        constexpr bool flat = std::is_same_v<Set, TriangleSet> || std::is_same_v<Set, PolygonSet>;
        while (n.maxCoeff() > 1) {
            const Vec3d cell = extent.cwiseQuotient(n.cast<double>());
            double sum = 0;
            for (size_t i = 0; i < parts.size(); i += stride)
                sum += cells_spanned(parts[i].box, cell, flat);
            if (sum * double(stride) <= most && n.cast<double>().prod() <= most) break;
            n = (n.cast<double>() * 0.8).cast<int>().cwiseMax(1);
        }
        return n;
    }

    /// @param region  what to clip the items to; null: nothing
    /// @param limit   gives up if a line through the region would cost more
    /// @return        a grid without cells if it gave up or nothing of the items is inside
    Draft make(std::span<const uint32_t> items, const Bounds3* region, double density,
               double limit = std::numeric_limits<double>::infinity()) const {
        Draft draft;
        std::vector<Part> parts(items.size());
        const size_t grain = 2048;
        parallel_for(items.size(), grain, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                parts[i] = {items[i], region ? item_part(items[i], *region) : item_box(items[i])};
        });
        std::erase_if(parts, [](const Part& part) { return part.box.empty(); });
        if (parts.empty()) return draft;
        double magnitude = 0;
        for (const Part& part : parts) {
            draft.content.extend(part.box);
            magnitude = std::max(magnitude, item_magnitude(part.item));
        }
        draft.space = widened_space(draft.content, resolution_for(parts, draft.content, density),
                                    magnitude, out_.box.magnitude());
        if (region &&
            sampled_cost(parts, draft) > 1.2 * limit / probability(draft.content, *region))
            return draft;
        sort_into_cells(parts, draft);
        draft.cost = flat_cost(draft);
        return draft;
    }

    /// What flat_cost will be at least, from a sample of many items: where shapes lie on top of
    /// each other, no grid tells them apart, and none should be tried in full.
    double sampled_cost(const std::vector<Part>& parts, const Draft& draft) const {
        constexpr size_t many = 2048;
        if (parts.size() < many) return 0;
        const size_t stride = parts.size() / (many / 8);
        std::vector<Part> sample;
        for (size_t i = 0; i < parts.size(); i += stride) sample.push_back(parts[i]);
        Draft trial;
        trial.space = draft.space;
        trial.content = draft.content;
        sort_into_cells(sample, trial);
        double sum = 0;
        for (const uint32_t item : trial.items) sum += item_cost(item);
        return line_cost(trial, sum * double(parts.size()) / double(sample.size()));
    }
    static double probability(const Bounds3& inner, const Bounds3& outer) {
        return std::clamp(hit_probability(inner, outer), 0x1p-20, 1.0);
    }

    /// Counting sort by cell; items stay in their order within one.
    void sort_into_cells(const std::vector<Part>& parts, Draft& draft) const {
        constexpr size_t range = 2048;
        using Entry = std::pair<uint32_t, uint32_t>;
        std::vector<std::vector<Entry>> entries((parts.size() + range - 1) / range);
        parallel_for(entries.size(), 1, [&](size_t begin, size_t end) {
            for (size_t k = begin; k < end; ++k)
                for (size_t i = k * range; i < std::min(parts.size(), (k + 1) * range); ++i)
                    cells_of_part(draft.space, parts[i], [&](int x, int y, int z) {
                        entries[k].emplace_back(
                            uint32_t(blocked_index(draft.space.resolution, x, y, z)),
                            parts[i].item);
                    });
        });
        const size_t cells = block_count(draft.space.resolution) * 64;
        draft.first.assign(cells + 1, 0);
        for (const auto& list : entries)
            for (const Entry& e : list) ++draft.first[e.first + 1];
        for (size_t c = 0; c < cells; ++c) draft.first[c + 1] += draft.first[c];
        draft.items.resize(draft.first.back());
        std::vector<uint32_t> next(draft.first.begin(), draft.first.end() - 1);
        for (const auto& list : entries)
            for (const Entry& e : list) draft.items[next[e.first]++] = e.second;
    }
    template <class Visit>
    void cells_of_part(const GridSpace& space, const Part& part, Visit&& visit) const {
        if (!(part.item & grid_flag)) {
            for_each_cell(space, set_, part.item, part.box, visit);
            return;
        }
        int low[3], high[3];
        for (int a = 0; a < 3; ++a) {
            low[a] = space.index(a, part.box.lower[a] - space.margin[a]);
            high[a] = space.index(a, part.box.upper[a] + space.margin[a]);
        }
        for (int z = low[2]; z <= high[2]; ++z)
            for (int y = low[1]; y <= high[1]; ++y)
                for (int x = low[0]; x <= high[0]; ++x) visit(x, y, z);
    }

    /// Expected cost of a line that meets the content, all cells being lists.
    double flat_cost(const Draft& draft) const {
        double sum = 0;
        for (size_t c = 0; c + 1 < draft.first.size(); ++c) sum += list_cost(draft.in(c));
        return line_cost(draft, sum);
    }
    double line_cost(const Draft& draft, double cost_of_cells) const {
        const double cells = expected_cells(draft.space.resolution, draft.content);
        return cells * (cost_constants.cell + cost_of_cells / double(draft.space.cells()));
    }

    /// The best grid for the content of one cell, or one without cells if a list costs less. Of two
    /// levels, a cell with a large share of all shapes (the teapot in the stadium) is a scene of
    /// its own, and has two levels again.
    Draft split(const Draft& parent, uint32_t cell, int level) const {
        const Vec3i at = cell_at(parent.space.resolution, cell);
        const Bounds3 box = parent.space.cell_box(at[0], at[1], at[2]);
        Bounds3 region = box;
        for (int a = 0; a < 3; ++a) {
            region.lower[a] = next_below(float(box.lower[a] - parent.space.margin[a]));
            region.upper[a] = next_above(float(box.upper[a] + parent.space.margin[a]));
        }
        const std::span<const uint32_t> items = parent.in(cell);
        double least = list_cost(items);
        Draft best;
        const auto offer = [&](double density, int levels) {
            Draft draft = make(items, &region, density, least);
            if (draft.first.empty()) return false;
            const double cost = probability(draft.content, box) * (enter_cost + draft.cost);
            if (cost >= least || draft.items.size() > most_per_shape * items.size()) return false;
            draft.levels = levels;
            least = cost;
            best = std::move(draft);
            return true;
        };
        if (p_.method != NestedGridMethod::two_level) {
            offer(p_.density, parent.levels - 1);
        } else if (items.size() >= scene_of_its_own_ && level < p_.max_depth) {
            offer(p_.density / two_level_coarseness, parent.levels);
        } else {
            // The last level chooses the resolution by its cost.
            for (const double factor : {1.0, 4.0, 16.0})
                if (!offer(p_.density * factor, parent.levels - 1)) break;
        }
        return best;
    }

    /// Gives grids to crowded cells, level by level, until nothing is gained, the levels are used
    /// up or memory would be.
    void refine(std::vector<uint32_t> open, int levels) {
        for (const uint32_t d : open) drafts_[d].levels = levels;
        for (int level = 1; !open.empty(); ++level) {
            std::vector<std::pair<uint32_t, uint32_t>> tasks;
            for (const uint32_t d : open)
                for (uint32_t c = 0; drafts_[d].levels > 0 && c + 1 < drafts_[d].first.size(); ++c)
                    if (drafts_[d].in(c).size() > size_t(p_.max_per_cell)) tasks.push_back({d, c});
            open.clear();
            // In batches, so that what is tried and dropped does not fill the memory either.
            constexpr size_t batch = 256;
            for (size_t first = 0; first < tasks.size(); first += batch) {
                std::vector<Draft> found(std::min(batch, tasks.size() - first));
                parallel_for(found.size(), 1, [&](size_t begin, size_t end) {
                    for (size_t t = begin; t < end; ++t) {
                        const auto& [draft, cell] = tasks[first + t];
                        found[t] = split(drafts_[draft], cell, level);
                    }
                });
                for (size_t t = 0; t < found.size(); ++t) {
                    if (found[t].first.empty()) continue;
                    words_ += found[t].space.cells() + found[t].items.size();
                    if (words_ > most_words_) return;
                    const auto& [draft, cell] = tasks[first + t];
                    open.push_back(add(std::move(found[t])));
                    drafts_[draft].children.push_back({cell, open.back()});
                }
            }
        }
    }

    uint32_t build_adaptive(BuildReferences shapes) {
        Items top;
        std::vector<uint32_t> grids;
        for (const ShapeCluster& cluster : clusters_by_place(std::move(shapes), merge_ratio)) {
            if (cluster.shapes.size() <= size_t(p_.max_per_cell)) {
                top.insert(top.end(), cluster.shapes.begin(), cluster.shapes.end());
                continue;
            }
            grids.push_back(add(make(cluster.shapes, nullptr, p_.density)));
        }
        // Where a root stands over them, it is refined like them: shapes without a cluster get
        // grids of their own, which the source calls orphans' grids.
        const uint32_t root = root_over(std::move(top), grids);
        if (grids.empty() || root != grids[0]) grids.push_back(root);
        refine(grids, p_.max_depth - 1);
        return root;
    }

    uint32_t build_hierarchy(const BuildReferences& shapes) {
        std::vector<ShapeCluster> clusters = clusters_by_size(shapes, p_.max_depth);
        Items top;
        std::vector<uint32_t> top_grids;
        std::erase_if(clusters, [&](const ShapeCluster& c) {
            if (c.shapes.size() > size_t(p_.max_per_cell)) return false;
            top.insert(top.end(), c.shapes.begin(), c.shapes.end());
            return true;
        });
        // Small sizes come first, so that a grid is there when its parent needs it.
        std::vector<Items> inside(clusters.size());
        for (size_t c = 0; c < clusters.size(); ++c) {
            Items items = clusters[c].shapes;
            items.insert(items.end(), inside[c].begin(), inside[c].end());
            const uint32_t draft = add(make(items, nullptr, p_.density));
            const size_t parent = parent_of(clusters, c);
            if (parent < clusters.size())
                inside[parent].push_back(grid_flag | draft);
            else
                top_grids.push_back(draft);
        }
        return root_over(std::move(top), top_grids);
    }
    /// The smallest cluster of larger shapes that encloses cluster c, among the first of each size.
    static size_t parent_of(const std::vector<ShapeCluster>& clusters, size_t c) {
        constexpr size_t most = 256;
        size_t best = clusters.size();
        double least = std::numeric_limits<double>::infinity();
        size_t looked = 0;
        for (size_t k = clusters.size(); k-- > c + 1 && looked < most; ++looked) {
            if (clusters[k].size_class == clusters[c].size_class) break;
            const double area = half_area(clusters[k].bounds);
            if (area >= least || !clusters[k].bounds.contains(clusters[c].bounds)) continue;
            best = k;
            least = area;
        }
        return best;
    }

    /// A grid over shapes and grids, unless one grid is all there is.
    uint32_t root_over(Items shapes, const std::vector<uint32_t>& grids) {
        if (shapes.empty() && grids.size() == 1) return grids[0];
        std::sort(shapes.begin(), shapes.end());
        for (const uint32_t g : grids) shapes.push_back(grid_flag | g);
        return add(make(shapes, nullptr, p_.density));
    }

    /// Copies a draft and what stands in it to the flat arrays. @return its place in `grids`
    uint32_t write(uint32_t d, uint32_t depth) {
        const uint32_t index = uint32_t(out_.grids.size());
        const size_t first_block = out_.blocks.size();
        const Vec3i& n = drafts_[d].space.resolution;
        const size_t blocks = block_count(n);
        out_.grids.push_back({drafts_[d].space, uint32_t(first_block), depth});
        out_.blocks.resize(first_block + blocks);
        out_.stats.depth = std::max(out_.stats.depth, depth + 1);
        out_.stats.N_V += drafts_[d].space.cells() - drafts_[d].children.size();
        out_.stats.N_EV += drafts_[d].space.cells();

        // Lists first; grids inside come behind all of them.
        double cost = 0;
        std::vector<size_t> children, lists_of_grids;  // places of codes, and of lists with grids
        auto child = drafts_[d].children.begin();
        ListWriter<Set> lists(set_, out_.words, out_.shapes);
        for (size_t b = 0; b < blocks; ++b) {
            lists.begin(out_.blocks[first_block + b],
                        std::span(drafts_[d].first).subspan(b * 64, 65));
            for (size_t c = b * 64; c < b * 64 + 64; ++c) {
                const std::span<const uint32_t> items = drafts_[d].in(c);
                if (items.empty()) continue;
                --out_.stats.N_EV;
                if (child != drafts_[d].children.end() && child->first == c) {
                    ++child;
                    children.push_back(lists.put(grid_flag));
                    continue;
                }
                cost += list_cost(items);
                write_list(items, lists, lists_of_grids);
            }
        }
        measure_clearance(std::span(out_.blocks).subspan(first_block), blocks_of(n));
        for (size_t i = 0; i < children.size(); ++i) {
            const uint32_t inner = drafts_[d].children[i].second;
            const uint32_t place = write(inner, depth + 1);
            out_.words[children[i]] = grid_flag | place;
            cost += enter_cost + drafts_[inner].cost;
        }
        for (const size_t list : lists_of_grids) write_grids_of(list, depth);
        drafts_[d].cost = line_cost(drafts_[d], cost);
        return index;
    }
    void write_list(std::span<const uint32_t> items, ListWriter<Set>& lists,
                    std::vector<size_t>& lists_of_grids) {
        size_t shapes = 0;
        while (shapes < items.size() && !(items[shapes] & grid_flag)) ++shapes;
        out_.stats.N_OIV += shapes;
        if (shapes == items.size()) {
            lists.add(items);
            return;
        }
        AlignedVector<uint32_t>& words = out_.words;
        lists_of_grids.push_back(words.size());
        lists.put(uint32_t(words.size()));
        words.push_back(uint32_t(shapes) | grid_flag);
        for (size_t i = 0; i < shapes; ++i) words.push_back(out_.shapes.place(set_, items[i]));
        words.push_back(uint32_t(items.size() - shapes));
        words.insert(words.end(), items.begin() + ptrdiff_t(shapes), items.end());
    }
    /// Writes the grids that stand in a list, each once, and puts their places into it.
    void write_grids_of(size_t list, uint32_t depth) {
        const size_t grids = list + 1 + (out_.words[list] & ~grid_flag);
        for (size_t i = grids + 1; i <= grids + out_.words[grids]; ++i) {
            const uint32_t draft = out_.words[i] & ~grid_flag;
            auto [it, fresh] = written_.try_emplace(draft, 0);
            if (fresh) it->second = write(draft, depth + 1);
            out_.words[i] = it->second;
        }
    }

    const Set& set_;
    const NestedGridParameters& p_;
    NestedGrid<Set>& out_;
    std::vector<Draft> drafts_;
    size_t words_ = 0, most_words_ = 0;     ///< of cells and references inside others
    size_t scene_of_its_own_ = 0;           ///< shapes that make a cell one, for two levels
    std::map<uint32_t, uint32_t> written_;  ///< draft → grid, of those in lists
};

}  // namespace

template <class Set>
NestedGrid<Set> NestedGrid<Set>::build(const Set& set, const NestedGridParameters& p) {
    NestedGrid nested;
    NestedGridBuilder<Set>(set, p, nested).build();
    return nested;
}

template <class Set>
void NestedGrid<Set>::walk(const BoxVisitor& visit) const {
    // Cells reach a margin beyond the shapes.
    const auto inside = [&](const Bounds3& b) {
        Bounds3 cut = intersection(b, box);
        cut.upper = cut.upper.cwiseMax(cut.lower);
        return cut;
    };
    for (const NestedGridHeader& grid : grids) {
        visit(inside(grid.space.box), grid.depth, false, 0);
        const Vec3i& n = grid.space.resolution;
        for (int z = 0; z < n[2]; ++z)
            for (int y = 0; y < n[1]; ++y)
                for (int x = 0; x < n[0]; ++x) {
                    const uint32_t place =
                        code_place(blocks.data() + grid.first_block, blocked_index(n, x, y, z));
                    const uint32_t code = place == no_code ? 0 : words[place];
                    if (code & nested_cell::grid_flag) continue;
                    const uint32_t count = place == no_code ? 0
                                                            : list_length(code, words.data()) &
                                                                  ~nested_cell::grid_flag;
                    visit(inside(grid.space.cell_box(x, y, z)), grid.depth + 1, true, count);
                }
    }
}

CROFTON_REGISTER_ACCELERATOR(
    NestedGrid, NestedGridParameters, "nested_grid",
    "grids in the cells of grids: two levels, recursive, around clusters, or by size of shape",
    "Jevans & Wyvill 1989; Cazals et al. 1995; Klimaszewski & Sederberg 1997; Ize et al. 2007");

}  // namespace crofton
#endif
