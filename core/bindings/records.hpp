// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Arrays of Python as records: any contiguous buffer whose elements have the size of the type. It must be
// writable, but for records that are const.
#pragma once

#include <nanobind/nanobind.h>

#include <stdexcept>
#include <string>
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
        constexpr int access = std::is_const_v<T> ? 0 : PyBUF_WRITABLE;
        if (PyObject_GetBuffer(object, &view, PyBUF_C_CONTIGUOUS | access) != 0) {
            PyErr_Clear();
            view.obj = nullptr;
            return false;
        }
        // Of the type itself, or of its numbers.
        const auto item = static_cast<std::size_t>(view.itemsize);
        const bool of_numbers = item == sizeof(double) && item_bytes % sizeof(double) == 0;
        return (item == item_bytes || of_numbers) && bytes() % item_bytes == 0;
    }

    void* data() const { return view.buf; }
    std::size_t bytes() const { return static_cast<std::size_t>(view.len); }

private:
    Py_buffer view{};
};

// Records in an attribute of a Python object, held as long as this lives.
template <class T>
class Field {
public:
    Field(nanobind::handle object, const char* name) {
        const nanobind::object value = object.attr(name);
        if (!buffer.hold<T>(value.ptr())) {
            throw nanobind::type_error((std::string(name) + ": not a writable array of its records").c_str());
        }
    }

    Records<T> all() const { return {static_cast<T*>(buffer.data()), buffer.bytes() / sizeof(T)}; }
    T& only() const { return all()[0]; }

private:
    HeldBuffer buffer;
};

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
