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

// Running means of past errors by which the centre moves, and samples that an error may wait to count.
constexpr std::size_t CENTRE_MEANS = 8, ERRORS_KEPT = 32;

// How the intervals follow the measured wrench, and where they are.
struct AdaptiveMemory {
    double step;        // η
    double miss_share;  // α
    Wrench log_factor;
    std::int64_t delay;                      // samples after which an error counts, 1 to ERRORS_KEPT
    std::int64_t samples;                    // so far
    Wrench narrower;                         // half width about the centre that moves, over the model's own
    std::array<double, CENTRE_MEANS> share;  // of a new error in each mean
    std::array<std::array<double, CENTRE_MEANS>, AXES> coefficient, mean;
    std::array<Wrench, ERRORS_KEPT> waiting;  // errors, the last ones
};

// Let the means take the error that is old enough at the next sample; see models/interval_rules.py.
inline void move_centre(AdaptiveMemory& memory, const Wrench& error) {
    memory.waiting[memory.samples % ERRORS_KEPT] = error;
    ++memory.samples;
    if (memory.samples < memory.delay) {
        return;
    }
    const Wrench& known = memory.waiting[(memory.samples - memory.delay) % ERRORS_KEPT];
    for (int axis = 0; axis < AXES; ++axis) {
        // What is not known leaves the means.
        for (std::size_t k = 0; k < CENTRE_MEANS && std::isfinite(known[axis]); ++k) {
            memory.mean[axis][k] += memory.share[k] * (known[axis] - memory.mean[axis][k]);
        }
    }
}

// Fill the bounds of one sample from the model's own, and advance the factors by it.
inline void adapt(
    AdaptiveMemory& memory,
    const Wrench& measured,
    const Wrench& own_lower,
    const Wrench& own_upper,
    Wrench& lower,
    Wrench& upper
) {
    Wrench error;
    for (int axis = 0; axis < AXES; ++axis) {
        const double factor = exponential(memory.log_factor[axis]);
        const double own_centre = 0.5 * own_lower[axis] + 0.5 * own_upper[axis];
        error[axis] = measured[axis] - own_centre;
        double centre = own_centre;
        for (std::size_t k = 0; k < CENTRE_MEANS; ++k) {
            centre += memory.coefficient[axis][k] * memory.mean[axis][k];
        }
        const double half = memory.narrower[axis] * (0.5 * own_upper[axis] - 0.5 * own_lower[axis]);
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
    move_centre(memory, error);
}

}  // namespace quadpi
