// Clusters of global hypotheses that measurements tie together, as one cluster each.  The plain
// versions are components(), join() and row_limit() of clusters.py, and say what is meant.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "tables.hpp"

namespace pmbm {

// row_limit() of one cluster.
inline double row_limit(double rows, double members, double cap, double largest) {
    return std::clamp(largest * rows / std::max(members, 1.0), 1.0, cap);
}

// Of the clusters that the table holds rows of.
inline void limit_rows(const TableView& table, std::int64_t cap, double largest, Ints& limits) {
    table.each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        const double limit = row_limit(static_cast<double>(last - first),
                                       static_cast<double>(table.start[last] - table.start[first]),
                                       static_cast<double>(cap), largest);
        limits[cluster] = static_cast<std::int64_t>(limit);
    });
}

// components(): what each cluster and each measurement is called once ties have joined clusters.
class Components {
 public:
    Components(std::int64_t clusters, std::int64_t measurements, const Ints& pair_cluster,
               const std::int64_t* pair_measurement)
        : leader_(static_cast<std::size_t>(clusters)), number(leader_.size(), -1),
          of_measurement(static_cast<std::size_t>(measurements), -1) {
        std::iota(leader_.begin(), leader_.end(), 0);
        for (std::size_t i = 0; i < pair_cluster.size(); ++i) {
            auto& owner = of_measurement[pair_measurement[i]];
            if (owner < 0) owner = pair_cluster[i];
            unite(owner, pair_cluster[i]);
        }
        Ints size(leader_.size(), 0);
        for (std::int64_t c = 0; c < clusters; ++c) ++size[find(c)];
        for (std::int64_t c = 0; c < clusters; ++c) {
            if (size[find(c)] == 1) number[c] = apart++;
        }
        // The least cluster of a component leads it, so it comes first and names the others.
        for (std::int64_t c = 0; c < clusters; ++c) {
            const auto leader = find(c);
            if (size[leader] == 1) continue;
            if (leader == c) {
                number[c] = apart + static_cast<std::int64_t>(products.size());
                products.emplace_back();
            }
            number[c] = number[leader];
            products[static_cast<std::size_t>(number[c] - apart)].push_back(c);
        }
        for (auto& owner : of_measurement) {
            owner = owner < 0 ? apart + static_cast<std::int64_t>(products.size()) + alone++
                              : number[owner];
        }
    }

 private:
    std::int64_t find(std::int64_t cluster) {
        while (leader_[cluster] != cluster) {
            cluster = leader_[cluster] = leader_[leader_[cluster]];
        }
        return cluster;
    }

    void unite(std::int64_t one, std::int64_t other) {
        one = find(one);
        other = find(other);
        leader_[std::max(one, other)] = std::min(one, other);
    }

    Ints leader_;

 public:
    Ints number, of_measurement;
    // Clusters that stay apart, and measurements in the gate of none.
    std::int64_t apart = 0, alone = 0;
    // The clusters of each component that has several.
    std::vector<Ints> products;
};

// The product of some clusters, appended to a table: _product_rows() and _best_of_product().
class Product {
 public:
    Product(const TableView& table, const Ints& first_row, std::int64_t cap, double largest)
        : table_(table), first_row_(first_row), cap_(cap), largest_(largest) {}

    void append(const Ints& clusters, std::int64_t number, Table& joined) {
        double breadth = 0, rows = 1;
        for (const auto c : clusters) {
            const double members = static_cast<double>(table_.start[first_row_[c + 1]] -
                                                       table_.start[first_row_[c]]);
            breadth += members / static_cast<double>(size(c));
            rows = std::min(rows, largest_ + 1) * static_cast<double>(size(c));
        }
        const double limit = row_limit(1.0, breadth, static_cast<double>(cap_), largest_);
        if (rows <= limit) {
            factors_ = clusters;
            append_all(static_cast<std::int64_t>(rows), number, joined);
        } else {
            factors_ = clusters;
            std::stable_sort(factors_.begin(), factors_.end(), [this](auto a, auto b) {
                return size(a) < size(b);
            });
            append_best(static_cast<std::size_t>(limit), number, joined);
        }
    }

 private:
    // A sum of weights so far, the sum before it, and the row that was added to that.
    struct Way {
        double weight;
        std::size_t before;
        std::int64_t row;
    };

    std::int64_t size(std::int64_t cluster) const {
        return first_row_[cluster + 1] - first_row_[cluster];
    }

    void append_row(std::int64_t row, Table& joined) const {
        joined.member.insert(joined.member.end(), table_.member + table_.start[row],
                             table_.member + table_.start[row + 1]);
    }

    // All combinations, counted like the digits of a clock: one wheel a factor.
    void append_all(std::int64_t rows, std::int64_t number, Table& joined) const {
        for (std::int64_t combination = 0; combination < rows; ++combination) {
            double weight = 0;
            auto rest = combination;
            for (const auto c : factors_) {
                const auto row = first_row_[c] + rest % size(c);
                rest /= size(c);
                weight += table_.log_weight[row];
                append_row(row, joined);
            }
            joined.close_row(number, weight);
        }
    }

    // The likeliest combinations, kept factor by factor.
    void append_best(std::size_t limit, std::int64_t number, Table& joined) {
        ways_.assign(1, {0.0, 0, 0});
        std::size_t first = 0;
        for (const auto c : factors_) {
            const auto last = ways_.size();
            tried_.clear();
            for (auto before = first; before < last; ++before) {
                for (auto row = first_row_[c]; row < first_row_[c + 1]; ++row) {
                    tried_.push_back({ways_[before].weight + table_.log_weight[row], before, row});
                }
            }
            keep_best(limit);
            first = last;
            ways_.insert(ways_.end(), tried_.begin(), tried_.end());
        }
        Ints chosen(factors_.size());
        for (auto way = first; way < ways_.size(); ++way) {
            auto at = way;
            for (auto k = chosen.size(); k-- > 0; at = ways_[at].before) chosen[k] = ways_[at].row;
            for (const auto row : chosen) append_row(row, joined);
            joined.close_row(number, ways_[way].weight);
        }
    }

    // The heaviest of `tried_`, the first of equals, in their order.
    void keep_best(std::size_t limit) {
        if (tried_.size() <= limit) return;
        order_.resize(tried_.size());
        std::iota(order_.begin(), order_.end(), std::size_t{0});
        const auto cut = order_.begin() + static_cast<std::ptrdiff_t>(limit);
        std::nth_element(order_.begin(), cut, order_.end(), [this](auto a, auto b) {
            const double one = tried_[a].weight, other = tried_[b].weight;
            return one != other ? one > other : a < b;
        });
        std::sort(order_.begin(), cut);
        for (std::size_t i = 0; i < limit; ++i) tried_[i] = tried_[order_[i]];
        tried_.resize(limit);
    }

    const TableView& table_;
    const Ints& first_row_;
    std::int64_t cap_;
    double largest_;
    Ints factors_;
    std::vector<Way> ways_, tried_;
    std::vector<std::size_t> order_;
};

// join(): the clusters that stay apart, then products, then measurements without a cluster; made one
// by one, since all products of a crowded scene together can be large.
class Joining {
 public:
    Joining(const TableView& table, std::int64_t locals, const std::int64_t* pair_row,
            const std::int64_t* pair_measurement, std::size_t pairs, std::int64_t measurements,
            std::int64_t cap, double largest)
        : table_(table), product_(table_, first_row_, cap, largest) {
        Ints cluster_of(static_cast<std::size_t>(locals), 0), pair_cluster;
        table_.each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
            first_row_.push_back(first);
            for (auto e = table_.start[first]; e < table_.start[last]; ++e) {
                cluster_of[table_.member[e]] = cluster;
            }
        });
        first_row_.push_back(table_.rows);
        pair_cluster.reserve(pairs);
        for (std::size_t i = 0; i < pairs; ++i) pair_cluster.push_back(cluster_of[pair_row[i]]);
        Components ties(table_.clusters(), measurements, pair_cluster, pair_measurement);
        for (std::size_t c = 0; c < ties.number.size(); ++c) {
            if (ties.number[c] < ties.apart) apart_.push_back(static_cast<std::int64_t>(c));
        }
        products_ = std::move(ties.products);
        alone_ = ties.alone;
        of_measurement = std::move(ties.of_measurement);
    }
    Joining(const Joining&) = delete;

    std::int64_t clusters() const {
        return static_cast<std::int64_t>(apart_.size() + products_.size()) + alone_;
    }

    // Appends the rows of the cluster of this number.
    void append(std::int64_t number, Table& joined) {
        const auto at = static_cast<std::size_t>(number);
        if (at < apart_.size()) {
            const auto c = apart_[at];
            for (auto g = first_row_[c]; g < first_row_[c + 1]; ++g) {
                joined.member.insert(joined.member.end(), table_.member + table_.start[g],
                                     table_.member + table_.start[g + 1]);
                joined.close_row(number, table_.log_weight[g]);
            }
        } else if (at < apart_.size() + products_.size()) {
            product_.append(products_[at - apart_.size()], number, joined);
        } else {
            joined.close_row(number, 0.0);
        }
    }

    Ints of_measurement;

 private:
    TableView table_;
    Ints first_row_, apart_;
    std::vector<Ints> products_;
    std::int64_t alone_ = 0;
    Product product_;
};

}  // namespace pmbm
