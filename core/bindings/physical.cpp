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
    checked_rotors(only(vehicle).rotors);
    for_rows([&](auto& own, Regressors& row) { fill_regressors(own, only(vehicle), row); }, motion, rows);
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
    explicit HeldPhysical(nb::object its_arrays) : HeldModel(its_arrays) {
        checked_rotors(common.only().vehicle.rotors);
        const std::size_t longest = model.model.longest();
        require(
            longest <= TERMS && whitening.all().size == AXES * longest * longest, "not the terms of six axes"
        );
    }

    Evaluator& evaluator() override { return model; }

private:
    const Field<const PhysicalCommon> common{arrays, "common"};
    const Field<const KeptTerm> kept{arrays, "kept"};
    const Field<const std::int64_t> acting{arrays, "acting"};
    const Field<const double> whitening{arrays, "whitening"};
    PhysicalEvaluator model{{common.only(), kept.all(), acting.all(), whitening.all()}};
};

using TrackFields = std::tuple<
    double,
    Motions,
    Records<const Quaternion>,
    Vehicles,
    double,
    double,
    Records<const Matrix3>,
    Records<const Matrix3>>;

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
    const TrackFields& track,
    Records<const std::int64_t> starts,
    Records<const std::int64_t> horizons,
    Records<const TermValues> parameters,
    const std::tuple<Records<const Wrench>, Records<const Matrix<AXES, TERMS>>, Records<const Wrench>>&
        disturbances,
    const std::tuple<Records<StateError>, Records<Sensitivity>, Records<Moving>>& rolled
) {
    const RollOuts wanted{starts, horizons};
    const auto flight = made_of<RolloutTrack>(track);
    const auto known = made_of<Disturbances>(disturbances);
    const auto filled = made_of<RolledOut>(rolled);
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

using UncertaintyFields = std::tuple<
    Records<const StateError>,
    Records<const Wrench>,
    Records<const Wrench>,
    Records<const Wrench>,
    Records<const Matrix<TERMS, TERMS>>>;

void spread_errors(
    const TrackFields& track,
    Records<const std::int64_t> starts,
    Records<const std::int64_t> horizons,
    Records<const Moving> path,
    Records<const TermValues> parameters,
    const UncertaintyFields& uncertainty,
    Records<RolloutCovariance> covariance
) {
    const RollOuts wanted{starts, horizons};
    const auto flight = made_of<RolloutTrack>(track);
    const auto begin = made_of<Uncertainty>(uncertainty);
    require_within(flight, wanted);
    require(path.size == starts.size * (wanted.last() + 1), DIFFERENT);
    require(covariance.size == starts.size * horizons.size, DIFFERENT);
    const TermValues& values = only(parameters);
    const nb::gil_scoped_release unlocked;
    error_covariance(flight, wanted, path, values, begin, covariance);
}

}  // namespace

void bind_physical(nb::module_& module) {
    module.def("fill_regressors", &find_regressors, Unlocked());
    module.def("physical_wrenches", &find_physical_wrenches, Unlocked());
    module.def("read_motions", &read_motions);
    nb::class_<HeldPhysical, HeldModel>(module, "Physical").def(nb::init<nb::object>());
    module.def("roll_out", &roll_out_all);
    module.def("error_covariance", &spread_errors);
}

}  // namespace quadpi
