// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// A controlled quadrotor as a rigid body with first-order motors, by fourth-order Runge-Kutta at 1 kHz; see
// state_records.py.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "quadpi/simulation/controller.hpp"

namespace quadpi {

// Steps of the integration [Hz]: the command is held and the wind is constant over a step.
constexpr int STEP_HZ = 1000;
// Limits beyond which a vehicle does not recover: least cosine of the tilt, that of 102 degrees, nearly
// upside down; largest body rate [rad/s], six times any reference; largest distance [m] from the reference.
constexpr double TILT_COSINE_MIN = -0.2;
constexpr double FLOWN_RATE_MAX_RAD_S = 40.0;
constexpr double POSITION_ERROR_MAX_M = 10.0;

// One logged instant; position and acceleration in the world, velocity and rates in body axes.
struct Logged {
    Vector3 position;
    Quaternion attitude;
    Vector3 velocity;
    Vector3 rates;
    Vector3 acceleration;
    Vector3 angular_acceleration;
    PerRotor rotor_speeds;
    PerRotor rotor_accelerations;
    Wrench wrench;
};

// What acts on a vehicle: the law of the aerodynamics, then the effects, each adding to the wrench.
struct Physics {
    const VehicleNumbers& vehicle;
    std::function<void(State&)> aerodynamics;
    std::vector<std::function<void(State&)>> effects;
};

// The integrator's memory: the state, a state ahead of it and the slopes of four stages.
constexpr std::size_t MOTIONS = 6;
constexpr std::size_t ROTOR_SPEEDS_OF_MOTION = offsetof(IntegratedMotion, rotor_speeds) / sizeof(double);

inline double* numbers_of(IntegratedMotion& motion) { return reinterpret_cast<double*>(&motion); }

// Equations of motion: m (v̇ − g) = R F, I Ω̇ = M − Ω × IΩ, q̇ = ½ q (0, Ω), ω̇ = (ω_c − ω)/τ.
inline void differentiate(
    const IntegratedMotion& motion,
    const PerRotor& command,
    const Vector3& wind,
    const Physics& physics,
    State& state,
    IntegratedMotion& slope
) {
    const VehicleNumbers& vehicle = physics.vehicle;
    const Matrix3 rotation = rotation_matrix(motion.attitude);
    slope.position = motion.velocity;
    state.position = motion.position;
    state.rates = motion.rates;
    state.attitude = motion.attitude;
    state.velocity_air = into_body(rotation, minus(motion.velocity, wind));
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double lag = command[rotor] - motion.rotor_speeds[rotor];
        slope.rotor_speeds[rotor] = lag / vehicle.motor_time_constant;
    }
    state.rotor_speeds = motion.rotor_speeds;
    state.rotor_accelerations = slope.rotor_speeds;
    state.memory = motion.memory;
    state.memory_slope = {};
    physics.aerodynamics(state);
    state.aerodynamics = state.wrench;
    for (const auto& effect : physics.effects) {
        effect(state);
    }
    slope.memory = state.memory_slope;

    const Wrench& wrench = state.wrench;
    for (int world = 0; world < 3; ++world) {
        slope.velocity[world] = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
            slope.velocity[world] += rotation[world][axis] * wrench[axis] / vehicle.mass;
        }
    }
    slope.velocity[2] += vehicle.gravity;
    const Vector3 precession = cross(motion.rates, times(vehicle.inertia, motion.rates));
    const Vector3 moment{wrench[3] - precession[0], wrench[4] - precession[1], wrench[5] - precession[2]};
    slope.rates = times(vehicle.inverse_inertia, moment);
    const auto [p, q, r] = motion.rates;
    const auto [w, x, y, z] = motion.attitude;
    slope.attitude = {
        0.5 * (-x * p - y * q - z * r),
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
    };
}

inline void log_instant(
    const IntegratedMotion& motion, const IntegratedMotion& slope, const State& state, Logged& row
) {
    const Matrix3 rotation = rotation_matrix(motion.attitude);
    row.position = motion.position;
    row.rates = motion.rates;
    row.acceleration = slope.velocity;
    row.angular_acceleration = slope.rates;
    row.velocity = into_body(rotation, motion.velocity);
    row.attitude = motion.attitude;
    row.rotor_speeds = motion.rotor_speeds;
    row.rotor_accelerations = slope.rotor_speeds;
    row.wrench = state.wrench;
}

// Whether the vehicle is upside down, spins, is below the ground, off its reference, or no number.
inline bool is_lost(const IntegratedMotion& motion, const Vector3& position) {
    const Quaternion& q = motion.attitude;
    const double cos_tilt = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
    double spin = 0.0, error = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        const double away = motion.position[axis] - position[axis];
        spin += motion.rates[axis] * motion.rates[axis];
        error += away * away;
    }
    const bool controlled = cos_tilt > TILT_COSINE_MIN &&
                            spin < FLOWN_RATE_MAX_RAD_S * FLOWN_RATE_MAX_RAD_S &&
                            error < POSITION_ERROR_MAX_M * POSITION_ERROR_MAX_M;
    return !controlled || motion.position[2] > 0.0;
}

// Fly until the demand ends, or until the vehicle is out of control or below the ground.
//
// `motions` are MOTIONS: the first is the initial state, and the last one at the end; `log` takes every
// (N - 1) / (L - 1)-th instant of N, from one evaluation of the equations of motion at that instant; `done`
// is the number of steps flown so far, for a thread that watches.
inline void fly(
    const Physics& physics,
    Controls& controls,
    const Demand& demand,
    Records<IntegratedMotion> motions,
    State& state,
    Records<Logged> log,
    volatile std::int64_t& done
) {
    const std::size_t numbers = ROTOR_SPEEDS_OF_MOTION + static_cast<std::size_t>(physics.vehicle.rotors);
    const std::size_t steps = demand.yaw.size, every = (steps - 1) / (log.size - 1);
    constexpr double step = 1.0 / STEP_HZ;
    IntegratedMotion& motion = motions[0];
    double *now = numbers_of(motions[0]), *ahead_of_it = numbers_of(motions[1]);
    const double *first = numbers_of(motions[2]), *second = numbers_of(motions[3]);
    const double *third = numbers_of(motions[4]), *fourth = numbers_of(motions[5]);
    differentiate(motion, controls.command, demand.wind[0], physics, state, motions[2]);
    observe(controls, state);
    for (std::size_t k = 0; k < steps; ++k) {
        control(controls, motion, demand, k);
        const Vector3& wind = demand.wind[k];
        differentiate(motion, controls.command, wind, physics, state, motions[2]);
        observe(controls, state);
        if (k % every == 0) {
            log_instant(motion, motions[2], state, log[k / every]);
        }
        done = static_cast<std::int64_t>(k);
        if (k == steps - 1 || is_lost(motion, demand.position[k])) {
            return;
        }
        for (int stage = 0; stage < 3; ++stage) {
            const double ahead = stage == 2 ? step : 0.5 * step;
            const double* slope = numbers_of(motions[2 + stage]);
            for (std::size_t j = 0; j < numbers; ++j) {
                ahead_of_it[j] = now[j] + ahead * slope[j];
            }
            differentiate(motions[1], controls.command, wind, physics, state, motions[3 + stage]);
        }
        for (std::size_t j = 0; j < numbers; ++j) {
            now[j] += step / 6.0 * (first[j] + 2.0 * second[j] + 2.0 * third[j] + fourth[j]);
        }
        scale_to_unit(motion.attitude);
    }
}

}  // namespace quadpi
