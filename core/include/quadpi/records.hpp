// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Arrays of records, as numpy holds them: a pointer and a length, never owned.
#pragma once

#include <cstddef>

namespace quadpi {

// N values of a type, in memory that somebody else keeps.
template <class T>
struct Records {
    T* data = nullptr;
    std::size_t size = 0;

    T& operator[](std::size_t index) const { return data[index]; }
    T* begin() const { return data; }
    T* end() const { return data + size; }
    Records part(std::size_t first, std::size_t last) const { return {data + first, last - first}; }
};

}  // namespace quadpi
