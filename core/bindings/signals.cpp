// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the signals, the input vectors and the rate of the IMU.
#include <nanobind/nanobind.h>

#include "bindings/rotors.hpp"
#include "quadpi/estimator/imu_rate.hpp"
#include "quadpi/inputs.hpp"
#include "quadpi/signals/force_bandwidth.hpp"
#include "quadpi/signals/wrench.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

DelayLines delay_lines(Records<double> state) { return {state.data, state.size / (SECTIONS * DELAYS)}; }

void settle_at(Records<const LowPass> design, Records<double> state, Records<const double> sample) {
    require(delay_lines(state).channels == sample.size, "not a sample of these channels");
    settle(only(design), delay_lines(state), sample.data);
}

void filter_rows(
    Records<const LowPass> design,
    Records<double> state,
    Records<const double> samples,
    Records<double> value,
    Records<double> derivative
) {
    const DelayLines delays = delay_lines(state);
    require(value.size == samples.size && derivative.size == samples.size, DIFFERENT);
    if (samples.size == 0) {
        return;
    }
    require(delays.channels > 0 && samples.size % delays.channels == 0, "not samples of these channels");
    low_pass(only(design), delays, samples.size / delays.channels, samples.data, value.data, derivative.data);
}

void find_wrenches(
    Records<const Vector3> specific_force,
    Records<const Vector3> rates,
    Records<const Vector3> acceleration,
    double mass_kg,
    Records<const Matrix3> inertia,
    Records<Wrench> wrench
) {
    const auto fill = [&](Wrench& own, auto&... measured) {
        own = newton_euler(measured..., mass_kg, only(inertia));
    };
    for_rows(fill, wrench, specific_force, rates, acceleration);
}

void find_inputs(
    Records<const Vector3> velocity_air,
    Records<const Quaternion> attitude,
    Records<const Vector3> rates,
    Records<const double> rotor_speeds,
    Records<const VehicleConstants> vehicle,
    Records<InputVector> out
) {
    require(velocity_air.size == out.size && attitude.size == out.size, DIFFERENT);
    const VehicleConstants& flown = only(vehicle);
    const auto rotors = checked_rotors(flown.rotors);
    require(rates.size == out.size && rotor_speeds.size == out.size * rotors, DIFFERENT);
    for (std::size_t row = 0; row < out.size; ++row) {
        PerRotor speeds{};
        std::copy_n(rotor_speeds.data + row * rotors, rotors, speeds.begin());
        fill_inputs(velocity_air[row], attitude[row], rates[row], speeds, flown, out[row]);
    }
}

}  // namespace

void bind_signals(nb::module_& module) {
    NAME_CONSTANTS(module, METER_ROOM, ROTORS_MAX, RATE_SPAN);
    module.def("settle", &settle_at);
    module.def("low_pass", &filter_rows);
    module.def("make_continuous", [](Records<Quaternion> attitudes, Records<const Quaternion> last) {
        make_continuous(attitudes, only(last));
    });
    module.def("newton_euler", &find_wrenches);
    module.def("turn_by_rates", &turn_by_rates);
    module.def("relative_to_air", over_rows(&relative_to_air));
    module.def("fill_inputs", &find_inputs);
    module.def("follow_rate", [](Records<Meter> meter, std::int64_t time_ns) {
        follow(only(meter), time_ns);
    });
}

}  // namespace quadpi
