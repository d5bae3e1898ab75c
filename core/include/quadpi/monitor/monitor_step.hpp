// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Samples through the whole monitor: preparation, model, intervals that adapt, alarm; see monitor/monitor.py.
//
// One sample and blocks of any length take the same way and give the same bits. Nothing is allocated.
#pragma once

#include "quadpi/models/evaluation.hpp"
#include "quadpi/monitor/adaptive.hpp"
#include "quadpi/monitor/alarm.hpp"
#include "quadpi/monitor/preparation.hpp"

namespace quadpi {

// Samples that go from stage to stage together, as they stay in the cache; of more, one piece after the
// other.
constexpr std::size_t MONITOR_BLOCK = 256;

// What a monitor knows and remembers, but for the preparation, which others may share.
struct MonitorMemory {
    const AlarmLimits& limits;
    AlarmState& alarm;
    Records<AdaptiveMemory> adaptive;  // one, or none where intervals do not adapt
    const Wrench& factors;             // half width of each axis' interval per unit of spread
};

// Samples between the stages: K, of which U are usable.
struct MonitorBlock {
    std::array<Verdict, MONITOR_BLOCK> verdicts;
    // Of the usable ones.
    std::array<InputVector, MONITOR_BLOCK> inputs;
    std::array<Wrench, MONITOR_BLOCK> measured;
    std::array<Derivatives, MONITOR_BLOCK> derivatives;
    std::array<Wrench, MONITOR_BLOCK> predicted, lower, upper, leverage, relative_width;
    std::array<Wrench, MONITOR_BLOCK> added;  // by the state, see widen(); zero where nothing is
    std::size_t samples, used;

    Evaluation evaluation() {
        return {predicted.data(), lower.data(), upper.data(), leverage.data(), relative_width.data()};
    }

    PreparedSamples prepared() {
        return {
            {verdicts.data(), samples},
            {inputs.data(), MONITOR_BLOCK},
            {measured.data(), MONITOR_BLOCK},
            {derivatives.data(), MONITOR_BLOCK},
        };
    }

    // Put a usable sample in the place of one before it, where its derivatives are no longer needed.
    void move(std::size_t from, std::size_t to) {
        inputs[to] = inputs[from];
        measured[to] = measured[from];
        for (Wrench* said :
             {predicted.data(), lower.data(), upper.data(), leverage.data(), relative_width.data()}) {
            said[to] = said[from];
        }
    }
};

// Rows that a monitor fills, room for one of each per sample.
struct MonitorRows {
    Records<std::int64_t> time_ns;  // of the predictions
    Records<Wrench> wrenches;       // (5, K): predicted, lower, upper, measured, relative width
    Records<AlarmRow> alarms;       // none where the alarm is not wanted
    std::size_t predictions = 0, raised = 0;

    Wrench& wrench(std::size_t column) const { return wrenches[column * time_ns.size + predictions]; }
};

// Write the predictions of a block. A sample one of whose numbers overflows is no longer usable.
inline void write_predictions(const MonitorMemory& memory, MonitorBlock& block, MonitorRows& rows) {
    std::size_t kept = 0, row = 0;
    for (std::size_t sample = 0; sample < block.samples; ++sample) {
        Verdict& verdict = block.verdicts[sample];
        if (!verdict.usable) {
            continue;
        }
        const Wrench &own_lower = block.lower[row], &own_upper = block.upper[row];
        Wrench lower = own_lower, upper = own_upper;
        if (memory.adaptive.size > 0) {
            adapt(memory.adaptive[0], block.measured[row], own_lower, own_upper, lower, upper);
        }
        verdict.usable = true;
        for (int axis = 0; axis < AXES; ++axis) {
            verdict.usable = verdict.usable && std::isfinite(lower[axis]) && std::isfinite(upper[axis]) &&
                             std::isfinite(block.leverage[row][axis]);
        }
        if (verdict.usable) {
            rows.time_ns[rows.predictions] = verdict.time_ns;
            rows.wrench(0) = block.predicted[row];
            rows.wrench(1) = lower;
            rows.wrench(2) = upper;
            rows.wrench(3) = block.measured[row];
            rows.wrench(4) = block.relative_width[row];
            ++rows.predictions;
            if (kept != row) {
                block.move(row, kept);
            }
            ++kept;
        }
        ++row;
    }
    block.used = kept;
}

// Take a block that is prepared: model, intervals, alarm.
inline void judge(const MonitorMemory& memory, Evaluator& model, MonitorBlock& block, MonitorRows& rows) {
    const std::size_t used = block.used;
    for (Wrench* said : {
             block.predicted.data(),
             block.lower.data(),
             block.upper.data(),
             block.leverage.data(),
             block.relative_width.data(),
         }) {
        std::fill_n(said, used, Wrench{});
    }
    model.evaluate(
        {block.inputs.data(), used}, {block.derivatives.data(), used}, memory.factors, block.evaluation()
    );
    for (std::size_t row = 0; row < used; ++row) {
        widen(block.added[row], block.evaluation(), row);
    }
    write_predictions(memory, block, rows);
    if (rows.alarms.size == 0) {
        return;
    }
    const std::size_t left = block.used;
    rows.raised += advance(
        memory.limits,
        memory.alarm,
        {block.verdicts.data(), block.samples},
        {block.inputs.data(), left},
        {block.measured.data(), left},
        {
            {block.lower.data(), left},
            {block.upper.data(), left},
            {block.leverage.data(), left},
            {block.relative_width.data(), left},
        },
        rows.alarms.part(rows.raised, rows.alarms.size)
    );
}

// Take K samples as the pairing gives them, in rows.
inline void step(
    const MonitorMemory& memory,
    PreparationMemory& preparation,
    Evaluator& model,
    Records<const std::int64_t> time_ns,
    Records<const double> samples,
    MonitorBlock& block,
    MonitorRows& rows
) {
    const std::size_t channels = channels_of(preparation.vehicle.rotors);
    for (std::size_t start = 0; start < time_ns.size; start += block.samples) {
        const std::size_t stop = std::min(time_ns.size, start + MONITOR_BLOCK);
        block.samples = stop - start;
        std::fill_n(block.verdicts.begin(), block.samples, Verdict{});
        const auto rows_of_block = samples.part(start * channels, stop * channels);
        block.used = prepare(preparation, time_ns.part(start, stop), rows_of_block, block.prepared());
        std::fill_n(block.added.begin(), block.used, Wrench{});
        judge(memory, model, block, rows);
    }
}

// Samples that somebody else prepared: K verdicts, and of the U usable ones the rest.
struct GivenSamples {
    Records<const Verdict> verdicts;
    Records<const InputVector> inputs;
    Records<const Wrench> measured;
    Records<const Derivatives> derivatives;
    Records<const Wrench> added;  // by their states, see widen(); or none
};

// Take K samples that are prepared.
inline void judge_given(
    const MonitorMemory& memory,
    Evaluator& model,
    const GivenSamples& given,
    MonitorBlock& block,
    MonitorRows& rows
) {
    std::size_t taken = 0;
    for (std::size_t start = 0; start < given.verdicts.size; start += block.samples) {
        const std::size_t stop = std::min(given.verdicts.size, start + MONITOR_BLOCK);
        block.samples = stop - start;
        block.used = 0;
        for (const Verdict& verdict : given.verdicts.part(start, stop)) {
            block.verdicts[&verdict - &given.verdicts[start]] = verdict;
            if (verdict.usable) {
                block.inputs[block.used] = given.inputs[taken];
                block.measured[block.used] = given.measured[taken];
                block.derivatives[block.used] = given.derivatives[taken];
                block.added[block.used] = given.added.size > 0 ? given.added[taken] : Wrench{};
                ++block.used, ++taken;
            }
        }
        judge(memory, model, block, rows);
    }
}

// What somebody else has said of N samples (5, N), handed out block by block in the place of a model.
class SaidBefore final : public Evaluator {
public:
    explicit SaidBefore(Records<const Wrench> evaluation) : said(evaluation) {}

    void evaluate(
        Records<const InputVector> inputs, Records<const Derivatives>, const Wrench&, const Evaluation& out
    ) override {
        const Wrench* from = said.data + given;
        for (Wrench* to : {out.predicted, out.lower, out.upper, out.leverage, out.relative_width}) {
            std::copy_n(from, inputs.size, to);
            from += said.size / 5;
        }
        given += inputs.size;
    }

private:
    Records<const Wrench> said;
    std::size_t given = 0;
};

}  // namespace quadpi
