// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What motion capture measures of an estimate, and how a measurement corrects it.
//
// The delay of motion capture is estimated with the state, after Li and Mourikis, "Online temporal
// calibration for camera-IMU systems" (2014): a delay that is longer by δ lets a pose show where the vehicle
// was δ earlier.
#pragma once

#include <algorithm>
#include <cmath>

#include "quadpi/estimator/propagate.hpp"

namespace quadpi {

// Chi-square quantiles at 0.9999 of the six numbers of a pose and the three of a velocity.
constexpr double POSE_GATE = 27.856;
constexpr double VELOCITY_GATE = 21.108;
// How fast body rates change in flight [rad/s²]: the second-order effect of a wrong delay on an attitude.
constexpr double ANGULAR_ACCELERATION = 20.0;
// How fast accelerations change [m/s³]: its second-order effect on a velocity.
constexpr double JERK = 20.0;
// Weight of the variance of a motion estimate in its significance: three standard deviations count half.
constexpr double SIGNIFICANCE = 9.0;
// Two rejected measurements agree if they are apart by no more than noise and a plausible motion explain: a
// vehicle whose estimate is off by this speed [m/s] and rate [rad/s], or acceleration [m/s²]. Spikes and
// flickering markers are farther apart.
constexpr double AGREE_STDS = 9.0, AGREE_LATEST_S = 0.5;
constexpr double AGREE_SPEED_M_S = 3.0, AGREE_RATE_RAD_S = 3.0, AGREE_FACTOR = 1.5;
constexpr double AGREE_ACCELERATION_M_S2 = 10.0;
// A motion shows if it is beyond this many standard deviations of the measurement's noise.
constexpr double SHOWS_STDS = 4.0;

// Whether a deviation says that its part was measured.
inline bool measured(double deviation) { return deviation >= 0.0; }

// The noise that holds for a measurement: its own where it states it, infinite where there is nothing.
inline Noise noise_of(const Noise& noise, const Measurement& measurement) {
    Noise own = noise;
    const auto [vector, attitude] = measurement.deviation;
    if (vector != 0.0) {
        own.position = own.velocity = vector > 0.0 ? vector * vector : INFINITY;
    }
    if (attitude != 0.0) {
        own.attitude = attitude > 0.0 ? attitude * attitude : INFINITY;
    }
    return own;
}

// Squared innovation beyond which a measurement contradicts the estimate.
inline double gate_of(const Measurement& measurement) {
    const auto [vector, attitude] = measurement.deviation;
    return measurement.kind == POSE && measured(vector) && measured(attitude) ? POSE_GATE : VELOCITY_GATE;
}

// Stamp of the instant at which a measurement was taken, by the delay of an estimate.
inline std::int64_t taken_ns(const Estimate& estimate, const Measurement& measurement) {
    return measurement.time_ns - static_cast<std::int64_t>(std::nearbyint(1e9 * estimate.delay));
}

// Significance of a motion estimate: |v|² / (|v|² + k · variance), near 0 within its own error.
//
// Scales the Jacobian of the delay: a vehicle at rest carries no information on it.
inline double significance(const Vector3& motion, double variance) {
    const double square = square_of(motion);
    return square > 0.0 ? square / (square + SIGNIFICANCE * variance) : 0.0;
}

// Variance that a model linear in the delay leaves out, to second order.
//
// The delay multiplies a motion that is itself uncertain, by `variance`, and that changes with `curvature`.
inline double delay_variance(const ErrorMatrix& covariance, double variance, double curvature) {
    const double delay = covariance[DELAY][DELAY];
    const double curved = delay * curvature;
    return delay * variance + 0.5 * (curved * curved);
}

// Total variance of three error states.
inline double total_variance(const ErrorMatrix& covariance, int first) {
    return covariance[first][first] + covariance[first + 1][first + 1] + covariance[first + 2][first + 2];
}

// Rotation vector [rad] from an attitude to a measured one of any norm and sign, body axes.
inline Vector3 turn_from(const Quaternion& attitude, const Quaternion& measured) {
    return to_rotation_vector(product(inverse(attitude), normalised(measured)));
}

// Acceleration [m/s²] over ground, in the world, of an estimate with its IMU sample.
inline Vector3 world_acceleration(const Estimate& estimate, double gravity) {
    const Vector3 force = minus(estimate.specific_force, estimate.accelerometer_bias);
    Vector3 acceleration = times(rotation_matrix(estimate.attitude), force);
    acceleration[2] += gravity;
    return acceleration;
}

// Fill the residual, Jacobian and variance of three scalars of position and three of attitude.
inline void linearise_pose(
    const Estimate& estimate, const Noise& noise, const Measurement& measurement, double lag, Scalars& scalars
) {
    const ErrorMatrix& covariance = estimate.covariance;
    const Vector3& velocity = estimate.velocity;
    const Vector3 rates = minus(estimate.rates, estimate.gyro_bias);
    const double moving = significance(velocity, total_variance(covariance, VELOCITY));
    const double turning = significance(rates, 3.0 * noise.rates + total_variance(covariance, GYRO_BIAS));
    const Vector3 acceleration = world_acceleration(estimate, noise.gravity);
    const Quaternion turned =
        product(estimate.attitude, from_rotation_vector({lag * rates[0], lag * rates[1], lag * rates[2]}));
    const Vector3 turn = turn_from(turned, measurement.attitude);
    for (int axis = 0; axis < 3; ++axis) {
        Scalar& scalar = scalars[axis];
        scalar.residual = measurement.vector[axis] - estimate.position[axis] - lag * velocity[axis];
        scalar.jacobian[POSITION + axis] = 1.0;
        scalar.jacobian[VELOCITY + axis] = lag;
        scalar.jacobian[DELAY] = -moving * velocity[axis];
        double left_out =
            delay_variance(covariance, covariance[VELOCITY + axis][VELOCITY + axis], acceleration[axis]);
        left_out += covariance[VELOCITY + axis][DELAY] * covariance[VELOCITY + axis][DELAY];
        scalar.variance = noise.position + left_out;
    }
    for (int axis = 0; axis < 3; ++axis) {
        Scalar& scalar = scalars[3 + axis];
        scalar.residual = turn[axis];
        scalar.jacobian[ATTITUDE + axis] = 1.0;
        scalar.jacobian[DELAY] = -turning * rates[axis];
        const double rate_variance = noise.rates + covariance[GYRO_BIAS + axis][GYRO_BIAS + axis];
        scalar.variance = noise.attitude + delay_variance(covariance, rate_variance, ANGULAR_ACCELERATION);
    }
}

// Fill the residual, Jacobian and variance of three scalars of a velocity.
inline void linearise_velocity(
    const Estimate& estimate, const Noise& noise, const Measurement& measurement, double lag, Scalars& scalars
) {
    const ErrorMatrix& covariance = estimate.covariance;
    const Vector3 acceleration = world_acceleration(estimate, noise.gravity);
    double uncertain = 3.0 * noise.specific_force + total_variance(covariance, ACCELEROMETER_BIAS);
    uncertain += noise.gravity * noise.gravity * total_variance(covariance, ATTITUDE);
    for (int axis = 0; axis < 3; ++axis) {
        scalars[axis].variance = noise.velocity + delay_variance(covariance, uncertain / 3.0, JERK);
    }
    if (measurement.kind == WORLD_VELOCITY) {
        const double accelerating = significance(acceleration, uncertain);
        for (int axis = 0; axis < 3; ++axis) {
            Scalar& scalar = scalars[axis];
            scalar.residual = measurement.vector[axis] - estimate.velocity[axis] - lag * acceleration[axis];
            scalar.jacobian[VELOCITY + axis] = 1.0;
            scalar.jacobian[DELAY] = -accelerating * acceleration[axis];
        }
        return;
    }
    const Matrix3 rotation = rotation_matrix(estimate.attitude);
    const Vector3 rates = minus(estimate.rates, estimate.gyro_bias);
    const Vector3 u = into_body(rotation, estimate.velocity);
    const Vector3 a = into_body(rotation, acceleration);
    const Vector3 slope = {
        a[0] - rates[1] * u[2] + rates[2] * u[1],
        a[1] - rates[2] * u[0] + rates[0] * u[2],
        a[2] - rates[0] * u[1] + rates[1] * u[0],
    };
    const double accelerating = significance(slope, uncertain);
    for (int axis = 0; axis < 3; ++axis) {
        Scalar& scalar = scalars[axis];
        scalar.residual = measurement.vector[axis] - u[axis] - lag * slope[axis];
        for (int column = 0; column < 3; ++column) {
            scalar.jacobian[VELOCITY + column] = rotation[column][axis];
        }
        scalar.jacobian[DELAY] = -accelerating * slope[axis];
    }
    // Rᵀ δv + u × δθ, with attitude errors in body axes.
    ErrorVector &x = scalars[0].jacobian, &y = scalars[1].jacobian, &z = scalars[2].jacobian;
    x[ATTITUDE + 1] = -u[2], x[ATTITUDE + 2] = u[1];
    y[ATTITUDE] = u[2], y[ATTITUDE + 2] = -u[0];
    z[ATTITUDE] = -u[1], z[ATTITUDE + 1] = u[0];
}

// Correct an estimate by a pose or a velocity, one scalar at a time.
//
// The measurement was taken earlier than it is stamped, by the delay of this estimate and of no other: use
// this estimate's own delay; a stale one makes the delay state diverge. What lies between the estimate's
// instant and that one, where the measurement precedes a correction already made or follows the newest IMU
// sample, is the estimate's own motion.
//
// estimate: updated; its IMU sample is that of its instant.
// scalars: filled for the smoother.
// Returns the squared innovation in units of its covariance, chi-square of 6 or 3 degrees of freedom.
inline double fuse(Estimate& estimate, const Noise& noise, const Measurement& measurement, Scalars& scalars) {
    for (Scalar& scalar : scalars) {
        scalar.jacobian = {};
    }
    const double lag = 1e-9 * static_cast<double>(taken_ns(estimate, measurement) - estimate.time_ns);
    const int count = measurement.kind == POSE ? 6 : 3;
    const Noise own = noise_of(noise, measurement);
    if (measurement.kind == POSE) {
        linearise_pose(estimate, own, measurement, lag, scalars);
    } else {
        linearise_velocity(estimate, own, measurement, lag, scalars);
    }
    ErrorVector error{};
    double nis = 0.0;
    for (int index = 0; index < count; ++index) {
        Scalar& scalar = scalars[index];
        if (!std::isfinite(scalar.variance)) {
            scalar.gain = {};
            scalar.innovation = 0.0;
            scalar.innovation_variance = INFINITY;
            continue;
        }
        correct_scalar(estimate.covariance, error, scalar);
        nis += scalar.innovation * scalar.innovation / scalar.innovation_variance;
    }
    inject(estimate, error);
    return nis;
}

// The variances that let an estimate follow a measurement beyond its gate.
//
// Motion capture that restarted elsewhere, a step of its delay or a swapped marker all show as residuals of
// position and attitude: each may be the cause, and with room for all of them the filter finds out which.
inline Widening widening_for(const Estimate& estimate, const Noise& noise, const Measurement& measurement) {
    const double speed2 = square_of(estimate.velocity);
    if (measurement.kind != POSE) {
        const double off2 = square_of(minus(measurement.vector, estimate.velocity));
        const bool in_world = measurement.kind == WORLD_VELOCITY;
        return {0.0, in_world ? off2 : std::max(off2, 4.0 * speed2), 0.25, noise.delay_prior};
    }
    const auto [vector, attitude] = measurement.deviation;
    const double turn2 =
        measured(attitude) ? square_of(turn_from(estimate.attitude, measurement.attitude)) : 0.0;
    return {
        measured(vector) ? square_of(minus(measurement.vector, estimate.position)) : 0.0,
        1.0 + speed2 * std::min(turn2, 4.0),
        measured(attitude) ? turn2 + noise.attitude : 0.0,
        noise.delay_prior,
    };
}

// Add variances of position, velocity, attitude and delay to the covariance of an estimate.
inline void widen(Estimate& estimate, const Widening& widening) {
    ErrorMatrix& covariance = estimate.covariance;
    for (int axis = 0; axis < 3; ++axis) {
        covariance[POSITION + axis][POSITION + axis] += widening.position;
        covariance[VELOCITY + axis][VELOCITY + axis] += widening.velocity;
        covariance[ATTITUDE + axis][ATTITUDE + axis] += widening.attitude;
    }
    covariance[DELAY][DELAY] += widening.delay;
}

// Magnitude [rad/s] of the body rates.
inline double turning_speed(const Estimate& estimate) {
    return length_of(minus(estimate.rates, estimate.gyro_bias));
}

// Whether two measurements of one kind can be of one vehicle that moves roughly as estimated.
//
// latest: time [s] between them beyond which nothing is said.
inline bool same_motion(
    const Measurement& first,
    const Measurement& second,
    const Estimate& estimate,
    const Noise& noise,
    double latest = AGREE_LATEST_S
) {
    const double elapsed = 1e-9 * static_cast<double>(second.time_ns - first.time_ns);
    if (elapsed > latest) {
        return false;
    }
    const double apart = length_of(minus(second.vector, first.vector));
    const double rate = turning_speed(estimate), speed = length_of(estimate.velocity);
    if (second.kind != POSE) {
        const double acceleration =
            AGREE_ACCELERATION_M_S2 + length_of(estimate.specific_force) + rate * speed;
        return apart <= AGREE_STDS * std::sqrt(noise.velocity) + acceleration * elapsed;
    }
    const bool turns = measured(first.deviation[1]) && measured(second.deviation[1]);
    const double angle = turns ? length_of(turn_from(normalised(first.attitude), second.attitude)) : 0.0;
    return apart <=
               AGREE_STDS * std::sqrt(noise.position) + (AGREE_SPEED_M_S + AGREE_FACTOR * speed) * elapsed &&
           angle <=
               AGREE_STDS * std::sqrt(noise.attitude) + (AGREE_RATE_RAD_S + AGREE_FACTOR * rate) * elapsed;
}

// Whether the estimate moves in `elapsed` s by more than the noise of a measurement could hide.
inline bool motion_shows(const Estimate& estimate, const Noise& noise, std::int64_t kind, double elapsed) {
    if (kind != POSE) {
        const double acceleration = length_of(world_acceleration(estimate, noise.gravity));
        return elapsed * acceleration > SHOWS_STDS * std::sqrt(noise.velocity);
    }
    return elapsed * length_of(estimate.velocity) > SHOWS_STDS * std::sqrt(noise.position) ||
           elapsed * turning_speed(estimate) > SHOWS_STDS * std::sqrt(noise.attitude);
}

}  // namespace quadpi
