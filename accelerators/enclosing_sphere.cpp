#include "accelerators/enclosing_sphere.h"

#include <algorithm>

namespace crofton {
namespace {

constexpr size_t sample_size = 256;
constexpr int sample_steps = 12;

/// Distance from `center` to the far side of a ball.
double reach(const Vec3d& center, const Ball& ball) {
    return (ball.center.cast<double>() - center).norm() + ball.radius;
}

double radius_about(const Vec3d& center, std::span<const Ball> balls) {
    double radius = 0;
    for (const Ball& ball : balls) radius = std::max(radius, reach(center, ball));
    return radius;
}

Vec3d box_center(std::span<const Ball> balls) {
    Vec3d lower = Vec3d::Constant(INFINITY), upper = -lower;
    for (const Ball& ball : balls) {
        const Vec3d c = ball.center.cast<double>();
        lower = lower.cwiseMin((c.array() - double(ball.radius)).matrix());
        upper = upper.cwiseMax((c.array() + double(ball.radius)).matrix());
    }
    return 0.5 * (lower + upper);
}

/// Moves `center` towards the farthest ball of a sample, less and less far.
Vec3d drawn_center(Vec3d center, std::span<const Ball> balls) {
    const size_t stride = (balls.size() + sample_size - 1) / sample_size;
    for (int step = 0; step < sample_steps; ++step) {
        const Ball* farthest = &balls[0];
        double distance = 0;
        for (size_t i = 0; i < balls.size(); i += stride)
            if (const double r = reach(center, balls[i]); r > distance) {
                distance = r;
                farthest = &balls[i];
            }
        center += (farthest->center.cast<double>() - center) / (step + 2);
    }
    return center;
}

}  // namespace

void add_balls(const TriangleSet& set, uint32_t i, std::vector<Ball>& balls) {
    for (int k = 0; k < 3; ++k) balls.push_back({set.vertex(i, k), 0});
}

void add_balls(const QuadricSet& set, uint32_t i, std::vector<Ball>& balls) {
    const QuadricShape& s = set.shape(i);
    balls.push_back({s.p, s.p_radius});
    if (s.kind == QuadricKind::cone) balls.push_back({s.q, s.q_radius});
}

void add_balls(const PolygonSet& set, uint32_t i, std::vector<Ball>& balls) {
    // Corners may stand off the plane that is hit by their own rounding: see PolygonSet::bounds.
    for (const Vec3f& c : set.corners(i)) balls.push_back({c, c.cwiseAbs().maxCoeff() * 0x1p-19f});
}

void add_balls(const ObjectSet& set, uint32_t i, std::vector<Ball>& balls) {
    const Bounds3& b = set.bounds(i);
    for (int corner = 0; corner < 8; ++corner)
        balls.push_back(
            {Vec3f(corner & 1 ? b.upper.x() : b.lower.x(), corner & 2 ? b.upper.y() : b.lower.y(),
                   corner & 4 ? b.upper.z() : b.lower.z()),
             0});
}

EnclosingSphere enclosing_sphere(std::span<const Ball> balls) {
    if (balls.empty()) return {};
    const Vec3d middle = box_center(balls), drawn = drawn_center(middle, balls);
    const double a = radius_about(middle, balls), b = radius_about(drawn, balls);
    // A few roundings of doubles, outwards.
    return b < a ? EnclosingSphere{drawn, b * (1 + 0x1p-50)}
                 : EnclosingSphere{middle, a * (1 + 0x1p-50)};
}

}  // namespace crofton
