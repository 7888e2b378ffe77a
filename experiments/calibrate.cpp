#include "experiments/calibrate.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>

#include "accelerators/auto_select.h"
#include "experiments/calibration_scenes.h"
#include "experiments/fit.h"
#include "experiments/measure.h"
#include "experiments/random.h"
#include "experiments/results.h"
#include "experiments/statistics.h"
#include "experiments/workload.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/transform.h"
#include "framework/triangle_set.h"
#include "scenegraph/assemble.h"
#include "scenegraph/auto_plan.h"
#include "scenegraph/shape_sets.h"
#include "scenegraph/thinned.h"

namespace crofton {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

MeasuredCost cost_of(std::vector<double> ns) {
    const MedianInterval m = median_interval(std::move(ns));
    return {m.median, m.low, m.high};
}

// --- memory levels ---

/// Nanoseconds of one load that depends on the last, in a random cycle over so many bytes.
MeasuredCost dependent_load(size_t bytes) {
    constexpr size_t line = 64;
    struct alignas(line) Entry {
        uint32_t next;
    };
    const size_t n = bytes / line;
    std::vector<uint32_t> order(n);
    std::iota(order.begin(), order.end(), 0u);
    Pcg32 rng(1);
    for (size_t i = n; i > 1; --i) std::swap(order[i - 1], order[rng.below(i)]);
    std::vector<Entry> entries(n);
    for (size_t i = 0; i < n; ++i) entries[order[i]].next = order[(i + 1) % n];
    std::vector<double> ns;
    uint32_t at = order[0];
    constexpr int passes = 11;
    const size_t steps = std::clamp<size_t>(n, 1 << 14, 1 << 18);
    for (int pass = 0; pass <= passes; ++pass) {
        const auto start = Clock::now();
        for (size_t i = 0; i < steps; ++i) at = entries[at].next;
        if (pass > 0) ns.push_back(seconds_since(start) * 1e9 / double(steps));
    }
    volatile uint32_t sink = at;  // the walk has a result
    (void)sink;
    return cost_of(std::move(ns));
}

double cache_size(int name, double fallback) {
    const long bytes = sysconf(name);
    return bytes > 0 ? double(bytes) : fallback;
}

void measure_memory(Calibration& c) {
    const double l1 = cache_size(_SC_LEVEL1_DCACHE_SIZE, 32 << 10);
    const double l2 = cache_size(_SC_LEVEL2_CACHE_SIZE, 1 << 20);
    const double l3 = cache_size(_SC_LEVEL3_CACHE_SIZE, 16 << 20);
    const auto add = [&](const char* name, double bytes) {
        c.memory.push_back({name, bytes, dependent_load(size_t(bytes))});
    };
    add("L1", l1 / 2);
    add("L2", l2 / 2);
    add("L3", std::min(l3 / 2, 16e6));
    add("memory", std::min(4 * l3, 256e6));
}

// --- constants ---

/// A primitive that every ray meets, and that does nothing.
class EmptyObject final : public Primitive {
  public:
    EmptyObject() { set_bounds({Vec3f(-1, -1, -1), Vec3f(1, 1, 1)}); }
    void closest_local(const LocalRay&, RayQuery&) const override {}
    bool any_local(const LocalRay&, RayQuery&) const override { return false; }
    void closest_local(const LocalRay&, RayQuery&, Counters&) const override {}
    bool any_local(const LocalRay&, RayQuery&, Counters&) const override { return false; }
    double expected_cost() const override { return 0; }
    StructureStatistics statistics() const override { return {}; }
    std::string type_name() const override { return "empty"; }
    void walk(const BoxVisitor&) const override {}
    void children(const std::function<void(const Primitive&)>&) const override {}
    void archive(StructureWriter&) const override {}
};

std::vector<Ray> lines_through(double radius, int64_t count) {
    return random_lines({Vec3d::Zero(), radius}, count, 1);
}

/// Several passes of one primitive, ns per ray.
std::vector<double> passes_ns(const Primitive& p, std::span<const Ray> rays, int passes,
                              bool any = false) {
    std::vector<double> ns;
    timed_pass(p, rays, {any, 1});
    for (int i = 0; i < passes; ++i)
        ns.push_back(timed_pass(p, rays, {any, 1}) * 1e9 / double(rays.size()));
    return ns;
}

/// The extra nanoseconds of `more` over `less`, for each of `units`.
MeasuredCost difference(const Primitive& more, const Primitive& less, std::span<const Ray> rays,
                        double units) {
    const std::vector<double> a = passes_ns(more, rays, 15), b = passes_ns(less, rays, 15);
    std::vector<double> each;
    for (size_t i = 0; i < a.size(); ++i) each.push_back((a[i] - b[i]) / units);
    return cost_of(std::move(each));
}

std::unique_ptr<Primitive> brute_force(const PrimitiveSet& set) {
    return accelerator("brute_force").build(set, {});
}

std::unique_ptr<Primitive> brute_force_of(const Scene& scene) {
    ShapeSetBuilder builder(scene);
    for (uint32_t m = 0; m < scene.meshes.size(); ++m) builder.add_mesh(m, nullptr, 0);
    return brute_force(builder.take().front());
}

/// Shapes with one of a kind at each of `count` places, so that a leaf tests them all.
Scene kinds_scene(const std::string& kind, uint32_t count) {
    Scene scene;
    Pcg32 rng(7);
    TriangleMesh mesh;
    Quadrics quadrics;
    Polygons polygons;
    polygons.first.push_back(0);
    for (uint32_t i = 0; i < count; ++i) {
        const Vec3f c = uniform_direction(rng).cast<float>() * 0.7f;
        const Vec3f a = uniform_direction(rng).cast<float>() * 0.3f;
        const Vec3f b = uniform_direction(rng).cast<float>() * 0.3f;
        const uint32_t first = uint32_t(mesh.positions.size());
        for (const Vec3f& p : {c, Vec3f(c + a), Vec3f(c + b)}) mesh.positions.push_back(p);
        mesh.triangles.push_back({first, first + 1, first + 2});
        for (const Vec3f& p : {c, Vec3f(c + a), Vec3f(c + a + b), Vec3f(c + b)})
            polygons.positions.push_back(p);
        polygons.first.push_back(uint32_t(polygons.positions.size()));
        if (kind == "sphere") quadrics.shapes.push_back(Sphere{c, 0.2f});
        if (kind == "cone") quadrics.shapes.push_back(Cone{c, 0.2f, c + a, 0.1f});
        if (kind == "disc") quadrics.shapes.push_back(Disc{c, 0.2f, a});
    }
    Geometry geometry;
    if (kind == "triangle")
        geometry.shapes = std::move(mesh);
    else if (kind == "polygon")
        geometry.shapes = std::move(polygons);
    else
        geometry.shapes = std::move(quadrics);
    scene.add_object(kind, std::move(geometry));
    return scene;
}

void measure_tests(Calibration& c, std::span<const Ray> rays) {
    const std::vector<std::pair<std::string, std::string>> kinds = {
        {"triangle", "triangle_test"}, {"sphere", "sphere_test"}, {"cone", "cone_test"},
        {"disc", "disc_test"},         {"polygon", "quad_test"},
    };
    for (const auto& [kind, name] : kinds) {
        const auto more = brute_force_of(kinds_scene(kind, 96));
        const auto less = brute_force_of(kinds_scene(kind, 32));
        c.constants[name] = difference(*more, *less, rays, 64);
    }
    const MeasuredCost t = c.constants["triangle_test"];
    const double w = TriangleLeaves::width;
    c.constants["triangle_block_test"] = {t.ns * w, t.low * w, t.high * w};
}

void measure_objects(Calibration& c, std::span<const Ray> rays) {
    const auto empty = std::make_shared<const EmptyObject>();
    const auto set_of = [&](size_t n) {
        return std::make_shared<const ObjectSet>(std::vector<ObjectSet::Object>(n, {empty, 0}));
    };
    c.constants["ray_setup"] = cost_of(passes_ns(*empty, rays, 15));
    c.constants["object_box_and_call"] =
        difference(*brute_force(set_of(96)), *brute_force(set_of(32)), rays, 64);
    const Transform turned = translation({0.1, 0, 0}) * rotation({0, 0, 1}, 1);
    c.constants["instance_transform"] = difference(Instance(empty, turned), *empty, rays, 1);
}

/// A virtual call that cannot be foreseen at compile time, without anything inside it.
void measure_call(Calibration& c) {
    const std::vector<std::unique_ptr<Primitive>> objects = [] {
        std::vector<std::unique_ptr<Primitive>> made;
        for (int i = 0; i < 64; ++i) made.push_back(std::make_unique<EmptyObject>());
        return made;
    }();
    RayQuery query;
    LocalRay local;
    float scale;
    prepare(Ray{{0, 0, -2}, 0, {0, 0, 1}, 10}, 1, query, local, scale);
    std::vector<double> ns;
    for (int pass = 0; pass < 15; ++pass) {
        constexpr int rounds = 256;
        const auto start = Clock::now();
        for (int r = 0; r < rounds; ++r)
            for (const auto& o : objects) o->closest_local(local, query);
        ns.push_back(seconds_since(start) * 1e9 / double(rounds * objects.size()));
    }
    c.constants["virtual_call"] = cost_of(std::move(ns));
}

void measure_constants(Calibration& c) {
    const std::vector<Ray> rays = lines_through(1, 2048);
    measure_tests(c, rays);
    measure_objects(c, rays);
    measure_call(c);
}

// --- structures ---

AssemblyPlan flat_plan(const std::string& type, const ParameterValues& parameters) {
    auto choice = std::make_shared<AcceleratorChoice>();
    choice->label = choice->type = type;
    choice->parameters = parameters;
    AssemblyPlan plan;
    plan.top = plan.objects = choice;
    plan.flatten = true;
    return plan;
}

/// One structure over one sample.
struct Observation {
    const CalibrationScene* sample;
    double build_ns, bytes, ray_ns;  ///< bytes and build per shape
    double structure_bytes;
    std::vector<RayCost> rays;  ///< counters and time of each set of rays
    /// Powers that costs grow with from the scene thinned to the whole one; none for small scenes.
    std::optional<double> thin_ray, thin_build;
};

/// Builds until the median is steady enough.
double build_seconds(const Scene& scene, const AssemblyPlan& plan, Assembly& last) {
    std::vector<double> seconds;
    double sum = 0;
    while (seconds.size() < 3 || (sum < 2e-3 && seconds.size() < 15)) {
        last = Assembly{};
        last = assemble(scene, plan);
        seconds.push_back(last.build_s);
        sum += last.build_s;
        if (sum > 0.25) break;
    }
    return median_interval(std::move(seconds)).median;
}

RayCost ray_cost(const Primitive& root, std::span<const Ray> rays) {
    const double pilot = pilot_ns(root, rays.first(std::min<size_t>(rays.size(), 64)), {false, 1});
    // Some milliseconds at most, however slow the structure.
    const auto most = size_t(8e6 / std::max(pilot, 1.0));
    const std::vector<Ray> some = some_of(rays, std::max<size_t>(64, most));
    const Counters counters = counted_pass(root, some, false);
    const double n = double(some.size());
    return {observed_ns(root, {some, false, Mode::robust}), double(counters.N_TS) / n,
            double(counters.N_IT) / n};
}

/// Lazy structures are built by rays that meet every part.
void wake(const Primitive& root, const CalibrationScene& sample) {
    for (const std::vector<Ray>* rays : {&sample.lines, &sample.view, &sample.inside})
        trace_hits(root, *rays, {false, 1});
}

std::vector<RayCost> ray_costs(const Primitive& root, const CalibrationScene& sample) {
    std::vector<RayCost> costs;
    for (const std::vector<Ray>* rays : {&sample.lines, &sample.view, &sample.inside})
        if (!rays->empty()) costs.push_back(ray_cost(root, *rays));
    return costs;
}

/// What pilots do, to scenes whose costs are known.
constexpr double least_to_thin = 4096, thin_factor = 4;

/// @param seconds  of the whole scene's build
void observe_thinned(const AssemblyPlan& plan, Observation& o, double seconds) {
    const Scene thin = thinned(o.sample->scene, thin_factor);
    Assembly assembly;
    const double thin_seconds = build_seconds(thin, plan, assembly);
    const double shapes = double(statistics(thin).shapes_instanced);
    const double powers = std::log(double(o.sample->count) / shapes);
    o.thin_ray =
        std::log(o.ray_ns / geometric_mean_ns(ray_costs(*assembly.root, *o.sample))) / powers;
    o.thin_build = std::log(seconds / thin_seconds) / powers;
}

Observation observe(const StructureChoice& choice, const CalibrationScene& sample) {
    const AssemblyPlan plan = flat_plan(choice.type, choice.parameters);
    Observation o{&sample, 0, 0, 0, 0, {}, {}, {}};
    Assembly assembly;
    double seconds = build_seconds(sample.scene, plan, assembly);
    if (choice.parameters.contains("lazy")) {
        const auto start = Clock::now();
        wake(*assembly.root, sample);
        const double first = seconds_since(start);
        const auto again = Clock::now();
        wake(*assembly.root, sample);
        seconds += std::max(0.0, first - seconds_since(again));
    }
    const double n = double(sample.count);
    o.build_ns = seconds * 1e9 / n;
    o.rays = ray_costs(*assembly.root, sample);
    o.structure_bytes = double(total_statistics(*assembly.root).bytes);
    o.bytes = o.structure_bytes / n;
    o.ray_ns = geometric_mean_ns(o.rays);
    if (sample.size >= least_to_thin) observe_thinned(plan, o, seconds);
    return o;
}

/// What rays of the view take, and those of the other sets, over the mean of all.
void set_coherence(StructureCosts& costs, const std::vector<Observation>& observations) {
    std::vector<double> together, apart;
    for (const Observation& o : observations) {
        constexpr size_t view = 1;  // see ray_costs
        if (o.rays.size() <= view || o.sample->view.empty()) continue;
        std::vector<RayCost> others = o.rays;
        others.erase(others.begin() + view);
        together.push_back(o.rays[view].ns / o.ray_ns);
        apart.push_back(geometric_mean_ns(others) / o.ray_ns);
    }
    if (together.empty()) return;
    costs.together = geometric_mean(together), costs.apart = geometric_mean(apart);
}

void set_thinned(StructureCosts& costs, const std::vector<Observation>& observations) {
    double ray = 0, build = 0;
    int n = 0;
    for (const Observation& o : observations)
        if (o.thin_ray) ray += *o.thin_ray, build += *o.thin_build, ++n;
    if (n > 0) costs.thin_ray = ray / n, costs.thin_build = build / n;
}

/// A power of what OrderCost says, by least squares of logarithms. The spread is what is left.
/// @param nodes  as in fit_counted: whose power holds here, too
void fit_order(StructureCosts& costs, const std::vector<Observation>& observations,
               double cache_bytes, const StructureCosts* nodes) {
    std::vector<std::pair<double, double>> logs;
    for (const Observation& o : observations) {
        const OrderCost order = order_cost(o.sample->scene.geometries.front());
        if (!order.known) continue;
        const double counted =
            costs.counted_ns(order.nodes, order.tests, o.structure_bytes, cache_bytes);
        logs.emplace_back(std::log(counted), std::log(o.ray_ns));
    }
    if (logs.empty()) return;
    double x = 0, y = 0, xx = 0, xy = 0, rest = 0;
    const double n = double(logs.size());
    for (const auto& [a, b] : logs) x += a / n, y += b / n;
    for (const auto& [a, b] : logs) xx += (a - x) * (a - x), xy += (a - x) * (b - y);
    costs.order_power = nodes ? nodes->order_power : std::clamp(xy / std::max(xx, 1e-9), 0.3, 1.0);
    costs.order_scale = std::exp(y - costs.order_power * x);
    for (const auto& [a, b] : logs) {
        const double d = b - y - costs.order_power * (a - x);
        rest += d * d / n;
    }
    costs.ray_spread = std::sqrt(rest);
}

/// @param reference  ns per ray of the structure that spreads are relative to, by sample
StructureCosts costs_of(const StructureChoice& choice, const std::string& kind,
                        const std::vector<Observation>& observations,
                        const std::map<const CalibrationScene*, double>& reference,
                        double cache_bytes, const StructureCosts* nodes) {
    StructureCosts costs;
    costs.structure = choice.name;
    costs.shapes = kind;
    std::vector<CountedRay> counted;
    std::vector<double> ray_deviations, build_deviations;
    // Samples of a size become one point.
    for (size_t begin = 0, end = 0; begin < observations.size(); begin = end) {
        std::vector<double> shapes, build, bytes, ray, relative;
        for (end = begin; end < observations.size() &&
                          observations[end].sample->size == observations[begin].sample->size;
             ++end) {
            const Observation& o = observations[end];
            shapes.push_back(double(o.sample->count));
            build.push_back(o.build_ns);
            bytes.push_back(o.bytes);
            ray.push_back(o.ray_ns);
            relative.push_back(o.ray_ns / reference.at(o.sample));
            for (const RayCost& r : o.rays) counted.push_back({r, o.structure_bytes});
        }
        costs.growth.push_back({geometric_mean(shapes), geometric_mean(build),
                                geometric_mean(bytes), geometric_mean(ray)});
        for (const double x : relative)
            ray_deviations.push_back(std::log(x / geometric_mean(relative)));
        for (const double x : build)
            build_deviations.push_back(std::log(x / costs.growth.back().build_ns));
    }
    set_thinned(costs, observations);
    set_coherence(costs, observations);
    costs.ray_spread = root_mean_square(ray_deviations);
    costs.build_spread = root_mean_square(build_deviations);
    fit_counted(costs, counted, cache_bytes, nodes);
    if (uses_order(choice)) fit_order(costs, observations, cache_bytes, nodes);
    return costs;
}

/// More shapes than this take a structure without hierarchy too long.
constexpr double most_for_brute_force = 4096;

void measure_structures(Calibration& c) {
    const std::vector<CalibrationScene> samples = calibration_scenes();
    std::map<const CalibrationScene*, double> reference;
    for (const StructureChoice& choice : structure_choices())
        for (const char* kind : {"triangles", "quadrics", "polygons"}) {
            std::vector<Observation> observations;
            for (const CalibrationScene& s : samples)
                if (s.shapes == kind &&
                    (choice.type != "brute_force" || s.size <= most_for_brute_force))
                    observations.push_back(observe(choice, s));
            // The first choice is the reference.
            for (const Observation& o : observations) reference.try_emplace(o.sample, o.ray_ns);
            const StructureCosts found = c.find(choice.name, "triangles")
                                             ? *c.find(choice.name, "triangles")
                                             : StructureCosts{};
            const StructureCosts* nodes = found.growth.empty() ? nullptr : &found;
            c.structures.push_back(
                costs_of(choice, kind, observations, reference, c.cache_bytes, nodes));
        }
}

using Json = nlohmann::ordered_json;

Json json_of(const MeasuredCost& m) { return {{"ns", m.ns}, {"low", m.low}, {"high", m.high}}; }

Json json_of(const StructureCosts& s) {
    Json json = {{"structure", s.structure},   {"shapes", s.shapes},
                 {"ray_spread", s.ray_spread}, {"build_spread", s.build_spread},
                 {"per_ray_ns", s.per_ray},    {"per_step_ns", s.per_step},
                 {"per_test_ns", s.per_test},  {"per_doubling", s.per_doubling},
                 {"fit_error", s.fit_error},   {"growth", Json::array()}};
    for (const GrowthPoint& p : s.growth)
        json["growth"].push_back({{"shapes", p.shapes},
                                  {"build_ns_per_shape", p.build_ns},
                                  {"bytes_per_shape", p.bytes},
                                  {"ns_per_ray", p.ray_ns}});
    return json;
}

}  // namespace

Calibration measure_calibration() {
    const auto start = Clock::now();
    Calibration c;
    c.machine = MachineIdentity::here(version_text());
    c.cache_bytes = cache_size(_SC_LEVEL2_CACHE_SIZE, c.cache_bytes);
    // Builds come first: threads that they start would inherit the one core that is pinned later.
    measure_structures(c);
    const PinnedThread pinned(true);
    measure_memory(c);
    measure_constants(c);
    c.measured_s = seconds_since(start);
    return c;
}

void ensure_calibration() {
    if (const char* given = std::getenv("CROFTON_CALIBRATION"); given && *given) {
        set_calibration(std::string(given) == "nominal" ? Calibration::nominal()
                                                        : read_calibration(given));
        return;
    }
    const MachineIdentity machine = MachineIdentity::here(version_text());
    if (calibration().machine == machine) return;
    const std::string path = calibration_path(machine);
    if (std::filesystem::exists(path)) {
        set_calibration(read_calibration(path));
        return;
    }
    fmt::print(stderr, "calibrating this machine, once: {}\n", path);
    set_calibration(measure_calibration());
    write_calibration(calibration(), path);
}

std::string calibration_text(const Calibration& c) {
    std::string text =
        fmt::format("{}, {}, {} threads build, {}; measured in {:.1f} s\n\n", c.machine.cpu,
                    c.machine.isa, c.machine.threads, c.machine.version, c.measured_s);
    text += "Constants, ns (median, interval that holds it with 95 %)\n";
    for (const auto& [name, m] : c.constants)
        text += fmt::format("  {:22} {:7.2f}  [{:.2f}, {:.2f}]\n", name, m.ns, m.low, m.high);
    text += "\nMemory, ns of a load that depends on the last\n";
    for (const MemoryLevel& level : c.memory)
        text += fmt::format("  {:8} {:>10.0f} kB  {:7.2f}  [{:.2f}, {:.2f}]\n", level.name,
                            level.bytes / 1e3, level.load.ns, level.load.low, level.load.high);
    text += fmt::format(
        "\nStructures: at the most shapes measured, ns per shape of a build, bytes per shape, ns "
        "per "
        "ray;\nand a ray's cost by counts: ns = ray + (step·N_TS + test·N_IT)·(1 + m·log2(bytes / "
        "{:.0f} kB)), median error\n",
        c.cache_bytes / 1e3);
    text +=
        fmt::format("  {:22} {:10} {:>8} {:>9} {:>7} {:>8}   {:>6} {:>6} {:>6} {:>5} {:>6}\n", "",
                    "", "shapes", "build", "bytes", "ns/ray", "ray", "step", "test", "m", "error");
    for (const StructureCosts& s : c.structures) {
        const GrowthPoint& p = s.growth.back();
        text += fmt::format(
            "  {:22} {:10} {:>8.0f} {:>9.1f} {:>7.1f} {:>8.1f}   {:>6.1f} {:>6.2f} {:>6.2f} "
            "{:>5.2f} "
            "{:>5.0f}%\n",
            s.structure, s.shapes, p.shapes, p.build_ns, p.bytes, p.ray_ns, s.per_ray, s.per_step,
            s.per_test, s.per_doubling, 100 * s.fit_error);
    }
    return text;
}

std::string calibration_json(const Calibration& c) {
    Json json;
    json["cpu"] = c.machine.cpu;
    json["isa"] = c.machine.isa;
    json["crofton"] = c.machine.version;
    json["build_threads"] = c.machine.threads;
    json["measured_s"] = c.measured_s;
    json["cache_bytes"] = c.cache_bytes;
    for (const auto& [name, m] : c.constants) json["constants"][name] = json_of(m);
    for (const MemoryLevel& level : c.memory) {
        Json one = json_of(level.load);
        one["bytes"] = level.bytes;
        json["memory"][level.name] = std::move(one);
    }
    json["structures"] = Json::array();
    for (const StructureCosts& s : c.structures) json["structures"].push_back(json_of(s));
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace crofton
