// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Fourth-order Butterworth low-pass, and the derivative that is consistent with it; see signals/filters.py.
#pragma once

#include <array>
#include <cstddef>

#include "quadpi/records.hpp"

namespace quadpi {

constexpr int SECTIONS = 2, DELAYS = 2;

// One second-order section: gain (1 + z⁻¹)² / (1 + a1 z⁻¹ + a2 z⁻²), of unit gain at zero frequency.
struct Section {
    double gain;
    double a1;
    double a2;
};

// The filter's coefficients.
struct LowPass {
    Section first;
    Section second;
    double rate_hz;
};

// Delay lines of a filter over C channels: C numbers of each delay of each section.
struct DelayLines {
    double* numbers;
    std::size_t channels;

    double& at(int section, int delay, std::size_t channel) const {
        return numbers[(section * DELAYS + delay) * channels + channel];
    }
};

// Set the delays to those of a filter whose input has always been `sample`.
inline void settle(const LowPass& design, const DelayLines& state, const double* sample) {
    for (std::size_t channel = 0; channel < state.channels; ++channel) {
        const double first = sample[channel] / (1.0 + design.first.a1 + design.first.a2);
        const double second = sample[channel] / (1.0 + design.second.a1 + design.second.a2);
        for (int delay = 0; delay < DELAYS; ++delay) {
            state.at(0, delay, channel) = first;
            state.at(1, delay, channel) = second;
        }
    }
}

// Filter rows of finite samples into values and derivatives per second, and advance the delays.
//
// Blocks of any length give the same samples, bit for bit. The sample rate is taken as constant.
inline void low_pass(
    const LowPass& design,
    const DelayLines& state,
    std::size_t rows,
    const double* samples,
    double* value,
    double* derivative
) {
    const Section &first = design.first, &second = design.second;
    const double slope_gain = 2.0 * design.rate_hz * second.gain;
    for (std::size_t row = 0; row < rows; ++row) {
        for (std::size_t channel = 0; channel < state.channels; ++channel) {
            const std::size_t place = row * state.channels + channel;
            double last = state.at(0, 0, channel), before = state.at(0, 1, channel);
            double newest = samples[place] - first.a1 * last - first.a2 * before;
            const double between = first.gain * (newest + 2.0 * last + before);
            state.at(0, 0, channel) = newest;
            state.at(0, 1, channel) = last;

            last = state.at(1, 0, channel);
            before = state.at(1, 1, channel);
            newest = between - second.a1 * last - second.a2 * before;
            value[place] = second.gain * (newest + 2.0 * last + before);
            derivative[place] = slope_gain * (newest - before);
            state.at(1, 0, channel) = newest;
            state.at(1, 1, channel) = last;
        }
    }
}

}  // namespace quadpi
