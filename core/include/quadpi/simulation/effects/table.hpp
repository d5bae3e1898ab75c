// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The library's effects on the wrench by their names, and those with a state of their own along a record.
//
// The file of an effect in quadpi_core/simulation/effects declares it and states the same law over blocks of
// instants, as people read and export it; a test compares the two.
#pragma once

#include <string_view>

#include "quadpi/records.hpp"
#include "quadpi/simulation/effects/airframe.hpp"
#include "quadpi/simulation/effects/rotors.hpp"

namespace quadpi {

// Wrench that an effect adds; one with a state of its own fills its slope.
using EffectFunction = Wrench (*)(State&, const VehicleNumbers&, const double* parameters);

struct WrenchEffect {
    std::string_view name;
    std::size_t parameters;
    EffectFunction function;
};

constexpr WrenchEffect WRENCH_EFFECTS[] = {
    {"body_drag", 3, effects::body_drag},
    {"cubic_drag", 1, effects::cubic_drag},
    {"rate_damping", 3, effects::rate_damping},
    {"tether", 6, effects::tether},
    {"force_bias", 3, effects::force_bias},
    {"moment_bias", 3, effects::moment_bias},
    {"cg_offset", 3, effects::cg_offset},
    {"ground_effect", 1, effects::ground_effect},
    {"ceiling_effect", 2, effects::ceiling_effect},
    {"rotor_drag", 1, effects::rotor_drag},
    {"cross_flow", 1, effects::cross_flow},
    {"blade_flapping", 1, effects::blade_flapping},
    {"translational_lift", 1, effects::translational_lift},
    {"inflow_damping", 1, effects::inflow_damping},
    {"rotor_dissymmetry", 1, effects::rotor_dissymmetry},
    {"vortex_ring", 1, effects::vortex_ring},
    {"rotor_interaction", 1, effects::rotor_interaction},
    {"gyroscopic", 1, effects::gyroscopic},
    {"spin_up", 1, effects::spin_up},
    {"thrust_coefficient", 1, effects::thrust_coefficient},
    {"rotor_thrusts", 4, effects::rotor_thrusts},
    {"weak_rotor", 3, effects::weak_rotor},
    {"rotor_tilt", 3, effects::rotor_tilt},
    {"slung_load", 4, effects::slung_load},
};

// The effect of a name; null for none.
inline const WrenchEffect* find_effect(std::string_view name) {
    for (const WrenchEffect& effect : WRENCH_EFFECTS) {
        if (effect.name == name) {
            return &effect;
        }
    }
    return nullptr;
}

// Largest change of a number of an effect's own state over a step of a recording: 125 rad/s² of a load at
// 62.5 Hz, which one on a cable of 0.1 m does not reach.
constexpr double OWN_STATE_CHANGE_MAX = 2.0;

// A change over one step; what is faster than the steps stays finite.
inline double limited_change(double change) {
    return std::min(std::max(change, -OWN_STATE_CHANGE_MAX), OWN_STATE_CHANGE_MAX);
}

// Wrench of an effect with a state of its own, which Heun's method brings forward by a step [s].
inline Wrench stepped(
    EffectFunction effect,
    State& now,
    State& ahead,
    const VehicleNumbers& vehicle,
    const double* parameters,
    double step_s
) {
    const Wrench wrench = effect(now, vehicle, parameters);
    for (int number = 0; number < MEMORY; ++number) {
        ahead.memory[number] = now.memory[number] + limited_change(step_s * now.memory_slope[number]);
    }
    effect(ahead, vehicle, parameters);
    for (int number = 0; number < MEMORY; ++number) {
        const double slope = 0.5 * (now.memory_slope[number] + ahead.memory_slope[number]);
        ahead.memory[number] = now.memory[number] + limited_change(step_s * slope);
    }
    return wrench;
}

// Fill the own state of an effect along a flight, from that of its first instant on.
inline void remember(
    EffectFunction effect,
    Records<State> states,
    const VehicleNumbers& vehicle,
    const double* parameters,
    double step_s
) {
    for (std::size_t i = 0; i + 1 < states.size; ++i) {
        stepped(effect, states[i], states[i + 1], vehicle, parameters, step_s);
    }
}

// Wrenches along a flight, with the effect's own state from each of K starts on.
//
// `memory` begins with the starts, and is used up; `added` has for each of N instants six rows of K numbers.
inline void remembered_wrenches(
    EffectFunction effect,
    Records<const State> states,
    const VehicleNumbers& vehicle,
    const double* parameters,
    Records<OwnState> memory,
    double step_s,
    double* added
) {
    for (std::size_t i = 0; i < states.size; ++i) {
        State now = states[i], ahead = states[std::min(i + 1, states.size - 1)];
        for (std::size_t start = 0; start < memory.size; ++start) {
            now.memory = memory[start];
            const Wrench wrench = stepped(effect, now, ahead, vehicle, parameters, step_s);
            memory[start] = ahead.memory;
            for (int axis = 0; axis < AXES; ++axis) {
                added[(i * AXES + axis) * memory.size + start] = wrench[axis];
            }
        }
    }
}

}  // namespace quadpi
