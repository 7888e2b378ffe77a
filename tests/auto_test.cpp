// Calibrations, estimates and choices, all with constants that a test injects: no clock decides.

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <set>

#include "accelerators/auto_select.h"
#include "experiments/budget.h"
#include "experiments/calibrate.h"
#include "experiments/fit.h"
#include "experiments/theorem.h"
#include "experiments/workload.h"
#include "framework/error.h"
#include "framework/triangle_set.h"
#include "scenegraph/auto_plan.h"
#include "scenegraph/procedural/procedural.h"
#include "scenegraph/thinned.h"
#include "tests/catch.h"
#include "tests/scratch_file.h"

using namespace crofton;

namespace {

StructureCosts costs(const std::string& name, double build_ns, double bytes, double ray_ns) {
    StructureCosts c{name, "triangles", {{16, build_ns, bytes, ray_ns}}, 0.1, 0.1, 1, 2, 3,
                     0.1,  0.05};
    c.test_share = 0.25;
    return c;
}

/// Three structures: cheap to build, compromise, fast to trace.
Calibration three() {
    Calibration c;
    c.machine = {"a cpu", "sse4", "1.0", 2};
    c.constants["virtual_call"] = {1.5, 1.25, 1.75};
    c.memory.push_back({"L1", 16384, {1.5, 1.25, 1.75}});
    c.structures = {costs("bvh/lbvh", 10, 20, 400), costs("bvh", 100, 40, 200),
                    costs("bvh/sbvh", 2000, 80, 100)};
    return c;
}

std::vector<CostEstimate> estimates(const Objective& objective, double count = 1000) {
    std::vector<CostEstimate> out;
    for (const StructureChoice& choice : structure_choices())
        out.push_back(estimate(choice, count, "triangles", objective, three()));
    return out;
}

std::string chosen(const Objective& objective) {
    return structure_choices()[best_of(estimates(objective), objective)].name;
}

TriangleSet strip(uint32_t n) {
    std::vector<Vec3f> positions;
    std::vector<TriangleSet::Indices> triangles;
    for (uint32_t i = 0; i < n + 2; ++i) positions.emplace_back(float(i / 2), float(i % 2), 0.0f);
    for (uint32_t i = 0; i < n; ++i) triangles.push_back({i, i + 1, i + 2});
    return TriangleSet(positions, triangles);
}

/// Puts the calibration back at the end.
class InjectedCalibration {
  public:
    explicit InjectedCalibration(Calibration c) : before_(calibration()) {
        set_calibration(std::move(c));
    }
    ~InjectedCalibration() { set_calibration(before_); }

  private:
    Calibration before_;
};

}  // namespace

TEST_CASE("calibration: what is written is read back, to the bits") {
    const ScratchFile file("calibration.toml", to_toml(three()));
    const Calibration read = read_calibration(file.path());
    CHECK(to_toml(read) == to_toml(three()));
    CHECK(read.machine == three().machine);
    REQUIRE(read.find("bvh", "triangles"));
    CHECK(read.find("bvh", "triangles")->growth[0].ray_ns == 200);
    CHECK(read.find("bvh", "triangles")->test_share == 0.25);
    CHECK(read.find("bvh", "quadrics") == nullptr);
}

TEST_CASE("calibration: a damaged or foreign file is refused with its place") {
    for (const char* text : {"", "version = 2\n", "version = 3\nwhat = 3\n",
                             "version = 3\n[[structure]]\nstructure = \"bvh\"\n",
                             "version = 3\n[constant]\nvirtual_call = [1.0]\n", "version = ["}) {
        const ScratchFile file("calibration.toml", text);
        INFO(text);
        CHECK_THROWS_AS(read_calibration(file.path()), InputError);
    }
}

TEST_CASE("calibration: a cached file that is damaged is none, and it is said why") {
    const ScratchFile good("good.toml", to_toml(three())), bad("bad.toml", "version = 2\n");
    std::string damage;
    CHECK_FALSE(cached_calibration(good.path() + ".gone", damage));
    CHECK(damage.empty());
    CHECK_FALSE(cached_calibration(bad.path(), damage));
    CHECK(damage.find("bad.toml:1") != std::string::npos);
    const std::optional<Calibration> cached = cached_calibration(good.path(), damage);
    REQUIRE(cached);
    CHECK(cached->machine == three().machine);
}

TEST_CASE("calibration: its file's name tells machines, instruction sets and versions apart") {
    const MachineIdentity one{"cpu", "sse4", "1", 2};
    for (const MachineIdentity& other :
         {MachineIdentity{"cpu2", "sse4", "1", 2}, MachineIdentity{"cpu", "avx2", "1", 2},
          MachineIdentity{"cpu", "sse4", "2", 2}, MachineIdentity{"cpu", "sse4", "1", 3}})
        CHECK(calibration_path(one) != calibration_path(other));
    CHECK(calibration_path(one) == calibration_path(MachineIdentity(one)));
}

TEST_CASE("calibration: costs between and beyond the points follow powers of the count") {
    StructureCosts s;
    s.growth = {{10, 100, 50, 20}, {1000, 400, 50, 80}};
    CHECK(s.at(100).build_ns == Approx(200));
    CHECK(s.at(100).ray_ns == Approx(40));
    CHECK(s.at(100000).ray_ns == Approx(320));
    CHECK(s.at(100000).bytes == Approx(50));
    CHECK(s.at(1).ray_ns == 20);
    s.growth[0].together = 0.2, s.growth[1].together = 0.8;
    CHECK(s.at(100).together == Approx(0.4));
    CHECK(s.at(1).together == 0.2);
    CHECK(s.at(1e9).together == 0.8);
}

TEST_CASE("fit: constants that made the times are found again") {
    StructureCosts truth;
    truth.per_ray = 20, truth.per_step = 3, truth.per_test = 5, truth.per_doubling = 0.25;
    std::vector<CountedRay> rays;
    for (double steps : {5.0, 10.0, 40.0})
        for (double tests : {1.0, 8.0})
            for (double bytes : {1e5, 8e6}) {
                CountedRay r{{0, steps, tests}, bytes};
                r.ray.ns = truth.counted_ns(steps, tests, bytes, 1e6);
                rays.push_back(r);
            }
    StructureCosts fitted;
    fit_counted(fitted, rays, 1e6);
    CHECK(fitted.per_ray == Approx(20));
    CHECK(fitted.per_step == Approx(3));
    CHECK(fitted.per_test == Approx(5));
    CHECK(fitted.per_doubling == Approx(0.25));
    CHECK(fitted.fit_error < 1e-9);
}

TEST_CASE("fit: no constant is negative, whatever the times") {
    std::vector<CountedRay> rays;
    for (double x : {1.0, 2.0, 3.0, 4.0}) rays.push_back({{100 - 10 * x, x, 4 * x * x}, 0});
    StructureCosts fitted;
    fit_counted(fitted, rays, 1e6);
    CHECK(fitted.per_ray >= 0);
    CHECK(fitted.per_step >= 0);
    CHECK(fitted.per_test >= 0);
}

TEST_CASE("auto: few rays get what is built fast, many what is traced fast") {
    CHECK(chosen({.rays = 1}) == "bvh/lbvh");
    CHECK(chosen({.rays = 1e4}) == "bvh");
    CHECK(chosen({.rays = 1e8}) == "bvh/sbvh");
}

TEST_CASE("auto: the time to trace or to build can count alone") {
    CHECK(chosen({.rays = 1, .priority = Priority::trace}) == "bvh/sbvh");
    // bvh/lbvh takes just four times as long as the fastest.
    CHECK(chosen({.rays = 1e12, .priority = Priority::build}) == "bvh/lbvh");
}

TEST_CASE("auto: what does not fit into the memory is not chosen, and if nothing does it says so") {
    CHECK(chosen({.rays = 1e8, .memory = 50e3}) == "bvh");
    CHECK(chosen({.rays = 1e8, .memory = 20e3}) == "bvh/lbvh");
    CHECK_THROWS_WITH(chosen({.rays = 1e8, .memory = 10e3}),
                      Catch::Matchers::ContainsSubstring("10000 bytes") &&
                          Catch::Matchers::ContainsSubstring("20000"));
}

TEST_CASE("auto: as an accelerator it builds the structure with the least expected total") {
    const InjectedCalibration injected([] {
        Calibration c = three();
        c.structures[0].structure = "brute_force";
        c.structures[2].structure = "kdtree";
        return c;
    }());
    const PrimitiveSet set = std::make_shared<const TriangleSet>(strip(1000));
    const auto built = [&](double rays) {
        return accelerator("auto").build(set, {{"rays", rays}})->type_name();
    };
    CHECK(built(1) == "brute_force");
    CHECK(built(1e4) == "bvh");
    CHECK(built(1e8) == "kdtree");
    CHECK_THROWS_AS(accelerator("auto").build(set, {{"memory", 1.0}}), InputError);
    CHECK_THROWS_AS(accelerator("auto").build(set, {{"ray", 1.0}}), InputError);
}

TEST_CASE("auto: every structure that can be chosen is known without a calibration") {
    for (const StructureChoice& choice : structure_choices()) {
        INFO(choice.name);
        const StructureCosts* found = Calibration::nominal().find(choice.name, "triangles");
        REQUIRE(found);
        CHECK(found->growth.back().build_ns > 0);
        CHECK(found->growth.back().ray_ns > 0);
    }
}

namespace {

/// Two terrains far apart, one placed three times.
Scene two_terrains() {
    Scene scene = make_scene("terrain", {{"n", 8.0}});
    Scene other = make_scene("terrain", {{"n", 32.0}});
    const uint32_t mesh = scene.nodes[scene.roots[0]].mesh.value();
    scene.add_node("again", mesh, translation({40, 0, 0}));
    scene.add_node("and again", mesh, translation({0, 0, 40}));
    scene.add_object("other", std::move(other.geometries[0]), translation({-40, 0, 0}));
    return scene;
}

AutoOptions counted_for(double rays, double memory = 0) {
    AutoOptions options;
    options.objective.rays = rays;
    options.objective.memory = memory;
    options.clock = false;
    return options;
}

Selection choose(const Scene& scene, const AutoOptions& options, std::span<const Ray> rays) {
    return choose_assembly(scene, options, {rays, false, Mode::robust}, three());
}

double area_of(const Scene& scene) {
    double area = 0;
    for (const Geometry& g : scene.geometries) {
        const auto& mesh = std::get<TriangleMesh>(g.shapes);
        for (const auto& t : mesh.triangles)
            area += (mesh.positions[t[1]] - mesh.positions[t[0]])
                        .cross(mesh.positions[t[2]] - mesh.positions[t[0]])
                        .norm();
    }
    return area;
}

}  // namespace

TEST_CASE("auto: shapes are counted by kind, once and as often as they are placed") {
    const SceneCounts counts = count_shapes(two_terrains());
    REQUIRE(counts.kinds.size() == 1);
    CHECK(counts.main_kind() == "triangles");
    CHECK(counts.kinds[0].unique == 128 + 2048);
    CHECK(counts.kinds[0].placed == 3 * 128 + 2048);
    CHECK(counts.placements == 4);
    CHECK(counts.meshes.size() == 2);
}

TEST_CASE("auto: shared nodes are counted without walking every path") {
    // 20^5 cubes; a path at a time would take minutes at this depth.
    const SceneCounts counts = count_shapes(make_scene("menger", {{"depth", 5.0}}));
    CHECK(counts.placements == std::pow(20.0, 5));
}

TEST_CASE("auto: a whole scene's choice follows the number of rays") {
    const Scene scene = two_terrains();
    const auto rays = random_lines({Vec3d::Zero(), 50}, 64, 1);
    CHECK(choose(scene, counted_for(1), rays).choice().choice.structure.name == "bvh/lbvh");
    CHECK(choose(scene, counted_for(1e9), rays).choice().choice.structure.name == "bvh/sbvh");
}

TEST_CASE("auto: the same calibration, scene and rays give the same choice and estimates") {
    const Scene scene = two_terrains();
    const auto rays = random_lines({Vec3d::Zero(), 50}, 64, 1);
    for (const double budget : {1e2, 1e4, 1e6, 1e8}) {
        const Selection a = choose(scene, counted_for(budget), rays);
        const Selection b = choose(scene, counted_for(budget), rays);
        CHECK(a.choice().choice.name == b.choice().choice.name);
        REQUIRE(a.candidates.size() == b.candidates.size());
        for (size_t i = 0; i < a.candidates.size(); ++i) {
            CHECK(a.candidates[i].choice.name == b.candidates[i].choice.name);
            CHECK(a.candidates[i].known().ns_per_ray == b.candidates[i].known().ns_per_ray);
        }
    }
}

TEST_CASE("auto: what is built never takes more than the memory limit") {
    const Scene scene = two_terrains();
    const auto rays = random_lines({Vec3d::Zero(), 50}, 64, 1);
    int fitted = 0, refused = 0;
    for (double limit = 1e3; limit < 1e7; limit *= 2) {
        try {
            const Selection s = choose(scene, counted_for(1e8, limit), rays);
            CHECK(double(total_statistics(*s.assembly.root).bytes) <= limit);
            ++fitted;
        } catch (const InputError&) {
            ++refused;
        }
    }
    CHECK(fitted > 0);
    CHECK(refused > 0);
}

TEST_CASE("auto: what rays build later is no candidate where memory is limited") {
    const SceneCounts counts = count_shapes(make_scene("menger", {{"depth", 4.0}}));
    const auto lazy = [&](double memory) {
        const auto choices = plan_choices(counts, counted_for(1e6, memory));
        return std::count_if(choices.begin(), choices.end(),
                             [](const PlanChoice& c) { return is_lazy(c.structure); });
    };
    CHECK(lazy(0) > 0);
    CHECK(lazy(1e12) == 0);
}

TEST_CASE("auto: as an accelerator it keeps to the memory limit whatever was predicted") {
    // Everything is said to take a byte a shape; lazy ones to be best.
    Calibration wrong = three();
    for (const StructureChoice& c : structure_choices())
        wrong.structures.push_back(costs(c.name, 1, 1, is_lazy(c) ? 1 : 500));
    for (StructureCosts& c : wrong.structures) c.growth[0].bytes = 1;
    const InjectedCalibration injected(wrong);
    const PrimitiveSet set = std::make_shared<const TriangleSet>(strip(20000));
    int fitted = 0, refused = 0;
    for (double limit = 2e4; limit < 1e7; limit *= 2) {
        try {
            const auto built = accelerator("auto").build(set, {{"memory", limit}});
            for (const Ray& ray : random_lines({Vec3d(5000, 0, 0), 5000}, 200, 1))
                built->intersect(ray);
            CHECK(double(total_statistics(*built).bytes) <= limit);
            ++fitted;
        } catch (const InputError&) {
            ++refused;
        }
    }
    CHECK(fitted > 0);
    CHECK(refused > 0);
}

TEST_CASE(
    "auto: samples are runs of rays as they are traced, and every quarter is spread over all") {
    std::vector<Ray> rays(10000);
    for (size_t i = 0; i < rays.size(); ++i) rays[i].origin = Vec3f(float(i), 0, 0);
    for (const size_t count : {16u, 64u, 1000u, 4096u, 10000u, 20000u}) {
        const std::vector<Ray> some = some_of(rays, count);
        INFO(count);
        CHECK(some.size() <= count);
        CHECK(some.size() >= std::min<size_t>(count, rays.size()) * 3 / 4);
        const size_t quarter = some.size() / 4;
        std::set<float> seen;
        for (size_t q = 0; q < 4; ++q) {
            float least = 1e9f, most = 0;
            for (size_t i = q * quarter; i < (q + 1) * quarter; ++i) {
                least = std::min(least, some[i].origin.x());
                most = std::max(most, some[i].origin.x());
                seen.insert(some[i].origin.x());
            }
            CHECK(least <= 4000);
            CHECK(most >= 6000);
        }
        CHECK(seen.size() == 4 * quarter);  // none twice
    }
    const std::vector<Ray> some = some_of(rays, 4096);
    size_t follow = 0;
    for (size_t i = 1; i < some.size(); ++i)
        follow += some[i].origin.x() == some[i - 1].origin.x() + 1;
    CHECK(follow > some.size() * 9 / 10);
    CHECK(some_of({}, 100).empty());
}

TEST_CASE("auto: a sample of a picture is from all of its columns, whatever their number") {
    for (const size_t width : {150u, 173u, 200u, 256u, 400u, 1000u}) {
        std::vector<Ray> rays(30000);
        for (size_t i = 0; i < rays.size(); ++i)
            rays[i].origin[0] = float(i % width) / float(width);
        for (const size_t count : {512u, 1024u, 2048u, 4096u}) {
            CAPTURE(width, count);
            std::array<size_t, 8> columns{};
            const std::vector<Ray> some = some_of(rays, count);
            for (const Ray& ray : some) ++columns[size_t(8 * ray.origin.x())];
            CHECK(*std::min_element(columns.begin(), columns.end()) >= some.size() / 24);
            CHECK(*std::max_element(columns.begin(), columns.end()) <= some.size() / 4);
        }
    }
}

TEST_CASE("auto: a scattered order of the shapes costs more tests and nodes than a tidy one") {
    Scene tidy = make_scene("terrain", {{"n", 64.0}});
    Scene scattered = tidy;
    auto& triangles = std::get<TriangleMesh>(scattered.geometries[0].shapes).triangles;
    const size_t n = triangles.size(), step = 4001;  // odd, so that every one has its place
    auto mixed = triangles;
    for (size_t i = 0; i < n; ++i) mixed[i] = triangles[i * step % n];
    triangles = mixed;
    const OrderCost a = order_cost(tidy.geometries[0]), b = order_cost(scattered.geometries[0]);
    CHECK(a.known);
    CHECK(b.nodes > 5 * a.nodes);
    CHECK(b.tests > 5 * a.tests);

    Calibration c = three();
    c.structures.push_back(costs("model_hierarchy", 10, 20, 100));
    c.structures.push_back(costs("wide_bvh/lbvh", 10, 20, 50));
    const PlanChoice choice = plan_choice(
        *std::find_if(structure_choices().begin(), structure_choices().end(),
                      [](const StructureChoice& s) { return s.name == "model_hierarchy"; }),
        PlanChoice::Placing::flat);
    const auto ns = [&](const Scene& scene) {
        return estimate(choice, count_shapes(scene), counted_for(1e6), c).ns_per_ray;
    };
    const double built = estimate(plan_choice(quickest(), PlanChoice::Placing::flat),
                                  count_shapes(tidy), counted_for(1e6), c)
                             .ns_per_ray;
    // Whatever the order itself was calibrated with.
    CHECK(ns(tidy) > 1.5 * built);
    CHECK(ns(tidy) < 2.5 * built);
    // Boxes of all that are met, and almost no ray ends early.
    CHECK(ns(scattered) > 5 * ns(tidy));
}

TEST_CASE("auto: what a thinned scene's rays cost grows as calibrations say") {
    const Scene scene = make_scene("terrain", {{"n", 64.0}});
    const SceneCounts counts = count_shapes(scene);
    const Pilot pilot(scene, counts, 512);
    const auto rays = random_lines({Vec3d::Zero(), 1}, 256, 1);
    const PlanChoice choice = plan_choice(structure_choices()[0], PlanChoice::Placing::flat);
    const auto ns = [&](double power) {
        Calibration c = three();
        c.structures.push_back(costs("wide_bvh", 10, 20, 100));
        c.structures.back().thin_apart = power;
        return pilot
            .estimate(choice, plan_of(choice), {rays, false, Mode::robust}, counted_for(1e6), c)
            .ns_per_ray;
    };
    REQUIRE(choice.structure.name == "wide_bvh");
    CHECK(ns(0) > 0);
    CHECK(ns(0.5) / ns(0) == Approx(4));  // 16 times the shapes
}

namespace {

Candidate candidate(const char* name, double build_s, double ns) {
    Candidate c;
    c.choice = plan_choice({name, "bvh", {}}, PlanChoice::Placing::flat);
    c.predicted = {build_s, 1000, ns, 0, 0.1, true};
    set_total(c.predicted, {1e6, 0, {}});
    return c;
}

}  // namespace

TEST_CASE("auto: no build is lost beyond the share of choosing") {
    // 1e6 rays of 100 ns are 0.1 s: 4 ms may be lost.
    const auto next = [&](double held_build_s) {
        Outlook outlook({candidate("held", held_build_s, 100), candidate("other", 0.002, 95)},
                        counted_for(1e6), 10000);
        outlook.learn(0, outlook[0], 4000);
        return outlook.next(0);
    };
    CHECK(next(0.001) == 1);
    CHECK(next(0.008) == 2);
}

TEST_CASE("auto: of two builds, the one that is less likely to be used counts as lost") {
    const auto next = [&](double ns, double spread) {
        Candidate other = candidate("other", 0.015, ns);
        other.predicted.ray_spread = spread;
        Outlook outlook({candidate("held", 0.001, 100), other}, counted_for(1e6), 10000);
        outlook.learn(0, outlook[0], 4000);
        return outlook.next(0);
    };
    CHECK(next(50, 0.1) == 1);
    CHECK(next(95, 0.5) == 2);  // might gain more than its build, but as likely nothing
}

TEST_CASE("auto: an order is not built in the hope that it is better than a tree") {
    const auto next = [](const char* type) {
        Candidate other = candidate("other", 1e-4, 110);
        other.choice.structure.type = type;
        other.predicted.ray_spread = order_spread;
        Outlook outlook({candidate("bvh", 0.001, 100), other}, counted_for(1e6), 4096);
        outlook.learn(0, {0.001, 1000, 100, 0, 0.1, true}, 1000);
        return outlook.next(0);
    };
    CHECK(next("model_hierarchy") == 2);
    CHECK(next("kdtree") == 1);  // as little is known of it, but it may be better
}

TEST_CASE("auto: time that choosing has taken is not there for another build") {
    const AutoOptions options = counted_for(1e6);
    Outlook outlook({candidate("held", 0.001, 100), candidate("other", 0.002, 80)}, options, 10000);
    outlook.learn(0, outlook[0], 4000);
    REQUIRE(outlook.next(0) == 1);
    outlook.set_spent(0.05 * outlook.total());
    CHECK(outlook.allowed() < 0);
    CHECK(outlook.next(0) == 2);
}

TEST_CASE("auto: nodes that only save memory are a candidate only where memory is limited") {
    const SceneCounts counts = count_shapes(two_terrains());
    AutoOptions options = counted_for(1e6);
    const auto quantised = [&] {
        const std::vector<PlanChoice> choices = plan_choices(counts, options);
        return std::count_if(choices.begin(), choices.end(), [](const PlanChoice& c) {
            return c.structure.name == "wide_bvh/quantised";
        });
    };
    CHECK(quantised() == 0);
    options.objective.memory = 1e9;
    CHECK(quantised() == 1);
}

TEST_CASE("auto: shapes that are dear to test make rays dear, by the share of tests") {
    SceneCounts counts = count_shapes(two_terrains());
    const PlanChoice choice = plan_choice({"wide_bvh", "wide_bvh", {}}, PlanChoice::Placing::flat);
    const AutoOptions options = counted_for(1e6);
    Calibration c = Calibration::nominal();
    const double ns = estimate(choice, counts, options, c).ns_per_ray;
    const double share = c.find("wide_bvh", "triangles")->test_share;
    REQUIRE(share > 0);
    counts.weight = 11;
    CHECK(estimate(choice, counts, options, c).ns_per_ray == Approx(ns * (1 + 10 * share)));
}

TEST_CASE("auto: two structures are compared on every number of rays") {
    const Scene scene = two_terrains();
    const PlanChoice choice = plan_choice({"bvh", "bvh", {}}, PlanChoice::Placing::flat);
    const Assembly assembly = assemble(scene, plan_of(choice));
    for (const size_t n : {1u, 64u, 65u, 1000u}) {
        const auto rays = random_lines({Vec3d::Zero(), 50}, n, 1);
        const double ratio =
            time_ratio(*assembly.root, *assembly.root, {rays, false, Mode::robust});
        CHECK(std::isfinite(ratio));
        CHECK(ratio > 0);
    }
}

TEST_CASE("auto: what is built in no time comes first, to teach how dear rays are") {
    // 1e6 rays: of a total of 0.1 s, 1 % is no time.
    const auto first = [](double dear_ns, double cheap_build_s) {
        return Outlook({candidate("dear", 0.04, dear_ns), candidate("cheap", cheap_build_s, 100)},
                       counted_for(1e6), 10000)
            .first();
    };
    CHECK(first(60, 0.0005) == 1);
    CHECK(first(30, 0.0005) == 0);  // cheap is not nearly as good
    CHECK(first(60, 0.006) == 0);
}

TEST_CASE("auto: a careful build follows a blind one of the same structure if only that is lost") {
    // Of 1e6 rays, 0.1 s: 3 ms may be lost, 15 ms not.
    const auto next = [](const char* builder) {
        Candidate quick = candidate("quick", 0.003, 100), careful = candidate("careful", 0.015, 95);
        careful.predicted.ray_spread = 0.5;
        quick.choice.structure.parameters["builder"] = std::string(builder);
        Outlook outlook({quick, careful}, counted_for(1e6), 10000);
        outlook.learn(0, outlook[0], 4000);
        return outlook.next(0);
    };
    CHECK(next("lbvh") == 1);
    CHECK(next("ploc") == 2);
}

TEST_CASE("auto: how nesting compares on a thinned scene scales what is nested, and nothing else") {
    const AutoOptions options = counted_for(1e6);
    Candidate nested = candidate("nested", 0.001, 0);
    const double before = nested_factor(nested.choice.structure, options.objective.coherence);
    nested.predicted.ns_per_ray = 100 * before;
    nested.choice.placing = PlanChoice::Placing::nested;
    Outlook outlook({candidate("flat", 0.001, 100), nested}, options, 10000);
    outlook.learn_placing(1);
    CHECK(outlook[0].ns_per_ray == 100);
    const double nearly = outlook[1].ns_per_ray;
    CHECK(nearly > 95);
    CHECK(nearly < 105);
    outlook.learn_placing(std::numeric_limits<double>::quiet_NaN());
    CHECK(outlook[1].ns_per_ray == nearly);
}

TEST_CASE(
    "auto: how a careful build compares on a thinned scene scales what is not built blindly") {
    const AutoOptions options = counted_for(1e6);
    const auto with_builder = [](const char* name, double ns, const char* builder) {
        Candidate c = candidate(name, 0.001, ns);
        if (*builder) c.choice.structure.parameters["builder"] = std::string(builder);
        return c;
    };
    Outlook outlook(
        {with_builder("quick", 100, "lbvh"), with_builder("careful", 100, ""),
         with_builder("better", 90, "sbvh"), with_builder("another quick", 150, "median")},
        options, 10000);
    outlook.learn_builder(1, 0, 0.5);
    CHECK(outlook[0].ns_per_ray == 100);
    CHECK(outlook[3].ns_per_ray == 150);
    // Most of what was seen is believed, and for all of them the same.
    CHECK(outlook[1].ns_per_ray > 50);
    CHECK(outlook[1].ns_per_ray < 70);
    CHECK(outlook[2].ns_per_ray == Approx(0.9 * outlook[1].ns_per_ray));
    CHECK(outlook.piloted(1));
    const double before = outlook[1].ns_per_ray;
    outlook.learn_builder(1, 0, std::numeric_limits<double>::quiet_NaN());
    CHECK(outlook[1].ns_per_ray == before);
}

TEST_CASE("auto: of two structures' times, rays that hit nothing do not drown the others") {
    // Most runs pass everything by, in both alike; what hits takes twice as long in one.
    std::vector<RunSeconds> seconds(24, {1, 1});
    for (size_t i = 0; i < 8; ++i) seconds[3 * i] = {60 + double(i), 30 + 0.5 * double(i)};
    CHECK(middle_ratio(seconds) == Approx(2).epsilon(0.01));
    // The machine was busy elsewhere in one run of each.
    seconds[0].own = 5000;
    seconds[3].others = 5000;
    CHECK(middle_ratio(seconds) == Approx(2).epsilon(0.01));
    CHECK(middle_ratio({{3, 4}}) == Approx(0.75));
    CHECK(std::isnan(middle_ratio({{0, 0}})));
}

TEST_CASE("auto: rays from one point, neighbours together, are told from others") {
    std::vector<Ray> rays(100);
    for (size_t i = 0; i < rays.size(); ++i) rays[i].direction = Vec3f(0.01f * float(i), 0, 1);
    CHECK(coherence_of(rays) == Coherence::together);
    for (size_t i = 0; i < rays.size(); i += 2) rays[i].direction = -rays[i].direction;
    CHECK(coherence_of(rays) == Coherence::apart);
    CHECK(coherence_of({}) == Coherence::unknown);
    StructureCosts c = costs("bvh", 100, 40, 200);
    c.growth.back().together = 0.5, c.growth.back().apart = 1.5;
    Objective objective;
    for (const auto& [coherence, ns] : {std::pair{Coherence::unknown, 200.0},
                                        {Coherence::together, 100.0},
                                        {Coherence::apart, 300.0}}) {
        objective.coherence = coherence;
        CHECK(estimate(&c, false, 100, objective).ns_per_ray == Approx(ns));
    }
}

TEST_CASE("auto: what two thinned structures show is believed more than what counts say") {
    const AutoOptions options = counted_for(1e6);
    Outlook outlook({candidate("held", 0.001, 100), candidate("other", 0.002, 60)}, options, 10000);
    outlook.learn(0, outlook[0], 4000);
    REQUIRE(outlook.next(0) == 1);
    outlook.learn_from_pilots(1, 0, 1.3);
    CHECK(outlook[1].ns_per_ray == Approx(130));
    CHECK(outlook.piloted(1));
    CHECK(outlook.next(0) == 2);  // not worth its build any more
}

TEST_CASE("auto: without rays to try, and for empty scenes, counts alone decide") {
    CHECK(choose(two_terrains(), counted_for(1e9), {}).choice().choice.structure.name ==
          "bvh/sbvh");
    const auto rays = random_lines({Vec3d::Zero(), 50}, 64, 1);
    for (const std::span<const Ray> some : {std::span<const Ray>(), std::span<const Ray>(rays)}) {
        const Selection none = choose(Scene{}, counted_for(1e6), some);
        REQUIRE(none.assembly.root);
        CHECK_FALSE(none.assembly.root->intersect(Ray{}).is_hit());
    }
}

TEST_CASE("auto: what is chosen gives the hits of any other structure") {
    const Scene scene = two_terrains();
    const auto rays = random_lines({Vec3d::Zero(), 60}, 500, 3);
    AssemblyPlan plan;
    plan.top = plan.objects = std::make_shared<const AcceleratorChoice>(
        AcceleratorChoice{"kdtree", "kdtree", {}, nullptr});
    const Assembly other = assemble(scene, plan);
    for (const double budget : {1.0, 1e5, 1e9}) {
        const Selection s = choose(scene, counted_for(budget), rays);
        for (const Ray& ray : rays)
            CHECK(s.assembly.root->intersect(ray) == other.root->intersect(ray));
    }
}

TEST_CASE("auto: the explanation names what was chosen and what was not") {
    const Scene scene = two_terrains();
    const auto rays = random_lines({Vec3d::Zero(), 50}, 64, 1);
    const AutoOptions options = counted_for(1e9);
    const std::string text = explanation(choose(scene, options, rays), options.objective);
    CHECK(text.find("* ") != std::string::npos);
    CHECK(text.find("flat bvh/lbvh") != std::string::npos);
    CHECK(text.find("bvh/sbvh") != std::string::npos);
    CHECK(text.find("built") != std::string::npos);
}

TEST_CASE("thinned: fewer shapes of the same area in all, always the same ones") {
    const Scene scene = make_scene("terrain", {{"n", 64.0}});
    const Scene thin = thinned(scene, 16);
    const auto count = [](const Scene& s) {
        return std::get<TriangleMesh>(s.geometries[0].shapes).triangles.size();
    };
    CHECK(count(scene) == 8192);
    CHECK(count(thin) == 512);
    // Some are cut back to their region.
    CHECK(area_of(thin) == Approx(area_of(scene)).epsilon(0.2));
    CHECK(std::get<TriangleMesh>(thinned(scene, 16).geometries[0].shapes).positions ==
          std::get<TriangleMesh>(thin.geometries[0].shapes).positions);
    CHECK(count(thinned(scene, 1)) == count(scene));
}

TEST_CASE("thinned: a sample of the shapes leaves as many, of about the same area") {
    const Scene scene = make_scene("terrain", {{"n", 64.0}});
    const Scene thin = thinned(scene, 64, 8);
    CHECK(std::get<TriangleMesh>(thin.geometries[0].shapes).triangles.size() == 128);
    CHECK(area_of(thin) == Approx(area_of(scene)).epsilon(0.3));
}

TEST_CASE("thinned: a few large shapes among many small ones stay as they are") {
    Scene scene = make_scene("terrain", {{"n", 32.0}});
    auto& mesh = std::get<TriangleMesh>(scene.geometries[0].shapes);
    const auto first = uint32_t(mesh.positions.size());
    for (const Vec3f& p : {Vec3f(-900, 0, 0), Vec3f(900, 0, 0), Vec3f(0, 900, 0)})
        mesh.positions.push_back(p);
    mesh.triangles.push_back({first, first + 1, first + 2});
    const Scene thin = thinned(scene, 32);
    const auto& left = std::get<TriangleMesh>(thin.geometries[0].shapes);
    int large = 0;
    for (const auto& t : left.triangles) large += left.positions[t[0]].x() == -900;
    CHECK(large == 1);
    CHECK(left.triangles.size() < 100);
}

TEST_CASE("theorem: areas and probabilities from random lines converge as 1/sqrt(N)") {
    for (const char* name : {"terrain", "tetra", "sphereflake"}) {
        INFO(name);
        const Scene scene =
            make_scene(name, std::string(name) == "terrain" ? ProceduralValues{{"n", 32.0}}
                                                            : ProceduralValues{{"depth", 3.0}});
        const auto rows = crofton_theorem(scene, 64000, 1);
        REQUIRE(rows.size() == 4);
        for (const TheoremRow& row : rows)
            for (const LineMean& m : {row.area, row.box, row.boxes}) {
                // Twelve means of fixed lines: five standard errors mean a wrong formula.
                CHECK(std::abs(m.mean - m.truth) <= 5 * m.standard_error);
                CHECK(m.truth > 0);
            }
        // 64 times the lines: an eighth of the error.
        const double ratio = rows[0].area.standard_error / rows[3].area.standard_error;
        CHECK(ratio == Approx(8).epsilon(0.25));
    }
}

TEST_CASE("theorem: a scene without surface is refused") {
    CHECK_THROWS_AS(crofton_theorem(Scene{}, 1000, 1), InputError);
}

TEST_CASE("budget: rank correlations are those of the ranks, ties in the middle") {
    const std::vector<double> a{1, 2, 3, 4}, same{10, 20, 30, 4000}, reverse{4, 3, 2, 1},
        tied{1, 1, 2, 2};
    CHECK(rank_correlation(a, same) == Approx(1));
    CHECK(rank_correlation(a, reverse) == Approx(-1));
    CHECK(rank_correlation(a, tied) == Approx(2 / std::sqrt(5.0)));
}
