#include "experiments/catalogue/recipes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "framework/instance.h"
#include "scenegraph/shape_sets.h"

namespace crofton {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

Vec3f float_of(const Vec3d& v) { return v.cast<float>(); }

double coin(Pcg32& rng) { return rng.next() & 1 ? 1 : -1; }

Vec3f corner(const AimPoints& aim, Pcg32& rng) {
    return aim.corners[rng.below(aim.corners.size())];
}

/// A point of the box, stretched about its middle.
Vec3d box_point(const AimPoints& aim, double stretch, Pcg32& rng) {
    Vec3d p;
    for (int a = 0; a < 3; ++a) {
        const double lo = aim.bounds.lower[a], hi = aim.bounds.upper[a];
        p[a] = (lo + hi) / 2 + (rng.uniform() - 0.5) * (hi - lo) * stretch;
    }
    return p;
}

double size_of(const AimPoints& aim) {
    return std::max((aim.bounds.upper.cast<double>() - aim.bounds.lower.cast<double>()).norm(),
                    1e-30);
}

/// Three points of a shape.
std::array<Vec3d, 3> shape(const AimPoints& aim, Pcg32& rng) {
    if (aim.triangles.empty()) {
        const Vec3d p = corner(aim, rng).cast<double>();
        return {p, p, p};
    }
    const auto& t = aim.triangles[rng.below(aim.triangles.size())];
    return {aim.corners[t[0]].cast<double>(), aim.corners[t[1]].cast<double>(),
            aim.corners[t[2]].cast<double>()};
}

Vec3d edge_point(const AimPoints& aim, Pcg32& rng) {
    const auto v = shape(aim, rng);
    const size_t k = rng.below(3);
    return v[k] + rng.uniform() * (v[(k + 1) % 3] - v[k]);
}

Vec3d inner_point(const AimPoints& aim, Pcg32& rng) {
    const auto v = shape(aim, rng);
    double a = rng.uniform(), b = rng.uniform();
    if (a + b > 1) a = 1 - a, b = 1 - b;
    return v[0] + a * (v[1] - v[0]) + b * (v[2] - v[0]);
}

/// Rounded as someone who aims would: d = fl(target - o).
AimedRay aimed(const Vec3f& o, const Vec3f& target) {
    return {{o, 0, target - o, infinity}, false};
}

/// An origin to aim from: surely inside if there is such a place, or around the scene.
AimedRay aimed_from_anywhere(const AimPoints& aim, const Vec3f& target, Pcg32& rng) {
    if (!aim.inside.empty() && rng.next() % 4) {
        AimedRay r = aimed(aim.inside[rng.below(aim.inside.size())], target);
        r.must_hit = !r.ray.direction.isZero(0);
        return r;
    }
    return aimed(float_of(box_point(aim, 4, rng)), target);
}

Vec3f axis_direction(Pcg32& rng) {
    Vec3f d;
    for (int a = 0; a < 3; ++a) d[a] = rng.next() & 1 ? 0.0f : -0.0f;
    d[int(rng.below(3))] = float(coin(rng));
    return d;
}

AimedRay random_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    return aimed(float_of(box_point(aim, 3, rng)), float_of(box_point(aim, 1, rng)));
}

AimedRay vertex_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    return aimed_from_anywhere(aim, corner(aim, rng), rng);
}

AimedRay edge_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    return aimed_from_anywhere(aim, float_of(edge_point(aim, rng)), rng);
}

AimedRay middle_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    return aimed_from_anywhere(aim, float_of(inner_point(aim, rng)), rng);
}

AimedRay axis_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    const Vec3d through = rng.next() & 1 ? edge_point(aim, rng) : box_point(aim, 1.2, rng);
    const Vec3f d = axis_direction(rng);
    return {{float_of(through - size_of(aim) * d.cast<double>()), 0, d, infinity}, false};
}

/// The origin in a plane that splits the box, and the direction within it.
AimedRay plane_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    Vec3f o = float_of(box_point(aim, 2, rng)), d = float_of(uniform_direction(rng));
    const int a = int(rng.below(3));
    if (rng.next() & 1) {
        o[a] = corner(aim, rng)[a];
    } else {
        const double lo = aim.bounds.lower[a], hi = aim.bounds.upper[a];
        o[a] = float(lo + (hi - lo) * double(rng.below(33)) / 32);
    }
    d[a] = rng.next() & 1 ? 0.0f : -0.0f;
    return {{o, 0, d, infinity}, false};
}

/// From one corner of the cells of a regular grid to another.
AimedRay cell_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    const int cells = 1 << rng.below(6);
    const auto lattice = [&] {
        Vec3f p;
        for (int a = 0; a < 3; ++a) {
            const double lo = aim.bounds.lower[a], hi = aim.bounds.upper[a];
            const double i = double(rng.below(uint64_t(3 * cells + 1))) - cells;
            p[a] = float(lo + (hi - lo) * i / cells);
        }
        return p;
    };
    const Vec3f o = lattice();
    return aimed(o, lattice());
}

AimedRay tiny_component_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    constexpr float tiny[] = {1e-45f, 1e-38f, 1e-30f, 1e-18f, 1e-7f};
    Vec3f d = float_of(uniform_direction(rng));
    const int a = int(rng.below(3));
    d[a] = float(coin(rng)) * tiny[rng.below(5)];
    if (rng.next() & 1) d[(a + 1) % 3] = float(coin(rng)) * tiny[rng.below(5)];
    const Vec3d through = edge_point(aim, rng);
    return {{float_of(through - 2 * size_of(aim) * d.cast<double>().stableNormalized()), 0, d,
             infinity},
            false};
}

AimedRay scaled_direction_ray(const AimPoints& aim, const exact::Oracle& oracle, Pcg32& rng) {
    constexpr double sizes[] = {1e-30, 1e-18, 1e-6, 1e6, 1e18, 1e30};
    AimedRay r = rng.next() & 1 ? edge_ray(aim, oracle, rng) : random_ray(aim, oracle, rng);
    const Vec3d d = r.ray.direction.cast<double>();
    if (d.isZero(0)) return r;
    // t itself must stay a float.
    const double longest = size_of(aim) + d.stableNorm();
    double size = sizes[rng.below(6)];
    if (longest / size > 1e36 || longest / size < 1e-36) size = 1;
    r.ray.direction = float_of(d.stableNormalized() * size);
    return r;
}

/// In the plane of a triangle, along an edge or across.
AimedRay coplanar_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    const auto v = shape(aim, rng);
    const Vec3d from = v[0] + (v[0] - v[1]) * double(1 + rng.below(3));
    const Vec3d to = rng.next() & 1 ? v[1] : Vec3d(v[1] + rng.uniform() * (v[2] - v[1]));
    return aimed(float_of(from), float_of(to));
}

AimedRay surface_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    const Vec3f o = rng.next() & 1 ? corner(aim, rng) : float_of(inner_point(aim, rng));
    Ray ray{o, 0, float_of(uniform_direction(rng)), infinity};
    constexpr float starts[] = {0.0f, -0.0f, 1e-30f, 1e-6f, -1e-6f, -infinity};
    ray.t_min = starts[rng.below(6)];
    return {ray, false};
}

/// Leaves what the oracle hit, nearly along a shape's edge half of the time.
AimedRay spawned_ray(const AimPoints& aim, const exact::Oracle& oracle, Pcg32& rng) {
    const AimedRay first = middle_ray(aim, oracle, rng);
    const exact::Answer answer = oracle.closest(first.ray);
    Vec3d o = first.ray.origin.cast<double>();
    if (answer.is_hit() && std::isfinite(answer.t()))
        o += double(answer.t()) * first.ray.direction.cast<double>();
    Vec3d d = uniform_direction(rng);
    if (rng.next() & 1) {
        const auto v = shape(aim, rng);
        d = (v[1] - v[0]).stableNormalized() + 1e-4 * d;
    }
    const float t_min = rng.next() & 1 ? 0.0f : float(size_of(aim) * 1e-5);
    return {{float_of(o), t_min, float_of(d), infinity}, false};
}

AimedRay far_ray(const AimPoints& aim, const exact::Oracle&, Pcg32& rng) {
    const double radii = std::pow(10.0, 4 + 4 * rng.uniform());
    const Vec3d target = rng.next() & 1 ? edge_point(aim, rng) : inner_point(aim, rng);
    return aimed(float_of(target + radii * size_of(aim) * uniform_direction(rng)),
                 float_of(target));
}

/// The interval begins or ends at the hit, or one float beside it.
AimedRay interval_ray(const AimPoints& aim, const exact::Oracle& oracle, Pcg32& rng) {
    AimedRay r = middle_ray(aim, oracle, rng);
    r.must_hit = false;
    const exact::Answer answer = oracle.closest(r.ray);
    if (!answer.is_hit()) return r;
    const float t = answer.t();
    switch (rng.below(6)) {
        case 0:
            r.ray.t_min = t;
            break;
        case 1:
            r.ray.t_min = std::nextafter(t, infinity);
            break;
        case 2:
            r.ray.t_max = t;
            break;
        case 3:
            r.ray.t_max = std::nextafter(t, -infinity);
            break;
        case 4:
            r.ray.t_min = r.ray.t_max = t;
            break;
        default:
            r.ray.t_min = t, r.ray.t_max = std::nextafter(t, -infinity);
            break;
    }
    return r;
}

/// What is no ray: every answer but a miss is wrong.
AimedRay invalid_ray(const AimPoints& aim, const exact::Oracle& oracle, Pcg32& rng) {
    AimedRay r = middle_ray(aim, oracle, rng);
    r.must_hit = false;
    const float bad = rng.next() & 1 ? nan : float(coin(rng)) * infinity;
    const int a = int(rng.below(3));
    switch (rng.below(6)) {
        case 0:
            r.ray.origin[a] = bad;
            break;
        case 1:
            r.ray.direction[a] = bad;
            break;
        case 2:
            r.ray.t_min = nan;
            break;
        case 3:
            r.ray.t_max = nan;
            break;
        case 4:
            r.ray.direction = Vec3f(0.0f, -0.0f, 0.0f);
            break;
        default:
            r.ray.t_min = 1, r.ray.t_max = 0.5f;
            break;
    }
    return r;
}

/// Whether every edge is used an even number of times, by the bits of its ends.
class EdgeCount {
  public:
    void add(const Vec3f& a, const Vec3f& b) {
        if (a == b) return;
        const Key p{a[0], a[1], a[2]}, q{b[0], b[1], b[2]};
        ++edges_[p < q ? std::pair(p, q) : std::pair(q, p)];
    }
    bool closed() const {
        return !edges_.empty() && std::all_of(edges_.begin(), edges_.end(),
                                              [](const auto& e) { return e.second % 2 == 0; });
    }

  private:
    using Key = std::array<float, 3>;
    std::map<std::pair<Key, Key>, int> edges_;
};

bool is_closed(const TriangleMesh& mesh) {
    if (mesh.triangles.size() > 200000) return false;  // not worth the memory
    EdgeCount edges;
    for (const auto& t : mesh.triangles)
        for (int k = 0; k < 3; ++k) {
            const Vec3f &a = mesh.positions[t[k]], &b = mesh.positions[t[(k + 1) % 3]];
            if (!a.allFinite() || !b.allFinite()) return false;
            edges.add(a, b);
        }
    return edges.closed();
}

/// Points by which to find a quadric: ends, and places on its surface.
std::array<Vec3d, 3> quadric_points(const QuadricShape& s, int variant) {
    const Vec3d p = s.p.cast<double>(), q = s.q.cast<double>();
    Vec3d axis = s.kind == QuadricKind::cone   ? Vec3d(q - p)
                 : s.kind == QuadricKind::disc ? q
                                               : Vec3d(0, 0, 1);
    axis = axis.isZero(0) ? Vec3d(0, 0, 1) : axis.stableNormalized();
    const Vec3d side =
        variant % 2 ? Vec3d(axis.unitOrthogonal()) : Vec3d(axis.cross(axis.unitOrthogonal()));
    const Vec3d rim = p + double(s.p_radius) * side;
    if (s.kind == QuadricKind::cone)
        return {rim, q + double(s.q_radius) * side, variant & 2 ? q : p};
    if (s.kind == QuadricKind::disc) return {rim, p + double(s.q_radius) * side, p};
    return {rim, p + double(s.p_radius) * axis, p};
}

/// Calls visit(a, b, c) with three points of each shape, object space: corners of triangles and
/// polygons, ends and rims of quadrics.
template <class Visit>
void visit_shapes(const TriangleMesh& mesh, const Visit& visit) {
    for (const auto& t : mesh.triangles)
        visit(mesh.positions[t[0]], mesh.positions[t[1]], mesh.positions[t[2]]);
}
template <class Visit>
void visit_shapes(const Quadrics& quadrics, const Visit& visit) {
    for (const Quadric& q : quadrics.shapes)
        for (int k = 0; k < 4; ++k) {
            const auto p = quadric_points(quadric_shape(q), k);
            visit(float_of(p[0]), float_of(p[1]), float_of(p[2]));
        }
}
template <class Visit>
void visit_shapes(const Polygons& polygons, const Visit& visit) {
    for (uint32_t i = 0; i < polygons.size(); ++i) {
        const uint32_t begin = polygons.first[i], n = polygons.first[i + 1] - begin;
        for (uint32_t k = 0; k < n; ++k)
            visit(polygons.positions[begin + k], polygons.positions[begin + (k + 1) % n],
                  polygons.positions[begin + (k + 2) % n]);
    }
}
template <class Visit>
void visit_shapes(const Points&, const Visit&) {}

/// Calls visit(geometry, placement) for all that are placed and active.
template <class Visit>
void visit_placed(const Scene& scene, const Visit& visit) {
    for (const MeshInstance& m : mesh_instances(scene)) {
        const Transform& t = m.world_from_object;
        if (!t.is_identity() && !Instance::is_valid(t)) continue;
        for (uint32_t g : scene.meshes[m.mesh].geometries) visit(g, t);
    }
}

size_t count_shapes(const Scene& scene) {
    size_t total = 0;
    visit_placed(scene, [&](uint32_t g, const Transform&) {
        const auto count = [&](const Vec3f&, const Vec3f&, const Vec3f&) { ++total; };
        std::visit([&](const auto& shapes) { visit_shapes(shapes, count); },
                   scene.geometries[g].shapes);
    });
    return total;
}

/// Whether there are only closed meshes.
bool is_closed(const Scene& scene) {
    std::vector<bool> seen(scene.geometries.size(), false);
    bool closed = true;
    visit_placed(scene, [&](uint32_t g, const Transform&) {
        if (seen[g] || !closed) return;
        seen[g] = true;
        const auto* mesh = std::get_if<TriangleMesh>(&scene.geometries[g].shapes);
        closed = mesh && is_closed(*mesh);
    });
    return closed;
}

}  // namespace

AimPoints::AimPoints(const Scene& scene, size_t limit) : closed(is_closed(scene)) {
    const size_t step = count_shapes(scene) / limit + 1;
    size_t index = 0;
    visit_placed(scene, [&](uint32_t g, const Transform& t) {
        const FloatTransform map = rounded(t);
        const auto add = [&](const Vec3f& a, const Vec3f& b, const Vec3f& c) {
            if (index++ % step != 0) return;
            std::array<Vec3f, 3> p{a, b, c};
            for (Vec3f& q : p) q = t.is_identity() ? q : apply(map, q);
            if (!p[0].allFinite() || !p[1].allFinite() || !p[2].allFinite()) return;
            const uint32_t first = uint32_t(corners.size());
            corners.insert(corners.end(), p.begin(), p.end());
            triangles.push_back({first, first + 1, first + 2});
        };
        std::visit([&](const auto& shapes) { visit_shapes(shapes, add); },
                   scene.geometries[g].shapes);
    });
    for (const Vec3f& p : corners) bounds.extend(p);
    if (corners.empty()) {
        closed = false;
        corners.push_back(Vec3f::Zero());
        bounds = {Vec3f(-1, -1, -1), Vec3f(1, 1, 1)};
    }
}

void AimPoints::find_inside(const exact::Oracle& oracle, Pcg32& rng) {
    inside.clear();
    if (!closed) return;
    const double clear = size_of(*this) * 1e-4;
    for (int i = 0; i < 400 && inside.size() < 32; ++i) {
        const Vec3f p = float_of(box_point(*this, 1, rng));
        bool in = true;
        for (int k = 0; k < 4 && in; ++k) {
            const Ray ray{p, 0, float_of(uniform_direction(rng)), infinity};
            const std::optional<int> crossings = oracle.sure_crossings(ray);
            in = crossings && *crossings % 2 == 1 && oracle.closest(ray).t() > clear;
        }
        if (in) inside.push_back(p);
    }
}

const std::vector<Recipe>& recipes() {
    static const std::vector<Recipe> list{
        {"random", "through the box", random_ray},
        {"vertex", "d = fl(corner - o)", vertex_ray},
        {"edge", "d = fl(point of an edge - o)", edge_ray},
        {"middle", "d = fl(point of a shape - o)", middle_ray},
        {"axis", "axis-parallel, with both zeros", axis_ray},
        {"plane", "within a split or cell plane", plane_ray},
        {"cell", "from one corner of a grid's cells to another", cell_ray},
        {"tiny", "components from 1e-45 to 1e-7", tiny_component_ray},
        {"scaled", "directions from 1e-30 to 1e30 long", scaled_direction_ray},
        {"coplanar", "within the plane of a shape", coplanar_ray},
        {"surface", "from a corner or a surface, t_min about 0", surface_ray},
        {"spawned", "from a hit, half of them along the surface", spawned_ray},
        {"far", "from 1e4 to 1e8 sizes away", far_ray},
        {"interval", "t_min and t_max at the hit and a float beside it", interval_ray},
        {"invalid", "NaN, infinity, zero direction, empty interval", invalid_ray},
    };
    return list;
}

}  // namespace crofton
