// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Covariance of the errors of roll-outs, by the physics; see models/tubes.py.
#pragma once

#include "quadpi/models/physical_rollout.hpp"

namespace quadpi {

// Errors of the state, then those of the wrench.
constexpr std::size_t JOINT = rollout::STATES + AXES;
using JointMatrix = Matrix<JOINT, JOINT>;
using RolloutCovariance = Matrix<rollout::STATES, rollout::STATES>;
// Below this variance of an angle [rad²] its sine varies as the angle does.
constexpr double SMALL_VARIANCE = 1e-6;

// What is not known when a roll-out starts; every number a variance but for the decay.
struct Uncertainty {
    const StateError& state;                 // of a state, at the start and at the horizon
    const Wrench& wrench;                    // of the disturbance at the start
    const Wrench& drive;                     // of what is new in the disturbance after a step
    const Wrench& decay;                     // share of the disturbance that is left after a step
    const Matrix<TERMS, TERMS>& parameters;  // covariance of the parameters
};

// Deviation of the sine of a normal angle of a variance [rad²] over that of the angle.
inline double sine_share(double variance) {
    return variance < SMALL_VARIANCE ? 1.0
                                     : std::sqrt(-0.5 * exponential_minus_1(-2.0 * variance) / variance);
}

// The uncertainty of one roll-out as it goes along its path.
class ErrorSpread {
public:
    ErrorSpread(const RolloutTrack& track, const TermValues& parameters, const Uncertainty& uncertainty)
        : track(track), parameters(parameters), uncertainty(uncertainty) {
        for (std::size_t i = 0; i < JOINT; ++i) {
            joint[i][i] =
                i < rollout::STATES ? uncertainty.state[i] : uncertainty.wrench[i - rollout::STATES];
        }
    }

    // Go on by a step.
    //
    // place: of the body on its path.
    // measured: sample of the flight.
    void step(const Moving& place, const MotionSample& measured) {
        const double h = track.step;
        const MotionSample now = set_motion(measured, measured, place.attitude, place.velocity, place.rates);
        fill_regressors(now, track.vehicle, row);
        const JointMatrix change = change_of(now, place);
        const JointMatrix twice = multiplied(change, change);
        JointMatrix transition;
        for (std::size_t i = 0; i < JOINT; ++i) {
            for (std::size_t j = 0; j < JOINT; ++j) {
                transition[i][j] = (i == j ? 1.0 : 0.0) + h * change[i][j] + 0.5 * h * h * twice[i][j];
            }
        }
        for (std::size_t axis = 0; axis < AXES; ++axis) {
            transition[rollout::STATES + axis][rollout::STATES + axis] = uncertainty.decay[axis];
        }
        joint = multiplied(multiplied(transition, joint), transposed(transition));
        for (std::size_t axis = 0; axis < AXES; ++axis) {
            joint[rollout::STATES + axis][rollout::STATES + axis] += uncertainty.drive[axis];
        }
        turn_sensitivity(change, transition);
    }

    // Of the errors now, with that of a measured state.
    RolloutCovariance covariance() const {
        RolloutCovariance found =
            multiplied(multiplied(sensitivity, uncertainty.parameters), transposed(sensitivity));
        for (std::size_t i = 0; i < rollout::STATES; ++i) {
            for (std::size_t j = 0; j < rollout::STATES; ++j) {
                found[i][j] = joint[i][j] + found[i][j] + (i == j ? uncertainty.state[i] : 0.0);
            }
        }
        return found;
    }

private:
    const RolloutTrack& track;
    const TermValues& parameters;
    const Uncertainty& uncertainty;
    JointMatrix joint{};
    Sensitivity sensitivity{};  // of the state by the parameters
    Regressors row{};

    // Rate of change of all errors by all errors, but for the decay of the wrench.
    JointMatrix change_of(const MotionSample& now, const Moving& place) const {
        Matrix<AXES, JOINT> by_wrench{};
        Matrix<rollout::STATES, JOINT> by_state{};
        for (std::size_t axis = 0; axis < AXES; ++axis) {
            by_wrench[axis][rollout::STATES + axis] = 1.0;
        }
        for (std::size_t i = 0; i < rollout::STATES; ++i) {
            by_state[i][i] = 1.0;
        }
        const Matrix<AXES, JOINT> accelerations = acceleration_slopes(
            now,
            rotation_matrix(place.attitude),
            track,
            wrench_of(row, parameters),
            wrench_slopes(now, track.vehicle, parameters),
            by_wrench,
            by_state
        );
        const Matrix3 turning = cross_matrix(place.rates);
        const double variance = joint[6][6] + joint[7][7] + joint[8][8];
        const double share = sine_share(variance / 3.0);
        JointMatrix change{};
        for (int axis = 0; axis < 3; ++axis) {
            change[rollout::POSITION + axis][rollout::VELOCITY + axis] = 1.0;
            change[rollout::ATTITUDE + axis][rollout::RATES + axis] = 1.0;
            change[rollout::VELOCITY + axis] = accelerations[axis];
            change[rollout::RATES + axis] = accelerations[3 + axis];
            for (int by = 0; by < 3; ++by) {
                change[rollout::ATTITUDE + axis][rollout::ATTITUDE + by] = -turning[axis][by];
                change[rollout::VELOCITY + axis][rollout::ATTITUDE + by] *= share;
                change[rollout::RATES + axis][rollout::ATTITUDE + by] *= share;
            }
        }
        return change;
    }

    void turn_sensitivity(const JointMatrix& change, const JointMatrix& transition) {
        RolloutCovariance of_state;
        Matrix<rollout::STATES, AXES> of_wrench;
        for (std::size_t i = 0; i < rollout::STATES; ++i) {
            std::copy_n(transition[i].begin(), rollout::STATES, of_state[i].begin());
            std::copy_n(change[i].begin() + rollout::STATES, AXES, of_wrench[i].begin());
        }
        Matrix<AXES, TERMS> own;
        for (std::size_t term = 0; term < TERMS; ++term) {
            for (int axis = 0; axis < AXES; ++axis) {
                own[axis][term] = terms_of(row)[term][axis];
            }
        }
        sensitivity = sum(multiplied(of_state, sensitivity), multiplied(of_wrench, own), track.step);
    }
};

// Covariance (W, H) of the errors of W roll-outs at H horizons, by the path (W, S + 1) that they took.
inline void error_covariance(
    const RolloutTrack& track,
    const RollOuts& wanted,
    Records<const Moving> path,
    const TermValues& parameters,
    const Uncertainty& uncertainty,
    Records<RolloutCovariance> covariance
) {
    const std::size_t steps = wanted.last(), count = wanted.horizons.size;
    for (std::size_t window = 0; window < wanted.starts.size; ++window) {
        ErrorSpread spread(track, parameters, uncertainty);
        std::size_t horizon = 0;
        for (std::size_t step = 0; step < steps; ++step) {
            const std::size_t sample = static_cast<std::size_t>(wanted.starts[window]) + step;
            spread.step(path[window * (steps + 1) + step], track.motion[sample]);
            if (static_cast<std::int64_t>(step + 1) == wanted.horizons[horizon]) {
                covariance[window * count + horizon] = spread.covariance();
                ++horizon;
            }
        }
    }
}

}  // namespace quadpi
