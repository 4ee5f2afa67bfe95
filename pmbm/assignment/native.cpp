// The Python module pmbm._native.  pmbm/assignment/__init__.py is its only caller and has checked
// what comes in.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "k_best.hpp"

namespace nb = nanobind;

namespace {

template <typename T>
using Input = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using Output = nb::ndarray<nb::numpy, T, nb::ndim<1>>;

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

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "The compiled kernel of pmbm.assignment.";
    m.def("k_best", &k_best, nb::arg("cost"), nb::arg("rows"), nb::arg("widths"), nb::arg("ks"));
    m.def("k_best_choices", &k_best_choices, nb::arg("row"), nb::arg("column"), nb::arg("cost"),
          nb::arg("first_row"), nb::arg("first_column"), nb::arg("ks"), nb::arg("margin"));
}
