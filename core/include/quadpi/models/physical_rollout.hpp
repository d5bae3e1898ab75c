// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Open-loop roll-outs of the physical model with their derivatives by each parameter; see
// models/physical_rollout.py, which says how they are made.
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

// Rows of an error and of its derivatives.
namespace rollout {
constexpr int POSITION = 0, VELOCITY = 3, ATTITUDE = 6, RATES = 9, STATES = 12;
}

// Derivatives of a state by the parameters.
using Sensitivity = Matrix<rollout::STATES, TERMS>;
using StateError = std::array<double, rollout::STATES>;

// Where a body is on its way.
struct Moving {
    Vector3 displacement;  // m in the world, since the start
    Quaternion attitude;   // body to world
    Vector3 velocity;      // m/s in the world
    Vector3 rates;         // rad/s in the body
};

// A disturbance as it is now: a wrench, and its slopes by the parameters.
struct HeldWrench {
    Wrench wrench;
    Matrix<AXES, TERMS> slopes;
};

// Residual wrench known at the starts.
struct Disturbances {
    Records<const Wrench> wrench;
    Records<const Matrix<AXES, TERMS>> slopes;  // by the parameters; none without derivatives
    const Wrench& decay;                        // share that is left after a step
};

// Errors of W roll-outs at H horizons, predicted less measured, to be filled.
struct RolledOut {
    Records<StateError> errors;        // (W, H)
    Records<Sensitivity> derivatives;  // (W, H) of the errors by the parameters; none where not asked for
    Records<Moving> path;              // (W, S + 1) at each of the S steps to the last horizon
};

// From where a flight is rolled out, and how far.
struct RollOuts {
    Records<const std::int64_t> starts;    // W samples
    Records<const std::int64_t> horizons;  // H steps after the start, rising

    std::size_t last() const { return static_cast<std::size_t>(horizons[horizons.size - 1]); }
};

// A body that is rolled out from a sample of a flight.
class RollOut {
public:
    RollOut(const RolloutTrack& track, const TermValues& parameters, const Wrench& decay, bool with_slopes)
        : track(track), parameters(parameters), decay(decay), with_slopes(with_slopes) {}

    // Begin at a sample, with the wrench that is held there.
    void begin(std::size_t first, const Wrench& wrench, const Matrix<AXES, TERMS>* slopes, Moving& here) {
        sample = first;
        flown = {};
        held.wrench = wrench;
        sensitivity = {};
        if (slopes != nullptr) {
            held.slopes = *slopes;
        }
        const MotionSample& motion = track.motion[sample];
        here.displacement = {};
        here.attitude = track.attitude[sample];
        here.velocity = times(rotation_matrix(here.attitude), motion.velocity);
        here.rates = motion.rates;
    }

    // Go on by a step, by the explicit midpoint rule.
    void step(const Moving& here, Moving& there) {
        const double h = track.step;
        const MotionSample &left = track.motion[sample], &right = track.motion[sample + 1];
        Wrench gained = accelerate(
            set_motion(left, left, here.attitude, here.velocity, here.rates), here.attitude, sensitivity
        );
        const Quaternion half_attitude =
            product(here.attitude, from_rotation_vector(scaled(0.5 * h, here.rates)));
        Vector3 half_velocity, half_rates;
        for (int axis = 0; axis < 3; ++axis) {
            half_velocity[axis] = here.velocity[axis] + 0.5 * h * gained[axis];
            half_rates[axis] = here.rates[axis] + 0.5 * h * gained[3 + axis];
        }
        if (with_slopes) {
            middle = slopes_after(sensitivity, sensitivity, here.rates, 0.5 * h);
        }
        gained = accelerate(
            set_motion(left, right, half_attitude, half_velocity, half_rates), half_attitude, middle
        );
        if (with_slopes) {
            sensitivity = slopes_after(sensitivity, middle, half_rates, h);
        }
        there.attitude = normalised(product(here.attitude, from_rotation_vector(scaled(h, half_rates))));
        for (int axis = 0; axis < 3; ++axis) {
            there.displacement[axis] = here.displacement[axis] + h * half_velocity[axis];
            there.velocity[axis] = here.velocity[axis] + h * gained[axis];
            there.rates[axis] = here.rates[axis] + h * gained[3 + axis];
        }
        for (const std::size_t end : {sample, sample + 1}) {
            const Vector3 moved = measured_velocity(end);
            for (int axis = 0; axis < 3; ++axis) {
                flown[axis] += 0.5 * h * moved[axis];
            }
        }
        decay_held();
        ++sample;
    }

    // Predicted less measured at the sample that was reached.
    StateError error_of(const Moving& there) const {
        const Vector3 measured = measured_velocity(sample);
        const Vector3 turned = to_rotation_vector(product(inverse(track.attitude[sample]), there.attitude));
        StateError error;
        for (int axis = 0; axis < 3; ++axis) {
            error[rollout::POSITION + axis] = there.displacement[axis] - flown[axis];
            error[rollout::VELOCITY + axis] = there.velocity[axis] - measured[axis];
            error[rollout::ATTITUDE + axis] = turned[axis];
            error[rollout::RATES + axis] = there.rates[axis] - track.motion[sample].rates[axis];
        }
        return error;
    }

    // Derivatives of that error by the parameters.
    void derivatives_of(const StateError& error, Sensitivity& out) const {
        out = sensitivity;
        const Matrix3 by_vector = inverse_of(right_jacobian({error[6], error[7], error[8]}));
        set_rows(out, rollout::ATTITUDE, multiplied(by_vector, rows_of<3>(sensitivity, rollout::ATTITUDE)));
    }

private:
    const RolloutTrack& track;
    const TermValues& parameters;
    const Wrench& decay;
    const bool with_slopes;
    std::size_t sample = 0;
    Vector3 flown{};  // m in the world, by the measured velocity
    HeldWrench held{};
    // Of the state now and halfway, and of the accelerations, by the parameters.
    Sensitivity sensitivity{}, middle{};
    Matrix<AXES, TERMS> slopes{};

    Vector3 measured_velocity(std::size_t at) const {
        return times(rotation_matrix(track.attitude[at]), track.motion[at].velocity);
    }

    void decay_held() {
        for (int axis = 0; axis < AXES; ++axis) {
            held.wrench[axis] *= decay[axis];
            if (with_slopes) {
                for (double& slope : held.slopes[axis]) {
                    slope *= decay[axis];
                }
            }
        }
    }

    // Accelerations, in the world m/s² and about the body axes rad/s²; sets their derivatives.
    Wrench accelerate(MotionSample now, const Quaternion& attitude, const Sensitivity& state) {
        Regressors row;
        fill_regressors(now, track.vehicle, row);
        Wrench wrench = wrench_of(row, parameters);
        for (int axis = 0; axis < AXES; ++axis) {
            wrench[axis] += held.wrench[axis];
        }
        const Matrix3 rotation = rotation_matrix(attitude);
        const Vector3 force = times(rotation, {wrench[0], wrench[1], wrench[2]});
        const Vector3 gyroscopic = cross(now.rates, times(track.inertia, now.rates));
        const Vector3 turning =
            times(track.inverse_inertia, minus({wrench[3], wrench[4], wrench[5]}, gyroscopic));
        if (with_slopes) {
            Matrix<AXES, TERMS> own = held.slopes;
            for (std::size_t term = 0; term < TERMS; ++term) {
                for (int axis = 0; axis < AXES; ++axis) {
                    own[axis][term] = terms_of(row)[term][axis] + own[axis][term];
                }
            }
            slopes = acceleration_slopes(
                now, rotation, track, wrench, wrench_slopes(now, track.vehicle, parameters), own, state
            );
        }
        return {
            force[0] / track.mass,
            force[1] / track.mass,
            force[2] / track.mass + track.gravity,
            turning[0],
            turning[1],
            turning[2],
        };
    }

    // Derivatives of the state after `h` seconds, of velocity, rates and accelerations that are held.
    //
    // Those of the state at the begin are `begin`, of what is held `during` and, for accelerations, `slopes`.
    Sensitivity slopes_after(
        const Sensitivity& begin, const Sensitivity& during, const Vector3& rates, double h
    ) const {
        const Vector3 vector = scaled(h, rates);
        const Matrix3 turn = transposed(rotation_matrix(from_rotation_vector(vector)));
        const Matrix<3, TERMS> turned = multiplied(turn, rows_of<3>(begin, rollout::ATTITUDE));
        const Matrix<3, TERMS> turning =
            multiplied(right_jacobian(vector), rows_of<3>(during, rollout::RATES));
        Sensitivity after;
        for (int axis = 0; axis < 3; ++axis) {
            for (std::size_t term = 0; term < TERMS; ++term) {
                after[axis][term] = begin[axis][term] + h * during[3 + axis][term];
                after[3 + axis][term] = begin[3 + axis][term] + h * slopes[axis][term];
                after[6 + axis][term] = turned[axis][term] + h * turning[axis][term];
                after[9 + axis][term] = begin[9 + axis][term] + h * slopes[3 + axis][term];
            }
        }
        return after;
    }
};

// Roll the model out from samples of a flight.
inline void roll_out(
    const RolloutTrack& track,
    const RollOuts& wanted,
    const TermValues& parameters,
    const Disturbances& disturbances,
    const RolledOut& rolled
) {
    const bool with_slopes = rolled.derivatives.size > 0;
    const std::size_t steps = wanted.last(), count = wanted.horizons.size;
    RollOut body(track, parameters, disturbances.decay, with_slopes);
    for (std::size_t window = 0; window < wanted.starts.size; ++window) {
        Moving* const path = &rolled.path[window * (steps + 1)];
        std::size_t place = window * count, horizon = 0;
        const Matrix<AXES, TERMS>* const slopes = with_slopes ? &disturbances.slopes[window] : nullptr;
        body.begin(
            static_cast<std::size_t>(wanted.starts[window]), disturbances.wrench[window], slopes, path[0]
        );
        for (std::size_t step = 0; step < steps; ++step) {
            body.step(path[step], path[step + 1]);
            if (static_cast<std::int64_t>(step + 1) == wanted.horizons[horizon]) {
                rolled.errors[place] = body.error_of(path[step + 1]);
                if (with_slopes) {
                    body.derivatives_of(rolled.errors[place], rolled.derivatives[place]);
                }
                ++horizon, ++place;
            }
        }
    }
}

}  // namespace quadpi
