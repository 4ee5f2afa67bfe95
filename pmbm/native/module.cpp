// The Python module pmbm._native: the twins that pmbm/kernels.py chooses between.  Their callers,
// pmbm/assignment and pmbm/filter, have checked what comes in.
#include <nanobind/nanobind.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "k_best.hpp"
#include "arrays.hpp"
#include "branch.hpp"
#include "gate.hpp"
#include "held.hpp"
#include "merge.hpp"
#include "rays.hpp"
#include "reduce.hpp"
#include "report.hpp"
#include "road.hpp"
#include "sensor.hpp"
#include "step.hpp"
#include "tables.hpp"
#include "undetected_map.hpp"

namespace nb = nanobind;

namespace {

template <typename T>
using Input = pmbm::Buffer<T>;
// Of any shape, C-ordered: read as one run of numbers.
template <typename T>
using Table = pmbm::Buffer<T>;
template <typename T>
using Output = nb::object;
using pmbm::array_of;
using pmbm::hand_over;
using pmbm::matrices_of;
using pmbm::rows_of;

// Many problems, their matrices one after the other: returns columns, costs, number of solutions.
nb::tuple k_best(Input<double> cost, Input<std::int32_t> rows, Input<std::int32_t> widths,
                 Input<std::int64_t> ks) {
    std::vector<std::int32_t> columns;
    std::vector<double> costs;
    std::vector<std::int64_t> counts;
    {
        nb::gil_scoped_release released;
        pmbm::KBest solver;
        const double* matrix = cost.data();
        for (std::size_t i = 0; i < rows.size(); ++i) {
            const auto r = rows.data()[i], c = widths.data()[i];
            counts.push_back(solver.solve(matrix, r, c, ks.data()[i], columns, costs));
            matrix += static_cast<std::size_t>(r) * static_cast<std::size_t>(c);
        }
    }
    return nb::make_tuple(hand_over(std::move(columns)), hand_over(std::move(costs)),
                          hand_over(std::move(counts)));
}

// Many sparse problems: problem p owns rows first_row[p] to first_row[p + 1], likewise columns.
nb::tuple k_best_choices(Input<std::int64_t> row, Input<std::int64_t> column, Input<double> cost,
                         Input<std::int64_t> first_row, Input<std::int64_t> first_column,
                         Input<std::int64_t> ks, double margin) {
    std::vector<std::int64_t> counts, takers, taken;
    std::vector<double> costs;
    {
        nb::gil_scoped_release released;
        pmbm::KBest solver;
        const auto options = static_cast<std::int64_t>(row.size());
        std::int64_t first = 0;
        for (std::size_t p = 0; p < ks.size(); ++p) {
            const auto r = first_row.data()[p], next_row = first_row.data()[p + 1];
            const auto c = first_column.data()[p], next_column = first_column.data()[p + 1];
            auto last = first;
            while (last < options && row.data()[last] < next_row) ++last;
            const pmbm::KBest::Options problem{row.data() + first, column.data() + first,
                                               cost.data() + first, last - first, first, r,
                                               next_row - r, c, next_column - c};
            counts.push_back(
                solver.choose(problem, ks.data()[p], margin, costs, takers, taken));
            first = last;
        }
    }
    return nb::make_tuple(hand_over(std::move(counts)), hand_over(std::move(costs)),
                          hand_over(std::move(takers)), hand_over(std::move(taken)));
}

Output<double> share_inside(Table<double> mean, Table<double> cov, Input<double> pose,
                            double centre, double half_angle, double max_range) {
    std::vector<double> share(mean.shape(0));
    pmbm::share_inside(mean.data(), cov.data(), share.size(),
                       {pose.data(), centre, half_angle, max_range}, share.data());
    return hand_over(std::move(share));
}

Output<std::int64_t> suppress_overlaps(Table<double> position, Table<double> box,
                                       Input<std::int64_t> order, std::size_t sure,
                                       double larger) {
    return hand_over(
        pmbm::suppress_overlaps(position.data(), box.data(), order.data(), order.size(), sure, larger));
}

// The columns of `ReportedColumns` of the tracks in these rows, and their P(class) (n,K).
nb::tuple reported_columns(const pmbm::Candidates& track, const pmbm::Ints& rows,
                           const double* mean, const double* cov, const double* box,
                           const std::int8_t* label, const double* source, std::size_t classes) {
    const auto n = rows.size();
    std::vector<double> position, size, yaw, velocity, score, covariance, sources;
    std::vector<std::int8_t> labels;
    for (auto* column : {&position, &size}) column->reserve(3 * n);
    for (auto* column : {&yaw, &score}) column->reserve(n);
    velocity.reserve(2 * n);
    covariance.reserve(16 * n);
    sources.reserve(classes * n);
    for (const auto row : rows) {
        const auto at = track.best[row];
        const auto own = static_cast<std::ptrdiff_t>(classes) * at;
        const double *state = mean + 4 * at, *outline = box + 5 * at, *spread = cov + 16 * at;
        position.insert(position.end(), {state[0], state[1], outline[0]});
        size.insert(size.end(), outline + 1, outline + 4);
        yaw.push_back(outline[4]);
        velocity.insert(velocity.end(), state + 2, state + 4);
        score.push_back(track.exists[row]);
        labels.push_back(label[at]);
        covariance.insert(covariance.end(), spread, spread + 16);
        sources.insert(sources.end(), source + own, source + own + static_cast<std::ptrdiff_t>(classes));
    }
    return nb::make_tuple(
        nb::make_tuple(rows_of<3>(std::move(position)), rows_of<3>(std::move(size)),
                       hand_over(std::move(yaw)), rows_of<2>(std::move(velocity)),
                       hand_over(std::move(score)), hand_over(std::move(labels)),
                       matrices_of<4>(std::move(covariance))),
        array_of(std::move(sources), {n, classes}));
}

nb::tuple reported(Input<std::int64_t> track_id, Input<std::int64_t> best, Input<double> exists,
                   Input<double> inside, Table<double> mean, Table<double> cov, Table<double> box,
                   Input<std::int8_t> label, Table<double> source, double above, bool exclusive,
                   double whole) {
    const pmbm::Candidates track{track_id.data(), best.data(), exists.data(), inside.data(),
                                 exists.size()};
    auto rows = pmbm::reported(track, mean.data(), box.data(), above, exclusive, whole);
    auto columns = reported_columns(track, rows, mean.data(), cov.data(), box.data(), label.data(),
                                    source.data(), source.shape(1));
    return nb::make_tuple(hand_over(std::move(rows)), columns[0], columns[1]);
}

nb::tuple reported_columns(const pmbm::Candidates& track, const pmbm::Ints& rows,
                           const pmbm::LocalsView& local) {
    return reported_columns(track, rows, local.mean, local.cov, local.box, local.label,
                            local.source, local.classes);
}

// The same of the tables of a step.
nb::tuple reported_of(const pmbm::Held& held, Input<std::int64_t> best, Input<double> exists,
                      Input<double> inside, double above, bool exclusive, double whole) {
    const auto local = held.locals();
    const pmbm::Candidates track{held.step().track_id.data(), best.data(), exists.data(),
                                 inside.data(), exists.size()};
    auto rows = pmbm::reported(track, local.mean, local.box, above, exclusive, whole);
    auto columns = reported_columns(track, rows, local);
    return nb::make_tuple(hand_over(std::move(rows)), columns[0], columns[1]);
}

// Ids, columns and P(class) of the tracks that are reported, if all have been before and none may
// inherit another's id; None otherwise.
nb::object reported_as_known(const pmbm::Judged& judged, Input<double> object_share,
                             Input<std::int64_t> reported_ids, Input<std::int64_t> candidate,
                             double above, bool exclusive, double whole) {
    const auto exists = judged.objects(object_share.data());
    const auto track = judged.candidates(exists);
    const auto local = judged.held().locals();
    const auto rows = pmbm::reported(track, local.mean, local.box, above, exclusive, whole);
    pmbm::Ints ids;
    ids.reserve(rows.size());
    for (const auto row : rows) ids.push_back(track.track_id[row]);
    if (!pmbm::known_as_they_are(ids, reported_ids.data(), reported_ids.size(), candidate.data(),
                                 candidate.size())) {
        return nb::none();
    }
    auto columns = reported_columns(track, rows, local);
    return nb::make_tuple(hand_over(std::move(ids)), columns[0], columns[1]);
}

Output<double> read_off(Input<double> x, Input<double> knot, Input<double> value, double base,
                        double within) {
    const auto K = knot.size();
    const double *at = knot.data(), *height = value.data();
    std::vector<double> found;
    found.reserve(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
        const double here = x.data()[i];
        const auto next = static_cast<std::size_t>(std::upper_bound(at, at + K, here) - at);
        double told = height[next ? next - 1 : 0];
        if (next && next < K) {
            const double slope = (height[next] - told) / (at[next] - at[next - 1]);
            told = slope * (here - at[next - 1]) + told;
        }
        found.push_back(std::min(std::max(told - base, -within), within));
    }
    return hand_over(std::move(found));
}

// (T,) the probability of being an object, of existence (T,) and that of each class (T,K).
Output<double> objects(Input<double> of_class, Input<double> existence, Input<double> share) {
    return hand_over(pmbm::objects(of_class.data(), existence.data(), existence.size(),
                                   share.data(), share.size()));
}

bool known_as_they_are(Input<std::int64_t> ids, Input<std::int64_t> reported,
                       Input<std::int64_t> candidate) {
    return pmbm::known_as_they_are({ids.data(), ids.data() + ids.size()}, reported.data(),
                                   reported.size(), candidate.data(), candidate.size());
}

Output<double> level_evidence(Input<double> log_odds, Input<double> level, double scatter,
                              Input<double> share, bool worth_their_odds) {
    const auto M = log_odds.size(), L = level.size();
    std::vector<double> height(M * L);
    for (std::size_t j = 0; j < M; ++j) {
        const double told = log_odds.data()[j];
        double nearest = std::numeric_limits<double>::infinity(), mean = 0;
        double* row = height.data() + L * j;
        for (std::size_t k = 0; k < L; ++k) {
            const double apart = (told - level.data()[k]) / scatter;
            row[k] = apart * apart;
            nearest = std::min(nearest, row[k]);
        }
        for (std::size_t k = 0; k < L; ++k) {
            row[k] = std::exp(0.5 * (nearest - row[k]));
            mean += row[k] * share.data()[k];
        }
        const double worth = (worth_their_odds ? std::exp(told) : 1.0) / std::max(mean, 1e-6);
        for (std::size_t k = 0; k < L; ++k) row[k] *= worth;
    }
    return array_of(std::move(height), {M, L});
}

pmbm::TableView view(const Input<std::int64_t>& cluster, const Input<double>& log_weight,
                     const Input<std::int64_t>& start, const Input<std::int64_t>& member) {
    return {cluster.data(), start.data(), member.data(), log_weight.data(),
            static_cast<std::int64_t>(cluster.size())};
}

Output<std::int64_t> merge_groups(Input<double> log_weight, Table<double> mean, Table<double> cov,
                                  double threshold, double alike, double as_heavy) {
    nb::gil_scoped_release released;
    auto group = pmbm::merge_groups(log_weight.data(), mean.data(), cov.data(), log_weight.size(),
                                    threshold, alike, as_heavy);
    nb::gil_scoped_acquire held;
    return hand_over(std::move(group));
}

// Returns the columns of `Rays`.
nb::tuple box_rays(Table<double> offset, Table<double> box, Input<double> widen, double yaw,
                   Input<double> cos, Input<double> sin) {
    auto rays = pmbm::box_rays(offset.data(), box.data(), widen.data(), widen.size(), yaw,
                               {cos.data(), sin.data(), static_cast<std::int64_t>(cos.size())});
    return nb::make_tuple(hand_over(std::move(rays.first)), hand_over(std::move(rays.bearing)),
                          hand_over(std::move(rays.distance)), hand_over(std::move(rays.margin)),
                          hand_over(std::move(rays.cores)));
}

pmbm::OcclusionRules occlusion_rules(const nb::tuple& constants, const Table<double>& nodes,
                                     const Input<double>& cos, const Input<double>& sin) {
    const auto number = [&](std::size_t i) { return nb::cast<double>(constants[i]); };
    return {number(0), number(1), number(2), number(3), number(4), number(5), number(6), number(7),
            nodes.data(), nodes.shape(0),
            {cos.data(), sin.data(), static_cast<std::int64_t>(cos.size())}};
}

// A mixture's columns: log_weight, mean, cov, and those of RecycledFrom or None.
struct MixtureColumns {
    Input<double> log_weight;
    Table<double> mean, cov;
    Input<std::int64_t> track;
    Input<double> share, recycled;
    bool any = false;

    explicit MixtureColumns(const nb::tuple& columns)
        : log_weight(nb::cast<Input<double>>(columns[0])),
          mean(nb::cast<Table<double>>(columns[1])), cov(nb::cast<Table<double>>(columns[2])) {
        if (columns[3].is_none()) return;
        any = true;
        const auto from = nb::cast<nb::tuple>(columns[3]);
        track = nb::cast<Input<std::int64_t>>(from[0]);
        share = nb::cast<Input<double>>(from[1]);
        recycled = nb::cast<Input<double>>(from[2]);
    }

    pmbm::MixtureView view() const {
        return {log_weight.data(), mean.data(), cov.data(), any ? track.data() : nullptr,
                any ? share.data() : nullptr, any ? recycled.data() : nullptr,
                log_weight.size()};
    }
};

nb::tuple hand_over(pmbm::Mixture&& mixture) {
    const bool any = mixture.any_recycled();
    return nb::make_tuple(
        hand_over(std::move(mixture.log_weight)), rows_of<4>(std::move(mixture.mean)),
        matrices_of<4>(std::move(mixture.cov)),
        any ? nb::object(nb::make_tuple(hand_over(std::move(mixture.track)),
                                        hand_over(std::move(mixture.share)),
                                        hand_over(std::move(mixture.recycled))))
            : nb::none());
}

// A mixture's columns, those of the settled one, and the mass that was dropped.
nb::tuple settled(nb::tuple ppp, Input<double> pose, double centre, double half_angle,
                  double max_range, double spacing, double log_negligible, double fine_above,
                  nb::tuple constants) {
    const MixtureColumns mixture(ppp);
    const auto number = [&](std::size_t i) { return nb::cast<double>(constants[i]); };
    auto [settled, dropped] =
        pmbm::MapSettler(mixture.view(), {pose.data(), centre, half_angle, max_range},
                         {spacing, log_negligible, fine_above, number(0), number(1), number(2),
                          number(3), number(4), number(5), number(6)})
            .run();
    return nb::make_tuple(hand_over(std::move(settled)), dropped);
}

// The values of a tuple, one after another.
class Values {
 public:
    explicit Values(nb::handle tuple) : tuple_(nb::borrow<nb::tuple>(tuple)) {}

    nb::handle any() { return nb::handle(PyTuple_GET_ITEM(tuple_.ptr(), at_++)); }
    template <typename T>
    T next() {
        return nb::cast<T>(any());
    }
    double number() { return next<double>(); }
    std::int64_t whole() { return next<std::int64_t>(); }
    bool flag() { return next<bool>(); }
    Input<double> numbers() { return next<Input<double>>(); }
    Input<std::int64_t> wholes() { return next<Input<std::int64_t>>(); }
    bool left() const { return at_ < PyTuple_GET_SIZE(tuple_.ptr()); }

 private:
    nb::tuple tuple_;
    Py_ssize_t at_ = 0;
};

// What does not change from step to step, in the order of _rules() of compiled.py; made once.
struct Rules {
    Input<double> R, corner, nodes, cos, sin;
    Input<std::int64_t> corner_start;
    pmbm::SensorRules sensor{};
    pmbm::StepRules step{};
    pmbm::OcclusionRules occlusion{};

    explicit Rules(nb::handle tuple) {
        Values in(tuple);
        R = in.numbers();
        sensor.R = R.data();
        sensor.clutter = in.number();
        sensor.view = sector(in);
        sensor.region = sector(in);
        sensor.occlusion = in.flag();
        sensor.undetected_in_detail = in.flag();
        corner_start = in.wholes();
        corner = in.numbers();
        sensor.occluders = {corner_start.data(), corner.data(), corner_start.size() - 1};
        sensor.scaled_misses = in.flag();
        sensor.box_gain = in.number();
        sensor.describes = in.flag();
        step.gate = in.number();
        step.recycle = in.flag();
        step.log_prune_undetected = in.number();
        step.merge_below = in.number();
        step.alike = in.number();
        step.as_heavy = in.number();
        step.as_likely = in.number();
        step.max_undetected = in.whole();
        step.few = in.whole();
        step.most_of_one = in.number();
        step.stay = in.number();
        const auto max_hypotheses = in.whole();
        const auto largest_table = in.number();
        const auto largest_search = in.whole();
        const auto log_prune = in.number();
        const auto recycle_below = in.number();
        const auto max_tracks = in.whole();
        const auto clustering = in.flag();
        const auto split_below = in.number();
        const auto worth_factoring = in.whole();
        step.branching = {max_hypotheses, largest_table, largest_search,
                          -log_prune,     log_prune,     clustering};
        step.reduction = {log_prune,  max_hypotheses, largest_table, recycle_below,
                          max_tracks, clustering,     split_below,   worth_factoring};
        const auto constants = in.next<nb::tuple>();
        nodes = in.numbers();
        cos = in.numbers();
        sin = in.numbers();
        occlusion = occlusion_rules(constants, nodes, cos, sin);
    }

 private:
    static pmbm::View sector(Values& in) {
        const auto centre = in.number(), half_angle = in.number(), max_range = in.number();
        return {nullptr, centre, half_angle, max_range};
    }
};

// How objects moved and lived on over one interval, and what became of what is remembered of them.
struct Interval {
    Input<double> F, Q;
    double survival, log_survival;
    std::vector<pmbm::DetectionLaw> laws;

    explicit Interval(nb::handle tuple) {
        Values in(tuple);
        F = in.numbers();
        Q = in.numbers();
        survival = in.number();
        log_survival = in.number();
        Values each(in.any());
        while (each.left()) {
            Values law(each.any());
            const auto low = law.number(), high = law.number();
            const bool rising = law.flag();
            const auto newest = law.number(), undetectable = law.number(), usual = law.number(),
                       memory = law.number();
            laws.push_back({low, high, rising, newest, undetectable, usual, memory});
        }
    }
};

struct BirthsColumns {
    Input<double> log_weight;
    Table<double> mean, cov;
    bool given = false, in_place = false;

    explicit BirthsColumns(nb::handle tuple) {
        Values in(tuple);
        if (!in.left()) return;
        given = true;
        log_weight = in.numbers();
        mean = in.numbers();
        cov = in.numbers();
        in_place = in.flag();
    }

    pmbm::BirthsView view() const {
        return {log_weight.data(), mean.data(), cov.data(), log_weight.size(), in_place};
    }
};

struct LocalsColumns {
    Input<std::int64_t> track, newest;
    Input<double> existence, mean, cov, box, confidence, detectable;
    std::size_t classes, sums;
    Input<std::int8_t> label;
    Input<bool> shown;
    Input<std::int32_t> history;

    explicit LocalsColumns(nb::handle tuple) {
        Values in(tuple);
        track = in.wholes();
        existence = in.numbers();
        mean = in.numbers();
        cov = in.numbers();
        box = in.numbers();
        label = in.next<Input<std::int8_t>>();
        newest = in.wholes();
        shown = in.next<Input<bool>>();
        history = in.next<Input<std::int32_t>>();
        classes = static_cast<std::size_t>(in.whole());
        confidence = in.numbers();
        detectable = in.numbers();
        sums = static_cast<std::size_t>(in.whole());
    }

    // P(class) (H,K) and running sums (H,R), predicted, come from elsewhere.
    pmbm::LocalsView view(const double* source, const double* record) const {
        return {track.data(),      existence.data(),  mean.data(),
                cov.data(),        box.data(),        label.data(),
                newest.data(),     shown.data(),      history.data(),
                source,            confidence.data(), detectable.data(),
                record,            existence.size(),  history.shape(1),
                classes,           sums};
    }
};

// The columns of `RadarScan`, or none.
struct RadarColumns {
    Input<double> R, sight, speed, variance;
    bool given = false;

    explicit RadarColumns(nb::handle tuple) {
        Values in(tuple);
        if (!in.left()) return;
        given = true;
        R = in.numbers();
        sight = in.numbers();
        const auto measured = in.any();
        if (!measured.is_none()) speed = nb::cast<Input<double>>(measured);
        variance = in.numbers();
    }

    pmbm::RadarView view() const { return {R.data(), sight.data(), speed.data(), variance.data()}; }
};

// What one frame measured.
struct ScanColumns {
    Input<double> evidence, birth, first, said, confidence;
    Input<std::int8_t> label;
    std::vector<double> position, box;

    explicit ScanColumns(nb::handle tuple) {
        Values in(tuple);
        const auto place = in.numbers(), size = in.numbers(), yaw = in.numbers();
        label = in.next<Input<std::int8_t>>();
        evidence = in.numbers();
        birth = in.numbers();
        const auto factors = in.any();
        if (!factors.is_none()) first = nb::cast<Input<double>>(factors);
        said = in.numbers();
        confidence = in.numbers();
        for (std::size_t j = 0; j < yaw.size(); ++j) {
            const double *at = place.data() + 3 * j, *extent = size.data() + 3 * j;
            position.insert(position.end(), {at[0], at[1]});
            box.insert(box.end(), {at[2], extent[0], extent[1], extent[2], yaw.data()[j]});
        }
    }

    pmbm::ScanView view() const {
        return {position.data(), box.data(),  label.data(),      evidence.data(),
                birth.data(),    first.data(), said.data(),      confidence.data(),
                label.size(),    birth.ndim() == 2};
    }
};

// The hypotheses that a step goes on from, in the order of _columns() of compiled.py.
struct DensityColumns {
    LocalsColumns local;
    Input<std::int64_t> cluster, start, member, track_id;
    Input<double> log_weight;
    std::int64_t settled;

    explicit DensityColumns(Values in) : local(in.any()) {
        Values table(in.any());
        cluster = table.wholes();
        log_weight = table.numbers();
        start = table.wholes();
        member = table.wholes();
        track_id = in.wholes();
        settled = in.whole();
    }
};

// One step of the filter; pmbm/filter/compiled.py says what goes in and what comes out.  It goes on
// from what a step before it left, or from columns; `ppp` is empty where that is what was left too.
nb::tuple step(const Rules& rules, const Interval& since, nb::handle ppp, nb::handle births,
               nb::handle before, nb::handle remembered, std::int64_t detections_seen,
               nb::handle scan, nb::handle radar, Input<double> pose, Input<double> region,
               std::size_t looking, bool blind, double detection_undetected) {
    auto sensor = rules.sensor;
    auto how = rules.step;
    const BirthsColumns born(births);
    // P(class) and running sums, predicted; or nothing, as they are.
    Input<double> source, record;
    Values predicted(remembered);
    if (predicted.left()) {
        source = predicted.numbers();
        record = predicted.numbers();
    }
    const auto births_view = born.view();
    const ScanColumns seen(scan);
    const RadarColumns by_radar(radar);
    const auto radar_view = by_radar.view();
    const pmbm::Held* held = nullptr;
    std::unique_ptr<const DensityColumns> given;
    std::unique_ptr<const MixtureColumns> mixture;
    if (!nb::try_cast<const pmbm::Held*>(before, held)) {
        given = std::make_unique<const DensityColumns>(Values(before));
    }
    if (Values(ppp).left()) {
        mixture = std::make_unique<const MixtureColumns>(nb::borrow<nb::tuple>(ppp));
    }
    const auto local = held ? held->locals(source.data(), record.data())
                            : given->local.view(source.data(), record.data());
    const auto table = held ? held->table()
                            : view(given->cluster, given->log_weight, given->start, given->member);

    sensor.view.pose = pose.data();
    sensor.region.pose = region.data();
    sensor.laws = since.laws.data();
    sensor.sensors = since.laws.size();
    sensor.looking = looking;
    sensor.blind = blind;
    sensor.detection_undetected = detection_undetected;
    how.F = since.F.data();
    how.Q = since.Q.data();
    how.survival = since.survival;
    how.log_survival = since.log_survival;

    auto out = std::make_shared<pmbm::Step>();
    {
        nb::gil_scoped_release released;
        pmbm::Stepper stepper(
            mixture ? mixture->view() : held->mixture(), born.given ? &births_view : nullptr,
            local, table, held ? held->step().track_id.data() : given->track_id.data(),
            held ? held->step().track_id.size() : given->track_id.size(), detections_seen,
            held ? held->settled() : given->settled, seen.view(),
            by_radar.given ? &radar_view : nullptr, sensor, how, rules.occlusion);
        *out = stepper.run();
    }
    if (out->existence.size() > pmbm::kMany) pmbm::trim_heap();
    const auto removed = nb::make_tuple(
        out->pruned + out->unlikely, out->capped, out->merged, out->recycled, out->tracks_capped,
        out->undetected_pruned, out->undetected_merged, out->undetected_capped);
    const auto apart = static_cast<std::int64_t>(local.count * seen.label.size()) - out->pairs;
    const auto seconds = nb::make_tuple(out->seconds[0], out->seconds[1], out->seconds[2],
                                        out->seconds[3]);
    auto tracks = std::move(out->tracks);
    pmbm::Held left(std::move(out), local, since.laws.size());
    return nb::make_tuple(left, pmbm::Judged(left, std::move(tracks)), removed, apart, seconds);
}

nb::tuple neighbours(Table<double> along, Table<double> aside, Input<bool> seen,
                     Input<double> half_width, Input<double> length, Input<std::int64_t> first,
                     Input<std::int64_t> searched, Input<double> offset, double reach,
                     Input<std::int64_t> row, Input<std::int64_t> column) {
    std::vector<std::int64_t> front, rear;
    pmbm::neighbours({along.data(), aside.data(), seen.data(), seen.size(), half_width.data(),
                      length.data(), length.size(), first.data(), searched.data(), offset.data()},
                     row.data(), column.data(), row.size(), reach, front, rear);
    return nb::make_tuple(hand_over(std::move(front)), hand_over(std::move(rear)));
}

nb::tuple near_pairs(Table<double> position, Input<double> heading, Input<double> speed,
                     Input<double> half_length, Input<double> half_width, std::size_t vehicles,
                     double dt) {
    std::vector<std::int64_t> first, second;
    pmbm::near_pairs({position.data(), heading.data(), speed.data(), half_length.data(),
                      half_width.data(), heading.size(), vehicles},
                     dt, 1e-6, first, second);
    return nb::make_tuple(hand_over(std::move(first)), hand_over(std::move(second)));
}

}  // namespace

NB_MODULE(_native, m) {
    nb::class_<pmbm::Owned>(m, "Owned", nb::type_slots(pmbm::owned_slots));
    nb::class_<pmbm::Held>(m, "Held")
        .def_prop_ro("settled", &pmbm::Held::settled)
        .def("undetected", &pmbm::Held::undetected)
        .def("recycled_from", &pmbm::Held::recycled_from)
        .def("local", &pmbm::Held::local)
        .def("marks", &pmbm::Held::marks)
        .def("source", &pmbm::Held::source)
        .def("record", &pmbm::Held::record)
        .def("hypotheses", &pmbm::Held::hypotheses)
        .def("track_id", &pmbm::Held::track_id)
        .def("reported", &reported_of);
    nb::class_<pmbm::Judged>(m, "Judged")
        .def("marginals", &pmbm::Judged::marginals)
        .def("inside", &pmbm::Judged::inside)
        .def("number_in_view",
             [](const pmbm::Judged& judged, Input<double> object_share) {
                 return judged.number_in_view(object_share.data());
             })
        .def("reported_as_known", &reported_as_known);
    nb::class_<Rules>(m, "Rules").def(nb::init<nb::handle>());
    nb::class_<Interval>(m, "Interval").def(nb::init<nb::handle>());
    m.doc() = "What is compiled; chosen by pmbm.kernels.";
    m.attr("fingerprint") = PMBM_FINGERPRINT;
    m.def("k_best", &k_best, nb::arg("cost"), nb::arg("rows"), nb::arg("widths"), nb::arg("ks"));
    m.def("k_best_choices", &k_best_choices, nb::arg("row"), nb::arg("column"), nb::arg("cost"),
          nb::arg("first_row"), nb::arg("first_column"), nb::arg("ks"), nb::arg("margin"));
    m.def("share_inside", &share_inside);
    m.def("level_evidence", &level_evidence);
    m.def("read_off", &read_off);
    m.def("objects", &objects);
    m.def("known_as_they_are", &known_as_they_are);
    m.def("suppress_overlaps", &suppress_overlaps);
    m.def("reported", &reported);
    m.def("merge_groups", &merge_groups);
    m.def("box_rays", &box_rays);
    m.def("settled", &settled);
    m.def("step", &step);
    m.def("neighbours", &neighbours);
    m.def("near_pairs", &near_pairs);
}
