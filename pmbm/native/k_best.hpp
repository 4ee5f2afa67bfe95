// The k cheapest assignments of rows to columns: Murty's partition, with the refinements of
// Miller, Stone and Cox.  No Python in here; native.cpp is the binding.
//
//   K. G. Murty, Operations Research 16(3), 1968: the partition.
//   M. L. Miller, H. S. Stone, I. J. Cox, IEEE Trans. AES 33(3), 1997: a part inherits its parent's
//     assignment and prices, so that its best member costs one shortest path; parts wait under a
//     lower bound until it is their turn; the parts least likely to matter stay the widest.
//
// Words: every row holds one column; a column that no row holds is free, and all free columns are
// held by one imaginary row, the hub, at cost 0.  So freeing a column and taking another is a path
// that leads through the hub, and rectangular problems need no case of their own.  Prices (dual
// variables) keep every reduced cost cost - row price - column price at 0 or above, and at 0 for a
// pair that is held.  The price of a free column is minus the hub's, so it is not stored.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

namespace pmbm {

class KBest {
 public:
    // Appends to `columns` n x rows column indices and to `costs` n sums, cheapest first (equal
    // costs by columns), n <= k.  `cost` is rows x width, row-major, finite or +inf.
    std::int64_t solve(const double* cost, std::int32_t rows, std::int32_t width, std::int64_t k,
                       std::vector<std::int32_t>& columns, std::vector<double>& costs) {
        load(cost, rows, width);
        const auto order = rank(k, kInf);
        for (const auto i : order) {
            costs.push_back(found_costs_[i]);
            columns.insert(columns.end(), found(i), found(i) + rows_);
        }
        return static_cast<std::int64_t>(order.size());
    }

    // A sparse problem: option i lets `row[i]` take `column[i]` at `cost[i]`, sorted by row, then
    // column; a row may also take nothing, at cost 0.  Rows, columns and options are numbered
    // through over many problems; the first_... say where this one's begin.
    struct Options {
        const std::int64_t *row, *column;
        const double* cost;
        std::int64_t count, first, first_row, rows, first_column, columns;
    };

    // The k cheapest ways within `margin` of the cheapest.  Appends their costs to `costs`, and to
    // `takers` and `taken` the index into `costs` of a way and an option that it uses.
    std::int64_t choose(const Options& o, std::int64_t k, double margin, std::vector<double>& costs,
                        std::vector<std::int64_t>& takers, std::vector<std::int64_t>& taken) {
        if (o.rows <= 1 || o.columns <= 1) return choose_one(o, k, margin, costs, takers, taken);
        if (k == 1 && choose_apart(o, costs, takers, taken)) return 1;
        rows_ = static_cast<std::int32_t>(o.rows);
        width_ = static_cast<std::int32_t>(o.columns + o.rows);
        clear();
        const auto entries = static_cast<std::size_t>(o.count + o.rows);
        column_.resize(entries);
        cost_.resize(entries);
        std::int64_t option = 0;
        std::size_t entry = 0;
        for (std::int32_t row = 0; row < rows_; ++row) {
            for (; option < o.count && o.row[option] == o.first_row + row; ++option, ++entry) {
                column_[entry] = static_cast<std::int32_t>(o.column[option] - o.first_column);
                cost_[entry] = o.cost[option];
            }
            // Taking nothing is a column of the row's own.
            column_[entry] = static_cast<std::int32_t>(o.columns) + row;
            cost_[entry++] = 0.0;
            start_.push_back(entry);
        }
        prepare();
        const auto order = rank(k, margin);
        for (const auto i : order) {
            const auto way = static_cast<std::int64_t>(costs.size());
            for (std::int32_t row = 0; row < rows_; ++row) {
                const auto column = found(i)[row];
                if (column >= o.columns) continue;
                takers.push_back(way);
                // Every row before this one has one entry more than options.
                const auto entry = found_entries_[i * static_cast<std::size_t>(rows_) +
                                                  static_cast<std::size_t>(row)];
                taken.push_back(o.first + static_cast<std::int64_t>(entry) - row);
            }
            costs.push_back(found_costs_[i]);
        }
        return static_cast<std::int64_t>(order.size());
    }

 private:
    // choose() of a single row or column, or none: its options, and nothing, in order of their costs.
    std::int64_t choose_one(const Options& o, std::int64_t k, double margin,
                            std::vector<double>& costs, std::vector<std::int64_t>& takers,
                            std::vector<std::int64_t>& taken) {
        by_cost_.assign(1, {0.0, o.count});
        for (std::int64_t option = 0; option < o.count; ++option) {
            by_cost_.push_back({o.cost[option], option});
        }
        std::sort(by_cost_.begin(), by_cost_.end());
        std::int64_t found = 0;
        for (const auto& [cost, option] : by_cost_) {
            if (found == k || cost > by_cost_.front().first + margin) break;
            if (option < o.count) {
                takers.push_back(static_cast<std::int64_t>(costs.size()));
                taken.push_back(o.first + option);
            }
            costs.push_back(cost);
            ++found;
        }
        return found;
    }

    // The cheapest way of choose() alone, if no two rows want one column: each row's cheapest option.
    bool choose_apart(const Options& o, std::vector<double>& costs,
                      std::vector<std::int64_t>& takers, std::vector<std::int64_t>& taken) {
        is_banned_.resize(std::max(is_banned_.size(), static_cast<std::size_t>(o.columns)), 0);
        const auto way = static_cast<std::int64_t>(costs.size());
        const auto first = taken.size();
        bool apart = true;
        double total = 0;
        for (std::int64_t option = 0; option < o.count && apart;) {
            const auto row = o.row[option];
            auto best = option;
            for (; option < o.count && o.row[option] == row; ++option) {
                if (o.cost[option] < o.cost[best]) best = option;
            }
            if (o.cost[best] > 0) continue;
            auto& wanted = is_banned_[static_cast<std::size_t>(o.column[best] - o.first_column)];
            apart = !wanted;
            wanted = 1;
            total += o.cost[best];
            takers.push_back(way);
            taken.push_back(o.first + best);
        }
        for (auto i = first; i < taken.size(); ++i) {
            const auto column = o.column[taken[i] - o.first] - o.first_column;
            is_banned_[static_cast<std::size_t>(column)] = 0;
        }
        if (apart) {
            costs.push_back(total);
        } else {
            takers.resize(first);
            taken.resize(first);
        }
        return apart;
    }

    static constexpr double kInf = std::numeric_limits<double>::infinity();
    static constexpr std::int32_t kNone = -1;
    static constexpr std::int32_t kHub = -2;
    // Turns of rows that have not been extracted yet: above every turn that counts.
    static constexpr std::int32_t kLater = std::numeric_limits<std::int32_t>::max();

    // One assignment with its prices, the cheapest of a set of assignments.  The set: rows of turn
    // kLater that wait in no part are fixed, and `banned` entries of the matrix are forbidden.
    struct Node {
        double cost = 0;
        double hub_price = 0;
        std::size_t first_banned = 0, banned_count = 0;
        std::size_t first_part = 0, part_count = 0, waiting = 0;
    };

    // The part of a node's set in which `row` does not hold its column; `bound` is below the cost
    // of every member.  Waiting parts are a heap; extracted ones stand behind it, the latest first.
    struct Part {
        double bound;
        std::int32_t row;
        bool operator>(const Part& other) const {
            return bound > other.bound || (bound == other.bound && row > other.row);
        }
    };

    // How a part's cheapest member differs from its parent: the path's new pairs, and the columns
    // whose prices (and whose holders' prices) move.
    struct Change {
        std::size_t node, part;
        double length, hub_distance;
        std::int32_t hub_column, freed;
        std::size_t first_pair, pair_count;
        std::size_t first_scanned, scanned_count;
    };
    struct Pair {
        std::int32_t row, column;
    };
    struct Scanned {
        std::int32_t column;
        double distance;
    };

    // What waits in the queue: a solved part (change >= 0), or the cheapest bound of a node's parts.
    struct Entry {
        double cost;
        std::ptrdiff_t change;
        std::size_t node;
        bool operator>(const Entry& other) const {
            if (cost != other.cost) return cost > other.cost;
            if ((change < 0) != (other.change < 0)) return change < 0;
            return change < 0 ? node > other.node : change > other.change;
        }
    };

    std::vector<std::pair<double, std::int64_t>> by_cost_;

    // The problem: the finite entries, row by row.
    std::int32_t rows_ = 0, width_ = 0;
    std::vector<std::size_t> start_;
    std::vector<std::int32_t> column_;
    std::vector<double> cost_;

    // All nodes' tables, one after the other: rows_ or width_ items each.
    std::vector<Node> nodes_;
    std::vector<double> row_price_, column_price_;
    std::vector<std::int32_t> held_, turn_, holder_;
    std::vector<std::size_t> banned_;
    std::vector<Part> parts_;
    std::vector<Change> changes_;
    std::vector<Pair> pairs_;
    std::vector<Scanned> scanned_;
    std::vector<Entry> queue_;
    // The k smallest costs of solutions known so far, emitted or waiting, the largest on top.
    std::vector<double> cheapest_;
    std::int64_t k_ = 0;
    double margin_ = kInf;

    // Of every solution, row by row: the columns held, and where these stand among the entries.
    std::vector<std::int32_t> found_columns_;
    std::vector<std::size_t> found_entries_;
    std::vector<double> found_costs_;

    // Scratch of one search; between searches `distance_` is inf and `is_banned_` 0 everywhere.
    std::vector<double> distance_, column_slack_;
    std::vector<std::int32_t> from_, frontier_, touched_, open_rows_;
    std::vector<unsigned char> is_banned_;

    // Pointers into one node's tables; any growth of the tables ends their life.
    struct Tables {
        double *row_price, *column_price;
        std::int32_t *held, *turn, *holder;
    };
    Tables tables(std::size_t node) {
        const auto r = node * static_cast<std::size_t>(rows_);
        const auto c = node * static_cast<std::size_t>(width_);
        return {row_price_.data() + r, column_price_.data() + c, held_.data() + r,
                turn_.data() + r, holder_.data() + c};
    }

    std::size_t add_node() {
        const auto count = nodes_.size() + 1;
        nodes_.emplace_back();
        row_price_.resize(count * rows_);
        column_price_.resize(count * width_);
        held_.resize(count * rows_);
        turn_.resize(count * rows_);
        holder_.resize(count * width_);
        return count - 1;
    }

    void load(const double* cost, std::int32_t rows, std::int32_t width) {
        rows_ = rows;
        width_ = width;
        clear();
        for (std::int32_t row = 0; row < rows; ++row) {
            const double* line = cost + static_cast<std::size_t>(row) * width;
            for (std::int32_t column = 0; column < width; ++column) {
                if (line[column] < kInf) {
                    column_.push_back(column);
                    cost_.push_back(line[column]);
                }
            }
            start_.push_back(column_.size());
        }
        prepare();
    }

    void clear() {
        start_.assign(1, 0);
        column_.clear();
        cost_.clear();
        nodes_.clear();
        row_price_.clear();
        column_price_.clear();
        held_.clear();
        turn_.clear();
        holder_.clear();
        banned_.clear();
        parts_.clear();
        changes_.clear();
        pairs_.clear();
        scanned_.clear();
        queue_.clear();
        cheapest_.clear();
        found_columns_.clear();
        found_entries_.clear();
        found_costs_.clear();
    }

    void prepare() {
        const auto width = static_cast<std::size_t>(width_);
        if (distance_.size() < width) {
            distance_.resize(width, kInf);
            column_slack_.resize(width);
            from_.resize(width);
        }
        if (is_banned_.size() < cost_.size()) is_banned_.resize(cost_.size(), 0);
    }

    // Finds the k best within `margin` of the best; gives their order among the found ones.
    std::vector<std::size_t> rank(std::int64_t k, double margin) {
        k_ = k;
        margin_ = margin;
        if (k > 0 && rows_ <= width_ && solve_first()) {
            emit();
            while (static_cast<std::int64_t>(found_costs_.size()) < k) {
                open_parts();
                if (!next_best()) break;
                emit();
            }
        }
        return in_order();
    }

    // The cheapest assignment of all, row by row along shortest paths.
    bool solve_first() {
        const auto node = add_node();
        const auto t = tables(node);
        std::fill_n(t.column_price, width_, 0.0);
        std::fill_n(t.held, rows_, kNone);
        std::fill_n(t.turn, rows_, 0);
        std::fill_n(t.holder, width_, kNone);
        for (std::int32_t row = 0; row < rows_; ++row) {
            std::size_t best = start_[row];
            for (auto entry = start_[row]; entry < start_[row + 1]; ++entry) {
                if (cost_[entry] < cost_[best]) best = entry;
            }
            if (best == start_[row + 1]) return false;
            t.row_price[row] = cost_[best];
            if (t.holder[column_[best]] == kNone) {
                t.holder[column_[best]] = row;
                t.held[row] = column_[best];
            }
        }
        for (std::int32_t row = 0; row < rows_; ++row) {
            if (t.held[row] != kNone) continue;
            Change change{};
            if (!search(node, row, kNone, 0, kInf, nullptr, 0, change)) return false;
            apply(t, t, nodes_[node].hub_price, change, row);
            pairs_.clear();
            scanned_.clear();
        }
        open_rows_.resize(rows_);
        for (std::int32_t row = 0; row < rows_; ++row) open_rows_[row] = row;
        return true;
    }

    // Dijkstra over reduced costs, from `start`, whose column is `terminal`, back to that column;
    // with no terminal, to any free column.  Rows of a turn after `last` are fixed; `others` are the
    // rows that are not.  Paths longer than `limit` are given up.
    bool search(std::size_t node, std::int32_t start, std::int32_t terminal, std::int32_t last,
                double limit, const Part* others, std::size_t other_count, Change& change) {
        const auto t = tables(node);
        const double hub_price = nodes_[node].hub_price;
        frontier_.clear();
        touched_.clear();
        const auto first_scanned = scanned_.size();
        double hub = kInf, end = limit;
        std::int32_t hub_column = kNone, hub_from = kNone;
        bool hub_done = false, reached = false;

        const auto reach = [&](std::int32_t column, double distance, std::int32_t from) {
            if (distance > end || distance >= distance_[column]) return;
            if (distance_[column] == kInf) {
                touched_.push_back(column);
                if (column != terminal) frontier_.push_back(column);
            }
            distance_[column] = distance;
            from_[column] = from;
            if (column == terminal) {
                end = distance;
                reached = true;
            }
        };

        const auto scan = [&](std::int32_t row, double base) {
            const double price = t.row_price[row];
            for (auto entry = start_[row]; entry < start_[row + 1]; ++entry) {
                const auto column = column_[entry];
                const auto holder = t.holder[column];
                if (holder == kNone) {
                    const double distance =
                        base + std::max(0.0, cost_[entry] - price + hub_price);
                    if (distance < hub && distance <= end && !is_banned_[entry]) {
                        hub = distance;
                        hub_column = column;
                        hub_from = row;
                    }
                } else if (t.turn[holder] <= last && !is_banned_[entry]) {
                    const double reduced = cost_[entry] - price - t.column_price[column];
                    reach(column, base + std::max(0.0, reduced), row);
                }
            }
        };

        scan(start, 0.0);
        while (true) {
            std::size_t nearest = 0;
            double distance = kInf;
            for (std::size_t i = 0; i < frontier_.size(); ++i) {
                if (distance_[frontier_[i]] < distance) {
                    distance = distance_[frontier_[i]];
                    nearest = i;
                }
            }
            const bool through_hub = !hub_done && hub <= distance;
            if (through_hub) distance = hub;
            if (distance == kInf || distance > end || (reached && distance == end)) break;
            if (through_hub) {
                hub_done = true;
                if (terminal == kNone) {
                    end = hub;
                    reached = true;
                    break;
                }
                for (std::size_t i = 0; i < other_count; ++i) {
                    const auto column = t.held[others[i].row];
                    reach(column, hub + std::max(0.0, -hub_price - t.column_price[column]), kHub);
                }
            } else {
                const auto column = frontier_[nearest];
                frontier_[nearest] = frontier_.back();
                frontier_.pop_back();
                scanned_.push_back({column, distance});
                scan(t.holder[column], distance);
            }
        }
        for (const auto column : touched_) distance_[column] = kInf;
        if (!reached) {
            scanned_.resize(first_scanned);
            return false;
        }

        change.length = end;
        change.hub_distance = hub_done ? hub : kInf;
        change.hub_column = kNone;
        change.freed = kNone;
        change.first_pair = pairs_.size();
        change.first_scanned = first_scanned;
        change.scanned_count = scanned_.size() - first_scanned;
        auto column = terminal;
        while (true) {
            auto holder = column == kNone ? kHub : from_[column];
            if (holder == kHub) {
                change.freed = column;
                change.hub_column = column = hub_column;
                holder = hub_from;
            }
            pairs_.push_back({holder, column});
            if (holder == start) break;
            column = t.held[holder];
        }
        change.pair_count = pairs_.size() - change.first_pair;
        return true;
    }

    // Turns the tables `from` into those after `change` (`to` is `from` or a copy of it).
    void apply(const Tables& from, const Tables& to, double& hub_price, const Change& change,
               std::int32_t start) {
        to.row_price[start] += change.length;
        for (std::size_t i = 0; i < change.scanned_count; ++i) {
            const auto [column, distance] = scanned_[change.first_scanned + i];
            to.row_price[from.holder[column]] += change.length - distance;
            to.column_price[column] -= change.length - distance;
        }
        if (change.hub_distance < change.length) hub_price += change.length - change.hub_distance;
        if (change.hub_column != kNone) to.column_price[change.hub_column] = -hub_price;
        if (change.freed != kNone) to.holder[change.freed] = kNone;
        for (std::size_t i = 0; i < change.pair_count; ++i) {
            const auto [row, column] = pairs_[change.first_pair + i];
            to.held[row] = column;
            to.holder[column] = row;
        }
    }

    // Writes the newest node down as a solution; its cost is added up anew, in the rows' order, so
    // that no rounding is inherited.
    void emit() {
        const auto node = nodes_.size() - 1;
        const auto t = tables(node);
        double total = 0;
        for (std::int32_t row = 0; row < rows_; ++row) {
            const auto entry = entry_of(row, t.held[row]);
            total = row ? total + cost_[entry] : cost_[entry];
            found_entries_.push_back(entry);
        }
        nodes_[node].cost = total;
        found_costs_.push_back(total);
        found_columns_.insert(found_columns_.end(), t.held, t.held + rows_);
        if (node == 0) know(total);
    }

    void know(double cost) {
        cheapest_.push_back(cost);
        std::push_heap(cheapest_.begin(), cheapest_.end());
        if (static_cast<std::int64_t>(cheapest_.size()) > k_) {
            std::pop_heap(cheapest_.begin(), cheapest_.end());
            cheapest_.pop_back();
        }
    }

    // Nothing that costs more is wanted.
    double limit() const {
        const double within = found_costs_.front() + margin_;
        return static_cast<std::int64_t>(cheapest_.size()) < k_
                   ? within
                   : std::min(within, cheapest_.front());
    }

    void enqueue(const Entry& entry) {
        queue_.push_back(entry);
        std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
    }

    // Parts of the newest node's set, over `open_rows_`: one for each row that could still change.
    // A row that leaves its column takes another, and somebody else (or the hub) takes its column:
    // two different pairs, whose least reduced costs add up to the bound.
    void open_parts() {
        const auto index = nodes_.size() - 1;
        auto& node = nodes_[index];
        const auto t = tables(index);
        const bool has_hub = width_ > rows_;
        for (std::size_t i = 0; i < node.banned_count; ++i) {
            is_banned_[banned_[node.first_banned + i]] = 1;
        }
        std::fill_n(t.turn, rows_, kNone);
        for (const auto row : open_rows_) {
            const auto column = t.held[row];
            t.turn[row] = kLater;
            column_slack_[column] = has_hub ? -node.hub_price - t.column_price[column] : kInf;
        }
        node.first_part = parts_.size();
        for (const auto row : open_rows_) {
            double row_slack = kInf;
            const double price = t.row_price[row];
            for (auto entry = start_[row]; entry < start_[row + 1]; ++entry) {
                const auto column = column_[entry];
                const auto holder = t.holder[column];
                if (holder == row || is_banned_[entry]) continue;
                if (holder == kNone) {
                    row_slack = std::min(row_slack, cost_[entry] - price + node.hub_price);
                } else if (t.turn[holder] == kLater) {
                    const double slack = cost_[entry] - price - t.column_price[column];
                    row_slack = std::min(row_slack, slack);
                    column_slack_[column] = std::min(column_slack_[column], slack);
                }
            }
            parts_.push_back({row_slack, row});
        }
        const double most = limit();
        auto kept = node.first_part;
        for (auto i = node.first_part; i < parts_.size(); ++i) {
            auto part = parts_[i];
            part.bound = node.cost + std::max(0.0, part.bound) +
                         std::max(0.0, column_slack_[t.held[part.row]]);
            if (part.bound < kInf && part.bound <= most) parts_[kept++] = part;
        }
        parts_.resize(kept);
        std::fill_n(t.turn, rows_, kLater);
        for (std::size_t i = 0; i < node.banned_count; ++i) {
            is_banned_[banned_[node.first_banned + i]] = 0;
        }
        node.part_count = node.waiting = parts_.size() - node.first_part;
        std::make_heap(waiting(node), waiting(node) + node.waiting, std::greater<>());
        if (node.waiting) enqueue({waiting(node)->bound, -1, index});
    }

    Part* waiting(const Node& node) { return parts_.data() + node.first_part; }

    // Solves parts in the order of their bounds until a solved one is the cheapest of all that
    // waits; that becomes the newest node.
    bool next_best() {
        while (!queue_.empty()) {
            std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
            const auto entry = queue_.back();
            queue_.pop_back();
            if (entry.change >= 0) {
                enter(changes_[static_cast<std::size_t>(entry.change)]);
                return true;
            }
            solve_part(entry.node);
        }
        return false;
    }

    // Extracts the node's most promising part and solves it.  Rows that still wait are fixed in it:
    // so the parts are disjoint, and those that promise least are the widest.
    void solve_part(std::size_t index) {
        auto& node = nodes_[index];
        const auto t = tables(index);
        auto* heap = waiting(node);
        std::pop_heap(heap, heap + node.waiting, std::greater<>());
        --node.waiting;
        const auto row = heap[node.waiting].row;
        const auto turn = static_cast<std::int32_t>(node.part_count - node.waiting);
        t.turn[row] = turn;

        const auto own = entry_of(row, t.held[row]);
        is_banned_[own] = 1;
        for (std::size_t i = 0; i < node.banned_count; ++i) {
            is_banned_[banned_[node.first_banned + i]] = 1;
        }
        Change change{};
        const bool found =
            search(index, row, t.held[row], turn, limit() - node.cost, heap + node.waiting,
                   node.part_count - node.waiting, change);
        is_banned_[own] = 0;
        for (std::size_t i = 0; i < node.banned_count; ++i) {
            is_banned_[banned_[node.first_banned + i]] = 0;
        }
        if (found) {
            change.node = index;
            change.part = node.waiting;
            const double cost = node.cost + change.length;
            enqueue({cost, static_cast<std::ptrdiff_t>(changes_.size()), index});
            changes_.push_back(change);
            know(cost);
        }
        if (node.waiting && heap->bound <= limit()) enqueue({heap->bound, -1, index});
    }

    std::size_t entry_of(std::int32_t row, std::int32_t column) const {
        const auto begin = column_.begin() + static_cast<std::ptrdiff_t>(start_[row]);
        const auto end = column_.begin() + static_cast<std::ptrdiff_t>(start_[row + 1]);
        return static_cast<std::size_t>(std::lower_bound(begin, end, column) - column_.begin());
    }

    // Makes a solved part the newest node: its parent's tables, changed.
    void enter(const Change& change) {
        const auto index = add_node();
        const auto parent = nodes_[change.node];
        const auto from = tables(change.node), to = tables(index);
        std::copy_n(from.row_price, rows_, to.row_price);
        std::copy_n(from.column_price, width_, to.column_price);
        std::copy_n(from.held, rows_, to.held);
        std::copy_n(from.holder, width_, to.holder);

        // Open in the part: its own row and those extracted before it.
        const auto* part = waiting(parent) + change.part;
        open_rows_.clear();
        for (auto i = change.part; i < parent.part_count; ++i, ++part) {
            open_rows_.push_back(part->row);
        }
        const auto start = open_rows_.front();

        auto& node = nodes_[index];
        node.hub_price = parent.hub_price;
        node.first_banned = banned_.size();
        banned_.push_back(entry_of(start, from.held[start]));
        const auto turn = from.turn[start];
        for (std::size_t i = 0; i < parent.banned_count; ++i) {
            const auto entry = banned_[parent.first_banned + i];
            const auto row = row_of(entry);
            if (from.turn[row] <= turn) banned_.push_back(entry);
        }
        node.banned_count = banned_.size() - node.first_banned;
        apply(from, to, node.hub_price, change, start);
    }

    std::int32_t row_of(std::size_t entry) const {
        return static_cast<std::int32_t>(
            std::upper_bound(start_.begin(), start_.end(), entry) - start_.begin() - 1);
    }

    const std::int32_t* found(std::size_t i) const {
        return found_columns_.data() + i * static_cast<std::size_t>(rows_);
    }

    // Bounds and partition may take two costs for equal that differ by rounding: order at the end.
    std::vector<std::size_t> in_order() const {
        std::vector<std::size_t> order(found_costs_.size());
        for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
        std::sort(order.begin(), order.end(), [this](std::size_t a, std::size_t b) {
            if (found_costs_[a] != found_costs_[b]) return found_costs_[a] < found_costs_[b];
            return std::lexicographical_compare(found(a), found(a) + rows_, found(b),
                                                found(b) + rows_);
        });
        return order;
    }
};

}  // namespace pmbm
