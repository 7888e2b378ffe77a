#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "framework/mode.h"
#include "framework/quadric_set.h"
#include "framework/ray.h"
#include "framework/transform.h"

namespace crofton::exact {

class Shapes;
struct Candidate;
struct DoubleRay;
struct Placed;
struct Tree;

/// What a ray truly hits first.
struct Answer {
    /// All shapes at the exact smallest t in [t_min, t_max], in the order of their ids; t is that t
    /// rounded to the nearest float, u = v = 0. Empty: a miss.
    std::vector<Hit> ties;

    bool is_hit() const { return !ties.empty(); }
    float t() const { return is_hit() ? ties.front().t : Hit{}.t; }
    /// Whether `hit` names one of the ties.
    bool has(const Hit& hit) const;
};

/// How an answer of the library compares with the truth.
struct Judgement {
    enum class Kind { right, false_miss, false_hit, wrong_primitive, wrong_t };
    Kind kind = Kind::right;
    /// Whether the leaf tests' stated bounds (framework/exact_shapes.h) allow the answer. What is
    /// not right and not inside the margin is a fault.
    bool inside_margin = true;
    /// Error of the right primitive's t, in ulps of t or, if they are larger, of the origin's
    /// largest coordinate in units of t.
    double t_ulp = 0;

    bool is_fault() const { return kind != Kind::right && !inside_margin; }
};
const char* to_string(Judgement::Kind kind);

/// The oracle: closest and any hits in exact arithmetic, independent of every kernel, set and
/// accelerator of the library. Never fast, always right.
///
/// The truth is what the float bits of the input say, taken as exact real numbers: corners, radii,
/// the ray, and the doubles of each map in the chain that places an object. Corners are mapped by
/// the exact product of the chain. The library maps them by that product rounded (FloatTransform),
/// so that its answers may differ within a margin that accounts for the rounding; to have the
/// truth about the corners *as the library places them*, give it those: mapped by `apply`, with an
/// empty chain (PlacementTruth::as_placed of scenegraph/exact_scene.h does).
///
/// A triangle or polygon is hit from both sides, its edges and corners included; a ray in its plane
/// misses it. For quadrics see exact_quadric.h. t_min and t_max are included. Rays that the library
/// defines as misses (see Ray) are misses.
///
/// Method: a tree of boxes and double arithmetic with error bounds leave few candidates, mostly one
/// that is sure; the rest is decided on integers of any length (Dyadic, Root). Thread-safe after
/// `finish`.
class Oracle {
  public:
    Oracle();
    ~Oracle();
    Oracle(Oracle&&) noexcept;
    Oracle& operator=(Oracle&&) noexcept;

    /// Where shapes are and what hits call them.
    struct Placement {
        std::vector<Transform> chain;  ///< world_from_object = chain[0]·chain[1]·…; all invertible
        uint32_t geometry = 0, instance = 0;
    };
    /// @name Adding shapes; `primitive` counts from 0 in each call
    /// @{
    void add_triangles(std::span<const Vec3f> positions,
                       std::span<const std::array<uint32_t, 3>> triangles,
                       const Placement& placement);
    /// @param first  first corner of each polygon, then corners.size()
    void add_polygons(std::span<const Vec3f> corners, std::span<const uint32_t> first,
                      const Placement& placement);
    void add_quadrics(std::span<const QuadricShape> shapes, const Placement& placement);
    void add(std::unique_ptr<Shapes> shapes, uint32_t geometry, uint32_t instance);
    /// @}
    /// Builds the tree; once, after the last shape.
    void finish();

    Answer closest(const Ray& ray) const;
    bool any(const Ray& ray) const;
    /// Distance to the nearest decision boundary, in units of the leaf tests' stated bounds: the
    /// largest power of two from 2^-16 to 2^20 by which they can be multiplied with the answer
    /// still the same for every shape that they allow; else 0 (ties, rays through edges). Above 1,
    /// the library must be right.
    double margin(const Ray& ray) const;

    /// Compares the library's answers with the truth.
    /// @param truth  closest(ray)
    /// @param mode   in which the hit was found
    Judgement judge(const Ray& ray, const Hit& hit, const Answer& truth,
                    Mode mode = Mode::robust) const;
    Judgement judge(const Ray& ray, bool occluded, const Answer& truth) const;

    /// Number of surfaces that the ray crosses, if no leaf test can see it otherwise: odd from the
    /// inside of closed surfaces.
    std::optional<int> sure_crossings(const Ray& ray) const;

    size_t size() const;

  private:
    struct Group {
        std::unique_ptr<Shapes> shapes;
        uint32_t geometry, instance;
    };
    struct Reference {
        uint32_t group, shape;
    };
    struct Open;

    Hit id(const Reference& r) const;
    std::vector<Open> open_candidates(const Ray& ray) const;
    bool allowed(const Ray& ray, const Hit& hit, Mode mode) const;
    bool certain(const Ray& ray, double scale) const;
    template <class Visit>
    void visit(const DoubleRay& ray, double scale, const double& t_end, const Visit& visit) const;

    std::vector<Group> groups_;
    std::vector<Reference> references_;  ///< in the order of the tree's leaves
    std::unique_ptr<Tree> tree_;
};

}  // namespace crofton::exact
