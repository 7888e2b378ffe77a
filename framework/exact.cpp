#include "framework/exact.h"

#include <algorithm>

#include "framework/exact_polygon.h"
#include "framework/exact_quadric.h"
#include "framework/exact_tree.h"
#include "framework/exact_triangle.h"

namespace crofton::exact {
namespace {

/// Whether a ray is a miss by definition.
bool is_void(const Ray& ray) {
    const float largest = ray.direction.cwiseAbs().maxCoeff();
    return !ray.origin.allFinite() || !ray.direction.allFinite() || largest < 0x1p-126f ||
           largest >= 0x1p127f || !(ray.t_min <= ray.t_max);
}

/// |a - b| in ulps: of the larger t, or of the t at which the ray is as far from its origin as that
/// is from zero, if that is larger: the coordinates of what is hit there have no finer ones.
double ulps(float a, float b, const Ray& ray) {
    if (a == b) return 0;
    const float largest = std::max(std::abs(a), std::abs(b));
    const double scale = std::max(double(largest), double(ray.origin.cwiseAbs().maxCoeff()) /
                                                       double(ray.direction.cwiseAbs().maxCoeff()));
    const int exponent = std::max(std::ilogb(scale), -126);
    return std::ldexp(std::abs(double(a) - double(b)), 23 - exponent);
}

bool same_id(const Hit& a, const Hit& b) {
    return a.primitive == b.primitive && a.geometry == b.geometry && a.instance == b.instance;
}

/// A hit of one shape with its exact t.
struct Solved {
    Root t;
    Hit id;
};

}  // namespace

/// A candidate that the filter left open.
struct Oracle::Open {
    Reference reference;
    Candidate at;
};

bool Answer::has(const Hit& hit) const {
    return std::any_of(ties.begin(), ties.end(), [&](const Hit& h) { return same_id(h, hit); });
}

const char* to_string(Judgement::Kind kind) {
    switch (kind) {
        case Judgement::Kind::right:
            return "right";
        case Judgement::Kind::false_miss:
            return "false miss";
        case Judgement::Kind::false_hit:
            return "false hit";
        case Judgement::Kind::wrong_primitive:
            return "wrong primitive";
        case Judgement::Kind::wrong_t:
            return "wrong t";
    }
    return "";
}

Oracle::Oracle() = default;
Oracle::~Oracle() = default;
Oracle::Oracle(Oracle&&) noexcept = default;
Oracle& Oracle::operator=(Oracle&&) noexcept = default;

void Oracle::add_triangles(std::span<const Vec3f> positions,
                           std::span<const std::array<uint32_t, 3>> triangles, const Placement& p) {
    add(std::make_unique<Triangles>(positions, triangles, std::make_shared<Placed>(p.chain)),
        p.geometry, p.instance);
}

void Oracle::add_polygons(std::span<const Vec3f> corners, std::span<const uint32_t> first,
                          const Placement& p) {
    add(std::make_unique<Polygons>(corners, first, std::make_shared<Placed>(p.chain)), p.geometry,
        p.instance);
}

void Oracle::add_quadrics(std::span<const QuadricShape> shapes, const Placement& p) {
    add(std::make_unique<QuadricShapes>(shapes, std::make_shared<Placed>(p.chain)), p.geometry,
        p.instance);
}

void Oracle::add(std::unique_ptr<Shapes> shapes, uint32_t geometry, uint32_t instance) {
    groups_.push_back({std::move(shapes), geometry, instance});
}

void Oracle::finish() {
    std::vector<Reference> all;
    std::vector<Box> boxes;
    for (uint32_t g = 0; g < groups_.size(); ++g)
        for (uint32_t i = 0; i < groups_[g].shapes->size(); ++i) {
            if (!groups_[g].shapes->active(i)) continue;
            all.push_back({g, i});
            boxes.push_back(groups_[g].shapes->bounds(i));
        }
    tree_ = std::make_unique<Tree>();
    std::vector<uint32_t> order;
    tree_->build(boxes, order);
    references_.clear();
    for (uint32_t i : order) references_.push_back(all[i]);
}

size_t Oracle::size() const { return references_.size(); }

Hit Oracle::id(const Reference& r) const {
    Hit hit;
    hit.primitive = r.shape;
    hit.geometry = groups_[r.group].geometry;
    hit.instance = groups_[r.group].instance;
    return hit;
}

/// Calls visit(reference, candidate) for every candidate that may lie within [t_min, t_end]; t_end
/// may shrink meanwhile.
template <class Visit>
void Oracle::visit(const DoubleRay& ray, double scale, const double& t_end,
                   const Visit& visit) const {
    if (tree_->nodes.empty()) return;
    // The median halves: 32 levels hold all that an index can name.
    uint32_t stack[64];
    int top = 0;
    stack[top++] = 0;
    while (top > 0) {
        const uint32_t index = stack[--top];
        const Tree::Node& node = tree_->nodes[index];
        double near, far;
        if (!passes(ray, node.box, scale, near, far)) continue;
        const double slack = scale * std::max(ray.t_bound, double_t_bound);
        if (near - slack * std::abs(near) > t_end || far + slack * std::abs(far) < ray.t_min)
            continue;
        if (node.count == 0) {
            // Nearer one last, by the middles of the boxes.
            const Box &a = tree_->nodes[index + 1].box, &b = tree_->nodes[node.first].box;
            double ahead = 0;
            for (int k = 0; k < 3; ++k)
                ahead +=
                    ray.d[k] * (b.lower[k] / 2 + b.upper[k] / 2 - a.lower[k] / 2 - a.upper[k] / 2);
            stack[top++] = ahead > 0 ? node.first : index + 1;
            stack[top++] = ahead > 0 ? index + 1 : node.first;
            continue;
        }
        for (uint32_t i = node.first; i < node.first + node.count; ++i) {
            Candidates found;
            const Reference& r = references_[i];
            groups_[r.group].shapes->candidates(ray, r.shape, scale, found);
            for (int k = 0; k < found.count; ++k) {
                Candidate& c = found.at[k];
                if (!(c.lo <= c.hi)) c = {};  // an overflow decides nothing
                if (!(c.hi < ray.t_min || c.lo > t_end)) visit(r, c);
            }
        }
    }
}

/// Candidates among which the closest hit is, if there is one.
std::vector<Oracle::Open> Oracle::open_candidates(const Ray& ray) const {
    const DoubleRay r(ray);
    std::vector<Open> open;
    double t_end = r.t_max;
    visit(r, 0, t_end, [&](const Reference& reference, const Candidate& c) {
        open.push_back({reference, c});
        if (c.sure && c.lo >= r.t_min) t_end = std::min(t_end, c.hi);
    });
    std::erase_if(open, [&](const Open& o) { return o.at.lo > t_end; });
    return open;
}

Answer Oracle::closest(const Ray& ray) const {
    Answer answer;
    if (is_void(ray)) return answer;
    std::vector<Open> open = open_candidates(ray);
    if (open.size() == 1) {
        const Candidate& c = open[0].at;
        const float t = float(c.lo);
        if (c.sure && c.lo >= ray.t_min && c.hi <= ray.t_max && t == float(c.hi)) {
            answer.ties = {id(open[0].reference)};
            answer.ties[0].t = t;
            return answer;
        }
    }
    const ExactRay exact(ray);
    std::vector<Root> roots;
    Root best;
    const Reference* last = nullptr;
    for (const Open& o : open) {
        // A shape's candidates follow each other, and its roots come all at once.
        if (last && last->group == o.reference.group && last->shape == o.reference.shape) continue;
        last = &o.reference;
        roots.clear();
        groups_[o.reference.group].shapes->solve(exact, o.reference.shape, roots);
        for (Root& root : roots) {
            if (compare(root, ray.t_min) < 0 || compare(root, ray.t_max) > 0) continue;
            const int order = answer.ties.empty() ? -1 : compare(root, best);
            if (order > 0) break;
            if (order < 0) {
                answer.ties.clear();
                best = std::move(root);
            }
            answer.ties.push_back(id(o.reference));
            break;
        }
    }
    if (answer.ties.empty()) return answer;
    std::sort(answer.ties.begin(), answer.ties.end(), id_less);
    const float t = round_to_float(best);
    for (Hit& hit : answer.ties) hit.t = t;
    return answer;
}

bool Oracle::any(const Ray& ray) const {
    if (is_void(ray)) return false;
    const DoubleRay r(ray);
    std::vector<Reference> open;
    bool sure = false;
    double t_end = r.t_max;
    visit(r, 0, t_end, [&](const Reference& reference, const Candidate& c) {
        if (c.sure && c.lo >= r.t_min && c.hi <= r.t_max) {
            sure = true;
            t_end = -INFINITY;  // nothing else needs a look
        }
        if (!sure) open.push_back(reference);
    });
    if (sure) return true;
    const ExactRay exact(ray);
    std::vector<Root> roots;
    for (const Reference& o : open) {
        roots.clear();
        groups_[o.group].shapes->solve(exact, o.shape, roots);
        for (const Root& root : roots)
            if (compare(root, ray.t_min) >= 0 && compare(root, ray.t_max) <= 0) return true;
    }
    return false;
}

/// Whether some shapes within the leaf tests' bounds give this answer: the hit must be a candidate,
/// and nothing that must be found may come surely before it. A t of infinity stands for all that no
/// float holds.
bool Oracle::allowed(const Ray& ray, const Hit& hit, Mode mode) const {
    if (hit.is_hit() && !(hit.t >= ray.t_min && hit.t <= ray.t_max)) return false;
    const DoubleRay r(ray, mode == Mode::fast ? fast_t_bound : t_bound);
    const double t_high = hit.is_hit() ? double(hit.t) : INFINITY;
    const double t_low =
        hit.is_hit() ? std::min<double>(hit.t, std::numeric_limits<float>::max()) : INFINITY;
    bool possible = !hit.is_hit(), passed_over = false;
    const double t_end = std::min(r.t_max, t_high);
    visit(r, 1, t_end, [&](const Reference& reference, const Candidate& c) {
        if (same_id(id(reference), hit) && c.lo <= t_high && t_low <= c.hi) possible = true;
        if (c.sure && c.lo >= r.t_min && c.hi <= r.t_max && c.hi < t_low) passed_over = true;
    });
    return possible && !passed_over;
}

Judgement Oracle::judge(const Ray& ray, const Hit& hit, const Answer& truth, Mode mode) const {
    using Kind = Judgement::Kind;
    Judgement j;
    if (!hit.is_hit() && !truth.is_hit()) return j;
    if (!hit.is_hit()) {
        j.kind = Kind::false_miss;
    } else if (!truth.is_hit()) {
        j.kind = Kind::false_hit;
    } else if (!truth.has(hit)) {
        j.kind = Kind::wrong_primitive;
    } else {
        j.t_ulp = ulps(hit.t, truth.t(), ray);
        if (hit.t == truth.t() || allowed(ray, hit, mode)) return j;
        j.kind = Kind::wrong_t;
        j.inside_margin = false;
        return j;
    }
    j.inside_margin = !is_void(ray) && allowed(ray, hit, mode);
    return j;
}

Judgement Oracle::judge(const Ray& ray, bool occluded, const Answer& truth) const {
    Judgement j;
    if (occluded == truth.is_hit()) return j;
    j.kind = occluded ? Judgement::Kind::false_hit : Judgement::Kind::false_miss;
    if (is_void(ray)) {
        j.inside_margin = false;
        return j;
    }
    const DoubleRay r(ray);
    bool possible = false, must = false;
    visit(r, 1, r.t_max, [&](const Reference&, const Candidate& c) {
        possible = true;
        must = must || (c.sure && c.lo >= r.t_min && c.hi <= r.t_max);
    });
    j.inside_margin = occluded ? possible : !must;
    return j;
}

/// Whether all shapes within `scale` times the bounds give one and the same answer.
bool Oracle::certain(const Ray& ray, double scale) const {
    const DoubleRay r(ray);
    std::vector<Open> all;
    double t_end = r.t_max;
    visit(r, scale, t_end, [&](const Reference& reference, const Candidate& c) {
        all.push_back({reference, c});
        if (c.sure && c.lo >= r.t_min) t_end = std::min(t_end, c.hi);
    });
    std::erase_if(all, [&](const Open& o) { return o.at.lo > t_end; });
    if (all.empty()) return true;
    return all.size() == 1 && all[0].at.sure && all[0].at.lo >= r.t_min && all[0].at.hi <= r.t_max;
}

double Oracle::margin(const Ray& ray) const {
    if (is_void(ray)) return std::numeric_limits<double>::infinity();
    int low = -17, high = 21;  // certain at 2^low (or never), not at 2^high
    while (high - low > 1) {
        const int middle = low + (high - low) / 2;
        (certain(ray, std::ldexp(1.0, middle)) ? low : high) = middle;
    }
    return low == -17 ? 0 : std::ldexp(1.0, low);
}

std::optional<int> Oracle::sure_crossings(const Ray& ray) const {
    if (is_void(ray)) return 0;
    const DoubleRay r(ray);
    int count = 0;
    bool sure = true;
    visit(r, 1, r.t_max, [&](const Reference&, const Candidate& c) {
        ++count;
        sure = sure && c.sure && c.lo >= r.t_min && c.hi <= r.t_max;
    });
    if (!sure) return std::nullopt;
    return count;
}

}  // namespace crofton::exact
