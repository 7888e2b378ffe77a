#pragma once

#include "scenegraph/procedural/deterministic.h"
#include "scenegraph/scene.h"

namespace crofton::procedural {

/// Collects triangles. Points are given in double and rounded once.
class MeshBuilder {
  public:
    uint32_t vertex(const Vec3d& p) {
        mesh_.positions.push_back(p.cast<float>());
        return uint32_t(mesh_.positions.size() - 1);
    }
    void triangle(uint32_t a, uint32_t b, uint32_t c) { mesh_.triangles.push_back({a, b, c}); }
    void quad(uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
        triangle(a, b, c);
        triangle(a, c, d);
    }
    void quad(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d) {
        const uint32_t i = vertex(a);
        vertex(b), vertex(c), vertex(d);
        quad(i, i + 1, i + 2, i + 3);
    }
    /// Axis-aligned box, 12 triangles facing outwards.
    void box(const Vec3d& lower, const Vec3d& upper);
    /// Upright prism about the y axis through `base`: `sides` quads and a top.
    void column(const Vec3d& base, double radius, double height, uint32_t sides);

    Geometry geometry(const std::string& name, uint32_t material = 0) {
        return {name, material, std::move(mesh_)};
    }

  private:
    TriangleMesh mesh_;
};

/// Unit sphere from an icosahedron whose triangles are split `level` times: 20·4^level triangles.
TriangleMesh icosphere(uint32_t level);

/// A camera with a 45° angle.
Camera camera(const Vec3d& eye, const Vec3d& at, const Vec3d& up);

}  // namespace crofton::procedural
