// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Filter of what a flight leaves of a model on one axis: its constant and a process; see monitor/change.py.
#pragma once

#include <algorithm>

#include "quadpi/monitor/change_state.hpp"

namespace quadpi {

// Blocks over which the running mean of squared surprises forgets, the largest square that counts in it, and
// the least mean that residuals are scaled by.
constexpr double LOUDNESS_BLOCKS = 40.0, LOUDNESS_MOST = 25.0, LOUDNESS_LEAST = 0.25;
// Surprise beyond which a block moves the filter no farther: one that collides says little of the constant.
constexpr double SURPRISE_MOST = 5.0;

// Begin a filter with what flights have shown.
inline void begin_filter(const AxisNoise& noise, AxisFilter& filter) {
    filter = {};
    filter.mean.constant = noise.mean;
    filter.of_constant = noise.between;
    filter.of_process = noise.process;
    filter.loudness = 1.0;
}

// Let a filter wait for a block without samples.
inline void pass_block(const AxisNoise& noise, AxisFilter& filter) {
    const double keep = noise.keep;
    filter.mean.process *= keep;
    filter.of_constant += noise.walk;
    filter.of_both *= keep;
    filter.of_process = noise.process + keep * keep * (filter.of_process - noise.process);
}

// Take the residual of a block, for which pass_block() has been called since the one before.
inline void take_residual(const AxisNoise& noise, AxisFilter& filter, double residual) {
    const double constant = filter.of_constant + filter.of_both;
    const double process = filter.of_both + filter.of_process;
    const double variance = constant + process + noise.white;
    const double error = residual - filter.mean.constant - filter.mean.process;
    filter.spread = std::sqrt(variance);
    filter.surprise = error / filter.spread;
    // A block that surprises more counts as if its own noise were larger by as much.
    const double share = std::min(1.0, SURPRISE_MOST / std::abs(filter.surprise));
    filter.gain = {share * constant / variance, share * process / variance};
    filter.mean.constant += filter.gain.constant * error;
    filter.mean.process += filter.gain.process * error;
    filter.of_constant -= filter.gain.constant * constant;
    filter.of_both -= filter.gain.constant * process;
    filter.of_process -= filter.gain.process * process;
}

inline void remember_loudness(AxisFilter& filter) {
    const double square = std::min(filter.surprise * filter.surprise, LOUDNESS_MOST);
    filter.loudness += (square - filter.loudness) / LOUDNESS_BLOCKS;
}

// Whitened residuals of one axis of a flight, their deviations, what a constant of 1 would add to them, and
// the loudness before each.
inline void whiten(
    const AxisNoise& noise,
    Records<const double> residuals,
    Records<const std::int64_t> numbers,
    Records<double> errors,
    Records<double> spreads,
    Records<double> ones,
    Records<double> loudness
) {
    AxisFilter filter;
    begin_filter(noise, filter);
    Parts moved{};
    for (std::size_t row = 0; row < residuals.size; ++row) {
        for (std::int64_t k = row == 0 ? 0 : numbers[row] - numbers[row - 1]; k > 0; --k) {
            pass_block(noise, filter);
            moved.process *= noise.keep;
        }
        take_residual(noise, filter, residuals[row]);
        const double one = 1.0 - moved.constant - moved.process;
        moved.constant += filter.gain.constant * one;
        moved.process += filter.gain.process * one;
        errors[row] = filter.surprise;
        spreads[row] = filter.spread;
        ones[row] = one / filter.spread;
        loudness[row] = filter.loudness;
        remember_loudness(filter);
    }
}

// Residuals count by how loud the axis was before: flights and manoeuvres differ in it.
inline double quieter(const AxisFilter& filter) {
    return 1.0 / std::sqrt(std::max(filter.loudness, LOUDNESS_LEAST));
}

}  // namespace quadpi
