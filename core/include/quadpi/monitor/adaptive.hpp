// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Intervals that adapt to the measured wrench; see monitor/adaptive.py.
#pragma once

#include "quadpi/elementary.hpp"
#include "quadpi/records.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// The factor follows errors of 1/LARGEST_CHANGE to LARGEST_CHANGE half widths.
constexpr double LARGEST_CHANGE = 1000.0;

// How the factors follow the measured wrench, and where they are.
struct AdaptiveMemory {
    double step;        // η
    double miss_share;  // α
    Wrench log_factor;
};

// Fill the bounds of one sample from the model's own, and advance the factors by it.
inline void adapt(
    AdaptiveMemory& memory,
    const Wrench& measured,
    const Wrench& own_lower,
    const Wrench& own_upper,
    Wrench& lower,
    Wrench& upper
) {
    for (int axis = 0; axis < AXES; ++axis) {
        const double factor = exponential(memory.log_factor[axis]);
        const double centre = 0.5 * own_lower[axis] + 0.5 * own_upper[axis];
        const double half = 0.5 * own_upper[axis] - 0.5 * own_lower[axis];
        const double low = centre - factor * half, high = centre + factor * half;
        lower[axis] = low;
        upper[axis] = high;
        if (!(half > 0.0 && std::isfinite(low + high) && std::isfinite(measured[axis]))) {
            continue;
        }
        bool missed = !(measured[axis] >= low && measured[axis] <= high);
        if (factor > LARGEST_CHANGE) {
            missed = false;
        } else if (factor < 1.0 / LARGEST_CHANGE) {
            missed = true;
        }
        memory.log_factor[axis] += memory.step * ((missed ? 1.0 : 0.0) - memory.miss_share);
    }
}

}  // namespace quadpi
