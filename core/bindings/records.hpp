// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Arrays of Python as records: any contiguous buffer whose elements have the size of the type. It must be
// writable, but for records that are const. A named tuple of arrays comes as a std::tuple of records.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "quadpi/records.hpp"

namespace quadpi {

// A buffer that is held as long as a call lasts.
class HeldBuffer {
public:
    HeldBuffer() = default;
    HeldBuffer(const HeldBuffer&) = delete;
    HeldBuffer& operator=(const HeldBuffer&) = delete;
    ~HeldBuffer() {
        if (view.obj != nullptr) {
            PyBuffer_Release(&view);
        }
    }

    template <class T>
    bool hold(PyObject* object) {
        constexpr std::size_t item_bytes = sizeof(T);
        constexpr bool may_be_records = item_bytes > sizeof(double);
        // Of the type itself, or of its numbers. Only of numbers is the format asked for: numpy writes that
        // of records anew in every call, in 10 µs for a filter's.
        if (!get<T>(object, may_be_records ? 0 : PyBUF_FORMAT)) {
            return false;
        }
        bool fits = item() == item_bytes;
        if (may_be_records && item() == sizeof(double) && item_bytes % sizeof(double) == 0) {
            PyBuffer_Release(&view);
            if (!get<T>(object, PyBUF_FORMAT)) {
                return false;
            }
            fits = true;
        }
        if (reinterpret_cast<std::uintptr_t>(view.buf) % alignof(T) != 0) {
            // Arrays that came from another process may begin anywhere.
            if constexpr (!std::is_const_v<T> || alignof(T) > alignof(double)) {
                return false;
            }
            copy.reset(new double[bytes() / sizeof(double) + 1]);
            std::memcpy(copy.get(), view.buf, bytes());
        }
        return fits && bytes() % item_bytes == 0 && (view.format == nullptr || is_number_of<T>(view.format));
    }

    void* data() const { return copy ? copy.get() : view.buf; }
    std::size_t bytes() const { return static_cast<std::size_t>(view.len); }

private:
    Py_buffer view{};
    std::unique_ptr<double[]> copy;

    template <class T>
    bool get(PyObject* object, int wanted) {
        constexpr int access = PyBUF_C_CONTIGUOUS | (std::is_const_v<T> ? 0 : PyBUF_WRITABLE);
        if (PyObject_GetBuffer(object, &view, access | wanted) != 0) {
            PyErr_Clear();
            view.obj = nullptr;
            return false;
        }
        return true;
    }

    std::size_t item() const { return static_cast<std::size_t>(view.itemsize); }

    // Whether a format of Python's buffers, where it is that of 64-bit numbers, is that of the type's.
    template <class T>
    static bool is_number_of(std::string_view format) {
        // Numpy says by a prefix that an array is not aligned; only ">" is another order of bytes.
        if (!format.empty() && std::string_view("@=^<").find(format.front()) != std::string_view::npos) {
            format.remove_prefix(1);
        }
        const bool is_double = format == "d", is_integer = format == "l" || format == "q";
        if constexpr (std::is_floating_point_v<T>) {
            return is_double;
        } else if constexpr (std::is_integral_v<T> && sizeof(T) == sizeof(std::int64_t)) {
            return is_integer;
        } else if constexpr (sizeof(T) >= sizeof(double)) {
            return is_double || is_integer || format.substr(0, 2) == "T{";
        } else {
            return true;
        }
    }
};

// Refuse arguments that do not belong together.
inline void require(bool holds, const char* what) {
    if (!holds) {
        throw nanobind::value_error(what);
    }
}

constexpr const char* DIFFERENT = "samples of different numbers";

// Refuse arrays that are not all of so many records.
template <class... T>
void require_each(std::size_t count, const Records<T>&... arrays) {
    require(((arrays.size == count) && ...), DIFFERENT);
}

// Call a function with each row of arrays of as many records.
template <class Function, class First, class... T>
void for_rows(const Function& function, Records<First> first, Records<T>... others) {
    require_each(first.size, others...);
    for (std::size_t row = 0; row < first.size; ++row) {
        function(first[row], others[row]...);
    }
}

// A function of single records as one of arrays of them, of which the last takes what it returns.
template <class Out, class... In>
auto over_rows(Out (*function)(In...)) {
    return [function](Records<const std::decay_t<In>>... in, Records<Out> out) {
        for_rows([function](auto& to, const auto&... of) { to = function(of...); }, out, in...);
    };
}

// The same of a function that changes records, and returns nothing.
template <class... T>
auto over_rows(void (*function)(T&...)) {
    return [function](Records<T>... arrays) { for_rows(function, arrays...); };
}

// The only one of an array that stands for a record.
template <class T>
T& only(Records<T> records) {
    require(records.size >= 1, "an empty array for a record");
    return records[0];
}

// A field of a structure: an array of records, or the only one of it.
template <class T>
struct Part {
    Records<T> records;

    operator Records<T>() const { return records; }
    operator T&() const { return only(records); }
};

template <class T>
Part<T> part(Records<T> records) {
    return {records};
}

inline double part(double number) { return number; }

// A structure of records from those of a named tuple with the same fields.
template <class Structure, class... T>
Structure made_of(const std::tuple<T...>& fields) {
    return std::apply([](const T&... field) { return Structure{part(field)...}; }, fields);
}

// Records in an attribute of a Python object, held as long as this lives.
template <class T>
class Field {
public:
    Field(nanobind::handle object, const char* name) {
        const nanobind::object value = object.attr(name);
        if (!buffer.hold<T>(value.ptr())) {
            throw nanobind::type_error(
                (std::string(name) + ": not an array of its records, or not writable").c_str()
            );
        }
    }

    Records<T> all() const { return {static_cast<T*>(buffer.data()), buffer.bytes() / sizeof(T)}; }
    T& only() const { return quadpi::only(all()); }

private:
    HeldBuffer buffer;
};

// How pickle makes an object again that holds `arrays`.
inline nanobind::tuple made_again(nanobind::handle self) {
    return nanobind::make_tuple(self.type(), nanobind::make_tuple(self.attr("arrays")));
}

// A class of Python whose objects hold their arrays, and are pickled with them.
template <class Held>
nanobind::class_<Held> bind_held(nanobind::module_& module, const char* name) {
    nanobind::class_<Held> bound(module, name);
    bound.def_ro("arrays", &Held::arrays).def("__reduce__", &made_again);
    return bound;
}

// Give Python numbers of the core under the names, set apart by ", ", that they have here.
template <class... T>
void name_constants(nanobind::module_& module, std::string_view names, T... values) {
    const auto name = [&](auto value) {
        const std::size_t end = std::min(names.find(','), names.size());
        const std::string own(names.substr(0, end));
        if constexpr (std::is_enum_v<decltype(value)>) {
            module.attr(own.c_str()) = static_cast<std::int64_t>(value);
        } else {
            module.attr(own.c_str()) = value;
        }
        names.remove_prefix(std::min(end + 2, names.size()));
    };
    (name(values), ...);
}
#define NAME_CONSTANTS(module, ...) name_constants(module, #__VA_ARGS__, __VA_ARGS__)

}  // namespace quadpi

namespace nanobind::detail {

template <class T>
struct type_caster<quadpi::Records<T>> {
    NB_TYPE_CASTER(quadpi::Records<T>, const_name("numpy.ndarray"))

    bool from_python(handle source, std::uint8_t, cleanup_list*) noexcept {
        if (!buffer.hold<T>(source.ptr())) {
            return false;
        }
        value = {static_cast<T*>(buffer.data()), buffer.bytes() / sizeof(T)};
        return true;
    }

private:
    quadpi::HeldBuffer buffer;
};

}  // namespace nanobind::detail
