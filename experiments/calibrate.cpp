#include "experiments/calibrate.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>

#include "accelerators/auto_select.h"
#include "experiments/calibrate_structures.h"
#include "experiments/measure.h"
#include "experiments/random.h"
#include "experiments/results.h"
#include "experiments/statistics.h"
#include "experiments/workload.h"
#include "framework/clock.h"
#include "framework/error.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/transform.h"
#include "framework/triangle_set.h"
#include "scenegraph/shape_sets.h"

namespace crofton {
namespace {

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

using Json = nlohmann::ordered_json;

Json json_of(const MeasuredCost& m) { return {{"ns", m.ns}, {"low", m.low}, {"high", m.high}}; }

Json json_of(const StructureCosts& s) {
    Json json = {{"structure", s.structure},   {"shapes", s.shapes},
                 {"ray_spread", s.ray_spread}, {"build_spread", s.build_spread},
                 {"per_ray_ns", s.per_ray},    {"per_step_ns", s.per_step},
                 {"per_test_ns", s.per_test},  {"per_doubling", s.per_doubling},
                 {"fit_error", s.fit_error},   {"counted_together", s.counted_together},
                 {"growth", Json::array()}};
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

std::optional<Calibration> cached_calibration(const std::string& path, std::string& damage) {
    if (!std::filesystem::exists(path)) return std::nullopt;
    try {
        return read_calibration(path);
    } catch (const InputError& e) {
        damage = e.what();
        return std::nullopt;
    }
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
    std::string damage;
    if (const auto cached = cached_calibration(path, damage)) {
        set_calibration(*cached);
        return;
    }
    if (!damage.empty()) fmt::print(stderr, "{}\n", damage);
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
        "{:.0f} kB)), median\nerror; times what neighbours from one point take\n",
        c.cache_bytes / 1e3);
    text += fmt::format(
        "  {:22} {:10} {:>8} {:>9} {:>7} {:>8}   {:>6} {:>6} {:>6} {:>5} {:>6} {:>8}\n", "", "",
        "shapes", "build", "bytes", "ns/ray", "ray", "step", "test", "m", "error", "together");
    for (const StructureCosts& s : c.structures) {
        const GrowthPoint& p = s.growth.back();
        text += fmt::format(
            "  {:22} {:10} {:>8.0f} {:>9.1f} {:>7.1f} {:>8.1f}   {:>6.1f} {:>6.2f} {:>6.2f} "
            "{:>5.2f} "
            "{:>5.0f}% {:>8.2f}\n",
            s.structure, s.shapes, p.shapes, p.build_ns, p.bytes, p.ray_ns, s.per_ray, s.per_step,
            s.per_test, s.per_doubling, 100 * s.fit_error, s.counted_together);
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
