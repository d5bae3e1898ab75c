// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// From paired samples to filtered inputs and the measured wrench: what models of one cut-off share.
#pragma once

#include "quadpi/inputs.hpp"
#include "quadpi/monitor/data_quality.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// When a state begins or comes back, its accelerometer bias is still being found: measured forces then leave
// their intervals up to ten times as often (experiments/results/alarm.md).
constexpr std::int64_t SETTLE_NS = 1'000'000'000;
// Faults of samples that say nothing of the state.
constexpr std::int64_t WITHOUT_STATE =
    NOT_FINITE | NOT_PLAUSIBLE | STAMP_REPEATED | STAMP_BACKWARD | STATE_MISSING;

// What data quality and low-pass say of one sample.
//
// What follows `absent` means something for a sample that is usable, or but for absent rotors; the signals
// have passed the low-pass. A sample has not settled in the first SETTLE_NS of a state, or after more than
// MAX_GAP_NS without one, nor before the low-pass has settled. Where rotor speeds alone are missing, the
// state goes on.
struct Verdict {
    std::int64_t time_ns;
    Faults faults;  // what is wrong
    bool usable;
    // Bit per rotor without a reading, in a sample that is usable but for these: the last ones hold.
    std::int64_t absent;
    Wrench wrench;  // measured, of such a sample alone
    bool settled;
    Vector3 velocity;        // over ground, m/s, world axes
    Vector3 rates;           // rad/s
    Vector3 specific_force;  // m/s², body axes
    PerRotor rotor_speeds;   // rad/s
    std::int64_t commanded;  // bit per rotor whose speed follows from its command
    bool wind_unknown;       // whether the wind is still to be told: horizontal forces are not judged
};

// All that the preparation knows and remembers.
struct PreparationMemory {
    VehicleConstants vehicle;
    LowPass low_pass;  // of rate 0 while no rate of the IMU is known that fits: no sample is usable
    std::int64_t fault_without_rate;  // bits of the fault of a sample that has no low-pass
    Quality quality;
    ChainMemory chain;
    std::int64_t settling_ns;  // of the low-pass
    std::int64_t filtered_ns;  // stamp of the first sample since the low-pass began
    std::int64_t begun_ns;     // that of the first one since the state began
    std::int64_t state_ns;     // that of the last one with a state
    double density_excess;     // by what share the air is denser than the vehicle file says
};

// What prepare() fills: a verdict of each of K samples, and of the usable ones as many of the others.
struct PreparedSamples {
    Records<Verdict> verdicts;
    Records<InputVector> inputs;
    Records<Wrench> measured;
    Records<Derivatives> derivatives;
    Records<Signals> filtered = {};  // none where nobody asks for them
};

inline bool sums_are_finite(const InputVector& inputs, const Wrench& measured) {
    double of_inputs = 0.0, of_measured = 0.0;
    for (const double value : inputs) {
        of_inputs += value;
    }
    for (const double value : measured) {
        of_measured += value;
    }
    return std::isfinite(of_inputs + of_measured);
}

// Fill the verdict of one sample, whose row is changed, and place `used` of the other arrays if it is usable.
inline void prepare_sample(
    PreparationMemory& memory,
    std::int64_t time_ns,
    Signals& row,
    Verdict& verdict,
    std::size_t used,
    PreparedSamples& out
) {
    ChainMemory& chain = memory.chain;
    const std::int64_t rotors = memory.vehicle.rotors;
    auto [faults, usable, jump] = judge(memory.quality, time_ns, row);
    if (usable && memory.low_pass.rate_hz == 0.0) {
        faults.add(memory.fault_without_rate);
        usable = false;
    }
    std::int64_t absent = 0;
    if (!usable && chain.started) {
        absent = take_last_readings(memory.quality, time_ns, row);
    }
    if (usable || absent != 0 || !faults.any(WITHOUT_STATE)) {
        const std::int64_t since_ns = time_ns - memory.state_ns;
        if (!(0 < since_ns && since_ns <= MAX_GAP_NS)) {
            memory.begun_ns = time_ns;
        }
        memory.state_ns = time_ns;
    }
    verdict.time_ns = time_ns;
    verdict.faults = faults;
    verdict.usable = usable;
    verdict.absent = absent;
    if (!usable && absent == 0) {
        return;
    }
    if (!chain.started) {
        memory.begun_ns = time_ns;
    }
    if (usable && jump) {
        forget(chain);
    }
    if (!chain.started) {
        memory.filtered_ns = time_ns;
    }
    verdict.settled =
        time_ns - memory.begun_ns >= SETTLE_NS && time_ns - memory.filtered_ns >= memory.settling_ns;
    Signals value{}, slope{};
    PerRotor curvature{};
    filter_sample(memory.low_pass, chain, row, value, slope, curvature, rotors);
    const Matrix3 turn = rotation_matrix(value.attitude);
    for (int k = 0; k < 3; ++k) {
        verdict.velocity[k] =
            turn[k][0] * value.velocity[0] + turn[k][1] * value.velocity[1] + turn[k][2] * value.velocity[2];
    }
    verdict.rates = value.rates;
    verdict.specific_force = value.specific_force;
    verdict.rotor_speeds = value.rotor_speeds;
    const VehicleConstants& vehicle = memory.vehicle;
    const Wrench measured =
        newton_euler(value.specific_force, value.rates, slope.rates, vehicle.mass, vehicle.inertia);
    if (!usable) {
        verdict.wrench = measured;
        return;
    }
    out.measured[used] = measured;
    fill_inputs(
        relative_to_air(value.velocity, value.attitude, value.wind),
        value.attitude,
        value.rates,
        value.rotor_speeds,
        vehicle,
        out.inputs[used]
    );
    out.derivatives[used] = {
        slope.rates, value.rotor_speeds, slope.rotor_speeds, curvature, memory.density_excess
    };
    if (out.filtered.size > 0) {
        out.filtered[used] = value;
    }
    // A sample one of whose numbers overflows is not usable.
    verdict.usable = sums_are_finite(out.inputs[used], measured);
}

// Fill the verdicts of K samples, which are zero, and what the usable ones give; returns their number.
//
// samples: K rows, see signals_in().
inline std::size_t prepare(
    PreparationMemory& memory,
    Records<const std::int64_t> time_ns,
    Records<const double> samples,
    PreparedSamples out
) {
    std::size_t used = 0;
    const std::int64_t rotors = memory.vehicle.rotors;
    for (std::size_t index = 0; index < time_ns.size; ++index) {
        Signals sample = signals_in(samples.data + index * channels_of(rotors), rotors);
        prepare_sample(memory, time_ns[index], sample, out.verdicts[index], used, out);
        used += out.verdicts[index].usable ? 1 : 0;
    }
    return used;
}

}  // namespace quadpi
