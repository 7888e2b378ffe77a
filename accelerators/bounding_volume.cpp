#include "accelerators/bounding_volume.h"

#include <Eigen/Eigenvalues>
#include <limits>

namespace crofton {
namespace {

constexpr float infinity = std::numeric_limits<float>::infinity();

float below(double x) { return std::nextafter(float(x), -infinity); }
float above(double x) { return std::nextafter(float(x), infinity); }

struct Ball {
    Vec3d center;
    double radius;
};

/// The smallest ball about a centre that is a point of float coordinates.
Ball ball_about(const Vec3d& center, std::span<const Vec3f> points, Vec3d* farthest = nullptr) {
    Ball ball{center.cast<float>().cast<double>(), 0};
    for (const Vec3f& p : points) {
        const double r = (p.cast<double>() - ball.center).norm();
        if (r < ball.radius) continue;
        ball.radius = r;
        if (farthest) *farthest = p.cast<double>();
    }
    return ball;
}

Bounds3 bounds_of(std::span<const Vec3f> points) {
    Bounds3 b;
    for (const Vec3f& p : points) b.extend(p);
    return b;
}

struct Slab {
    double lower = std::numeric_limits<double>::infinity();
    double upper = -std::numeric_limits<double>::infinity();
    double width() const { return upper - lower; }
};

/// @param direction  as it is stored: floats
Slab slab_of(const Vec3d& direction, std::span<const Vec3f> points) {
    Slab slab;
    for (const Vec3f& p : points) {
        const double x = direction.dot(p.cast<double>());
        slab.lower = std::min(slab.lower, x);
        slab.upper = std::max(slab.upper, x);
    }
    return slab;
}

/// Three slabs at right angles.
struct Slabs {
    Eigen::Matrix3d directions;  ///< rows, of float entries
    Slab slab[3];
    double half_area() const {
        return slab[0].width() * slab[1].width() + slab[1].width() * slab[2].width() +
               slab[2].width() * slab[0].width();
    }
};

Slabs slabs_along(const Eigen::Matrix3d& directions, std::span<const Vec3f> points) {
    Slabs s;
    s.directions = directions.cast<float>().cast<double>();
    for (int k = 0; k < 3; ++k) s.slab[k] = slab_of(s.directions.row(k).transpose(), points);
    return s;
}

Eigen::Matrix3d principal_directions(std::span<const Vec3f> points) {
    Vec3d mean = Vec3d::Zero();
    for (const Vec3f& p : points) mean += p.cast<double>();
    mean /= double(points.size());
    Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
    for (const Vec3f& p : points) {
        const Vec3d q = p.cast<double>() - mean;
        spread += q * q.transpose();
    }
    const double scale = spread.cwiseAbs().maxCoeff();
    if (!(scale > 0) || !std::isfinite(scale)) return Eigen::Matrix3d::Identity();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread / scale);
    return solver.info() == Eigen::Success ? Eigen::Matrix3d(solver.eigenvectors().transpose())
                                           : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
}

/// Mean over directions of a k-dop's projected area would need its faces; its surface lies between
/// that of the box cut at the corners and the box. The cut of a corner by a diagonal plane at depth
/// h (along x + y + z) removes 3·h²/2 of the box's faces and adds √3·h²/2.
double half_area_of(const KdopPair::Child& c) {
    double box[3];
    for (int a = 0; a < 3; ++a) box[a] = double(c.upper[a]) - c.lower[a];
    double area = 2 * (box[0] * box[1] + box[1] * box[2] + box[2] * box[0]);
    const double least = std::min({box[0], box[1], box[2]});
    for (int k = 3; k < 7; ++k) {
        double lower = 0, upper = 0;
        for (int a = 0; a < 3; ++a) {
            const int n = KdopPair::directions[k][a];
            lower += n > 0 ? c.lower[a] : -double(c.upper[a]);
            upper += n > 0 ? c.upper[a] : -double(c.lower[a]);
        }
        for (const double depth : {c.lower[k] - lower, upper - c.upper[k]}) {
            const double h = std::clamp(depth, 0.0, least);
            area -= h * h * (1.5 - std::sqrt(3.0) / 2);
        }
    }
    return std::max(area, 0.0) / 2;
}

}  // namespace

double fit(std::span<const Vec3f> points, int side, SpherePair& pair) {
    if (points.empty()) {
        for (auto& axis : pair.center) axis[side] = 0;
        pair.radius[side] = -1;
        return 0;
    }
    Vec3d farthest = Vec3d::Zero();
    Ball best = ball_about(bounds_of(points).center().cast<double>(), points, &farthest);
    // Towards the farthest point, by less and less; large sets gain little and would cost much.
    Ball ball = best;
    const int steps = points.size() > 4096 ? 2 : 12;
    for (int i = 1; i <= steps; ++i) {
        ball = ball_about(ball.center + (farthest - ball.center) / (i + 4.0), points, &farthest);
        if (ball.radius < best.radius) best = ball;
    }
    for (int a = 0; a < 3; ++a) pair.center[a][side] = float(best.center[a]);
    pair.radius[side] = above(best.radius * (1 + 1e-12));
    return 2 * M_PI * best.radius * best.radius;
}

double fit(std::span<const Vec3f> points, int side, ObbPair& pair) {
    ObbPair::Child& child = pair.child[side];
    std::fill_n(child.direction[0], 12, 0.0f);
    std::fill_n(child.lower, 4, -infinity);
    std::fill_n(child.upper, 4, infinity);
    if (points.empty()) {
        child.direction[0][0] = 1;
        std::swap(child.lower[0], child.upper[0]);
        return 0;
    }
    Slabs best = slabs_along(Eigen::Matrix3d::Identity(), points);
    const Slabs turned = slabs_along(principal_directions(points), points);
    if (turned.half_area() < best.half_area()) best = turned;
    for (int k = 0; k < 3; ++k) {
        for (int a = 0; a < 3; ++a) child.direction[a][k] = float(best.directions(k, a));
        child.lower[k] = below(best.slab[k].lower);
        child.upper[k] = above(best.slab[k].upper);
    }
    return best.half_area();
}

double fit(std::span<const Vec3f> points, int side, KdopPair& pair) {
    KdopPair::Child& child = pair.child[side];
    child.lower[7] = -infinity;
    child.upper[7] = infinity;
    for (int k = 0; k < 7; ++k) {
        const auto& n = KdopPair::directions[k];
        const Slab slab = slab_of(Vec3d(n[0], n[1], n[2]), points);
        child.lower[k] = points.empty() ? infinity : below(slab.lower);
        child.upper[k] = points.empty() ? -infinity : above(slab.upper);
    }
    return points.empty() ? 0 : half_area_of(child);
}

}  // namespace crofton
