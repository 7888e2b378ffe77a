#include "experiments/image.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "experiments/camera.h"
#include "framework/clock.h"
#include "framework/error.h"
#include "framework/parallel.h"
#include "scenegraph/shading.h"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#pragma GCC diagnostic ignored "-Wunused-function"
#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STB_IMAGE_WRITE_STATIC
#include <stb/stb_easy_font.h>
#include <stb/stb_image_write.h>
#pragma GCC diagnostic pop

namespace crofton {
namespace {

constexpr int legend_height = 34;
const Vec3d background(0.13, 0.13, 0.15);

/// Where a cost stands on the scale from 1 to `highest`.
double scale_position(double cost, double highest) {
    return std::log(std::max(cost, 1.0)) / std::log(std::max(highest, 2.0));
}

void draw_legend(Image& image, double highest) {
    const int top = image.height - legend_height, left = 8, right = image.width - 9;
    for (int x = left; x <= right; ++x)
        for (int y = top + 4; y < top + 14; ++y)
            image.set(x, y, heat_color(double(x - left) / (right - left)));
    // Ticks at powers of ten, where they do not run into the text at the end.
    const std::string end = fmt::format("max {:.0f} steps + tests per ray", highest);
    const int end_x = right - stb_easy_font_width(const_cast<char*>(end.c_str()));
    draw_text(image, end_x, top + 19, end);
    for (double tick = 1; tick <= highest; tick *= 10) {
        const int x = left + int(scale_position(tick, highest) * (right - left));
        const std::string text = fmt::format("{:.0f}", tick);
        const int text_width = stb_easy_font_width(const_cast<char*>(text.c_str()));
        for (int y = top + 12; y < top + 17; ++y) image.set(x, y, Vec3d::Ones());
        if (x + text_width + 8 < end_x)
            draw_text(image, std::max(left, x - text_width / 2), top + 19, text);
    }
}

/// Seconds a ray takes with counting, from an even sample of the rays.
double pilot_s(const Primitive& root, const std::vector<Ray>& rays) {
    const size_t step = std::max<size_t>(1, rays.size() / 200);
    const auto start = Clock::now();
    size_t count = 0;
    for (size_t i = step / 2; i < rays.size(); i += step, ++count) {
        Counters counters;
        root.intersect(rays[i], counters);
    }
    return count ? seconds_since(start) / double(count) : 0.0;
}

}  // namespace

void draw_text(Image& image, int x, int y, std::string text) {
    struct Vertex {
        float x, y, z;
        unsigned char color[4];
    };
    std::vector<Vertex> vertices(text.size() * 4 * 20 + 64);
    const int quads = stb_easy_font_print(0, 0, text.data(), nullptr, vertices.data(),
                                          int(vertices.size() * sizeof(Vertex)));
    for (int q = 0; q < quads; ++q) {
        const Vertex& a = vertices[size_t(q) * 4];
        const Vertex& c = vertices[size_t(q) * 4 + 2];
        for (int v = int(a.y); v < int(c.y); ++v)
            for (int u = int(a.x); u < int(c.x); ++u) image.set(x + u, y + v, Vec3d::Ones());
    }
}

void Image::set(int x, int y, const Vec3d& color) {
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    for (int c = 0; c < 3; ++c)
        rgb[(size_t(y) * size_t(width) + size_t(x)) * 3 + size_t(c)] =
            uint8_t(std::lround(std::clamp(color[c], 0.0, 1.0) * 255));
}

void write_png(const std::string& path, const Image& image) {
    if (!stbi_write_png(path.c_str(), image.width, image.height, 3, image.rgb.data(),
                        image.width * 3))
        throw InputError(path + ": cannot be written");
}

Image normal_image(const Scene& scene, const Primitive& root, const Camera& camera, int width,
                   int height) {
    Image image(width, height);
    const std::vector<MeshInstance> instances = mesh_instances(scene);
    const std::vector<Ray> rays = camera_rays(camera, width, height);
    parallel_for(rays.size(), 1024, [&](size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) {
            const Hit hit = root.intersect(rays[i]);
            const auto n = surface_normal(scene, instances, hit, rays[i]);
            const int x = int(i % size_t(width)), y = int(i / size_t(width));
            const Vec3d color = n ? Vec3d(0.5 * (*n + Vec3d::Ones())) : background;
            image.set(x, y, color);
        }
    });
    return image;
}

CostMap cost_map(const Primitive& root, const Camera& camera, int width, int height, double max_s) {
    CostMap map{width, height, 1, std::vector<float>(size_t(width) * size_t(height)), 0};
    const std::vector<Ray> rays = camera_rays(camera, width, height);
    const double full_s = pilot_s(root, rays) * double(rays.size());
    while (map.block < 32 && full_s / (map.block * map.block) > max_s) ++map.block;
    const int blocks_x = (width + map.block - 1) / map.block;
    const int blocks_y = (height + map.block - 1) / map.block;
    const auto trace_block = [&](size_t b) {
        const int x0 = int(b % size_t(blocks_x)) * map.block;
        const int y0 = int(b / size_t(blocks_x)) * map.block;
        const int x = std::min(x0 + map.block / 2, width - 1);
        const int y = std::min(y0 + map.block / 2, height - 1);
        Counters counters;
        root.intersect(rays[size_t(y) * size_t(width) + size_t(x)], counters);
        for (int v = y0; v < std::min(y0 + map.block, height); ++v)
            for (int u = x0; u < std::min(x0 + map.block, width); ++u)
                map.cost[size_t(v) * size_t(width) + size_t(u)] =
                    float(counters.N_TS + counters.N_IT);
    };
    parallel_for(size_t(blocks_x) * size_t(blocks_y), 256, [&](size_t begin, size_t end) {
        for (size_t b = begin; b < end; ++b) trace_block(b);
    });
    map.highest = map.cost.empty() ? 0 : *std::max_element(map.cost.begin(), map.cost.end());
    return map;
}

Image heat_image(const CostMap& map, double highest) {
    Image image(map.width, map.height + legend_height);
    for (int y = 0; y < map.height; ++y)
        for (int x = 0; x < map.width; ++x) {
            const float cost = map.cost[size_t(y) * size_t(map.width) + size_t(x)];
            image.set(x, y, heat_color(scale_position(cost, highest)));
        }
    draw_legend(image, highest);
    return image;
}

Vec3d heat_color(double x) {
    // Polynomial fit of matplotlib's inferno (Smith, van der Walt 2015), within 1 % of its table.
    static const Vec3d c[7] = {
        {0.00021894, 0.00165100, -0.01948090},     {0.10651342, 0.56395644, 3.93271239},
        {11.60249308, -3.97285397, -15.94239411},  {-41.70399613, 17.43639888, 44.35414520},
        {77.16293570, -33.40235894, -81.80730926}, {-71.31942824, 32.62606426, 73.20951986},
        {25.13112622, -12.24266895, -23.07032500}};
    x = std::clamp(x, 0.0, 1.0);
    Vec3d color = c[6];
    for (int i = 5; i >= 0; --i) color = color * x + c[i];
    return color.cwiseMax(0.0).cwiseMin(1.0);
}

}  // namespace crofton
