// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Numbers of rotors that Python hands over: loops run over them, so they are checked where they come in.
#pragma once

#include "bindings/records.hpp"
#include "quadpi/signals/chain.hpp"

namespace quadpi {

constexpr const char* NO_ROTORS = "not a number of rotors from 1 to 12";

// The number of rotors of a record.
inline std::size_t checked_rotors(std::int64_t rotors) {
    require(1 <= rotors && rotors <= ROTORS_MAX, NO_ROTORS);
    return static_cast<std::size_t>(rotors);
}

// Refuse rows of signals that are not so many, of so many rotors.
inline void require_rows(Records<const double> rows, std::size_t count, std::int64_t rotors) {
    checked_rotors(rotors);
    require(rows.size == count * channels_of(rotors), DIFFERENT);
}

}  // namespace quadpi
