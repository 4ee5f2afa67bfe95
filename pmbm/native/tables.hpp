// Tables of global hypotheses: pruning and splitting them.
// The plain versions, of the same names or named beside each function, are in reduction.py,
// clusters.py and estimation.py, and say what is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace pmbm {

using Ints = std::vector<std::int64_t>;
using Floats = std::vector<double>;

// Gives back the memory of what is done with: of many objects each column is large.
template <typename... Columns>
void release(Columns&... columns) {
    ((columns = Columns()), ...);
}

// A bool of which a vector holds one after the other, as an array does.
struct Flag {
    bool value;
};

// Global hypotheses, sorted by cluster: row g is member[start[g]] to member[start[g + 1]].
struct TableView {
    const std::int64_t *cluster, *start, *member;
    const double* log_weight;
    std::int64_t rows;

    std::int64_t clusters() const { return rows ? cluster[rows - 1] + 1 : 0; }
    std::int64_t members() const { return start[rows]; }

    // Calls visit(cluster, first row, last row + 1) for each cluster.
    template <typename Visit>
    void each_cluster(Visit visit) const {
        for (std::int64_t first = 0, last = 0; first < rows; first = last) {
            while (last < rows && cluster[last] == cluster[first]) ++last;
            visit(cluster[first], first, last);
        }
    }
};

struct Table {
    Ints cluster, start{0}, member;
    Floats log_weight;

    // Room for as much as another table holds: growing step by step takes time and memory.
    void reserve(std::int64_t rows, std::int64_t members) {
        cluster.reserve(static_cast<std::size_t>(rows));
        log_weight.reserve(static_cast<std::size_t>(rows));
        start.reserve(static_cast<std::size_t>(rows) + 1);
        member.reserve(static_cast<std::size_t>(members));
    }

    void clear() {
        cluster.clear();
        log_weight.clear();
        start.resize(1);
        member.clear();
    }

    void close_row(std::int64_t of_cluster, double weight) {
        cluster.push_back(of_cluster);
        log_weight.push_back(weight);
        start.push_back(static_cast<std::int64_t>(member.size()));
    }
};

inline TableView view_of(const Table& t) {
    return {t.cluster.data(), t.start.data(), t.member.data(), t.log_weight.data(),
            static_cast<std::int64_t>(t.cluster.size())};
}

inline Table owned(const TableView& view) {
    Table table;
    table.cluster.assign(view.cluster, view.cluster + view.rows);
    table.log_weight.assign(view.log_weight, view.log_weight + view.rows);
    table.start.assign(view.start, view.start + view.rows + 1);
    table.member.assign(view.member, view.member + view.members());
    return table;
}

// Makes the weights of rows first to last - 1 add up to one.
inline void normalise(double* log_weight, std::int64_t first, std::int64_t last) {
    double top = -std::numeric_limits<double>::infinity();
    for (auto g = first; g < last; ++g) top = std::max(top, log_weight[g]);
    double total = 0;
    for (auto g = first; g < last; ++g) total += std::exp(log_weight[g] - top);
    const double shift = std::log(total);
    for (auto g = first; g < last; ++g) log_weight[g] = log_weight[g] - top - shift;
}

// likely(), _best() and _keep(): the rows above the threshold, at most `cap` of each cluster, and
// its best one in any case.  `likely` is how many were above the threshold.
inline Table pruned(const TableView& table, double log_threshold, const std::int64_t* cap,
                    std::int64_t& likely) {
    Table kept;
    kept.reserve(table.rows, table.members());
    likely = 0;
    Ints rows;
    table.each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        const double* weight = table.log_weight;
        const double top = *std::max_element(weight + first, weight + last);
        rows.clear();
        for (auto g = first; g < last; ++g) {
            if (weight[g] > log_threshold || weight[g] == top) rows.push_back(g);
        }
        likely += static_cast<std::int64_t>(rows.size());
        if (static_cast<std::int64_t>(rows.size()) > cap[cluster]) {
            std::stable_sort(rows.begin(), rows.end(), [&](std::int64_t a, std::int64_t b) {
                return weight[a] > weight[b];
            });
            rows.resize(static_cast<std::size_t>(cap[cluster]));
            std::sort(rows.begin(), rows.end());
        }
        const auto begin = static_cast<std::int64_t>(kept.log_weight.size());
        for (const auto g : rows) {
            kept.member.insert(kept.member.end(), table.member + table.start[g],
                               table.member + table.start[g + 1]);
            kept.close_row(cluster, weight[g]);
        }
        if (static_cast<std::int64_t>(rows.size()) < last - first) {
            normalise(kept.log_weight.data(), begin,
                      static_cast<std::int64_t>(kept.log_weight.size()));
        }
    });
    return kept;
}

// split(): tracks that are certain in their cluster in clusters of their own.
inline Table split(const TableView& table, std::int64_t locals) {
    Ints times(static_cast<std::size_t>(locals), 0);
    for (std::int64_t e = 0; e < table.members(); ++e) ++times[table.member[e]];
    Table apart;
    apart.reserve(table.rows, table.members());
    Ints alone;
    std::int64_t open = 0;
    table.each_cluster([&](std::int64_t, std::int64_t first, std::int64_t last) {
        const auto certain = [&](std::int64_t e) { return times[table.member[e]] == last - first; };
        for (auto e = table.start[first]; e < table.start[first + 1]; ++e) {
            if (certain(e)) alone.push_back(table.member[e]);
        }
        bool is_open = false;
        for (auto e = table.start[first]; e < table.start[last] && !is_open; ++e) {
            is_open = !certain(e);
        }
        if (!is_open) return;
        for (auto g = first; g < last; ++g) {
            for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
                if (!certain(e)) apart.member.push_back(table.member[e]);
            }
            apart.close_row(open, table.log_weight[g]);
        }
        ++open;
    });
    for (const auto member : alone) {
        apart.member.push_back(member);
        apart.close_row(open++, 0.0);
    }
    return apart;
}

// merge_equal(): rows of one cluster with the same members become the first of them.
inline Table merged(const TableView& table) {
    std::vector<std::pair<std::uint64_t, std::int64_t>> rows;
    Table kept;
    kept.reserve(table.rows, table.members());
    table.each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        rows.clear();
        for (auto g = first; g < last; ++g) {
            std::uint64_t sum = 0;
            for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
                // SplitMix64, of the member plus one since zero hashes to zero.
                auto key = (static_cast<std::uint64_t>(table.member[e]) + 1) *
                           std::uint64_t{0x9E3779B97F4A7C15};
                key = (key ^ (key >> 30)) * std::uint64_t{0xBF58476D1CE4E5B9};
                key = (key ^ (key >> 27)) * std::uint64_t{0x94D049BB133111EB};
                sum += key ^ (key >> 31);
            }
            rows.push_back({sum, g});
        }
        std::sort(rows.begin(), rows.end());
        // The first row of every group takes the others' weight; the others are marked.
        Floats weight(table.log_weight + first, table.log_weight + last);
        for (std::size_t i = 0, j = 0; i < rows.size(); i = j) {
            double top = -std::numeric_limits<double>::infinity(), total = 0;
            for (j = i; j < rows.size() && rows[j].first == rows[i].first; ++j) {
                top = std::max(top, table.log_weight[rows[j].second]);
            }
            if (j == i + 1) continue;
            for (auto k = i; k < j; ++k) {
                total += std::exp(table.log_weight[rows[k].second] - top);
                weight[rows[k].second - first] = std::numeric_limits<double>::quiet_NaN();
            }
            weight[rows[i].second - first] = top + std::log(total);
        }
        for (auto g = first; g < last; ++g) {
            if (std::isnan(weight[g - first])) continue;
            kept.member.insert(kept.member.end(), table.member + table.start[g],
                               table.member + table.start[g + 1]);
            kept.close_row(cluster, weight[g - first]);
        }
    });
    return kept;
}

// Puts a value among the few that rise from `first` on, unless it is one of them.
inline void insert(Ints& rising, std::size_t first, std::int64_t value) {
    const auto at = std::lower_bound(rising.begin() + static_cast<std::ptrdiff_t>(first),
                                     rising.end(), value);
    if (at == rising.end() || *at != value) rising.insert(at, value);
}

// One cluster as a dense table of local hypotheses: rows x tracks, both in order, -1 for absent.
struct Dense {
    Ints tracks, choice;
    Floats weight;

    Dense(const TableView& table, const std::int64_t* track, std::int64_t first,
          std::int64_t last) {
        for (auto e = table.start[first]; e < table.start[last]; ++e) {
            insert(tracks, 0, track[table.member[e]]);
        }
        weight.reserve(static_cast<std::size_t>(last - first));
        choice.assign(static_cast<std::size_t>(last - first) * tracks.size(), -1);
        for (auto g = first; g < last; ++g) {
            weight.push_back(std::exp(table.log_weight[g]));
            for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
                const auto at = std::lower_bound(tracks.begin(), tracks.end(),
                                                 track[table.member[e]]) - tracks.begin();
                choice[static_cast<std::size_t>(g - first) * tracks.size() +
                       static_cast<std::size_t>(at)] = table.member[e];
            }
        }
    }

    std::int64_t at(std::size_t row, std::size_t column) const {
        return choice[row * tracks.size() + column];
    }
};

// _groups(): the group of each track of a dense table, numbered by their first tracks.
inline Ints groups(const Dense& dense, double tolerance) {
    const auto tracks = dense.tracks.size(), rows = dense.weight.size();
    // Local hypotheses by name, those of a track together.
    Ints names;
    std::vector<std::size_t> first_name{0};
    std::vector<std::size_t> name(dense.choice.size());
    for (std::size_t column = 0; column < tracks; ++column) {
        const auto begin = static_cast<std::ptrdiff_t>(names.size());
        for (std::size_t row = 0; row < rows; ++row) {
            if (dense.at(row, column) >= 0) insert(names, first_name.back(), dense.at(row, column));
        }
        first_name.push_back(names.size());
        for (std::size_t row = 0; row < rows; ++row) {
            name[row * tracks + column] = static_cast<std::size_t>(
                std::lower_bound(names.begin() + begin, names.end(), dense.at(row, column)) -
                names.begin());
        }
    }
    Floats alone(names.size(), 0.0), both(names.size() * names.size(), 0.0);
    std::vector<std::size_t> present;
    for (std::size_t row = 0; row < rows; ++row) {
        present.clear();
        for (std::size_t column = 0; column < tracks; ++column) {
            if (dense.at(row, column) >= 0) present.push_back(name[row * tracks + column]);
        }
        for (std::size_t i = 0; i < present.size(); ++i) {
            alone[present[i]] += dense.weight[row];
            for (std::size_t j = 0; j < i; ++j) {
                both[present[i] * names.size() + present[j]] += dense.weight[row];
            }
        }
    }
    Ints group(tracks);
    for (std::size_t t = 0; t < tracks; ++t) group[t] = static_cast<std::int64_t>(t);
    for (std::size_t one = 0; one < tracks; ++one) {
        for (std::size_t other = 0; other < one; ++other) {
            if (group[one] == group[other]) continue;
            double dependence = 0;
            for (auto i = first_name[one]; i < first_name[one + 1]; ++i) {
                for (auto j = first_name[other]; j < first_name[other + 1]; ++j) {
                    dependence += std::abs(both[i * names.size() + j] - alone[i] * alone[j]);
                }
            }
            if (!(dependence > tolerance)) continue;
            const auto low = std::min(group[one], group[other]);
            const auto high = std::max(group[one], group[other]);
            std::replace(group.begin(), group.end(), high, low);
        }
    }
    return group;
}

// _marginal(): the distinct choices of one group's tracks, with the weight of all rows alike.
inline void append_marginal(Table& table, const Dense& dense,
                            const std::vector<std::size_t>& columns, std::int64_t cluster) {
    std::vector<std::size_t> order(dense.weight.size());
    for (std::size_t row = 0; row < order.size(); ++row) order[row] = row;
    const auto before = [&](std::size_t a, std::size_t b) {
        for (const auto column : columns) {
            if (dense.at(a, column) != dense.at(b, column)) {
                return dense.at(a, column) < dense.at(b, column);
            }
        }
        return false;
    };
    std::stable_sort(order.begin(), order.end(), before);
    for (std::size_t i = 0, j = 0; i < order.size(); i = j) {
        double weight = 0;
        for (j = i; j < order.size() && !before(order[i], order[j]); ++j) {
            weight += dense.weight[order[j]];
        }
        for (const auto column : columns) {
            const auto member = dense.at(order[i], column);
            if (member >= 0) table.member.push_back(member);
        }
        table.close_row(cluster, std::log(weight));
    }
}

// factor(): clusters of more than `worth` members and at least four rows as the product of groups
// of tracks that hardly depend on one another; they come after the others.
inline Table factored(const TableView& table, const std::int64_t* track, double tolerance,
                      std::int64_t worth) {
    Table apart;
    apart.reserve(table.rows, table.members());
    std::vector<std::pair<std::int64_t, std::int64_t>> large;
    std::int64_t cluster = 0;
    table.each_cluster([&](std::int64_t, std::int64_t first, std::int64_t last) {
        if (table.start[last] - table.start[first] > worth && last - first >= 4) {
            large.push_back({first, last});
            return;
        }
        for (auto g = first; g < last; ++g) {
            apart.member.insert(apart.member.end(), table.member + table.start[g],
                                table.member + table.start[g + 1]);
            apart.close_row(cluster, table.log_weight[g]);
        }
        ++cluster;
    });
    for (const auto& [first, last] : large) {
        const Dense dense(table, track, first, last);
        const auto group = groups(dense, tolerance);
        for (std::size_t leader = 0; leader < group.size(); ++leader) {
            if (group[leader] != static_cast<std::int64_t>(leader)) continue;
            std::vector<std::size_t> columns;
            for (std::size_t t = leader; t < group.size(); ++t) {
                if (group[t] == group[leader]) columns.push_back(t);
            }
            append_marginal(apart, dense, columns, cluster++);
        }
    }
    return apart;
}

// _compact(): the rows of the local table and the tracks that are mentioned, and what members and
// the kept rows' tracks are called among them.
struct Compacted {
    Ints rows, member, tracks, track;
};

inline Compacted compacted(const std::int64_t* member, std::size_t members,
                           const std::int64_t* track, std::size_t locals, std::size_t tracks) {
    Compacted c;
    Ints name(locals, -1), track_name(tracks, -1);
    for (std::size_t e = 0; e < members; ++e) name[member[e]] = 0;
    for (std::size_t row = 0; row < locals; ++row) {
        if (name[row] < 0) continue;
        name[row] = static_cast<std::int64_t>(c.rows.size());
        c.rows.push_back(static_cast<std::int64_t>(row));
        track_name[track[row]] = 0;
    }
    for (std::size_t t = 0; t < tracks; ++t) {
        if (track_name[t] < 0) continue;
        track_name[t] = static_cast<std::int64_t>(c.tracks.size());
        c.tracks.push_back(static_cast<std::int64_t>(t));
    }
    for (std::size_t e = 0; e < members; ++e) c.member.push_back(name[member[e]]);
    for (const auto row : c.rows) c.track.push_back(track_name[track[row]]);
    return c;
}

// update() of update.py: of candidates in runs of these lengths, those that are members, counted from
// the start of their run, and what the members are called among them.
inline Ints used(const std::int64_t* member, std::size_t members,
                 const std::vector<std::int64_t>& lengths, std::vector<Ints>& runs) {
    Ints name(static_cast<std::size_t>(std::accumulate(lengths.begin(), lengths.end(),
                                                       std::int64_t{0})), -1);
    for (std::size_t e = 0; e < members; ++e) name[member[e]] = 0;
    runs.assign(lengths.size(), {});
    std::size_t candidate = 0;
    std::int64_t called = 0;
    for (std::size_t run = 0; run < lengths.size(); ++run) {
        for (std::int64_t i = 0; i < lengths[run]; ++i, ++candidate) {
            if (name[candidate] < 0) continue;
            name[candidate] = called++;
            runs[run].push_back(i);
        }
    }
    Ints renumbered(members);
    for (std::size_t e = 0; e < members; ++e) renumbered[e] = name[member[e]];
    return renumbered;
}

// Of each track (T,) the row of the largest mass among those that took last what is likeliest in
// all; of masses that are `alike`, the first.  newest (rows,): which detection each took last.  The
// plain version is _likeliest() of estimation.py.
inline Ints likeliest(const std::int64_t* track, const std::int64_t* newest, const double* mass,
                      std::size_t rows, std::size_t tracks, double alike) {
    struct Group {
        std::int64_t next, newest;
        double mass;
    };
    std::vector<Group> groups;
    Ints first_group(tracks, -1), group(rows);
    groups.reserve(rows);
    for (std::size_t row = 0; row < rows; ++row) {
        auto g = first_group[track[row]];
        while (g >= 0 && groups[g].newest != newest[row]) g = groups[g].next;
        if (g < 0) {
            g = static_cast<std::int64_t>(groups.size());
            groups.push_back({first_group[track[row]], newest[row], 0.0});
            first_group[track[row]] = g;
        }
        groups[g].mass += mass[row];
        group[row] = g;
    }
    const auto first_of_largest = [&](auto&& value) {
        Floats top(tracks, 0.0);
        for (std::size_t row = 0; row < rows; ++row) {
            top[track[row]] = std::max(top[track[row]], value(row));
        }
        Ints best(tracks, -1);
        for (std::size_t row = 0; row < rows; ++row) {
            auto& leader = best[track[row]];
            if (leader < 0 && value(row) >= top[track[row]] * (1 - alike)) {
                leader = static_cast<std::int64_t>(row);
            }
        }
        return best;
    };
    const auto agreed = first_of_largest([&](std::size_t row) { return groups[group[row]].mass; });
    return first_of_largest([&](std::size_t row) {
        return group[row] == group[agreed[track[row]]] ? mass[row] : -1.0;
    });
}

// Density.hypothesis_probability(): the weight of all rows that each local hypothesis is part of.
inline Floats probability(const TableView& table, std::int64_t locals) {
    Floats sum(static_cast<std::size_t>(locals), 0.0);
    for (std::int64_t g = 0; g < table.rows; ++g) {
        const double weight = std::exp(table.log_weight[g]);
        for (auto e = table.start[g]; e < table.start[g + 1]; ++e) sum[table.member[e]] += weight;
    }
    return sum;
}

}  // namespace pmbm
