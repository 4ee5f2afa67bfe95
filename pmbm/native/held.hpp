// The tables that a step left, kept where they are for the next step, and made arrays of where somebody
// looks at them.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <memory>
#include <utility>

#include "arrays.hpp"
#include "step.hpp"

namespace pmbm {

class Held {
 public:
    // The widths of the tables are those of the ones before.
    Held(std::shared_ptr<const Step> step, const LocalsView& before, std::size_t sensors)
        : step_(std::move(step)), history_(before.history_length), classes_(before.classes),
          sums_(before.sums), sensors_(sensors) {}

    const Step& step() const { return *step_; }
    std::int64_t settled() const { return step_->settled; }

    MixtureView mixture() const {
        const auto& ppp = step_->undetected;
        const bool any = ppp.any_recycled();
        return {ppp.log_weight.data(), ppp.mean.data(), ppp.cov.data(),
                any ? ppp.track.data() : nullptr, any ? ppp.share.data() : nullptr,
                any ? ppp.recycled.data() : nullptr, ppp.size()};
    }

    // P(class) (H,K) and running sums (H,R), predicted, come from elsewhere.
    LocalsView locals(const double* source, const double* record) const {
        const auto& s = *step_;
        return {s.track.data(),   s.existence.data(),
                s.mean.data(),    s.cov.data(),
                s.box.data(),     s.label.data(),
                s.newest.data(),  reinterpret_cast<const bool*>(s.shown.data()),
                s.history.data(), source,
                s.confidence.data(), s.detectable.data(),
                record,           s.existence.size(),
                history_,         classes_,
                sums_};
    }

    TableView table() const { return view_of(step_->hypotheses); }

    // The columns of `Mixture`.
    nb::tuple undetected() const {
        const auto& ppp = step_->undetected;
        const auto P = ppp.size();
        nb::object recycled = nb::none();
        if (ppp.any_recycled()) {
            recycled = nb::make_tuple(column(ppp.track), column(ppp.share), column(ppp.recycled));
        }
        return nb::make_tuple(column(ppp.log_weight), array(ppp.mean, {P, 4}),
                              array(ppp.cov, {P, 4, 4}), recycled);
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

}  // namespace pmbm
