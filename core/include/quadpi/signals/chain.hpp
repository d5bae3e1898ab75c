// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// One low-pass for all signals of a flight, so that they share one delay; see signals/chain.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "quadpi/rotations.hpp"
#include "quadpi/signals/filters.hpp"

namespace quadpi {

// Room for the rotors of a vehicle. How many it has, from 1 on, stands in the record that knows the vehicle:
// loops run over these alone, and the numbers beyond mean nothing.
constexpr int ROTORS_MAX = 12;
using PerRotor = std::array<double, ROTORS_MAX>;

// The signals of a sample, offline and live. The low-pass takes them as one row of numbers, of which those of
// the vehicle's rotors are the last.
struct Signals {
    Vector3 velocity;        // m/s over ground, body axes
    Quaternion attitude;     // body to world
    Vector3 rates;           // rad/s
    Vector3 specific_force;  // m/s², body axes
    Vector3 wind;            // m/s, world
    PerRotor rotor_speeds;   // rad/s
};

constexpr std::size_t CHANNELS_MAX = sizeof(Signals) / sizeof(double);
constexpr std::size_t WIND_CHANNEL = offsetof(Signals, wind) / sizeof(double);
constexpr std::size_t ROTOR_CHANNEL = offsetof(Signals, rotor_speeds) / sizeof(double);

inline double* numbers_of(Signals& signals) { return reinterpret_cast<double*>(&signals); }
inline const double* numbers_of(const Signals& signals) { return reinterpret_cast<const double*>(&signals); }

// Numbers of a sample of a vehicle with so many rotors.
constexpr std::size_t channels_of(std::int64_t rotors) {
    return ROTOR_CHANNEL + static_cast<std::size_t>(rotors);
}

// A sample outside the core is a row of velocity, attitude, rates, specific force, n rotor speeds and wind.
inline Signals signals_in(const double* row, std::int64_t rotors) {
    Signals signals{};
    std::copy_n(row, WIND_CHANNEL, numbers_of(signals));
    std::copy_n(row + WIND_CHANNEL, rotors, signals.rotor_speeds.begin());
    std::copy_n(row + WIND_CHANNEL + rotors, 3, signals.wind.begin());
    return signals;
}

inline void fill_row(const Signals& signals, std::int64_t rotors, double* row) {
    row = std::copy_n(numbers_of(signals), WIND_CHANNEL, row);
    row = std::copy_n(signals.rotor_speeds.begin(), rotors, row);
    std::copy_n(signals.wind.begin(), 3, row);
}

// What the causal low-pass over all signals remembers; all zeros before the first sample.
struct ChainMemory {
    std::array<double, SECTIONS * DELAYS * CHANNELS_MAX> delays;
    Quaternion attitude;  // the last one, with the sign that it was filtered with
    bool started;
};

// Forget all samples, after a gap or a jump of the clock: the filter settles at the next one.
inline void forget(ChainMemory& memory) {
    memory.attitude = {};
    memory.started = false;
}

// Give each quaternion, in place, the sign nearest to the previous one, which before the first is `last`.
//
// q and −q are the same attitude, but their mean is not an attitude.
inline void make_continuous(Records<Quaternion> attitudes, Quaternion last) {
    for (Quaternion& attitude : attitudes) {
        double projection = 0.0;
        for (int component = 0; component < 4; ++component) {
            projection += last[component] * attitude[component];
        }
        const double sign = projection < 0.0 ? -1.0 : 1.0;
        for (int component = 0; component < 4; ++component) {
            attitude[component] *= sign;
        }
        last = attitude;
    }
}

// The quaternion divided by its norm.
inline void scale_to_unit(Quaternion& attitude) {
    double square = 0.0;
    for (const double component : attitude) {
        square += component * component;
    }
    const double norm = std::sqrt(square);
    for (double& component : attitude) {
        component /= norm;
    }
}

// Pass one finite sample through the causal low-pass; the rate is taken as constant.
//
// Fills `value`, with an attitude of unit norm, `slope`, the derivative per second, and `curvature`, the
// second derivative of the rotor speeds. The attitude in `sample` gets the sign nearest to the previous one.
// The filter starts settled at its first sample. `rotors`: of the vehicle.
inline void filter_sample(
    const LowPass& design,
    ChainMemory& memory,
    Signals& sample,
    Signals& value,
    Signals& slope,
    PerRotor& curvature,
    std::int64_t rotors
) {
    make_continuous({&sample.attitude, 1}, memory.attitude);
    memory.attitude = sample.attitude;
    const DelayLines delays{memory.delays.data(), channels_of(rotors)};
    if (!memory.started) {
        settle(design, delays, numbers_of(sample));
        memory.started = true;
    }
    PerRotor before;
    for (int rotor = 0; rotor < rotors; ++rotor) {
        before[rotor] = delays.at(1, 1, ROTOR_CHANNEL + rotor);
    }
    low_pass(design, delays, 1, numbers_of(sample), numbers_of(value), numbers_of(slope));
    // s² H(s), as the derivative is s H(s): both factors (1 + z⁻¹) become 2 f (1 − z⁻¹).
    const double gain = 4.0 * (design.rate_hz * design.rate_hz) * design.second.gain;
    for (int rotor = 0; rotor < rotors; ++rotor) {
        const double newest = delays.at(1, 0, ROTOR_CHANNEL + rotor),
                     last = delays.at(1, 1, ROTOR_CHANNEL + rotor);
        curvature[rotor] = gain * (newest - 2.0 * last + before[rotor]);
    }
    scale_to_unit(value.attitude);
}

}  // namespace quadpi
