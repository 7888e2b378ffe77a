#include "framework/crofton.h"

namespace crofton {

double expected_cells(const Vec3i& resolution, const Bounds3& bounds) {
    const Vec3d e = bounds.upper.cast<double>() - bounds.lower.cast<double>();
    const Vec3d area(e.y() * e.z(), e.z() * e.x(), e.x() * e.y());
    const double sum = area.sum();
    // A box that is a line or a point is crossed, if at all, along its whole length.
    if (!(sum > 0)) return double(resolution.maxCoeff());
    double cells = 1;
    for (int a = 0; a < 3; ++a) cells += (resolution[a] - 1) * area[a] / sum;
    return cells;
}

double hit_probability(const Bounds3& inner, const Bounds3& outer) {
    const double whole = half_area(outer);
    return whole > 0 ? half_area(inner) / whole : 1.0;
}

double mean_chord(const Bounds3& body) {
    const double area = surface_area(body);
    return area > 0 ? 4 * volume(body) / area : 0.0;
}

}  // namespace crofton
