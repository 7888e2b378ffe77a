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

/// The point of the surface that `p` was meant to be, in object space.
struct OnSurface {
    const Vec3d& p;
    uint32_t primitive;

    Vec3d operator()(const Quadrics& quadrics) const {
        return std::visit(*this, quadrics.shapes[primitive]);
    }
    Vec3d operator()(const Sphere& sphere) const {
        const Vec3d center = sphere.center.cast<double>();
        return center + double(sphere.radius) * (p - center).stableNormalized();
    }
    Vec3d operator()(const Disc& disc) const {
        return onto_plane(disc.center.cast<double>(), disc.normal.cast<double>());
    }
    Vec3d operator()(const Cone& cone) const {
        const Vec3d base = cone.base.cast<double>();
        const Vec3d axis = cone.apex.cast<double>() - base;
        const double y = (p - base).dot(axis) / axis.squaredNorm();
        const Vec3d center = base + y * axis;
        const double radius =
            double(cone.base_radius) + y * (double(cone.apex_radius) - double(cone.base_radius));
        return center + radius * (p - center).stableNormalized();
    }
    Vec3d operator()(const Polygons& polygons) const {
        return onto_plane(polygons.positions[polygons.first[primitive]].cast<double>(),
                          ObjectNormal{p, primitive}(polygons));
    }
    template <class Other>
    Vec3d operator()(const Other&) const {
        return p;
    }
    Vec3d onto_plane(const Vec3d& q, const Vec3d& normal) const {
        const double square = normal.squaredNorm();
        return square > 0 ? Vec3d(p - normal * ((p - q).dot(normal) / square)) : p;
    }
};

/// What the coordinates of a mapped point were summed from, at most.
double mapped_size(const Transform& map, const Vec3d& p) {
    return (map.linear.cwiseAbs() * p.cwiseAbs() + map.translation.cwiseAbs()).maxCoeff();
}

/// Largest coordinate of a shape that is not a triangle, its radii included.
struct ShapeSize {
    uint32_t primitive;

    double operator()(const Quadrics& quadrics) const {
        return std::visit(*this, quadrics.shapes[primitive]);
    }
    double operator()(const Sphere& s) const { return size(s.center) + double(s.radius); }
    double operator()(const Disc& d) const { return size(d.center) + double(d.radius); }
    double operator()(const Cone& c) const {
        return std::max(size(c.base) + double(c.base_radius), size(c.apex) + double(c.apex_radius));
    }
    double operator()(const Polygons& polygons) const {
        double largest = 0;
        for (uint32_t i = polygons.first[primitive]; i < polygons.first[primitive + 1]; ++i)
            largest = std::max(largest, size(polygons.positions[i]));
        return largest;
    }
    template <class Other>
    double operator()(const Other&) const {
        return 0;
    }
    static double size(const Vec3f& p) { return double(p.cwiseAbs().maxCoeff()); }
};

SurfacePoint placed_triangle_point(const TriangleMesh& mesh, const Transform& world_from_object,
                                   const Hit& hit, const Vec3f& direction) {
    const bool placed = !world_from_object.is_identity();
    const FloatTransform map = rounded(world_from_object);
    Vec3f v[3];
    double size = 0;
    for (int k = 0; k < 3; ++k) {
        v[k] = mesh.positions[mesh.triangles[hit.primitive][size_t(k)]];
        if (!placed) continue;
        size = std::max(size, mapped_size(world_from_object, v[k].cast<double>()));
        v[k] = apply(map, v[k]);
    }
    SurfacePoint point = triangle_point(v, hit, direction);
    point.error += 0x1p-22 * size;
    return point;
}

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

std::optional<SurfacePoint> surface_point(const Scene& scene,
                                          std::span<const MeshInstance> instances, const Hit& hit,
                                          const Ray& ray) {
    const std::optional<Vec3d> normal = surface_normal(scene, instances, hit, ray);
    if (!normal) return std::nullopt;
    const Transform& world_from_object = instances[hit.instance].world_from_object;
    const auto& shapes = scene.geometries[hit.geometry].shapes;
    if (const auto* mesh = std::get_if<TriangleMesh>(&shapes)) {
        SurfacePoint point = placed_triangle_point(*mesh, world_from_object, hit, ray.direction);
        if (point.normal.isZero(0)) return std::nullopt;
        return point;
    }
    const Vec3d seen =
        world_from_object.linear.inverse() * (point_at(ray, hit.t) - world_from_object.translation);
    SurfacePoint point;
    point.position = world_from_object.point(std::visit(OnSurface{seen, hit.primitive}, shapes));
    point.normal = *normal;
    const double shape = std::visit(ShapeSize{hit.primitive}, shapes);
    point.error = 0x1p-22 * point.position.cwiseAbs().maxCoeff() +
                  0x1p-36 * mapped_size(world_from_object, Vec3d::Constant(shape));
    return point;
}

}  // namespace crofton
