// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The algebra of the error-state Kalman filter on one estimate: propagate, correct, inject.
//
// After Solà, "Quaternion kinematics for the error-state Kalman filter" (2017), section 5, with blocks of
// three exploited throughout.
#pragma once

#include <algorithm>

#include "quadpi/estimator/filter_state.hpp"

namespace quadpi {

// Motion capture whose stamps are off by more cannot be fused from the buffer [s].
constexpr double DELAY_MAX_S = 0.35;

// Linearise a step about the attitude in its middle; gives the rotation of the step in body axes.
inline Quaternion linearise_step(
    const Estimate& estimate, double dt, const Vector3& rates, const Vector3& force, Transition& transition
) {
    const Vector3 turn = minus(rates, estimate.gyro_bias, dt);
    const auto [f0, f1, f2] = minus(force, estimate.accelerometer_bias, 1.0);
    const Quaternion half_turn = from_rotation_vector({0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2]});
    const Matrix3 rotation = rotation_matrix(product(estimate.attitude, half_turn));
    const Quaternion whole_turn = from_rotation_vector(turn);
    transition.attitude_by_attitude = rotation_matrix(inverse(whole_turn));
    transition.dt = dt;
    for (int axis = 0; axis < 3; ++axis) {
        const auto [r0, r1, r2] = rotation[axis];
        const double a = -dt * r0, b = -dt * r1, c = -dt * r2;
        transition.velocity_by_accelerometer_bias[axis] = {a, b, c};
        transition.velocity_by_attitude[axis] = {b * f2 - c * f1, c * f0 - a * f2, a * f1 - b * f0};
        transition.world_force[axis] = r0 * f0 + r1 * f1 + r2 * f2;
    }
    return whole_turn;
}

// P ← F P in place: position, velocity, attitude in the order in which they feed each other.
inline void transform_rows(ErrorMatrix& covariance, const Transition& transition) {
    const double dt = transition.dt;
    const Matrix3& a = transition.velocity_by_attitude;
    const Matrix3& b = transition.velocity_by_accelerometer_bias;
    const Matrix3& t = transition.attitude_by_attitude;
    ErrorVector* const position = &covariance[POSITION];
    ErrorVector* const velocity = &covariance[VELOCITY];
    ErrorVector* const attitude = &covariance[ATTITUDE];
    const ErrorVector* const gyro_bias = &covariance[GYRO_BIAS];
    const ErrorVector* const accelerometer_bias = &covariance[ACCELEROMETER_BIAS];
    for (int axis = 0; axis < 3; ++axis) {
        for (int column = 0; column < ERROR_STATES; ++column) {
            position[axis][column] += dt * velocity[axis][column];
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        for (int column = 0; column < ERROR_STATES; ++column) {
            velocity[axis][column] +=
                a[axis][0] * attitude[0][column] + a[axis][1] * attitude[1][column] +
                a[axis][2] * attitude[2][column] + b[axis][0] * accelerometer_bias[0][column] +
                b[axis][1] * accelerometer_bias[1][column] + b[axis][2] * accelerometer_bias[2][column];
        }
    }
    for (int column = 0; column < ERROR_STATES; ++column) {
        const double a0 = attitude[0][column], a1 = attitude[1][column], a2 = attitude[2][column];
        for (int axis = 0; axis < 3; ++axis) {
            attitude[axis][column] =
                t[axis][0] * a0 + t[axis][1] * a1 + t[axis][2] * a2 - dt * gyro_bias[axis][column];
        }
    }
}

// P ← P Fᵀ in place, where only the lower triangle is needed.
inline void transform_columns(ErrorMatrix& covariance, const Transition& transition) {
    const double dt = transition.dt;
    const Matrix3& a = transition.velocity_by_attitude;
    const Matrix3& b = transition.velocity_by_accelerometer_bias;
    const Matrix3& t = transition.attitude_by_attitude;
    for (int index = 0; index < ERROR_STATES; ++index) {
        ErrorVector& row = covariance[index];
        for (int axis = 0; axis < 3; ++axis) {
            row[axis] += dt * row[3 + axis];
        }
        if (index < VELOCITY) {
            continue;
        }
        const double a0 = row[6], a1 = row[7], a2 = row[8];
        const double b0 = row[12], b1 = row[13], b2 = row[14];
        for (int axis = 0; axis < 3; ++axis) {
            row[3 + axis] += a[axis][0] * a0 + a[axis][1] * a1 + a[axis][2] * a2 + b[axis][0] * b0 +
                             b[axis][1] * b1 + b[axis][2] * b2;
        }
        if (index < ATTITUDE) {
            continue;
        }
        for (int axis = 0; axis < 3; ++axis) {
            row[6 + axis] = t[axis][0] * a0 + t[axis][1] * a1 + t[axis][2] * a2 - dt * row[9 + axis];
        }
    }
}

// Move the state by `dt` s under a constant measured rate and specific force; fills `transition`.
inline void propagate(
    Estimate& estimate,
    const Noise& noise,
    double dt,
    const Vector3& rates,
    const Vector3& force,
    Transition& transition
) {
    const Quaternion turn = linearise_step(estimate, dt, rates, force, transition);
    for (int axis = 0; axis < 3; ++axis) {
        double acceleration = transition.world_force[axis];
        if (axis == 2) {
            acceleration += noise.gravity;
        }
        estimate.position[axis] += (estimate.velocity[axis] + 0.5 * acceleration * dt) * dt;
        estimate.velocity[axis] += acceleration * dt;
    }
    estimate.attitude = normalised(product(estimate.attitude, turn));

    ErrorMatrix& covariance = estimate.covariance;
    transform_rows(covariance, transition);
    transform_columns(covariance, transition);
    for (int i = 0; i < ERROR_STATES; ++i) {
        for (int j = 0; j < i; ++j) {
            covariance[j][i] = covariance[i][j];
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        covariance[VELOCITY + axis][VELOCITY + axis] += noise.accelerometer * dt;
        covariance[ATTITUDE + axis][ATTITUDE + axis] += noise.gyro * dt;
        covariance[GYRO_BIAS + axis][GYRO_BIAS + axis] += noise.gyro_bias * dt;
        covariance[ACCELEROMETER_BIAS + axis][ACCELEROMETER_BIAS + axis] += noise.accelerometer_bias * dt;
    }
    covariance[DELAY][DELAY] += noise.delay * dt;
}

// Move an estimate to a later instant between two IMU samples, whose signal is taken as linear.
inline void propagate_between(
    Estimate& estimate,
    const Noise& noise,
    const ImuSample& first,
    const ImuSample& second,
    std::int64_t to_ns,
    Transition& transition
) {
    const std::int64_t from_ns = estimate.time_ns;
    const double share = 0.5 * static_cast<double>((from_ns - first.time_ns) + (to_ns - first.time_ns)) /
                         static_cast<double>(second.time_ns - first.time_ns);
    const Vector3 rates = on_line(first.rates, second.rates, share);
    const Vector3 force = on_line(first.specific_force, second.specific_force, share);
    propagate(estimate, noise, 1e-9 * static_cast<double>(to_ns - from_ns), rates, force, transition);
    estimate.time_ns = to_ns;
}

// Multiply a vector by Fᵀ in place.
inline void apply_transposed(const Transition& transition, ErrorVector& vector) {
    const double dt = transition.dt;
    const Matrix3& a = transition.velocity_by_attitude;
    const Matrix3& b = transition.velocity_by_accelerometer_bias;
    const Matrix3& t = transition.attitude_by_attitude;
    const double v0 = vector[3], v1 = vector[4], v2 = vector[5];
    const double a0 = vector[6], a1 = vector[7], a2 = vector[8];
    for (int axis = 0; axis < 3; ++axis) {
        vector[6 + axis] = t[0][axis] * a0 + t[1][axis] * a1 + t[2][axis] * a2 + a[0][axis] * v0 +
                           a[1][axis] * v1 + a[2][axis] * v2;
        vector[12 + axis] += b[0][axis] * v0 + b[1][axis] * v1 + b[2][axis] * v2;
        vector[3 + axis] += dt * vector[axis];
    }
    vector[9] -= dt * a0;
    vector[10] -= dt * a1;
    vector[11] -= dt * a2;
}

// Correct by one scalar: P ← (I − k hᵀ) P (I − k hᵀ)ᵀ + k r kᵀ, Joseph's form.
//
// covariance: of the error state, updated.
// error: error state as estimated from the scalars before, updated.
// scalar: with its Jacobian h, residual and variance r; gains k and innovation are filled.
inline void correct_scalar(ErrorMatrix& covariance, ErrorVector& error, Scalar& scalar) {
    const ErrorVector& by = scalar.jacobian;
    ErrorVector& gain = scalar.gain;
    const double variance = scalar.variance;
    double innovation = scalar.residual, expected = variance;
    ErrorVector projected;
    for (int i = 0; i < ERROR_STATES; ++i) {
        double total = 0.0;
        for (int j = 0; j < ERROR_STATES; ++j) {
            total += covariance[i][j] * by[j];
        }
        projected[i] = total;
        innovation -= by[i] * error[i];
        expected += by[i] * total;
    }
    const double prior = expected - variance;
    for (int i = 0; i < ERROR_STATES; ++i) {
        gain[i] = projected[i] / expected;
    }
    for (int i = 0; i < ERROR_STATES; ++i) {
        error[i] += gain[i] * innovation;
        // Row i of (I − k hᵀ) P hᵀ, which Joseph's form subtracts once more.
        const double remaining = projected[i] - gain[i] * prior;
        for (int j = 0; j <= i; ++j) {
            const double updated = covariance[i][j] - gain[i] * projected[j] - remaining * gain[j] +
                                   gain[i] * variance * gain[j];
            covariance[i][j] = updated;
            covariance[j][i] = updated;
        }
    }
    scalar.innovation = innovation;
    scalar.innovation_variance = expected;
}

// Add an estimated error to the state.
inline void inject(NominalState& state, const ErrorVector& error) {
    for (int axis = 0; axis < 3; ++axis) {
        state.position[axis] += error[POSITION + axis];
        state.velocity[axis] += error[VELOCITY + axis];
        state.gyro_bias[axis] += error[GYRO_BIAS + axis];
        state.accelerometer_bias[axis] += error[ACCELEROMETER_BIAS + axis];
    }
    const Vector3 turn{error[ATTITUDE], error[ATTITUDE + 1], error[ATTITUDE + 2]};
    state.attitude = normalised(product(state.attitude, from_rotation_vector(turn)));
    state.delay = std::min(std::max(state.delay + error[DELAY], -DELAY_MAX_S), DELAY_MAX_S);
}

}  // namespace quadpi
