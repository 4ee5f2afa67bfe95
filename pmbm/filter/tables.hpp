// Tables of global hypotheses: extending them by a scan's associations, pruning and splitting them.
// The plain versions, of the same names or named beside each function, are in association.py,
// update.py, reduction.py, clusters.py and estimation.py, and say what is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "assignment/k_best.hpp"

namespace pmbm {

using Ints = std::vector<std::int64_t>;
using Floats = std::vector<double>;

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

    void close_row(std::int64_t of_cluster, double weight) {
        cluster.push_back(of_cluster);
        log_weight.push_back(weight);
        start.push_back(static_cast<std::int64_t>(member.size()));
    }
};

// Makes the weights of rows first to last - 1 add up to one.
inline void normalise(double* log_weight, std::int64_t first, std::int64_t last) {
    double top = -std::numeric_limits<double>::infinity();
    for (auto g = first; g < last; ++g) top = std::max(top, log_weight[g]);
    double total = 0;
    for (auto g = first; g < last; ++g) total += std::exp(log_weight[g] - top);
    const double shift = std::log(total);
    for (auto g = first; g < last; ++g) log_weight[g] = log_weight[g] - top - shift;
}

// Gated pairs of a local hypothesis and a measurement, sorted by the former.
struct PairsView {
    const std::int64_t *row, *measurement;
    const double* log_weight;
    std::int64_t count;
};

struct ChildrenOf {
    Ints parent, taker, entry, pair;
    Floats log_weight;
    std::int64_t dropped = 0;

    // The children from `first` on, of uses from `first_use` on, are all of a cluster: their weights
    // are made to add up to one, and those of a share up to the threshold are dropped.
    void close_cluster(std::size_t first, std::size_t first_use, double log_threshold) {
        const auto end = parent.size();
        normalise(log_weight.data(), static_cast<std::int64_t>(first),
                  static_cast<std::int64_t>(end));
        if (end - first < 2) return;
        const double top = *std::max_element(log_weight.begin() + static_cast<long>(first),
                                             log_weight.end());
        auto kept = first, use = first_use, kept_use = first_use;
        for (auto child = first; child < end; ++child) {
            const bool stays = log_weight[child] > log_threshold || log_weight[child] == top;
            for (; use < taker.size() && taker[use] == static_cast<std::int64_t>(child); ++use) {
                if (!stays) continue;
                taker[kept_use] = static_cast<std::int64_t>(kept);
                entry[kept_use] = entry[use];
                pair[kept_use++] = pair[use];
            }
            if (!stays) continue;
            parent[kept] = parent[child];
            log_weight[kept++] = log_weight[child];
        }
        if (kept == end) return;
        dropped += static_cast<std::int64_t>(end - kept);
        parent.resize(kept);
        log_weight.resize(kept);
        taker.resize(kept_use);
        entry.resize(kept_use);
        pair.resize(kept_use);
        normalise(log_weight.data(), static_cast<std::int64_t>(first),
                  static_cast<std::int64_t>(kept));
    }
};

// _children(): the best children of every parent; `allowed` is for each cluster.
inline ChildrenOf best_children(const TableView& parents, const PairsView& known,
                                const double* log_missed, std::int64_t locals,
                                const double* log_new, const std::int64_t* cluster_of,
                                std::int64_t measurements, const std::int64_t* allowed,
                                double margin, double log_threshold) {
    Ints first_pair(static_cast<std::size_t>(locals) + 1, 0);
    for (std::int64_t p = 0; p < known.count; ++p) ++first_pair[known.row[p] + 1];
    for (std::int64_t i = 0; i < locals; ++i) first_pair[i + 1] += first_pair[i];
    Floats new_by_cluster(static_cast<std::size_t>(parents.clusters()), 0.0);
    for (std::int64_t m = 0; m < measurements; ++m) new_by_cluster[cluster_of[m]] += log_new[m];

    struct Option {
        std::int64_t measurement, entry, pair;
    };
    std::vector<Option> options;
    Ints row, column;
    Floats cost, costs;
    ChildrenOf found;
    KBest solver;
    const auto find = [&](std::int64_t g) {
        const auto begin = parents.start[g], end = parents.start[g + 1];
        double missed = 0;
        options.clear();
        for (auto entry = begin; entry < end; ++entry) {
            const auto local = parents.member[entry];
            missed += log_missed[local];
            for (auto p = first_pair[local]; p < first_pair[local + 1]; ++p) {
                options.push_back({known.measurement[p], entry, p});
            }
        }
        std::sort(options.begin(), options.end(), [](const Option& a, const Option& b) {
            return a.measurement != b.measurement ? a.measurement < b.measurement
                                                  : a.entry < b.entry;
        });
        row.clear();
        column.clear();
        cost.clear();
        costs.clear();
        std::int64_t rows = 0;
        for (std::size_t i = 0; i < options.size(); ++i) {
            const auto& o = options[i];
            rows += i == 0 || o.measurement != options[i - 1].measurement;
            row.push_back(rows - 1);
            column.push_back(o.entry - begin);
            const double missing = log_missed[parents.member[o.entry]];
            cost.push_back(-(known.log_weight[o.pair] - missing - log_new[o.measurement]));
        }
        const auto cluster = parents.cluster[g];
        const double quota =
            std::ceil(static_cast<double>(allowed[cluster]) * std::exp(parents.log_weight[g]) -
                      1e-9);
        const auto before = found.taker.size(), children = found.parent.size();
        solver.choose({row.data(), column.data(), cost.data(),
                       static_cast<std::int64_t>(options.size()), 0, 0, rows, 0, end - begin},
                      std::max<std::int64_t>(1, static_cast<std::int64_t>(quota)), margin, costs,
                      found.taker, found.pair);
        for (auto i = before; i < found.pair.size(); ++i) {
            const auto& option = options[static_cast<std::size_t>(found.pair[i])];
            found.taker[i] += static_cast<std::int64_t>(children);
            found.entry.push_back(option.entry);
            found.pair[i] = option.pair;
        }
        const double base = parents.log_weight[g] + missed + new_by_cluster[cluster];
        for (const auto one : costs) {
            found.parent.push_back(g);
            found.log_weight.push_back(base - one);
        }
    };
    parents.each_cluster([&](std::int64_t, std::int64_t first, std::int64_t last) {
        const auto child = found.parent.size(), use = found.taker.size();
        for (auto g = first; g < last; ++g) find(g);
        found.close_cluster(child, use, log_threshold);
    });
    return found;
}

struct ChildrenView {
    const std::int64_t *parent, *taker, *entry, *pair;
    const double* log_weight;
    std::size_t count, uses;
};

// _hypotheses(): children as rows over the candidates.
inline Table extended(const TableView& parents, const ChildrenView& children,
                      const PairsView& known,
                      const std::int64_t* cluster_of, std::int64_t measurements,
                      std::int64_t locals) {
    Ints first_of(static_cast<std::size_t>(parents.clusters()) + 1, 0);
    for (std::int64_t m = 0; m < measurements; ++m) ++first_of[cluster_of[m] + 1];
    for (std::size_t c = 1; c < first_of.size(); ++c) first_of[c] += first_of[c - 1];
    Ints by_cluster(static_cast<std::size_t>(measurements)), next(first_of);
    for (std::int64_t m = 0; m < measurements; ++m) by_cluster[next[cluster_of[m]]++] = m;

    std::vector<unsigned char> taken(static_cast<std::size_t>(measurements), 0);
    Table table;
    std::size_t use = 0;
    for (std::size_t child = 0; child < children.count; ++child) {
        const auto g = children.parent[child], begin = parents.start[g];
        const auto own = table.member.size(), first_use = use;
        table.member.insert(table.member.end(), parents.member + begin,
                            parents.member + parents.start[g + 1]);
        for (; use < children.uses &&
               children.taker[use] == static_cast<std::int64_t>(child);
             ++use) {
            table.member[own + static_cast<std::size_t>(children.entry[use] - begin)] =
                locals + children.pair[use];
            taken[known.measurement[children.pair[use]]] = 1;
        }
        const auto cluster = parents.cluster[g];
        for (auto i = first_of[cluster]; i < first_of[cluster + 1]; ++i) {
            if (!taken[by_cluster[i]]) {
                table.member.push_back(locals + known.count + by_cluster[i]);
            }
        }
        for (auto i = first_use; i < use; ++i) taken[known.measurement[children.pair[i]]] = 0;
        table.close_row(cluster, children.log_weight[child]);
    }
    return table;
}

// likely(), _best() and _keep(): the rows above the threshold, at most `cap` of each cluster, and
// its best one in any case.  `likely` is how many were above the threshold.
inline Table pruned(const TableView& table, double log_threshold, const std::int64_t* cap,
                    std::int64_t& likely) {
    Table kept;
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

// One cluster as a dense table of local hypotheses: rows x tracks, both in order, -1 for absent.
struct Dense {
    Ints tracks, choice;
    Floats weight;

    Dense(const TableView& table, const std::int64_t* track, std::int64_t first,
          std::int64_t last) {
        for (auto e = table.start[first]; e < table.start[last]; ++e) {
            tracks.push_back(track[table.member[e]]);
        }
        std::sort(tracks.begin(), tracks.end());
        tracks.erase(std::unique(tracks.begin(), tracks.end()), tracks.end());
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
            if (dense.at(row, column) >= 0) names.push_back(dense.at(row, column));
        }
        std::sort(names.begin() + begin, names.end());
        names.erase(std::unique(names.begin() + begin, names.end()), names.end());
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

// Of each track (T,) the row of the largest mass, the first of them.
inline Ints likeliest(const std::int64_t* track, const double* mass, std::size_t rows,
                      std::size_t tracks) {
    Ints best(tracks, -1);
    for (std::size_t row = 0; row < rows; ++row) {
        auto& leader = best[track[row]];
        if (leader < 0 || mass[row] > mass[leader]) leader = static_cast<std::int64_t>(row);
    }
    return best;
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
