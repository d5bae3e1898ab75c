// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The state of the Kalman filter: an estimate, the samples that change it, and all that the filter remembers.
//
// Error state, 16 numbers: position and velocity in the world, attitude as a rotation vector in body axes
// (true = estimated ⊗ exp(error)), gyro bias, accelerometer bias, and the delay of motion capture: what it
// stamps s was true at s less the delay.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "quadpi/rotations.hpp"

namespace quadpi {

constexpr int ERROR_STATES = 16;
// First columns of the error state.
constexpr int POSITION = 0, VELOCITY = 3, ATTITUDE = 6, GYRO_BIAS = 9, ACCELEROMETER_BIAS = 12, DELAY = 15;

using ErrorVector = std::array<double, ERROR_STATES>;
using ErrorMatrix = std::array<ErrorVector, ERROR_STATES>;

// Kinds of measurement.
constexpr std::int64_t POSE = 0, WORLD_VELOCITY = 1, BODY_VELOCITY = 2;

// Measurements that wait for their time; more than motion capture sends while it may be early.
constexpr int HELD = 256;
constexpr int OUTCOMES = 10;

// What became of one sample.
enum Outcome : std::int64_t {
    USED,
    COLLECTED,  // kept: for the initialisation, or until it is time to fuse it
    UNUSABLE,   // a value is not finite or impossible, or an attitude is no rotation
    STAMP_NOT_ADVANCING,
    TOO_LATE,
    TOO_EARLY,
    RESET,     // the IMU paused too long, its clock jumped back or its rate changed: the filter starts again
    REJECTED,  // contradicts the estimate by more than both uncertainties allow
    FROZEN,    // repeats the previous value bit for bit: no new measurement
    STAMP_JUMPED,  // an IMU sample far from the previous one: RESET if the next one agrees with it
};

// How far the estimate can be used.
enum Status : std::int64_t {
    INITIALISING,
    OK,
    DEGRADED,  // not settled, no correction for a while, or corrections are being rejected
    LOST,      // no correction for so long, or a velocity so uncertain, that there is no usable state
};

// One IMU sample as it came, in body axes.
struct ImuSample {
    std::int64_t time_ns;
    Vector3 rates;           // rad/s
    Vector3 specific_force;  // m/s²
};

// One pose or velocity that corrects the estimate: of motion capture, of GPS, of another estimator.
struct Measurement {
    std::int64_t time_ns;
    std::int64_t kind;    // POSE, WORLD_VELOCITY or BODY_VELOCITY
    Vector3 vector;       // position [m] in the world, or velocity over ground [m/s] in the axes of its kind
    Quaternion attitude;  // body to world, of any norm and sign; zeros for a velocity
    // Standard deviations of vector and attitude [rad]; 0 is that of the vehicle, below 0 is not measured.
    std::array<double, 2> deviation;
};

// The numbers that are estimated, without their errors.
struct NominalState {
    Vector3 position;            // m, world
    Vector3 velocity;            // m/s over ground, world
    Quaternion attitude;         // body to world
    Vector3 gyro_bias;           // rad/s
    Vector3 accelerometer_bias;  // m/s²
    double delay;                // s, of motion capture
};

// The state at one instant, with the IMU sample of that instant.
struct Estimate : NominalState, ImuSample {
    ErrorMatrix covariance;  // of the error state

    // Take another state and its covariance; the stamp and the IMU sample stay.
    void take_state(const Estimate& source) {
        static_cast<NominalState&>(*this) = source;
        covariance = source.covariance;
    }
};

// What the filter assumes of the sensors.
struct Noise {
    double gyro;                // density, (rad/s)²/Hz
    double accelerometer;       // density, (m/s²)²/Hz
    double gyro_bias;           // growth of the variance per second
    double accelerometer_bias;  // growth of the variance per second
    double delay;               // growth of the variance per second
    double position;            // variance of a pose, m²
    double attitude;            // variance of a pose, rad²
    double velocity;            // variance of a velocity, (m/s)²
    double delay_prior;     // variance of the delay before anything is known of it, s²; 0: stamps are trusted
    double rates;           // variance of one gyro sample, (rad/s)²
    double specific_force;  // variance of one accelerometer sample, (m/s²)²
    double gravity;         // m/s², along the world's third axis
};

// The blocks of the matrix F that a step of the IMU applies to the error state.
struct Transition {
    double dt;  // s
    Matrix3 velocity_by_attitude;
    Matrix3 velocity_by_accelerometer_bias;
    Matrix3 attitude_by_attitude;
    Vector3 world_force;  // specific force [m/s²] in the world
};

// One scalar component of a measurement, and how it corrected the error state.
struct Scalar {
    ErrorVector jacobian;  // h
    double residual;       // measured less estimated, before the other components
    double variance;       // of the component, with what the linear model leaves out
    ErrorVector gain;      // k
    double innovation;
    double innovation_variance;
};

using Scalars = std::array<Scalar, 6>;

// Variances added to an estimate before a measurement beyond its gate is believed.
struct Widening {
    double position;
    double velocity;
    double attitude;
    double delay;
};

// A measurement as it was fused.
struct Correction {
    std::int64_t time_ns;  // of the estimate that it corrected
    double nis;            // squared innovation in units of its covariance
    Measurement measurement;
    Widening widening;
};

// Of a source of 1 Hz [ns], the slowest that corrects, with its jitter.
constexpr std::int64_t SLOWEST_STEP_NS = 1'100'000'000;

// What is remembered of one source of measurements: poses or velocities.
struct Source {
    std::int64_t arrived_ns;  // stamp of the last measurement that was held
    Measurement last;         // the last one whose value was new
    std::int64_t repeats;     // of that value
    std::int64_t changes;     // of the value, up to where repeating is known to be no habit of this source
    Measurement refused;      // the last one rejected
    std::int64_t refused_since_ns;
    std::int64_t refusals;  // in a row that agree among themselves
    std::int64_t step_ns;   // between the last two measurements, and between the two before
    std::int64_t step_before_ns;

    // Time between its measurements, one that was lost apart; 0 before it is known. What comes more seldom
    // than the slowest source is a measurement by itself, after which the next is not waited for.
    std::int64_t usual_step_ns() const { return std::min({step_ns, step_before_ns, SLOWEST_STEP_NS}); }
};

// All that the filter remembers beside its ring of estimates.
struct Filter {
    Noise noise;
    std::int64_t newest;                                       // place of the newest estimate in the ring
    std::int64_t filled;                                       // places in use
    std::int64_t status;                                       // see Status
    std::array<std::array<std::int64_t, OUTCOMES>, 3> counts;  // of IMU samples, poses and velocities
    std::int64_t accepted_ns;       // stamp of the IMU sample at which a correction was last accepted
    std::int64_t jumped_ns;         // stamp of the previous IMU sample, where that was far from all before it
    std::int64_t rate_span_ns;      // usual time of RATE_SPAN steps of the IMU; 0 where its rate is given
    std::int64_t rate_off_ns;       // for how long nearly all such spans have differed from that
    std::array<Source, 2> sources;  // poses and velocities
    std::array<Measurement, HELD> held;  // a ring of measurements that wait for their time, by stamp
    std::int64_t held_first;
    std::int64_t held_count;
    std::int64_t journalled;  // corrections written to the journal
    Estimate corrected;       // after the last correction, at its instant
    // Room to work.
    Estimate prior;
    Estimate trial;
    Correction correction;
    Transition transition;
    Scalars scalars;
};

// What lies on the line between two vectors, at a share of the way.
inline Vector3 on_line(const Vector3& first, const Vector3& second, double share) {
    Vector3 between;
    for (int axis = 0; axis < 3; ++axis) {
        between[axis] = first[axis] + share * (second[axis] - first[axis]);
    }
    return between;
}

// Give an estimate the IMU sample of its instant, on the line between two samples around it.
inline void interpolate_sample(Estimate& estimate, const ImuSample& first, const ImuSample& second) {
    double share = 0.0;
    if (estimate.time_ns > first.time_ns) {
        share = static_cast<double>(estimate.time_ns - first.time_ns) /
                static_cast<double>(second.time_ns - first.time_ns);
    }
    estimate.rates = on_line(first.rates, second.rates, share);
    estimate.specific_force = on_line(first.specific_force, second.specific_force, share);
}

}  // namespace quadpi
