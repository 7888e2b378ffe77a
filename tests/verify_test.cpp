// crofton verify: the catalogue in every accelerator, and its own bookkeeping.

#include "experiments/verify.h"

#include <cmath>
#include <limits>

#include "experiments/catalogue/scenes.h"
#include "experiments/minimise.h"
#include "framework/error.h"
#include "framework/parallel.h"
#include "framework/registry.h"
#include "tests/catch.h"
#include "tests/scratch_file.h"

namespace crofton {
namespace {

VerifyOptions of(std::string scene, std::vector<std::string> accelerators, uint64_t rays = 100,
                 uint64_t seed = 1) {
    VerifyOptions options;
    options.scene = std::move(scene);
    options.accelerators = std::move(accelerators);
    options.rays = rays;
    options.seed = seed;
    return options;
}

std::string error_of(const VerifyOptions& options) {
    try {
        Progress quiet(true);
        verify(options, quiet);
    } catch (const InputError& error) {
        return error.what();
    }
    return "accepted";
}

VerifyReport run(const VerifyOptions& options) {
    Progress quiet(true);
    return verify(options, quiet);
}

std::string kinds(const VerifyReport& report) {
    std::string text;
    for (size_t i = 0; i < std::min<size_t>(20, report.failing.size()); ++i) {
        const FailingRay& f = report.failing[i];
        text += f.scene + " " + f.recipe + " " + f.accelerator + " " + f.kind + "\n";
    }
    return text;
}

}  // namespace

TEST_CASE("verify: no accelerator has a fault in the catalogue") {
    const VerifyReport report = run(of("", {}, 6000, 3));
    INFO(kinds(report));
    CHECK(report.faults() == 0);
    CHECK(report.rays == 6000);
    uint64_t hits = 0;
    for (const VerifyCase& c : report.cases) {
        CHECK(c.accelerators == accelerator_names());
        hits += c.tallies[0].hits;
    }
    CHECK(hits > 2000);
}

TEST_CASE("verify: recipes are chosen by name") {
    VerifyOptions options = of("catalogue:ball", {"bvh"}, 500, 4);
    options.recipes = {"vertex", "edge"};
    const VerifyReport report = run(options);
    REQUIRE(report.cases.size() == 2);
    CHECK(report.cases[1].recipe == "edge");
    CHECK(report.rays == 500);
    options.recipes = {"vertec"};
    CHECK_THROWS_AS(run(options), InputError);
}

TEST_CASE("verify: what was a fault once is none in any accelerator") {
    const std::string file = std::string(CROFTON_SOURCE_DIR) + "/tests/regressions/verify.jsonl";
    Progress quiet(true);
    const std::vector<FailingRay> rays = read_failing(file);
    CHECK(rays.size() >= 10);
    std::vector<FailingRay> all;
    for (const std::string& name : accelerator_names())
        for (FailingRay f : rays) {
            f.accelerator = name;
            all.push_back(f);
        }
    const VerifyReport report = replay(all, quiet);
    INFO(kinds(report));
    CHECK(report.faults() == 0);
}

TEST_CASE(
    "verify: the other modes have no fault in the catalogue either, and exact is never wrong") {
    for (const Mode mode : {Mode::double_precision, Mode::exact}) {
        VerifyOptions options = of("", {}, 3000, 8);
        options.mode = mode;
        const VerifyReport report = run(options);
        INFO(name_of(mode) << "\n" << kinds(report));
        CHECK(report.faults() == 0);
    }
    VerifyOptions options = of("catalogue:ball", {"bvh", "kdtree"}, 5000, 9);
    options.mode = Mode::exact;
    const VerifyReport report = run(options);
    for (const VerifyCase& c : report.cases)
        for (const VerifyTally& t : c.tallies) {
            CHECK(t.false_misses == VerifyTally::Split{});
            CHECK(t.false_hits == VerifyTally::Split{});
            CHECK(t.wrong_primitives == VerifyTally::Split{});
            CHECK(t.t_ulp.largest() == 0);
        }
}

TEST_CASE("verify: the same seed gives the same figures, with one thread and with two") {
    const VerifyOptions options = of("catalogue:ball", {}, 3000, 5);
    set_threads(1);
    const std::string one = verify_json(run(options));
    set_threads(2);
    const std::string two = verify_json(run(options));
    set_threads(0);
    CHECK(one == two);
    VerifyOptions other = options;
    other.seed = 6;
    CHECK(verify_json(run(other)) != one);
}

TEST_CASE("verify: unknown names are refused with the nearest valid one") {
    CHECK(error_of(of("", {"bvhh"})).find("did you mean 'bvh'") != std::string::npos);
    CHECK(error_of(of("catalogue:bal", {})).find("did you mean 'ball'") != std::string::npos);
    CHECK(error_of(of("procedural:stadum", {})).find("did you mean 'stadium'") !=
          std::string::npos);
    CHECK(error_of(of("/no/such.obj", {})).find("/no/such.obj") != std::string::npos);
}

TEST_CASE("verify: failing rays are written and read back bit for bit, and a leak is a fault") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    std::vector<FailingRay> rays(2);
    rays[0] = {"catalogue:ball", "vertex", "bvh", "leak", {{5, 5, 5}, 0, {0, 0, 1}}, true};
    rays[1] = {"catalogue:ball",
               "invalid",
               "bvh",
               "false hit",
               {{nan, -0.0f, 1e-45f}, 0, {0, 0, 1}},
               false};
    ScratchFile file("rays.jsonl", "");
    rays[0].mode = Mode::exact;
    write_failing(file.path(), rays);
    const std::vector<FailingRay> read = read_failing(file.path());
    REQUIRE(read.size() == 2);
    CHECK(std::isnan(read[1].ray.origin[0]));
    CHECK(std::signbit(read[1].ray.origin[1]));
    CHECK(read[1].ray.origin[2] == 1e-45f);
    CHECK(read[0].must_hit);
    CHECK(read[0].mode == Mode::exact);
    // The first ray misses the ball: said to come from its inside, it would be a leak.
    Progress quiet(true);
    const VerifyReport report = replay(file.path(), quiet);
    CHECK(report.rays == 2);
    CHECK(report.faults() == 2);  // in brute_force and in bvh
    CHECK(report.failing[0].kind == "leak");
}

TEST_CASE("verify: a line of a file that cannot be read is named") {
    ScratchFile file("rays.jsonl", "\n{\"scene\": \"catalogue:ball\"}\n");
    std::string message;
    try {
        read_failing(file.path());
    } catch (const InputError& error) {
        message = error.what();
    }
    CHECK(message.find("rays.jsonl:2: ") != std::string::npos);
    CHECK_THROWS_AS(read_failing("/no/such.jsonl"), InputError);
}

TEST_CASE("verify: quantiles of errors in t") {
    UlpCounts counts;
    CHECK(counts.quantile(0.5) == 0);
    for (int i = 0; i < 990; ++i) counts.add(0);
    for (int i = 0; i < 9; ++i) counts.add(3);
    counts.add(1000);
    CHECK(counts.quantile(0.5) == 0);
    CHECK(counts.quantile(0.99) == 0);
    CHECK(counts.quantile(0.999) == 3);
    CHECK(counts.quantile(1) == 1000);
    CHECK(counts.largest() == 1000);
}

TEST_CASE("verify: the minimiser leaves the triangles and digits that a failure takes") {
    FailingCase start{placed_triangles(catalogue_scene("ball")), {}};
    start.ray = {{0.123456f, 0.0432f, 9.87654f}, 0.001f, {0.0123f, 0.00321f, -1.2345f}, 100};
    const TriangleMesh all = start.mesh;
    // "Fails" while two given triangles are there and the ray goes down from above.
    const auto corners_of = [](const TriangleMesh& mesh, size_t i) {
        std::array<Vec3f, 3> v;
        for (size_t k = 0; k < 3; ++k) v[k] = mesh.positions[mesh.triangles[i][k]];
        return v;
    };
    const auto first = corners_of(all, 17), second = corners_of(all, 900);
    const auto fails = [&](const FailingCase& c) {
        bool a = false, b = false;
        for (size_t i = 0; i < c.mesh.triangles.size(); ++i) {
            a = a || corners_of(c.mesh, i) == first;
            b = b || corners_of(c.mesh, i) == second;
        }
        return a && b && c.ray.direction[2] < 0 && c.ray.origin[2] > 9;
    };
    REQUIRE(fails(start));
    const FailingCase small = minimise(start, fails);
    CHECK(fails(small));
    CHECK(small.mesh.triangles.size() == 2);
    CHECK(small.mesh.positions.size() <= 6);
    CHECK(small.ray.origin == Vec3f(0, 0, 10));
    CHECK(small.ray.direction == Vec3f(0, 0, -1));
    CHECK(small.ray.t_min == 0);
    CHECK(std::isinf(small.ray.t_max));
}

TEST_CASE("verify: placed triangles fail where the scene does, and a good ray has no fault") {
    const TriangleMesh mesh = placed_triangles(catalogue_scene("instances"));
    CHECK(mesh.triangles.size() == 6 * 80);
    CHECK(!has_fault({mesh, {{5, 0.1f, 0.2f}, 0, {-1, 0, 0}}}, "bvh"));
    const std::vector<FailingRay> rays{
        {"catalogue:instances", "axis", "bvh", "leak", {{5, 0.1f, 0.2f}, 0, {-1, 0, 0}}, false}};
    ScratchFile file("small.obj", "");
    CHECK(minimise_to_files(rays, file.path()).find("nothing to minimise") != std::string::npos);
}

}  // namespace crofton
