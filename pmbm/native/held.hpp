// The tables that a step left, kept where they are for the next step, and made arrays of where somebody
// looks at them.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <memory>
#include <utility>

#include "arrays.hpp"
#include "report.hpp"
#include "step.hpp"

namespace pmbm {

class Held {
 public:
    // The widths of the tables are those of the ones before.
    Held(std::shared_ptr<const Step> step, const LocalsView& before, std::size_t sensors)
        : step_(std::move(step)), history_(before.history_length), classes_(before.classes),
          sums_(before.sums), sensors_(sensors) {}

    const Step& step() const { return *step_; }
    std::size_t classes() const { return classes_; }
    std::int64_t settled() const { return step_->settled; }

    MixtureView mixture() const {
        const auto& ppp = step_->undetected;
        const bool any = ppp.any_recycled();
        return {ppp.log_weight.data(), ppp.mean.data(), ppp.cov.data(),
                any ? ppp.track.data() : nullptr, any ? ppp.share.data() : nullptr,
                any ? ppp.recycled.data() : nullptr, ppp.size()};
    }

    // source (H,K), record (H,R) : P(class) and running sums, predicted; null, as they are.
    LocalsView locals(const double* source = nullptr, const double* record = nullptr) const {
        const auto& s = *step_;
        return {s.track.data(),   s.existence.data(),
                s.mean.data(),    s.cov.data(),
                s.box.data(),     s.label.data(),
                s.newest.data(),  reinterpret_cast<const bool*>(s.shown.data()),
                s.history.data(), source ? source : s.source.data(),
                s.confidence.data(), s.detectable.data(),
                record ? record : s.record.data(), s.existence.size(),
                history_,         classes_,
                sums_};
    }

    TableView table() const { return view_of(step_->hypotheses); }

    // The columns of `GaussianMixture`.
    nb::tuple undetected() const {
        const auto& ppp = step_->undetected;
        const auto P = ppp.size();
        return nb::make_tuple(column(ppp.log_weight), array(ppp.mean, {P, 4}),
                              array(ppp.cov, {P, 4, 4}));
    }

    // Those of `RecycledFrom`, or None.
    nb::object recycled_from() const {
        const auto& ppp = step_->undetected;
        if (!ppp.any_recycled()) return nb::none();
        return nb::make_tuple(column(ppp.track), column(ppp.share), column(ppp.recycled));
    }

    // Those of `Locals`, but for its marks and record.
    nb::tuple local() const {
        const auto& s = *step_;
        const auto H = s.existence.size();
        return nb::make_tuple(column(s.track), column(s.existence), array(s.mean, {H, 4}),
                              array(s.cov, {H, 4, 4}), array(s.box, {H, 5}), column(s.label),
                              column(s.newest), column(s.shown), array(s.history, {H, history_}));
    }

    // Those of `Marks`.
    nb::tuple marks() const {
        return nb::make_tuple(source(), of_sensors(step_->confidence),
                              of_sensors(step_->detectable));
    }

    nb::object source() const {
        return array(step_->source, {step_->existence.size(), classes_});
    }

    nb::object record() const { return array(step_->record, {step_->existence.size(), sums_}); }

    // Those of `Globals`.
    nb::tuple hypotheses() const {
        const auto& table = step_->hypotheses;
        return nb::make_tuple(column(table.cluster), column(table.log_weight),
                              column(table.start), column(table.member));
    }

    nb::object track_id() const { return column(step_->track_id); }

 private:
    template <typename Column>
    nb::object array(const Column& values, std::initializer_list<std::size_t> shape) const {
        return array_over(values, step_, shape);
    }

    template <typename Column>
    nb::object column(const Column& values) const {
        return array(values, {values.size()});
    }

    // Of one sensor alone, a column; of several, a table.
    template <typename Column>
    nb::object of_sensors(const Column& values) const {
        return sensors_ > 1 ? array(values, {step_->existence.size(), sensors_}) : column(values);
    }

    std::shared_ptr<const Step> step_;
    std::size_t history_, classes_, sums_, sensors_;
};

// The marginals of the tracks that a step left, for what is reported of them.
class Judged {
 public:
    Judged(Held held, TrackMarginals&& tracks)
        : held_(std::move(held)),
          tracks_(std::make_shared<const TrackMarginals>(std::move(tracks))) {}

    const Held& held() const { return held_; }

    // P(object) (T,), given that (K,) of a source of each class.
    Floats objects(const double* share) const {
        return pmbm::objects(tracks_->of_class.data(), tracks_->existence.data(),
                             tracks_->existence.size(), share, held_.classes());
    }

    double number_in_view(const double* share) const {
        const auto exists = objects(share);
        double number = 0;
        for (std::size_t t = 0; t < exists.size(); ++t) number += exists[t] * tracks_->inside[t];
        return number;
    }

    // exists (T,) : that each is an object.
    Candidates candidates(const Floats& exists) const {
        return {held_.step().track_id.data(), tracks_->best.data(), exists.data(),
                tracks_->inside.data(), exists.size()};
    }

    // The columns of `Marginals`.
    nb::tuple marginals() const {
        const auto T = tracks_->existence.size();
        return nb::make_tuple(array_over(tracks_->existence, tracks_, {T}),
                              array_over(tracks_->of_class, tracks_, {T, held_.classes()}),
                              array_over(tracks_->best, tracks_, {T}));
    }

    nb::object inside() const {
        return array_over(tracks_->inside, tracks_, {tracks_->inside.size()});
    }

 private:
    Held held_;
    std::shared_ptr<const TrackMarginals> tracks_;
};

}  // namespace pmbm
