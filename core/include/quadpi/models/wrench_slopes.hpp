// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// How the physical model's wrench, and the accelerations by it, change with the state of the body.
#pragma once

#include "quadpi/models/physical_regressors.hpp"
#include "quadpi/models/small_matrices.hpp"

namespace quadpi {

// Steps of the central differences [m/s] and [rad/s]: their error is below 1e-8 of the derivative.
constexpr double DIFFERENCE = 1e-4;

// A flight as roll-outs need it.
struct RolloutTrack {
    double step;                         // s between samples
    Records<const MotionSample> motion;  // rotor speeds as they act at each sample
    Records<const Quaternion> attitude;  // body to world
    const PhysicalVehicle& vehicle;
    double mass, gravity;              // kg, m/s²
    Matrix3 inertia, inverse_inertia;  // kg m², and its inverse
};

// Rotor speeds halfway between two samples, motion as given (velocity in the world).
inline MotionSample set_motion(
    const MotionSample& left,
    const MotionSample& right,
    const Quaternion& attitude,
    const Vector3& velocity,
    const Vector3& rates
) {
    MotionSample now{};
    now.velocity = into_body(rotation_matrix(attitude), velocity);
    now.rates = rates;
    for (int rotor = 0; rotor < ROTORS_MAX; ++rotor) {
        now.rotor_speeds[rotor] = 0.5 * (left.rotor_speeds[rotor] + right.rotor_speeds[rotor]);
        now.rotor_accelerations[rotor] =
            0.5 * (left.rotor_accelerations[rotor] + right.rotor_accelerations[rotor]);
    }
    return now;
}

// Derivatives of the wrench by velocity and rates in body axes.
inline Matrix<AXES, AXES> wrench_slopes(
    const MotionSample& motion, const PhysicalVehicle& vehicle, const TermValues& parameters
) {
    Matrix<AXES, AXES> slopes{};
    Regressors row;
    for (int by = 0; by < AXES; ++by) {
        for (const double sign : {1.0, -1.0}) {
            MotionSample moved = motion;
            (by < 3 ? moved.velocity[by] : moved.rates[by - 3]) += sign * DIFFERENCE;
            fill_regressors(moved, vehicle, row);
            const Wrench wrench = wrench_of(row, parameters);
            for (int axis = 0; axis < AXES; ++axis) {
                slopes[axis][by] += sign / (2.0 * DIFFERENCE) * wrench[axis];
            }
        }
    }
    return slopes;
}

// Derivatives of the accelerations by anything that changes wrench and state.
//
// motion: of the body.
// rotation: body to world.
// wrench: that acts.
// by_motion: its derivatives by velocity and rates in body axes.
// own: its derivatives where the state stays.
// state: derivatives of the state.
template <std::size_t COLUMNS>
Matrix<AXES, COLUMNS> acceleration_slopes(
    const MotionSample& motion,
    const Matrix3& rotation,
    const RolloutTrack& track,
    const Wrench& wrench,
    const Matrix<AXES, AXES>& by_motion,
    const Matrix<AXES, COLUMNS>& own,
    const Matrix<12, COLUMNS>& state
) {
    const auto turned = rows_of<3>(state, 6), turning = rows_of<3>(state, 9);
    const auto air =
        sum(multiplied(transposed(rotation), rows_of<3>(state, 3)),
            multiplied(cross_matrix(motion.velocity), turned));
    Matrix<AXES, 3> by_velocity, by_rates;
    for (int axis = 0; axis < AXES; ++axis) {
        std::copy_n(by_motion[axis].begin(), 3, by_velocity[axis].begin());
        std::copy_n(by_motion[axis].begin() + 3, 3, by_rates[axis].begin());
    }
    const auto change = sum(sum(own, multiplied(by_velocity, air)), multiplied(by_rates, turning));
    const Vector3 force{wrench[0], wrench[1], wrench[2]};
    const Matrix3 gyroscopic =
        sum(multiplied(cross_matrix(motion.rates), track.inertia),
            cross_matrix(times(track.inertia, motion.rates)),
            -1.0);
    auto pushed =
        multiplied(rotation, sum(rows_of<3>(change, 0), multiplied(cross_matrix(force), turned), -1.0));
    for (auto& row : pushed) {
        for (double& slope : row) {
            slope /= track.mass;
        }
    }
    Matrix<AXES, COLUMNS> slopes;
    set_rows(slopes, 0, pushed);
    set_rows(
        slopes,
        3,
        multiplied(track.inverse_inertia, sum(rows_of<3>(change, 3), multiplied(gyroscopic, turning), -1.0))
    );
    return slopes;
}

}  // namespace quadpi
