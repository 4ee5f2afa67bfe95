// Gating and update by measurements each of which has a covariance of its own, and perhaps a radial
// velocity: a radar's.  The plain version is gating.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gate.hpp"

namespace pmbm {

// The columns of `RadarScan`: R (M,2,2), sight (M,2), speed (M,) or null, variance (M,).
struct RadarView {
    const double *R, *sight, *speed, *variance;
};

// A Gaussian after a radar's measurement j of position z (2), the log density of the measurement
// under it, and their squared distance.
struct RadarUpdate {
    double distance, log_density, mean[4], cov[16];

    RadarUpdate(const double* m, const double* P, const double* z, const RadarView& radar,
                std::size_t j) {
        const double* R = radar.R + 4 * j;
        const Innovation g(m, P, R);
        const Correction c(P, g, R);
        const auto [y0, y1] = g.whitened(z);
        distance = y0 * y0 + y1 * y1;
        log_density = g.log_norm() - 0.5 * distance;
        for (int a = 0; a < 4; ++a) mean[a] = m[a] + c.W[2 * a] * y0 + c.W[2 * a + 1] * y1;
        std::copy_n(c.after, 16, cov);
        if (radar.speed) take_in_speed(radar.sight + 2 * j, radar.speed[j], radar.variance[j]);
    }

 private:
    void take_in_speed(const double* sight, double speed, double variance) {
        static const double log_2pi = std::log(2 * std::acos(-1.0));
        double PH[4];
        for (int a = 0; a < 4; ++a) {
            PH[a] = cov[4 * a + 2] * sight[0] + cov[4 * a + 3] * sight[1];
        }
        const double S = PH[2] * sight[0] + PH[3] * sight[1] + variance;
        const double error = speed - (sight[0] * mean[2] + sight[1] * mean[3]);
        const double further = error * error / S;
        distance += further;
        log_density -= 0.5 * (log_2pi + std::log(S) + further);
        for (int a = 0; a < 4; ++a) {
            mean[a] += PH[a] / S * error;
            for (int b = 0; b < 4; ++b) cov[4 * a + b] -= PH[a] * PH[b] / S;
        }
    }
};

// Finds a radar's measurements z (M,2) of squared distance below a threshold.
class RadarGate {
 public:
    RadarGate(const double* z, std::size_t measurements, const RadarView& radar, double threshold)
        : z_(z), measurements_(measurements), radar_(radar), threshold_(threshold),
          grid_(z, measurements) {
        for (std::size_t j = 0; j < measurements; ++j) {
            widest_[0] = std::max(widest_[0], radar.R[4 * j]);
            widest_[1] = std::max(widest_[1], radar.R[4 * j + 3]);
        }
    }

    struct Pair {
        std::int64_t measurement;
        double log_density;
    };

    // Those of a Gaussian, in their order.
    void sorted(const double* mean, const double* P, std::vector<Pair>& pairs) const {
        pairs.clear();
        if (!measurements_) return;
        const double reach = std::sqrt(threshold_) * (1 + 1e-9);
        grid_.in_box(mean[0], mean[1], reach * std::sqrt(P[0] + widest_[0]),
                     reach * std::sqrt(P[5] + widest_[1]), [&](std::int64_t j) {
                         const RadarUpdate after(mean, P, z_ + 2 * j, radar_,
                                                 static_cast<std::size_t>(j));
                         if (after.distance < threshold_) pairs.push_back({j, after.log_density});
                     });
        std::sort(pairs.begin(), pairs.end(),
                  [](const Pair& a, const Pair& b) { return a.measurement < b.measurement; });
    }

 private:
    const double* z_;
    std::size_t measurements_;
    RadarView radar_;
    double threshold_;
    Grid grid_;
    double widest_[2] = {0, 0};
};

}  // namespace pmbm
