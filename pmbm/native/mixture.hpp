// Gaussian mixtures of undetected objects, and from whom their weight was recycled.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "tables.hpp"

namespace pmbm {

// A Gaussian mixture: log_weight (P,), mean (P,4), cov (P,4,4); and the columns of RecycledFrom, null
// where nothing was recycled.
struct MixtureView {
    const double *log_weight, *mean, *cov;
    const std::int64_t* track;
    const double *share, *recycled;
    std::size_t count;
};

struct Mixture {
    Floats log_weight, mean, cov;
    Ints track;
    Floats share, recycled;

    std::size_t size() const { return log_weight.size(); }

    void append(const Mixture& other, std::size_t i) {
        log_weight.push_back(other.log_weight[i]);
        mean.insert(mean.end(), other.mean.begin() + 4 * i, other.mean.begin() + 4 * (i + 1));
        cov.insert(cov.end(), other.cov.begin() + 16 * i, other.cov.begin() + 16 * (i + 1));
        track.push_back(other.track[i]);
        share.push_back(other.share[i]);
        recycled.push_back(other.recycled[i]);
    }

    // Only the components that `stays` says of, by row and in their order.
    template <typename Stays>
    void keep(Stays stays) {
        std::size_t kept = 0;
        for (std::size_t i = 0; i < size(); ++i) {
            if (!stays(i)) continue;
            log_weight[kept] = log_weight[i];
            std::copy_n(mean.begin() + 4 * i, 4, mean.begin() + 4 * kept);
            std::copy_n(cov.begin() + 16 * i, 16, cov.begin() + 16 * kept);
            track[kept] = track[i];
            share[kept] = share[i];
            recycled[kept++] = recycled[i];
        }
        for (auto* column : {&log_weight, &share, &recycled}) column->resize(kept);
        mean.resize(4 * kept);
        cov.resize(16 * kept);
        track.resize(kept);
    }

    bool any_recycled() const {
        return std::any_of(recycled.begin(), recycled.end(), [](auto part) { return part > 0; });
    }
};

inline Mixture owned(const MixtureView& view) {
    const auto n = view.count;
    Mixture out;
    out.log_weight.assign(view.log_weight, view.log_weight + n);
    out.mean.assign(view.mean, view.mean + 4 * n);
    out.cov.assign(view.cov, view.cov + 16 * n);
    if (view.track) {
        out.track.assign(view.track, view.track + n);
        out.share.assign(view.share, view.share + n);
        out.recycled.assign(view.recycled, view.recycled + n);
    } else {
        out.track.assign(n, -1);
        out.share.assign(n, 0.0);
        out.recycled.assign(n, 0.0);
    }
    return out;
}

// RecycledFrom.merged() for one group of components.
inline void merge_recycled(const Mixture& mixture, const std::size_t* rows, std::size_t count,
                           const double* weight, double total, std::int64_t& track,
                           double& share, double& recycled) {
    track = -1;
    share = recycled = 0;
    struct Part {
        std::int64_t track;
        double mass;
    };
    std::vector<Part> parts;
    for (std::size_t i = 0; i < count; ++i) {
        const double own = weight[i] * mixture.share[rows[i]];
        recycled += weight[i] * mixture.recycled[rows[i]] / total;
        if (mixture.track[rows[i]] >= 0 && own > 0) {
            parts.push_back({mixture.track[rows[i]], own});
        }
    }
    std::stable_sort(parts.begin(), parts.end(),
                     [](const Part& a, const Part& b) { return a.track < b.track; });
    double best = -1;
    for (std::size_t i = 0, end = 0; i < parts.size(); i = end) {
        double mass = 0;
        for (end = i; end < parts.size() && parts[end].track == parts[i].track; ++end) {
            mass += parts[end].mass;
        }
        if (mass >= best) {
            best = mass;
            track = parts[i].track;
            share = mass / total;
        }
    }
}

// The weighted sum of some components as one with its moments: component k has the mean mean_of(k),
// the rest is that of `from` at rows[k], and weighs exp(top) * weight[k].
template <typename MeanOf>
void append_merged(Mixture& out, const Mixture& from, const std::size_t* rows, std::size_t count,
                   MeanOf mean_of, const double* weight, double top) {
    double total = 0, mean[4] = {0, 0, 0, 0}, cov[16] = {};
    for (std::size_t k = 0; k < count; ++k) total += weight[k];
    for (std::size_t k = 0; k < count; ++k) {
        const double* m = mean_of(k);
        for (int a = 0; a < 4; ++a) mean[a] += weight[k] / total * m[a];
    }
    for (std::size_t k = 0; k < count; ++k) {
        const double *m = mean_of(k), *P = from.cov.data() + 16 * rows[k];
        const double share = weight[k] / total;
        for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) {
                cov[4 * a + b] +=
                    share * (P[4 * a + b] + (m[a] - mean[a]) * (m[b] - mean[b]));
            }
        }
    }
    out.log_weight.push_back(top + std::log(total));
    out.mean.insert(out.mean.end(), mean, mean + 4);
    out.cov.insert(out.cov.end(), cov, cov + 16);
    std::int64_t track;
    double share, recycled;
    merge_recycled(from, rows, count, weight, total, track, share, recycled);
    out.track.push_back(track);
    out.share.push_back(share);
    out.recycled.push_back(recycled);
}

}  // namespace pmbm
