// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Arrays of Python as records: any writable, contiguous buffer whose elements have the size of the type.
#pragma once

#include <nanobind/nanobind.h>

#include <stdexcept>
#include <string>
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

    bool hold(PyObject* object, std::size_t item_bytes) {
        if (PyObject_GetBuffer(object, &view, PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE) != 0) {
            PyErr_Clear();
            view.obj = nullptr;
            return false;
        }
        // Of the type itself, or of its numbers.
        const auto item = static_cast<std::size_t>(view.itemsize);
        return (item == item_bytes || item == sizeof(double)) && bytes() % item_bytes == 0;
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
        if (!buffer.hold(value.ptr(), sizeof(T))) {
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
        if (!buffer.hold(source.ptr(), sizeof(T))) {
            return false;
        }
        value = {static_cast<T*>(buffer.data()), buffer.bytes() / sizeof(T)};
        return true;
    }

private:
    quadpi::HeldBuffer buffer;
};

}  // namespace nanobind::detail
