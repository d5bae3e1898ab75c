// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What may be known of a sample beside its signals: density of the air, how sure its state is, and which
// rotor speeds are commands.
#pragma once

#include "quadpi/models/small_matrices.hpp"
#include "quadpi/monitor/preparation.hpp"

namespace quadpi {

// Errors of a state: velocity in body axes [m/s], rotation about the world's axes [rad], rates [rad/s].
constexpr std::size_t STATE_ERRORS = 9;
using StateCovariance = Matrix<STATE_ERRORS, STATE_ERRORS>;

struct Conditions {
    double air_density;  // kg/m³, 0 where only the vehicle file tells
    // Of the state, in what it is less sure of than in the flights of the model; zero where nothing tells.
    StateCovariance covariance;
    std::int64_t commanded;     // bit per rotor whose speed follows from its command, as nothing measured it
    std::int64_t wind_unknown;  // 1 while the wind is still to be told: horizontal forces are not judged
};

// Lower triangular root L of a covariance L Lᵀ (Cholesky); what rounding leaves of no variance is zero.
inline StateCovariance root_of(const StateCovariance& covariance) {
    StateCovariance root{};
    for (std::size_t column = 0; column < STATE_ERRORS; ++column) {
        for (std::size_t row = column; row < STATE_ERRORS; ++row) {
            double left = covariance[row][column];
            for (std::size_t inner = 0; inner < column; ++inner) {
                left -= root[row][inner] * root[column][inner];
            }
            if (row == column) {
                root[row][row] = std::sqrt(std::max(left, 0.0));
            } else if (root[column][column] > 0.0) {
                root[row][column] = left / root[column][column];
            }
        }
    }
    return root;
}

// Input vectors of a sample whose state errs by each column of that root, one way and the other.
using ErringInputs = std::array<std::array<InputVector, 2>, STATE_ERRORS>;

inline ErringInputs erring_inputs(
    const Signals& sample, const StateCovariance& covariance, const VehicleConstants& vehicle
) {
    const StateCovariance root = root_of(covariance);
    ErringInputs inputs;
    for (std::size_t column = 0; column < STATE_ERRORS; ++column) {
        for (std::size_t way = 0; way < 2; ++way) {
            const double sign = way == 0 ? 1.0 : -1.0;
            Vector3 velocity = sample.velocity, turn, rates = sample.rates;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                velocity[axis] += sign * root[axis][column];
                turn[axis] = sign * root[3 + axis][column];
                rates[axis] += sign * root[6 + axis][column];
            }
            const Quaternion attitude = product(from_rotation_vector(turn), sample.attitude);
            fill_inputs(
                relative_to_air(velocity, attitude, sample.wind),
                attitude,
                rates,
                sample.rotor_speeds,
                vehicle,
                inputs[column][way]
            );
        }
    }
    return inputs;
}

// Tell verdicts which speeds are commands and models the density of the air, and fill the inputs that the
// errors of the state give.
//
// filtered, derivatives, erring: of the usable ones of the samples alone.
inline void take_conditions(
    Records<const Conditions> conditions,
    Records<Verdict> verdicts,
    Records<const Signals> filtered,
    const VehicleConstants& vehicle,
    Records<Derivatives> derivatives,
    Records<ErringInputs> erring
) {
    std::size_t used = 0;
    for (std::size_t sample = 0; sample < conditions.size; ++sample) {
        const Conditions& own = conditions[sample];
        verdicts[sample].commanded = own.commanded;
        verdicts[sample].wind_unknown = own.wind_unknown != 0;
        if (!verdicts[sample].usable) {
            continue;
        }
        if (own.air_density > 0.0) {
            derivatives[used].density_excess = own.air_density / vehicle.air_density - 1.0;
        }
        erring[used] = erring_inputs(filtered[used], own.covariance, vehicle);
        ++used;
    }
}

}  // namespace quadpi
