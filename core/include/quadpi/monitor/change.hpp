// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Evidence that a vehicle has changed, and of what, by the sizes of residuals; see monitor/change.py.
#pragma once

#include <numeric>

#include "quadpi/elementary.hpp"
#include "quadpi/monitor/axis_filter.hpp"
#include "quadpi/monitor/directions.hpp"
#include "quadpi/monitor/repeating_part.hpp"

namespace quadpi {

// Share of the evidence of the likeliest moment that another one needs to be named.
constexpr double LIKELY = 0.1;
// Half as large again as the largest size that is bet on.
constexpr double MOST_SIZE = 1.5 * LEAST_SIZE * (1 << (DOUBLINGS - 1));
// Deviation of a named size over that of least squares, as part and moment are chosen for being large: on
// altered flights intervals of 95 % hold then (experiments/results/alarm.md).
constexpr double CHOSEN = 2.0;
// Blocks of half a second, in which the evidence grows by CAP at most, e to the 8, and by LATE_CAP, e to the
// 9, of moments after the first second, in which sound flights gather most (experiments/results/alarm.md).
constexpr std::int64_t CAP_BLOCKS = 5, LATER = 10;
constexpr double CAP = 2980.9579870417283, LATE_CAP = 8103.083927575384;
// Share of the lift by which a model may be off where a load is weighed: of 14 flights beyond those of their
// models, ten of them by two models, none is by more than 0.021 throughout, nor by more than 0.042 for half a
// second without a load that swings (experiments/results/alarm.md). From halfway to the first size on, 9 %,
// one is told.
constexpr double OFF_MOST = 0.06;
constexpr int FIRST_LOAD = 6;  // of the sizes: 12 %
// Standard deviation of blocks there, as a share of the lift: theirs is 0.008, of NeuroBEM 0.02.
constexpr double SCATTER = 0.02;
// What a block counts for at most, e to the 2.5, and the evidence of the alarm: three blocks in a row raise
// none, but the first of a flight. Of sound flights one in 400 does, if blocks err independently.
constexpr double BLOCK_CAP = 12.182493960703473, LOAD_EVIDENCE = 400.0;
// Prior of all sizes of mass over that of those that are large enough.
constexpr double OF_LARGE = 2.0;
// Degrees of freedom of Student's distribution; share of the prior below which a size is no longer followed.
constexpr double FREEDOM = 3.0, RUIN = 1e-12;
constexpr std::int64_t PAUSE_MOST = 100;  // longer pauses [blocks] count as this long

// What a block says of one direction from an onset on.
struct Response {
    int axes;
    double sound;                              // product over the axes of 1 + surprise² / tail
    std::array<double, 3> error, moved, tail;  // surprise, its change by the direction, and the tail
};

// Move the filters' answer to a direction on by one block.
inline Response answer(
    const ChangeLimits& limits,
    const std::array<AxisFilter, AXES>& filters,
    const Template& direction,
    std::array<Parts, 3>& moved
) {
    Response response{direction.axes, 1.0, {}, {}, {}};
    for (int i = 0; i < direction.axes; ++i) {
        const AxisFilter& filter = filters[direction.axis[i]];
        const AxisNoise& noise = limits.noise[direction.axis[i]];
        const double error = direction.change[i] - moved[i].constant - moved[i].process;
        moved[i].constant += filter.gain.constant * error;
        moved[i].process += filter.gain.process * error;
        const double share = quieter(filter);
        response.error[i] = filter.surprise * share;
        response.moved[i] = error / filter.spread * share;
        response.tail[i] = noise.tail;
        response.sound *= 1.0 + response.error[i] * response.error[i] / noise.tail;
    }
    return response;
}

inline double cap_of(const Onset& onset) { return onset.prior < prior_of_onset(LATER) ? LATE_CAP : CAP; }

// Take the likelihood ratio of each size; returns the evidence of the direction.
//
// With 3 degrees of freedom the density of Student's distribution goes with (1 + z² / tail)⁻².
inline double bet(const Response& response, int direction, Onset& onset, bool settle) {
    std::array<double, SIZES>&wealth = onset.wealth[direction], &gain = onset.gain[direction];
    const double cap = cap_of(onset);
    constexpr std::array<double, SIZES> size = sizes();
    std::array<double, SIZES> changed;
    changed.fill(1.0);
    for (int i = 0; i < response.axes; ++i) {
        const double error = response.error[i], moved = response.moved[i], tail = 1.0 / response.tail[i];
        for (int index = 0; index < SIZES; ++index) {
            const double rest = error - size[index] * moved;
            changed[index] *= 1.0 + rest * rest * tail;
        }
    }
    double total = 0.0;
    for (int index = 0; index < SIZES; ++index) {
        const double ratio = response.sound / changed[index];
        gain[index] *= ratio * ratio;
        changed[index] = wealth[index] * std::min(gain[index], cap);
        total += changed[index];
    }
    if (settle) {
        for (int index = 0; index < SIZES; ++index) {
            wealth[index] = changed[index] < RUIN ? 0.0 : changed[index];
        }
        gain.fill(1.0);
    }
    return total;
}

// Begin to follow the moment of a block in the place of the one that has been followed for longest.
inline void begin_onset(const Templates& templates, Change& change) {
    Onset& onset = change.onsets[change.blocks % ONSETS] = {};
    onset.number = change.within.sum.number;
    const bool is_unlike = change.blocks == 0 && change.unlike_s + change.spent > 0.0;
    onset.prior = is_unlike ? 0.0 : prior_of_onset(change.blocks);
    change.spent += onset.prior;
    const std::array<double, DIRECTIONS> of_direction = prior_of_directions(templates);
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        onset.wealth[direction] = prior_of_sizes(direction);
        scale(onset.wealth[direction], of_direction[direction]);
        onset.gain[direction].fill(1.0);
    }
}

inline void name_if_likelier(ChangeFound found, ChangeFound& named) {
    if (found.explained > named.explained) {
        // What is larger than any bet was on has no name.
        if (std::abs(found.size) > MOST_SIZE) {
            found.direction = NOTHING;
            found.size = found.deviation = 0.0;
        }
        named = found;
    }
}

// Name the moment and the direction that explain most of the squared surprises since then.
//
// The evidence of a large change is at its cap for several of them. Moments after the alarm was raised only
// see what the filters have not yet taken for their own.
inline void find_change(Change& change, const std::array<double, ONSETS>& evidence) {
    const double least = LIKELY * change.evidence;
    for (int place = 0; place < ONSETS; ++place) {
        const Onset& onset = change.onsets[place];
        if (evidence[place] < least || onset.number > change.raised_number) {
            continue;
        }
        for (int direction = 0; direction < DIRECTIONS; ++direction) {
            const double squares = onset.squares[direction];
            const double size = squares > 0.0 ? onset.products[direction] / squares : 0.0;
            name_if_likelier(
                {direction,
                 onset.number * BLOCK_NS,
                 onset.prior == FROM_START ? 1 : 0,
                 size,
                 CHOSEN / std::sqrt(squares),
                 size * size * squares},
                change.found
            );
        }
    }
}

// Move the filters on to a block; returns the blocks that have passed since the one before.
inline std::int64_t take_residuals(const ChangeLimits& limits, Change& change) {
    const ChangeBlock& block = change.within.sum;
    if (change.blocks == 0) {
        change.last = block.number;
        for (int axis = 0; axis < AXES; ++axis) {
            begin_filter(limits.noise[axis], change.filters[axis]);
        }
    }
    const std::int64_t passed = std::min(block.number - change.last, PAUSE_MOST);
    change.last = block.number;
    change.loud = false;
    for (int axis = 0; axis < AXES; ++axis) {
        const AxisNoise& noise = limits.noise[axis];
        AxisFilter& filter = change.filters[axis];
        if (noise.loudest > 0.0) {
            for (std::int64_t k = 0; k < passed; ++k) {
                pass_block(noise, filter);
            }
            take_residual(noise, filter, block.residual[axis]);
            change.loud = change.loud || filter.loudness > noise.loudest;
        }
    }
    return passed;
}

// Keep what the moment that has been followed for longest says, before another takes its place.
inline void settle_oldest(Change& change) {
    if (change.blocks < ONSETS) {
        return;
    }
    const Onset& oldest = change.onsets[change.blocks % ONSETS];
    const double cap = cap_of(oldest);
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        for (int index = 0; index < SIZES; ++index) {
            change.settled +=
                oldest.prior * oldest.wealth[direction][index] * std::min(oldest.gain[direction][index], cap);
        }
    }
}

// What a block says of each direction, if it began to change at an onset; returns the evidence of all.
inline double follow_onset(
    const ChangeLimits& limits, const Templates& templates, std::int64_t passed, Change& change, Onset& onset
) {
    double total = 0.0;
    const bool settle = ++onset.age % CAP_BLOCKS == 0;
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        const Template& own = templates[direction];
        if (own.axes == 0) {
            continue;
        }
        std::array<Parts, 3>& moved = onset.moved[direction];
        for (int i = 0; i < own.axes && onset.age > 1; ++i) {
            for (std::int64_t k = 0; k < passed; ++k) {
                moved[i].process *= limits.noise[own.axis[i]].keep;
            }
        }
        const Response response = answer(limits, change.filters, own, moved);
        for (int i = 0; i < own.axes; ++i) {
            onset.squares[direction] += response.moved[i] * response.moved[i];
            onset.products[direction] += response.moved[i] * response.error[i];
        }
        total += bet(response, direction, onset, settle);
    }
    return onset.prior * total;
}

// Whether the alarm is raised by now, by the evidence of all changes or that of a load.
inline bool raises(const ChangeLimits& limits, Change& change, std::int64_t number) {
    const double by_all = logarithm(std::max(1.0, change.evidence)) / logarithm(limits.evidence);
    const double by_load = logarithm(std::max(1.0, 1.0 + change.load.won)) / logarithm(LOAD_EVIDENCE);
    change.score = std::max(by_all, by_load);
    if (!change.raised && change.score > 1.0) {
        change.raised = true;
        change.raised_number = number;
    }
    return change.raised;
}

// Take the mean of a block of samples.
inline void take_block(const ChangeLimits& limits, const RotorGeometry& rotors, Change& change) {
    take_repeating(limits.repeating, change);
    const Templates templates = templates_of(limits, rotors, change.within.sum);
    const std::int64_t passed = take_residuals(limits, change);
    settle_oldest(change);
    begin_onset(templates, change);
    ++change.blocks;

    std::array<double, ONSETS> evidence{};
    double total = 1.0 - change.spent + change.settled;
    for (int place = 0; place < std::min<std::int64_t>(change.blocks, ONSETS); ++place) {
        evidence[place] = follow_onset(limits, templates, passed, change, change.onsets[place]);
        total += evidence[place];
    }
    for (AxisFilter& filter : change.filters) {
        remember_loudness(filter);
    }
    change.evidence = total;
    if (raises(limits, change, change.last)) {
        find_change(change, evidence);
    }
}

// Weigh a load by a block, within or beyond the inputs of the training flights.
//
// The null is a model that is off by any share of the lift up to OFF_MOST: its likeliest is the end that is
// next to the load.
inline void take_load(const ChangeLimits& limits, const ChangeBlock& block, Change& change) {
    constexpr std::array<double, SIZES> size = sizes(), of_size = prior_of_sizes(LIFT);
    Load& load = change.load;
    const AxisNoise& noise = limits.noise[FZ];
    const double prior = prior_of_onset(load.blocks);
    if (std::accumulate(load.wealth.begin(), load.wealth.end(), 0.0) < prior) {
        load.since = block.number;
        load.from_start = load.blocks == 0 ? 1 : 0;
        load.squares = load.products = 0.0;
    }
    ++load.blocks;
    const double force = block.residual[FZ], scatter = SCATTER * block.lift;
    const double variance = noise.process + noise.white + scatter * scatter;
    load.squares += block.lift * block.lift / variance;
    load.products += block.lift * force / variance;
    // A rotor turns the vehicle by its arm, which a mass does not.
    const double roll = block.residual[3], pitch = block.residual[4], half = 0.5 * limits.arm * force;
    const bool turns = roll * roll + pitch * pitch > half * half;
    for (int index = FIRST_LOAD; index < SIZES; ++index) {
        const double off = force - std::copysign(OFF_MOST, size[index]) * block.lift;
        const double rest = force - size[index] * block.lift;
        const double ratio = (FREEDOM * variance + off * off) / (FREEDOM * variance + rest * rest);
        const double before = load.wealth[index] + prior * of_size[index] * OF_LARGE;
        load.wealth[index] = before * std::min(ratio * ratio, turns ? 1.0 : BLOCK_CAP);
        load.won += load.wealth[index] - before;
    }
    if (raises(limits, change, block.number) && load.won > LOAD_EVIDENCE) {
        const double found = load.products / load.squares;
        name_if_likelier(
            {LIFT,
             load.since * BLOCK_NS,
             load.from_start,
             found,
             CHOSEN / std::sqrt(load.squares) + 0.5 * OFF_MOST,
             found * found * load.squares},
            change.found
        );
    }
}

// End the block that a sample is no longer of, and begin the next; its means are taken, if samples fill
// enough of it.
template <typename Take>
void end_block(Gathered& gathered, std::int64_t number, const Take& take) {
    ChangeBlock& block = gathered.sum;
    if (number == block.number) {
        return;
    }
    if (gathered.filled_s >= BLOCK_FILLED_S && block.lift > 0.0) {
        const double share = 1.0 / gathered.samples;
        scale(block.residual, share);
        scale(block.squares, share);
        scale(block.inputs, share);
        block.lift *= share;
        take();
    }
    gathered = {};
    block.number = number;
}

// Add a sample that the model is judged on.
//
// error: measured − predicted.
// step_s: since the sample before.
inline void add_to_block(
    Gathered& gathered,
    const Wrench& error,
    double lift,
    const PerRotor& rotor_speeds,
    const InputVector& inputs,
    double step_s
) {
    ChangeBlock& block = gathered.sum;
    for (int axis = 0; axis < AXES; ++axis) {
        block.residual[axis] += error[axis];
    }
    for (std::size_t k = 0; k < rotor_speeds.size(); ++k) {
        block.squares[k] += rotor_speeds[k] * rotor_speeds[k];
    }
    for (int k = 0; k < INPUTS; ++k) {
        block.inputs[k] += inputs[k];
    }
    block.lift += lift;
    gathered.samples += 1.0;
    gathered.filled_s += step_s;
}

// Forget what was gathered, as on the ground.
inline void forget_change(Change& change) {
    change.within = change.beyond = {};
    change.load = {};
    change.blocks = 0;
    change.spent = change.evidence = change.score = change.settled = change.unlike_s = 0.0;
    change.raised = change.loud = false;
    change.found = NOTHING_FOUND;
}

}  // namespace quadpi
