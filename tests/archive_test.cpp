// Saved structures: what is loaded gives the same bits, and what is not whole is refused.

#include "framework/archive.h"

#include <cstdio>
#include <fstream>
#include <iterator>

#include "accelerators/opening.h"
#include "framework/error.h"
#include "framework/instance.h"
#include "framework/object_set.h"
#include "framework/registry.h"
#include "framework/triangle_set.h"
#include "tests/catch.h"
#include "tests/hard_scenes.h"
#include "tests/scratch_file.h"

namespace crofton {
namespace {

std::string bytes_of(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

void write_bytes(const std::string& path, const std::string& bytes) {
    std::ofstream(path, std::ios::binary).write(bytes.data(), std::streamsize(bytes.size()));
}

std::string refusal(const std::string& path) {
    try {
        load_structure(path);
    } catch (const InputError& e) {
        return e.what();
    }
    return "accepted";
}

/// One mesh placed three times, twice in a group of its own.
std::shared_ptr<const Primitive> nested(const AcceleratorInfo& info) {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(2, p, t);
    const std::shared_ptr<const Primitive> ball =
        info.build(std::make_shared<const TriangleSet>(p, t), {});
    const auto placed = [](std::shared_ptr<const Primitive> object, const Vec3d& at) {
        return std::make_shared<const Instance>(std::move(object), translation(at));
    };
    const std::shared_ptr<const Primitive> pair =
        info.build(std::make_shared<const ObjectSet>(std::vector<ObjectSet::Object>{
                       {placed(ball, {2, 0, 0}), 0}, {placed(ball, {-2, 0.5, 0}), 1}}),
                   {});
    return info.build(std::make_shared<const ObjectSet>(std::vector<ObjectSet::Object>{
                          {placed(pair, {0, 3, 0}), 0}, {placed(ball, {0, -3, 1}), 2}, {ball, 3}}),
                      {});
}

}  // namespace

TEST_CASE("every structure over every set is loaded as it was saved") {
    const ScratchFile file("structure", "");
    for (const test::HardScene& scene : test::hard_scenes())
        for (const auto& [name, info] : accelerators()) {
            INFO(name << " over " << scene.name);
            const auto saved = info.build(scene.set, {});
            save_structure(*saved, file.path());
            const auto loaded = load_structure(file.path()).root;
            CHECK(loaded->type_name() == saved->type_name());
            if (info.load) CHECK(loaded->type_name() == name);
            CHECK(loaded->bounds() == saved->bounds());
            CHECK(loaded->expected_cost() == saved->expected_cost());
            CHECK(loaded->statistics().N_OIV == saved->statistics().N_OIV);
            CHECK(test::different_hits(*saved, *loaded, scene.rays) == 0);
        }
}

TEST_CASE("a nest is saved with its shared objects once, and lazy parts are built for it") {
    const ScratchFile file("structure", ""), lazy_file("lazy", "");
    for (const auto& [name, info] : accelerators()) {
        INFO(name);
        const auto saved = nested(info);
        save_structure(*saved, file.path());
        const auto loaded = load_structure(file.path()).root;
        const std::vector<Ray> rays = test::hard_rays(saved->bounds(), {{0, 0, 0}}, 3);
        CHECK(test::different_hits(*saved, *loaded, rays) == 0);
        CHECK(total_statistics(*loaded).N_OIV == total_statistics(*saved).N_OIV);

        const test::HardScene scene = test::hard_scenes()[1];
        const auto lazy = info.build(scene.set, {{"lazy", true}, {"lazy_size", int64_t(16)}});
        save_structure(*lazy, lazy_file.path());
        CHECK(test::different_hits(*lazy, *load_structure(lazy_file.path()).root, scene.rays) == 0);
    }
}

TEST_CASE("parts of opened objects are saved, with their whole once") {
    std::vector<Vec3f> p;
    std::vector<std::array<uint32_t, 3>> t;
    test::icosphere(2, p, t);
    for (const char* name : {"bvh", "wide_bvh", "model_hierarchy"}) {
        const std::shared_ptr<const Primitive> ball =
            accelerator(name).build(std::make_shared<const TriangleSet>(p, t), {});
        const OpenedObjects opened = open_overlapping(
            {{ball, 0}, {std::make_shared<Instance>(ball, translation({0.5, 0.25, 0})), 1}}, 40,
            OpeningRule::always);
        REQUIRE(opened.opened == 2);
        const auto saved =
            accelerator("bvh").build(std::make_shared<const ObjectSet>(opened.objects), {});
        const ScratchFile file("parts", "");
        save_structure(*saved, file.path());
        const auto loaded = load_structure(file.path()).root;
        INFO(name);
        CHECK(test::different_hits(*saved, *loaded, test::hard_rays(saved->bounds(), p, 8)) == 0);
        CHECK(total_statistics(*loaded).N_OIV == total_statistics(*saved).N_OIV);
    }
}

TEST_CASE("damaged and foreign files are refused with a line that says why") {
    const ScratchFile file("structure", "");
    save_structure(*nested(accelerator("bvh")), file.path());
    const std::string good = bytes_of(file.path());
    const auto refusal_of = [&](const std::string& bytes) {
        write_bytes(file.path(), bytes);
        return refusal(file.path());
    };
    CHECK(refusal_of(good) == "accepted");
    CHECK(refusal("/nonexistent/file").find("cannot be opened") != std::string::npos);
    CHECK(refusal_of("").find("not a saved structure") != std::string::npos);
    CHECK(refusal_of("o bunny\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").find("not a saved") !=
          std::string::npos);
    CHECK(refusal_of(good + "x").find("not as long") != std::string::npos);
    // Every length and a flipped bit at every place of the header, and at many of the rest.
    test::Random random(5);
    size_t accepted = 0;
    for (int i = 0; i < 2000; ++i) {
        std::string bad = good;
        if (i % 2) {
            bad.resize(i < 128 ? size_t(i) : random.next() % good.size());
        } else {
            const size_t at = i < 64 ? size_t(i / 2) : random.next() % good.size();
            bad[at] = char(bad[at] ^ (1 << (random.next() % 8)));
        }
        accepted += refusal_of(bad) == "accepted";
    }
    CHECK(accepted == 0);

    std::string newer = good;
    ++newer[8];
    CHECK(refusal_of(newer).find("version 4") != std::string::npos);
}

TEST_CASE("archive: what is written stays as it is, for those who trace it meanwhile") {
    std::vector<Vec3f> positions;
    std::vector<std::array<uint32_t, 3>> triangles;
    test::icosphere(1, positions, triangles);
    TriangleSet set(positions, triangles, IdTable({{0, 3, 0, 0}, {20, 4, 0, 0}}));
    const float* const before = set.coordinates();
    ArchiveWriter out;
    set.archive(out);
    CHECK(set.coordinates() == before);
    ArchiveReader in(out.buffer(), "buffer");
    TriangleSet read;
    read.archive(in);
    CHECK(in.at_end());
    REQUIRE(read.size() == set.size());
    Hit hit;
    read.ids().resolve(25, 0, hit);
    CHECK(hit.geometry == 4);
    CHECK(hit.primitive == 5);
    CHECK(std::equal(before, before + 3 * positions.size(), read.coordinates()));
}

}  // namespace crofton
