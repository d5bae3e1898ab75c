// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Whether a sample lies where the training flights say little; see monitor/alarm.py.
#pragma once

#include "quadpi/monitor/alarm_state.hpp"

namespace quadpi {

// Inputs that leave their range where a vehicle is heavier, however it flies: v_in and these.
constexpr int OMEGA_AVG = 7, MU_V_IN = 18;
constexpr std::int64_t OF_THRUST = 1 << 3 | 1 << OMEGA_AVG | 1 << MU_V_IN;

// Distance of an input outside its range, in widths of the range; negative inside. See models/envelope.py.
inline double distance_outside(double value, double lower, double upper, double width, bool is_cosine) {
    const double distance = std::max(lower - value, value - upper) / width;
    return is_cosine && distance > 0.0 ? 0.5 * (std::sqrt(1.0 + distance) - 1.0) : distance;
}

inline void raise_to(double& evidence, double value) { evidence = std::max(evidence, value); }

// A charge after one more step with or without evidence.
inline double charged(double charge, bool evidence, double step_s, const AlarmLimits& limits) {
    const double change = evidence ? step_s / limits.persistence_s : -step_s / limits.release_s;
    return std::min(1.0, std::max(0.0, charge + change));
}

// The inputs as a sound vehicle would have them under the measured thrust, which goes with the square of the
// rotor speed: a heavier one turns its rotors faster, however it flies. Within its interval the thrust is as
// the inputs say.
inline InputVector inputs_by_load(const InputVector& inputs, double measured, double lower, double upper) {
    InputVector sound = inputs;
    const double predicted = 0.5 * (lower + upper);
    if ((measured < lower || measured > upper) && measured < 0.0 && predicted < 0.0) {
        const double ratio = std::sqrt(measured / predicted);
        sound[OMEGA_AVG] *= ratio;
        sound[MU_V_IN] /= ratio;
    }
    return sound;
}

// Charge alarm and warning of EXTRAPOLATION; returns the inputs beyond their near limit as bits.
//
// An input is as far outside as it is by its reading or by the load, whichever is less: a manoeuvre has both.
inline std::int64_t judge_extrapolation(
    const AlarmLimits& limits,
    AlarmState& state,
    const InputVector& inputs,
    const InputVector& by_load,
    const Wrench& leverages,
    const Wrench& widths,
    double step_s
) {
    AlarmRow& row = state.row;
    double worst = 0.0;
    std::int64_t beyond = 0;
    bool near = false;
    for (int k = 0; k < INPUTS; ++k) {
        const auto outside_by = [&](double value) {
            return distance_outside(value, limits.lower[k], limits.upper[k], limits.scale[k], IS_COSINE[k]);
        };
        const double outside = std::min(outside_by(inputs[k]), outside_by(by_load[k]));
        const double distance = 1.0 + 2.0 * outside;
        if (distance > limits.near_distance[k]) {
            beyond |= std::int64_t{1} << k;
        }
        const double score = distance / limits.distance[k];
        raise_to(worst, score);
        raise_to(row.input_score[k], score);
        raise_to(row.input_excess[k], outside);
    }
    for (int axis = 0; axis < AXES; ++axis) {
        near |= leverages[axis] > limits.near_leverage[axis] || widths[axis] > limits.near_width[axis];
        const double leverage = leverages[axis] / limits.leverage[axis];
        const double width = widths[axis] / limits.width[axis];
        raise_to(worst, leverage);
        raise_to(worst, width);
        raise_to(row.leverage[axis], leverage);
        raise_to(row.width[axis], width);
    }
    raise_to(row.cause_evidence[EXTRAPOLATION], worst);
    state.charge[EXTRAPOLATION] = charged(state.charge[EXTRAPOLATION], worst > 1.0, step_s, limits);
    state.extrapolates = (beyond & ~OF_THRUST) != 0;
    state.thrust_known = widths[FZ] <= limits.width[FZ];
    state.near_charge = charged(state.near_charge, near || beyond != 0, step_s, limits);
    return beyond;
}

}  // namespace quadpi
