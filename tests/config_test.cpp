#include "framework/config.h"

#include <filesystem>
#include <fstream>

#include "experiments/experiment.h"
#include "experiments/peers.h"
#include "experiments/sweep.h"
#include "framework/error.h"
#include "tests/catch.h"

using namespace crofton;

namespace {

const std::string scene = "[scene]\nprocedural = \"stadium\"\n";

/// Text of the error that a config causes, "" for none.
std::string error_of(const std::string& text, const std::vector<std::string>& settings = {}) {
    try {
        make_experiments(parse_config(text, "test.toml"), "test", "", settings);
    } catch (const InputError& error) {
        return error.what();
    }
    return "";
}

ExperimentFile read(const std::string& text, const std::vector<std::string>& settings = {}) {
    return make_experiments(parse_config(text, "test.toml"), "test", "", settings);
}

int64_t leaf_size(const Variant& variant) {
    return std::get<int64_t>(variant.plan.top->parameters.at("max_leaf_size"));
}

const std::string tree = scene +
                         "[accelerator.fine]\ntype = \"bvh\"\nmax_leaf_size = 2\n"
                         "[assign]\ntop = \"fine\"\n";

}  // namespace

TEST_CASE("config: an unknown key is refused with its place and the nearest valid key") {
    CHECK(error_of(scene + "[run]\nrepeat = 3\n") ==
          "test.toml:4:1: unknown key 'repeat'; did you mean 'repeats'?");
    CHECK(error_of(scene + "[accelerator.fine]\ntype = \"bvh\"\n  max_leaf_sise = 3\n") ==
          "test.toml:5:3: unknown key 'max_leaf_sise'; did you mean 'max_leaf_size'?");
    CHECK(error_of(scene + "[wrokload]\n").find("test.toml:3:") == 0);
    CHECK(error_of(scene + "[[workload]]\ntype = \"random\"\nwidth = 3\n")
              .find("test.toml:5:1: unknown key 'width'") == 0);
}

TEST_CASE("config: an unknown accelerator is refused with its place and the nearest name") {
    CHECK(error_of(scene + "[assign]\ntop = \"bhv\"\n") ==
          "test.toml:4:7: unknown accelerator 'bhv'; did you mean 'bvh'?");
    CHECK(error_of(scene + "[accelerator.fine]\ntype = \"uniform_gird\"\n") ==
          "test.toml:4:8: unknown accelerator 'uniform_gird'; did you mean 'uniform_grid'?");
    CHECK(error_of(tree + "[[variant]]\nname = \"a\"\ntop = \"fin\"\n") ==
          "test.toml:10:7: unknown accelerator 'fin'; did you mean 'fine'?");
}

TEST_CASE("config: a wrong type is refused with what was expected and found") {
    CHECK(error_of(scene + "[run]\nrepeats = \"many\"\n") ==
          "test.toml:4:11: repeats: expected an integer, found a string");
    CHECK(error_of(scene + "[run]\npin = 1\n") ==
          "test.toml:4:7: pin: expected a boolean, found an integer");
    CHECK(error_of("scene = 3\n") == "test.toml:1:9: scene: expected a table, found an integer");
    const std::string parameter =
        error_of(scene + "[accelerator.fine]\ntype = \"bvh\"\nmax_leaf_size = \"x\"\n");
    CHECK(parameter.find("test.toml:5:17: ") == 0);
    CHECK(parameter.find("expected an integer, found a string") != std::string::npos);
}

TEST_CASE("config: a choice among numbers may be written as a number") {
    const std::string wide = scene + "[accelerator.fine]\ntype = \"wide_bvh\"\nwidth = ";
    CHECK(error_of(wide + "8\n") == "");
    CHECK(error_of(wide + "\"8\"\n") == "");
    CHECK(error_of(wide + "5\n").find("test.toml:5:9: width: unknown value '5'") == 0);
}

TEST_CASE("config: a value out of range is refused") {
    CHECK(error_of(scene + "[run]\nrepeats = 0\n") ==
          "test.toml:4:11: repeats: 0 is outside 1 … 10000");
    CHECK(error_of(scene + "[accelerator.fine]\ntype = \"bvh\"\nmax_leaf_size = 100000\n")
              .find("test.toml:5:17: ") == 0);
}

TEST_CASE("config: a syntax error has its place") {
    CHECK(error_of("[scene\n").find("test.toml:1:") == 0);
}

TEST_CASE("config: accelerators that are inside one another are refused") {
    const std::string text = scene +
                             "[accelerator.a]\ntype = \"bvh\"\ninside = \"b\"\n"
                             "[accelerator.b]\ntype = \"uniform_grid\"\ninside = \"a\"\n";
    const std::string error = error_of(text);
    CHECK(error.find("test.toml:") == 0);
    CHECK(error.find("a → b → a") != std::string::npos);
    CHECK(error_of(scene + "[accelerator.a]\ntype = \"bvh\"\ninside = \"a\"\n").find("a → a") !=
          std::string::npos);
}

TEST_CASE("config: nesting by name reaches the plan") {
    const ExperimentFile file = read(scene +
                                     "[accelerator.a]\ntype = \"bvh\"\ninside = \"b\"\n"
                                     "[accelerator.b]\ntype = \"uniform_grid\"\n"
                                     "[assign]\ntop = \"a\"\n");
    const AssemblyPlan& plan = file.experiments.at(0).variants.at(0).plan;
    CHECK(plan.top->type == "bvh");
    REQUIRE(plan.top->inside);
    CHECK(plan.top->inside->label == "b");
    CHECK(plan.top->inside->type == "uniform_grid");
}

TEST_CASE("config: whether objects are baked reaches the plan, and tells variants apart") {
    const ExperimentFile file = read(scene +
                                     "[assign]\nbake = false\n[[variant]]\nname = \"a\"\n"
                                     "[[variant]]\nname = \"b\"\nbake = true\n");
    const std::vector<Variant>& variants = file.experiments.at(0).variants;
    CHECK_FALSE(variants.at(0).plan.bake);
    CHECK(variants.at(1).plan.bake);
    CHECK(variants.at(0).canonical != variants.at(1).canonical);
    CHECK(read(scene).experiments.at(0).variants.at(0).plan.bake);
}

TEST_CASE("config: opening reaches the plan, is checked, and tells variants apart") {
    const ExperimentFile file = read(scene +
                                     "[assign]\nopening = 2\n[[variant]]\nname = \"a\"\n"
                                     "[[variant]]\nname = \"b\"\nopening = 3.5\n");
    const std::vector<Variant>& variants = file.experiments.at(0).variants;
    CHECK(variants.at(0).plan.opening == 2);
    CHECK(variants.at(1).plan.opening == 3.5);
    CHECK(variants.at(0).canonical != variants.at(1).canonical);
    CHECK(to_toml_document(read(scene).resolved).find("opening = 0") != std::string::npos);
    CHECK(error_of(scene + "[assign]\nopening = -1\n").find("test.toml:4:11: opening: -1") == 0);
    CHECK(error_of(scene + "[assign]\nopenin = 2\n").find("did you mean 'opening'?") !=
          std::string::npos);
}

TEST_CASE("config: a rule that matches no node is refused with its place") {
    const ExperimentFile file =
        read(scene + "[[assign.node]]\nmatch = \"no_such_node\"\naccelerator = \"bvh\"\n");
    const Experiment& experiment = file.experiments.at(0);
    const Scene made = make_scene(experiment.scene);
    CHECK_THROWS_WITH(
        assemble(made, experiment.variants.at(0).plan),
        Catch::Matchers::Contains("test.toml:4:9") && Catch::Matchers::Contains("no_such_node"));
}

TEST_CASE("config: --set replaces a value, and is checked as if it stood in the file") {
    CHECK(read(tree, {"run.repeats=11"}).experiments.at(0).run.repeats == 11);
    CHECK(leaf_size(
              read(tree, {"accelerator.fine.max_leaf_size=5"}).experiments.at(0).variants.at(0)) ==
          5);
    const auto file =
        read(tree + "[[variant]]\nname = \"flat\"\n", {"variant.flat.top=uniform_grid"});
    CHECK(file.experiments.at(0).variants.at(0).plan.top->type == "uniform_grid");
    CHECK(error_of(tree, {"run.repeats=many"}) ==
          "--set run.repeats=many: repeats: expected an integer, found a string");
    CHECK(error_of(tree, {"run.repeat=3"}) ==
          "--set run.repeat=3: unknown key 'repeat'; did you mean 'repeats'?");
    CHECK(error_of(tree, {"accelerator.fin.max_leaf_size=3"}) ==
          "--set accelerator.fin.max_leaf_size=3: unknown accelerator 'fin'; did you mean 'fine'?");
    CHECK(error_of(tree, {"acelerator.fine.max_leaf_size=3"}).find("did you mean 'accelerator'?") !=
          std::string::npos);
    CHECK(error_of(tree, {"run.repeats"}).find("expected path=value") != std::string::npos);
    CHECK(error_of(tree, {"run.repeats=[1"}).find("not a value") != std::string::npos);
}

TEST_CASE("config: a grid sweep makes all combinations, the last key fastest") {
    const auto points =
        expand_sweep(parse_config(tree + "[sweep]\n\"accelerator.fine.max_leaf_size\" = [1, 2, 4]\n"
                                         "run.repeats = [3, 5]\n",
                                  "test.toml"),
                     config_sections());
    REQUIRE(points.size() == 6);
    CHECK(points[1].values[0].second.integer == 1);
    CHECK(points[1].values[1].second.integer == 5);
    CHECK(points[5].config.find("accelerator")->find("fine")->find("max_leaf_size")->integer == 4);
}

TEST_CASE("config: a zip sweep advances its keys together") {
    const std::string sweep = "[sweep.zip]\n\"accelerator.fine.max_leaf_size\" = [1, 2]\n";
    const auto points = expand_sweep(
        parse_config(tree + sweep + "\"run.repeats\" = [7, 9]\n", "test.toml"), config_sections());
    REQUIRE(points.size() == 2);
    CHECK(points[1].config.find("run")->find("repeats")->integer == 9);
    CHECK(error_of(tree + sweep + "\"run.repeats\" = [7, 9, 11]\n").find("sweep.zip") !=
          std::string::npos);
}

TEST_CASE("config: swept variants of one scene are run together, and equal ones once") {
    const ExperimentFile file = read(tree +
                                     "[[variant]]\nname = \"fine\"\n"
                                     "[[variant]]\nname = \"grid\"\ntop = \"uniform_grid\"\n"
                                     "default = \"uniform_grid\"\n"
                                     "[sweep]\n\"accelerator.fine.max_leaf_size\" = [1, 2, 4]\n");
    REQUIRE(file.experiments.size() == 1);
    const std::vector<Variant>& variants = file.experiments[0].variants;
    REQUIRE(variants.size() == 4);
    CHECK(variants[0].name == "fine[max_leaf_size=1]");
    CHECK(variants[1].name == "grid");
    CHECK(leaf_size(variants[3]) == 4);
    CHECK(read(tree + "[sweep]\n\"run.repeats\" = [1, 2]\n").experiments.size() == 2);
}

TEST_CASE("config: a sweep over a path that does not exist is refused with its place") {
    CHECK(error_of(tree + "[sweep]\n\"accelerator.fime.max_leaf_size\" = [1]\n")
              .find("unknown accelerator 'fime'; did you mean 'fine'?") != std::string::npos);
    CHECK(
        error_of(tree + "[sweep]\n\"accelerator.fine.leaf_sizes\" = [1]\n").find("test.toml:9:") ==
        0);
    CHECK(error_of(tree + "[sweep]\n\"run.repeats\" = 3\n").find("expected an array") !=
          std::string::npos);
}

TEST_CASE("config: the resolved config reads back as the same config") {
    const ExperimentFile file = read(tree +
                                     "[[variant]]\nname = \"a\"\n[[variant]]\nname = \"b\"\n"
                                     "flatten = true\n[[workload]]\ntype = \"random\"\n");
    const std::string text = to_toml_document(file.resolved);
    const ExperimentFile again =
        make_experiments(parse_config(text, "resolved.toml"), "test", "", {});
    CHECK(to_toml_document(again.resolved) == text);
    CHECK(again.experiments.at(0).variants.at(1).canonical ==
          file.experiments.at(0).variants.at(1).canonical);
}

TEST_CASE("config: a mode is that of the run, unless a variant has its own") {
    const std::string two =
        "[[variant]]\nname = \"a\"\n[[variant]]\nname = \"b\"\nmode = \"exact\"\n";
    const auto modes = [](const ExperimentFile& file) {
        std::vector<Mode> list;
        for (const Variant& v : file.experiments.at(0).variants) list.push_back(v.mode.value());
        return list;
    };
    using List = std::vector<Mode>;
    CHECK(modes(read(scene + two)) == List{Mode::robust, Mode::exact});
    CHECK(modes(read(scene + two + "[run]\nmode = \"double\"\n")) ==
          List{Mode::double_precision, Mode::exact});
    CHECK(error_of(scene + "[run]\nmode = \"robus\"\n").find("did you mean 'robust'") !=
          std::string::npos);
    CHECK(error_of(scene + "[[variant]]\nname = \"a\"\nmode = \"exakt\"\n")
              .find("did you mean 'exact'") != std::string::npos);
    CHECK(error_of(scene + "[run]\nplot = true\n").find("needs 'oracle'") != std::string::npos);
    CHECK(read(scene + "[run]\nbuilds = 3\n").experiments.at(0).run.builds == 3);
    CHECK(error_of(scene + "[run]\nbuilds = 0\n").find("builds") != std::string::npos);
}

TEST_CASE("config: a peer is known by name, and told from our structures") {
    register_peers();
    const ExperimentFile file = read(scene +
                                     "[accelerator.other]\ntype = \"embree\"\nrobust = true\n"
                                     "[[variant]]\nname = \"a\"\ntop = \"other\"\nflatten = true\n"
                                     "[[variant]]\nname = \"b\"\nflatten = true\n");
    CHECK(file.experiments.at(0).variants.at(0).peer);
    CHECK_FALSE(file.experiments.at(0).variants.at(1).peer);
    CHECK(file.experiments.at(0).variants.at(1).available);
}

TEST_CASE("config: variants of one structure, by spans and by single calls, are two") {
    const ExperimentFile file = read(scene +
                                     "[[variant]]\nname = \"spans\"\n"
                                     "[[variant]]\nname = \"calls\"\nsingle = true\n");
    REQUIRE(file.experiments.at(0).variants.size() == 2);
    CHECK_FALSE(file.experiments.at(0).variants.at(0).single);
    CHECK(file.experiments.at(0).variants.at(1).single);
}

TEST_CASE("config: a scene file that does not exist is refused with what was tried") {
    CHECK(error_of("[scene]\nfile = [\"no1.obj\", \"no2.obj\"]\n")
              .find("test.toml:2:8: file: 'no1.obj', 'no2.obj': none exists") == 0);
    CHECK(error_of("[run]\n").find("scene: needs") != std::string::npos);
}

TEST_CASE("config: the configs that ship are valid") {
    register_peers();
    const std::string folder = std::string(CROFTON_SOURCE_DIR) + "/experiments/configs";
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
        INFO(entry.path().string());
        try {
            const ExperimentFile file = load_experiments(entry.path().string(), {});
            CHECK_FALSE(file.experiments.empty());
        } catch (const InputError& e) {
            // Some experiments are about scenes that lie beside the repository, not in it.
            const bool shared = std::filesystem::exists(CROFTON_SOURCE_DIR "/../shared");
            const std::string what = e.what();
            if (!shared && what.find("/shared/scenes/") != std::string::npos)
                WARN("skipped: ../shared is absent");
            else
                FAIL_CHECK(what);
        }
    }
}
