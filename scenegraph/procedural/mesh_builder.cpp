#include "scenegraph/procedural/mesh_builder.h"

#include <unordered_map>

namespace crofton::procedural {
namespace {

/// The vertex in the middle of an edge, made on first use, pushed out to the unit sphere.
uint32_t midpoint(TriangleMesh& mesh, std::unordered_map<uint64_t, uint32_t>& known, uint32_t a,
                  uint32_t b) {
    const uint64_t key = uint64_t(std::min(a, b)) << 32 | std::max(a, b);
    const auto [entry, is_new] = known.emplace(key, uint32_t(mesh.positions.size()));
    if (is_new) {
        const Vec3d sum = mesh.positions[a].cast<double>() + mesh.positions[b].cast<double>();
        mesh.positions.push_back((sum / std::sqrt(sum.squaredNorm())).cast<float>());
    }
    return entry->second;
}

TriangleMesh icosahedron() {
    const double golden = (1 + std::sqrt(5.0)) / 2, size = std::sqrt(1 + golden * golden);
    TriangleMesh mesh;
    for (int axis = 0; axis < 3; ++axis)
        for (int corner = 0; corner < 4; ++corner) {
            Vec3d p;
            p[axis] = 0;
            p[(axis + 1) % 3] = (corner & 1 ? 1 : -1) / size;
            p[(axis + 2) % 3] = (corner & 2 ? golden : -golden) / size;
            mesh.positions.push_back(p.cast<float>());
        }
    // Faces are the triples of mutual neighbours, turned outwards.
    const double edge = 2.1 / size;
    const auto near = [&](uint32_t a, uint32_t b) {
        return (mesh.positions[a] - mesh.positions[b]).squaredNorm() < edge * edge;
    };
    for (uint32_t a = 0; a < 12; ++a)
        for (uint32_t b = a + 1; b < 12; ++b)
            for (uint32_t c = b + 1; c < 12; ++c) {
                if (!near(a, b) || !near(b, c) || !near(c, a)) continue;
                const Vec3f &p = mesh.positions[a], &q = mesh.positions[b], &r = mesh.positions[c];
                if ((q - p).cross(r - p).dot(p) > 0)
                    mesh.triangles.push_back({a, b, c});
                else
                    mesh.triangles.push_back({a, c, b});
            }
    return mesh;
}

}  // namespace

void MeshBuilder::box(const Vec3d& lower, const Vec3d& upper) {
    const uint32_t first = uint32_t(mesh_.positions.size());
    for (int corner = 0; corner < 8; ++corner)
        vertex({corner & 1 ? upper.x() : lower.x(), corner & 2 ? upper.y() : lower.y(),
                corner & 4 ? upper.z() : lower.z()});
    constexpr uint32_t faces[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                      {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    for (const auto& f : faces) quad(first + f[0], first + f[1], first + f[2], first + f[3]);
}

void MeshBuilder::column(const Vec3d& base, double radius, double height, uint32_t sides) {
    const uint32_t first = uint32_t(mesh_.positions.size());
    for (uint32_t i = 0; i < sides; ++i) {
        const CosSin angle = cos_sin(double(i) / sides);
        const Vec3d foot = base + radius * Vec3d(angle.cos, 0, -angle.sin);
        vertex(foot);
        vertex(foot + Vec3d(0, height, 0));
    }
    for (uint32_t i = 0; i < sides; ++i) {
        const uint32_t a = first + 2 * i, b = first + 2 * ((i + 1) % sides);
        quad(a, b, b + 1, a + 1);
        if (i >= 2) triangle(first + 1, a - 1, a + 1);
    }
}

TriangleMesh icosphere(uint32_t level) {
    TriangleMesh mesh = icosahedron();
    for (; level > 0; --level) {
        std::unordered_map<uint64_t, uint32_t> known;
        std::vector<std::array<uint32_t, 3>> split;
        split.reserve(4 * mesh.triangles.size());
        for (const auto& [a, b, c] : mesh.triangles) {
            const uint32_t ab = midpoint(mesh, known, a, b), bc = midpoint(mesh, known, b, c),
                           ca = midpoint(mesh, known, c, a);
            split.push_back({a, ab, ca});
            split.push_back({ab, b, bc});
            split.push_back({ca, bc, c});
            split.push_back({ab, bc, ca});
        }
        mesh.triangles = std::move(split);
    }
    return mesh;
}

Camera camera(const Vec3d& eye, const Vec3d& at, const Vec3d& up) {
    Camera c;
    c.eye = eye;
    c.at = at;
    c.up = up;
    return c;
}

}  // namespace crofton::procedural
