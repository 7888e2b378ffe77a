#include "framework/exact_nearest.h"

#include <algorithm>
#include <cassert>

#include "framework/exact_leaf.h"
#include "framework/exact_polygon.h"
#include "framework/exact_quadric.h"
#include "framework/polygon_set.h"

namespace crofton::exact {
namespace {

std::shared_ptr<const Placed> nowhere() {
    static const auto identity = std::make_shared<const Placed>(std::vector<Transform>{});
    return identity;
}

/// The query's ray, in the query's units.
Ray ray_of(const RayQuery& q) {
    return {{q.origin[0], q.origin[1], q.origin[2]},
            q.t_min,
            {q.direction[0], q.direction[1], q.direction[2]},
            q.t_best};
}

/// Whether float(middle) is within an ulp of everything inside.
bool narrow(const Candidate& c) {
    return float(c.lo) == float(c.hi) || c.hi - c.lo <= 0x1p-26 * std::abs(c.lo);
}

/// Barycentric weights of the second and third corner, in double.
void weights(const DoubleRay& ray, const Vec3f (&corners)[3], float& u, float& v) {
    double x[3], y[3], w[3];
    for (int k = 0; k < 3; ++k) {
        const double z = double(corners[k][ray.kz]) - ray.o[ray.kz];
        x[k] = (double(corners[k][ray.kx]) - ray.o[ray.kx]) - ray.sx * z;
        y[k] = (double(corners[k][ray.ky]) - ray.o[ray.ky]) - ray.sy * z;
    }
    for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        w[k] = x[i] * y[j] - x[j] * y[i];
    }
    const double sum = w[0] + w[1] + w[2];
    u = sum != 0 ? float(std::clamp(w[1] / sum, 0.0, 1.0)) : 0.0f;
    v = sum != 0 ? float(std::clamp(w[2] / sum, 0.0, 1.0)) : 0.0f;
}

QuadricShapes one_shape(const QuadricSet& set, uint32_t i, std::shared_ptr<const Placed> placed) {
    return QuadricShapes({&set.shape(i), 1}, std::move(placed));
}

Polygons one_shape(const PolygonSet& set, uint32_t i, std::shared_ptr<const Placed> placed) {
    const std::span<const Vec3f> corners = set.corners(i);
    const uint32_t first[2] = {0, uint32_t(corners.size())};
    return Polygons(corners, first, std::move(placed));
}

/// Of several places where a shape is hit, the one meant is nearest to t.
float refined_t(const Shapes& one, const RayQuery& q, float t) {
    const Ray ray = ray_of(q);
    Candidates found;
    one.candidates(DoubleRay(ray), 0, 0, found);
    const Candidate* nearest = nullptr;
    const auto distance = [&](const Candidate& c) { return std::max(c.lo - t, t - c.hi); };
    for (int k = 0; k < found.count; ++k)
        if (!nearest || distance(found.at[k]) < distance(*nearest)) nearest = &found.at[k];
    if (!nearest) return t;
    if (nearest->sure && narrow(*nearest)) return float(nearest->lo / 2 + nearest->hi / 2);
    std::vector<Root> roots;
    one.solve(ExactRay(ray), 0, roots);
    float best = t;
    double least = INFINITY;
    for (const Root& root : roots) {
        const float exact = round_to_float(root);
        if (std::abs(double(exact) - t) >= least) continue;
        least = std::abs(double(exact) - t);
        best = exact;
    }
    return best;
}

template <class Set>
bool test_exactly(Query kind, const Set& set, const uint32_t* references, uint32_t count,
                  const LocalRay& ray, RayQuery& q) {
    const std::shared_ptr<const Placed> placed = q.exact->placed(ray.frame);
    for (uint32_t i = 0; i < count; ++i)
        if (q.exact->test_shape(one_shape(set, references[i], placed), set.ids(), references[i],
                                kind, q))
            return true;
    return false;
}

template <class Set>
bool test_refined(Query kind, const Set& set, const uint32_t* references, uint32_t count,
                  const LocalRay& ray, RayQuery& q) {
    for (uint32_t i = 0; i < count; ++i) {
        float t;
        if (!set.intersect(references[i], ray, q, t)) continue;
        const auto placed =
            ray.frame ? std::make_shared<const Placed>(std::vector{ray.frame->world_from_object})
                      : nowhere();
        t = refined_t(one_shape(set, references[i], placed), q, t);
        if (!(t >= q.t_min && t <= q.t_best)) continue;
        if (kind == Query::any) return true;
        q.record(t, 0, 0, set.ids(), references[i]);
    }
    return false;
}

}  // namespace

const ExactRay& NearestHit::exact_ray() {
    if (!exact_ray_) exact_ray_.emplace(ray_);
    return *exact_ray_;
}

std::shared_ptr<const Placed> NearestHit::placed(const InstanceFrame* frame) {
    if (!frame || frame->world_from_object.is_identity()) return nowhere();
    if (!placed_ || !(placed_map_ == frame->world_from_object)) {
        placed_map_ = frame->world_from_object;
        placed_ = std::make_shared<const Placed>(std::vector{placed_map_});
    }
    return placed_;
}

/// The first root within [t_min, t_max]. @return  whether there is one
template <class Solve>
bool NearestHit::first_root(const Solve& solve, Root& root) {
    std::vector<Root> roots;
    solve(roots);
    for (Root& r : roots) {
        if (compare(r, ray_.t_min) < 0 || compare(r, ray_.t_max) > 0) continue;
        root = std::move(r);
        return true;
    }
    return false;
}

/// Whether a hit at `root` takes the place of the one there is.
bool NearestHit::in_front(const Root& root, const IdTable& ids, uint32_t shape,
                          const RayQuery& query) {
    if (!ids_) return true;
    if (!root_) {
        const auto solve = [&](std::vector<Root>& out) {
            solve_triangle(exact_ray(), corners_, out);
        };
        [[maybe_unused]] const bool found = first_root(solve, root_.emplace());
        assert(found);  // the filter was sure of it
    }
    const int order = compare(root, *root_);
    if (order != 0) return order < 0;
    Hit candidate;
    ids.resolve(shape, query.instance, candidate);
    return id_less(candidate, query.ids());
}

void NearestHit::take(double lo, double hi, float t, const IdTable& ids, uint32_t shape, float u,
                      float v, RayQuery& query) {
    ids_ = &ids;
    shape_ = shape;
    instance_ = query.instance;
    lo_ = lo;
    hi_ = hi;
    t_ = t;
    // Exact, unless it leaves the range of normal floats, in the user's units or the query's: then
    // up, so that nothing is culled for it.
    float query_t = t / scale_;
    if (query_t * scale_ != t || !(std::abs(t) >= std::numeric_limits<float>::min()))
        query_t = std::nextafter(float(hi / scale_), INFINITY);
    query.replace(query_t, u, v, ids, shape);
}

/// Makes a hit of a kind that the oracle does not know the one to beat, with its t as exact.
void NearestHit::adopt(const RayQuery& query) {
    ids_ = query.hit_ids;
    shape_ = query.hit_shape;
    instance_ = query.hit_instance;
    t_ = query.t_best * scale_;
    lo_ = hi_ = t_;
    root_ = Root::fraction(Dyadic(t_), Dyadic(1));
}

template <class Solve>
NearestHit::Outcome NearestHit::consider(const Candidates& found, const Solve& solve,
                                         const IdTable& ids, uint32_t shape, float u, float v,
                                         Query kind, bool deferred, RayQuery& query) {
    if (query.hit_ids && !decided(query)) adopt(query);
    // Candidates of a shape ascend, so that the first one that may count is the one that does, if
    // it is sure.
    const double t_end = std::min<double>(ray_.t_max, hi_);
    const Candidate* first = nullptr;
    Candidate unsure;
    for (int k = 0; k < found.count && !first; ++k) {
        const Candidate& c = found.at[k];
        const bool bounded = c.lo <= c.hi;  // an overflow decides nothing
        if (bounded && (c.hi < ray_.t_min || c.lo > t_end)) continue;
        first = bounded ? &c : &unsure;
    }
    if (!first) return Outcome::passed;
    const bool sure = first->sure && first->lo >= ray_.t_min && first->hi <= ray_.t_max;
    if (sure && kind == Query::any) return Outcome::answered;
    if (sure && deferred && first->hi < lo_ && float(first->lo) == float(first->hi)) {
        root_.reset();
        take(first->lo, first->hi, float(first->lo), ids, shape, u, v, query);
        return Outcome::taken;
    }
    Root root;
    if (!first_root(solve, root)) return Outcome::passed;
    if (kind == Query::any) return Outcome::answered;
    if (!in_front(root, ids, shape, query)) return Outcome::passed;
    const float t = round_to_float(root);
    root_ = std::move(root);
    take(std::nextafter(t, -INFINITY), std::nextafter(t, INFINITY), t, ids, shape, u, v, query);
    return Outcome::taken;
}

bool NearestHit::test_triangle(const Vec3f (&v)[3], const IdTable& ids, uint32_t shape, Query kind,
                               RayQuery& query) {
    for (const Vec3f& corner : v)
        if (!corner.allFinite()) return false;
    Candidates found;
    triangle_candidates(double_ray_, v, found);
    if (found.count == 0) return false;
    float a, b;
    weights(double_ray_, v, a, b);
    const auto solve = [&](std::vector<Root>& out) { solve_triangle(exact_ray(), v, out); };
    const Outcome outcome = consider(found, solve, ids, shape, a, b, kind, true, query);
    if (outcome == Outcome::taken) std::copy(std::begin(v), std::end(v), corners_);
    return outcome == Outcome::answered;
}

bool NearestHit::test_shape(const Shapes& one, const IdTable& ids, uint32_t shape, Query kind,
                            RayQuery& query) {
    if (!one.active(0)) return false;
    Candidates found;
    one.candidates(double_ray_, 0, 0, found);
    const auto solve = [&](std::vector<Root>& out) { one.solve(exact_ray(), 0, out); };
    return found.count > 0 &&
           consider(found, solve, ids, shape, 0, 0, kind, false, query) == Outcome::answered;
}

bool test_triangle(Query kind, const Vec3f (&v)[3], const IdTable& ids, uint32_t shape,
                   RayQuery& query) {
    return query.exact->test_triangle(v, ids, shape, kind, query);
}

float refined_t(const float (&v)[3][3], const RayQuery& q, float t) {
    const Ray ray = ray_of(q);
    Vec3f corners[3];
    for (int k = 0; k < 3; ++k) corners[k] = Vec3f(v[k][0], v[k][1], v[k][2]);
    Candidates found;
    triangle_candidates(DoubleRay(ray), corners, found);
    if (found.count == 0) return t;
    const Candidate& c = found.at[0];
    if (c.sure && narrow(c)) return float(c.lo / 2 + c.hi / 2);
    std::vector<Root> roots;
    solve_triangle(ExactRay(ray), corners, roots);
    return roots.empty() ? t : round_to_float(roots[0]);
}

bool test_shapes(Query kind, const QuadricSet& set, const uint32_t* references, uint32_t count,
                 const LocalRay& ray, RayQuery& q) {
    return q.mode == Mode::exact ? test_exactly(kind, set, references, count, ray, q)
                                 : test_refined(kind, set, references, count, ray, q);
}

bool test_shapes(Query kind, const PolygonSet& set, const uint32_t* references, uint32_t count,
                 const LocalRay& ray, RayQuery& q) {
    return q.mode == Mode::exact ? test_exactly(kind, set, references, count, ray, q)
                                 : test_refined(kind, set, references, count, ray, q);
}

}  // namespace crofton::exact
