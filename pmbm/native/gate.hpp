// Which measurements lie in the gate of which Gaussian, and what the undetected objects behind a
// measurement look like.  The plain versions are gating.py, _fused() of update.py and what
// is named beside each function.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
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

// Innovation.of() of gaussian.py, of one Gaussian.
struct Innovation {
    double x, y, l11, l21, l22;

    Innovation(double x, double y, double l11, double l21, double l22)
        : x(x), y(y), l11(l11), l21(l21), l22(l22) {}

    Innovation(const double* mean, const double* P, const double* R)
        : x(mean[0]), y(mean[1]), l11(std::sqrt(P[0] + R[0])), l21((P[4] + R[2]) / l11),
          l22(std::sqrt(P[5] + R[3] - l21 * l21)) {}

    // log of the height of the density of measurements.
    double log_norm() const {
        static const double log_2pi = std::log(2 * std::acos(-1.0));
        return -log_2pi - std::log(l11) - std::log(l22);
    }

    // Of a measurement.
    std::array<double, 2> whitened(const double* z) const {
        const double y0 = (z[0] - x) / l11;
        return {y0, (z[1] - y - l21 * y0) / l22};
    }
};

// N Gaussians of measurements: centres (N,2) and lower Cholesky factors.
struct Innovations {
    const double *expected, *l11, *l21, *l22;
    std::size_t count;

    Innovation operator[](std::size_t i) const {
        return {expected[2 * i], expected[2 * i + 1], l11[i], l21[i], l22[i]};
    }
};

// The innovations of many, and the log of `prior` times the height of each.
struct Expected {
    std::vector<double> centre, l11, l21, l22, log_height;

    // `prior` is a weight, or its log.
    Expected(const double* mean, const double* cov, const double* R, const double* prior,
             bool prior_is_log, std::size_t count)
        : centre(2 * count), l11(count), l21(count), l22(count), log_height(count) {
        for (std::size_t i = 0; i < count; ++i) {
            const Innovation one(mean + 4 * i, cov + 16 * i, R);
            centre[2 * i] = one.x;
            centre[2 * i + 1] = one.y;
            l11[i] = one.l11;
            l21[i] = one.l21;
            l22[i] = one.l22;
            log_height[i] = (prior_is_log ? prior[i] : std::log(prior[i])) + one.log_norm();
        }
    }

    Innovations view() const {
        return {centre.data(), l11.data(), l21.data(), l22.data(), l11.size()};
    }
};

struct Hit {
    std::int64_t measurement;
    double y0, y1;
};

// Finds the measurements z (M,2) of squared distance below a threshold.
class Gate {
 public:
    Gate(const double* z, std::size_t measurements, double threshold)
        : z_(z), measurements_(measurements), threshold_(threshold), grid_(z, measurements) {}

    // Calls visit(measurement, y0, y1), in no order, with the whitened innovation.
    template <typename Visit>
    void each(const Innovation& g, Visit visit) const {
        if (!measurements_) return;
        // The gate's ellipse touches its bounding box, so rounding gets a little room.
        const double reach = std::sqrt(threshold_) * (1 + 1e-9);
        grid_.in_box(g.x, g.y, reach * g.l11, reach * std::sqrt(g.l21 * g.l21 + g.l22 * g.l22),
                     [&](std::int64_t j) {
                         const auto [y0, y1] = g.whitened(z_ + 2 * j);
                         if (y0 * y0 + y1 * y1 < threshold_) visit(j, y0, y1);
                     });
    }

    // The same in their order.
    void sorted(const Innovation& g, std::vector<Hit>& hits) const {
        hits.clear();
        each(g, [&](std::int64_t j, double y0, double y1) { hits.push_back({j, y0, y1}); });
        std::sort(hits.begin(), hits.end(),
                  [](const Hit& a, const Hit& b) { return a.measurement < b.measurement; });
    }

 private:
    const double* z_;
    std::size_t measurements_;
    double threshold_;
    Grid grid_;
};

// Calls visit(i, measurement, y0, y1) for every pair of squared distance below `threshold`, by
// Gaussian; a Gaussian's measurements come in no order.
template <typename Visit>
void each_gated(const Innovations& g, const double* z, std::size_t measurements, double threshold,
                Visit visit) {
    const Gate gate(z, measurements, threshold);
    for (std::size_t i = 0; i < g.count; ++i) {
        gate.each(g[i], [&](std::int64_t j, double y0, double y1) { visit(i, j, y0, y1); });
    }
}

// log of the sum of exp(value) for each of M measurements; -inf where nothing was added.
class LogSums {
 public:
    explicit LogSums(std::size_t measurements) : top_(measurements, kNone), sum_(measurements, 0.0) {}

    void add(std::int64_t j, double value) {
        if (value == kNone) return;
        if (value > top_[j]) {
            sum_[j] = sum_[j] * std::exp(top_[j] - value) + 1;
            top_[j] = value;
        } else {
            sum_[j] += std::exp(value - top_[j]);
        }
    }

    std::vector<double> found() && {
        for (std::size_t j = 0; j < top_.size(); ++j) {
            if (sum_[j] > 0) top_[j] += std::log(sum_[j]);
        }
        return std::move(top_);
    }

 private:
    static constexpr double kNone = -std::numeric_limits<double>::infinity();
    std::vector<double> top_, sum_;
};

// log of the sum, over the Gaussians in whose gate a measurement lies, of exp(log_height) times the
// Gaussian's shape exp(-d^2 / 2); -inf where it lies in none.
inline std::vector<double> log_density(const Innovations& g, const double* log_height,
                                       const double* z, std::size_t measurements,
                                       double threshold) {
    LogSums sums(measurements);
    each_gated(g, z, measurements, threshold,
               [&](std::size_t i, std::int64_t j, double y0, double y1) {
                   sums.add(j, log_height[i] - 0.5 * (y0 * y0 + y1 * y1));
               });
    return std::move(sums).found();
}

// Share of a measurement's density that comes from a Gaussian of that origin.
struct OriginShare {
    std::int64_t measurement, origin;
    double share;
};

// _explained() of recycling.py: the origin that makes up most of each measurement's density, and its
// share; -1 and 0 where there is none.
inline void explained(std::vector<OriginShare>&& parts, std::size_t measurements,
                      std::vector<std::int64_t>& origins, std::vector<double>& shares) {
    std::stable_sort(parts.begin(), parts.end(), [](const OriginShare& a, const OriginShare& b) {
        return a.measurement != b.measurement ? a.measurement < b.measurement
                                              : a.origin < b.origin;
    });
    origins.assign(measurements, -1);
    shares.assign(measurements, 0.0);
    for (std::size_t i = 0, end = 0; i < parts.size(); i = end) {
        const auto j = static_cast<std::size_t>(parts[i].measurement);
        double share = 0;
        for (end = i; end < parts.size() && parts[end].measurement == parts[i].measurement &&
                      parts[end].origin == parts[i].origin;
             ++end) {
            share += parts[end].share;
        }
        if (share < shares[j]) continue;
        origins[j] = parts[i].origin;
        shares[j] = share;
    }
}

// The same of Gaussians of an origin, or of -1, each, and of a share that is of it; `log_total` is
// the log of each measurement's density.
inline void explained(const Innovations& g, const double* log_height, const std::int64_t* origin,
                      const double* share_of_origin, const double* z, const double* log_total,
                      std::size_t measurements, double threshold, std::vector<std::int64_t>& origins,
                      std::vector<double>& shares) {
    std::vector<OriginShare> parts;
    each_gated(g, z, measurements, threshold,
               [&](std::size_t i, std::int64_t j, double y0, double y1) {
                   const double value = log_height[i] - 0.5 * (y0 * y0 + y1 * y1);
                   if (origin[i] < 0 || !(value > -std::numeric_limits<double>::infinity())) return;
                   parts.push_back(
                       {j, origin[i], std::exp(value - log_total[j]) * share_of_origin[i]});
               });
    explained(std::move(parts), measurements, origins, shares);
}

// _resumed() of recycling.py: of each measurement the origin that explains more than `most` of it,
// or -1; not one of `known`, and each origin once, where probability (M,) times share is largest.
inline std::vector<std::int64_t> resumed(std::vector<std::int64_t> origins,
                                         const std::vector<double>& shares, double most,
                                         const double* probability, const std::int64_t* known,
                                         std::size_t known_count) {
    struct Claim {
        std::int64_t origin;
        double strength;
        std::size_t measurement;
    };
    std::vector<Claim> claims;
    for (std::size_t j = 0; j < origins.size(); ++j) {
        if (shares[j] > most) claims.push_back({origins[j], probability[j] * shares[j], j});
        origins[j] = -1;
    }
    std::sort(claims.begin(), claims.end(), [](const Claim& a, const Claim& b) {
        if (a.origin != b.origin) return a.origin < b.origin;
        return a.strength != b.strength ? a.strength < b.strength : a.measurement < b.measurement;
    });
    for (std::size_t i = 0; i < claims.size(); ++i) {
        const bool strongest = i + 1 == claims.size() || claims[i + 1].origin != claims[i].origin;
        if (strongest) origins[claims[i].measurement] = claims[i].origin;
    }
    if (claims.empty()) return origins;
    for (std::size_t t = 0; t < known_count; ++t) {
        const auto at = std::upper_bound(
            claims.begin(), claims.end(), known[t],
            [](std::int64_t origin, const Claim& claim) { return origin < claim.origin; });
        if (at != claims.begin() && (at - 1)->origin == known[t]) {
            origins[(at - 1)->measurement] = -1;
        }
    }
    return origins;
}

// A Kalman update but for the measurement: gain W for whitened innovations, and covariance after.
// gain() and corrected_cov() of gaussian.py say why the position block is what it is.
struct Correction {
    double W[8], after[16];

    Correction(const double* P, const Innovation& g, const double* R) {
        for (int a = 0; a < 4; ++a) {
            W[2 * a] = P[4 * a] / g.l11;
            W[2 * a + 1] = (P[4 * a + 1] - g.l21 * W[2 * a]) / g.l22;
        }
        double V[4];
        for (int a = 0; a < 2; ++a) {
            V[2 * a] = R[2 * a] / g.l11;
            V[2 * a + 1] = (R[2 * a + 1] - g.l21 * V[2 * a]) / g.l22;
        }
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) {
                after[4 * a + b] =
                    a < 2 && b < 2
                        ? R[2 * a + b] - V[2 * a] * V[2 * b] - V[2 * a + 1] * V[2 * b + 1]
                        : P[4 * a + b] - (W[2 * a] * W[2 * b] + W[2 * a + 1] * W[2 * b + 1]);
            }
        }
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < a; ++b) {
                const double both = 0.5 * (after[4 * a + b] + after[4 * b + a]);
                after[4 * a + b] = after[4 * b + a] = both;
            }
        }
    }
};

// F m and F P F' + Q of a Gaussian.
inline void move(const double* m, const double* P, const double* F, const double* Q, double* mean,
                 double* cov) {
    double FP[16];
    for (int a = 0; a < 4; ++a) {
        const double* f = F + 4 * a;
        mean[a] = f[0] * m[0] + f[1] * m[1] + f[2] * m[2] + f[3] * m[3];
        for (int b = 0; b < 4; ++b) {
            FP[4 * a + b] = f[0] * P[b] + f[1] * P[4 + b] + f[2] * P[8 + b] + f[3] * P[12 + b];
        }
    }
    for (int a = 0; a < 4; ++a) {
        for (int b = 0; b <= a; ++b) {
            const double *row = FP + 4 * a, *f = F + 4 * b;
            cov[4 * a + b] = cov[4 * b + a] = Q[4 * a + b] + row[0] * f[0] + row[1] * f[1] +
                                              row[2] * f[2] + row[3] * f[3];
        }
    }
}

// The same of many.
inline void move(const double* mean, const double* cov, std::size_t count, const double* F,
                 const double* Q, std::vector<double>& means, std::vector<double>& covs) {
    means.resize(4 * count);
    covs.resize(16 * count);
    for (std::size_t i = 0; i < count; ++i) {
        move(mean + 4 * i, cov + 16 * i, F, Q, means.data() + 4 * i, covs.data() + 16 * i);
    }
}

// What a measurement says alone: mean (4) at it and at rest, cov (4,4) of R in both blocks.
inline void unexplained(const double* z, const double* R, double* mean, double* cov) {
    for (int a = 0; a < 2; ++a) {
        mean[a] = z[a];
        for (int b = 0; b < 2; ++b) cov[4 * a + b] = cov[4 * (a + 2) + b + 2] = R[2 * a + b];
    }
}

// Gaussians that make up a share of the density of a measurement z (M,2) each, as one Gaussian.
class Fusion {
 public:
    Fusion(const double* z, std::size_t measurements)
        : z_(z), first_(4 * measurements, 0.0), second_(16 * measurements, 0.0) {}

    // mean (4), cov (16) : after measurement j.
    void add(std::int64_t j, double share, const double* mean, const double* cov) {
        double apart[4];
        for (int a = 0; a < 4; ++a) {
            apart[a] = mean[a] - (a < 2 ? z_[2 * j + a] : 0.0);
            first_[4 * j + a] += share * apart[a];
        }
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) {
                second_[16 * j + 4 * a + b] += share * (cov[4 * a + b] + apart[a] * apart[b]);
            }
        }
    }

    // mean (M,4), cov (M,4,4) of those whose density, of log `log_total` (M,), is not zero; what is
    // there stays of the others.
    void write(const double* log_total, double* mean, double* cov) const {
        for (std::size_t j = 0; 4 * j < first_.size(); ++j) {
            if (!(log_total[j] > -std::numeric_limits<double>::infinity())) continue;
            for (int a = 0; a < 4; ++a) {
                mean[4 * j + a] = first_[4 * j + a] + (a < 2 ? z_[2 * j + a] : 0.0);
                for (int b = 0; b < 4; ++b) {
                    cov[16 * j + 4 * a + b] =
                        second_[16 * j + 4 * a + b] - first_[4 * j + a] * first_[4 * j + b];
                }
            }
        }
    }

 private:
    const double* z_;
    // Moments about the measurement itself, at rest: near the mean, so that little cancels.
    std::vector<double> first_, second_;
};

// The Gaussians (mean_of, cov_of) in whose gate each measurement lies, corrected by it and weighted
// by their share in its density, whose log is `log_total`, as one Gaussian: mean (M,4) and
// cov (M,4,4).  A measurement that lies in no gate keeps what is there.
inline void fuse(const Innovations& g, const double* log_height, const double* mean_of,
                 const double* cov_of, const double* R, const double* z, const double* log_total,
                 std::size_t measurements, double threshold, double* mean, double* cov) {
    // Of the Gaussian that was visited last: they come one after another, and most lie in no gate.
    std::optional<Correction> correction;
    std::size_t corrected = 0;
    Fusion fusion(z, measurements);
    each_gated(g, z, measurements, threshold,
               [&](std::size_t i, std::int64_t j, double y0, double y1) {
                   if (!correction || corrected != i) {
                       correction.emplace(cov_of + 16 * i, g[i], R);
                       corrected = i;
                   }
                   const auto& c = *correction;
                   double after[4];
                   for (int a = 0; a < 4; ++a) {
                       after[a] = mean_of[4 * i + a] + c.W[2 * a] * y0 + c.W[2 * a + 1] * y1;
                   }
                   fusion.add(j, std::exp(log_height[i] - 0.5 * (y0 * y0 + y1 * y1) - log_total[j]),
                              after, c.after);
               });
    fusion.write(log_total, mean, cov);
}

}  // namespace pmbm
