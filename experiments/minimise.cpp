#include "experiments/minimise.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <map>

#include "experiments/plan.h"
#include "framework/error.h"
#include "framework/instance.h"
#include "scenegraph/exact_scene.h"

namespace crofton {
namespace {

using Fails = std::function<bool(const FailingCase&)>;

Scene scene_of(const TriangleMesh& mesh) {
    Scene scene;
    scene.add_object("mesh", {"mesh", 0, mesh});
    return scene;
}

/// Leaves out runs of triangles, half of them at first, then ever shorter ones.
void drop_triangles(FailingCase& c, const Fails& fails) {
    for (size_t run = (c.mesh.triangles.size() + 1) / 2; run > 0;
         run = run == 1 ? 0 : (run + 1) / 2)
        for (size_t begin = 0; begin < c.mesh.triangles.size();) {
            FailingCase less = c;
            auto& t = less.mesh.triangles;
            const size_t end = std::min(begin + run, t.size());
            t.erase(t.begin() + long(begin), t.begin() + long(end));
            if (fails(less))
                c = std::move(less);
            else
                begin = end;
        }
}

void drop_corners(FailingCase& c) {
    std::map<uint32_t, uint32_t> renamed;
    std::vector<Vec3f> kept;
    for (auto& t : c.mesh.triangles)
        for (uint32_t& i : t) {
            const auto [it, fresh] = renamed.try_emplace(i, uint32_t(kept.size()));
            if (fresh) kept.push_back(c.mesh.positions[i]);
            i = it->second;
        }
    c.mesh.positions = std::move(kept);
}

/// x with so many bits of its mantissa.
float shortened(float x, int bits) {
    if (!std::isfinite(x) || x == 0) return x;
    const double unit = std::ldexp(1.0, std::ilogb(x) + 1 - bits);
    return float(std::nearbyint(x / unit) * unit);
}

void shorten(FailingCase& c, const std::function<float&(FailingCase&)>& number,
             const Fails& fails) {
    const float x = number(c);
    const auto accept = [&](float shorter) {
        if (shorter == x) return true;
        FailingCase simpler = c;
        number(simpler) = shorter;
        if (!fails(simpler)) return false;
        c = std::move(simpler);
        return true;
    };
    if (accept(0)) return;
    for (int bits : {1, 2, 4, 8, 12, 16, 20})
        if (accept(shortened(x, bits))) return;
}

void shorten_numbers(FailingCase& c, const Fails& fails) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    FailingCase open = c;
    open.ray.t_max = infinity;
    if (fails(open)) c = open;
    shorten(
        c, [](FailingCase& x) -> float& { return x.ray.t_min; }, fails);
    for (int a = 0; a < 3; ++a) {
        shorten(
            c, [a](FailingCase& x) -> float& { return x.ray.direction[a]; }, fails);
        shorten(
            c, [a](FailingCase& x) -> float& { return x.ray.origin[a]; }, fails);
    }
    for (size_t i = 0; i < c.mesh.positions.size(); ++i)
        for (int a = 0; a < 3; ++a)
            shorten(
                c, [i, a](FailingCase& x) -> float& { return x.mesh.positions[i][a]; }, fails);
}

}  // namespace

FailingCase minimise(FailingCase start, const Fails& fails) {
    FailingCase c = std::move(start);
    drop_triangles(c, fails);
    drop_corners(c);
    shorten_numbers(c, fails);
    return c;
}

bool has_fault(const FailingCase& c, const std::string& name) {
    const Scene scene = scene_of(c.mesh);
    const exact::Oracle oracle = make_oracle(scene);
    const Assembly assembly = assemble(scene, uniform_plan(name)),
                   reference = assemble(scene, uniform_plan("brute_force"));
    const Hit hit = assembly.root->intersect(c.ray);
    const exact::Answer truth = oracle.closest(c.ray);
    return !(hit == reference.root->intersect(c.ray)) ||
           oracle.judge(c.ray, hit, truth).is_fault() ||
           oracle.judge(c.ray, assembly.root->occluded(c.ray), truth).is_fault();
}

TriangleMesh placed_triangles(const Scene& scene) {
    TriangleMesh all;
    for (const MeshInstance& m : mesh_instances(scene)) {
        const bool identity = m.world_from_object.is_identity();
        if (!identity && !Instance::is_valid(m.world_from_object)) continue;
        const FloatTransform map = rounded(m.world_from_object);
        for (const uint32_t g : scene.meshes[m.mesh].geometries) {
            const auto* mesh = std::get_if<TriangleMesh>(&scene.geometries[g].shapes);
            if (!mesh) continue;
            const uint32_t base = uint32_t(all.positions.size());
            for (const Vec3f& p : mesh->positions)
                all.positions.push_back(identity ? p : apply(map, p));
            for (const auto& t : mesh->triangles)
                all.triangles.push_back({base + t[0], base + t[1], base + t[2]});
        }
    }
    return all;
}

std::string minimise_to_files(const std::vector<FailingRay>& rays, const std::string& obj_file) {
    for (const FailingRay& failing : rays) {
        FailingCase c{placed_triangles(verify_scene(failing.scene)), failing.ray};
        const auto fails = [&](const FailingCase& x) { return has_fault(x, failing.accelerator); };
        if (!fails(c)) continue;
        c = minimise(std::move(c), fails);
        std::ofstream out(obj_file);
        out << fmt::format("# {} in {}: {}\n", failing.accelerator, failing.scene, failing.kind);
        for (const Vec3f& p : c.mesh.positions)
            out << fmt::format("v {:.9g} {:.9g} {:.9g}\n", p[0], p[1], p[2]);
        for (const auto& t : c.mesh.triangles)
            out << fmt::format("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
        out.flush();
        if (!out) throw InputError(obj_file + ": cannot be written");
        FailingRay small = failing;
        small.scene = obj_file;
        small.ray = c.ray;
        small.must_hit = false;
        write_failing(obj_file + ".jsonl", {small});
        return fmt::format("{}: {} triangles; crofton verify --replay {}.jsonl", obj_file,
                           c.mesh.triangles.size(), obj_file);
    }
    return "no ray of the file fails over placed triangles: nothing to minimise";
}

}  // namespace crofton
