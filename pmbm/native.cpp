// The Python module pmbm._native.  Its callers, pmbm/assignment/__init__.py and pmbm/filter, have
// checked what comes in.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "assignment/k_best.hpp"
#include "filter/gate.hpp"

namespace nb = nanobind;

namespace {

template <typename T>
using Input = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using Output = nb::ndarray<nb::numpy, T, nb::ndim<1>>;
// Of any shape, C-ordered: read as one run of numbers.
template <typename T>
using Table = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
using Written = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

template <typename T>
Output<T> hand_over(std::vector<T>&& values) {
    auto* owned = new std::vector<T>(std::move(values));
    nb::capsule owner(owned, [](void* pointer) noexcept {
        delete static_cast<std::vector<T>*>(pointer);
    });
    return Output<T>(owned->data(), {owned->size()}, owner);
}

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

nb::tuple gate(Table<double> expected, Input<double> l11, Input<double> l21, Input<double> l22,
               Table<double> z, double threshold) {
    std::vector<std::int64_t> rows, columns;
    std::vector<double> whitened;
    {
        nb::gil_scoped_release released;
        pmbm::gate({expected.data(), l11.data(), l21.data(), l22.data(), l11.size()}, z.data(),
                   z.shape(0), threshold, rows, columns, whitened);
    }
    return nb::make_tuple(hand_over(std::move(rows)), hand_over(std::move(columns)),
                          hand_over(std::move(whitened)));
}

// Writes into mean (n,4) and cov (n,4,4).
void fuse(Input<std::int64_t> component, Input<std::int64_t> target, Input<double> log_weight,
          Table<double> whitened, Table<double> mean_of, Table<double> gain_of,
          Table<double> cov_of, Written mean, Written cov) {
    nb::gil_scoped_release released;
    pmbm::fuse({component.data(), target.data(), log_weight.data(), whitened.data(),
                component.size(), mean_of.data(), gain_of.data(), cov_of.data()},
               mean.shape(0), mean.data(), cov.data());
}

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "What is compiled; chosen by pmbm.compiled.";
    m.def("k_best", &k_best, nb::arg("cost"), nb::arg("rows"), nb::arg("widths"), nb::arg("ks"));
    m.def("k_best_choices", &k_best_choices, nb::arg("row"), nb::arg("column"), nb::arg("cost"),
          nb::arg("first_row"), nb::arg("first_column"), nb::arg("ks"), nb::arg("margin"));
    m.def("gate", &gate, nb::arg("expected"), nb::arg("l11"), nb::arg("l21"), nb::arg("l22"),
          nb::arg("z"), nb::arg("threshold"));
    m.def("fuse", &fuse, nb::arg("component"), nb::arg("target"), nb::arg("log_weight"),
          nb::arg("whitened"), nb::arg("mean_of"), nb::arg("gain_of"), nb::arg("cov_of"),
          nb::arg("mean").noconvert(), nb::arg("cov").noconvert());
}
