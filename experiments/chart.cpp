#include "experiments/chart.h"

#include <algorithm>
#include <cmath>

namespace crofton::chart {

Image blank(int width, int height) {
    Image image(width, height);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) image.set(x, y, background);
    return image;
}

void line(Image& image, Point a, Point b, const Vec3d& color) {
    const int n = int(std::max(std::abs(b.x() - a.x()), std::abs(b.y() - a.y()))) + 1;
    for (int i = 0; i <= n; ++i) {
        const Point p = a + (b - a) * (double(i) / n);
        image.set(int(std::lround(p.x())), int(std::lround(p.y())), color);
    }
}

void dot(Image& image, Point p, const Vec3d& color) {
    for (int y = -3; y <= 3; ++y)
        for (int x = -3; x <= 3; ++x)
            if (x * x + y * y <= 10) image.set(int(p.x()) + x, int(p.y()) + y, color);
}

}  // namespace crofton::chart
