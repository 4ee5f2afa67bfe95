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

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "The compiled kernel of pmbm.assignment.";
    m.def("k_best", &k_best, nb::arg("cost"), nb::arg("rows"), nb::arg("widths"), nb::arg("ks"));
}
