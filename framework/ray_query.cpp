#include "framework/ray_query.h"

#include "framework/ray_setup.h"

namespace crofton {
namespace {

// For callers that are not compiled for every target.
using namespace HWY_NAMESPACE::ray_setup;

alignas(16) constexpr float last_lane[4] = {0, 0, 0, 1};

}  // namespace

bool prepare(const Ray& ray, float magnitude, RayQuery& q, LocalRay& local, float& scale) {
    return HWY_NAMESPACE::ray_setup::prepare(ray, magnitude, q, local, scale);
}

/// Thickness: the leaf test sees fl(M·v) - o in the world, wrong by at most 4u·(|M|·|v| + |m| +
/// |o|) per axis and by the test's own 8u of the distance; |M⁻¹| brings that to object space. The
/// rounded map moves the origin by 4u·(|M⁻¹|·|o| + |M⁻¹·m|), and the direction by 4u·|M⁻¹|·|d|,
/// times t of which |d|·t is within the same sum. 32u covers all 20u of it, and the roundings of
/// the pad.
InstanceFrame::InstanceFrame(const Transform& to_world, const Transform& to_object,
                             const Vec3f& magnitudes)
    : world_from_object(to_world),
      object_from_world(to_object),
      world_from_object_f(rounded(to_world)),
      magnitude(magnitudes.maxCoeff()) {
    const Vec3d reach =
        to_world.linear.cwiseAbs() * magnitudes.cast<double>() + to_world.translation.cwiseAbs();
    const Vec3d thickness = frame_pad * (to_object.linear.cwiseAbs() * reach);
    for (int a = 0; a < 3; ++a) {
        for (int k = 0; k < 3; ++k) column[k][a] = float(to_object.linear(a, k));
        column[3][a] = float(to_object.translation[a]);
        pad[a] = float(thickness[a]);
    }
    for (float(&c)[4] : column) c[3] = 0;
    pad[3] = 0;
}

bool enter(const InstanceFrame& frame, const RayQuery& query, LocalRay& local) {
    const auto x = hn::LoadU(f4, frame.column[0]), y = hn::LoadU(f4, frame.column[1]),
               z = hn::LoadU(f4, frame.column[2]), origin = hn::LoadU(f4, frame.column[3]);
    const auto o = hn::LoadU(f4, query.origin), d = hn::LoadU(f4, query.direction);
    const auto ox = hn::Broadcast<0>(o), oy = hn::Broadcast<1>(o), oz = hn::Broadcast<2>(o);
    const auto from =
        hn::Add(hn::Add(hn::Mul(x, ox), hn::Mul(y, oy)), hn::Add(hn::Mul(z, oz), origin));
    const auto way =
        hn::Add(hn::Add(hn::Mul(x, hn::Broadcast<0>(d)), hn::Mul(y, hn::Broadcast<1>(d))),
                hn::Mul(z, hn::Broadcast<2>(d)));
    const auto reach =
        hn::Add(hn::Add(hn::Abs(hn::Mul(x, ox)), hn::Abs(hn::Mul(y, oy))), hn::Abs(hn::Mul(z, oz)));
    const auto pad = hn::MulAdd(reach, hn::Set(f4, frame_pad), hn::LoadU(f4, frame.pad));
    const float largest = hn::GetLane(hn::MaxOfLanes(f4, hn::Abs(way)));
    if (!(largest > 0) || !finite3(way, way)) return false;
    local.frame = &frame;
    // The fourth lane means nothing, but must not divide by zero.
    const auto divisor = hn::Or(way, hn::Load(f4, last_lane));
    complete(local, from, divisor, hn::Div(hn::Set(f4, 1.0f), divisor), pad, query.t_min,
             frame.magnitude, rcp_limit / largest);
    return true;
}

ObjectRay::ObjectRay(const LocalRay& local, const RayQuery& query) {
    const Vec3d o(query.origin[0], query.origin[1], query.origin[2]);
    const Vec3d d(query.direction[0], query.direction[1], query.direction[2]);
    origin = local.frame ? local.frame->object_from_world.point(o) : o;
    direction = local.frame ? local.frame->object_from_world.vector(d) : d;
}

void IdTable::index_runs() {
    run_at_.clear();
    if (runs_.empty()) runs_.push_back({0, 0, 0, 0});  // as no file that was written has it
    if (runs_.size() < 2) return;
    const uint32_t last = runs_.back().first;
    const size_t places = 4 * runs_.size();
    shift_ = 0;
    while (last >> shift_ >= places) ++shift_;
    for (uint32_t place = 0, run = 0; place <= last >> shift_; ++place) {
        while (run + 1 < runs_.size() && runs_[run + 1].first <= place << shift_) ++run;
        run_at_.push_back(run);
    }
    run_at_.push_back(uint32_t(runs_.size() - 1));
}

ShapeGroups IdTable::groups(uint32_t size) const {
    ShapeGroups groups;
    if (runs_.size() < 2 || size == 0) return groups;
    for (size_t r = 0; r < runs_.size(); ++r) {
        const uint32_t end = r + 1 < runs_.size() ? runs_[r + 1].first : ~0u;
        if (end > runs_[r].first) groups.push_back({runs_[r].first, end});
    }
    if (!whole_.empty()) return groups_of_part(groups, whole_);
    groups.back().end = size;
    return groups;
}

}  // namespace crofton
