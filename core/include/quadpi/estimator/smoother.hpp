// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Fixed-interval smoother over the model of the filter: every state from the whole flight.
//
// The result is that of Rauch, Tung and Striebel; the form is Bierman's modification of the Bryson-Frazier
// smoother, a recursion of the adjoint state that needs no inverse: G. J. Bierman, "Fixed interval smoothing
// with discrete measurements" (1973). The forward pass repeats the corrections of the causal filter in the
// order of their instants.
#pragma once

#include <algorithm>

#include "quadpi/estimator/corrections.hpp"
#include "quadpi/estimator/filter_run.hpp"
#include "quadpi/records.hpp"

namespace quadpi {

// What happened in a forward pass.
enum Event : std::int64_t {
    STEP,               // of the IMU
    SCALAR_CORRECTION,  // by one component of a measurement
    ESTIMATE_HERE,      // at an IMU stamp
};

// How much of a tape is in use.
struct Length {
    std::int64_t events;
    std::int64_t steps;
    std::int64_t scalars;
    std::int64_t estimates;
};

// What the forward pass runs over.
struct SmootherInputs {
    Records<ImuSample> imu;       // that the filter used
    Records<Correction> journal;  // by their instants
    const Noise& noise;
};

// A forward pass over a chunk, for the backward pass. One without room for events is not recorded.
struct Tape {
    Length& length;
    Records<std::int64_t>
        events;  // what happened, in order; the details are in the next arrays' order of each kind
    Records<Transition> steps;
    Records<Scalar> scalars;
    Records<Estimate> estimates;

    bool is_recorded() const { return events.size > 0; }
    void note(Event event) { events[length.events++] = event; }
};

// Propagate an estimate between two IMU samples.
inline void advance(
    const SmootherInputs& inputs,
    Estimate& estimate,
    const ImuSample& before,
    const ImuSample& after,
    std::int64_t to_ns,
    Tape& tape
) {
    if (to_ns > estimate.time_ns) {
        propagate_between(estimate, inputs.noise, before, after, to_ns, tape.steps[tape.length.steps]);
        if (tape.is_recorded()) {
            ++tape.length.steps;
            tape.note(STEP);
        }
    }
}

// Apply a correction as the filter did, at the filter's instant.
inline void correct(
    const SmootherInputs& inputs, Estimate& estimate, const Correction& correction, Tape& tape
) {
    Scalars scalars;
    widen(estimate, correction.widening);
    fuse(estimate, inputs.noise, correction.measurement, scalars);
    if (tape.is_recorded()) {
        const int count = correction.measurement.kind == POSE ? 6 : 3;
        for (int index = 0; index < count; ++index) {
            tape.scalars[tape.length.scalars++] = scalars[index];
            tape.note(SCALAR_CORRECTION);
        }
    }
}

// Filter up to IMU sample `last - 1`, the corrections in the order of their instants.
//
// estimate: at IMU sample `first - 1`, or where the segment begins; updated.
// first: IMU sample that comes next.
// applied: corrections applied before this pass.
// tape: filled, if it has room.
// Returns corrections applied after this pass.
inline std::int64_t forward(
    const SmootherInputs& inputs,
    Estimate& estimate,
    std::int64_t first,
    std::int64_t last,
    std::int64_t applied,
    Tape& tape
) {
    tape.length = {};
    for (std::int64_t index = first; index < last; ++index) {
        const ImuSample& before = inputs.imu[std::max<std::int64_t>(index - 1, 0)];
        const ImuSample& after = inputs.imu[index];
        while (applied < static_cast<std::int64_t>(inputs.journal.size) &&
               inputs.journal[applied].time_ns <= after.time_ns) {
            const Correction& correction = inputs.journal[applied];
            advance(inputs, estimate, before, after, correction.time_ns, tape);
            interpolate_sample(estimate, before, after);
            correct(inputs, estimate, correction, tape);
            ++applied;
        }
        advance(inputs, estimate, before, after, after.time_ns, tape);
        if (tape.is_recorded()) {
            tape.estimates[tape.length.estimates++] = estimate;
            tape.note(ESTIMATE_HERE);
        }
    }
    return applied;
}

// λ ← Fᵀ λ and Λ ← Fᵀ Λ F.
inline void step_back(const Transition& transition, ErrorVector& adjoint, ErrorMatrix& information) {
    apply_transposed(transition, adjoint);
    for (ErrorVector& row : information) {
        apply_transposed(transition, row);
    }
    for (int column = 0; column < ERROR_STATES; ++column) {
        for (int other = 0; other < column; ++other) {
            std::swap(information[other][column], information[column][other]);
        }
    }
    for (ErrorVector& row : information) {
        apply_transposed(transition, row);
    }
}

// λ ← (I − k hᵀ)ᵀ λ − h y/s and Λ ← (I − k hᵀ)ᵀ Λ (I − k hᵀ) + h hᵀ/s.
inline void scalar_back(const Scalar& scalar, ErrorVector& adjoint, ErrorMatrix& information) {
    const ErrorVector &by = scalar.jacobian, &gain = scalar.gain;
    ErrorVector turned;
    double along = scalar.innovation / scalar.innovation_variance;
    double inner = 1.0 / scalar.innovation_variance;
    for (int i = 0; i < ERROR_STATES; ++i) {
        double total = 0.0;
        for (int j = 0; j < ERROR_STATES; ++j) {
            total += information[i][j] * gain[j];
        }
        turned[i] = total;
        along += gain[i] * adjoint[i];
        inner += gain[i] * total;
    }
    for (int i = 0; i < ERROR_STATES; ++i) {
        adjoint[i] -= by[i] * along;
        for (int j = 0; j < ERROR_STATES; ++j) {
            information[i][j] += by[i] * by[j] * inner - by[i] * turned[j] - turned[i] * by[j];
        }
    }
}

// X ← x − P λ, of variance P − P Λ P.
inline void smooth_estimate(
    Estimate& estimate, const ErrorVector& adjoint, const ErrorMatrix& information, EstimatedSample& smoothed
) {
    const ErrorMatrix& covariance = estimate.covariance;
    ErrorVector error;
    for (int i = 0; i < ERROR_STATES; ++i) {
        double total = 0.0, reduction = 0.0;
        for (int j = 0; j < ERROR_STATES; ++j) {
            total -= covariance[i][j] * adjoint[j];
            double inner = 0.0;
            for (int k = 0; k < ERROR_STATES; ++k) {
                inner += information[j][k] * covariance[k][i];
            }
            reduction += covariance[i][j] * inner;
        }
        error[i] = total;
        smoothed.variance[i] = std::max(covariance[i][i] - reduction, 0.0);
    }
    inject(estimate, error);
    static_cast<NominalState&>(smoothed) = estimate;
}

// Run the adjoint state and its information back over a tape; smooth its estimates.
inline void backward(
    Tape& tape, ErrorVector& adjoint, ErrorMatrix& information, Records<EstimatedSample> smoothed
) {
    Length& length = tape.length;
    while (length.events > 0) {
        switch (tape.events[--length.events]) {
            case STEP:
                step_back(tape.steps[--length.steps], adjoint, information);
                break;
            case SCALAR_CORRECTION:
                scalar_back(tape.scalars[--length.scalars], adjoint, information);
                break;
            default:
                --length.estimates;
                smooth_estimate(
                    tape.estimates[length.estimates], adjoint, information, smoothed[length.estimates]
                );
        }
    }
}

// The motion over each step: velocity [m/s] and specific force [m/s²] in the world, body rates [rad/s].
struct StepMotion {
    Vector3 velocity;
    Vector3 rates;
    Vector3 pushed;
};

// Smallest variance of the delay [s²], of stamps that are trusted, and of a velocity [m²/s²] by poses.
struct PoseLimits {
    double delay_variance;
    double velocity_variance;
};

// Information that the poses of each step give of each position [1/m²] and attitude [1/rad²].
//
// As in the filter: an uncertain delay widens a pose, and motion well above its own noise observes it.
// poses: in a step.
inline void pose_information(
    Records<StepMotion> steps,
    const Noise& noise,
    const PoseLimits& limits,
    double poses,
    Records<std::array<double, 2>> found
) {
    double delay = std::max(noise.delay_prior, limits.delay_variance);
    for (std::size_t step = 0; step < steps.size; ++step) {
        const auto& [velocity, rates, pushed] = steps[step];
        const double turned = delay * ANGULAR_ACCELERATION;
        const double position = poses / (noise.position + 0.5 * (delay * delay) * square_of(pushed) / 3.0);
        const double attitude = poses / (noise.attitude + 0.5 * (turned * turned));
        found[step] = {position, attitude};
        const double moving = significance(velocity, 3.0 * limits.velocity_variance);
        const double turning = significance(rates, 3.0 * noise.rates);
        delay = 1.0 / (1.0 / delay + position * (moving * moving * square_of(velocity)) +
                       attitude * (turning * turning * square_of(rates)));
    }
}

}  // namespace quadpi
