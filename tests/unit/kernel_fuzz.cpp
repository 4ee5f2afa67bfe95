// Random problems through the compiled kernel, each answer checked; built by
// test_kernel_sanitized.py with the address and undefined-behaviour sanitizers.
#include "k_best.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <set>

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
std::mt19937 random_source(20260101);

int whole(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_source); }
double chance() { return std::uniform_real_distribution<double>(0, 1)(random_source); }

struct Problem {
    int rows, width;
    std::vector<double> cost;
    double at(int row, int column) const {
        return cost[static_cast<std::size_t>(row * width + column)];
    }
};

Problem draw(int most_rows, int most_width) {
    Problem p{whole(0, most_rows), whole(0, most_width), {}};
    const bool ties = chance() < 0.5;
    const double forbidden = chance() < 0.3 ? 0 : chance();
    const double scale = std::pow(10.0, whole(-3, 6));
    for (int i = 0; i < p.rows * p.width; ++i) {
        const double finite =
            ties ? whole(-3, 3) : std::normal_distribution<double>(0, scale)(random_source);
        p.cost.push_back(chance() < forbidden ? kInf : finite);
    }
    return p;
}

void enumerate(const Problem& p, int row, double total, std::vector<bool>& used,
               std::vector<double>& totals) {
    if (row == p.rows) {
        totals.push_back(total);
        return;
    }
    for (int column = 0; column < p.width; ++column) {
        const auto c = static_cast<std::size_t>(column);
        if (used[c] || p.at(row, column) == kInf) continue;
        used[c] = true;
        enumerate(p, row + 1, row ? total + p.at(row, column) : p.at(row, column), used, totals);
        used[c] = false;
    }
}

void fail(const char* what, const Problem& p, std::int64_t k) {
    std::printf("%s: %d x %d, k = %lld\n", what, p.rows, p.width, static_cast<long long>(k));
    for (int row = 0; row < p.rows; ++row) {
        for (int column = 0; column < p.width; ++column) std::printf("%.17g ", p.at(row, column));
        std::printf("\n");
    }
    std::exit(1);
}

// Solutions are assignments, all different, in order, with the costs they say.
void check(const Problem& p, std::int64_t k, std::int64_t n,
           const std::vector<std::int32_t>& columns, const std::vector<double>& costs) {
    const auto rows = static_cast<std::size_t>(p.rows), count = static_cast<std::size_t>(n);
    if (n > k || costs.size() != count || columns.size() != count * rows) fail("size", p, k);
    std::set<std::vector<std::int32_t>> seen;
    for (std::size_t i = 0; i < count; ++i) {
        const std::vector<std::int32_t> taken(columns.begin() + static_cast<long>(i * rows),
                                              columns.begin() + static_cast<long>((i + 1) * rows));
        if (!seen.insert(taken).second) fail("a solution twice", p, k);
        if (std::set<std::int32_t>(taken.begin(), taken.end()).size() != rows) {
            fail("a column twice", p, k);
        }
        double total = 0;
        for (std::size_t row = 0; row < rows; ++row) {
            const double c = p.at(static_cast<int>(row), taken[row]);
            total = row ? total + c : c;
        }
        if (total != costs[i] || !(total < kInf)) fail("cost", p, k);
        if (i && costs[i] < costs[i - 1]) fail("order", p, k);
    }
}

}  // namespace

int main(int argc, char** argv) {
    const int problems = argc > 1 ? std::atoi(argv[1]) : 1000;
    pmbm::KBest solver;
    for (int i = 0; i < problems; ++i) {
        const bool small = i % 4 != 0;
        const Problem p = small ? draw(5, 7) : draw(25, 40);
        const std::int64_t k = whole(0, 3) == 0 ? 3000 : whole(0, 40);
        std::vector<std::int32_t> columns;
        std::vector<double> costs;
        const auto n = solver.solve(p.cost.data(), p.rows, p.width, k, columns, costs);
        check(p, k, n, columns, costs);
        if (!small) continue;
        std::vector<double> totals;
        std::vector<bool> used(static_cast<std::size_t>(p.width));
        enumerate(p, 0, 0, used, totals);
        std::sort(totals.begin(), totals.end());
        totals.resize(std::min(totals.size(), static_cast<std::size_t>(k)));
        if (totals.size() != costs.size()) fail("number of solutions", p, k);
        for (std::size_t j = 0; j < totals.size(); ++j) {
            const double scale = std::max(1.0, std::abs(totals[j]));
            if (std::abs(totals[j] - costs[j]) > 1e-9 * scale) fail("not the cheapest", p, k);
        }
    }
    std::printf("%d problems\n", problems);
}
