// Numpy arrays in and out by the buffer protocol: a step of few objects hands over some sixty, and
// through DLPack each takes longer than the filter's work on it.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include "memory.hpp"
#include "tables.hpp"

namespace pmbm {

namespace nb = nanobind;

template <typename T>
struct Kind;
template <>
struct Kind<double> {
    static constexpr const char *name = "float64", *formats = "d";
};
template <>
struct Kind<std::int64_t> {
    static constexpr const char *name = "int64", *formats = "lq";
};
template <>
struct Kind<std::int32_t> {
    static constexpr const char *name = "int32", *formats = "il";
};
template <>
struct Kind<Flag> {
    static constexpr const char *name = "bool", *formats = "?";
};
template <>
struct Kind<bool> {
    static constexpr const char *name = "bool", *formats = "?";
};
template <>
struct Kind<std::int8_t> {
    static constexpr const char *name = "int8", *formats = "b";
};

// A name of numpy, looked up once for each place that asks.
inline nb::handle of_numpy(const char* name) {
    return nb::object(nb::module_::import_("numpy").attr(name)).release();
}

template <typename T>
nb::handle dtype() {
    static const nb::handle found = of_numpy("dtype")(Kind<T>::name).release();
    return found;
}

// A C-ordered array of numbers that is read.
template <typename T>
class Buffer {
 public:
    Buffer() = default;
    Buffer(Buffer&& other) noexcept
        : view_(other.view_), held_(other.held_), converted_(std::move(other.converted_)) {
        other.held_ = false;
    }
    Buffer& operator=(Buffer&& other) noexcept {
        release();
        view_ = other.view_;
        held_ = std::exchange(other.held_, false);
        converted_ = std::move(other.converted_);
        return *this;
    }
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { release(); }

    // Whether it is such an array, or can be made one.
    bool take(nb::handle array) noexcept {
        if (look(array)) return true;
        static const nb::handle contiguous = of_numpy("ascontiguousarray");
        try {
            converted_ = contiguous(array, dtype<T>());
        } catch (nb::python_error&) {
            return false;
        }
        return look(converted_);
    }

    const T* data() const { return static_cast<const T*>(view_.buf); }
    std::size_t size() const { return static_cast<std::size_t>(view_.len) / sizeof(T); }
    std::size_t shape(int axis) const { return static_cast<std::size_t>(view_.shape[axis]); }
    int ndim() const { return view_.ndim; }

 private:
    bool look(nb::handle array) noexcept {
        if (PyObject_GetBuffer(array.ptr(), &view_, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) != 0) {
            PyErr_Clear();
            return false;
        }
        held_ = true;
        const char* format = view_.format;
        if (view_.itemsize == sizeof(T) && format && format[0] && !format[1] &&
            std::strchr(Kind<T>::formats, format[0])) {
            return true;
        }
        release();
        return false;
    }

    void release() {
        if (held_) PyBuffer_Release(&view_);
        held_ = false;
    }

    Py_buffer view_{};
    bool held_ = false;
    nb::object converted_;
};

// Numbers that outlive the call that made them.
struct Owned {
    std::shared_ptr<const void> keep;
    void* data;
    Py_ssize_t bytes;
    bool read_only = false;
};

inline int show_owned(PyObject* self, Py_buffer* view, int flags) {
    auto* owned = nb::inst_ptr<Owned>(self);
    return PyBuffer_FillInfo(view, self, owned->data, owned->bytes,
                             owned->read_only, flags);
}

inline PyType_Slot owned_slots[] = {
    {Py_bf_getbuffer, reinterpret_cast<void*>(show_owned)},
    {0, nullptr},
};

// Bytes up to which numbers are copied into an array: numpy makes one of its own in an eighth of the
// time that it takes to make one of memory that another keeps.
constexpr std::size_t kCopied = std::size_t{1} << 14;

inline nb::object shape_of(std::initializer_list<std::size_t> lengths) {
    auto shape = nb::steal(nb::handle(PyTuple_New(static_cast<Py_ssize_t>(lengths.size()))));
    Py_ssize_t axis = 0;
    for (const auto length : lengths) {
        PyTuple_SET_ITEM(shape.ptr(), axis++, PyLong_FromSize_t(length));
    }
    return shape;
}

template <typename Column>
nb::object copied(const Column& values, const nb::object& shape) {
    using T = typename Column::value_type;
    static const nb::handle empty = of_numpy("empty");
    PyObject* const arguments[] = {shape.ptr(), dtype<T>().ptr()};
    PyObject* made = PyObject_Vectorcall(empty.ptr(), arguments, 2, nullptr);
    if (!made) throw nb::python_error();
    auto array = nb::steal(nb::handle(made));
    Py_buffer view;
    if (PyObject_GetBuffer(made, &view, PyBUF_SIMPLE) != 0) throw nb::python_error();
    if (!values.empty()) std::memcpy(view.buf, values.data(), values.size() * sizeof(T));
    PyBuffer_Release(&view);
    return array;
}

// The values as an array of this shape; where they are many, without a copy, but out of the heap.
template <typename T, typename Memory>
nb::object array_of(std::vector<T, Memory>&& values, std::initializer_list<std::size_t> lengths) {
    if constexpr (!std::is_same_v<Memory, Pages<T>>) {
        if (Pages<T>::has_its_own(values.size())) {
            Column<T> moved(values.begin(), values.end());
            values = std::vector<T, Memory>();
            return array_of(std::move(moved), lengths);
        }
    }
    static const nb::handle ndarray = of_numpy("ndarray");
    const auto bytes = values.size() * sizeof(T);
    const auto shape = shape_of(lengths);
    if (bytes <= kCopied) return copied(values, shape);
    auto kept = std::make_shared<std::vector<T, Memory>>(std::move(values));
    void* data = kept->data();
    nb::object owned = nb::cast(Owned{std::move(kept), data, static_cast<Py_ssize_t>(bytes)});
    PyObject* made = PyObject_CallFunctionObjArgs(ndarray.ptr(), shape.ptr(), dtype<T>().ptr(),
                                                  owned.ptr(), nullptr);
    if (!made) throw nb::python_error();
    return nb::steal(nb::handle(made));
}

// The values of a column that something keeps, as an array of this shape; read only, unless copied.
template <typename Column, typename Keep>
nb::object array_over(const Column& values, const std::shared_ptr<Keep>& keep,
                      std::initializer_list<std::size_t> lengths) {
    using T = typename Column::value_type;
    static const nb::handle ndarray = of_numpy("ndarray");
    const auto bytes = values.size() * sizeof(T);
    const auto shape = shape_of(lengths);
    if (bytes <= kCopied) return copied(values, shape);
    nb::object owned = nb::cast(Owned{keep, const_cast<T*>(values.data()),
                                      static_cast<Py_ssize_t>(bytes), true});
    PyObject* made = PyObject_CallFunctionObjArgs(ndarray.ptr(), shape.ptr(), dtype<T>().ptr(),
                                                  owned.ptr(), nullptr);
    if (!made) throw nb::python_error();
    return nb::steal(nb::handle(made));
}

template <typename T, typename Memory>
nb::object hand_over(std::vector<T, Memory>&& values) {
    const auto count = values.size();
    return array_of(std::move(values), {count});
}

// The same as a table of so many columns.
template <std::size_t columns, typename T, typename Memory>
nb::object rows_of(std::vector<T, Memory>&& values) {
    const auto rows = values.size() / columns;
    return array_of(std::move(values), {rows, columns});
}

// The same as square matrices.
template <std::size_t size, typename Memory>
nb::object matrices_of(std::vector<double, Memory>&& values) {
    const auto count = values.size() / (size * size);
    return array_of(std::move(values), {count, size, size});
}

}  // namespace pmbm

namespace nanobind::detail {

template <typename T>
struct type_caster<pmbm::Buffer<T>> {
    NB_TYPE_CASTER(pmbm::Buffer<T>, const_name("numpy.ndarray"))

    bool from_python(handle source, std::uint8_t, cleanup_list*) noexcept {
        return value.take(source);
    }
};

}  // namespace nanobind::detail
