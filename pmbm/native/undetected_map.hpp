// The map of undetected objects, settled cell by cell.  The plain version is _settled() of
// undetected_map.py, and says what is meant.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "mixture.hpp"
#include "sensor.hpp"

namespace pmbm {

// Constants of undetected_map.py, handed over so that they stand once.
struct MapRules {
    double spacing, log_negligible, fine_above;
    double widest, margin, left_by_split, part_spacing, slow, round, on_edge;
};

class MapSettler {
 public:
    MapSettler(const MixtureView& mixture, const View& view, const MapRules& rules)
        : whole_(owned(mixture)), view_(view), rules_(rules) {}

    // The mixture after it, and the mass that was dropped.
    std::pair<Mixture, double> run() {
        double dropped = 0;
        const double reach = rules_.margin * rules_.spacing + rules_.on_edge;
        for (std::size_t p = 0; p < whole_.size(); ++p) {
            const double* m = whole_.mean.data() + 4 * p;
            if (whole_.log_weight[p] > rules_.log_negligible && beyond(view_, m) <= reach) {
                narrow(p);
            } else {
                dropped += std::exp(whole_.log_weight[p]);
            }
        }
        merge_by_cell();
        return {std::move(out_), dropped};
    }

 private:
    struct Part {
        double log_weight;
        std::array<double, 4> mean;
        std::size_t origin;
    };

    // Where the parts of a component lie along its axis, in its standard deviations, and what each
    // weighs.
    struct Cut {
        double ratio, left;
        Floats node, log_weight;
    };

    // narrowed(): all parts of a component are cut alike, since they have one covariance.
    void narrow(std::size_t p) {
        double* P = whole_.cov.data() + 16 * p;
        const auto first = parts_.size();
        parts_.push_back({whole_.log_weight[p], {}, p});
        std::copy_n(whole_.mean.data() + 4 * p, 4, parts_.back().mean.begin());
        for (;;) {
            const double a = P[0], b = P[1], d = P[5];
            const double longest = 0.5 * (a + d) + std::hypot(0.5 * (a - d), b);
            const double ratio = std::ceil(std::sqrt(longest) / rules_.widest * (1 - 1e-9));
            if (!(ratio > 1)) return;
            const auto& cut = cut_into(ratio);
            double along[4];
            widest_axis(P, along);
            for (int i = 0; i < 4; ++i) {
                for (int j = 0; j < 4; ++j) P[4 * i + j] -= (1 - cut.left) * along[i] * along[j];
            }
            for (int i = 0; i < 4; ++i) {
                for (int j = 0; j < i; ++j) {
                    P[4 * i + j] = P[4 * j + i] = 0.5 * (P[4 * i + j] + P[4 * j + i]);
                }
            }
            uncut_.assign(parts_.begin() + static_cast<std::ptrdiff_t>(first), parts_.end());
            parts_.resize(first);
            for (std::size_t n = 0; n < cut.node.size(); ++n) {
                for (auto part : uncut_) {
                    part.log_weight += cut.log_weight[n];
                    for (int i = 0; i < 4; ++i) part.mean[i] += cut.node[n] * along[i];
                    parts_.push_back(part);
                }
            }
        }
    }

    // _longest(): how the state moves with one standard deviation of the position along the axis
    // along which it is widest.
    void widest_axis(const double* P, double* along) const {
        const double a = P[0], b = P[1], d = P[5], least = 0.5 * rules_.round * (a + d);
        const double between = std::abs(a - d) > least ? a - d : 0.0;
        const double tilt = std::abs(b) > least ? b : 0.0;
        const double angle = 0.5 * std::atan2(2 * tilt, between);
        const double cos = std::cos(angle), sin = std::sin(angle);
        const double sd = std::sqrt(a * cos * cos + 2 * b * cos * sin + d * sin * sin);
        for (int i = 0; i < 4; ++i) along[i] = (P[4 * i] * cos + P[4 * i + 1] * sin) / sd;
    }

    // The nodes of _split().
    const Cut& cut_into(double ratio) {
        for (const auto& cut : cuts_) {
            if (cut.ratio == ratio) return cut;
        }
        Cut cut{ratio, rules_.left_by_split * (2 / ratio) * (2 / ratio), {}, {}};
        if (ratio == 2) {
            const double apart = std::sqrt(3 * (1 - cut.left));
            cut.node = {-apart, 0, apart};
            cut.log_weight = {std::log(1.0 / 6), std::log(4.0 / 6), std::log(1.0 / 6)};
        } else {
            const double step = rules_.part_spacing * std::sqrt(cut.left);
            const int most = static_cast<int>(std::ceil(3 / step));
            double total = 0, second = 0;
            Floats weight;
            for (int n = -most; n <= most; ++n) {
                cut.node.push_back(step * n);
                weight.push_back(std::exp(-0.5 * cut.node.back() * cut.node.back() / (1 - cut.left)));
                total += weight.back();
            }
            for (std::size_t n = 0; n < weight.size(); ++n) {
                weight[n] /= total;
                second += weight[n] * cut.node[n] * cut.node[n];
                cut.log_weight.push_back(std::log(weight[n]));
            }
            for (auto& node : cut.node) node *= std::sqrt((1 - cut.left) / second);
        }
        cuts_.push_back(std::move(cut));
        return cuts_.back();
    }

    // merged_by_cell().
    void merge_by_cell() {
        Ints cell[2];
        for (int axis = 0; axis < 2; ++axis) {
            for (const auto& part : parts_) {
                cell[axis].push_back(static_cast<std::int64_t>(
                    std::floor(part.mean[axis] / rules_.spacing + rules_.on_edge)));
            }
        }
        std::vector<std::size_t> order(parts_.size());
        for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
        sort_by(cell[1], order);
        sort_by(cell[0], order);
        Floats weight;
        std::vector<std::size_t> kinds[9];
        for (std::size_t i = 0, end = 0; i < order.size(); i = end) {
            const auto in_cell = [&](std::size_t k) {
                return cell[0][order[k]] == cell[0][order[i]] &&
                       cell[1][order[k]] == cell[1][order[i]];
            };
            double held = 0;
            for (end = i; end < order.size() && in_cell(end); ++end) {
                held += std::exp(parts_[order[end]].log_weight);
            }
            if (!(held > rules_.fine_above)) {
                merge(order.data() + i, end - i);
                continue;
            }
            for (auto& rows : kinds) rows.clear();
            for (auto k = i; k < end; ++k) kinds[kind(parts_[order[k]])].push_back(order[k]);
            for (const auto& rows : kinds) merge(rows.data(), rows.size());
        }
    }

    // Class of a velocity; all are one at the edge, where objects only come and go.
    std::size_t kind(const Part& part) const {
        const double inner = -rules_.margin * rules_.spacing + rules_.on_edge;
        if (!(beyond(view_, part.mean.data()) <= inner)) return 0;
        const auto fast = [&](double v) { return 1 + (v > rules_.slow) - (v < -rules_.slow); };
        return static_cast<std::size_t>(3 * fast(part.mean[2]) + fast(part.mean[3]));
    }

    void merge(const std::size_t* rows, std::size_t count) {
        if (!count) return;
        double top = parts_[rows[0]].log_weight;
        for (std::size_t k = 1; k < count; ++k) top = std::max(top, parts_[rows[k]].log_weight);
        weight_.clear();
        origin_.clear();
        for (std::size_t k = 0; k < count; ++k) {
            weight_.push_back(std::exp(parts_[rows[k]].log_weight - top));
            origin_.push_back(parts_[rows[k]].origin);
        }
        append_merged(out_, whole_, origin_.data(), count,
                      [&](std::size_t k) { return parts_[rows[k]].mean.data(); }, weight_.data(),
                      top);
    }

    // Stable, by counting: a map has few rows and columns of cells.
    static void sort_by(const Ints& key, std::vector<std::size_t>& order) {
        if (order.empty()) return;
        const auto [low, high] = std::minmax_element(key.begin(), key.end());
        const auto least = *low;
        std::vector<std::size_t> first(static_cast<std::size_t>(*high - least) + 2, 0);
        for (const auto k : key) ++first[static_cast<std::size_t>(k - least) + 1];
        for (std::size_t k = 1; k < first.size(); ++k) first[k] += first[k - 1];
        std::vector<std::size_t> sorted(order.size());
        for (const auto i : order) sorted[first[static_cast<std::size_t>(key[i] - least)]++] = i;
        order = std::move(sorted);
    }

    // Its covariances become those of the parts.
    Mixture whole_;
    View view_;
    MapRules rules_;
    std::vector<Cut> cuts_;
    std::vector<Part> parts_, uncut_;
    Floats weight_;
    std::vector<std::size_t> origin_;
    Mixture out_;
};

}  // namespace pmbm
