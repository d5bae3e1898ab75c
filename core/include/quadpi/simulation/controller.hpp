// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Position and yaw controller: geometric, with incremental inversion; sources in controller.py.
#pragma once

#include <algorithm>

#include "quadpi/records.hpp"
#include "quadpi/simulation/state.hpp"

namespace quadpi {

// Gains of position [1/s²] and velocity [1/s] (damped at 0.9, settled in two seconds), of attitude [1/s] and
// of body rates [1/s], each faster than the one before. A test makes a bundled bag again byte for byte.
constexpr double POSITION_GAIN = 5.0, VELOCITY_GAIN = 4.0;
constexpr double TILT_GAIN = 8.0, YAW_GAIN = 3.0;
constexpr double RATE_GAIN = 18.0, YAW_RATE_GAIN = 6.0;
// The command leads the wanted rotor speed by this factor, to compensate the lag of a first-order motor.
constexpr double MOTOR_LEAD = 2.0;
// Largest tilt of a path [degrees]: a position error must not turn the vehicle over; excitation adds to it.
constexpr double TILT_MAX_DEG = 65.0;
// Least upward specific force demanded [m/s²]: near zero the attitude of the thrust is undefined.
constexpr double SPECIFIC_FORCE_MIN = 2.0;
inline const double TAN_TILT_MAX = sine(TILT_MAX_DEG * (PI / 180.0)) / cosine(TILT_MAX_DEG * (PI / 180.0));
// Least cosine between the nose and its heading that a yaw rate is divided by.
constexpr double SIDE_MIN = 0.3;

// Squares of the rotor speeds from thrust and moments, and the other way round.
using Allocation = std::array<std::array<double, 4>, ROTORS_MAX>;
using Effectiveness = std::array<PerRotor, 4>;

// The integrated state, or its derivative; position and velocity in the world.
struct IntegratedMotion {
    Vector3 position;
    Vector3 velocity;
    Quaternion attitude;
    Vector3 rates;
    OwnState memory;        // of an effect that has a state of its own
    PerRotor rotor_speeds;  // the last: numbers beyond the vehicle's rotors are not integrated
};

// The reference, its jerk [m/s³], and the wind [m/s] in the world, at every step.
struct Demand {
    Records<const Vector3> position, velocity, acceleration, jerk;
    Records<const double> yaw, yaw_rate;
    Records<const std::array<double, 2>> tilt;
    Records<const double> thrust;
    Records<const Vector3> wind;
};

// Parameters of the nominal vehicle, and memory of the controller.
struct Controls {
    const VehicleNumbers& nominal;
    const Allocation& allocation;  // the inverse of the next, of four rotors; of others the pseudo-inverse
    const Effectiveness& effectiveness;
    Wrench& disturbance;  // wrench of the last instant less that of the rotors in hover
    PerRotor& command;    // commanded rotor speeds
};

// Update the disturbance: the wrench less that of rotors in hover at the present rotor speeds.
//
// The torque of rotors that speed up ends with the command that caused it: as a disturbance, the next
// command would answer it, and the rotors would change their speed to and fro at every step.
inline void observe(Controls& controls, const State& state) {
    Wrench& disturbance = controls.disturbance;
    disturbance = state.wrench;
    for (int rotor = 0; rotor < controls.nominal.rotors; ++rotor) {
        const double square = state.rotor_speeds[rotor] * state.rotor_speeds[rotor];
        disturbance[2] += controls.effectiveness[0][rotor] * square;
        for (int axis = 0; axis < 3; ++axis) {
            disturbance[3 + axis] -= controls.effectiveness[1 + axis][rotor] * square;
        }
        const double spin_up = controls.nominal.rotor_spins[rotor] * state.rotor_accelerations[rotor];
        disturbance[5] += controls.nominal.rotor_inertia * spin_up;
    }
}

// Rotation whose -z points along a specific force, nose near the yaw, then tilted.
inline Matrix3 attitude_of(const Vector3& force, double yaw, const std::array<double, 2>& tilt) {
    double size = length_of(force);
    const double z0 = -force[0] / size, z1 = -force[1] / size, z2 = -force[2] / size;
    const auto [east, north] = sine_and_cosine(yaw);
    // x = side × z in the vertical plane of the heading, y = z × x.
    double x0 = north * z2, x1 = east * z2, x2 = -east * z1 - north * z0;
    size = std::sqrt(x0 * x0 + x1 * x1 + x2 * x2);
    x0 /= size, x1 /= size, x2 /= size;
    const Matrix3 target{{
        {x0, z1 * x2 - z2 * x1, z0},
        {x1, z2 * x0 - z0 * x2, z1},
        {x2, z0 * x1 - z1 * x0, z2},
    }};
    if (tilt[0] == 0.0 && tilt[1] == 0.0) {
        return target;
    }
    const auto [sin_roll, cos_roll] = sine_and_cosine(tilt[0]);
    const auto [sin_pitch, cos_pitch] = sine_and_cosine(tilt[1]);
    Matrix3 tilted;
    for (int axis = 0; axis < 3; ++axis) {
        const auto [x, y, z] = target[axis];
        const double pitched_z = sin_pitch * x + cos_pitch * z;
        tilted[axis] = {
            cos_pitch * x - sin_pitch * z,
            cos_roll * y + sin_roll * pitched_z,
            cos_roll * pitched_z - sin_roll * y,
        };
    }
    return tilted;
}

// Command rotor speeds for thrust and moments; where they saturate, yaw gives way first, then thrust.
inline void allocate(
    Controls& controls, const PerRotor& rotor_speeds, double thrust, const Vector3& moments
) {
    const double fastest = controls.nominal.rotor_speed_max;
    const double largest = fastest * fastest;
    const auto rotors = controls.nominal.rotors;
    PerRotor lift{}, turn{};
    for (int rotor = 0; rotor < rotors; ++rotor) {
        const auto& row = controls.allocation[rotor];
        lift[rotor] = row[0] * thrust + row[1] * moments[0] + row[2] * moments[1];
        turn[rotor] = row[3] * moments[2];
    }
    const double excess = *std::max_element(lift.begin(), lift.begin() + rotors) - largest;
    if (excess > 0.0) {
        const double lowered =
            std::min(excess, std::max(*std::min_element(lift.begin(), lift.begin() + rotors), 0.0));
        for (double& one : lift) {
            one -= lowered;
        }
    }
    double share = 1.0;
    for (int rotor = 0; rotor < rotors; ++rotor) {
        if (turn[rotor] != 0.0) {
            const double bound = turn[rotor] > 0.0 ? largest : 0.0;
            share = std::min(share, std::max(0.0, (bound - lift[rotor]) / turn[rotor]));
        }
    }
    for (int rotor = 0; rotor < rotors; ++rotor) {
        const double square = lift[rotor] + share * turn[rotor];
        const double wanted = std::sqrt(std::min(std::max(square, 0.0), largest));
        const double led = rotor_speeds[rotor] + MOTOR_LEAD * (wanted - rotor_speeds[rotor]);
        controls.command[rotor] = std::min(std::max(led, 0.0), fastest);
    }
}

// Specific force of the rotors in the world: the demand less the disturbance, within the limit of its tilt.
inline Vector3 demanded_force(
    const Controls& controls,
    const IntegratedMotion& motion,
    const Matrix3& rotation,
    const Demand& demand,
    std::size_t step
) {
    const VehicleNumbers& vehicle = controls.nominal;
    Vector3 force;
    for (int axis = 0; axis < 3; ++axis) {
        force[axis] = demand.acceleration[step][axis] +
                      VELOCITY_GAIN * (demand.velocity[step][axis] - motion.velocity[axis]) +
                      POSITION_GAIN * (demand.position[step][axis] - motion.position[axis]);
        for (int body = 0; body < 3; ++body) {
            force[axis] -= rotation[axis][body] * controls.disturbance[body] / vehicle.mass;
        }
    }
    force[2] -= vehicle.gravity;
    // Upward thrust has a tilt limit and never vanishes: the attitude would be undefined.
    const double horizontal = std::sqrt(force[0] * force[0] + force[1] * force[1]);
    force[2] = std::min(force[2], -SPECIFIC_FORCE_MIN);
    const double limit = -force[2] * TAN_TILT_MAX;
    if (horizontal > limit) {
        force[0] *= limit / horizontal;
        force[1] *= limit / horizontal;
    }
    return force;
}

// Set the commanded rotor speeds for one step.
inline void control(
    Controls& controls, const IntegratedMotion& motion, const Demand& demand, std::size_t step
) {
    const VehicleNumbers& vehicle = controls.nominal;
    const Matrix3 rotation = rotation_matrix(motion.attitude);
    const Vector3 force = demanded_force(controls, motion, rotation, demand, step);
    const Matrix3 target = attitude_of(force, demand.yaw[step], demand.tilt[step]);
    double along = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        along -= force[axis] * rotation[axis][2];
    }
    const double specific_thrust =
        std::max(along, SPECIFIC_FORCE_MIN) + demand.thrust[step] * vehicle.gravity;

    // Rates of the target: from jerk (differential flatness) and the turn of the nose.
    Vector3 rates{};
    for (int axis = 0; axis < 3; ++axis) {
        rates[0] += demand.jerk[step][axis] * rotation[axis][1] / specific_thrust;
        rates[1] -= demand.jerk[step][axis] * rotation[axis][0] / specific_thrust;
    }
    // The nose stays in the vertical plane of the heading while the vehicle tilts.
    const auto [east, north] = sine_and_cosine(demand.yaw[step]);
    const double ahead = rotation[0][0] * north + rotation[1][0] * east;
    const double side = rotation[1][1] * north - rotation[0][1] * east;
    const double tilted_side = rotation[1][2] * north - rotation[0][2] * east;
    rates[2] = (demand.yaw_rate[step] * ahead + rates[1] * tilted_side) / std::max(side, SIDE_MIN);
    // Twice the attitude error: the vector of R_targetᵀ R − Rᵀ R_target, in body axes.
    Vector3 error{};
    for (int axis = 0; axis < 3; ++axis) {
        error[0] += rotation[axis][1] * target[axis][2] - rotation[axis][2] * target[axis][1];
        error[1] += rotation[axis][2] * target[axis][0] - rotation[axis][0] * target[axis][2];
        error[2] += rotation[axis][0] * target[axis][1] - rotation[axis][1] * target[axis][0];
    }
    Vector3 turn;
    for (int axis = 0; axis < 3; ++axis) {
        const double attitude_gain = axis < 2 ? TILT_GAIN : YAW_GAIN;
        const double rate_gain = axis < 2 ? RATE_GAIN : YAW_RATE_GAIN;
        const double wanted = rates[axis] - 0.5 * attitude_gain * error[axis];
        turn[axis] = rate_gain * (wanted - motion.rates[axis]);
    }
    const Vector3 precession = cross(motion.rates, times(vehicle.inertia, motion.rates));
    const Vector3 torque = times(vehicle.inertia, turn);
    Vector3 moments;
    for (int axis = 0; axis < 3; ++axis) {
        moments[axis] = torque[axis] + precession[axis] - controls.disturbance[3 + axis];
    }
    allocate(controls, motion.rotor_speeds, vehicle.mass * specific_thrust, moments);
}

}  // namespace quadpi
