// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Evidence that a vehicle has changed, and of what, by the sizes of residuals; see monitor/change.py.
#pragma once

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
// Blocks of half a second, in which the evidence grows by CAP at most: e to the 8.
constexpr std::int64_t CAP_BLOCKS = 5;
constexpr double CAP = 2980.9579870417283;
// Prior of a change that is there from take-off.
constexpr double FROM_START = 0.5;
// Share of the prior for what is heavier, and for rotors that give less than their speed says: the reverse is
// rare.
constexpr double LOSSES = 0.8;
// Prior of each size over that of the one half as large, but of mass: what is large wins any bet soon.
constexpr double RARER = 0.6;
// Prior of mass, of each push, of each balance, of all rotors that give less and of all whose speed reads
// more.
constexpr double OF_MASS = 0.25, OF_PUSH = 0.04, OF_BALANCE = 0.06, OF_LESS = 0.3, OF_MORE = 0.25;
// Number of the block by which half of the rest of the prior is spent.
constexpr double HALF_SPENT = 100.0;
// Share of the prior below which a size is no longer followed.
constexpr double RUIN = 1e-12;
// Longer pauses [blocks] count as this long.
constexpr std::int64_t PAUSE_MOST = 100;

constexpr std::array<double, SIZES> sizes() {
    std::array<double, SIZES> all{};
    for (int k = 0; k < DOUBLINGS; ++k) {
        all[2 * k] = LEAST_SIZE * static_cast<double>(1 << k);
        all[2 * k + 1] = -all[2 * k];
    }
    return all;
}

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

// Take the likelihood ratio of each size; returns the evidence of the direction.
//
// With 3 degrees of freedom the density of Student's distribution goes with (1 + z² / tail)⁻².
inline double bet(
    const Response& response, std::array<double, SIZES>& wealth, std::array<double, SIZES>& gain, bool settle
) {
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
        changed[index] = wealth[index] * std::min(gain[index], CAP);
    }
    for (int index = 0; index < SIZES; ++index) {
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

// Prior of each size of a direction, the positive and the negative one in turn; they add up to 1.
constexpr std::array<double, SIZES> prior_of_sizes(int direction) {
    std::array<double, SIZES> all{};
    double total = 0.0, own = 1.0;
    for (int k = 0; k < DOUBLINGS; ++k, own *= direction == LIFT ? 1.0 : RARER) {
        const double loss = direction == LIFT || direction >= LESS_1 ? LOSSES : 0.5;
        all[2 * k] = loss * own;
        all[2 * k + 1] = (1.0 - loss) * own;
        total += own;
    }
    for (double& share : all) {
        share /= total;
    }
    return all;
}

// Prior of the directions that are known; they add up to 1.
inline std::array<double, DIRECTIONS> prior_of_directions(const Templates& templates) {
    std::array<double, DIRECTIONS> all{};
    const double rotors =
        static_cast<double>(std::count_if(&templates[LESS_1], &templates[MORE_1], [](const Template& own) {
            return own.axes > 0;
        }));
    double total = 0.0;
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        if (templates[direction].axes == 0) {
            continue;
        }
        all[direction] = direction == LIFT             ? OF_MASS
                         : direction < BALANCE_FORWARD ? OF_PUSH
                         : direction < LESS_1          ? OF_BALANCE
                         : direction < MORE_1          ? OF_LESS / rotors
                                                       : OF_MORE / rotors;
        total += all[direction];
    }
    for (double& share : all) {
        share = total > 0.0 ? share / total : 0.0;
    }
    return all;
}

// Begin to follow the moment of a block in the place of the one that has been followed for longest.
inline void begin_onset(const Templates& templates, Change& change) {
    Onset& onset = change.onsets[change.blocks % ONSETS];
    const double block = static_cast<double>(change.blocks);
    onset = {};
    onset.number = change.sum.number;
    // Of the blocks 1, 2, ... the rest of the prior spends HALF_SPENT / (HALF_SPENT + block) up to each.
    onset.prior = change.blocks == 0
                      ? FROM_START
                      : (1.0 - FROM_START) * HALF_SPENT / ((HALF_SPENT + block - 1.0) * (HALF_SPENT + block));
    change.spent += onset.prior;
    const std::array<double, DIRECTIONS> of_direction = prior_of_directions(templates);
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        onset.wealth[direction] = prior_of_sizes(direction);
        for (double& share : onset.wealth[direction]) {
            share *= of_direction[direction];
        }
        onset.gain[direction].fill(1.0);
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
            if (size * size * squares > change.found.explained) {
                // What is larger than any bet was on has no name.
                const bool named = std::abs(size) <= MOST_SIZE;
                change.found = {
                    named ? direction : NOTHING,
                    onset.number * BLOCK_NS,
                    onset.prior == FROM_START ? 1 : 0,
                    named ? size : 0.0,
                    named ? CHOSEN / std::sqrt(squares) : 0.0,
                    size * size * squares,
                };
            }
        }
    }
}

// Move the filters on to a block; returns the blocks that have passed since the one before.
inline std::int64_t take_residuals(const ChangeLimits& limits, Change& change) {
    const ChangeBlock& block = change.sum;
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
    for (int direction = 0; direction < DIRECTIONS; ++direction) {
        for (int index = 0; index < SIZES; ++index) {
            change.settled +=
                oldest.prior * oldest.wealth[direction][index] * std::min(oldest.gain[direction][index], CAP);
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
        total += bet(response, onset.wealth[direction], onset.gain[direction], settle);
    }
    return onset.prior * total;
}

// Take the mean of a block of samples.
inline void take_block(const ChangeLimits& limits, const RotorGeometry& rotors, Change& change) {
    take_repeating(limits.repeating, change);
    const Templates templates = templates_of(limits, rotors, change.sum);
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
    change.score = std::max(0.0, logarithm(total) / logarithm(limits.evidence));
    if (!change.raised && total > limits.evidence) {
        change.raised = true;
        change.raised_number = change.last;
    }
    if (change.raised) {
        find_change(change, evidence);
    }
}

// Begin the next block.
inline void begin_block(Change& change, std::int64_t number) {
    change.sum = {};
    change.sum.number = number;
    change.filled_s = change.samples = 0.0;
}

// Take the block that a sample ends, if samples fill enough of it.
inline void end_block(
    const ChangeLimits& limits, const RotorGeometry& rotors, Change& change, std::int64_t number
) {
    ChangeBlock& block = change.sum;
    if (number == block.number) {
        return;
    }
    if (change.filled_s >= BLOCK_FILLED_S && block.lift > 0.0) {
        const double share = 1.0 / change.samples;
        for (double& of_axis : block.residual) {
            of_axis *= share;
        }
        for (double& square : block.squares) {
            square *= share;
        }
        for (double& input : block.inputs) {
            input *= share;
        }
        block.lift *= share;
        take_block(limits, rotors, change);
    }
    begin_block(change, number);
}

// Add a sample that the model is judged on.
//
// error: measured − predicted.
// step_s: since the sample before.
inline void add_to_block(
    Change& change,
    const Wrench& error,
    double lift,
    const PerRotor& rotor_speeds,
    const InputVector& inputs,
    double step_s
) {
    ChangeBlock& block = change.sum;
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
    change.samples += 1.0;
    change.filled_s += step_s;
}

// Forget what was gathered, as on the ground.
inline void forget_change(Change& change) {
    begin_block(change, 0);
    change.blocks = 0;
    change.spent = change.evidence = change.score = 0.0;
    change.settled = 0.0;
    change.raised = change.loud = false;
    change.unlike_s = 0.0;
    change.found = NOTHING_FOUND;
}

}  // namespace quadpi
