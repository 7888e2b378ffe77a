#include "framework/exact_tree.h"

#include <algorithm>
#include <numeric>
#include <span>

namespace crofton::exact {
namespace {

constexpr size_t leaf_size = 3;

double center(const Box& b, int axis) { return b.lower[axis] / 2 + b.upper[axis] / 2; }

int widest_axis(const std::vector<Box>& boxes, std::span<const uint32_t> shapes) {
    double width[3];
    for (int a = 0; a < 3; ++a) {
        double lo = INFINITY, hi = -INFINITY;
        for (uint32_t s : shapes) {
            lo = std::min(lo, center(boxes[s], a));
            hi = std::max(hi, center(boxes[s], a));
        }
        width[a] = hi - lo;
    }
    return int(std::max_element(width, width + 3) - width);
}

}  // namespace

void Tree::build(const std::vector<Box>& boxes, std::vector<uint32_t>& order) {
    order.resize(boxes.size());
    std::iota(order.begin(), order.end(), 0);
    struct Task {
        uint32_t begin, end;
        int64_t parent;  ///< whose second child this is, or -1
    };
    std::vector<Task> tasks;
    if (!order.empty()) tasks.push_back({0, uint32_t(order.size()), -1});
    while (!tasks.empty()) {
        const Task task = tasks.back();
        tasks.pop_back();
        if (task.parent >= 0) nodes[size_t(task.parent)].first = uint32_t(nodes.size());
        Node node;
        for (uint32_t i = task.begin; i < task.end; ++i) node.box.extend(boxes[order[i]]);
        const uint32_t count = task.end - task.begin;
        if (count <= leaf_size) {
            node.first = task.begin;
            node.count = count;
        } else {
            const int axis = widest_axis(boxes, {order.data() + task.begin, count});
            const uint32_t middle = task.begin + count / 2;
            std::nth_element(order.begin() + task.begin, order.begin() + middle,
                             order.begin() + task.end, [&](uint32_t a, uint32_t b) {
                                 return center(boxes[a], axis) < center(boxes[b], axis);
                             });
            // The first child is made next, right behind its parent.
            tasks.push_back({middle, task.end, int64_t(nodes.size())});
            tasks.push_back({task.begin, middle, -1});
        }
        nodes.push_back(node);
    }
}

bool passes(const DoubleRay& ray, const Box& box, double scale, double& near, double& far) {
    double pad = 0;
    if (scale > 0) {
        double reach = 0;
        for (int a = 0; a < 3; ++a)
            reach = std::max(reach, std::max(std::abs(box.lower[a] - ray.o[a]),
                                             std::abs(box.upper[a] - ray.o[a])));
        // The sheared coordinates' displacement, as one in space, with room for both of them.
        pad = scale * (2 * triangle_bound * (reach + box.size) + least_bound);
    }
    near = -INFINITY;
    far = INFINITY;
    for (int a = 0; a < 3; ++a) {
        const double lo = box.lower[a] - pad, hi = box.upper[a] + pad;
        if (ray.d[a] == 0) {
            if (ray.o[a] < lo || ray.o[a] > hi) return false;
            continue;
        }
        const double p = (lo - ray.o[a]) / ray.d[a], q = (hi - ray.o[a]) / ray.d[a];
        near = std::max(near, std::min(p, q) - 0x1p-50 * std::abs(std::min(p, q)));
        far = std::min(far, std::max(p, q) + 0x1p-50 * std::abs(std::max(p, q)));
    }
    return near <= far;
}

}  // namespace crofton::exact
