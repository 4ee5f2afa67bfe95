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

// P(object) (T,) of existence (T,) and that of sources of each class (T,K), given P(object) (K,) of
// these.
inline Floats objects(const double* of_class, const double* existence, std::size_t tracks,
                      const double* share, std::size_t classes) {
    Floats found(tracks, 0.0);
    for (std::size_t t = 0; t < tracks; ++t) {
        for (std::size_t k = 0; k < classes; ++k) found[t] += of_class[classes * t + k] * share[k];
        found[t] = std::min(found[t], existence[t]);
    }
    return found;
}

// Whether tracks of these ids have all been reported before, and none may inherit another: reported,
// candidate : ids, rising.  The plain version is _known_as_they_are() of inheritance.py.
inline bool known_as_they_are(const Ints& ids, const std::int64_t* reported, std::size_t reports,
                              const std::int64_t* candidate, std::size_t candidates) {
    // Ids mostly rise too: what follows the one found last is looked at first.
    std::size_t next = 0;
    for (const auto id : ids) {
        if (next == reports || reported[next] != id) {
            next = static_cast<std::size_t>(std::lower_bound(reported, reported + reports, id) -
                                            reported);
            if (next == reports || reported[next] != id) return false;
        }
        ++next;
        if (std::binary_search(candidate, candidate + candidates, id)) return false;
    }
    return true;
}

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
