#include "scenegraph/scene_counts.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "framework/cost.h"

namespace crofton {
namespace {

struct ShapeSize {
    double operator()(const TriangleMesh& m) const { return double(m.triangles.size()); }
    double operator()(const Quadrics& q) const { return double(q.shapes.size()); }
    double operator()(const Polygons& p) const { return double(p.size()); }
    double operator()(const Points& p) const { return double(p.positions.size()); }
};

/// Points are traced as quadrics.
const char* kind_of_shapes(const Geometry& geometry) {
    static constexpr const char* names[] = {"triangles", "quadrics", "polygons", "quadrics"};
    return names[geometry.shapes.index()];
}

/// Meshes of similar size count as equal ones.
void add_mesh(SceneCounts& counts, double shapes) {
    constexpr double similar = 4;
    for (auto& [size, meshes] : counts.meshes)
        if (shapes < similar * size && size < similar * shapes) {
            size += (shapes - size) / (meshes + 1);
            meshes += 1;
            return;
        }
    counts.meshes.emplace_back(shapes, 1.0);
}

/// How often every mesh is placed. Paths are counted, not walked: O(nodes) however often shared.
std::vector<double> placements_of_meshes(const Scene& scene) {
    std::vector<double> paths(scene.nodes.size(), 0), meshes(scene.meshes.size(), 0);
    std::vector<uint32_t> parents(scene.nodes.size(), 0), open;
    std::vector<bool> reached(scene.nodes.size(), false);
    // Nodes in topological order from the roots: each after all of its parents.
    for (const uint32_t r : scene.roots) {
        paths[r] += 1;
        if (!reached[r]) open.push_back(r), reached[r] = true;
    }
    std::vector<uint32_t> found = open;
    while (!found.empty()) {
        const uint32_t n = found.back();
        found.pop_back();
        for (const uint32_t c : scene.nodes[n].children) {
            ++parents[c];
            if (!reached[c]) found.push_back(c), reached[c] = true;
        }
    }
    std::erase_if(open, [&](uint32_t r) { return parents[r] > 0; });
    while (!open.empty()) {
        const uint32_t n = open.back();
        open.pop_back();
        const Node& node = scene.nodes[n];
        if (node.mesh)
            meshes[*node.mesh] +=
                paths[n] * double(std::max<size_t>(1, node.node_from_instance.size()));
        for (const uint32_t c : node.children) {
            paths[c] += paths[n];
            if (--parents[c] == 0) open.push_back(c);
        }
    }
    return meshes;
}

/// Box and area of every kind of shape; the area in any unit.
struct ShapeView {
    const Geometry& geometry;
    size_t size() const { return size_t(std::visit(ShapeSize{}, geometry.shapes)); }
    Bounds3 bounds(size_t i) const {
        Bounds3 box;
        const auto ball = [&](const Vec3f& center, float radius) {
            box.extend(Vec3f(center - Vec3f::Constant(radius)));
            box.extend(Vec3f(center + Vec3f::Constant(radius)));
        };
        if (const auto* m = std::get_if<TriangleMesh>(&geometry.shapes)) {
            for (const uint32_t corner : m->triangles[i]) box.extend(m->positions[corner]);
        } else if (const auto* p = std::get_if<Polygons>(&geometry.shapes)) {
            for (uint32_t k = p->first[i]; k < p->first[i + 1]; ++k) box.extend(p->positions[k]);
        } else if (const auto* p = std::get_if<Points>(&geometry.shapes)) {
            box.extend(p->positions[i]);
        } else {
            const Quadric& q = std::get<Quadrics>(geometry.shapes).shapes[i];
            if (const Sphere* s = std::get_if<Sphere>(&q))
                ball(s->center, s->radius);
            else if (const Cone* c = std::get_if<Cone>(&q))
                ball(c->base, c->base_radius), ball(c->apex, c->apex_radius);
            else
                ball(std::get<Disc>(q).center, std::get<Disc>(q).radius);
        }
        return box;
    }
    /// Area and nominal cost of a test over that of calibrations: quads, spheres and cones.
    std::pair<double, double> area_and_cost(size_t i) const {
        const CostConstants& c = cost_constants;
        if (const auto* p = std::get_if<Polygons>(&geometry.shapes)) {
            const uint32_t first = p->first[i], end = p->first[i + 1];
            Bounds3 box;
            for (uint32_t k = first; k < end; ++k) box.extend(p->positions[k]);
            const double quad = c.polygon + 4 * c.polygon_corner;
            return {half_area(box), (c.polygon + (end - first) * c.polygon_corner) / quad};
        }
        if (const auto* q = std::get_if<Quadrics>(&geometry.shapes)) {
            const double mean = 0.5 * (c.sphere + c.cone);
            if (const Sphere* s = std::get_if<Sphere>(&q->shapes[i]))
                return {4.0 * s->radius * s->radius, c.sphere / mean};
            if (const Cone* k = std::get_if<Cone>(&q->shapes[i]))
                return {(double(k->base_radius) + k->apex_radius) * (k->base - k->apex).norm(),
                        c.cone / mean};
            return {1.0, c.disc / mean};
        }
        return {1.0, 1.0};
    }
};

/// Sizes of a sample: at most so many leaves and runs, shapes of a run, and shapes of the whole.
struct SampleSizes {
    size_t leaves, runs, of_run, of_whole;
};
constexpr SampleSizes glance{16, 4, 4, 32}, look{256, 16, 8, 256};

/// Box of so many shapes spread evenly over a run.
Bounds3 run_bounds(const ShapeView& shapes, size_t first, size_t count, size_t spread) {
    Bounds3 box;
    for (size_t k = 0; k < spread; ++k) {
        const Bounds3 one = shapes.bounds(first + (2 * k + 1) * count / (2 * spread));
        if (one.lower.allFinite() && one.upper.allFinite()) box.extend(one);
    }
    return box;
}

/// Expected number of boxes around runs of so many shapes that a line through all of them meets,
/// from `samples` runs spread evenly.
/// @param of_run  shapes at most that are looked at of a run
/// @param whole   half area of the box of all shapes
double visits_of_runs(const ShapeView& shapes, size_t count, size_t samples, size_t of_run,
                      double whole) {
    // A sample stands for so many runs. One that is large is rather a rare one than typical of all
    // these, and counts as no more than a few visits; of few samples as more, so that a bad order
    // shows.
    const double most_visits = 32 / std::sqrt(double(samples));
    const double stands_for = double(shapes.size()) / double(count * samples);
    double visits = 0;
    for (size_t r = 0; r < samples; ++r) {
        // In the middle of its part: files begin and end with what is not like the rest.
        const size_t place = (2 * r + 1) * shapes.size() / (2 * samples);
        const size_t first = std::min(place, shapes.size() - count);
        const double area = half_area(run_bounds(shapes, first, count, std::min(count, of_run)));
        visits += std::min(stands_for * area / whole, most_visits);
    }
    return visits;
}

}  // namespace

const std::string& SceneCounts::main_kind() const {
    static const std::string none = "triangles";
    return kinds.empty() ? none : kinds.front().name;
}

double SceneCounts::unique() const {
    double sum = 0;
    for (const Kind& kind : kinds) sum += kind.unique;
    return sum;
}

double SceneCounts::placed() const {
    double sum = 0;
    for (const Kind& kind : kinds) sum += kind.placed;
    return sum;
}

SceneCounts count_shapes(const Scene& scene) {
    SceneCounts counts;
    for (const char* name : {"triangles", "quadrics", "polygons"}) counts.kinds.push_back({name});
    const std::vector<double> placements = placements_of_meshes(scene);
    double most = 0;
    for (size_t m = 0; m < scene.meshes.size(); ++m) {
        if (placements[m] == 0) continue;
        double shapes = 0;
        for (const uint32_t g : scene.meshes[m].geometries) {
            const Geometry& geometry = scene.geometries[g];
            const double n = std::visit(ShapeSize{}, geometry.shapes);
            for (SceneCounts::Kind& kind : counts.kinds)
                if (kind.name == kind_of_shapes(geometry))
                    kind.unique += n, kind.placed += n * placements[m];
            shapes += n;
            if (n * placements[m] > most) most = n * placements[m], counts.largest = g;
        }
        add_mesh(counts, shapes);
        counts.placements += placements[m];
    }
    std::erase_if(counts.kinds, [](const SceneCounts::Kind& k) { return k.unique == 0; });
    std::stable_sort(counts.kinds.begin(), counts.kinds.end(),
                     [](const auto& a, const auto& b) { return a.placed > b.placed; });
    if (counts.largest)
        counts.order = order_cost(scene.geometries[*counts.largest], OrderSample::glance);
    return counts;
}

OrderCost order_cost(const Geometry& geometry, OrderSample sample) {
    constexpr size_t leaf = 4, width = 8, least = 64;
    const SampleSizes& most = sample == OrderSample::glance ? glance : look;
    const ShapeView shapes{geometry};
    const size_t n = shapes.size();
    if (n < least) return {};
    // Of leaves many, since a few large ones among small ones weigh most.
    const size_t leaves = std::clamp<size_t>(n / 64, 8, most.leaves),
                 runs = std::clamp<size_t>(n / 512, 4, most.runs);
    const double whole = half_area(run_bounds(shapes, 0, n, std::min(n, most.of_whole)));
    if (!(whole > 0)) return {};
    const double leaf_visits = visits_of_runs(shapes, leaf, leaves, leaf, whole);
    OrderCost cost{1 + leaf_visits, leaf * leaf_visits, true};
    for (size_t count = leaf * width; count < n; count *= width)
        cost.nodes += std::max(1.0, visits_of_runs(shapes, count, runs, most.of_run, whole));
    return std::isfinite(cost.nodes) ? cost : OrderCost{};
}

double test_weight(const Scene& scene, const std::string& kind) {
    constexpr size_t most = 512;
    if (kind == "triangles") return 1;  // all alike
    double sum = 0, areas = 0;
    for (const Geometry& g : scene.geometries) {
        const ShapeView shapes{g};
        if (kind != kind_of_shapes(g)) continue;
        const size_t n = shapes.size(), step = std::max<size_t>(1, n / most);
        for (size_t i = 0; i < n; i += step) {
            const auto [area, cost] = shapes.area_and_cost(i);
            if (!std::isfinite(area)) continue;
            sum += double(step) * area * cost, areas += double(step) * area;
        }
    }
    return areas > 0 ? sum / areas : 1;
}

}  // namespace crofton
