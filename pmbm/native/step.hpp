// One step of the filter for detected objects and for the undetected ones that a scan may show:
// prediction, association, update and reduction in one pass over the tables.  The plain version is
// predict(), associate(), update() and reduce() of pmbm/filter, box by box.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "branch.hpp"
#include "detection.hpp"
#include "gate.hpp"
#include "memory.hpp"
#include "merge.hpp"
#include "mixture.hpp"
#include "occlusion.hpp"
#include "radar.hpp"
#include "reduce.hpp"
#include "sensor.hpp"
#include "tables.hpp"

namespace pmbm {

// log 0 in weights, so that what nothing explains gets the smallest weight there is.
constexpr double kLogTiny = -700.0;
constexpr double kNothing = -std::numeric_limits<double>::infinity();

// What was born meanwhile: log_weight (P,), mean (P,4), cov (P,4,4).  in_place: survivors that begin
// with the births of the interval before take in the new ones component by component.
struct BirthsView {
    const double *log_weight, *mean, *cov;
    std::size_t count;
    bool in_place;
};

struct LocalsView {
    const std::int64_t* track;
    const double *existence, *mean, *cov, *box;
    const std::int8_t* label;
    const std::int64_t* newest;
    const bool* shown;
    const std::int32_t* history;
    // P(class of the source) (H,K), predicted; of each of S sensors the mean score and P(detectable)
    // (H,S); running sums of what detections said (H,R).
    const double *source, *confidence, *detectable, *record;
    std::size_t count, history_length, classes, sums;
};

struct ScanView {
    const double *position, *box;
    const std::int8_t* label;
    // evidence (M,K); birth (K,) or (M,K); first (M,2) or null; said (M,R); confidence (M,).
    const double *evidence, *birth, *first, *said, *confidence;
    std::size_t count;
    bool birth_by_place;
};

struct SensorRules {
    // Of a measured position, where a radar does not give each its own.
    const double* R;
    double clutter, detection_undetected;
    // Of S sensors, and which of them looks.
    const DetectionLaw* laws;
    std::size_t sensors, looking;
    bool blind;
    // Where it looks, and where objects are followed.
    View view, region;
    bool occlusion, undetected_in_detail;
    Polygons occluders;
    bool scaled_misses;
    double box_gain;
    bool describes;
};

struct StepRules {
    const double *F, *Q;
    double survival, log_survival, gate;
    BranchLimits branching;
    ReductionLimits reduction;
    bool recycle;
    double log_prune_undetected, merge_below, alike, as_heavy, as_likely, stay;
    std::int64_t max_undetected, few;
    double most_of_one;
};

// Of the tracks that a step leaves: existence (T,), that of sources of each class (T,K), how probably
// the likeliest local hypotheses are where objects are followed (T,), and the rows of these (T,).
struct TrackMarginals {
    Column<double> existence, of_class, inside;
    Column<std::int64_t> best;
};

// What a step leaves: the tables of the density, the marginals of its tracks, and counts of what was
// removed.
struct Step {
    Mixture undetected;
    Ints track;
    Column<double> existence, mean, cov, box;
    Column<std::int8_t> label;
    Column<std::int64_t> newest;
    Column<Flag> shown;
    Column<std::int32_t> history;
    Column<double> source, confidence, detectable, record;
    Table hypotheses;
    Ints track_id;
    std::int64_t settled = 0;
    TrackMarginals tracks;
    std::int64_t unlikely = 0, pairs = 0, pruned = 0, capped = 0, merged = 0, recycled = 0,
                 tracks_capped = 0, undetected_pruned = 0, undetected_merged = 0,
                 undetected_capped = 0;
    double seconds[4] = {0, 0, 0, 0};
};

inline double log_sum(double a, double b) {
    const double top = std::max(a, b);
    if (top == kNothing) return kNothing;
    return top + std::log1p(std::exp(std::min(a, b) - top));
}

// BroadBirth.joined().
inline Mixture with_births(Mixture&& survivors, const BirthsView& births) {
    const auto n = births.count;
    const bool meet = births.in_place && n <= survivors.size() &&
                      std::equal(births.mean, births.mean + 4 * n, survivors.mean.begin());
    if (!meet) {
        Mixture born = owned({births.log_weight, births.mean, births.cov, nullptr, nullptr,
                              nullptr, n});
        Mixture& first = births.in_place ? born : survivors;
        const Mixture& second = births.in_place ? survivors : born;
        for (std::size_t i = 0; i < second.size(); ++i) first.append(second, i);
        return std::move(first);
    }
    for (std::size_t i = 0; i < n; ++i) {
        double& weight = survivors.log_weight[i];
        weight = log_sum(weight, births.log_weight[i]);
        const double share = std::exp(births.log_weight[i] - weight);
        double* P = survivors.cov.data() + 16 * i;
        for (int a = 0; a < 16; ++a) P[a] += share * (births.cov[16 * i + a] - P[a]);
        survivors.share[i] *= 1 - share;
        survivors.recycled[i] *= 1 - share;
    }
    return std::move(survivors);
}

// merge_mixture() of reduction.py.
inline Mixture merged_mixture(const Mixture& mixture, double threshold, double alike,
                              double as_heavy) {
    const auto group = merge_groups(mixture.log_weight.data(), mixture.mean.data(),
                                    mixture.cov.data(), mixture.size(), threshold, alike, as_heavy);
    std::vector<std::size_t> order(mixture.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](auto a, auto b) { return group[a] < group[b]; });
    Mixture out;
    std::vector<double> weight;
    for (std::size_t i = 0, end = 0; i < order.size(); i = end) {
        double top = kNothing;
        for (end = i; end < order.size() && group[order[end]] == group[order[i]]; ++end) {
            top = std::max(top, mixture.log_weight[order[end]]);
        }
        if (end - i == 1) {
            out.append(mixture, order[i]);
            continue;
        }
        weight.clear();
        for (auto k = i; k < end; ++k) {
            weight.push_back(std::exp(mixture.log_weight[order[k]] - top));
        }
        append_merged(out, mixture, order.data() + i, end - i,
                      [&](auto k) { return mixture.mean.data() + 4 * order[i + k]; },
                      weight.data(), top);
    }
    return out;
}

struct Gaussian {
    double mean[4], cov[16];
};

class Stepper {
 public:
    // births: null where the undetected objects come predicted, births and all.  radar: null where
    // all measurements are positions of one covariance.
    Stepper(const MixtureView& ppp, const BirthsView* births, const LocalsView& local, const TableView& table,
            const std::int64_t* track_id, std::size_t tracks, std::int64_t detections_seen,
            std::int64_t settled, const ScanView& scan, const RadarView* radar,
            const SensorRules& sensor, const StepRules& rules, const OcclusionRules& occlusion)
        : survivors_(ppp), births_(births), local_(local), table_(table), track_id_(track_id), tracks_(tracks),
          detections_seen_(detections_seen), settled_(settled), scan_(scan), radar_(radar),
          sensor_(sensor), rules_(rules), occlusion_(occlusion) {}

    Step run() {
        auto last = std::chrono::steady_clock::now();
        const auto read = [&](int part) {
            const auto now = std::chrono::steady_clock::now();
            out_.seconds[part] = std::chrono::duration<double>(now - last).count();
            last = now;
        };
        predict();
        read(0);
        observe();
        associate();
        read(1);
        update();
        read(2);
        reduce();
        judge();
        read(3);
        return std::move(out_);
    }

 private:
    // Box 1.  Detected objects are predicted one by one, where they are asked for, and kept if they
    // are few: with many of them their table is large.
    double existence(std::size_t h) const { return local_.existence[h] * rules_.survival; }

    // i : of a local hypothesis and a sensor, in the order of the table.
    double detectable(std::size_t i) const {
        return sensor_.laws[i % sensor_.sensors].predicted(local_.detectable[i]);
    }

    Gaussian predicted(std::size_t h) const {
        return predicted_.empty() ? moved(h) : predicted_[h];
    }

    Gaussian moved(std::size_t h) const {
        Gaussian one;
        move(local_.mean + 4 * h, local_.cov + 16 * h, rules_.F, rules_.Q, one.mean, one.cov);
        return one;
    }

    void predict() {
        if (local_.count <= kMany) {
            predicted_.reserve(local_.count);
            for (std::size_t h = 0; h < local_.count; ++h) predicted_.push_back(moved(h));
        }
        ppp_ = owned(survivors_);
        recycled_before_ = survivors_.track != nullptr;
        if (!births_) return;
        move(survivors_.mean, survivors_.cov, survivors_.count, rules_.F, rules_.Q, ppp_.mean,
             ppp_.cov);
        for (auto& weight : ppp_.log_weight) weight += rules_.log_survival;
        ppp_ = with_births(std::move(ppp_), *births_);
    }

    // P_D as misses and as detections count it, and the states after a miss.
    void observe() {
        const auto H = local_.count, P = ppp_.size();
        detection_.resize(H);
        const auto& law = sensor_.laws[sensor_.looking];
        for (std::size_t h = 0, own = sensor_.looking; h < H; ++h, own += sensor_.sensors) {
            const auto one = predicted(h);
            double inside;
            share_inside(one.mean, one.cov, 1, sensor_.view, &inside);
            detection_[h] = law.probability(local_.confidence[own], detectable(own)) * inside;
        }
        if (sensor_.blind) std::fill(detection_.begin(), detection_.end(), 0.0);
        Floats inside(P, 1.0);
        if (sensor_.undetected_in_detail) {
            share_inside(ppp_.mean.data(), ppp_.cov.data(), P, sensor_.view, inside.data());
        }
        ppp_detection_.resize(P);
        for (std::size_t p = 0; p < P; ++p) {
            ppp_detection_[p] = sensor_.detection_undetected * inside[p];
        }
        ppp_if_detected_ = ppp_detection_;
        hides_ = sensor_.occlusion && (sensor_.undetected_in_detail || H > 0);
        if (hides_) hide();
    }

    void hide() {
        const auto H = local_.count;
        // Predicted, and row by row changed to what a miss makes of them.
        auto &mean = missed_mean_, &cov = missed_cov_;
        mean.resize(4 * H);
        cov.resize(16 * H);
        for (std::size_t h = 0; h < H; ++h) {
            const auto one = predicted(h);
            std::copy_n(one.mean, 4, mean.data() + 4 * h);
            std::copy_n(one.cov, 16, cov.data() + 16 * h);
        }
        if (sensor_.undetected_in_detail) {
            ppp_missed_mean_ = ppp_.mean;
            ppp_missed_cov_ = ppp_.cov;
        }
        if_detected_.resize(H);
        const auto held = probability(table_, static_cast<std::int64_t>(H));
        Floats mass(H), track_existence(tracks_, 0.0);
        for (std::size_t h = 0; h < H; ++h) {
            mass[h] = held[h] * existence(h);
            track_existence[local_.track[h]] += mass[h];
            if (local_.shown[h]) mass[h] *= rules_.stay;
        }
        for (auto& r : track_existence) r = std::min(r, 1.0);
        const auto best = likeliest(local_.track, local_.newest, mass.data(), H, tracks_,
                                    rules_.as_likely);
        const Shadows shadows(sensor_.view.pose, {mean.data(), cov.data()}, local_.box,
                              local_.track, H, track_existence.data(), best.data(), tracks_,
                              sensor_.occluders, occlusion_);
        Floats visible(H);
        Glimpse glimpse;
        shadows.share_of_bearings(visible.data());
        for (std::size_t h = 0; h < H; ++h) {
            const double in_the_open = detection_[h];
            if (is_vague(cov.data() + 16 * h, occlusion_)) {
                shadows.of_track(h, glimpse);
                visible[h] = glimpse.share();
                glimpse.if_missed(in_the_open, occlusion_.moves, mean.data() + 4 * h,
                                  cov.data() + 16 * h);
            }
            detection_[h] = in_the_open * visible[h];
            if_detected_[h] = in_the_open * std::max(visible[h], occlusion_.least_visible);
        }
        for (std::size_t p = 0; sensor_.undetected_in_detail && p < ppp_.size(); ++p) {
            const double in_the_open = ppp_detection_[p];
            shadows.of_undetected(ppp_.mean.data() + 4 * p, ppp_.cov.data() + 16 * p, glimpse);
            const double share = glimpse.share();
            ppp_detection_[p] = in_the_open * share;
            ppp_if_detected_[p] = in_the_open * std::max(share, occlusion_.least_visible);
            glimpse.if_missed(in_the_open, 0.0, ppp_missed_mean_.data() + 4 * p,
                              ppp_missed_cov_.data() + 16 * p);
        }
    }

    // Box 2.
    void associate() {
        const auto H = local_.count, M = scan_.count, K = local_.classes;
        if (radar_) {
            gate_by_radar();
        } else {
            gate();
        }
        release(if_detected_);
        if (H > kMany) {
            for (auto* column : {&row_, &measurement_}) column->shrink_to_fit();
            pair_weight_.shrink_to_fit();
        }
        missed_existence_.resize(H);
        Floats log_missed(H);
        for (std::size_t h = 0; h < H; ++h) {
            const double r = existence(h);
            if (sensor_.scaled_misses) {
                missed_existence_[h] = r * (1 - detection_[h]);
                log_missed[h] = 1 - detection_[h];
            } else {
                missed(&r, &detection_[h], 1, &missed_existence_[h], &log_missed[h]);
            }
        }
        const double tiny = std::exp(kLogTiny);
        for (auto& weight : log_missed) weight = std::log(std::max(weight, tiny));

        detect_first();
        const double log_clutter = sensor_.clutter > 0 ? std::log(sensor_.clutter) : kNothing;
        log_birth_.resize(M);
        log_new_.resize(M);
        for (std::size_t j = 0; j < M; ++j) {
            const double *evidence = scan_.evidence + K * j,
                         *birth = scan_.birth + (scan_.birth_by_place ? K * j : 0);
            double ratio = 0;
            for (std::size_t k = 0; k < K; ++k) ratio += evidence[k] * birth[k];
            const double object = scan_.first ? std::log(scan_.first[2 * j]) : 0.0,
                         clutter = scan_.first ? std::log(scan_.first[2 * j + 1]) : 0.0;
            log_birth_[j] = log_e_[j] + object + std::log(ratio);
            log_new_[j] = std::max(log_sum(log_birth_[j], log_clutter + clutter), kLogTiny);
        }
        children_ = branched(table_,
                             {row_.data(), measurement_.data(), pair_weight_.data(),
                              static_cast<std::int64_t>(row_.size())},
                             log_missed.data(), static_cast<std::int64_t>(H), log_new_.data(),
                             static_cast<std::int64_t>(M), rules_.branching, out_.unlikely);
        out_.pairs = static_cast<std::int64_t>(row_.size());
        release(pair_weight_);
    }

    void gate() {
        const Gate gate(scan_.position, scan_.count, rules_.gate);
        std::vector<Hit> hits;
        for (std::size_t h = 0; h < local_.count; ++h) {
            const auto one = predicted(h);
            const Innovation g(one.mean, one.cov, sensor_.R);
            const double log_height = log_prior(h) + g.log_norm();
            gate.sorted(g, hits);
            for (const auto& hit : hits) {
                add_pair(h, hit.measurement, log_height - 0.5 * (hit.y0 * hit.y0 + hit.y1 * hit.y1));
            }
        }
    }

    void gate_by_radar() {
        const RadarGate gate(scan_.position, scan_.count, *radar_, rules_.gate);
        std::vector<RadarGate::Pair> pairs;
        for (std::size_t h = 0; h < local_.count; ++h) {
            const double prior = log_prior(h);
            if (!(prior > kNothing)) continue;
            const auto one = predicted(h);
            gate.sorted(one.mean, one.cov, pairs);
            for (const auto& [j, log_density] : pairs) add_pair(h, j, prior + log_density);
        }
    }

    // log of r P_D.
    double log_prior(std::size_t h) const {
        return std::log(existence(h) * (hides_ ? if_detected_[h] : detection_[h]));
    }

    // weight : of the pair, but for what the measurement's score says of its source.
    void add_pair(std::size_t h, std::int64_t j, double weight) {
        if (!(weight > kNothing)) return;
        const auto K = local_.classes;
        const double* source = local_.source + K * h;
        const double* evidence = scan_.evidence + K * static_cast<std::size_t>(j);
        double ratio = 0;
        for (std::size_t k = 0; k < K; ++k) ratio += source[k] * evidence[k];
        row_.push_back(static_cast<std::int64_t>(h));
        measurement_.push_back(j);
        pair_weight_.push_back(weight + std::max(std::log(ratio), kLogTiny));
    }

    // log e of each measurement, and by what it is made up.
    void detect_first() {
        const auto P = ppp_.size(), M = scan_.count;
        Floats log_detected(P);
        for (std::size_t p = 0; p < P; ++p) {
            log_detected[p] = ppp_.log_weight[p] + std::log(ppp_if_detected_[p]);
        }
        if (!radar_) {
            first_ = std::make_unique<Expected>(ppp_.mean.data(), ppp_.cov.data(), sensor_.R,
                                                log_detected.data(), true, P);
            log_e_ = log_density(first_->view(), first_->log_height.data(), scan_.position, M,
                                 rules_.gate);
            return;
        }
        const RadarGate gate(scan_.position, M, *radar_, rules_.gate);
        std::vector<RadarGate::Pair> pairs;
        LogSums sums(M);
        for (std::size_t p = 0; p < P; ++p) {
            if (!(log_detected[p] > kNothing)) continue;
            gate.sorted(ppp_.mean.data() + 4 * p, ppp_.cov.data() + 16 * p, pairs);
            for (const auto& [j, log_density] : pairs) {
                first_pairs_.push_back({p, j, log_detected[p] + log_density});
                sums.add(j, first_pairs_.back().log_weight);
            }
        }
        log_e_ = std::move(sums).found();
    }

    // Box 3: which candidates are used, and what decides which of them stay: existence and track.
    // The states are worked out when it is known which stay.
    void update() {
        const auto H = static_cast<std::int64_t>(local_.count);
        const auto n = static_cast<std::int64_t>(row_.size());
        const auto M = static_cast<std::int64_t>(scan_.count);
        children_.member =
            used(children_.member.data(), children_.member.size(), {H, n, M}, runs_);
        const auto candidates = runs_[0].size() + runs_[1].size() + runs_[2].size();
        track_.reserve(candidates);
        existence_after_.reserve(candidates);
        for (const auto h : runs_[0]) {
            track_.push_back(local_.track[h]);
            existence_after_.push_back(missed_existence_[h]);
        }
        for (const auto pair : runs_[1]) {
            track_.push_back(local_.track[row_[pair]]);
            existence_after_.push_back(1.0);
        }
        for (const auto j : runs_[2]) {
            track_.push_back(static_cast<std::int64_t>(tracks_) + j);
            existence_after_.push_back(std::exp(log_birth_[j] - log_new_[j]));
        }
        release(missed_existence_);
        ids_.assign(track_id_, track_id_ + tracks_);
        for (std::int64_t j = 0; j < M; ++j) ids_.push_back(detections_seen_ + j);
        if (recycled_before_ && !runs_[2].empty()) resume();
        auto& ppp = out_.undetected;
        ppp.log_weight.resize(ppp_.size());
        for (std::size_t p = 0; p < ppp_.size(); ++p) {
            ppp.log_weight[p] = ppp_.log_weight[p] + std::log1p(-ppp_detection_[p]);
        }
    }

    void resume() {
        const auto& fresh = runs_[2];
        Floats r(fresh.size());
        for (std::size_t i = 0; i < fresh.size(); ++i) {
            const auto j = static_cast<std::size_t>(fresh[i]);
            r[i] = std::exp(log_birth_[j] - log_new_[j]);
        }
        Ints origins;
        Floats shares;
        if (radar_) {
            std::vector<OriginShare> parts;
            each_first_pair(fresh, [&](std::int64_t i, std::size_t p, std::size_t, double share) {
                if (ppp_.track[p] >= 0) parts.push_back({i, ppp_.track[p], share * ppp_.share[p]});
            });
            explained(std::move(parts), fresh.size(), origins, shares);
        } else {
            Floats z, log_e;
            places(fresh, z, log_e);
            explained(first_->view(), first_->log_height.data(), ppp_.track.data(),
                      ppp_.share.data(), z.data(), log_e.data(), fresh.size(), rules_.gate, origins,
                      shares);
        }
        origins = resumed(std::move(origins), shares, rules_.most_of_one, r.data(), track_id_,
                          tracks_);
        for (std::size_t i = 0; i < fresh.size(); ++i) {
            if (origins[i] >= 0) ids_[tracks_ + static_cast<std::size_t>(fresh[i])] = origins[i];
        }
    }

    // Of these measurements (n,) positions (n,2), and log e.
    void places(const Ints& of, Floats& z, Floats& log_e) const {
        for (const auto j : of) {
            z.insert(z.end(), scan_.position + 2 * j, scan_.position + 2 * j + 2);
            log_e.push_back(log_e_[static_cast<std::size_t>(j)]);
        }
    }

    // Calls visit(i, component, measurement, share of the component in its e) for all pairs of a
    // component and the ith of these measurements of a radar.
    template <typename Visit>
    void each_first_pair(const Ints& of, Visit visit) const {
        Ints place(scan_.count, -1);
        for (std::size_t i = 0; i < of.size(); ++i) place[of[i]] = static_cast<std::int64_t>(i);
        for (const auto& [p, j, log_weight] : first_pairs_) {
            if (place[j] < 0) continue;
            visit(place[j], p, static_cast<std::size_t>(j), std::exp(log_weight - log_e_[j]));
        }
    }

    // Box 4, and the states of what stays.
    void reduce() {
        const auto candidates = track_.size();
        auto reduced = pmbm::reduced(std::move(children_), existence_after_.data(), track_.data(),
                                     candidates, ids_.size(), rules_.reduction);
        out_.pruned = reduced.pruned;
        out_.capped = reduced.capped;
        out_.merged = reduced.merged;
        out_.tracks_capped = reduced.tracks_capped;
        out_.recycled = static_cast<std::int64_t>(reduced.recycled.size());
        fuse_new(reduced);
        // The tables that stay come next, and what is free in between would stay beside them.
        if (candidates > kMany) trim_heap();
        keep(reduced);
        auto& ppp = out_.undetected;
        const bool changed = hides_ && sensor_.undetected_in_detail;
        ppp.mean = std::move(changed ? ppp_missed_mean_ : ppp_.mean);
        ppp.cov = std::move(changed ? ppp_missed_cov_ : ppp_.cov);
        ppp.track = std::move(ppp_.track);
        ppp.share = std::move(ppp_.share);
        ppp.recycled = std::move(ppp_.recycled);
        if (rules_.recycle) {
            for (std::size_t i = 0; i < reduced.recycled.size(); ++i) {
                recycle(static_cast<std::size_t>(reduced.recycled[i]), reduced.probability[i]);
            }
        }
        out_.hypotheses = std::move(reduced.table);
        for (const auto t : reduced.compact.tracks) out_.track_id.push_back(ids_[t]);
        release(row_, measurement_, runs_, track_, ids_, fused_at_, existence_after_, new_mean_,
                new_cov_, detection_, missed_mean_, missed_cov_, log_e_, log_birth_, log_new_, first_,
                first_pairs_);
        reduce_undetected();
    }

    // States of new tracks, of those that stay or are recycled.
    void fuse_new(const ReducedTable& reduced) {
        const auto first_new = static_cast<std::int64_t>(runs_[0].size() + runs_[1].size());
        fused_at_.assign(runs_[2].size(), -1);
        Ints wanted;
        const auto want = [&](std::int64_t row) {
            if (row < first_new) return;
            auto& at = fused_at_[static_cast<std::size_t>(row - first_new)];
            if (at >= 0) return;
            at = static_cast<std::int64_t>(wanted.size());
            wanted.push_back(runs_[2][static_cast<std::size_t>(row - first_new)]);
        };
        for (const auto row : reduced.compact.rows) want(row);
        for (const auto row : reduced.recycled) want(row);
        const auto n = wanted.size();
        Floats z, log_e;
        places(wanted, z, log_e);
        new_mean_.resize(4 * n);
        new_cov_.resize(16 * n);
        for (std::size_t i = 0; i < n; ++i) {
            unexplained(z.data() + 2 * i, radar_ ? radar_->R + 4 * wanted[i] : sensor_.R,
                        new_mean_.data() + 4 * i, new_cov_.data() + 16 * i);
        }
        if (!n) return;
        if (!radar_) {
            fuse(first_->view(), first_->log_height.data(), ppp_.mean.data(), ppp_.cov.data(),
                 sensor_.R, z.data(), log_e.data(), n, rules_.gate, new_mean_.data(),
                 new_cov_.data());
            return;
        }
        Fusion fusion(z.data(), n);
        each_first_pair(wanted, [&](std::int64_t i, std::size_t p, std::size_t j, double share) {
            const RadarUpdate after(ppp_.mean.data() + 4 * p, ppp_.cov.data() + 16 * p,
                                    z.data() + 2 * i, *radar_, j);
            fusion.add(i, share, after.mean, after.cov);
        });
        fusion.write(log_e.data(), new_mean_.data(), new_cov_.data());
    }

    // The state of a candidate: mean (4), cov (16).
    void state(std::size_t candidate, double* mean, double* cov) const {
        const auto missed = runs_[0].size(), detected = runs_[1].size();
        if (candidate < missed) {
            const auto h = static_cast<std::size_t>(runs_[0][candidate]);
            if (hides_) {
                std::copy_n(missed_mean_.data() + 4 * h, 4, mean);
                std::copy_n(missed_cov_.data() + 16 * h, 16, cov);
            } else {
                const auto one = predicted(h);
                std::copy_n(one.mean, 4, mean);
                std::copy_n(one.cov, 16, cov);
            }
        } else if (candidate < missed + detected) {
            const auto pair = static_cast<std::size_t>(runs_[1][candidate - missed]);
            const auto h = static_cast<std::size_t>(row_[pair]);
            const auto before = predicted(h);
            if (radar_) {
                const auto j = static_cast<std::size_t>(measurement_[pair]);
                const RadarUpdate after(before.mean, before.cov, scan_.position + 2 * j, *radar_, j);
                std::copy_n(after.mean, 4, mean);
                std::copy_n(after.cov, 16, cov);
                return;
            }
            const Innovation g(before.mean, before.cov, sensor_.R);
            const Correction c(before.cov, g, sensor_.R);
            const auto y = g.whitened(scan_.position + 2 * measurement_[pair]);
            for (int a = 0; a < 4; ++a) {
                mean[a] = before.mean[a] + c.W[2 * a] * y[0] + c.W[2 * a + 1] * y[1];
            }
            std::copy_n(c.after, 16, cov);
        } else {
            const auto at = static_cast<std::size_t>(fused_at_[candidate - missed - detected]);
            std::copy_n(new_mean_.data() + 4 * at, 4, mean);
            std::copy_n(new_cov_.data() + 16 * at, 16, cov);
        }
    }

    void keep(const ReducedTable& reduced) {
        const auto& rows = reduced.compact.rows;
        const auto missed = runs_[0].size(), detected = runs_[1].size(),
                   L = local_.history_length;
        out_.track = reduced.compact.track;
        out_.mean.resize(4 * rows.size());
        out_.cov.resize(16 * rows.size());
        out_.box.resize(5 * rows.size());
        out_.history.resize(L * rows.size());
        out_.source.resize(local_.classes * rows.size());
        out_.confidence.resize(sensor_.sensors * rows.size());
        out_.detectable.resize(sensor_.sensors * rows.size());
        out_.record.resize(local_.sums * rows.size());
        out_.existence.reserve(rows.size());
        out_.newest.reserve(rows.size());
        out_.label.reserve(rows.size());
        out_.shown.reserve(rows.size());
        for (std::size_t i = 0; i < rows.size(); ++i) {
            const auto candidate = static_cast<std::size_t>(rows[i]);
            out_.existence.push_back(existence_after_[candidate]);
            state(candidate, out_.mean.data() + 4 * i, out_.cov.data() + 16 * i);
            double* box = out_.box.data() + 5 * i;
            std::int32_t* history = out_.history.data() + L * i;
            std::int64_t h = -1, j = -1;
            if (candidate < missed) {
                h = runs_[0][candidate];
            } else if (candidate < missed + detected) {
                const auto pair = runs_[1][candidate - missed];
                h = row_[pair];
                j = measurement_[pair];
            } else {
                j = runs_[2][candidate - missed - detected];
            }
            const bool described = j >= 0 && (h < 0 || sensor_.describes);
            std::copy_n(described ? scan_.box + 5 * j : local_.box + 5 * h, 5, box);
            if (h >= 0 && described && sensor_.box_gain != 1) {
                const double* before = local_.box + 5 * h;
                for (int a = 0; a < 4; ++a) {
                    box[a] = before[a] + sensor_.box_gain * (box[a] - before[a]);
                }
            }
            out_.shown.push_back({h >= 0 && local_.shown[h]});
            out_.newest.push_back(j >= 0 ? detections_seen_ + j : local_.newest[h]);
            out_.label.push_back(described ? scan_.label[j] : local_.label[h]);
            for (std::size_t step = 0; L && step + 1 < L; ++step) {
                history[step] = h >= 0 ? local_.history[L * h + step + 1] : kBefore;
            }
            if (L) history[L - 1] = j >= 0 ? static_cast<std::int32_t>(j) : kMissed;
            tell_source(h, j, out_.source.data() + local_.classes * i);
            remember(h, j, out_.confidence.data() + sensor_.sensors * i,
                     out_.detectable.data() + sensor_.sensors * i);
            record(h, j, out_.record.data() + local_.sums * i);
        }
    }

    // What the sensors' models remember (S,) of such a local hypothesis.
    void remember(std::int64_t h, std::int64_t j, double* confidence, double* detectable) const {
        const auto S = sensor_.sensors;
        for (std::size_t s = 0; s < S; ++s) {
            const auto& law = sensor_.laws[s];
            const bool looks = s == sensor_.looking;
            confidence[s] = h >= 0 ? local_.confidence[S * h + s] : 0.0;
            detectable[s] = h >= 0 ? this->detectable(S * h + s) : law.usual;
            if (!looks) continue;
            if (j < 0) {
                detectable[s] = law.if_missed(detectable[s], detection_[h]);
                continue;
            }
            const double told = scan_.confidence[j];
            confidence[s] = h >= 0 ? law.mean_score(confidence[s], told) : told;
            detectable[s] = law.if_detected(detectable[s]);
        }
    }

    // The running sums (R,) of such a local hypothesis.
    void record(std::int64_t h, std::int64_t j, double* sums) const {
        const auto R = local_.sums;
        for (std::size_t i = 0; i < R; ++i) {
            sums[i] = (h >= 0 ? local_.record[R * h + i] : 0.0) +
                      (j >= 0 ? scan_.said[R * j + i] : 0.0);
        }
    }

    // What a report asks of the tracks: in_view() and Marginals.shown_as() of estimation.py.
    void judge() {
        const auto H = out_.existence.size(), T = out_.track_id.size(), K = local_.classes;
        auto& of = out_.tracks;
        auto mass = probability(view_of(out_.hypotheses), static_cast<std::int64_t>(H));
        of.existence.assign(T, 0.0);
        of.of_class.assign(T * K, 0.0);
        of.inside.resize(T);
        for (std::size_t h = 0; h < H; ++h) {
            mass[h] *= out_.existence[h];
            const auto t = static_cast<std::size_t>(out_.track[h]);
            of.existence[t] += mass[h];
            for (std::size_t k = 0; k < K; ++k) {
                of.of_class[K * t + k] += mass[h] * out_.source[K * h + k];
            }
            if (out_.shown[h].value) mass[h] *= rules_.stay;
        }
        for (auto& r : of.existence) r = std::min(r, 1.0);
        const auto best = likeliest(out_.track.data(), out_.newest.data(), mass.data(), H, T,
                                    rules_.as_likely);
        of.best.assign(best.begin(), best.end());
        for (std::size_t t = 0; t < T; ++t) {
            const auto h = static_cast<std::size_t>(best[t]);
            share_inside(out_.mean.data() + 4 * h, out_.cov.data() + 16 * h, 1, sensor_.region,
                         &of.inside[t]);
        }
        for (std::size_t h = 0; h < H; ++h) {
            const auto shown = best[static_cast<std::size_t>(out_.track[h])];
            out_.shown[h] = {out_.newest[h] == out_.newest[static_cast<std::size_t>(shown)]};
        }
    }

    // P(class of the source) (K,) of a local hypothesis that was of row h, or new, and took j or
    // nothing.  Scan.source_after() and source_if_first().
    void tell_source(std::int64_t h, std::int64_t j, double* source) const {
        const auto K = local_.classes;
        const double* before = h >= 0 ? local_.source + K * static_cast<std::size_t>(h)
                                      : scan_.birth + (scan_.birth_by_place ? K * j : 0);
        std::copy_n(before, K, source);
        if (j < 0) return;
        const double* evidence = scan_.evidence + K * static_cast<std::size_t>(j);
        double total = 0;
        for (std::size_t k = 0; k < K; ++k) total += before[k] * evidence[k];
        if (!(total > 0)) return;
        for (std::size_t k = 0; k < K; ++k) source[k] = before[k] * evidence[k] / total;
    }

    void recycle(std::size_t candidate, double probability) {
        auto& ppp = out_.undetected;
        double mean[4], cov[16];
        state(candidate, mean, cov);
        ppp.log_weight.push_back(std::log(probability * existence_after_[candidate]));
        ppp.mean.insert(ppp.mean.end(), mean, mean + 4);
        ppp.cov.insert(ppp.cov.end(), cov, cov + 16);
        ppp.track.push_back(ids_[static_cast<std::size_t>(track_[candidate])]);
        ppp.share.push_back(1.0);
        ppp.recycled.push_back(1.0);
    }

    void reduce_undetected() {
        auto& ppp = out_.undetected;
        const auto all = ppp.size();
        ppp.keep([&](std::size_t p) { return ppp.log_weight[p] > rules_.log_prune_undetected; });
        out_.undetected_pruned = static_cast<std::int64_t>(all - ppp.size());
        out_.settled = settled_;
        const auto before = static_cast<std::int64_t>(ppp.size());
        if (before > 2 * settled_ + rules_.few) {
            // Merging takes longer than what it saves until the mixture has grown.
            if (rules_.merge_below > 0 && before > 1) {
                ppp = merged_mixture(ppp, rules_.merge_below, rules_.alike, rules_.as_heavy);
            }
            out_.settled = static_cast<std::int64_t>(ppp.size());
            out_.undetected_merged = before - out_.settled;
        }
        const auto most = static_cast<std::size_t>(rules_.max_undetected);
        if (ppp.size() > most) {
            std::vector<std::size_t> order(ppp.size());
            std::iota(order.begin(), order.end(), 0);
            std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) {
                return ppp.log_weight[a] > ppp.log_weight[b];
            });
            out_.undetected_capped = static_cast<std::int64_t>(ppp.size() - most);
            std::vector<bool> heavy(ppp.size(), false);
            for (std::size_t i = 0; i < most; ++i) heavy[order[i]] = true;
            ppp.keep([&](std::size_t p) { return heavy[p]; });
        }
    }

    static constexpr std::int32_t kMissed = -1, kBefore = -2;

    const MixtureView survivors_;
    const BirthsView* births_;
    const LocalsView local_;
    const TableView table_;
    const std::int64_t* track_id_;
    std::size_t tracks_;
    std::int64_t detections_seen_, settled_;
    const ScanView scan_;
    const RadarView* radar_;
    const SensorRules& sensor_;
    const StepRules& rules_;
    const OcclusionRules& occlusion_;

    // The undetected objects, predicted; and what both kinds are after a miss, where something hides.
    Mixture ppp_;
    bool recycled_before_ = false, hides_ = false;
    std::vector<Gaussian> predicted_;
    Floats detection_, if_detected_, ppp_detection_, ppp_if_detected_;
    Floats missed_mean_, missed_cov_, missed_existence_, ppp_missed_mean_, ppp_missed_cov_;
    // Gated pairs, and first detections: the undetected objects as these see them, or their pairs
    // with a radar's measurements.
    struct FirstPair {
        std::size_t component;
        std::int64_t measurement;
        double log_weight;
    };
    std::unique_ptr<Expected> first_;
    std::vector<FirstPair> first_pairs_;
    Ints row_, measurement_;
    Floats pair_weight_, log_e_, log_birth_, log_new_;
    // Candidates: runs of missed, detected and new ones that are used.
    Table children_;
    std::vector<Ints> runs_;
    Ints track_, ids_, fused_at_;
    Floats existence_after_, new_mean_, new_cov_;
    Step out_;
};

}  // namespace pmbm
