// What the bsp promises beyond brute force's bits, which conformance_test checks.

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "accelerators/bsp_build.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"

namespace crofton {
namespace {

// Sums of at most a few hundred terms in double.
constexpr double rounding = 1e-12;

bool near(double a, double b, double relative = rounding) {
    return std::abs(a - b) <= relative * std::max(std::abs(a), std::abs(b));
}

Bounds3 cube(float low, float high) { return {Vec3f::Constant(low), Vec3f::Constant(high)}; }

Polyhedron cut_by(Polyhedron p, const std::vector<Vec3d>& normals, double d) {
    for (const Vec3d& n : normals) p = clipped(p, n, d, 1e-14);
    return p;
}

struct Soup {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
};

Soup random_soup(int n, float size) {
    test::Random random(5);
    Soup soup;
    for (int i = 0; i < n; ++i) {
        const Vec3f c = random.point(1);
        for (uint32_t k = 0; k < 3; ++k) soup.p.push_back(c + random.point(size));
        soup.t.push_back({uint32_t(3 * i), uint32_t(3 * i + 1), uint32_t(3 * i + 2)});
    }
    return soup;
}

/// Parallel bars, as long as their square array is wide, turned by 45 degrees about two axes.
Soup turned_bars(int along) {
    const Eigen::Matrix3f turn = (Eigen::AngleAxisf(0.25f * float(M_PI), Vec3f::UnitY()) *
                                  Eigen::AngleAxisf(0.25f * float(M_PI), Vec3f::UnitX()))
                                     .toRotationMatrix();
    constexpr uint32_t faces[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6},
                                       {0, 1, 4}, {1, 5, 4}, {2, 6, 3}, {3, 6, 7},
                                       {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    Soup soup;
    for (int i = 0; i < along * along; ++i) {
        const Vec3f corner(0, float(i % along), float(i / along));
        const uint32_t base = uint32_t(soup.p.size());
        for (int k = 0; k < 8; ++k)
            soup.p.push_back(turn *
                             (corner + Vec3f(float((k & 1) * along), 0.3f * float(k >> 1 & 1),
                                             0.3f * float(k >> 2 & 1))));
        for (const auto& f : faces) soup.t.push_back({base + f[0], base + f[1], base + f[2]});
    }
    return soup;
}

BspShapes shapes_of(const Soup& soup) {
    const TriangleSet set(soup.p, soup.t);
    BspShapes shapes;
    shapes.references = build_references(set);
    for (const BuildReference& r : shapes.references) {
        shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
        for (int k = 0; k < 3; ++k) shapes.corners.push_back(set.vertex(r.shape, k).cast<double>());
    }
    shapes.first_corner.push_back(uint32_t(shapes.corners.size()));
    return shapes;
}

std::span<const uint32_t> references(const BspTreeData& tree, const BspNode& leaf) {
    return {leaf.count() == 1 ? &leaf.value : tree.references.data() + leaf.value, leaf.count()};
}

/// Whether a leaf that holds `shape` can be reached with `x` taken to both sides of a plane that it
/// is within the tolerance of.
bool stands_at(const BspTreeData& tree, const Vec3d& x, uint32_t shape) {
    const double tolerance = 1.01 * bsp_tolerance * double(tree.box.magnitude());
    std::vector<uint32_t> open{0};
    while (!open.empty()) {
        const uint32_t index = open.back();
        open.pop_back();
        const BspNode& n = tree.nodes[index];
        if (n.is_leaf()) {
            const auto list = references(tree, n);
            if (std::find(list.begin(), list.end(), shape) != list.end()) return true;
            continue;
        }
        const BspEquation e = equation(n, tree.planes);
        const double height = e.n.dot(x) - e.d, slack = tolerance * e.n.lpNorm<1>();
        if (height <= slack) open.push_back(index + 1);
        if (height >= -slack) open.push_back(n.above());
    }
    return false;
}

BspOptions options_of(BspPlanes planes) {
    BspOptions options;
    options.planes = planes;
    options.costs.node = 1.5;
    return options;
}

constexpr BspPlanes every_choice[] = {BspPlanes::axis_aligned, BspPlanes::kdop, BspPlanes::polygons,
                                      BspPlanes::all};

Counters counted(const std::string& name, const ParameterValues& values, const Soup& soup) {
    const auto set = std::make_shared<const TriangleSet>(soup.p, soup.t);
    const auto tree = accelerator(name).build(set, values);
    test::Random random(77);
    const Vec3f center = tree->bounds().center();
    const float size = tree->bounds().extent().norm();
    Counters counters;
    for (int i = 0; i < 4000; ++i) {
        Ray ray;
        ray.origin = center + random.direction() * size;
        ray.direction = center + random.point(0.3f) * size - ray.origin;
        tree->intersect(ray, counters);
    }
    return counters;
}

}  // namespace

TEST_CASE("polyhedra have the areas of known solids") {
    const Polyhedron unit = Polyhedron::box(cube(0, 1));
    CHECK(near(unit.area(), 6));
    // A corner cut off at s along each axis: three right triangles and an equilateral one.
    const double s = 0.75;
    CHECK(near(clipped(unit, {1, 1, 1}, s, 0).area(), s * s * (1.5 + 0.5 * std::sqrt(3.0))));
    // Half the cube and a regular hexagon.
    CHECK(near(clipped(unit, {1, 1, 1}, 1.5, 0).area(), 3 + 0.75 * std::sqrt(3.0)));

    std::vector<Vec3d> octahedron, dodecahedron;
    const double golden = 0.5 * (1 + std::sqrt(5.0));
    for (const double a : {-1.0, 1.0})
        for (const double b : {-1.0, 1.0}) {
            for (const double c : {-1.0, 1.0}) octahedron.emplace_back(a, b, c);
            dodecahedron.push_back(Vec3d(0, a, b * golden).normalized());
            dodecahedron.push_back(Vec3d(a, b * golden, 0).normalized());
            dodecahedron.push_back(Vec3d(b * golden, 0, a).normalized());
        }
    const Polyhedron big = Polyhedron::box(cube(-2, 2));
    CHECK(near(cut_by(big, octahedron, 1).area(), 4 * std::sqrt(3.0)));
    const Polyhedron twelve = cut_by(big, dodecahedron, 1);
    const double edge = 2 / std::sqrt((25 + 11 * std::sqrt(5.0)) / 10);
    CHECK(twelve.points.size() == 20);
    CHECK(near(twelve.area(), 3 * std::sqrt(25 + 10 * std::sqrt(5.0)) * edge * edge));
    CHECK(clipped(unit, {1, 0, 0}, -1, 0).empty());
    CHECK(clipped(unit, {1, 0, 0}, 2, 0).points.size() == 8);
}

TEST_CASE("areas on either side of a plane are those of the polyhedron cut by it") {
    test::Random random(3);
    for (int trial = 0; trial < 300; ++trial) {
        Polyhedron p = Polyhedron::box(cube(-1, 1));
        for (int i = 0; i < trial % 12; ++i) {
            const Polyhedron cut =
                clipped(p, random.direction().cast<double>(), random.uniform(0.2f, 1), 1e-13);
            if (!cut.empty()) p = cut;
        }
        const CellAreas areas(p);
        const Vec3d n = random.direction().cast<double>() * 3;
        AreaProfile profile;
        profile.look_along(areas, n);
        for (int i = 1; i < 8; ++i) {
            const double d = profile.lowest() + (profile.highest() - profile.lowest()) * i / 8;
            const AreaProfile::Parts parts = profile.at(d);
            CHECK(near(parts.below, clipped(p, n, d, 0).area(), 1e-11));
            CHECK(near(parts.above, clipped(p, -n, -d, 0).area(), 1e-11));
        }
    }
}

TEST_CASE("every shape stands in a leaf at each of its points") {
    for (const Soup& soup : {random_soup(700, 0.2f), random_soup(60, 2.0f), turned_bars(5)}) {
        const BspShapes shapes = shapes_of(soup);
        for (const BspPlanes planes : every_choice) {
            const BspTreeData tree = build_bsp(shapes, options_of(planes));
            test::Random random(8);
            size_t absent = 0;
            for (size_t i = 0; i < shapes.references.size(); ++i)
                for (int k = 0; k < 40; ++k) {
                    const auto c = shapes.outline(i);
                    double u = random.uniform(), v = random.uniform();
                    if (u + v > 1) u = 1 - u, v = 1 - v;
                    const Vec3d x =
                        k < 3 ? c[size_t(k)] : Vec3d(c[0] + u * (c[1] - c[0]) + v * (c[2] - c[0]));
                    absent += !stands_at(tree, x, shapes.references[i].shape);
                }
            INFO(int(planes));
            CHECK(absent == 0);
        }
    }
}

TEST_CASE("a triangle stands only in leaves that it meets") {
    const BspShapes shapes = shapes_of(random_soup(500, 0.3f));
    for (const BspPlanes planes : every_choice) {
        const BspTreeData tree = build_bsp(shapes, options_of(planes));
        const double slack = 1e-6;  // of a box of size 2: a few times the tolerance
        size_t apart = 0, found = 0;
        walk_cells(
            tree.nodes, tree.planes, tree.box, [&](uint32_t index, const BspCell& cell, uint32_t) {
                const BspNode& leaf = tree.nodes[index];
                if (!leaf.is_leaf()) return;
                Polyhedron room;
                const Polyhedron& solid = cell.polyhedron(room);
                for (const uint32_t shape : references(tree, leaf)) {
                    std::vector<Vec3d> polygon(shapes.outline(shape).begin(),
                                               shapes.outline(shape).end());
                    for (const Polyhedron::Face& face : solid.faces) {
                        const double d =
                            face.normal.dot(solid.points[solid.corners[face.first]]) + slack;
                        std::vector<Vec3d> rest;
                        for (size_t i = 0; i < polygon.size(); ++i) {
                            const Vec3d &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
                            const double ha = face.normal.dot(a) - d, hb = face.normal.dot(b) - d;
                            if (ha <= 0) rest.push_back(a);
                            if ((ha < 0) != (hb < 0))
                                rest.push_back(a + (b - a) * (ha / (ha - hb)));
                        }
                        polygon = rest;
                    }
                    ++found;
                    apart += polygon.empty();
                }
            });
        INFO(int(planes));
        CHECK(found > 500);
        CHECK(apart == 0);
    }
}

TEST_CASE("round shapes stand in a leaf at each point of their surface") {
    test::Random random(12);
    BspShapes shapes;
    std::vector<std::vector<Vec3d>> surface;
    for (uint32_t i = 0; i < 150; ++i) {
        const Vec3d a = random.point(1).cast<double>();
        const Vec3d axis = random.direction().cast<double>();
        const Vec3d b = i % 3 == 1 ? Vec3d(a + 0.5 * axis) : a;
        const double r = random.uniform(0.02f, 0.1f);
        shapes.rounds.push_back({{a, b}, {r, r}, i % 3 ? axis : Vec3d::Zero()});
        surface.emplace_back();
        Bounds3 bounds;
        for (int k = 0; k < 60; ++k) {
            // Sphere, cylinder, disc.
            Vec3d x = random.direction().cast<double>();
            if (i % 3) x = (x - axis * axis.dot(x)).normalized();
            x = a + (b - a) * random.uniform() + r * x;
            surface.back().push_back(x);
            bounds.extend(x.cast<float>());
        }
        shapes.references.push_back({widened(bounds, 1e-6f), i, 6});
    }
    for (const BspPlanes planes : every_choice) {
        const BspTreeData tree = build_bsp(shapes, options_of(planes));
        size_t absent = 0;
        for (uint32_t i = 0; i < surface.size(); ++i)
            for (const Vec3d& x : surface[i]) absent += !stands_at(tree, x, i);
        INFO(int(planes));
        CHECK(absent == 0);
    }
}

TEST_CASE("the cost of a bsp is the sum over its cells by their true areas") {
    const BspShapes shapes = shapes_of(random_soup(400, 0.3f));
    for (const BspPlanes planes : every_choice) {
        const BspOptions options = options_of(planes);
        const BspTreeData tree = build_bsp(shapes, options);
        double cost = 0;
        size_t diagonal = 0, general = 0;
        const double root = Polyhedron::box(tree.box).area();
        walk_cells(tree.nodes, tree.planes, tree.box,
                   [&](uint32_t index, const BspCell& cell, uint32_t depth) {
                       const BspNode& n = tree.nodes[index];
                       Polyhedron room;
                       double work = options.costs.node;
                       if (n.is_leaf()) {
                           double sum = 0;
                           for (const uint32_t shape : references(tree, n))
                               sum += shapes.references[shape].cost;
                           work = options.costs.leaf(sum, n.count());
                       } else if (n.kind() == BspNode::general) {
                           work = options.general_node;
                           ++general;
                       } else {
                           diagonal += n.kind() >= 3;
                       }
                       cost += cell.polyhedron(room).area() / root * work;
                       CHECK(depth <= uint32_t(BspTreeData::max_depth));
                   });
        INFO(int(planes));
        // Corners closer than a merging distance are one, in the cells but not in the areas.
        CHECK(near(tree.cost, cost, 1e-6));
        if (planes == BspPlanes::axis_aligned || planes == BspPlanes::polygons)
            CHECK(diagonal == 0);
        else
            CHECK(diagonal > 0);
        if (planes == BspPlanes::axis_aligned || planes == BspPlanes::kdop) CHECK(general == 0);
        if (planes == BspPlanes::polygons) CHECK(general > 0);
        CHECK(tree.planes.size() == general);
        for (const BspPlane& p : tree.planes) {
            const double sum =
                std::abs(double(p.n[0])) + std::abs(double(p.n[1])) + std::abs(double(p.n[2]));
            CHECK(sum <= 1);
            CHECK(sum > 0.999);
        }
    }
}

TEST_CASE("a tree of axis-aligned planes works no more than a kdtree's, within 10 %") {
    // Large cells choose among bins here, and among all planes there.
    for (const Soup& soup : {random_soup(3000, 0.05f), turned_bars(8)}) {
        const Counters bsp = counted("bsp", {{"planes", std::string("axis_aligned")}}, soup);
        const Counters kdtree = counted("kdtree", {}, soup);
        CHECK(double(bsp.N_IT) < 1.1 * double(kdtree.N_IT));
        CHECK(double(bsp.N_IT + bsp.N_TS) < 1.1 * double(kdtree.N_IT + kdtree.N_TS));
    }
}

TEST_CASE("over bars at 45 degrees a bsp tests less than half of what a kdtree does") {
    const Soup soup = turned_bars(8);
    const Counters bsp = counted("bsp", {}, soup), kdtree = counted("kdtree", {}, soup);
    CHECK(bsp.N_IT < kdtree.N_IT / 2);
    CHECK(bsp.N_TS < kdtree.N_TS);
}

}  // namespace crofton
