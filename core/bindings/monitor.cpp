// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the monitor: pairing, preparation, adaptive intervals and the alarm.
#include <nanobind/nanobind.h>

#include "bindings/held_monitor.hpp"
#include "quadpi/monitor/conditions.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

nb::object add_imu(HeldPairing& held, std::int64_t time_ns, Records<const Vector3> specific_force) {
    held.pairing().add_imu(time_ns, only(specific_force));
    return held.completed();
}

nb::object add_state(
    HeldPairing& held,
    std::int64_t time_ns,
    Records<const Vector3> velocity,
    Records<const Quaternion> attitude,
    Records<const Vector3> rates
) {
    held.pairing().add_state(time_ns, only(velocity), only(attitude), only(rates));
    return held.completed();
}

nb::object add_estimate(HeldPairing& held, std::int64_t time_ns, Records<const Motion> motion) {
    Pairing pairing = held.pairing();
    const Motion& own = only(motion);
    pairing.add_imu(time_ns, own.specific_force);
    pairing.add_state(time_ns, own.velocity, own.attitude, own.rates);
    return held.completed();
}

nb::object add_sample(
    HeldPairing& held, std::int64_t topic, std::int64_t time_ns, Records<const double> values
) {
    require(0 <= topic && topic < TOPICS && values.size <= WIDEST, "not a sample of a topic");
    PairingState& state = held.state.only();
    require(topic != ROTOR_SPEEDS || values.size == checked_rotors(state.rotors), "not of these rotors");
    held.pairing().add(static_cast<Topic>(topic), time_ns, values.data, values.size);
    return held.completed();
}

nb::tuple take_samples(HeldPairing& held, Records<std::int64_t> taken_ns, Records<double> taken) {
    PairingState& state = held.state.only();
    const auto room = static_cast<std::int64_t>(taken_ns.size);
    require_rows({taken.data, taken.size}, taken_ns.size, state.rotors);
    require(room >= held.due(), DIFFERENT);
    const bool changed = held.pairing().rate_has_changed();
    state.rate_changes = state.meter.changes;
    return nb::make_tuple(held.pairing().take(taken_ns, taken.data), changed);
}

using Stamps = Records<const std::int64_t>;
using Vectors = Records<const Vector3>;
using Arriving = std::tuple<
    Stamps,
    Stamps,
    Stamps,
    Vectors,
    Stamps,
    Records<const StateValues>,
    Stamps,
    Records<const double>,
    Stamps,
    Vectors>;

nb::tuple take_stretch(
    HeldPairing& pairing,
    const Arriving& arriving,
    std::int64_t start,
    Records<std::int64_t> taken_ns,
    Records<double> taken
) {
    const auto samples = made_of<ArrivingSamples>(arriving);
    const auto rotors = checked_rotors(pairing.state.only().rotors);
    require(samples.rotor_speeds.size == samples.rotor_ns.size * rotors, DIFFERENT);
    const StretchEnd end = pairing.pairing().take_stretch(samples, start, taken_ns, taken.data);
    return nb::make_tuple(end.event, end.begin, end.count);
}

std::size_t prepare_all(
    Records<PreparationMemory> memory,
    Records<const std::int64_t> time_ns,
    Records<const double> samples,
    Records<Verdict> verdicts,
    Records<InputVector> inputs,
    Records<Wrench> measured,
    Records<Derivatives> derivatives,
    Records<Signals> filtered
) {
    require_rows(samples, time_ns.size, only(memory).vehicle.rotors);
    require(verdicts.size == time_ns.size, DIFFERENT);
    return prepare(only(memory), time_ns, samples, {verdicts, inputs, measured, derivatives, filtered});
}

void take_all_conditions(
    Records<const PreparationMemory> memory,
    Records<const Conditions> conditions,
    Records<Verdict> verdicts,
    Records<const Signals> filtered,
    Records<Derivatives> derivatives,
    Records<ErringInputs> erring
) {
    require(verdicts.size == conditions.size, DIFFERENT);
    require(filtered.size == erring.size && derivatives.size == erring.size, DIFFERENT);
    take_conditions(conditions, verdicts, filtered, only(memory).vehicle, derivatives, erring);
}

void scale_evaluation_by_density(Records<const Derivatives> derivatives, Records<Wrench> evaluation) {
    require(evaluation.size == 5 * derivatives.size, DIFFERENT);
    scale_by_density(derivatives, Evaluation::in(evaluation, derivatives.size));
}

void adapt_all(
    Records<AdaptiveMemory> memory,
    Records<const Wrench> measured,
    Records<const Wrench> own_lower,
    Records<const Wrench> own_upper,
    Records<Wrench> lower,
    Records<Wrench> upper
) {
    const auto adapt_row = [&](auto&... wrenches) { adapt(only(memory), wrenches...); };
    for_rows(adapt_row, measured, own_lower, own_upper, lower, upper);
}

std::size_t advance_alarm(
    Records<const AlarmLimits> limits,
    Records<AlarmState> state,
    Records<const Verdict> verdicts,
    Records<const InputVector> inputs,
    Records<const Wrench> measured,
    Records<const Wrench> lower,
    Records<const Wrench> upper,
    Records<const Wrench> leverage,
    Records<const Wrench> relative_width,
    Records<AlarmRow> rows
) {
    const std::size_t used = inputs.size;
    checked_rotors(only(limits).rotors.rotors);
    require(rows.size >= verdicts.size && used <= verdicts.size, DIFFERENT);
    require_each(used, measured, lower, upper, leverage, relative_width);
    return advance(
        only(limits), only(state), verdicts, inputs, measured, {lower, upper, leverage, relative_width}, rows
    );
}

nb::tuple step_monitor(
    HeldMonitor& monitor,
    Records<PreparationMemory> preparation,
    Records<const std::int64_t> time_ns,
    Records<const double> samples,
    Records<std::int64_t> predicted_ns,
    Records<Wrench> wrenches,
    Records<AlarmRow> alarms
) {
    const std::size_t count = time_ns.size;
    require(monitor.model != nullptr, "a model that Python evaluates");
    require_rows(samples, count, only(preparation).vehicle.rotors);
    require(predicted_ns.size == count, DIFFERENT);
    require(wrenches.size == 5 * count && alarms.size >= count, DIFFERENT);
    MonitorRows rows{predicted_ns, wrenches, alarms};
    step(monitor.memory(), only(preparation), *monitor.model, time_ns, samples, *monitor.block, rows);
    return nb::make_tuple(rows.predictions, rows.raised);
}

// added: (U) squares of what the states add to half widths, or nothing.
// said: (5, U) what Python evaluated, or nothing where the model is compiled.
// alarms: none where the alarm is not wanted.
nb::tuple judge_prepared(
    HeldMonitor& monitor,
    nb::handle prepared,
    Records<const Wrench> added,
    Records<const Wrench> said,
    Records<std::int64_t> predicted_ns,
    Records<Wrench> wrenches,
    Records<AlarmRow> alarms
) {
    const Field<const Verdict> verdicts(prepared, "verdicts");
    const Field<const InputVector> inputs(prepared, "inputs");
    const Field<const Wrench> measured(prepared, "measured");
    const Field<const Derivatives> derivatives(prepared, "derivatives");
    const GivenSamples given{verdicts.all(), inputs.all(), measured.all(), derivatives.all(), added};
    std::size_t used = 0;
    for (const Verdict& verdict : given.verdicts) {
        used += verdict.usable ? 1 : 0;
    }
    require_each(used, given.inputs, given.measured, given.derivatives, predicted_ns);
    require(wrenches.size == 5 * used && (added.size == 0 || added.size == used), DIFFERENT);
    require(alarms.size == 0 || alarms.size >= given.verdicts.size, DIFFERENT);
    require(said.size == (monitor.model == nullptr ? 5 * used : 0), DIFFERENT);
    MonitorRows rows{predicted_ns, wrenches, alarms};
    SaidBefore of_python(said);
    Evaluator& model = monitor.model == nullptr ? of_python : *monitor.model;
    judge_given(monitor.memory(), model, given, *monitor.block, rows);
    return nb::make_tuple(rows.predictions, rows.raised);
}

// Whether a signal exceeds a level long enough to raise the alarm.
bool lasts(
    Records<const double> values,
    Records<const double> steps,
    double level,
    double persistence_s,
    double release_s
) {
    require(steps.size == values.size, DIFFERENT);
    double charge = 0.0;
    for (std::size_t i = 0; i < values.size; ++i) {
        const double change = values[i] > level ? steps[i] / persistence_s : -steps[i] / release_s;
        charge = std::max(0.0, charge + change);
        if (charge >= 1.0 - ROUNDING) {
            return true;
        }
    }
    return false;
}

// The sequential test of each axis, without its end at the limit.
void sum_misses(
    Records<const double> steps, Records<const Wrench> miss, double allowed, Records<Wrench> sums
) {
    require(miss.size == steps.size && sums.size == steps.size, DIFFERENT);
    Wrench total{};
    for (std::size_t i = 0; i < steps.size; ++i) {
        for (int axis = 0; axis < AXES; ++axis) {
            if (!std::isnan(miss[i][axis])) {
                total[axis] = std::max(0.0, total[axis] + steps[i] * (miss[i][axis] - allowed));
            }
            sums[i][axis] = total[axis];
        }
    }
}

}  // namespace

void bind_monitor(nb::module_& module) {
    NAME_CONSTANTS(module, NOT_FINITE, NOT_PLAUSIBLE, STAMP_REPEATED, STAMP_BACKWARD, GAP, STATE_MISSING);
    NAME_CONSTANTS(module, ROTORS_MISSING, GYRO_FROZEN, ACCELEROMETER_FROZEN, ROTOR_FROZEN, ROTOR_HALF);
    NAME_CONSTANTS(module, ROTOR_JUMPS, ROTOR_DIFFERS, RATE_DIFFERS, RATE_UNKNOWN, RATE_LOW, ROTOR_ZERO);
    NAME_CONSTANTS(module, SETTLE_NS, ERRORS_KEPT, FINE_STEP, GONE_M, LARGEST_CHANGE, LIFTED, LOST_MOST);
    NAME_CONSTANTS(module, LOST_S, LOST_SHARE, MOVES_G, MOVES_M_S, MOVES_RAD_S, OTHERS_STEPS, RESTING);
    NAME_CONSTANTS(module, ROUNDING, SILENT_LOST_S, STEADY_SHARE, STEP_MAX_S, STUCK_RAD_S, STUCK_S);
    NAME_CONSTANTS(module, SUPPORTED_G, SUPPORTED_S, TOGETHER_SHARE, TURNING, UNDECIDED_S, WARNING_CHARGE);
    bind_held<HeldPairing>(module, "Pairing").def(nb::init<nb::object>());
    module.def("add_imu", &add_imu);
    module.def("add_state", &add_state);
    module.def("add_estimate", &add_estimate);
    module.def("add_sample", &add_sample);
    module.def("take_samples", &take_samples);
    module.def("take_stretch", &take_stretch);
    module.def("prepare", &prepare_all);
    module.def("take_conditions", &take_all_conditions);
    module.def("scale_by_density", &scale_evaluation_by_density);
    module.def("adapt", &adapt_all);
    module.def("advance_alarm", &advance_alarm);
    bind_held<HeldMonitor>(module, "Monitor").def(nb::init<nb::object>());
    nb::class_<PairedMonitor, HeldPairing>(module, "PairedMonitor").def(nb::init<nb::object>());
    module.def("step_monitor", &step_monitor);
    module.def("judge_prepared", &judge_prepared);
    module.def("lasts", &lasts);
    module.def("sum_misses", &sum_misses);
}

}  // namespace quadpi
