// Lines of sight to upright boxes.  The plain version, of the same name, is in rays.py and says what
// is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace pmbm {

// Directions of the bearings' centres.
struct Compass {
    const double *cos, *sin;
    std::int64_t bearings;
};

struct BoxRays {
    std::vector<std::int64_t> first{0}, bearing, margin, cores;
    std::vector<double> distance;
};

constexpr double kPi = 3.14159265358979323846;
// Of a bearing: what lies nearer below its edge is on the edge.
constexpr double kOnEdge = 1e-6;

// The bearings first to last whose centres lie within an extent; none where last < first.
struct Extent {
    std::int64_t first, last;

    static Extent of(double low, double high, double step) {
        return {static_cast<std::int64_t>(std::ceil(low / step - 0.5)),
                static_cast<std::int64_t>(std::floor(high / step - 0.5))};
    }
};

// An angle from another one, in [-pi, pi).
inline double turn_from(double angle, double from) {
    const double turned = std::fmod(angle - from + kPi, 2 * kPi);
    return (turned < 0 ? turned + 2 * kPi : turned) - kPi;
}

inline double not_zero(double value) {
    return std::copysign(std::max(std::abs(value), 1e-12), value);
}

// offset (B,2) : centres in the sensor's frame.  box (B,5).  yaw : of the sensor.  widen (B,).
inline BoxRays box_rays(const double* offset, const double* box, const double* widen,
                        std::size_t boxes, double yaw, const Compass& compass) {
    constexpr double corner[4][2] = {{0.5, 0.5}, {-0.5, 0.5}, {-0.5, -0.5}, {0.5, -0.5}};
    const double step = 2 * kPi / static_cast<double>(compass.bearings);
    BoxRays rays;
    rays.first.reserve(boxes + 1);
    for (std::size_t b = 0; b < boxes; ++b) {
        const double X = offset[2 * b], Y = offset[2 * b + 1], turned = box[5 * b + 4] - yaw;
        const double length = box[5 * b + 1], width = box[5 * b + 2];
        const double cos = std::cos(turned), sin = std::sin(turned);
        const double x = -(X * cos + Y * sin), y = X * sin - Y * cos;
        const double range = std::hypot(X, Y), middle = std::atan2(Y, X);
        double low = kPi, high = -kPi;
        for (const auto& at : corner) {
            const double along = at[0] * length, across = at[1] * width;
            const double turn = turn_from(std::atan2(Y + along * sin + across * cos,
                                                     X + along * cos - across * sin),
                                          middle);
            low = std::min(low, turn);
            high = std::max(high, turn);
        }
        auto core = Extent::of(middle + low, middle + high, step);
        if (core.last < core.first) {
            core.first = core.last =
                static_cast<std::int64_t>(std::floor(middle / step + kOnEdge));
        }
        const double margin = std::atan2(widen[b], std::max(range, 1e-9));
        auto all = Extent::of(middle + std::max(low - margin, -3.0),
                              middle + std::min(high + margin, 3.0), step);
        all = {std::min(core.first, all.first), std::max(core.last, all.last)};

        const bool around = std::abs(x) <= 0.5 * length && std::abs(y) <= 0.5 * width;
        for (auto ray = all.first; !around && ray <= all.last; ++ray) {
            const auto bearing = ((ray % compass.bearings) + compass.bearings) % compass.bearings;
            const double to_x = compass.cos[bearing], to_y = compass.sin[bearing];
            const double per_x = 1 / not_zero(to_x * cos + to_y * sin);
            const double per_y = 1 / not_zero(to_y * cos - to_x * sin);
            const double at_x = -x * per_x, at_y = -y * per_y;
            const double within_x = 0.5 * length * std::abs(per_x);
            const double within_y = 0.5 * width * std::abs(per_y);
            const double enter = std::max(at_x - within_x, at_y - within_y);
            const double leave = std::min(at_x + within_x, at_y + within_y);
            rays.bearing.push_back(bearing);
            rays.distance.push_back(enter <= leave && enter > 0 ? enter : range);
        }
        rays.first.push_back(static_cast<std::int64_t>(rays.bearing.size()));
        rays.margin.push_back(core.first - all.first);
        rays.cores.push_back(around ? 0 : core.last - core.first + 1);
    }
    return rays;
}

}  // namespace pmbm
