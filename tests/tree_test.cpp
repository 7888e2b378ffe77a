// What the builders of binary trees promise by themselves; hits are the business of
// conformance_test.

#include <cmath>
#include <cstring>

#include "accelerators/leaves.h"
#include "accelerators/tree_build.h"
#include "accelerators/wide_collapse.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

constexpr TreeBuilder all_builders[] = {
    TreeBuilder::median, TreeBuilder::binned_sah, TreeBuilder::sweep_sah, TreeBuilder::sbvh,
    TreeBuilder::ploc,   TreeBuilder::lbvh,       TreeBuilder::insertion};

TreeParameters with(TreeBuilder builder, int reinsertion = 0) {
    TreeParameters p;
    p.builder = builder;
    p.reinsertion = reinsertion;
    return p;
}

/// A node costs as much as a shape.
TreeCosts unit_costs() {
    TreeCosts costs;
    costs.node = 1;
    return costs;
}

std::vector<std::pair<std::string, std::shared_ptr<const TriangleSet>>> triangle_scenes() {
    std::vector<std::pair<std::string, std::shared_ptr<const TriangleSet>>> list;
    for (const test::HardScene& scene : test::hard_scenes())
        if (const auto* set = std::get_if<std::shared_ptr<const TriangleSet>>(&scene.set))
            if ((*set)->size() > 0) list.emplace_back(scene.name, *set);
    return list;
}

/// Calls visit(node, depth) for every node, parents first.
template <class Visit>
void visit_nodes(const BinaryTree& tree, const Visit& visit) {
    std::vector<std::pair<uint32_t, int>> open;
    if (!tree.empty()) open.emplace_back(0, 0);
    while (!open.empty()) {
        const auto [i, depth] = open.back();
        open.pop_back();
        const BinaryTree::Node& node = tree.nodes[i];
        visit(node, depth);
        if (node.leaf()) continue;
        open.emplace_back(node.left, depth + 1);
        open.emplace_back(node.right, depth + 1);
    }
}

int depth_of(const BinaryTree& tree) {
    int deepest = 0;
    visit_nodes(tree, [&](const BinaryTree::Node&, int d) { deepest = std::max(deepest, d); });
    return deepest;
}

std::vector<uint32_t> references_per_shape(const BinaryTree& tree, uint32_t shapes) {
    std::vector<uint32_t> count(shapes);
    visit_nodes(tree, [&](const BinaryTree::Node& node, int) {
        for (uint32_t i = 0; i < node.count; ++i) ++count[tree.order[node.first + i]];
    });
    return count;
}

/// Whether boxes hold their children's.
bool boxes_nest(const BinaryTree& tree) {
    bool nest = true;
    visit_nodes(tree, [&](const BinaryTree::Node& node, int) {
        if (!node.leaf())
            nest = nest && node.bounds.contains(tree.nodes[node.left].bounds) &&
                   node.bounds.contains(tree.nodes[node.right].bounds);
    });
    return nest;
}

/// Whether each of some points of every triangle is in the box of a leaf that names the triangle.
bool leaves_cover(const BinaryTree& tree, const TriangleSet& set) {
    std::vector<std::vector<Bounds3>> boxes(set.size());
    visit_nodes(tree, [&](const BinaryTree::Node& node, int) {
        for (uint32_t i = 0; i < node.count; ++i)
            boxes[tree.order[node.first + i]].push_back(node.bounds);
    });
    test::Random random(3);
    for (uint32_t t = 0; t < set.size(); ++t) {
        if (!set.active(t)) continue;
        for (int k = 0; k < 20; ++k) {
            const double u = k < 3 ? k == 1 : random.uniform();
            const double v = k < 3 ? k == 2 : random.uniform() * (1 - u);
            const Vec3d p = set.vertex(t, 0).cast<double>() * (1 - u - v) +
                            set.vertex(t, 1).cast<double>() * u +
                            set.vertex(t, 2).cast<double>() * v;
            bool found = false;
            // The point itself is rounded by some 2^-52 of the coordinates.
            const Vec3d slack = p.cwiseAbs() * 1e-15 + Vec3d::Constant(1e-300) +
                                set.bounds(t).extent().cast<double>() * 1e-15;
            for (const Bounds3& b : boxes[t])
                found |= ((b.lower.cast<double>() - slack).array() <= p.array()).all() &&
                         ((b.upper.cast<double>() + slack).array() >= p.array()).all();
            if (!found) return false;
        }
    }
    return true;
}

using References = BuildReferences;

void add_box(References& list, const Vec3f& center, float half) {
    list.push_back({{center - Vec3f::Constant(half), center + Vec3f::Constant(half)},
                    uint32_t(list.size()),
                    1.0f});
}

/// Inputs that make lists of trees, or trees of no end.
std::vector<std::pair<std::string, References>> hard_references() {
    std::vector<std::pair<std::string, References>> list(5);
    list[0].first = "powers of two";
    for (int e = -100; e <= 100; ++e)
        for (int k = 0; k < 3; ++k)
            add_box(list[0].second, Vec3f::Unit(k) * std::ldexp(1.0f, e), std::ldexp(0.1f, e));
    list[1].first = "1e5 times one box";
    for (int i = 0; i < 100000; ++i) add_box(list[1].second, {1, 2, 3}, 0.5f);
    list[2].first = "1e6 boxes with one centre";
    for (int i = 0; i < 1000000; ++i) add_box(list[2].second, {0, 0, 0}, float(i + 1));
    list[3].first = "a row with growing gaps";
    for (int i = 0; i < 30000; ++i)
        add_box(list[3].second, {float(i) + 1e-4f * float(i) * float(i), 0, 0}, 0.01f);
    list[4].first = "long boxes across each other";
    test::Random random(8);
    for (int i = 0; i < 3000; ++i) {
        add_box(list[4].second, random.point(1), 0.01f);
        list[4].second.back().bounds.lower[i % 3] = -1;
        list[4].second.back().bounds.upper[i % 3] = 1;
    }
    return list;
}

const ShapeClipper box_clipper{[](uint32_t, const Bounds3& box) { return box; }, nullptr};

}  // namespace

TEST_CASE("every builder names every shape, in leaves that hold all of it") {
    for (const auto& [name, set] : triangle_scenes())
        for (const TreeBuilder builder : all_builders)
            for (const int reinsertion : {0, 3}) {
                TreeParameters p = with(builder, reinsertion);
                p.split_overlap = 0;
                const BinaryTree tree = build_tree(*set, p, unit_costs());
                INFO("builder " << int(builder) << " reinsertion " << reinsertion << " over "
                                << name);
                const auto count = references_per_shape(tree, set->size());
                bool all_there = true, once = true;
                for (uint32_t i = 0; i < set->size(); ++i) {
                    all_there = all_there && (count[i] > 0) == set->active(i);
                    once = once && count[i] <= 1;
                }
                CHECK(all_there);
                CHECK((once || builder == TreeBuilder::sbvh));
                CHECK(boxes_nest(tree));
                CHECK(leaves_cover(tree, *set));
            }
}

TEST_CASE("leaves are no larger than asked and name shapes once, ascending") {
    for (const auto& [name, set] : triangle_scenes())
        for (const TreeBuilder builder : all_builders)
            for (const int size : {1, 5}) {
                TreeParameters p = with(builder);
                p.max_leaf_size = size;
                const BinaryTree tree =
                    build_tree(*set, p, tree_costs<TriangleSet>(cost_constants.node));
                bool good = true;
                visit_nodes(tree, [&](const BinaryTree::Node& node, int) {
                    good = good && node.count <= uint32_t(size);
                    for (uint32_t i = 1; i < node.count; ++i)
                        good = good && tree.order[node.first + i - 1] < tree.order[node.first + i];
                });
                INFO("builder " << int(builder) << " over " << name);
                CHECK(good);
            }
}

TEST_CASE("no builder makes a tree deeper than the stacks of traversal") {
    for (const auto& [name, references] : hard_references())
        for (const TreeBuilder builder : all_builders)
            for (const InsertionOrder order : {InsertionOrder::file, InsertionOrder::shuffled}) {
                if (builder != TreeBuilder::insertion && order != InsertionOrder::file) continue;
                TreeParameters p = with(builder, references.size() < 50000 ? 1 : 0);
                p.insertion_order = order;
                p.max_leaf_size = 1;
                const BinaryTree tree = build_tree(references, box_clipper, p, unit_costs());
                INFO("builder " << int(builder) << " over " << name);
                CHECK(depth_of(tree) <= BinaryTree::max_depth);
                const auto count = references_per_shape(tree, uint32_t(references.size()));
                CHECK(std::count(count.begin(), count.end(), 0u) == 0);
            }
}

TEST_CASE("limit_depth rebuilds what is too deep and keeps every leaf") {
    // A list: each node has one leaf and the rest.
    constexpr uint32_t n = 5000;
    BinaryTree tree;
    tree.nodes.assign(2 * n - 1, {});
    for (uint32_t i = 0; i < n; ++i) {
        BinaryTree::Node& leaf = tree.nodes[n - 1 + i];
        leaf.bounds = {{float(i), 0, 0}, {float(i) + 1, 1, 1}};
        leaf.first = i;
        leaf.count = 1;
        tree.order.push_back(i);
    }
    for (uint32_t i = n - 1; i-- > 0;) {
        BinaryTree::Node& node = tree.nodes[i];
        node.left = n - 1 + i;
        node.right = i + 2 < n ? i + 1 : 2 * n - 2;
        node.bounds = merge(tree.nodes[node.left].bounds, tree.nodes[node.right].bounds);
    }
    REQUIRE(depth_of(tree) == int(n) - 1);
    limit_depth(tree);
    CHECK(depth_of(tree) <= BinaryTree::max_depth);
    CHECK(boxes_nest(tree));
    CHECK(references_per_shape(tree, n) == std::vector<uint32_t>(n, 1));
}

TEST_CASE("reinsertion never makes a tree dearer, and mends a bad one") {
    for (const auto& [name, set] : triangle_scenes()) {
        for (const TreeBuilder builder : all_builders) {
            TreeParameters p = with(builder);
            p.max_leaf_size = 1;
            BinaryTree tree = build_tree(*set, p, unit_costs());
            const double before = inner_area(tree);
            reinsert(tree, 3);
            INFO("builder " << int(builder) << " over " << name);
            CHECK(inner_area(tree) <= before);
            CHECK(boxes_nest(tree));
        }
        if (name != "random triangles") continue;
        TreeParameters p = with(TreeBuilder::median);
        const double median = inner_area(build_tree(*set, p, unit_costs()));
        p.reinsertion = 8;
        CHECK(inner_area(build_tree(*set, p, unit_costs())) < 0.9 * median);
    }
}

/// Needles longer than the space that they start in.
std::shared_ptr<const TriangleSet> crossing_needles(int n) {
    std::vector<Vec3f> p;
    std::vector<TriangleSet::Indices> t;
    test::Random random(1);
    for (int i = 0; i < n; ++i) {
        const Vec3f base = random.point(1), tip = base + random.direction() * 3;
        const uint32_t k = uint32_t(p.size());
        p.insert(p.end(), {base, tip, tip + random.point(0.002f)});
        t.push_back({k, k + 1, k + 2});
    }
    return std::make_shared<const TriangleSet>(p, t);
}

TEST_CASE("sbvh costs no more than the sweep, and less where needles cross") {
    const auto cost = [](const TriangleSet& set, TreeBuilder builder) {
        TreeParameters p = with(builder);
        p.reference_budget = 4;
        return expected_cost(build_tree(set, p, unit_costs()), unit_costs(),
                             shape_costs(set, unit_costs()));
    };
    for (const auto& [name, set] : triangle_scenes()) {
        INFO(name);
        // Bins see a few planes of the many that the sweep tries.
        CHECK(cost(*set, TreeBuilder::sbvh) <= 1.1 * cost(*set, TreeBuilder::sweep_sah));
    }
    const auto needles = crossing_needles(5000);
    CHECK(cost(*needles, TreeBuilder::sbvh) < 0.9 * cost(*needles, TreeBuilder::sweep_sah));
}

TEST_CASE("sbvh keeps to its budget of references") {
    for (const auto& [name, set] : triangle_scenes())
        for (const double budget : {1.0, 1.25, 3.0}) {
            TreeParameters p = with(TreeBuilder::sbvh);
            p.reference_budget = budget;
            p.split_overlap = 0;
            p.max_leaf_size = 1;
            const auto count = references_per_shape(build_tree(*set, p, unit_costs()), set->size());
            uint64_t sum = 0;
            for (const uint32_t c : count) sum += c;
            INFO(name << " budget " << budget);
            CHECK(double(sum) <= budget * set->size());
        }
}

TEST_CASE("a tree is the same, bit for bit, for any number of threads") {
    test::Random random(12);
    References references;
    for (int i = 0; i < 60000; ++i)
        add_box(references, random.point(1), random.uniform(0.001f, 0.05f));
    for (const TreeBuilder builder : all_builders) {
        const auto build = [&](int threads) {
            set_threads(threads);
            const BinaryTree tree =
                build_tree(references, box_clipper, with(builder, 1), unit_costs());
            set_threads(0);
            return tree;
        };
        const BinaryTree one = build(1), four = build(4);
        INFO("builder " << int(builder));
        CHECK(one.order == four.order);
        REQUIRE(one.nodes.size() == four.nodes.size());
        CHECK(std::memcmp(one.nodes.data(), four.nodes.data(),
                          one.nodes.size() * sizeof(BinaryTree::Node)) == 0);
    }
}

namespace {

constexpr double wide_node_cost = 6;

/// Children of a wide node in the simple way: opening the largest box again and again.
std::vector<uint32_t> open_largest(const BinaryTree& tree, uint32_t n, size_t width) {
    std::vector<uint32_t> list{tree.nodes[n].left, tree.nodes[n].right};
    while (list.size() < width) {
        auto best = list.end();
        for (auto i = list.begin(); i != list.end(); ++i)
            if (!tree.nodes[*i].leaf() &&
                (best == list.end() ||
                 half_area(tree.nodes[*i].bounds) > half_area(tree.nodes[*best].bounds)))
                best = i;
        if (best == list.end()) break;
        const BinaryTree::Node& node = tree.nodes[*best];
        *best = node.left;
        list.push_back(node.right);
    }
    return list;
}

/// By the area heuristic, of the wide tree whose nodes have the children that `children_of` names.
template <class F>
double wide_cost(const BinaryTree& tree, const TreeCosts& costs, size_t width,
                 const F& children_of) {
    const double root = half_area(tree.nodes[0].bounds);
    double sum = 0;
    uint64_t shapes = 0;
    std::vector<uint32_t> open{0};
    while (!open.empty()) {
        const uint32_t n = open.back();
        open.pop_back();
        const double share = half_area(tree.nodes[n].bounds) / root;
        if (tree.nodes[n].leaf()) {
            sum += share * costs.leaf(0, tree.nodes[n].count);
            shapes += tree.nodes[n].count;
            continue;
        }
        sum += share * wide_node_cost;
        const std::vector<uint32_t> children = children_of(n);
        REQUIRE(children.size() >= 2);
        REQUIRE(children.size() <= width);
        open.insert(open.end(), children.begin(), children.end());
    }
    CHECK(shapes == tree.order.size());
    return sum;
}

/// @return the cost of the collapsed tree
template <int W>
double check_collapse(const BinaryTree& tree, const TreeCosts& costs) {
    INFO("width " << W);
    const WideCollapse<W> collapse(tree, costs, wide_node_cost, {});
    const double planned = wide_cost(tree, costs, W, [&](uint32_t n) {
        const auto children = collapse.children(n);
        return std::vector<uint32_t>(children.begin(), children.end());
    });
    CHECK(planned == Approx(collapse.expected_cost()).epsilon(1e-9));
    const double simple =
        wide_cost(tree, costs, W, [&](uint32_t n) { return open_largest(tree, n, W); });
    CHECK(planned <= simple * (1 + 1e-9));
    return planned;
}

}  // namespace

TEST_CASE("the cost of a wide tree is what its nodes add up to, and the least of any collapse") {
    for (const auto& [name, set] : triangle_scenes()) {
        const TreeCosts costs = tree_costs<TriangleSet>(cost_constants.wide_node);
        const BinaryTree tree = build_tree(*set, with(TreeBuilder::binned_sah), costs);
        if (tree.nodes[0].leaf() || !(half_area(tree.nodes[0].bounds) > 0)) continue;
        INFO(name);
        const double four = check_collapse<4>(tree, costs), eight = check_collapse<8>(tree, costs),
                     sixteen = check_collapse<16>(tree, costs);
        CHECK(eight <= four);
        CHECK(sixteen <= eight);
    }
}

}  // namespace crofton
