#include "accelerators/opening.h"

#include <algorithm>
#include <numeric>

#include "accelerators/tree_build.h"
#include "framework/cost.h"
#include "framework/parallel.h"

namespace crofton {
namespace {

constexpr size_t most_visits = 4096;     // nodes that one query of overlap looks into
constexpr size_t all_visits = 1u << 27;  // and all queries of a round
constexpr double least_saving = 0.95;  // the expected cost must fall to this, or nothing is opened
constexpr size_t most_entries = 1u << 24;  // as many as a scene may place meshes

/// Sums of half areas over a tree of boxes, for queries of overlap.
class OverlapTree {
  public:
    OverlapTree(const std::vector<ObjectSet::Object>& entries, const std::vector<uint32_t>& origin)
        : entries_(entries), origin_(origin) {
        BuildReferences references;
        for (uint32_t i = 0; i < entries.size(); ++i)
            if (const Bounds3& b = entries[i].primitive->bounds(); !b.empty())
                references.push_back({b, i, 1.0f});
        visits_ = std::clamp<size_t>(all_visits / std::max<size_t>(references.size(), 1), 64,
                                     most_visits);
        tree_ = build_binned(std::move(references), TreeCosts{1.0, 1, 0.0}, 8, 4);
        count_.assign(tree_.nodes.size(), 0);
        if (!tree_.empty()) count();
    }

    double overlap(uint32_t entry) const {
        const Bounds3& box = entries_[entry].primitive->bounds();
        if (tree_.empty() || box.empty()) return 0;
        double sum = 0;
        std::vector<uint32_t> open{0};
        for (size_t visits = 0; !open.empty(); ++visits) {
            const uint32_t n = open.back();
            const BinaryTree::Node& node = tree_.nodes[n];
            open.pop_back();
            if (!node.bounds.overlaps(box)) continue;
            if (visits >= visits_) {
                sum += half_area(intersection(node.bounds, box)) * count_[n];
            } else if (node.leaf()) {
                for (uint32_t i = node.first; i < node.first + node.count; ++i)
                    sum += overlap(entry, box, tree_.order[i]);
            } else {
                open.push_back(node.right);
                open.push_back(node.left);
            }
        }
        return sum;
    }

  private:
    double overlap(uint32_t entry, const Bounds3& box, uint32_t other) const {
        if (origin_[other] == origin_[entry]) return 0;
        return half_area(intersection(entries_[other].primitive->bounds(), box));
    }
    /// Entries below each node: parents come before their children.
    void count() {
        std::vector<uint32_t> order{0};
        for (size_t i = 0; i < order.size(); ++i)
            if (const BinaryTree::Node& node = tree_.nodes[order[i]]; !node.leaf())
                order.insert(order.end(), {node.left, node.right});
        for (size_t i = order.size(); i-- > 0;) {
            const BinaryTree::Node& node = tree_.nodes[order[i]];
            count_[order[i]] = node.leaf() ? node.count : count_[node.left] + count_[node.right];
        }
    }

    const std::vector<ObjectSet::Object>& entries_;
    const std::vector<uint32_t>& origin_;
    BinaryTree tree_;
    std::vector<uint32_t> count_;
    size_t visits_;
};

/// Nominal ns of a line that meets the box of all entries, of a binary tree over them, by areas
/// (MacDonald & Booth 1990).
double tree_cost(const ObjectSet& entries) {
    TreeCosts costs;
    costs.node = cost_constants.node;
    const BinaryTree tree = build_binned(build_references(entries), costs, 16, 8);
    if (tree.empty()) return 0;
    double sum = 0;
    std::vector<uint32_t> open{0};
    while (!open.empty()) {
        const BinaryTree::Node& node = tree.nodes[open.back()];
        open.pop_back();
        if (node.leaf()) {
            for (uint32_t i = node.first; i < node.first + node.count; ++i) {
                const uint32_t e = tree.order[i];
                sum += half_area(node.bounds) * cost_constants.object +
                       half_area(entries.bounds(e)) * (entries.cost(e) - cost_constants.object);
            }
        } else {
            sum += half_area(node.bounds) * cost_constants.node;
            open.push_back(node.left);
            open.push_back(node.right);
        }
    }
    return sum / half_area(tree.nodes[0].bounds);
}

class Opener {
  public:
    Opener(std::vector<ObjectSet::Object> objects, double growth)
        : given_(objects.size()),
          budget_(std::min(double(most_entries), growth * double(objects.size()))) {
        result_.objects = std::move(objects);
        result_.origin.resize(given_);
        std::iota(result_.origin.begin(), result_.origin.end(), 0u);
        closed_.assign(given_, false);
    }

    OpenedObjects run(OpeningRule rule) {
        if (rule == OpeningRule::where_it_pays)
            open_to_least_cost();
        else
            while (result_.objects.size() < budget_ && round()) {
            }
        std::vector<uint32_t> parts(given_, 0);
        for (const uint32_t origin : result_.origin) result_.opened += ++parts[origin] == 2;
        return std::move(result_);
    }

  private:
    /// Keeps what is cheapest of all rounds: one that does not pay may be on the way to one that
    /// does.
    void open_to_least_cost() {
        OpenedObjects best = result_;
        double least = least_saving * tree_cost(ObjectSet(result_.objects));
        while (result_.objects.size() < budget_ && round()) {
            const double cost = tree_cost(ObjectSet(result_.objects));
            if (!(cost < least)) continue;
            least = cost;
            best = result_;
        }
        result_ = std::move(best);
    }

    /// Opens the entries that overlap most, until half of the budget that is left is spent: what
    /// overlaps changes with each. @return whether any was opened
    bool round() {
        const std::vector<uint32_t> candidates = by_overlap();
        const size_t left = size_t(budget_) - result_.objects.size();
        const size_t share = std::max<size_t>(left / 2, std::min<size_t>(left, 64));
        std::vector<const std::vector<PlacedPrimitive>*> replaced(result_.objects.size(), nullptr);
        size_t added = 0;
        for (const uint32_t i : candidates) {
            if (added >= share) break;
            const std::vector<PlacedPrimitive>& parts = cache_.parts(result_.objects[i].primitive);
            if (parts.size() < 2 || added + parts.size() - 1 > left) {
                closed_[i] = true;
                continue;
            }
            replaced[i] = &parts;
            added += parts.size() - 1;
        }
        if (added > 0) replace(replaced);
        return added > 0;
    }

    std::vector<uint32_t> by_overlap() const {
        const OverlapTree tree(result_.objects, result_.origin);
        std::vector<double> overlap(result_.objects.size(), 0);
        parallel_for(overlap.size(), 64, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i)
                if (!closed_[i]) overlap[i] = tree.overlap(uint32_t(i));
        });
        std::vector<uint32_t> order;
        for (uint32_t i = 0; i < overlap.size(); ++i)
            if (overlap[i] > 0) order.push_back(i);
        std::stable_sort(order.begin(), order.end(),
                         [&](uint32_t a, uint32_t b) { return overlap[a] > overlap[b]; });
        return order;
    }

    /// Parts take their object's place and its instance.
    void replace(const std::vector<const std::vector<PlacedPrimitive>*>& replaced) {
        OpenedObjects next;
        std::vector<bool> closed;
        for (size_t i = 0; i < replaced.size(); ++i) {
            const ObjectSet::Object& old = result_.objects[i];
            if (!replaced[i]) {
                next.objects.push_back(old);
                closed.push_back(closed_[i]);
            } else {
                for (const PlacedPrimitive& part : *replaced[i]) {
                    next.objects.push_back({part.primitive, old.instance + part.instance});
                    closed.push_back(false);
                }
            }
            next.origin.resize(next.objects.size(), result_.origin[i]);
        }
        result_ = std::move(next);
        closed_ = std::move(closed);
    }

    const size_t given_;
    const double budget_;
    OpenedObjects result_;
    std::vector<bool> closed_;  ///< cannot be opened, or not within the budget
    PartCache cache_;
};

}  // namespace

OpenedObjects open_overlapping(std::vector<ObjectSet::Object> objects, double growth,
                               OpeningRule rule) {
    return Opener(std::move(objects), growth).run(rule);
}

ShapeGroups moved_groups(const ShapeGroups& groups, const OpenedObjects& opened) {
    ShapeGroups moved;
    for (const ShapeGroup& g : groups) {
        const auto at = [&](uint32_t object) {
            return uint32_t(std::lower_bound(opened.origin.begin(), opened.origin.end(), object) -
                            opened.origin.begin());
        };
        moved.push_back({at(g.first), at(g.end)});
    }
    return moved;
}

}  // namespace crofton
