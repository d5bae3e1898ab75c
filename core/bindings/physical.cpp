// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the physical model.
#include <nanobind/nanobind.h>

#include "bindings/held_model.hpp"
#include "bindings/rotors.hpp"
#include "quadpi/models/physical_kernel.hpp"
#include "quadpi/models/tubes.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Unlocked = nb::call_guard<nb::gil_scoped_release>;
using Motions = Records<const MotionSample>;
using Vehicles = Records<const PhysicalVehicle>;

void find_regressors(Motions motion, Vehicles vehicle, Records<Regressors> rows) {
    require(rows.size == motion.size, DIFFERENT);
    checked_rotors(only(vehicle).rotors);
    for (std::size_t i = 0; i < rows.size; ++i) {
        fill_regressors(motion[i], only(vehicle), rows[i]);
    }
}

void find_physical_wrenches(
    Motions motion, Vehicles vehicle, Records<const TermValues> parameters, Records<Wrench> out
) {
    require(out.size == motion.size, DIFFERENT);
    checked_rotors(only(vehicle).rotors);
    Regressors row;
    for (std::size_t i = 0; i < out.size; ++i) {
        fill_regressors(motion[i], only(vehicle), row);
        out[i] = wrench_of(row, only(parameters));
    }
}

void read_motions(
    Records<const InputVector> inputs,
    Records<const Derivatives> derivatives,
    Records<const VehicleConstants> vehicle,
    Records<MotionSample> motion
) {
    require(inputs.size == motion.size && derivatives.size == motion.size, DIFFERENT);
    const VehicleConstants& flown = only(vehicle);
    checked_rotors(flown.rotors);
    for (std::size_t i = 0; i < motion.size; ++i) {
        motion[i] = motion_of(inputs[i], derivatives[i], flown.control_signs, flown.rotors, 0.0);
    }
}

// The arrays of `FittedPhysical`.
class HeldPhysical final : public HeldModel {
public:
    explicit HeldPhysical(nb::object arrays)
        : HeldModel(arrays),
          common(arrays, "common"),
          kept(arrays, "kept"),
          acting(arrays, "acting"),
          whitening(arrays, "whitening"),
          model({common.only(), kept.all(), acting.all(), whitening.all()}) {
        checked_rotors(common.only().vehicle.rotors);
        const std::size_t longest = model.model.longest();
        require(
            longest <= TERMS && whitening.all().size == AXES * longest * longest, "not the terms of six axes"
        );
    }

    Evaluator& evaluator() override { return model; }

private:
    Field<const PhysicalCommon> common;
    Field<const KeptTerm> kept;
    Field<const std::int64_t> acting;
    Field<const double> whitening;
    PhysicalEvaluator model;
};

// The arrays of a flight that is rolled out, held as long as a call lasts.
struct HeldTrack {
    explicit HeldTrack(nb::handle track)
        : step(nb::cast<double>(track.attr("step"))),
          mass(nb::cast<double>(track.attr("mass"))),
          gravity(nb::cast<double>(track.attr("gravity"))),
          motion(track, "motion"),
          attitude(track, "attitude"),
          vehicle(track, "vehicle"),
          inertia(track, "inertia"),
          inverse_inertia(track, "inverse_inertia") {}

    RolloutTrack track() const {
        return {
            step,
            motion.all(),
            attitude.all(),
            vehicle.only(),
            mass,
            gravity,
            inertia.only(),
            inverse_inertia.only(),
        };
    }

    double step, mass, gravity;
    Field<const MotionSample> motion;
    Field<const Quaternion> attitude;
    Field<const PhysicalVehicle> vehicle;
    Field<const Matrix3> inertia, inverse_inertia;
};

// Refuse roll-outs that do not lie within a flight.
void require_within(const RolloutTrack& track, const RollOuts& wanted) {
    std::int64_t before = 0;
    for (const std::int64_t horizon : wanted.horizons) {
        require(horizon > before, "horizons must rise from one step on");
        before = horizon;
    }
    checked_rotors(track.vehicle.rotors);
    require(before > 0 && track.attitude.size == track.motion.size, DIFFERENT);
    for (const std::int64_t start : wanted.starts) {
        const auto end = static_cast<std::size_t>(start + before);
        require(start >= 0 && end < track.motion.size, "a roll-out beyond its flight");
    }
}

void roll_out_all(
    nb::handle track,
    Records<const std::int64_t> starts,
    Records<const std::int64_t> horizons,
    Records<const TermValues> parameters,
    nb::handle disturbances,
    nb::handle rolled
) {
    const HeldTrack held(track);
    const Field<const Wrench> wrench(disturbances, "wrench"), decay(disturbances, "decay");
    const Field<const Matrix<AXES, TERMS>> slopes(disturbances, "slopes");
    const Field<StateError> errors(rolled, "errors");
    const Field<Sensitivity> derivatives(rolled, "derivatives");
    const Field<Moving> path(rolled, "path");
    const RollOuts wanted{starts, horizons};
    const RolloutTrack flight = held.track();
    const Disturbances known{wrench.all(), slopes.all(), decay.only()};
    const RolledOut filled{errors.all(), derivatives.all(), path.all()};
    require_within(flight, wanted);
    const std::size_t count = starts.size, all = count * horizons.size;
    require(known.wrench.size == count && filled.errors.size == all, DIFFERENT);
    require(filled.path.size == count * (wanted.last() + 1), DIFFERENT);
    if (filled.derivatives.size > 0) {
        require(known.slopes.size == count && filled.derivatives.size == all, DIFFERENT);
    }
    const TermValues& values = only(parameters);
    const nb::gil_scoped_release unlocked;
    roll_out(flight, wanted, values, known, filled);
}

void spread_errors(
    nb::handle track,
    Records<const std::int64_t> starts,
    Records<const std::int64_t> horizons,
    Records<const Moving> path,
    Records<const TermValues> parameters,
    nb::handle uncertainty,
    Records<RolloutCovariance> covariance
) {
    const HeldTrack held(track);
    const Field<const StateError> state(uncertainty, "state");
    const Field<const Wrench> wrench(uncertainty, "wrench"), drive(uncertainty, "drive");
    const Field<const Wrench> decay(uncertainty, "decay");
    const Field<const Matrix<TERMS, TERMS>> of_parameters(uncertainty, "parameters");
    const RollOuts wanted{starts, horizons};
    const RolloutTrack flight = held.track();
    const Uncertainty begin{state.only(), wrench.only(), drive.only(), decay.only(), of_parameters.only()};
    require_within(flight, wanted);
    require(path.size == starts.size * (wanted.last() + 1), DIFFERENT);
    require(covariance.size == starts.size * horizons.size, DIFFERENT);
    const TermValues& values = only(parameters);
    const nb::gil_scoped_release unlocked;
    error_covariance(flight, wanted, path, values, begin, covariance);
}

}  // namespace

void bind_physical(nb::module_& module) {
    module.def("solve_induced_velocity", &solve_induced_velocity);
    module.def("fill_regressors", &find_regressors, Unlocked());
    module.def("physical_wrenches", &find_physical_wrenches, Unlocked());
    module.def("read_motions", &read_motions);
    nb::class_<HeldPhysical, HeldModel>(module, "Physical").def(nb::init<nb::object>());
    module.def("roll_out", &roll_out_all);
    module.def("error_covariance", &spread_errors);
}

}  // namespace quadpi
