// Random problems through the compiled kernels, each answer checked; built by
// test_kernel_sanitized.py with the address and undefined-behaviour sanitizers.
#include "k_best.hpp"
#include "branch.hpp"
#include "detection.hpp"
#include "overlaps.hpp"
#include "radar.hpp"
#include "gate.hpp"
#include "join.hpp"
#include "merge.hpp"
#include "rays.hpp"
#include "reduce.hpp"
#include "road.hpp"
#include "sensor.hpp"
#include "step.hpp"
#include "tables.hpp"
#include "undetected_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
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

void require(bool good, const char* what) {
    if (good) return;
    std::printf("%s\n", what);
    std::exit(1);
}

pmbm::TableView view(const pmbm::Table& t) {
    return {t.cluster.data(), t.start.data(), t.member.data(), t.log_weight.data(),
            static_cast<std::int64_t>(t.cluster.size())};
}

// Clusters of a few tracks, each with a few local hypotheses; rows take at most one of each track.
struct Scene {
    pmbm::Table table;
    pmbm::Ints track, cluster_of_local;

    Scene() {
        const int clusters = whole(0, 5);
        std::int64_t tracks = 0;
        for (int c = 0; c < clusters; ++c) {
            std::vector<pmbm::Ints> locals(static_cast<std::size_t>(whole(0, 5)));
            for (auto& own : locals) {
                for (int i = whole(1, 3); i > 0; --i) {
                    own.push_back(static_cast<std::int64_t>(track.size()));
                    track.push_back(tracks);
                    cluster_of_local.push_back(c);
                }
                ++tracks;
            }
            for (int row = whole(1, 9); row > 0; --row) {
                for (const auto& own : locals) {
                    const int pick = whole(-1, static_cast<int>(own.size()) - 1);
                    if (pick >= 0) table.member.push_back(own[static_cast<std::size_t>(pick)]);
                }
                table.close_row(c, std::log(chance() + 1e-3));
            }
        }
        normalise_all();
    }

    void normalise_all() {
        view(table).each_cluster([&](std::int64_t, std::int64_t first, std::int64_t last) {
            pmbm::normalise(table.log_weight.data(), first, last);
        });
    }

    std::int64_t locals() const { return static_cast<std::int64_t>(track.size()); }
};

// Every cluster's weights add up to one, clusters are numbered through, and, where it is given, each
// local hypothesis has the probability it had.
void check_table(const pmbm::Table& t, std::int64_t locals, const pmbm::Floats* before) {
    std::int64_t next = 0;
    view(t).each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        require(cluster == next++, "clusters are not numbered through");
        double total = 0;
        for (auto g = first; g < last; ++g) total += std::exp(t.log_weight[g]);
        require(std::abs(total - 1) < 1e-9, "weights do not add up to one");
    });
    require(t.start.back() == static_cast<std::int64_t>(t.member.size()), "members left over");
    const auto after = pmbm::probability(view(t), locals);
    for (std::size_t i = 0; before && i < after.size(); ++i) {
        require(std::abs(after[i] - (*before)[i]) < 1e-9, "a local hypothesis lost probability");
    }
}

// Measurements tie clusters together at random: members stay, no table grows beyond its limit, and
// where nothing is cut every local hypothesis keeps its probability.
void fuzz_joins(const Scene& scene, const pmbm::Ints& row, const pmbm::Ints& own,
                std::int64_t measurements) {
    const auto locals = scene.locals();
    pmbm::Ints measurement;
    for (const auto m : own) {
        measurement.push_back(chance() < 0.2 ? whole(0, static_cast<int>(measurements) - 1) : m);
    }
    const bool roomy = chance() < 0.5;
    const double largest = roomy ? 1e12 : whole(1, 60);
    const std::int64_t cap = roomy ? 1000000 : whole(1, 30);
    pmbm::Joining joined(view(scene.table), locals, row.data(), measurement.data(), row.size(),
                         measurements, cap, largest);
    pmbm::Table table;
    for (std::int64_t number = 0; number < joined.clusters(); ++number) {
        joined.append(number, table);
    }
    std::int64_t clusters = 0;
    view(table).each_cluster([&](std::int64_t cluster, std::int64_t first, std::int64_t last) {
        require(cluster == clusters++, "joined clusters are not numbered through");
        require(roomy || last - first <= std::max<std::int64_t>(cap, 9), "too many rows");
    });
    for (const auto cluster : joined.of_measurement) {
        require(cluster >= 0 && cluster < clusters, "a measurement without a cluster");
    }
    for (std::size_t i = 0; i < row.size(); ++i) {
        const auto of_measurement = joined.of_measurement[measurement[i]];
        for (std::size_t g = 0; g < table.cluster.size(); ++g) {
            for (auto e = table.start[g]; e < table.start[g + 1]; ++e) {
                require(table.member[e] != row[i] || table.cluster[g] == of_measurement,
                        "a pair of different clusters");
            }
        }
    }
    pmbm::Ints limits(static_cast<std::size_t>(clusters), cap);
    pmbm::limit_rows(view(table), cap, largest, limits);
    for (const auto limit : limits) {
        require(limit >= 1 && limit <= cap, "a limit beyond the cap");
    }
    if (!roomy) return;
    const auto probability = pmbm::probability(view(scene.table), locals);
    check_table(table, locals, &probability);
}

void fuzz_tables() {
    Scene scene;
    const auto locals = scene.locals();
    const auto clusters = view(scene.table).clusters();
    pmbm::Ints cluster_of, row, measurement, allowed;
    pmbm::Floats weight, missed, fresh;
    for (int m = clusters ? whole(0, 8) : 0; m > 0; --m) {
        cluster_of.push_back(whole(0, static_cast<int>(clusters) - 1));
        fresh.push_back(-5 * chance());
    }
    for (std::int64_t i = 0; i < locals; ++i) {
        missed.push_back(-3 * chance());
        for (std::size_t m = 0; m < cluster_of.size(); ++m) {
            if (cluster_of[m] != scene.cluster_of_local[i] || chance() < 0.5) continue;
            row.push_back(i);
            measurement.push_back(static_cast<std::int64_t>(m));
            weight.push_back(-8 * chance());
        }
    }
    fuzz_joins(scene, row, measurement, static_cast<std::int64_t>(cluster_of.size()));
    allowed.assign(static_cast<std::size_t>(clusters), whole(1, 60));
    const pmbm::PairsView known{row.data(), measurement.data(), weight.data(),
                                static_cast<std::int64_t>(row.size())};
    const auto scans = static_cast<std::int64_t>(cluster_of.size());
    const pmbm::Scanned scan(known, missed.data(), locals, fresh.data(), scans, cluster_of.data(),
                             clusters);
    const auto children =
        pmbm::best_children(view(scene.table), scan, allowed.data(),
                            chance() < 0.5 ? 1000000 : whole(1, 20), chance() < 0.5 ? 4 : kInf,
                            chance() < 0.5 ? -4 : -kInf);
    pmbm::Table made;
    std::vector<unsigned char> taken(cluster_of.size(), 0);
    pmbm::extend(made, view(scene.table), children, scan, taken);
    const auto candidates = locals + known.count + scans;
    std::int64_t dropped = 0;
    check_table(pmbm::branched(view(scene.table), known, missed.data(), locals, fresh.data(), scans,
                               {whole(1, 60), chance() < 0.5 ? 1e12 : 40.0,
                                chance() < 0.5 ? 1000000 : whole(1, 20), kInf, -kInf,
                                chance() < 0.7 || clusters == 1},
                               dropped),
                candidates, nullptr);
    require(dropped == 0, "a child dropped though nothing is negligible");
    check_table(made, candidates, nullptr);
    for (std::size_t g = 0; g + 1 < made.start.size(); ++g) {
        std::multiset<std::int64_t> used;
        for (auto e = made.start[g]; e < made.start[g + 1]; ++e) {
            const auto member = made.member[e];
            if (member >= locals + known.count) used.insert(member - locals - known.count);
            else if (member >= locals) used.insert(measurement[member - locals]);
        }
        std::set<std::int64_t> all;
        for (std::size_t m = 0; m < cluster_of.size(); ++m) {
            if (cluster_of[m] == made.cluster[g]) all.insert(static_cast<std::int64_t>(m));
        }
        require(used.size() == all.size() && std::equal(used.begin(), used.end(), all.begin()),
                "a row does not explain each measurement once");
    }

    std::int64_t likely = 0;
    const pmbm::Ints cap(static_cast<std::size_t>(clusters), whole(1, 6));
    const auto kept = pmbm::pruned(view(made), std::log(0.01), cap.data(), likely);
    check_table(kept, candidates, nullptr);
    require(likely >= static_cast<std::int64_t>(kept.cluster.size()), "more kept than likely");

    const auto before = pmbm::probability(view(scene.table), locals);
    const auto merged = pmbm::merged(view(scene.table));
    check_table(merged, locals, &before);
    check_table(pmbm::split(view(merged), locals), locals, &before);
    check_table(pmbm::factored(view(merged), scene.track.data(), chance() * 0.5, 6), locals,
                &before);
    const auto tracks = scene.track.empty() ? 0 : scene.track.back() + 1;
    const auto compact = pmbm::compacted(
        merged.member.data(), merged.member.size(), scene.track.data(), scene.track.size(),
        static_cast<std::size_t>(tracks));
    for (std::size_t e = 0; e < merged.member.size(); ++e) {
        require(compact.rows[compact.member[e]] == merged.member[e], "a member was renamed wrongly");
        require(compact.tracks[compact.track[compact.member[e]]] == scene.track[merged.member[e]],
                "a track was renamed wrongly");
    }
}

// The whole reduction: tables stay sound, every member is a row that is kept, and where nothing is
// cut or recycled every local hypothesis keeps its probability.
void fuzz_reduction() {
    const Scene scene;
    const auto locals = static_cast<std::size_t>(scene.locals());
    const auto tracks = scene.track.empty() ? 0 : static_cast<std::size_t>(scene.track.back()) + 1;
    pmbm::Floats existence;
    for (std::size_t i = 0; i < locals; ++i) existence.push_back(chance());
    const bool gentle = chance() < 0.3;
    const pmbm::ReductionLimits limits{gentle ? -kInf : std::log(0.05),
                                       gentle ? 1000 : whole(1, 6),
                                       gentle ? 1e12 : whole(1, 60),
                                       gentle ? 0.0 : chance(),
                                       gentle ? 1000 : whole(0, 8),
                                       chance() < 0.8,
                                       chance() < 0.5 ? 0.0 : 0.2 * chance(),
                                       whole(1, 20)};
    const auto made = pmbm::reduced(pmbm::Table(scene.table), existence.data(), scene.track.data(), locals,
                                    tracks, limits);
    const auto kept = static_cast<std::int64_t>(made.compact.rows.size());
    check_table(made.table, kept, nullptr);
    for (const auto member : made.table.member) {
        require(member >= 0 && member < kept, "a member that is not kept");
    }
    for (std::size_t i = 0; i < made.recycled.size(); ++i) {
        require(made.probability[i] > 0, "recycled out of nothing");
        for (const auto row : made.compact.rows) {
            require(row != made.recycled[i], "recycled and kept");
        }
    }
    std::set<std::int64_t> alive;
    for (const auto row : made.compact.rows) alive.insert(scene.track[row]);
    require(static_cast<std::int64_t>(alive.size()) <= limits.max_tracks, "too many tracks");
    if (!gentle) return;
    const auto before = pmbm::probability(view(scene.table), scene.locals());
    const auto after = pmbm::probability(view(made.table), kept);
    for (std::size_t i = 0; i < after.size(); ++i) {
        require(std::abs(after[i] - before[made.compact.rows[i]]) < 1e-9,
                "a local hypothesis lost probability");
    }
}

void fuzz_gate() {
    const auto n = static_cast<std::size_t>(whole(0, 30)), m = static_cast<std::size_t>(whole(0, 60));
    const double spread = std::pow(10.0, whole(-1, 4)), threshold = 0.5 + 20 * chance();
    std::normal_distribution<double> normal;
    pmbm::Floats expected, l11, l21, l22, height, mean, cov, z;
    for (std::size_t i = 0; i < n; ++i) {
        const double size = chance() < 0.2 ? spread : 1;
        double P[16] = {};
        for (int a = 0; a < 4; ++a) P[5 * a] = size * size * (0.1 + chance());
        P[1] = P[4] = 0.3 * std::sqrt(P[0] * P[5]);
        for (int a = 0; a < 4; ++a) mean.push_back(spread * normal(random_source));
        cov.insert(cov.end(), P, P + 16);
        expected.insert(expected.end(), mean.end() - 4, mean.end() - 2);
        l11.push_back(std::sqrt(P[0] + 0.09));
        l21.push_back(P[4] / l11.back());
        l22.push_back(std::sqrt(P[5] + 0.09 - l21.back() * l21.back()));
        height.push_back(chance() < 0.1 ? -kInf : -10 * chance());
    }
    const bool on_a_line = chance() < 0.2;
    for (std::size_t j = 0; j < m; ++j) {
        z.push_back(spread * normal(random_source));
        z.push_back(on_a_line ? 1.0 : spread * normal(random_source));
    }
    const pmbm::Innovations g{expected.data(), l11.data(), l21.data(), l22.data(), n};
    const pmbm::Gate gate(z.data(), m, threshold);
    std::vector<pmbm::Hit> hits;
    for (std::size_t i = 0; i < n; ++i) {
        gate.sorted(g[i], hits);
        std::size_t at = 0;
        for (std::size_t j = 0; j < m; ++j) {
            const double y0 = (z[2 * j] - expected[2 * i]) / l11[i];
            const double y1 = (z[2 * j + 1] - expected[2 * i + 1] - l21[i] * y0) / l22[i];
            if (y0 * y0 + y1 * y1 >= threshold) continue;
            require(at < hits.size() && hits[at].measurement == static_cast<std::int64_t>(j) &&
                        hits[at].y0 == y0 && hits[at].y1 == y1,
                    "a pair in the gate is missing or out of order");
            ++at;
        }
        require(at == hits.size(), "a pair out of the gate");
    }
    const bool is_log = chance() < 0.5;
    pmbm::Floats prior(height);
    if (!is_log) for (auto& one : prior) one = std::exp(one);
    const double R[4] = {0.09, 0, 0, 0.09};
    const pmbm::Expected own(mean.data(), cov.data(), R, prior.data(), is_log, n);
    require(own.centre == expected && own.l11 == l11 && own.l21 == l21 && own.l22 == l22,
            "an innovation of its own");
    const auto groups =
        pmbm::merge_groups(height.data(), mean.data(), cov.data(), n, threshold, chance(), 1e-6);
    for (std::size_t i = 0; i < n; ++i) {
        const auto head = groups[i];
        require(head >= 0 && head < static_cast<std::int64_t>(n) && groups[head] == head,
                "merged into what is merged itself");
        require(height[head] >= height[i], "merged into a lighter one");
    }
    pmbm::Ints origin, origins;
    pmbm::Floats share, shares;
    for (std::size_t i = 0; i < n; ++i) {
        origin.push_back(whole(-1, 5));
        share.push_back(chance());
    }
    const auto total = pmbm::log_density(g, height.data(), z.data(), m, threshold);
    pmbm::explained(g, height.data(), origin.data(), share.data(), z.data(), total.data(), m,
                    threshold, origins, shares);
    const pmbm::Ints known{1, 3};
    const pmbm::Floats probability(m, 0.5);
    const auto resumed = pmbm::resumed(origins, shares, 0.3, probability.data(), known.data(), 2);
    std::set<std::int64_t> given;
    for (std::size_t j = 0; j < m; ++j) {
        require(shares[j] >= 0 && shares[j] < 1 + 1e-9, "a share beyond all there is");
        if (resumed[j] < 0) continue;
        require(resumed[j] == origins[j] && shares[j] > 0.3, "an id of nobody's");
        require(given.insert(resumed[j]).second, "an id given twice");
        require(resumed[j] != 1 && resumed[j] != 3, "an id in use");
    }
    pmbm::Floats fused(4 * m, 7.0), spread_of(16 * m, 7.0);
    pmbm::fuse(g, height.data(), mean.data(), cov.data(), R, z.data(), total.data(), m, threshold,
               fused.data(), spread_of.data());
    for (const auto value : fused) require(std::isfinite(value), "a mean is not finite");
    for (const auto value : spread_of) require(std::isfinite(value), "a covariance is not finite");
}

// Measurements of a covariance of their own around a sensor, and perhaps of radial velocities.
struct RadarScan {
    pmbm::Floats R, sight, speed, variance;
    bool has_speed = chance() < 0.6;

    explicit RadarScan(const pmbm::Floats& z) {
        for (std::size_t j = 0; 2 * j < z.size(); ++j) {
            const double turn = 7 * chance(), along = 0.01 + chance(), across = 0.01 + 9 * chance();
            const double c = std::cos(turn), s = std::sin(turn), both = (along - across) * c * s;
            R.insert(R.end(), {along * c * c + across * s * s, both, both,
                               along * s * s + across * c * c});
            sight.insert(sight.end(), {c, s});
            speed.push_back(20 * chance() - 10);
            variance.push_back(0.01 + chance());
        }
    }

    pmbm::RadarView view() const {
        return {R.data(), sight.data(), has_speed ? speed.data() : nullptr, variance.data()};
    }
};

// The pairs in a radar's gate are those that a look at each finds, and an update leaves less to know.
void fuzz_radar() {
    const auto m = static_cast<std::size_t>(whole(0, 40));
    const double spread = std::pow(10.0, whole(0, 3)), threshold = 0.5 + 20 * chance();
    pmbm::Floats z;
    for (std::size_t i = 0; i < 2 * m; ++i) z.push_back(spread * (chance() - 0.5));
    const RadarScan scan(z);
    const pmbm::RadarGate gate(z.data(), m, scan.view(), threshold);
    double mean[4], P[16] = {};
    for (int a = 0; a < 4; ++a) {
        mean[a] = spread * (chance() - 0.5);
        P[5 * a] = 0.1 + (chance() < 0.2 ? spread * spread : 1) * chance();
    }
    P[1] = P[4] = 0.3 * std::sqrt(P[0] * P[5]);
    std::vector<pmbm::RadarGate::Pair> pairs;
    gate.sorted(mean, P, pairs);
    std::size_t at = 0;
    for (std::size_t j = 0; j < m; ++j) {
        const pmbm::RadarUpdate after(mean, P, z.data() + 2 * j, scan.view(), j);
        require(after.distance >= 0 && std::isfinite(after.log_density), "a density of no number");
        for (int a = 0; a < 4; ++a) {
            require(after.cov[5 * a] > 0 && after.cov[5 * a] <= P[5 * a] * (1 + 1e-9),
                    "a measurement left more to know");
        }
        if (after.distance >= threshold) continue;
        require(at < pairs.size() && pairs[at].measurement == static_cast<std::int64_t>(j) &&
                    pairs[at].log_density == after.log_density,
                "a pair in a radar's gate is missing or out of order");
        ++at;
    }
    require(at == pairs.size(), "a pair out of a radar's gate");
}

// A few steps, each from what the one before left, of sensors that take turns: tables stay sound.
void fuzz_steps() {
    const auto K = static_cast<std::size_t>(whole(1, 3)), S = static_cast<std::size_t>(whole(1, 2)),
               L = static_cast<std::size_t>(whole(0, 3)), sums = static_cast<std::size_t>(whole(0, 2));
    const bool clustering = chance() < 0.8, recycle = chance() < 0.8;
    const double F[16] = {1, 0, .1, 0, 0, 1, 0, .1, 0, 0, 1, 0, 0, 0, 0, 1};
    const double Q[16] = {.01, 0, .1, 0, 0, .01, 0, .1, .1, 0, 2, 0, 0, .1, 0, 2};
    const double R[4] = {0.3, 0.1, 0.1, 0.2}, pose[3] = {1, 2, 20 * chance() - 10};
    const pmbm::View view{pose, chance(), chance() < 0.5 ? std::acos(-1.0) : 1.0, 60};
    std::vector<pmbm::DetectionLaw> laws;
    for (std::size_t s = 0; s < S; ++s) {
        laws.push_back({0.5, 0.9, chance() < 0.5, chance(), 0.2 * chance(), 0.9, chance()});
    }
    const pmbm::Ints corner_start{0, 4};
    const double corner[8] = {10, 10, 14, 10, 14, 14, 10, 14}, nodes[8] = {1, 0, -1, 0, 0, 1, 0, -1};
    pmbm::Floats cos, sin;
    for (int i = 0; i < 90; ++i) {
        cos.push_back(std::cos((i + 0.5) * 2 * pmbm::kPi / 90));
        sin.push_back(std::sin((i + 0.5) * 2 * pmbm::kPi / 90));
    }
    const pmbm::OcclusionRules occlusion{0.05, 1 - 1e-9, 1e-6, 1, 2, 0.8, 0.05, 1e5, nodes, 4,
                                         {cos.data(), sin.data(), 90}};
    const pmbm::SensorRules sensor{R, chance() < 0.1 ? 0.0 : 1e-3, 0.8, laws.data(), S, 0, false,
                                   view, view, chance() < 0.5, chance() < 0.5,
                                   {corner_start.data(), corner, 1}, chance() < 0.2,
                                   chance() < 0.5 ? 1.0 : 0.4, true};
    const double log_prune = std::log(1e-3);
    const pmbm::StepRules rules{F, Q, 0.99, std::log(0.99), 16,
                                {whole(1, 30), 1e12, 300000, -log_prune, log_prune, clustering},
                                {log_prune, 30, 1e12, 0.1 * chance(), whole(1, 12), clustering, 1e-3, 30},
                                recycle, std::log(1e-5), chance() < 0.5 ? 0.0 : 1.0, 1, 1e-6, 1e-9,
                                30, whole(2, 30), 3, 0.5};
    const double birth_weight[2] = {-2, -1}, birth_mean[8] = {-20, 0, 0, 0, 20, 0, 0, 0};
    double birth_cov[32] = {};
    for (int a = 0; a < 8; ++a) birth_cov[16 * (a / 4) + 5 * (a % 4)] = a % 4 < 2 ? 400 : 25;
    const pmbm::BirthsView births{birth_weight, birth_mean, birth_cov, 2, chance() < 0.5};

    auto before = std::make_unique<pmbm::Step>();
    if (!clustering) before->hypotheses.close_row(0, 0.0);
    std::int64_t seen = 0;
    for (int steps = whole(1, 5); steps > 0; --steps) {
        const auto m = static_cast<std::size_t>(whole(0, 6));
        pmbm::Floats z, box(5 * m, 1.0), evidence, birth(K, 1.0 / static_cast<double>(K)), first,
            said(sums * m, 0.5), confidence;
        const std::vector<std::int8_t> label(m, 1);
        for (std::size_t j = 0; j < m; ++j) {
            for (int a = 0; a < 2; ++a) z.push_back(chance() < 0.7 ? 8 * whole(-2, 2) + chance() : 80 * chance() - 40);
            for (std::size_t k = 0; k < K; ++k) evidence.push_back(chance() < 0.1 ? 0.0 : 5 * chance());
            first.insert(first.end(), {chance(), chance()});
            confidence.push_back(chance());
        }
        const RadarScan by_radar(z);
        const auto radar = by_radar.view();
        const bool given = chance() < 0.5;
        auto looks = sensor;
        looks.looking = static_cast<std::size_t>(whole(0, static_cast<int>(S) - 1));
        looks.describes = !given;
        looks.blind = chance() < 0.1;
        const auto& s = *before;
        const auto H = s.existence.size();
        const auto& ppp = s.undetected;
        const pmbm::MixtureView survivors{
            ppp.log_weight.data(), ppp.mean.data(), ppp.cov.data(), ppp.track.data(),
            ppp.share.data(), ppp.recycled.data(), ppp.size()};
        const pmbm::LocalsView local{s.track.data(), s.existence.data(), s.mean.data(),
                                     s.cov.data(), s.box.data(), s.label.data(), s.newest.data(),
                                     reinterpret_cast<const bool*>(s.shown.data()),
                                     s.history.data(), s.source.data(), s.confidence.data(),
                                     s.detectable.data(), s.record.data(), H, L, K, sums};
        pmbm::Stepper stepper(survivors, &births, local, view_of(s.hypotheses), s.track_id.data(),
                              s.track_id.size(), seen, s.settled,
                              {z.data(), box.data(), label.data(), evidence.data(), birth.data(),
                               chance() < 0.5 ? first.data() : nullptr, said.data(),
                               confidence.data(), m, false},
                              given ? &radar : nullptr, looks, rules, occlusion);
        auto after = std::make_unique<pmbm::Step>(stepper.run());
        seen += static_cast<std::int64_t>(m);
        const auto kept = after->existence.size(), tracks = after->track_id.size();
        check_table(after->hypotheses, static_cast<std::int64_t>(kept), nullptr);
        require(after->mean.size() == 4 * kept && after->cov.size() == 16 * kept &&
                    after->source.size() == K * kept && after->history.size() == L * kept &&
                    after->detectable.size() == S * kept && after->record.size() == sums * kept,
                "a table of another length");
        for (std::size_t h = 0; h < kept; ++h) {
            require(after->existence[h] >= 0 && after->existence[h] <= 1 + 1e-9, "no probability");
            require(after->track[h] >= 0 && after->track[h] < static_cast<std::int64_t>(tracks),
                    "a hypothesis of no track");
            require(after->newest[h] >= 0 && after->newest[h] < seen, "a detection of nobody's");
            for (int a = 0; a < 4; ++a) {
                require(std::isfinite(after->mean[4 * h + a]) && after->cov[16 * h + 5 * a] > 0,
                        "a state of no number");
            }
            double total = 0;
            for (std::size_t k = 0; k < K; ++k) total += after->source[K * h + k];
            require(std::abs(total - 1) < 1e-9, "classes do not add up to one");
        }
        require(std::set<std::int64_t>(after->track_id.begin(), after->track_id.end()).size() ==
                    tracks, "an id twice");
        for (std::size_t t = 0; t < tracks; ++t) {
            require(after->tracks.existence[t] >= 0 && after->tracks.existence[t] <= 1, "existence");
            require(after->track[static_cast<std::size_t>(after->tracks.best[t])] ==
                        static_cast<std::int64_t>(t), "the best of another track");
        }
        for (std::size_t p = 0; p < after->undetected.size(); ++p) {
            require(std::isfinite(after->undetected.log_weight[p]), "undetected ones of no weight");
            for (int a = 0; a < 4; ++a) {
                require(after->undetected.cov[16 * p + 5 * a] > 0, "undetected ones of no place");
            }
        }
        before = std::move(after);
    }
}

void fuzz_candidates() {
    const std::vector<std::int64_t> lengths{whole(0, 9), whole(0, 9), whole(0, 9)};
    const auto all = static_cast<int>(lengths[0] + lengths[1] + lengths[2]);
    pmbm::Ints member;
    for (int e = all ? whole(0, 20) : 0; e > 0; --e) member.push_back(whole(0, all - 1));
    std::vector<pmbm::Ints> runs;
    const auto renumbered = pmbm::used(member.data(), member.size(), lengths, runs);
    pmbm::Ints name;
    std::int64_t first = 0;
    for (std::size_t run = 0; run < runs.size(); first += lengths[run++]) {
        for (const auto one : runs[run]) {
            require(one >= 0 && one < lengths[run], "a candidate of another run");
            name.push_back(first + one);
        }
    }
    require(std::set<std::int64_t>(member.begin(), member.end()).size() == name.size(),
            "a candidate that is used is missing");
    for (std::size_t e = 0; e < member.size(); ++e) {
        require(name[renumbered[e]] == member[e], "a candidate was renamed wrongly");
    }
}

// No report that stands lies in another's place, and what does not stand has a reason.
void fuzz_exclusion() {
    const auto n = static_cast<std::size_t>(whole(0, 30));
    pmbm::Floats position, box;
    pmbm::Ints order(n);
    for (std::size_t i = 0; i < n; ++i) {
        order[i] = static_cast<std::int64_t>(i);
        for (int a = 0; a < 2; ++a) position.push_back(chance() < 0.2 ? 0 : 20 * chance());
        const double size = chance() < 0.1 ? 0 : 8;
        box.insert(box.end(), {0, size * chance(), size * chance(), 1, 20 * chance() - 10});
    }
    std::shuffle(order.begin(), order.end(), random_source);
    const auto sure = static_cast<std::size_t>(whole(0, static_cast<int>(n)));
    const auto rows = pmbm::suppress_overlaps(position.data(), box.data(), order.data(), n, sure, 1.5);
    std::vector<char> holds(n, 0);
    for (std::size_t i = 0; i < sure; ++i) holds[order[i]] = 1;
    std::vector<char> stands(n, 0);
    for (const auto row : rows) stands[row] = 1;
    for (std::size_t i = 0; i < n; ++i) {
        bool alone = true;
        for (std::size_t j = 0; j < n; ++j) {
            if (i == j) continue;
            const double *a = &position[2 * i], *b = &position[2 * j];
            const bool shared = pmbm::inside(a, b, &box[5 * j]) || pmbm::inside(b, a, &box[5 * i]);
            require(!(shared && stands[i] && stands[j] && holds[i]), "two reports at one place");
            alone &= !shared;
        }
        require(stands[i] || !alone, "a report held back by nobody");
    }
}

void fuzz_sensor() {
    const auto n = static_cast<std::size_t>(whole(0, 20));
    pmbm::Floats mean, cov, r, P_D, share(n), after(n), left(n);
    for (std::size_t i = 0; i < n; ++i) {
        for (int a = 0; a < 4; ++a) mean.push_back(200 * chance() - 100);
        for (int a = 0; a < 16; ++a) cov.push_back(a % 5 ? 0.0 : (chance() < 0.1 ? 0.0 : 9 * chance()));
        r.push_back(chance() < 0.2 ? 1.0 : chance());
        P_D.push_back(chance() < 0.2 ? whole(0, 1) : chance());
    }
    const double pose[3] = {10 * chance(), 10 * chance(), 20 * chance() - 10};
    const double half_angle = chance() < 0.3 ? std::acos(-1.0) : 0.1 + 3 * chance();
    pmbm::share_inside(mean.data(), cov.data(), n, {pose, 6 * chance() - 3, half_angle, 60},
                       share.data());
    for (const auto one : share) require(one >= 0 && one <= 1, "a share beyond all there is");
    pmbm::missed(r.data(), P_D.data(), n, after.data(), left.data());
    for (std::size_t i = 0; i < n; ++i) {
        require(after[i] >= 0 && after[i] <= r[i], "a miss made existence likelier");
        require(left[i] >= 0 && left[i] <= 1, "the weight of a miss");
    }
    // P_D over both states is at most that of what is seen.
    const double unseen = chance();
    for (std::size_t i = 0; i < n; ++i) P_D[i] *= r[i] + (1 - r[i]) * unseen;
    const pmbm::DetectionLaw law{0.9, 0.9, false, 0, unseen, chance(), chance()};
    for (std::size_t i = 0; i < n; ++i) {
        const double missed = law.if_missed(r[i], P_D[i]);
        require(missed >= 0 && missed <= r[i] + 1e-12, "a miss made being detectable likelier");
        const double found = law.if_detected(r[i]);
        require(found >= r[i] - 1e-12 && found <= 1 + 1e-12, "a detection made it less so");
    }
}

void fuzz_rays() {
    const auto boxes = static_cast<std::size_t>(whole(0, 20));
    const auto bearings = whole(1, 800);
    pmbm::Floats offset, box, widen, cos, sin;
    for (int i = 0; i < bearings; ++i) {
        cos.push_back(std::cos((i + 0.5) * 2 * pmbm::kPi / bearings));
        sin.push_back(std::sin((i + 0.5) * 2 * pmbm::kPi / bearings));
    }
    for (std::size_t b = 0; b < boxes; ++b) {
        const double far = std::pow(10.0, whole(-3, 4));
        offset.push_back(far * (2 * chance() - 1));
        offset.push_back(chance() < 0.1 ? 0.0 : far * (2 * chance() - 1));
        box.push_back(0);
        for (int i = 0; i < 3; ++i) box.push_back(chance() < 0.1 ? 0.0 : 12 * chance());
        box.push_back(20 * chance() - 10);
        widen.push_back(chance() < 0.5 ? 0.0 : 5 * chance());
    }
    const double yaw = 20 * chance() - 10;
    const auto rays = pmbm::box_rays(offset.data(), box.data(), widen.data(), boxes, yaw, {cos.data(), sin.data(), bearings});
    require(rays.first.size() == boxes + 1 && rays.margin.size() == boxes &&
                rays.cores.size() == boxes && rays.bearing.size() == rays.distance.size() &&
                rays.first.back() == static_cast<std::int64_t>(rays.bearing.size()),
            "rays of no box");
    for (std::size_t b = 0; b < boxes; ++b) {
        const auto first = rays.first[b], last = rays.first[b + 1];
        require(last >= first && rays.margin[b] >= 0, "a run of rays that ends before it begins");
        require(last == first ? rays.cores[b] == 0
                              : rays.cores[b] > 0 && rays.margin[b] + rays.cores[b] <= last - first,
                "a core beyond the rays");
        const double range = std::hypot(offset[2 * b], offset[2 * b + 1]);
        const double along = std::abs(std::sin(box[5 * b + 4] - yaw) * offset[2 * b + 1] +
                                      std::cos(box[5 * b + 4] - yaw) * offset[2 * b]);
        const double across = std::sqrt(std::max(0.0, range * range - along * along));
        require(last == first || 2.001 * along > box[5 * b + 1] || 2.001 * across > box[5 * b + 2],
                "a box around the sensor has rays");
        for (auto ray = first; ray < last; ++ray) {
            require(rays.bearing[ray] >= 0 && rays.bearing[ray] < bearings, "no such bearing");
            require(rays.distance[ray] > 0 && rays.distance[ray] <= range + 12,
                    "a ray meets its box too far away");
            require(ray == first || rays.bearing[ray] == (rays.bearing[ray - 1] + 1) % bearings,
                    "bearings that are not consecutive");
        }
    }
}

// Things on lanes that lead to each other, many in one place: each neighbour against a search
// through all; and pairs of boxes that overlap are among those that could collide.
void fuzz_road() {
    const auto things = static_cast<std::size_t>(whole(0, 12));
    const auto lanes = static_cast<std::size_t>(whole(1, 4));
    std::vector<double> along, aside, half_width, length, offset;
    std::vector<std::int64_t> first{0}, searched;
    for (std::size_t i = 0; i < things * lanes; ++i) {
        along.push_back(chance() < 0.5 ? whole(-8, 40) : 60 * chance() - 12);
        aside.push_back(6 * chance() - 3);
    }
    for (std::size_t lane = 0; lane < lanes; ++lane) {
        half_width.push_back(2 * chance());
        length.push_back(whole(5, 30));
        searched.push_back(static_cast<std::int64_t>(lane));
        offset.push_back(0);
        for (int more = whole(0, 2); more > 0; --more) {
            searched.push_back(whole(0, static_cast<int>(lanes) - 1));
            offset.push_back(whole(-30, 30));
        }
        first.push_back(static_cast<std::int64_t>(searched.size()));
    }
    const auto seen = std::make_unique<bool[]>(things);
    std::vector<std::int64_t> row, column, front, rear;
    for (std::size_t n = 0; n < things; ++n) {
        seen[n] = chance() < 0.9;
        row.push_back(static_cast<std::int64_t>(n));
        column.push_back(whole(0, static_cast<int>(lanes) - 1));
    }
    pmbm::neighbours({along.data(), aside.data(), seen.get(), things, half_width.data(),
                      length.data(), lanes, first.data(), searched.data(), offset.data()},
                     row.data(), column.data(), things, 5.0, front, rear);
    for (std::size_t q = 0; q < things; ++q) {
        const double at = along[q * lanes + static_cast<std::size_t>(column[q])];
        std::int64_t ahead = -1, behind = -1;
        double nearest = kInf, nearest_behind = -kInf;
        for (std::size_t n = 0; n < things; ++n) {
            if (n == q || !seen[n]) continue;
            for (auto k = first[column[q]]; k < first[column[q] + 1]; ++k) {
                const auto lane = static_cast<std::size_t>(searched[k]);
                const double place = along[n * lanes + lane];
                if (std::abs(aside[n * lanes + lane]) > half_width[lane] + 1 || place < -5 ||
                    place >= length[lane] + 5) {
                    continue;
                }
                if (place + offset[k] >= at && place + offset[k] <= nearest) {
                    nearest = place + offset[k];
                    ahead = static_cast<std::int64_t>(n);
                }
                if (place + offset[k] < at && place + offset[k] > nearest_behind) {
                    nearest_behind = place + offset[k];
                    behind = static_cast<std::int64_t>(n);
                }
                break;
            }
        }
        require(front[q] == ahead && rear[q] == behind, "another neighbour");
    }

    std::vector<double> position, heading, speed, half_length, half;
    for (std::size_t n = 0; n < things; ++n) {
        for (int i = 0; i < 2; ++i) position.push_back(30 * chance());
        heading.push_back(20 * chance() - 10);
        speed.push_back(30 * chance());
        half_length.push_back(0.2 + 5 * chance());
        half.push_back(0.2 + chance());
    }
    const auto vehicles = static_cast<std::size_t>(whole(0, static_cast<int>(things)));
    std::vector<std::int64_t> one, other;
    pmbm::near_pairs({position.data(), heading.data(), speed.data(), half_length.data(),
                      half.data(), things, vehicles},
                     0.1, 1e-6, one, other);
    std::set<std::pair<std::int64_t, std::int64_t>> found;
    for (std::size_t k = 0; k < one.size(); ++k) {
        require(one[k] < other[k] && static_cast<std::size_t>(one[k]) < vehicles &&
                    found.emplace(one[k], other[k]).second &&
                    (k == 0 || std::pair(one[k - 1], other[k - 1]) < std::pair(one[k], other[k])),
                "pairs out of order");
    }
    for (std::size_t a = 0; a < vehicles; ++a) {
        for (auto b = a + 1; b < things; ++b) {
            // A corner of one within the other.
            for (const auto& [in, of] : {std::pair(a, b), std::pair(b, a)}) {
                for (int corner = 0; corner < 4; ++corner) {
                    const double l = (corner & 1 ? 1 : -1) * half_length[of];
                    const double w = (corner & 2 ? 1 : -1) * half[of];
                    const double x = position[2 * of] - position[2 * in] +
                                     l * std::cos(heading[of]) - w * std::sin(heading[of]);
                    const double y = position[2 * of + 1] - position[2 * in + 1] +
                                     l * std::sin(heading[of]) + w * std::cos(heading[of]);
                    const double c = std::cos(heading[in]), s = std::sin(heading[in]);
                    if (std::abs(x * c + y * s) < half_length[in] &&
                        std::abs(y * c - x * s) < half[in]) {
                        require(found.count({static_cast<std::int64_t>(a),
                                             static_cast<std::int64_t>(b)}) > 0,
                                "boxes that overlap are left out");
                    }
                }
            }
        }
    }
}

// The settled map and what was dropped weigh what the components did, and nothing in it is wide.
void fuzz_map() {
    const auto count = static_cast<std::size_t>(whole(0, 30));
    pmbm::Mixture ppp;
    double before = 0;
    for (std::size_t p = 0; p < count; ++p) {
        double root[16], weight = std::log(chance() + 1e-9);
        for (auto& entry : root) entry = 12 * (chance() - 0.5);
        for (int a = 0; a < 4; ++a) {
            ppp.mean.push_back(100 * (chance() - 0.5));
            for (int b = 0; b < 4; ++b) {
                double sum = 0;
                for (int c = 0; c < 4; ++c) sum += root[4 * a + c] * root[4 * b + c];
                ppp.cov.push_back(sum);
            }
        }
        ppp.log_weight.push_back(weight);
        ppp.track.push_back(whole(-1, 4));
        ppp.share.push_back(ppp.track.back() < 0 ? 0 : chance());
        ppp.recycled.push_back(ppp.share.back());
        before += std::exp(weight);
    }
    const double pose[3] = {chance(), chance(), 7 * chance()};
    const double half_angle = chance() < 0.5 ? std::acos(-1.0) : chance();
    const auto [after, dropped] =
        pmbm::MapSettler({ppp.log_weight.data(), ppp.mean.data(), ppp.cov.data(), ppp.track.data(),
                          ppp.share.data(), ppp.recycled.data(), count},
                         {pose, chance(), half_angle, 40},
                         {3.5, std::log(0.01), chance() < 0.5 ? kInf : 0.1, 2, 2, 0.5, 1.75, 6,
                          0.1, 1e-6})
            .run();
    double weight = dropped;
    for (std::size_t p = 0; p < after.size(); ++p) {
        weight += std::exp(after.log_weight[p]);
        require(after.share[p] <= after.recycled[p] + 1e-9 && after.recycled[p] <= 1 + 1e-9,
                "more was recycled than there is");
    }
    require(std::abs(weight - before) <= 1e-9 * (1 + before), "a map that weighs something else");
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
        fuzz_tables();
        fuzz_reduction();
        fuzz_gate();
        fuzz_radar();
        fuzz_steps();
        fuzz_candidates();
        fuzz_exclusion();
        fuzz_sensor();
        fuzz_rays();
        fuzz_road();
        fuzz_map();
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
