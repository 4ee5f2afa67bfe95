// Which Gaussians of a mixture lie together.  The plain version is _merge_groups() of reduction.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "gate.hpp"

namespace pmbm {

// A covariance's lower Cholesky factor, for squared Mahalanobis distances of n = 4 dimensions.
struct Cholesky {
    double L[16];

    explicit Cholesky(const double* P) {
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b <= a; ++b) {
                double sum = P[4 * a + b];
                for (int c = 0; c < b; ++c) sum -= L[4 * a + c] * L[4 * b + c];
                L[4 * a + b] = a == b ? std::sqrt(sum) : sum / L[4 * b + b];
            }
        }
    }

    double squared_distance(const double* apart) const {
        double y[4], total = 0;
        for (int a = 0; a < 4; ++a) {
            y[a] = apart[a];
            for (int c = 0; c < a; ++c) y[a] -= L[4 * a + c] * y[c];
            y[a] /= L[4 * a + a];
            total += y[a] * y[a];
        }
        return total;
    }
};

// The component, by row, that each one is merged into: the heaviest first takes in the lighter ones
// below `threshold` under either covariance whose log position areas differ by at most `alike`; log
// weights that differ by less than `as_heavy` are equal, and the first of them comes first.
inline std::vector<std::int64_t> merge_groups(const double* log_weight, const double* mean,
                                              const double* cov, std::size_t count,
                                              double threshold, double alike, double as_heavy) {
    std::vector<double> area(count), place(2 * count);
    std::vector<Cholesky> root;
    for (std::size_t i = 0; i < count; ++i) {
        const double* P = cov + 16 * i;
        const double determinant = P[0] * P[5] - P[1] * P[1];
        area[i] = 0.5 * std::log(std::max(determinant, std::numeric_limits<double>::min()));
        root.emplace_back(P);
        place[2 * i] = mean[4 * i];
        place[2 * i + 1] = mean[4 * i + 1];
    }
    std::vector<std::int64_t> group(count), order(count);
    std::iota(group.begin(), group.end(), 0);
    std::iota(order.begin(), order.end(), 0);
    std::vector<double> heavy(count);
    for (std::size_t i = 0; i < count; ++i) heavy[i] = std::nearbyint(log_weight[i] / as_heavy);
    std::stable_sort(order.begin(), order.end(),
                     [&](auto a, auto b) { return heavy[a] > heavy[b]; });
    std::vector<unsigned char> free(count, 1);
    const Grid grid(place.data(), count);
    for (const auto head : order) {
        if (!free[head]) continue;
        free[head] = 0;
        const double* P = cov + 16 * head;
        // A distance below the threshold is one below it along each axis alone.
        const double half_width = std::sqrt(threshold * P[0]) * (1 + 1e-9);
        const double half_height = std::sqrt(threshold * P[5]) * (1 + 1e-9);
        grid.in_box(place[2 * head], place[2 * head + 1], half_width, half_height,
                    [&](std::int64_t other) {
                        if (!free[other] || std::abs(area[head] - area[other]) > alike) return;
                        double apart[4];
                        for (int a = 0; a < 4; ++a) {
                            apart[a] = mean[4 * other + a] - mean[4 * head + a];
                        }
                        if (!(root[head].squared_distance(apart) < threshold) ||
                            !(root[other].squared_distance(apart) < threshold)) {
                            return;
                        }
                        free[other] = 0;
                        group[other] = head;
                    });
    }
    return group;
}

}  // namespace pmbm
