// Calibrations, estimates and choices, all with constants that a test injects: no clock decides.

#include <cmath>

#include "accelerators/auto_select.h"
#include "experiments/fit.h"
#include "framework/error.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/scratch_file.h"

using namespace crofton;

namespace {

StructureCosts costs(const std::string& name, double build_ns, double bytes, double ray_ns) {
    return {name, "triangles", {{16, build_ns, bytes, ray_ns}}, 0.1, 0.1, 1, 2, 3, 0.1, 0.05};
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
    CHECK(read.find("bvh", "quadrics") == nullptr);
}

TEST_CASE("calibration: a damaged or foreign file is refused with its place") {
    for (const char* text : {"", "version = 2\n", "version = 1\nwhat = 3\n",
                             "version = 1\n[[structure]]\nstructure = \"bvh\"\n",
                             "version = 1\n[constant]\nvirtual_call = [1.0]\n", "version = ["}) {
        const ScratchFile file("calibration.toml", text);
        INFO(text);
        CHECK_THROWS_AS(read_calibration(file.path()), InputError);
    }
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
}

TEST_CASE("fit: constants that made the times are found again") {
    StructureCosts truth;
    truth.per_ray = 20, truth.per_step = 3, truth.per_test = 5, truth.per_doubling = 0.25;
    std::vector<CountedRay> rays;
    for (double steps : {5.0, 10.0, 40.0})
        for (double tests : {1.0, 8.0})
            for (double bytes : {1e5, 8e6}) {
                CountedRay r{{0, steps, tests}, bytes};
                r.ray.ns = counted_ns(truth, r.ray, bytes, 1e6);
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
