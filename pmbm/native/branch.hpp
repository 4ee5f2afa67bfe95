// From the global hypotheses before a scan to those after it.  The plain versions are in
// branching.py, named beside each function, and say what is meant.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>

#include "k_best.hpp"
#include "join.hpp"
#include "tables.hpp"

namespace pmbm {

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
        const auto stays_at = [&](std::size_t child) {
            return log_weight[child] > log_threshold || log_weight[child] == top;
        };
        auto kept = first, use = first_use;
        while (kept < end && stays_at(kept)) ++kept;
        if (kept == end) return;
        while (use < taker.size() && taker[use] < static_cast<std::int64_t>(kept)) ++use;
        auto kept_use = use;
        for (auto child = kept; child < end; ++child) {
            const bool stays = stays_at(child);
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

// The gated pairs, and what each measurement and each cluster has of them: worked out once for all
// parents.
struct Scanned {
    PairsView known;
    const double *log_missed, *log_new;
    std::int64_t locals, measurements;
    // The pairs of local hypothesis i are first_pair[i] to first_pair[i + 1].
    Ints first_pair;
    // The measurements of cluster c are by_cluster[first_of[c]] to by_cluster[first_of[c + 1]].
    Ints first_of, by_cluster;
    Floats new_by_cluster;

    Scanned(const PairsView& known, const double* log_missed, std::int64_t locals,
            const double* log_new, std::int64_t measurements, const std::int64_t* cluster_of,
            std::int64_t clusters)
        : known(known), log_missed(log_missed), log_new(log_new), locals(locals),
          measurements(measurements), first_pair(static_cast<std::size_t>(locals) + 1, 0),
          first_of(static_cast<std::size_t>(clusters) + 1, 0),
          by_cluster(static_cast<std::size_t>(measurements)),
          new_by_cluster(static_cast<std::size_t>(clusters), 0.0) {
        for (std::int64_t p = 0; p < known.count; ++p) ++first_pair[known.row[p] + 1];
        for (std::int64_t i = 0; i < locals; ++i) first_pair[i + 1] += first_pair[i];
        for (std::int64_t m = 0; m < measurements; ++m) ++first_of[cluster_of[m] + 1];
        for (std::size_t c = 1; c < first_of.size(); ++c) first_of[c] += first_of[c - 1];
        Ints next(first_of);
        for (std::int64_t m = 0; m < measurements; ++m) {
            by_cluster[next[cluster_of[m]]++] = m;
            new_by_cluster[cluster_of[m]] += log_new[m];
        }
    }

    std::int64_t pairs_of(std::int64_t local) const {
        return first_pair[local + 1] - first_pair[local];
    }
};

// best_children(): the best children of every parent; `allowed` is for each cluster.
inline ChildrenOf best_children(const TableView& parents, const Scanned& scan,
                                const std::int64_t* allowed, std::int64_t largest_search,
                                double margin, double log_threshold) {
    const auto& known = scan.known;
    const auto& first_pair = scan.first_pair;
    const double *log_missed = scan.log_missed, *log_new = scan.log_new;
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
        row.resize(options.size());
        column.resize(options.size());
        cost.resize(options.size());
        costs.clear();
        std::int64_t rows = 0;
        for (std::size_t i = 0; i < options.size(); ++i) {
            const auto& o = options[i];
            rows += i == 0 || o.measurement != options[i - 1].measurement;
            row[i] = rows - 1;
            column[i] = o.entry - begin;
            const double missing = log_missed[parents.member[o.entry]];
            cost[i] = -(known.log_weight[o.pair] - missing - log_new[o.measurement]);
        }
        const auto cluster = parents.cluster[g];
        const double quota =
            std::ceil(static_cast<double>(allowed[cluster]) * std::exp(parents.log_weight[g]) -
                      1e-9);
        const auto most = largest_search / std::max<std::int64_t>(
                                               1, static_cast<std::int64_t>(options.size()));
        const auto before = found.taker.size(), children = found.parent.size();
        solver.choose({row.data(), column.data(), cost.data(),
                       static_cast<std::int64_t>(options.size()), 0, 0, rows, 0, end - begin},
                      std::max<std::int64_t>(
                          1, std::min(most, static_cast<std::int64_t>(quota))),
                      margin, costs,
                      found.taker, found.pair);
        for (auto i = before; i < found.pair.size(); ++i) {
            const auto& option = options[static_cast<std::size_t>(found.pair[i])];
            found.taker[i] += static_cast<std::int64_t>(children);
            found.entry.push_back(option.entry);
            found.pair[i] = option.pair;
        }
        const double base = parents.log_weight[g] + missed + scan.new_by_cluster[cluster];
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

// _over_candidates(): children as rows over the candidates, appended to a table.  taken (M,) : all
// 0, and so again afterwards.
inline void extend(Table& table, const TableView& parents, const ChildrenOf& children,
                   const Scanned& scan, std::vector<unsigned char>& taken) {
    const auto& known = scan.known;
    std::size_t use = 0;
    for (std::size_t child = 0; child < children.parent.size(); ++child) {
        const auto g = children.parent[child], begin = parents.start[g];
        const auto own = table.member.size(), first_use = use;
        table.member.insert(table.member.end(), parents.member + begin,
                            parents.member + parents.start[g + 1]);
        for (; use < children.taker.size() &&
               children.taker[use] == static_cast<std::int64_t>(child);
             ++use) {
            table.member[own + static_cast<std::size_t>(children.entry[use] - begin)] =
                scan.locals + children.pair[use];
            taken[known.measurement[children.pair[use]]] = 1;
        }
        const auto cluster = parents.cluster[g];
        for (auto i = scan.first_of[cluster]; i < scan.first_of[cluster + 1]; ++i) {
            const auto m = scan.by_cluster[i];
            if (!taken[m]) table.member.push_back(scan.locals + known.count + m);
        }
        for (auto i = first_use; i < use; ++i) taken[known.measurement[children.pair[i]]] = 0;
        table.close_row(cluster, children.log_weight[child]);
    }
}

// _affordable(): the heaviest rows of each cluster whose options are together at most `largest`, one
// at least.
inline Table affordable(const TableView& table, const Scanned& scan, std::int64_t largest) {
    Table kept;
    Ints rows, options(static_cast<std::size_t>(table.rows), 0);
    for (std::int64_t g = 0; g < table.rows; ++g) {
        for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
            options[g] += scan.pairs_of(table.member[e]);
        }
    }
    table.each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        rows.resize(static_cast<std::size_t>(last - first));
        std::iota(rows.begin(), rows.end(), first);
        std::stable_sort(rows.begin(), rows.end(), [&](std::int64_t a, std::int64_t b) {
            return table.log_weight[a] > table.log_weight[b];
        });
        std::size_t count = 0;
        for (std::int64_t sum = 0; count < rows.size(); ++count) {
            sum += options[rows[count]];
            if (count && sum > largest) break;
        }
        rows.resize(count);
        std::sort(rows.begin(), rows.end());
        for (const auto g : rows) {
            kept.member.insert(kept.member.end(), table.member + table.start[g],
                               table.member + table.start[g + 1]);
            kept.close_row(cluster, table.log_weight[g]);
        }
    });
    return kept;
}

struct BranchLimits {
    std::int64_t max_hypotheses;
    double largest_table;
    std::int64_t largest_search;
    double margin, log_threshold;
    bool clustering;
};

// branch(): the children of all rows, over the candidates.
inline Table branched(const TableView& table, const PairsView& known, const double* log_missed,
                      std::int64_t locals, const double* log_new, std::int64_t measurements,
                      const BranchLimits& limits, std::int64_t& dropped) {
    constexpr std::size_t at_once = 1 << 15;
    Table grown;
    dropped = 0;
    std::vector<unsigned char> taken(static_cast<std::size_t>(measurements), 0);
    const auto grow = [&](TableView parents, const Scanned& scan, const std::int64_t* allowed) {
        std::int64_t options = 0;
        for (std::int64_t e = 0; e < parents.members(); ++e) {
            options += scan.pairs_of(parents.member[e]);
        }
        Table cut;
        if (options > limits.largest_search) {
            cut = affordable(parents, scan, limits.largest_search);
            parents = view_of(cut);
        }
        const auto children = best_children(parents, scan, allowed, limits.largest_search,
                                            limits.margin, limits.log_threshold);
        dropped += children.dropped;
        extend(grown, parents, children, scan, taken);
    };
    if (!limits.clustering) {
        const auto clusters = table.clusters();
        const Ints of_measurement(static_cast<std::size_t>(measurements), 0),
            allowed(static_cast<std::size_t>(clusters), limits.max_hypotheses);
        grow(table,
             Scanned(known, log_missed, locals, log_new, measurements, of_measurement.data(),
                     clusters),
             allowed.data());
        return grown;
    }
    Joining joining(table, locals, known.row, known.measurement,
                    static_cast<std::size_t>(known.count), measurements, limits.max_hypotheses,
                    limits.largest_table);
    const auto clusters = joining.clusters();
    const Scanned scan(known, log_missed, locals, log_new, measurements,
                       joining.of_measurement.data(), clusters);
    Ints allowed(static_cast<std::size_t>(clusters), limits.max_hypotheses);
    Table parents;
    const auto expected = std::min<std::int64_t>(table.rows + measurements, at_once);
    parents.reserve(expected, expected);
    grown.reserve(expected, expected);
    for (std::int64_t number = 0; number < clusters; ++number) {
        joining.append(number, parents);
        if (parents.member.size() < at_once && number + 1 < clusters) continue;
        limit_rows(view_of(parents), limits.max_hypotheses, limits.largest_table, allowed);
        grow(view_of(parents), scan, allowed.data());
        parents.clear();
    }
    return grown;
}

}  // namespace pmbm
