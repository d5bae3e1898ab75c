// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What is known and remembered of the evidence that the vehicle has changed; see monitor/change.py.
#pragma once

#include "quadpi/monitor/rotor_thrust.hpp"

namespace quadpi {

constexpr int FX = 0, FY = 1, FZ = 2;

// Time [ns] over which residuals are averaged to one observation.
constexpr std::int64_t BLOCK_NS = 100'000'000;
// Time [s] of a block that samples must fill.
constexpr double BLOCK_FILLED_S = 0.05;
// Blocks for which a moment is followed at which the change may have begun.
constexpr int ONSETS = 30;
// Sizes that are tried in either direction, each twice the one before, and the least one, in shares of what
// a direction changes.
constexpr int DOUBLINGS = 6, SIZES = 2 * DOUBLINGS;
constexpr double LEAST_SIZE = 0.015;

// What may have changed. A rotor gives less thrust, with its arm (LESS_1 and its number), or its speed reads
// more, with the arm that the model has for it (MORE_1 and its number).
enum Direction : int { LIFT, PUSH_FORWARD, PUSH_RIGHT, BALANCE_FORWARD, BALANCE_RIGHT, LESS_1 };
constexpr int MORE_1 = LESS_1 + static_cast<int>(ROTORS_MAX);
constexpr int DIRECTIONS = MORE_1 + static_cast<int>(ROTORS_MAX);
constexpr std::int64_t NOTHING = -1;

// What flights leave of a model on one axis, in N or Nm: y = constant of the flight + process + white noise.
struct AxisNoise {
    double mean;     // of the constants
    double between;  // variance of the constant of one more flight
    double walk;     // variance by which the constant walks in a block
    double keep;     // share of the process that a block leaves
    double process;  // variance of the process
    double white;    // variance of the noise of a block's mean
    double tail;     // 3 times the squared scale of Student's distribution of the whitened residuals
    double loudest;  // largest running mean of their squares in any flight; 0 for an axis that is not known
};

// Changes of the inputs from block to block that tell what a model leaves of the last of them.
constexpr int INPUT_CHANGES = 2;

// What a model leaves in every flight where inputs change, which is no evidence.
struct Repeating {
    InputVector lower, upper;  // largest fall and rise in the flights; changes beyond count as these
    // N or Nm per unit by which an input changes, the latest change first; all 0 where no flights told.
    std::array<std::array<InputVector, INPUT_CHANGES>, AXES> slopes;
};

// What sound flights leave of a model, and the vehicle.
struct ChangeLimits {
    double evidence;  // of an alarm; 0 where no flights told what is sound
    double weight;    // N
    double arm;       // m, mean distance of the rotors
    // Change of Fz, Mx, My per newton that a rotor loses, as the model has it: about 1, m, m.
    std::array<Vector3, ROTORS_MAX> lever;
    std::array<AxisNoise, AXES> noise;
    Repeating repeating;
};

// Mean of a block of samples.
struct ChangeBlock {
    std::int64_t number;  // of BLOCK_NS since the epoch
    Wrench residual;      // measured − predicted
    double lift;          // N, predicted
    PerRotor squares;     // (rad/s)² of the rotors
    InputVector inputs;
};

// A block and how far samples fill it: their sums until it ends, then their means.
struct Gathered {
    ChangeBlock sum;
    double filled_s, samples;
};

// Inputs of a block that has passed.
struct BlockInputs {
    std::int64_t number;
    InputVector inputs;
};

// Two parts of an axis: its constant and its process.
struct Parts {
    double constant, process;
};

// Kalman filter of one axis, and how the last block looks to it.
struct AxisFilter {
    Parts mean, gain;
    double of_constant, of_both, of_process;  // covariance
    double spread;                            // standard deviation of the block before it was seen
    double surprise;                          // its error over `spread`
    double loudness;                          // running mean of the squared surprises
};

// A moment at which a change may have begun, with the evidence for each direction and size.
struct Onset {
    std::int64_t number;  // of its block
    std::int64_t age;     // in blocks
    double prior;
    // How each direction, were its size 1, would have moved the filters of its axes.
    std::array<std::array<Parts, 3>, DIRECTIONS> moved;
    std::array<std::array<double, SIZES>, DIRECTIONS> wealth;  // at the end of the last half second
    std::array<std::array<double, SIZES>, DIRECTIONS> gain;    // since then
    // Sums for the least squares of a direction's size.
    std::array<double, DIRECTIONS> squares, products;
};

// What has changed, as it is published.
struct ChangeFound {
    std::int64_t direction;   // of Direction, or NOTHING
    std::int64_t since_ns;    // start of the block in which it began
    std::int64_t from_start;  // whether that is the first block since take-off
    double size;              // in shares of what the direction changes
    double deviation;         // standard deviation of the size
    double explained;         // squared surprises that it explains
};

constexpr ChangeFound NOTHING_FOUND = {NOTHING, 0, 0, 0.0, 0.0, 0.0};

// What Fz says of a load, against a model that may be off.
struct Load {
    std::int64_t blocks;
    std::array<double, SIZES> wealth;
    double won;  // what all bets have won, less what was put on them
    // Since the bets were last lost, and sums for the least squares of the size since then.
    std::int64_t since, from_start;
    double squares, products;
};

// All that is remembered of a flight.
struct Change {
    Gathered within, beyond;  // the inputs of the training flights
    Load load;
    std::int64_t blocks;                            // taken since take-off
    std::int64_t last;                              // number of the last block
    std::array<BlockInputs, INPUT_CHANGES> before;  // the last blocks, the latest first
    std::array<AxisFilter, AXES> filters;
    std::array<Onset, ONSETS> onsets;
    double settled;  // evidence of moments that are no longer followed
    double spent;    // of the prior
    double evidence;
    double score;                // logarithm of the evidence over that of its limit, at least 0
    std::int64_t raised_number;  // of the block after which the alarm was raised
    bool raised;
    bool loud;        // louder than any flight that told what is sound
    double unlike_s;  // for which the flight still counts as unlike those
    ChangeFound found;
};

}  // namespace quadpi
