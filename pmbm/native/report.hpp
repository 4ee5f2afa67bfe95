// Which tracks are reported, and how.  The plain version is _reported() of estimation.py.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "overlaps.hpp"
#include "tables.hpp"

namespace pmbm {

// Of each track (T,): its id, the row of its state, that it exists and is an object, and that it is
// in view.
struct Candidates {
    const std::int64_t *track_id, *best;
    const double *exists, *inside;
    std::size_t count;
};

// The tracks that probably exist and are in view; `exclusive`: but one of those at one place.
inline Ints reported(const Candidates& track, const double* mean, const double* box, double above,
                     bool exclusive, double whole) {
    Ints rows;
    for (std::size_t t = 0; t < track.count; ++t) {
        if (track.exists[t] > above && track.inside[t] > 0.5) {
            rows.push_back(static_cast<std::int64_t>(t));
        }
    }
    const auto n = rows.size();
    if (!exclusive || n < 2) return rows;
    Ints order(n);
    Floats position(2 * n), outline(5 * n);
    std::size_t sure = 0;
    for (std::size_t i = 0; i < n; ++i) {
        order[i] = static_cast<std::int64_t>(i);
        sure += track.exists[rows[i]] > 0.5;
        const auto at = track.best[rows[i]];
        std::copy_n(mean + 4 * at, 2, position.data() + 2 * i);
        std::copy_n(box + 5 * at, 5, outline.data() + 5 * i);
    }
    std::sort(order.begin(), order.end(), [&](auto a, auto b) {
        const bool first = track.exists[rows[a]] > 0.5, second = track.exists[rows[b]] > 0.5;
        return first != second ? first : track.track_id[rows[a]] < track.track_id[rows[b]];
    });
    Ints kept;
    for (const auto i : suppress_overlaps(position.data(), outline.data(), order.data(), n, sure,
                                          whole)) {
        kept.push_back(rows[i]);
    }
    return kept;
}

}  // namespace pmbm
