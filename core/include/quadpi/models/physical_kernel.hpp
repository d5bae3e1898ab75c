// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Evaluation of the physical model: its wrench, and leverage and spread of each axis.
#pragma once

#include "quadpi/models/evaluation.hpp"
#include "quadpi/models/physical_regressors.hpp"

namespace quadpi {

// What the axes share, and the axes.
struct PhysicalCommon {
    PhysicalVehicle vehicle;
    std::array<PerRotor, 3> controls;  // signs that gave U_p, U_q and U_r of the rotor speeds
    double delay_s;                    // that rotor speeds act after they were measured
    std::array<FittedAxis, AXES> axes;
};

// A term in the model: its number, and its parameter.
struct KeptTerm {
    std::int64_t number;
    double value;
};

// A physical model as it is stored; S is the largest number of terms that act on an axis.
struct PhysicalModel {
    const PhysicalCommon& common;
    Records<const KeptTerm> kept;
    Records<const std::int64_t> acting;  // (6, S) numbers of the terms that act on an axis
    Records<const double> whitening;     // (6, S, S) lower triangular Wᵀ with leverage h = |W z|²

    std::size_t longest() const { return acting.size / AXES; }
};

// Motion of an input vector and derivatives, the rotor speeds as they were some time ago.
//
// Of four rotors, one in each quadrant, ω_avg is a root mean square and the controls are orthogonal sums of
// the rotor speeds, so that Σω = √(16 ω_avg² − U_p² − U_q² − U_r²), and each rotor's speed is a quarter of
// the signed sums. The speeds of others do not follow from these.
inline MotionSample motion_of(
    const InputVector& inputs,
    const Derivatives& derivatives,
    const std::array<PerRotor, 3>& controls,
    std::int64_t rotors,
    double delay_s
) {
    double total = 16.0 * (inputs[7] * inputs[7]) - inputs[12] * inputs[12] - inputs[13] * inputs[13] -
                   inputs[14] * inputs[14];
    total = std::sqrt(std::max(total, 0.0));
    const bool follow = rotors == 4 && controls[0][0] != 0.0 && controls[1][0] != 0.0;
    MotionSample motion{};
    motion.velocity = {inputs[0], inputs[1], inputs[2]};
    motion.rates = {inputs[4], inputs[5], inputs[6]};
    motion.angular_acceleration = derivatives.angular_acceleration;
    for (int rotor = 0; rotor < rotors; ++rotor) {
        double speed = total;
        for (int control = 0; control < 3; ++control) {
            speed += controls[control][rotor] * inputs[12 + control];
        }
        speed = follow ? 0.25 * speed : derivatives.rotor_speeds[rotor];
        // By Taylor's series from now.
        const double acceleration = derivatives.rotor_accelerations[rotor];
        const double jerk = derivatives.rotor_jerks[rotor];
        speed -= delay_s * (acceleration - 0.5 * delay_s * jerk);
        motion.rotor_speeds[rotor] = std::max(speed, 0.0);
        motion.rotor_accelerations[rotor] = acceleration - delay_s * jerk;
    }
    return motion;
}

// Leverage |W z|² of the regressors of a sample on an axis.
inline double leverage_of(const PhysicalModel& model, const Regressors& row, int axis) {
    const std::size_t longest = model.longest();
    const auto size = static_cast<std::size_t>(model.common.axes[axis].size);
    TermValues whitened{};
    for (std::size_t b = 0; b < size; ++b) {
        const double z = terms_of(row)[model.acting[axis * longest + b]][axis];
        const double* weights = &model.whitening[(axis * longest + b) * longest];
        for (std::size_t a = 0; a <= b; ++a) {
            whitened[a] += weights[a] * z;
        }
    }
    double leverage = 0.0;
    for (std::size_t a = 0; a < size; ++a) {
        leverage += whitened[a] * whitened[a];
    }
    return leverage;
}

// A physical model, which needs no room.
struct PhysicalEvaluator final : Evaluator {
    explicit PhysicalEvaluator(const PhysicalModel& its_model) : model(its_model) {}

    bool uses_derivatives() const override { return true; }

    PhysicalModel model;

    void evaluate(
        Records<const InputVector> inputs,
        Records<const Derivatives> derivatives,
        const Wrench& factors,
        const Evaluation& out
    ) override {
        const auto& [vehicle, controls, delay_s, axes] = model.common;
        Regressors row;
        for (std::size_t i = 0; i < inputs.size; ++i) {
            const MotionSample motion =
                motion_of(inputs[i], derivatives[i], controls, vehicle.rotors, delay_s);
            fill_regressors(motion, vehicle, row);
            if (derivatives[i].density_excess != 0.0) {
                scale_by_density(row, 1.0 + derivatives[i].density_excess);
            }
            Wrench predicted{};
            for (const KeptTerm& term : model.kept) {
                for (int axis = 0; axis < AXES; ++axis) {
                    predicted[axis] += term.value * terms_of(row)[term.number][axis];
                }
            }
            for (int axis = 0; axis < AXES; ++axis) {
                if (axes[axis].size > 0) {
                    const double leverage = leverage_of(model, row, axis);
                    out.fill(i, axis, predicted[axis], leverage, factors[axis], axes[axis], inputs[i]);
                }
            }
        }
    }
};

}  // namespace quadpi
