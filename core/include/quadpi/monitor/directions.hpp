// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What each direction in which a vehicle may have changed does to a block, and how likely it is before any
// evidence; see monitor/change.py.
#pragma once

#include "quadpi/monitor/change_state.hpp"

namespace quadpi {

// Prior of a change that is there from take-off.
constexpr double FROM_START = 0.5;
// Share of the prior for what is heavier, and for rotors that give less: the reverse is rare.
constexpr double LOSSES = 0.8;
// Prior of each size over that of the one half as large, but of mass: what is large wins any bet soon.
constexpr double RARER = 0.6;
// Prior of mass, of each push, of each balance, of all rotors that give less and of all that read more.
constexpr double OF_MASS = 0.25, OF_PUSH = 0.04, OF_BALANCE = 0.06, OF_LESS = 0.3, OF_MORE = 0.25;
// Number of the block by which half of the rest of the prior is spent.
constexpr double HALF_SPENT = 100.0;

constexpr std::array<double, SIZES> sizes() {
    std::array<double, SIZES> all{};
    for (int k = 0; k < DOUBLINGS; ++k) {
        all[2 * k] = LEAST_SIZE * static_cast<double>(1 << k);
        all[2 * k + 1] = -all[2 * k];
    }
    return all;
}

template <std::size_t N>
constexpr void scale(std::array<double, N>& values, double share) {
    for (double& value : values) {
        value *= share;
    }
}

// Axes that a direction changes, and by how much, were its size 1.
struct Template {
    int axes;  // 0 where they are not all known
    std::array<int, 3> axis;
    std::array<double, 3> change;
};
using Templates = std::array<Template, DIRECTIONS>;

inline Template on_axis(const ChangeLimits& limits, int axis, double change) {
    return {limits.noise[axis].loudest > 0.0 ? 1 : 0, {axis, 0, 0}, {change, 0.0, 0.0}};
}

// What each direction would change in a block.
inline Templates templates_of(
    const ChangeLimits& limits, const RotorGeometry& rotors, const ChangeBlock& block
) {
    Templates all{};
    const double turn = block.lift * limits.arm / static_cast<double>(rotors.rotors);
    all[LIFT] = on_axis(limits, 2, block.lift);
    all[PUSH_FORWARD] = on_axis(limits, 0, limits.weight);
    all[PUSH_RIGHT] = on_axis(limits, 1, limits.weight);
    all[BALANCE_FORWARD] = on_axis(limits, 4, -turn);
    all[BALANCE_RIGHT] = on_axis(limits, 3, turn);
    double total = 0.0;
    bool known = true;
    for (int k = 0; k < rotors.rotors; ++k) {
        total += block.squares[k];
    }
    for (const int axis : SHOWN) {
        known = known && limits.noise[axis].loudest > 0.0;
    }
    for (int k = 0; k < rotors.rotors && known && total > 0.0; ++k) {
        const double thrust = block.lift * block.squares[k] / total;
        Template &less = all[LESS_1 + k], &more = all[MORE_1 + k];
        less = more = {3, SHOWN, {}};
        for (std::size_t shown = 0; shown < SHOWN.size(); ++shown) {
            less.change[shown] = thrust * rotors.lever[k][shown];
            more.change[shown] = thrust * limits.lever[k][shown];
        }
    }
    return all;
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
    scale(all, 1.0 / total);
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
    scale(all, total > 0.0 ? 1.0 / total : 0.0);
    return all;
}

// Prior of a moment, by its block since take-off: of the blocks 1, 2, ... the rest of the prior spends
// HALF_SPENT / (HALF_SPENT + block) up to each.
inline double prior_of_onset(std::int64_t number) {
    const double block = static_cast<double>(number);
    return number == 0
               ? FROM_START
               : (1.0 - FROM_START) * HALF_SPENT / ((HALF_SPENT + block - 1.0) * (HALF_SPENT + block));
}

}  // namespace quadpi
