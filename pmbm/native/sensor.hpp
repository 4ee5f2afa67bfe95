// What a sensor can see, and what a miss says.  The plain versions are _share_inside() of view.py,
// ObservationModel.missed() of sensor.py, and say what is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

namespace pmbm {

struct View {
    const double* pose;
    double centre, half_angle, max_range;
};

// The probability that a standard normal is at most x.
inline double normal_below(double x) { return 0.5 * std::erfc(-x * std::sqrt(0.5)); }

// Distance of a point from the view's boundary, m: negative inside.  beyond() of undetected_map.py.
inline double beyond(const View& view, const double* point) {
    const double pi = std::acos(-1.0);
    const double x = point[0] - view.pose[0], y = point[1] - view.pose[1];
    const double range = std::hypot(x, y), outside = range - view.max_range;
    if (view.half_angle >= pi) return outside;
    const double bearing = std::atan2(y, x) - view.pose[2] - view.centre;
    const double off = std::abs(std::remainder(bearing, 2 * pi)) - view.half_angle;
    const double sign = (off > 0) - (off < 0);
    return std::max(outside, range * (std::abs(off) < pi / 2 ? std::sin(off) : sign));
}

inline void share_inside(const double* mean, const double* cov, std::size_t count, const View& view,
                         double* share) {
    const double pi = std::acos(-1.0);
    for (std::size_t i = 0; i < count; ++i) {
        const double dx = mean[4 * i] - view.pose[0], dy = mean[4 * i + 1] - view.pose[1];
        const double distance = std::sqrt(dx * dx + dy * dy);
        const double sd = std::sqrt(std::max(cov[16 * i] + cov[16 * i + 5], 1e-12) / 2);
        const double range = std::sqrt(distance * distance + sd * sd);
        share[i] = normal_below((view.max_range - range) / sd);
        if (!(view.half_angle < pi)) continue;
        const double bearing = std::atan2(dy, dx) - view.pose[2] - view.centre;
        const double off_centre = std::abs(std::remainder(bearing, 2 * pi));
        share[i] *= normal_below((view.half_angle - off_centre) * distance / sd);
    }
}

// Existence after a miss, and the weight of missing, by Bayes' rule.
inline void missed(const double* r, const double* P_D, std::size_t count, double* existence,
                   double* left) {
    for (std::size_t i = 0; i < count; ++i) {
        left[i] = 1 - r[i] * P_D[i];
        existence[i] = left[i] > 0 ? r[i] * (1 - P_D[i]) / left[i] : 0.0;
    }
}

}  // namespace pmbm
