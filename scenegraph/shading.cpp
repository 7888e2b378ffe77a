#include "scenegraph/shading.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>

#include "scenegraph/splats.h"

namespace crofton {
namespace {

/// A covector of the object, or zero. `p` is the hit point in object space.
struct ObjectNormal {
    const Vec3d& p;
    uint32_t primitive;

    Vec3d operator()(const TriangleMesh& mesh) const {
        const auto& [a, b, c] = mesh.triangles[primitive];
        const Vec3d origin = mesh.positions[a].cast<double>();
        return (mesh.positions[b].cast<double>() - origin)
            .cross(mesh.positions[c].cast<double>() - origin);
    }
    Vec3d operator()(const Quadrics& quadrics) const {
        return std::visit(*this, quadrics.shapes[primitive]);
    }
    Vec3d operator()(const Sphere& sphere) const { return p - sphere.center.cast<double>(); }
    Vec3d operator()(const Disc& disc) const { return disc.normal.cast<double>(); }
    Vec3d operator()(const Cone& cone) const {
        const Vec3d base = cone.base.cast<double>();
        const Vec3d axis = cone.apex.cast<double>() - base;
        const double height = axis.norm();
        if (!(height > 0)) return Vec3d::Zero();
        const Vec3d a = axis / height;
        Vec3d radial = (p - base) - a * (p - base).dot(a);
        if (!(radial.norm() > 0)) return Vec3d::Zero();
        // The radius changes by `slope` per unit of height, and the normal leans against it.
        const double slope = (double(cone.apex_radius) - double(cone.base_radius)) / height;
        return radial.normalized() - a * slope;
    }
    /// Newell's sum: right for any simple planar polygon.
    Vec3d operator()(const Polygons& polygons) const {
        Vec3d sum = Vec3d::Zero();
        const uint32_t first = polygons.first[primitive], end = polygons.first[primitive + 1];
        const Vec3d origin = polygons.positions[first].cast<double>();
        for (uint32_t i = first; i < end; ++i) {
            const uint32_t j = i + 1 < end ? i + 1 : first;
            sum += (polygons.positions[i].cast<double>() - origin)
                       .cross(polygons.positions[j].cast<double>() - origin);
        }
        return sum;
    }
    Vec3d operator()(const Points& points) const {
        if (is_disc(points, primitive)) return points.normals[primitive].cast<double>();
        return p - points.positions[primitive].cast<double>();
    }
};

}  // namespace

std::optional<Vec3d> surface_normal(const Scene& scene, std::span<const MeshInstance> instances,
                                    const Hit& hit, const Ray& ray) {
    if (!hit.is_hit() || hit.instance >= instances.size()) return std::nullopt;
    const Transform& world_from_object = instances[hit.instance].world_from_object;
    Eigen::Matrix3d object_from_world;
    bool invertible = false;
    world_from_object.linear.computeInverseWithCheck(object_from_world, invertible, 0.0);
    if (!invertible) return std::nullopt;
    const Vec3d p = object_from_world * (point_at(ray, hit.t) - world_from_object.translation);
    const Vec3d n =
        std::visit(ObjectNormal{p, hit.primitive}, scene.geometries[hit.geometry].shapes);
    // Covectors map by the inverse transpose; scaled first, so that squares stay in range.
    Vec3d world = object_from_world.transpose() * n;
    world /= world.cwiseAbs().maxCoeff();
    if (!world.allFinite()) return std::nullopt;
    world.normalize();
    return world.dot(ray.direction.cast<double>()) > 0 ? Vec3d(-world) : world;
}

}  // namespace crofton
