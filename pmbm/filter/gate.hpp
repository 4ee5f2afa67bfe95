// Which measurements lie in the gate of which Gaussian, and what the undetected objects behind a
// measurement look like.  The plain versions are gate() of gating.py and _fused() of update.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace pmbm {

// Points of the plane in square cells, about one to a cell.
class Grid {
 public:
    Grid(const double* points, std::size_t count) {
        double low[2] = {0, 0}, high[2] = {0, 0};
        for (int axis = 0; axis < 2 && count; ++axis) {
            low[axis] = high[axis] = points[axis];
            for (std::size_t i = 1; i < count; ++i) {
                low[axis] = std::min(low[axis], points[2 * i + axis]);
                high[axis] = std::max(high[axis], points[2 * i + axis]);
            }
        }
        const double width = high[0] - low[0], height = high[1] - low[1];
        const double n = static_cast<double>(std::max<std::size_t>(count, 1));
        // A line of points has no area; its cells are as long as it needs.
        side_ = std::max({std::sqrt(width * height / n), std::max(width, height) / n, 1e-9});
        for (int axis = 0; axis < 2; ++axis) {
            low_[axis] = low[axis];
            cells_[axis] = 1 + static_cast<std::int64_t>((high[axis] - low[axis]) / side_);
        }
        start_.assign(static_cast<std::size_t>(cells_[0] * cells_[1]) + 1, 0);
        std::vector<std::size_t> cell(count);
        for (std::size_t i = 0; i < count; ++i) {
            cell[i] = static_cast<std::size_t>(at(points[2 * i], 0) * cells_[1] +
                                               at(points[2 * i + 1], 1));
            ++start_[cell[i] + 1];
        }
        for (std::size_t i = 1; i < start_.size(); ++i) start_[i] += start_[i - 1];
        point_.resize(count);
        auto next = start_;
        for (std::size_t i = 0; i < count; ++i) {
            point_[next[cell[i]]++] = static_cast<std::int64_t>(i);
        }
    }

    // Calls visit(point) for all points of the box and perhaps some around it.
    template <typename Visit>
    void in_box(double x, double y, double half_width, double half_height, Visit visit) const {
        const auto first = at(y - half_height, 1), last = at(y + half_height, 1);
        for (auto column = at(x - half_width, 0); column <= at(x + half_width, 0); ++column) {
            const auto row = static_cast<std::size_t>(column * cells_[1]);
            const auto from = start_[row + static_cast<std::size_t>(first)];
            const auto to = start_[row + static_cast<std::size_t>(last) + 1];
            for (auto i = from; i < to; ++i) visit(point_[i]);
        }
    }

 private:
    std::int64_t at(double coordinate, int axis) const {
        const double cell = std::floor((coordinate - low_[axis]) / side_);
        const double last = static_cast<double>(cells_[axis] - 1);
        return static_cast<std::int64_t>(std::clamp(cell, 0.0, last));
    }

    double side_ = 1, low_[2] = {0, 0};
    std::int64_t cells_[2] = {1, 1};
    std::vector<std::size_t> start_;
    std::vector<std::int64_t> point_;
};

// N Gaussians of measurements: centres (N,2) and lower Cholesky factors.
struct Innovations {
    const double *expected, *l11, *l21, *l22;
    std::size_t count;
};

// All pairs below `threshold`, sorted by Gaussian, then measurement, with whitened innovations.
inline void gate(const Innovations& g, const double* z, std::size_t measurements, double threshold,
                 std::vector<std::int64_t>& rows, std::vector<std::int64_t>& columns,
                 std::vector<double>& whitened) {
    if (!measurements) return;
    const Grid grid(z, measurements);
    struct Hit {
        std::int64_t measurement;
        double y0, y1;
    };
    std::vector<Hit> hits;
    // The gate's ellipse touches its bounding box, so rounding gets a little room.
    const double reach = std::sqrt(threshold) * (1 + 1e-9);
    for (std::size_t i = 0; i < g.count; ++i) {
        const double x = g.expected[2 * i], y = g.expected[2 * i + 1];
        hits.clear();
        grid.in_box(x, y, reach * g.l11[i], reach * std::hypot(g.l21[i], g.l22[i]),
                    [&](std::int64_t j) {
                        const double y0 = (z[2 * j] - x) / g.l11[i];
                        const double y1 = (z[2 * j + 1] - y - g.l21[i] * y0) / g.l22[i];
                        if (y0 * y0 + y1 * y1 < threshold) hits.push_back({j, y0, y1});
                    });
        std::sort(hits.begin(), hits.end(),
                  [](const Hit& a, const Hit& b) { return a.measurement < b.measurement; });
        for (const auto& hit : hits) {
            rows.push_back(static_cast<std::int64_t>(i));
            columns.push_back(hit.measurement);
            whitened.push_back(hit.y0);
            whitened.push_back(hit.y1);
        }
    }
}

// n mixtures of 4-dimensional Gaussians as one Gaussian each.  Pair p adds component[p], moved by
// gain x whitened innovation, to the mixture target[p] (none below 0) with weight exp(log_weight).
// Mixtures without a pair are left alone.
struct Mixtures {
    const std::int64_t *component, *target;
    const double *log_weight, *whitened;
    std::size_t pairs;
    const double *mean, *gain, *cov;
};

inline void fuse(const Mixtures& m, std::size_t count, double* mean, double* cov) {
    std::vector<double> top(count, -std::numeric_limits<double>::infinity());
    for (std::size_t p = 0; p < m.pairs; ++p) {
        if (m.target[p] >= 0) top[m.target[p]] = std::max(top[m.target[p]], m.log_weight[p]);
    }
    const auto moved = [&m](std::size_t p, int i) {
        const auto c = m.component[p];
        const double* W = m.gain + 8 * c + 2 * i;
        return m.mean[4 * c + i] + W[0] * m.whitened[2 * p] + W[1] * m.whitened[2 * p + 1];
    };
    std::vector<double> share(m.pairs, 0.0), total(count, 0.0);
    for (std::size_t p = 0; p < m.pairs; ++p) {
        const auto t = m.target[p];
        if (t < 0) continue;
        if (total[t] == 0) std::fill_n(mean + 4 * t, 4, 0.0);
        share[p] = std::exp(m.log_weight[p] - top[t]);
        total[t] += share[p];
        for (int i = 0; i < 4; ++i) mean[4 * t + i] += share[p] * moved(p, i);
    }
    for (std::size_t t = 0; t < count; ++t) {
        if (total[t] == 0) continue;
        for (int i = 0; i < 4; ++i) mean[4 * t + i] /= total[t];
        std::fill_n(cov + 16 * t, 16, 0.0);
    }
    for (std::size_t p = 0; p < m.pairs; ++p) {
        const auto t = m.target[p];
        if (t < 0) continue;
        double apart[4];
        for (int i = 0; i < 4; ++i) apart[i] = moved(p, i) - mean[4 * t + i];
        const double* P = m.cov + 16 * m.component[p];
        const double weight = share[p] / total[t];
        for (int i = 0; i < 4; ++i) {
            for (int j = 0; j < 4; ++j) {
                cov[16 * t + 4 * i + j] += weight * (P[4 * i + j] + apart[i] * apart[j]);
            }
        }
    }
}

}  // namespace pmbm
