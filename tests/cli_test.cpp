#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "framework/ray.h"
#include "tests/catch.h"

namespace fs = std::filesystem;

namespace {

struct Outcome {
    int code;
    std::string out;  ///< stdout and stderr
};

/// Choices are made with nominal costs: no test measures the machine.
const bool nominal_costs = setenv("CROFTON_CALIBRATION", "nominal", 1) == 0;

Outcome run_crofton(const std::string& arguments) {
    REQUIRE(nominal_costs);
    const std::string command = std::string(CROFTON_BINARY) + " " + arguments + " 2>&1";
    FILE* pipe = popen(command.c_str(), "r");
    REQUIRE(pipe);
    std::string out;
    std::array<char, 4096> buffer;
    for (size_t n; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
        out.append(buffer.data(), n);
    const int status = pclose(pipe);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, out};
}

/// A folder that is removed at the end.
class Folder {
  public:
    Folder() : path_(fs::temp_directory_path() / ("crofton_cli_" + std::to_string(getpid()))) {
        fs::create_directories(path_);
    }
    ~Folder() { fs::remove_all(path_); }
    std::string file(const std::string& name, const std::string& text) const {
        std::ofstream(path_ / name) << text;
        return (path_ / name).string();
    }
    std::string path(const std::string& name) const { return (path_ / name).string(); }

  private:
    fs::path path_;
};

std::string read_text(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

const char* const small =
    "[scene]\nprocedural = \"stadium\"\n"
    "[accelerator.grid]\ntype = \"uniform_grid\"\n"
    "[[variant]]\nname = \"a\"\n[[variant]]\nname = \"b\"\ntop = \"bvh\"\ndefault = \"grid\"\n"
    "[[workload]]\ntype = \"random\"\nrays = 2000\n"
    "[[workload]]\ntype = \"ambient_occlusion\"\nrays = 2000\n"
    "[run]\nrepeats = 2\npicture_width = 64\npicture_height = 64\n";

}  // namespace

TEST_CASE("cli: help is there for every command and exits with 0") {
    for (const char* arguments :
         {"--help", "run --help", "inspect --help", "render --help", "build --help",
          "export --help", "list --help", "verify --help", "calibrate --help", "theorem --help"}) {
        const Outcome outcome = run_crofton(arguments);
        INFO(arguments);
        CHECK(outcome.code == 0);
        CHECK(outcome.out.size() > 50);
    }
    CHECK(run_crofton("--version").code == 0);
}

TEST_CASE("cli: bad input is one line on stderr and exits with 2") {
    Folder folder;
    const std::string bad = folder.file("bad.toml", "[scene]\nprocedural = \"stadum\"\n");
    const std::string no_file = folder.path("none.obj");
    for (const std::string& arguments :
         {std::string(""), std::string("rum"), std::string("run"), "run " + bad, "run " + no_file,
          "inspect " + no_file, std::string("inspect procedural:stadum"), "render " + no_file,
          std::string("render procedural:stadium --shade x"), std::string("list --jsn")}) {
        const Outcome outcome = run_crofton(arguments);
        INFO(arguments << " -> " << outcome.out);
        CHECK(outcome.code == 2);
        CHECK(outcome.out.find("crofton: error: ") == 0);
        CHECK(std::count(outcome.out.begin(), outcome.out.end(), '\n') == 1);
    }
    CHECK(run_crofton("run " + bad).out.find("bad.toml:2:14: ") != std::string::npos);
}

TEST_CASE("cli: list as JSON names accelerators with parameters, workloads and scenes") {
    const Outcome outcome = run_crofton("list --json");
    CHECK(outcome.code == 0);
    const auto json = nlohmann::json::parse(outcome.out);
    std::vector<std::string> names;
    for (const auto& accelerator : json.at("accelerators")) {
        names.push_back(accelerator.at("name"));
        CHECK(!accelerator.at("source").get<std::string>().empty());
        for (const auto& parameter : accelerator.at("parameters")) {
            CHECK(parameter.contains("default"));
            CHECK(!parameter.at("description").get<std::string>().empty());
        }
    }
    for (const char* name : {"brute_force", "uniform_grid", "bvh"})
        CHECK(std::count(names.begin(), names.end(), name) == 1);
    CHECK(json.at("workloads").size() == 8);
    CHECK(json.at("scenes").size() >= 1);
    const Outcome text = run_crofton("list");
    CHECK(text.code == 0);
    // What every accelerator can do is said once, not at each.
    for (const std::string line : {"      lazy = false", "      lazy_size = 1024"}) {
        const size_t first = text.out.find(line);
        REQUIRE(first != std::string::npos);
        CHECK(text.out.find(line, first + 1) == std::string::npos);
    }
}

TEST_CASE("cli: inspect as JSON has the keys of the manifests") {
    Folder folder;
    const std::string obj = folder.file("t.obj", "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n");
    const auto json = nlohmann::json::parse(run_crofton("inspect --json " + obj).out);
    CHECK(json.at("triangles_unique") == 1);
    CHECK(json.at("triangles_instanced") == 1);
    CHECK(json.at("mesh_instances") == 1);
    CHECK(json.at("depth") == 1);
    CHECK(json.at("bounds_min") == nlohmann::json({0.0, 0.0, 0.0}));
    CHECK(json.at("bounds_max") == nlohmann::json({1.0, 2.0, 0.0}));
    CHECK(json.at("zero_area_triangles_object_space") == 0);
    CHECK(json.at("mirrored_instances") == 0);
    CHECK(run_crofton("inspect procedural:stadium --accelerator bvh").code == 0);
}

TEST_CASE("cli: a run leaves rows, manifest, resolved config and pictures") {
    Folder folder;
    const std::string out = folder.path("out"), hits = folder.path("hits.bin");
    const Outcome outcome = run_crofton("run " + folder.file("small.toml", small) + " --out " +
                                        out + " --hits " + hits + " --set run.repeats=3");
    INFO(outcome.out);
    REQUIRE(outcome.code == 0);
    std::ifstream rows(out + "/rows.jsonl");
    std::vector<nlohmann::json> parsed;
    for (std::string line; std::getline(rows, line);) parsed.push_back(nlohmann::json::parse(line));
    REQUIRE(parsed.size() == 4);
    for (const auto& row : parsed) {
        for (const char* key : {"scene",
                                "variant",
                                "accelerator",
                                "workload",
                                "query",
                                "rays",
                                "hits",
                                "triangles",
                                "instances",
                                "build_s",
                                "bytes",
                                "ns_per_ray",
                                "ns_per_ray_low",
                                "ns_per_ray_high",
                                "repeats",
                                "threads",
                                "isa",
                                "N_IN",
                                "N_V",
                                "N_EV",
                                "N_OIV",
                                "N_IT",
                                "N_TS",
                                "N_ETS",
                                "N_EETS",
                                "key",
                                "host",
                                "sweep",
                                "hits_checksum"})
            CHECK(row.contains(key));
        CHECK(row.at("rays") == 2000);
        CHECK(row.at("repeats") == 3);
        CHECK(row.at("mismatches") == 0);
    }
    CHECK(parsed[0].at("hits_checksum") == parsed[1].at("hits_checksum"));
    CHECK(parsed[2].at("query") == "any");
    const auto manifest = nlohmann::json::parse(read_text(out + "/manifest.json"));
    for (const char* key : {"revision", "dirty", "compiler", "flags", "cpu", "isa", "cores",
                            "load_average", "packages", "seeds", "inputs", "crofton", "date"})
        CHECK(manifest.contains(key));
    for (const char* name : {"normal-stadium.png", "cost-stadium-a.png", "cost-stadium-b.png"})
        CHECK(read_text(out + "/" + name).substr(1, 3) == "PNG");
    CHECK(run_crofton("run " + out + "/resolved.toml --set run.pictures=false --out " +
                      folder.path("again"))
              .code == 0);
}

TEST_CASE("cli: a file of hits has 24 bytes a ray, and misses are marked") {
    Folder folder;
    const std::string obj = folder.file("t.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    crofton::Ray rays[2];
    rays[0].origin = {0.25f, 0.25f, 1};
    rays[0].direction = {0, 0, -1};
    rays[1].origin = {0.25f, 0.25f, 1};
    std::ofstream(folder.path("rays.bin"), std::ios::binary)
        .write(reinterpret_cast<const char*>(rays), sizeof rays);
    const std::string config = folder.file(
        "c.toml",
        "[scene]\nfile = \"t.obj\"\n[[workload]]\ntype = \"file\"\nfile = \"rays.bin\"\n"
        "[run]\nrepeats = 1\npictures = false\n");
    const std::string hits = folder.path("hits.bin");
    const Outcome outcome =
        run_crofton("run " + config + " --out " + folder.path("out") + " --hits " + hits);
    INFO(outcome.out);
    REQUIRE(outcome.code == 0);
    const std::string bytes = read_text(hits);
    REQUIRE(bytes.size() == 48);
    crofton::Hit read[2];
    std::memcpy(static_cast<void*>(read), bytes.data(), sizeof read);
    CHECK(read[0].t == 1);
    CHECK(read[0].u == Approx(0.25f));
    CHECK(read[0].v == Approx(0.25f));
    CHECK(read[0].primitive == 0);
    CHECK(read[0].instance == 0);
    CHECK(read[1].primitive == crofton::no_id);
    CHECK(read[1].geometry == crofton::no_id);
    CHECK(read[1].instance == crofton::no_id);
    std::ofstream(folder.path("rays.bin"), std::ios::binary | std::ios::app) << "x";
    CHECK(run_crofton("run " + config + " --out " + folder.path("out")).code == 2);
}

TEST_CASE("cli: verify exits with 0, with 1 on a fault, with 2 on bad input") {
    Folder folder;
    const std::string failures = " --failures " + folder.path("failures.jsonl");
    const Outcome good = run_crofton(
        "verify catalogue:fan_17 --accelerators bvh,kdtree --rays 300 --quiet --json" + failures);
    INFO(good.out);
    REQUIRE(good.code == 0);
    const auto json = nlohmann::json::parse(good.out);
    CHECK(json.at("rays") == 300);
    for (const char* name : {"bvh", "kdtree"}) {
        const auto& totals = json.at("accelerators").at(name);
        CHECK(totals.at("rays") == 300);
        CHECK(totals.at("leaks") == 0);
        for (const char* key : {"false_misses", "false_hits", "wrong_primitives"})
            CHECK(totals.at(key).at("outside") == 0);
    }
    CHECK(!fs::exists(folder.path("failures.jsonl")));
    CHECK(run_crofton("verify procedural:stadium --rays 200 --quiet" + failures).code == 0);
    // A ray that misses, said to come from inside of a closed ball.
    const std::string file = folder.file(
        "rays.jsonl",
        "{\"scene\":\"catalogue:ball\",\"recipe\":\"vertex\",\"accelerator\":\"bvh\",\"kind\":"
        "\"leak\",\"must_hit\":true,\"ray\":[\"40a00000\",\"40a00000\",\"40a00000\","
        "\"00000000\",\"00000000\",\"00000000\",\"3f800000\",\"7f800000\"]}\n");
    const Outcome leak = run_crofton("verify --quiet --replay " + file);
    CHECK(leak.code == 1);
    CHECK(leak.out.find("verify --replay " + file) != std::string::npos);
    CHECK(run_crofton("verify --accelerators bvhh").out.find("did you mean 'bvh'") !=
          std::string::npos);
    for (const char* bad : {"verify catalogue:bal", "verify --accelerators bvhh", "verify --rays 0",
                            "verify --replay /no/such.jsonl"})
        CHECK(run_crofton(bad).code == 2);
}

TEST_CASE("cli: render writes pictures by normal and by cost") {
    Folder folder;
    for (const std::string shade : {"normal", "cost"}) {
        const std::string png = folder.path(shade + ".png");
        const Outcome outcome = run_crofton(
            "render procedural:stadium -o " + png + " --width 64 --height 48 --shade " + shade +
            " --set scene.parameters.rows=5 --set max_leaf_size=2 --eye=-3,1,2 --at 0,0,0");
        INFO(outcome.out);
        CHECK(outcome.code == 0);
        CHECK(read_text(png).substr(1, 3) == "PNG");
    }
    CHECK(
        run_crofton("render procedural:stadium --set no_such=1 -o " + folder.path("x.png")).code ==
        2);
}

TEST_CASE("cli: a built structure is saved, and drawn again without a build for its scene only") {
    Folder folder;
    const std::string saved = folder.path("stadium.crofton"), size = " --width 64 --height 48 -o ";
    const std::string built_png = folder.path("built.png"), loaded_png = folder.path("loaded.png");
    REQUIRE(run_crofton("build procedural:stadium --accelerator kdtree -o " + saved).code == 0);
    CHECK(run_crofton("render procedural:stadium --accelerator kdtree" + size + built_png).code ==
          0);
    CHECK(run_crofton("render procedural:stadium --structure " + saved + size + loaded_png).code ==
          0);
    CHECK(read_text(built_png) == read_text(loaded_png));

    const Outcome other = run_crofton("render procedural:stadium --set scene.parameters.size=50" +
                                      (" --structure " + saved + size + loaded_png));
    CHECK(other.code == 2);
    CHECK(other.out.find("was saved for another scene") != std::string::npos);
    std::string text = read_text(saved);
    text[text.size() / 2] ^= 1;
    const std::string damaged = folder.file("damaged.crofton", text);
    const Outcome refused =
        run_crofton("export procedural:stadium --structure " + damaged + " -o " + loaded_png);
    CHECK(refused.code == 2);
    CHECK(refused.out == "crofton: error: " + damaged + ": damaged: the checksum differs\n");
}

TEST_CASE("cli: export writes the boxes of every structure as lines that a glTF reader accepts") {
    Folder folder;
    const std::string glb = folder.path("boxes.glb");
    for (const std::string& options :
         {std::string("--accelerator octree"), std::string("--accelerator uniform_grid --empty"),
          std::string("--accelerator kdtree --depth 3")}) {
        INFO(options);
        const Outcome outcome = run_crofton("export procedural:stadium " + options + " -o " + glb);
        CHECK(outcome.code == 0);
        CHECK(outcome.out.find(" boxes in ") != std::string::npos);
        const auto json = nlohmann::json::parse(run_crofton("inspect --json " + glb).out);
        CHECK(json.at("mesh_instances") >= 1);
        CHECK(json.at("triangles_unique") == 0);
    }
}

TEST_CASE("cli: a cloud of points is inspected, rendered and run like any scene") {
    Folder folder;
    std::string text =
        "ply\nformat ascii 1.0\nelement vertex 441\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n";
    for (int i = 0; i < 441; ++i)
        text += std::to_string(i % 21 * 0.1) + " " + std::to_string(i / 21 * 0.1) + " 0\n";
    const std::string ply = folder.file("cloud.ply", text);
    const auto json =
        nlohmann::json::parse(run_crofton("inspect --json --accelerator bvh " + ply).out);
    CHECK(json.at("shapes_unique") == 441);
    CHECK(json.at("nodes_assigned").at(0).at("shapes") == 441);
    const std::string png = folder.path("cloud.png");
    CHECK(run_crofton("render " + ply +
                      " --accelerator sphere_hierarchy --set lod=2 --width 64 "
                      "--height 64 -o " +
                      png)
              .code == 0);
    CHECK(read_text(png).substr(1, 3) == "PNG");
    const Outcome outcome = run_crofton(
        "run " +
        folder.file("c.toml",
                    "[scene]\nfile = \"cloud.ply\"\n[camera]\neye = [1, 1, 5]\nat = [1, 1, 0]\n"
                    "fov = 25\n[[variant]]\nname = \"a\"\n"
                    "[[variant]]\nname = \"b\"\ndefault = \"kdtree\"\n"
                    "[run]\nrepeats = 1\npictures = false\n") +
        " --out " + folder.path("out"));
    INFO(outcome.out);
    CHECK(outcome.code == 0);
    // The camera sees nothing but the cloud, whose splats leave no holes between them.
    std::ifstream rows(folder.path("out") + "/rows.jsonl");
    std::string line;
    REQUIRE(std::getline(rows, line));
    CHECK(nlohmann::json::parse(line).at("hits").get<double>() > 0.6 * 250000);
}

TEST_CASE("cli: variants that end rays early report a depth error and fail no check") {
    Folder folder;
    const std::string config =
        folder.file("c.toml",
                    "[scene]\nprocedural = \"terrain\"\nparameters = { n = 64 }\n"
                    "[accelerator.coarse]\ntype = \"sphere_hierarchy\"\nlod = 8\n"
                    "[accelerator.exact]\ntype = \"sphere_hierarchy\"\n"
                    "[[variant]]\nname = \"coarse\"\ndefault = \"coarse\"\n"
                    "[[variant]]\nname = \"exact\"\ndefault = \"exact\"\n"
                    "[[variant]]\nname = \"bvh\"\n"
                    "[[workload]]\ntype = \"primary\"\nwidth = 64\nheight = 48\n"
                    "[[workload]]\ntype = \"ambient_occlusion\"\nrays = 1000\n"
                    "[run]\nrepeats = 1\npicture_width = 64\npicture_height = 64\n");
    for (const std::string only : {"", " --set variant.exact.default=coarse"}) {
        const std::string out = folder.path("out");
        const Outcome outcome = run_crofton("run " + config + " --out " + out + only);
        INFO(outcome.out);
        REQUIRE(outcome.code == 0);
        CHECK(outcome.out.find("coarse: ends rays early; t is off by ") != std::string::npos);
        CHECK(outcome.out.find("all exact variants' hits agree") != std::string::npos);
        std::ifstream rows(out + "/rows.jsonl");
        std::vector<nlohmann::json> parsed;
        for (std::string line; std::getline(rows, line);)
            parsed.push_back(nlohmann::json::parse(line));
        REQUIRE(parsed.size() == 6);
        const auto& coarse = parsed[0].at("depth_error");
        CHECK(coarse.at("rms") > 0);
        CHECK(coarse.at("max") >= coarse.at("rms"));
        CHECK(coarse.contains("hit_or_miss"));
        CHECK(parsed[0].at("mismatches") == 0);
        CHECK(parsed[1].at("depth_error").is_null() == only.empty());
        CHECK(parsed[2].at("depth_error").is_null());
        CHECK(read_text(out + "/normal-terrain-coarse.png").substr(1, 3) == "PNG");
    }
}

TEST_CASE("cli: auto explains itself, and refuses what it cannot do with one line") {
    const std::string scene = "procedural:terrain --set scene.parameters.n=32";
    const Outcome few = run_crofton("inspect " + scene + " --explain --set objective.rays=10");
    CHECK(few.code == 0);
    CHECK(few.out.find("Chosen for 10 rays") != std::string::npos);
    CHECK(few.out.find("wide_bvh") != std::string::npos);
    CHECK(few.out.find("kdtree") == std::string::npos);  // too dear to look at for ten rays
    const Outcome many =
        run_crofton("inspect " + scene + " --explain --set objective.rays=1000000");
    CHECK(many.code == 0);
    CHECK(many.out.find("kdtree") != std::string::npos);
    const Outcome tight = run_crofton("inspect " + scene + " --explain --set objective.memory=10");
    CHECK(tight.code == 2);
    CHECK(tight.out.find("10 bytes") != std::string::npos);
    CHECK(std::count(tight.out.begin(), tight.out.end(), '\n') == 1);
    for (const char* bad : {"objective.ray=1", "objective.rays=0", "objective.priority=speed",
                            "objective.memory=-1", "objective.clock=3"}) {
        INFO(bad);
        const Outcome outcome =
            run_crofton("inspect " + scene + " --explain --set " + std::string(bad));
        CHECK(outcome.code == 2);
        CHECK(std::count(outcome.out.begin(), outcome.out.end(), '\n') == 1);
    }
}

TEST_CASE("cli: a run with budgets has a row for each, with what auto took and expected") {
    const Folder folder;
    const std::string config =
        folder.file("budgets.toml",
                    "[scene]\nprocedural = \"terrain\"\nparameters = { n = 32 }\n"
                    "[[variant]]\nname = \"auto\"\ntop = \"auto\"\ndefault = \"auto\"\n"
                    "[[variant]]\nname = \"bvh\"\ntop = \"bvh\"\nflatten = true\n"
                    "[[workload]]\ntype = \"random\"\nrays = 2000\n"
                    "[run]\nrepeats = 2\npictures = false\nbudgets = [1e3, 1e6]\npredict = true\n");
    const std::string out = folder.path("out");
    const Outcome outcome = run_crofton("run " + config + " --quiet --out " + out);
    INFO(outcome.out);
    REQUIRE(outcome.code == 0);
    std::ifstream rows(out + "/rows.jsonl");
    int automatic = 0, fixed = 0;
    for (std::string line; std::getline(rows, line);) {
        const auto row = nlohmann::json::parse(line);
        if (!row.contains("budget_rays")) continue;
        const double total = row["total_s"], choose = row["choose_s"];
        CHECK(total >= choose);
        CHECK(double(row["predicted_ns_per_ray"]) > 0);
        CHECK(double(row["predicted_bytes"]) > 0);
        CHECK(double(row["expected_ns_per_ray"]) > 0);
        ++(row["variant"] == "auto" ? automatic : fixed);
    }
    CHECK(automatic == 2);
    CHECK(fixed == 2);
    CHECK(outcome.out.find("Total time") != std::string::npos);
    CHECK(outcome.out.find("Predicted against measured") != std::string::npos);
}

TEST_CASE("cli: a config without accelerators is auto") {
    const Folder folder;
    const std::string config =
        folder.file("nothing.toml",
                    "[scene]\nprocedural = \"terrain\"\nparameters = { n = 16 }\n"
                    "[[workload]]\ntype = \"random\"\nrays = 500\n"
                    "[run]\nrepeats = 2\npicture_width = 64\npicture_height = 64\n");
    const Outcome outcome = run_crofton("run " + config + " --quiet --out " + folder.path("out"));
    INFO(outcome.out);
    CHECK(outcome.code == 0);
    CHECK(outcome.out.find("Chosen for 500 rays") != std::string::npos);
}

TEST_CASE("cli: Crofton's theorem is shown as a table") {
    const Outcome outcome = run_crofton("theorem procedural:tetra --lines 4000");
    CHECK(outcome.code == 0);
    CHECK(outcome.out.find("boxes met") != std::string::npos);
    CHECK(run_crofton("theorem procedural:tetra --lines 1").code == 2);
}
