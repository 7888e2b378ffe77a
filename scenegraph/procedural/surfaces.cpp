#include <algorithm>
#include <vector>

#include "scenegraph/procedural/generators.h"
#include "scenegraph/procedural/mesh_builder.h"

namespace crofton::procedural {
namespace {

/// A value in [0, 1) for each point of the integer lattice.
double lattice_value(uint64_t seed, int64_t x, int64_t y) {
    const uint64_t key = mixed(seed ^ mixed(uint64_t(x) * 0x9e3779b97f4a7c15u + uint64_t(y)));
    return double(key >> 11) * 0x1p-53;
}

/// Value noise: lattice values joined by smooth steps.
double noise(uint64_t seed, double x, double y) {
    const double x0 = std::floor(x), y0 = std::floor(y), u = x - x0, v = y - y0;
    const double s = u * u * (3 - 2 * u), t = v * v * (3 - 2 * v);
    const int64_t i = int64_t(x0), j = int64_t(y0);
    const double near = lattice_value(seed, i, j) * (1 - s) + lattice_value(seed, i + 1, j) * s;
    const double far =
        lattice_value(seed, i, j + 1) * (1 - s) + lattice_value(seed, i + 1, j + 1) * s;
    return near * (1 - t) + far * t;
}

/// Octaves of noise over the unit square, each of half the amplitude; in [0, 1).
double fractal(uint64_t seed, double x, double y) {
    double sum = 0, amplitude = 0.5, frequency = 4;
    for (int octave = 0; octave < 10; ++octave) {
        sum += amplitude * noise(seed + uint64_t(octave), frequency * x, frequency * y);
        amplitude *= 0.5;
        frequency *= 2;
    }
    return sum;
}

constexpr uint32_t kHairSegments = 16, kHairSides = 3;

/// One hair: a tube of triangular section that winds about the center at changing heights.
void add_hair(MeshBuilder& mesh, Random& random, double thickness) {
    Vec3d outward = random.direction();
    Vec3d axis = outward.cross(random.direction());
    while (axis.squaredNorm() < 1e-6) axis = outward.cross(random.direction());
    axis /= std::sqrt(axis.squaredNorm());
    const double stride = random.between(0.01, 0.03), curl = random.between(-0.03, 0.03);
    const double wave = random.between(0.02, 0.08), phase = random.unit();
    const double radius = random.between(0.5, 0.95), swing = random.between(0.0, 0.05);
    uint32_t previous = 0;
    for (uint32_t i = 0; i <= kHairSegments; ++i) {
        const Vec3d center = outward * (radius + swing * cos_sin(phase + wave * i).sin);
        uint32_t ring = 0;
        for (uint32_t side = 0; side < kHairSides; ++side) {
            const CosSin a = cos_sin(double(side) / kHairSides);
            const uint32_t v = mesh.vertex(center + thickness * (a.cos * outward + a.sin * axis));
            if (side == 0) ring = v;
        }
        for (uint32_t side = 0; i > 0 && side < kHairSides; ++side) {
            const uint32_t next = (side + 1) % kHairSides;
            mesh.quad(previous + side, previous + next, ring + next, ring + side);
        }
        previous = ring;
        // The axis stays perpendicular to the way out, up to rounding.
        outward = turned(outward, axis, cos_sin(stride));
        outward /= std::sqrt(outward.squaredNorm());
        axis = turned(axis, outward, cos_sin(curl));
    }
}

}  // namespace

Scene terrain(const ProceduralValues& values) {
    const uint32_t n = uint32_t(values.at("n"));
    const double size = values.at("size"), height = values.at("height");
    const uint64_t seed = uint64_t(values.at("seed"));
    MeshBuilder mesh;
    for (uint32_t j = 0; j <= n; ++j)
        for (uint32_t i = 0; i <= n; ++i) {
            const double x = double(i) / n, z = double(j) / n;
            mesh.vertex({size * (x - 0.5), height * fractal(seed, x, z), size * (z - 0.5)});
        }
    for (uint32_t j = 0; j < n; ++j)
        for (uint32_t i = 0; i < n; ++i) {
            const uint32_t a = j * (n + 1) + i, b = a + n + 1;
            mesh.quad(a, b, b + 1, a + 1);
        }
    Scene scene;
    scene.add_object("terrain", mesh.geometry("terrain"));
    scene.cameras.push_back(
        camera({0, height + 0.2 * size, 0.8 * size}, Vec3d::Zero(), Vec3d::UnitY()));
    scene.lights.push_back({{size, 2 * size + height, size}});
    return scene;
}

// After the hairball of Samuli Laine and Tero Karras, "Two Methods for Fast Ray-Cast Ambient
// Occlusion", 2010; not its data.
Scene hairball(const ProceduralValues& values) {
    const uint64_t each = 2 * kHairSides * kHairSegments;
    const uint64_t hairs = (uint64_t(values.at("triangles")) + each - 1) / each;
    Random random(uint64_t(values.at("seed")));
    MeshBuilder mesh;
    for (uint64_t i = 0; i < hairs; ++i) add_hair(mesh, random, values.at("thickness"));
    Scene scene;
    scene.add_object("hairball", mesh.geometry("hairball"));
    scene.cameras.push_back(camera({0, 0, 3}, Vec3d::Zero(), Vec3d::UnitY()));
    scene.lights.push_back({{3, 4, 5}});
    return scene;
}

/// A tube about the y axis from -1/2 to 1/2 that winds around it.
Geometry stem(uint32_t segments) {
    constexpr uint32_t sides = 6;
    MeshBuilder mesh;
    uint32_t previous = 0;
    for (uint32_t i = 0; i <= segments; ++i) {
        const double s = double(i) / segments;
        const CosSin wind = cos_sin(2.5 * s);
        const Vec3d center(0.06 * wind.cos, s - 0.5, 0.06 * wind.sin);
        uint32_t ring = 0;
        for (uint32_t side = 0; side < sides; ++side) {
            const CosSin a = cos_sin(double(side) / sides);
            const uint32_t v = mesh.vertex(center + 0.012 * Vec3d(a.cos, 0, a.sin));
            if (side == 0) ring = v;
        }
        for (uint32_t side = 0; i > 0 && side < sides; ++side) {
            const uint32_t next = (side + 1) % sides;
            mesh.quad(previous + next, previous + side, ring + side, ring + next);
        }
        previous = ring;
    }
    return mesh.geometry("stem");
}

Scene thicket(const ProceduralValues& values) {
    Random random(uint64_t(values.at("seed")));
    Scene scene;
    scene.meshes.push_back(
        {"stem", {scene.add_geometry(stem(uint32_t(std::ceil(values.at("triangles") / 12))))}});
    const uint32_t count = uint32_t(values.at("n"));
    // Groups of stems that grow near one another, as a model would have them.
    const uint32_t bushes = std::max(1u, uint32_t(std::sqrt(double(count))));
    const uint32_t root = scene.add_node("thicket", {});
    for (uint32_t bush = 0; bush < bushes; ++bush) {
        const Vec3d middle = random.in_unit_cube();
        const uint32_t group =
            scene.add_node("bush " + std::to_string(bush), {}, translation(middle), root);
        const uint32_t begin = uint32_t(uint64_t(count) * bush / bushes),
                       end = uint32_t(uint64_t(count) * (bush + 1) / bushes);
        for (uint32_t i = begin; i < end; ++i) {
            const Vec3d axis = random.direction().normalized();
            const CosSin angle = cos_sin(random.unit());
            Transform place;
            for (int a = 0; a < 3; ++a)
                place.linear.col(a) = values.at("length") * turned(Vec3d::Unit(a), axis, angle);
            place.translation = 0.2 * (random.in_unit_cube() - Vec3d::Constant(0.5));
            scene.add_node("", 0, place, group);
        }
    }
    scene.cameras.push_back(camera({0.5, 0.8, 2.4}, Vec3d::Constant(0.5), Vec3d::UnitY()));
    scene.lights.push_back({{3, 4, 5}});
    return scene;
}

Scene random_triangles(const ProceduralValues& values) {
    const double size = values.at("size");
    Random random(uint64_t(values.at("seed")));
    MeshBuilder mesh;
    for (uint64_t i = 0; i < uint64_t(values.at("n")); ++i) {
        const Vec3d center = random.in_unit_cube();
        uint32_t last = 0;
        for (int corner = 0; corner < 3; ++corner)
            last = mesh.vertex(center + size * (random.in_unit_cube() - Vec3d::Constant(0.5)));
        mesh.triangle(last - 2, last - 1, last);
    }
    Scene scene;
    scene.add_object("random triangles", mesh.geometry("random triangles"));
    scene.cameras.push_back(camera({0.5, 0.5, 2.5}, Vec3d::Constant(0.5), Vec3d::UnitY()));
    scene.lights.push_back({{2, 3, 4}});
    return scene;
}

}  // namespace crofton::procedural
