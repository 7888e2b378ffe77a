#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "experiments/image.h"

namespace crofton::chart {

using Point = Eigen::Vector2d;  ///< pixels, y downwards

inline const Vec3d white(1, 1, 1), grey(0.35, 0.35, 0.4), background(0.13, 0.13, 0.15);

/// An image of the background's colour.
Image blank(int width, int height);
void line(Image& image, Point a, Point b, const Vec3d& color);
void dot(Image& image, Point p, const Vec3d& color);

/// A logarithmic axis over powers of ten; values of 0 stand apart at its beginning.
struct Axis {
    double low = 0, high = 1;  ///< exponents
    bool zero = false;

    Axis(const std::vector<double>& values, bool with_zero) : zero(with_zero) {
        double least = INFINITY, most = 0;
        for (const double v : values)
            if (v > 0) least = std::min(least, v), most = std::max(most, v);
        if (most == 0) least = most = 1;
        low = std::floor(std::log10(least));
        high = std::max(low + 1, std::ceil(std::log10(most)));
    }
    /// From 0 to 1.
    double at(double value) const {
        const double begin = zero ? 0.12 : 0;
        if (!(value > 0)) return 0.03;
        return begin + (1 - begin) * (std::log10(value) - low) / (high - low);
    }
};

}  // namespace crofton::chart
