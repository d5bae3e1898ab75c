// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What each direction in which a vehicle may have changed does to a block; see monitor/change.py.
#pragma once

#include "quadpi/monitor/change_state.hpp"

namespace quadpi {

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

}  // namespace quadpi
