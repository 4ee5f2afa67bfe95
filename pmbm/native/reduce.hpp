// The reduction of the hypotheses of detected objects, whole.  The plain version is _fewer() of
// reduction.py, with the functions named beside each of tables.hpp.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "join.hpp"
#include "tables.hpp"

namespace pmbm {

struct ReductionLimits {
    double log_prune;
    std::int64_t max_hypotheses;
    double largest_table, recycle_below;
    std::int64_t max_tracks;
    bool clustering;
    double split_below;
    std::int64_t worth_factoring;
};

struct ReducedTable {
    Table table;
    // What is left of the local table and of the tracks, and what members and tracks are called.
    Compacted compact;
    // Rows that return to the PPP, and the weight of the hypotheses that they were part of.
    Ints recycled;
    Floats probability;
    std::int64_t pruned = 0, capped = 0, merged = 0, tracks_capped = 0;
};

// _surplus_tracks(): whether each track is beyond the `most` that may stay.
inline std::vector<bool> surplus(const Floats& probability, const double* existence,
                                 const std::int64_t* track, std::size_t tracks,
                                 std::int64_t most) {
    Floats expected(tracks, 0.0);
    std::vector<bool> alive(tracks, false), beyond(tracks, false);
    for (std::size_t row = 0; row < probability.size(); ++row) {
        expected[track[row]] += probability[row] * existence[row];
        alive[track[row]] = true;
    }
    if (std::count(alive.begin(), alive.end(), true) <= most) return beyond;
    Ints order(tracks);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](auto a, auto b) { return expected[a] > expected[b]; });
    for (auto i = static_cast<std::size_t>(most); i < tracks; ++i) beyond[order[i]] = true;
    return beyond;
}

// The rows without the members marked in `gone`.
inline Table without(const TableView& table, const std::vector<bool>& gone) {
    Table emptied;
    emptied.reserve(table.rows, table.members());
    for (std::int64_t g = 0; g < table.rows; ++g) {
        for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
            if (!gone[table.member[e]]) emptied.member.push_back(table.member[e]);
        }
        emptied.close_row(table.cluster[g], table.log_weight[g]);
    }
    return emptied;
}

inline ReducedTable reduced(Table&& table, const double* existence, const std::int64_t* track,
                            std::size_t locals, std::size_t tracks,
                            const ReductionLimits& limits) {
    ReducedTable out;
    Ints caps(static_cast<std::size_t>(view_of(table).clusters()), limits.max_hypotheses);
    if (limits.clustering) {
        limit_rows(view_of(table), limits.max_hypotheses, limits.largest_table, caps);
    }
    std::int64_t above = 0;
    auto& kept = out.table;
    kept = pruned(view_of(table), limits.log_prune, caps.data(), above);
    out.pruned = view_of(table).rows - above;
    out.capped = above - view_of(kept).rows;
    release(table, caps);

    const auto count = static_cast<std::int64_t>(locals);
    std::vector<bool> gone(locals);
    for (std::size_t row = 0; row < locals; ++row) {
        gone[row] = existence[row] < limits.recycle_below;
    }
    if (count > limits.max_tracks) {
        const auto beyond = surplus(probability(view_of(kept), count), existence, track, tracks,
                                    limits.max_tracks);
        for (std::size_t row = 0; row < locals; ++row) {
            if (gone[row] || !beyond[track[row]]) continue;
            gone[row] = true;
            ++out.tracks_capped;
        }
    }
    if (std::any_of(kept.member.begin(), kept.member.end(), [&](auto m) { return gone[m]; })) {
        const auto held = probability(view_of(kept), count);
        for (std::size_t row = 0; row < locals; ++row) {
            if (!gone[row] || !(held[row] > 0)) continue;
            out.recycled.push_back(static_cast<std::int64_t>(row));
            out.probability.push_back(held[row]);
        }
        kept = without(view_of(kept), gone);
    }
    if (!out.recycled.empty() || out.tracks_capped) {
        const auto before = view_of(kept).rows;
        kept = merged(view_of(kept));
        out.merged = before - view_of(kept).rows;
    }
    if (limits.clustering) {
        kept = split(view_of(kept), count);
        if (limits.split_below > 0) {
            kept = factored(view_of(kept), track, limits.split_below, limits.worth_factoring);
        }
    }
    out.compact = compacted(kept.member.data(), kept.member.size(), track, locals, tracks);
    kept.member = std::move(out.compact.member);
    return out;
}

}  // namespace pmbm
