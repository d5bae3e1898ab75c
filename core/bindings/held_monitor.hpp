// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// A pairing and a monitor, whose arrays are of Python, and both together.
#pragma once

#include <vector>

#include "bindings/held_model.hpp"
#include "bindings/rotors.hpp"
#include "quadpi/monitor/monitor_step.hpp"
#include "quadpi/monitor/pairing.hpp"

namespace quadpi {

// The whole of a vector.
template <class T>
Records<T> all(std::vector<T>& of) {
    return {of.data(), of.size()};
}

// The arrays of a pairing.
class HeldPairing {
public:
    explicit HeldPairing(nanobind::object its_arrays) : arrays(its_arrays) {
        checked_rotors(state.only().rotors);
    }
    virtual ~HeldPairing() = default;

    Pairing pairing() const { return Pairing(state.only(), rings.all()); }

    // What Python is told after a sample was added.
    virtual nanobind::object completed() { return nanobind::int_(due()); }

    // How many samples take_samples() may give; −1 where it has nothing to do.
    std::int64_t due() const { return pairing().take_is_due() ? state.only().tracks[IMU].count : -1; }

    nanobind::object arrays;
    const Field<PairingState> state{arrays, "state"};
    const Field<Entry> rings{arrays, "rings"};
};

// The arrays of a monitor, and room for a block of samples.
class HeldMonitor {
public:
    explicit HeldMonitor(nanobind::object its_arrays) : arrays(its_arrays) {
        checked_rotors(limits.only().rotors.rotors);
        const nanobind::object its_model = arrays.attr("model");
        if (!its_model.is_none()) {
            model = &nanobind::cast<HeldModel&>(its_model).evaluator();
        }
    }

    MonitorMemory memory() const { return {limits.only(), alarm.only(), adaptive.all(), factors.only()}; }

    nanobind::object arrays;
    const Field<const AlarmLimits> limits{arrays, "limits"};
    const Field<AlarmState> alarm{arrays, "alarm"};
    const Field<AdaptiveMemory> adaptive{arrays, "adaptive"};
    const Field<const Wrench> factors{arrays, "factors"};
    Evaluator* model = nullptr;  // None for one that Python evaluates
    const std::unique_ptr<MonitorBlock> block{new MonitorBlock};
};

// A pairing, and a monitor that judges what each sample completes.
class PairedMonitor final : public HeldPairing {
public:
    explicit PairedMonitor(nanobind::object its_arrays)
        : HeldPairing(its_arrays.attr("pairing").attr("arrays")),
          held(its_arrays),
          taken_ns(alarms.all().size),
          predicted_ns(alarms.all().size),
          taken(taken_ns.size() * channels_of(state.only().rotors)) {
        require(monitor->model != nullptr, "a model that Python evaluates");
        require(state.only().rotors == preparation.only().vehicle.rotors, "of other rotors");
        require(TOPICS * alarms.all().size == rings.all().size, "no room for all that may wait");
        require(wrenches.all().size == 5 * taken_ns.size(), DIFFERENT);
    }

    // How many samples were taken, the stamps of the predictions, and how many rows of the alarm were raised.
    // Where none is complete, or the rate of the IMU has changed, nothing is taken, and it is due().
    nanobind::object completed() override {
        if (pairing().rate_has_changed() || due() < 0) {
            return nanobind::int_(due());
        }
        MonitorRows rows{all(predicted_ns), wrenches.all(), alarms.all()};
        const auto count = static_cast<std::size_t>(pairing().take(all(taken_ns), taken.data()));
        step(
            monitor->memory(),
            preparation.only(),
            *monitor->model,
            {taken_ns.data(), count},
            {taken.data(), taken.size()},
            *monitor->block,
            rows
        );
        nanobind::list stamps;
        for (std::size_t row = 0; row < rows.predictions; ++row) {
            stamps.append(predicted_ns[row]);
        }
        return nanobind::make_tuple(count, stamps, rows.raised);
    }

    const nanobind::object held;
    HeldMonitor* const monitor = nanobind::cast<HeldMonitor*>(held.attr("monitor"));
    const Field<PreparationMemory> preparation{held, "preparation"};
    const Field<Wrench> wrenches{held, "wrenches"};
    const Field<AlarmRow> alarms{held, "alarms"};
    std::vector<std::int64_t> taken_ns, predicted_ns;
    std::vector<double> taken;  // rows of samples
};

}  // namespace quadpi
