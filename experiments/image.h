#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "framework/primitive.h"
#include "scenegraph/scene.h"

namespace crofton {

/// 8 bits a channel, RGB, rows from the top.
struct Image {
    int width = 0, height = 0;
    std::vector<uint8_t> rgb;

    Image(int w, int h) : width(w), height(h), rgb(size_t(w) * size_t(h) * 3, 0) {}
    void set(int x, int y, const Vec3d& color);  ///< channels in [0, 1]; nothing outside the image
};

/// White text with its upper left corner at (x, y), 8 pixels high.
void draw_text(Image& image, int x, int y, std::string text);

/// @throws InputError  cannot be written
void write_png(const std::string& path, const Image& image);

/// Shaded by normal: (n + 1) / 2 as RGB, misses dark grey.
Image normal_image(const Scene& scene, const Primitive& root, const Camera& camera, int width,
                   int height);

/// Traversal steps plus intersection tests of each pixel's ray.
struct CostMap {
    int width = 0, height = 0;
    int block = 1;  ///< one ray stands for block × block pixels, where all would take too long
    std::vector<float> cost;  ///< width × height
    double highest = 0;
};
/// @param max_s  aim in seconds; the picture gets coarser rather than take longer
CostMap cost_map(const Primitive& root, const Camera& camera, int width, int height, double max_s);

/// The map on a logarithmic scale from 1 to `highest`, with a legend below.
Image heat_image(const CostMap& map, double highest);

/// The colour map "inferno", perceptually uniform, dark to bright. @param x  in [0, 1]
Vec3d heat_color(double x);

}  // namespace crofton
