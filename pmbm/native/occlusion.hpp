// What tracks and occluders hide.  The plain versions are Shadows and Glimpse of
// pmbm/filter/models/occlusion.py, and say what is meant.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "rays.hpp"

namespace pmbm {

// Constants of occlusion.py and rays.py, handed over so that they stand once.
struct OcclusionRules {
    double ignored_existence, certain, touching, vague, moves, car_sd, least_visible, far;
    // Points (count,2) of equal weight that stand for a standard normal.
    const double* nodes;
    std::size_t count;
    Compass compass;
};

// Convex polygons: outline p has the corners start[p] to start[p + 1].
struct Polygons {
    const std::int64_t* start;
    const double* corner;
    std::size_t count;
};

struct GaussiansView {
    const double *mean, *cov;
};

inline bool is_vague(const double* cov, const OcclusionRules& rules) {
    return cov[0] + cov[5] > 2 * rules.vague * rules.vague;
}

// Standard deviation of a position across the line of sight.
inline double across(const double* pose, const double* mean, const double* cov) {
    const double x = mean[0] - pose[0], y = mean[1] - pose[1];
    const double range = std::max(std::hypot(x, y), 1e-9);
    const double nx = -y / range, ny = x / range;
    const double variance = nx * (nx * cov[0] + ny * cov[1]) + ny * (nx * cov[4] + ny * cov[5]);
    return std::sqrt(std::max(variance, 0.0));
}

class Shadows;

// What can be seen of one Gaussian over places, point by point; made for one, and used for the next.
struct Glimpse {
    std::vector<double> visible, left;
    std::vector<std::array<double, 2>> node;
    double S[4];

    double share() const {
        return std::accumulate(visible.begin(), visible.end(), 0.0) /
               static_cast<double>(visible.size());
    }

    // Mean and covariance after a miss; `moves` : 0 for undetected objects, whose whole state
    // follows, else OcclusionRules::moves for tracks, whose place alone follows, and in part.
    void if_missed(double in_the_open, double moves, double* mean, double* cov) {
        double total = 0, shift[2] = {0, 0}, spread[4] = {0, 0, 0, 0};
        left.resize(visible.size());
        for (std::size_t k = 0; k < visible.size(); ++k) {
            left[k] = 1 - in_the_open * visible[k];
            total += left[k];
        }
        total = std::max(total, std::numeric_limits<double>::min());
        for (std::size_t k = 0; k < visible.size(); ++k) {
            left[k] /= total;
            for (int a = 0; a < 2; ++a) shift[a] += left[k] * node[k][a];
        }
        for (std::size_t k = 0; k < visible.size(); ++k) {
            const double apart[2] = {node[k][0] - shift[0], node[k][1] - shift[1]};
            for (int a = 0; a < 2; ++a) {
                for (int b = 0; b < 2; ++b) spread[2 * a + b] += left[k] * apart[a] * apart[b];
            }
        }
        const double determinant = S[0] * S[3] - S[1] * S[2];
        double gain[8];
        for (int a = 0; a < 4; ++a) {
            gain[2 * a] = (cov[4 * a] * S[3] - cov[4 * a + 1] * S[2]) / determinant;
            gain[2 * a + 1] = (cov[4 * a + 1] * S[0] - cov[4 * a] * S[1]) / determinant;
        }
        double held = 0;
        if (moves > 0) {
            held = 1 - std::min(moves * share(), 1.0);
            for (int a = 0; a < 2; ++a) {
                for (int b = 0; b < 2; ++b) {
                    spread[2 * a + b] += held * shift[a] * (held * shift[b]);
                }
            }
        }
        for (int a = 0; a < (moves > 0 ? 2 : 4); ++a) {
            mean[a] += (1 - held) * (gain[2 * a] * shift[0] + gain[2 * a + 1] * shift[1]);
        }
        double change[4];
        for (int i = 0; i < 4; ++i) change[i] = spread[i] - S[i];
        double after[16];
        for (int a = 0; a < 4; ++a) {
            const double left_0 = gain[2 * a] * change[0] + gain[2 * a + 1] * change[2];
            const double left_1 = gain[2 * a] * change[1] + gain[2 * a + 1] * change[3];
            for (int b = 0; b < 4; ++b) {
                after[4 * a + b] =
                    cov[4 * a + b] + left_0 * gain[2 * b] + left_1 * gain[2 * b + 1];
            }
        }
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) {
                cov[4 * a + b] = 0.5 * (after[4 * a + b] + after[4 * b + a]);
            }
        }
    }
};

class Shadows {
 public:
    // existence (T,), best (T,) : of the tracks.  The tables of H local hypotheses must outlive it.
    Shadows(const double* pose, const GaussiansView& local, const double* box,
            const std::int64_t* track, std::size_t locals, const double* existence,
            const std::int64_t* best, std::size_t tracks, const Polygons& occluders,
            const OcclusionRules& rules)
        : rules_(rules), pose_(pose), local_(local), box_(box), track_(track), locals_(locals) {
        const double cos = std::cos(pose[2]), sin = std::sin(pose[2]);
        std::vector<double> offset(2 * locals), widen(locals);
        for (std::size_t h = 0; h < locals; ++h) {
            const double x = local.mean[4 * h] - pose[0], y = local.mean[4 * h + 1] - pose[1];
            offset[2 * h] = cos * x + sin * y;
            offset[2 * h + 1] = cos * y - sin * x;
            const double *mean = local.mean + 4 * h, *cov = local.cov + 16 * h;
            widen[h] = is_vague(cov, rules) ? 0.0 : across(pose, mean, cov);
        }
        target_ = box_rays(offset.data(), box, widen.data(), locals, pose[2], rules.compass);
        track_row_.assign(tracks, -1);
        shadowless_.assign(locals, true);
        for (std::size_t t = 0; t < tracks; ++t) {
            if (!(existence[t] > rules.ignored_existence)) continue;
            const auto h = static_cast<std::size_t>(best[t]);
            track_row_[t] = static_cast<std::int64_t>(log_open_.size());
            shadowless_[h] = false;
            const auto from = target_.first[h] + target_.margin[h];
            for (auto i = from; i < from + target_.cores[h]; ++i) {
                bearing_.push_back(target_.bearing[i]);
                distance_.push_back(target_.distance[i]);
            }
            close_outline(std::log1p(-std::min(existence[t], rules.certain)));
        }
        for (std::size_t p = 0; p < occluders.count; ++p) add(occluders, p, cos, sin);
        sort();
    }

    // Expected visible share of each local hypothesis by its bearings.
    void share_of_bearings(double* visible) const {
        for (std::size_t h = 0; h < locals_; ++h) {
            const auto from = target_.first[h], to = target_.first[h + 1];
            visible[h] = 1.0;
            if (key_.empty() || from == to) continue;
            const auto own = shadowless_[h] ? track_row_[track_[h]] : -1;
            double sum = 0;
            for (auto i = from; i < to; ++i) {
                const auto bearing = target_.bearing[i];
                const double distance = target_.distance[i];
                const double open = log_open(bearing, distance) - by_itself(bearing, distance, own);
                sum += std::exp(std::min(open, 0.0));
            }
            visible[h] = sum / static_cast<double>(to - from);
        }
    }

    // What is seen of local hypothesis h, whose place is little known.
    void of_track(std::size_t h, Glimpse& seen) const {
        const double *cov = local_.cov + 16 * h, *box = box_ + 5 * h;
        const double c = std::cos(box[4]), s = std::sin(box[4]);
        const double along = box[1] * box[1] / 12, side = box[2] * box[2] / 12;
        const double spread[4] = {cov[0] + c * c * along + s * s * side,
                                  cov[1] + c * s * along - s * c * side,
                                  cov[4] + s * c * along - c * s * side,
                                  cov[5] + s * s * along + c * c * side};
        look(local_.mean + 4 * h, spread, track_row_[track_[h]], seen);
    }

    // What is seen of an undetected object.
    void of_undetected(const double* mean, const double* cov, Glimpse& seen) const {
        const double own = rules_.car_sd * rules_.car_sd;
        const double spread[4] = {cov[0] + own, cov[1], cov[4], cov[5] + own};
        look(mean, spread, -1, seen);
    }

 private:
    double key_of(std::int64_t bearing, double distance) const {
        return static_cast<double>(bearing) + std::min(distance, 0.999 * rules_.far) / rules_.far;
    }

    void close_outline(double log_open) {
        log_open_.push_back(log_open);
        first_.push_back(static_cast<std::int64_t>(bearing_.size()));
    }

    // Rays of a polygon; one around the sensor has none.
    void add(const Polygons& polygons, std::size_t p, double cos, double sin) {
        const auto from = polygons.start[p], to = polygons.start[p + 1];
        const auto corners = static_cast<std::size_t>(to - from);
        std::vector<std::array<double, 2>> corner(corners);
        double middle[2] = {0, 0};
        for (std::size_t i = 0; i < corners; ++i) {
            const double* at = polygons.corner + 2 * (static_cast<std::size_t>(from) + i);
            const double x = at[0] - pose_[0], y = at[1] - pose_[1];
            corner[i] = {cos * x + sin * y, cos * y - sin * x};
            for (int a = 0; a < 2; ++a) middle[a] += corner[i][a] / static_cast<double>(corners);
        }
        const double towards = std::atan2(middle[1], middle[0]);
        double low = kPi, high = -kPi;
        for (const auto& at : corner) {
            const double turn = turn_from(std::atan2(at[1], at[0]), towards);
            low = std::min(low, turn);
            high = std::max(high, turn);
        }
        const auto bearings = rules_.compass.bearings;
        const double step = 2 * kPi / static_cast<double>(bearings);
        const auto extent = Extent::of(towards + low, towards + high, step);
        for (auto ray = extent.first; high - low <= kPi && ray <= extent.last; ++ray) {
            const double angle = (static_cast<double>(ray) + 0.5) * step;
            const double x = std::cos(angle), y = std::sin(angle);
            double nearest = rules_.far;
            for (std::size_t i = 0; i < corners; ++i) {
                const auto &a = corner[i], &b = corner[(i + 1) % corners];
                const double ex = b[0] - a[0], ey = b[1] - a[1];
                // t ray = corner + s edge, by Cramer's rule.
                const double area = x * ey - y * ex;
                const double t = (a[0] * ey - a[1] * ex) / area;
                const double s = (a[0] * y - a[1] * x) / area;
                if (s >= 0 && s <= 1 && t > 0) nearest = std::min(nearest, t);
            }
            if (!(nearest < rules_.far)) continue;
            bearing_.push_back(((ray % bearings) + bearings) % bearings);
            distance_.push_back(nearest);
        }
        close_outline(std::log1p(-rules_.certain));
    }

    void sort() {
        const auto rays = bearing_.size();
        std::vector<double> key(rays), open(rays);
        for (std::size_t b = 0; b + 1 < first_.size(); ++b) {
            for (auto i = first_[b]; i < first_[b + 1]; ++i) open[i] = log_open_[b];
        }
        for (std::size_t i = 0; i < rays; ++i) key[i] = key_of(bearing_[i], distance_[i]);
        std::vector<std::size_t> order(rays);
        std::iota(order.begin(), order.end(), 0);
        std::stable_sort(order.begin(), order.end(),
                         [&](auto a, auto b) { return key[a] < key[b]; });
        key_.resize(rays);
        before_.assign(rays + 1, 0.0);
        start_.assign(static_cast<std::size_t>(rules_.compass.bearings) + 1, 0);
        for (std::size_t i = 0; i < rays; ++i) {
            key_[i] = key[order[i]];
            before_[i + 1] = before_[i] + open[order[i]];
            ++start_[static_cast<std::size_t>(bearing_[i]) + 1];
        }
        std::partial_sum(start_.begin(), start_.end(), start_.begin());
    }

    // log of the probability that nothing stands nearer at this bearing.
    double log_open(std::int64_t bearing, double distance) const {
        const auto from = start_[static_cast<std::size_t>(bearing)];
        const auto to = start_[static_cast<std::size_t>(bearing) + 1];
        const double key = key_of(bearing, distance - rules_.touching);
        const auto nearer = std::lower_bound(key_.begin() + from, key_.begin() + to, key);
        return before_[static_cast<std::size_t>(nearer - key_.begin())] -
               before_[static_cast<std::size_t>(from)];
    }

    // What a track's own outline takes from its rays.
    double by_itself(std::int64_t bearing, double distance, std::int64_t own) const {
        if (own < 0) return 0.0;
        const auto first = first_[own], count = first_[own + 1] - first;
        if (!count) return 0.0;
        const auto bearings = rules_.compass.bearings;
        const auto offset = ((bearing - bearing_[first]) % bearings + bearings) % bearings;
        if (offset >= count) return 0.0;
        const bool nearer = key_of(bearing, distance_[first + offset]) <
                            key_of(bearing, distance - rules_.touching);
        return nearer ? log_open_[own] : 0.0;
    }

    void look(const double* mean, const double* spread, std::int64_t own, Glimpse& seen) const {
        const double x = mean[0] - pose_[0], y = mean[1] - pose_[1];
        const double range = std::max(std::hypot(x, y), 1e-9);
        const double lx = x / range, ly = y / range;
        // Columns: across the line of sight, along it.
        const double turn[4] = {-ly, lx, lx, ly};
        double half[4], S[4];
        for (int a = 0; a < 2; ++a) {
            for (int b = 0; b < 2; ++b) {
                half[2 * a + b] = turn[a] * spread[b] + turn[2 + a] * spread[2 + b];
            }
        }
        for (int a = 0; a < 2; ++a) {
            for (int b = 0; b < 2; ++b) {
                S[2 * a + b] = half[2 * a] * turn[b] + half[2 * a + 1] * turn[2 + b];
            }
        }
        const double sd = std::sqrt(S[0]), slope = S[1] / sd;
        const double rest = std::sqrt(std::max(S[3] - slope * slope, 0.0));
        const auto bearings = rules_.compass.bearings;
        const double step = 2 * kPi / static_cast<double>(bearings);
        seen.visible.assign(rules_.count, 1.0);
        seen.node.resize(rules_.count);
        const double towards = std::atan2(ly, lx);
        double aside = 0, nearest = range, furthest = range;
        for (std::size_t k = 0; k < rules_.count; ++k) {
            const double* n = rules_.nodes + 2 * k;
            const double side = sd * n[0], depth = slope * n[0] + rest * n[1];
            seen.node[k] = {side * turn[0] + depth * turn[1], side * turn[2] + depth * turn[3]};
            aside = std::max(aside, std::abs(side));
            nearest = std::min(nearest, range + depth);
            furthest = std::max(furthest, range + depth);
        }
        const bool open = nearest > 0 && is_open(towards - pose_[2], std::atan(aside / nearest),
                                                 std::hypot(aside, furthest));
        for (std::size_t k = 0; k < rules_.count && !open; ++k) {
            const double* n = rules_.nodes + 2 * k;
            const double side = sd * n[0], depth = slope * n[0] + rest * n[1];
            const double ahead = range + depth;
            const double angle = towards + std::atan2(side, ahead) - pose_[2];
            const auto cell = static_cast<std::int64_t>(std::floor(angle / step + kOnEdge));
            const auto bearing = ((cell % bearings) + bearings) % bearings;
            const double distance = std::hypot(side, ahead);
            double log = log_open(bearing, distance);
            if (!key_.empty()) log -= by_itself(bearing, distance, own);
            seen.visible[k] = std::exp(std::min(log, 0.0));
        }
        for (int a = 0; a < 2; ++a) {
            for (int b = 0; b < 2; ++b) {
                half[2 * a + b] = turn[2 * a] * S[b] + turn[2 * a + 1] * S[2 + b];
            }
        }
        for (int a = 0; a < 2; ++a) {
            for (int b = 0; b < 2; ++b) {
                seen.S[2 * a + b] = half[2 * a] * turn[2 * b] + half[2 * a + 1] * turn[2 * b + 1];
            }
        }
    }

    // Whether nothing at all stands nearer than `distance` within `half` of an angle.
    bool is_open(double angle, double half, double distance) const {
        const auto bearings = rules_.compass.bearings;
        const double step = 2 * kPi / static_cast<double>(bearings);
        const auto first = static_cast<std::int64_t>(std::floor((angle - half) / step)) - 1;
        const auto last = static_cast<std::int64_t>(std::floor((angle + half) / step)) + 1;
        for (auto ray = first; ray <= last; ++ray) {
            const auto bearing = ((ray % bearings) + bearings) % bearings;
            const auto nearest = start_[static_cast<std::size_t>(bearing)];
            if (nearest < start_[static_cast<std::size_t>(bearing) + 1] &&
                key_[static_cast<std::size_t>(nearest)] < key_of(bearing, distance)) {
                return false;
            }
        }
        return true;
    }

    const OcclusionRules& rules_;
    const double* pose_;
    GaussiansView local_;
    const double* box_;
    const std::int64_t* track_;
    std::size_t locals_;
    BoxRays target_;
    std::vector<std::int64_t> track_row_;
    std::vector<bool> shadowless_;
    // Of the outlines: their rays, and the log of the probability that each is not there.
    std::vector<std::int64_t> first_{0}, bearing_;
    std::vector<double> distance_, log_open_;
    // The rays by bearing, then distance.
    std::vector<double> key_, before_;
    std::vector<std::int64_t> start_;
};

}  // namespace pmbm
