// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What a model leaves in every flight where inputs change; see identification/repeating_part.py.
#pragma once

#include <algorithm>

#include "quadpi/monitor/change_state.hpp"

namespace quadpi {

// Take away what a model leaves in every flight, and remember the inputs for the blocks to come.
//
// To a block that is missing nothing has changed, and all of it from there.
inline void take_repeating(const Repeating& known, Change& change) {
    ChangeBlock& block = change.within.sum;
    InputVector later = block.inputs;
    for (int back = 0; back < INPUT_CHANGES; ++back) {
        for (int place = 0; place <= back && place < change.blocks; ++place) {
            const BlockInputs& before = change.before[place];
            if (before.number != block.number - back - 1) {
                continue;
            }
            for (int k = 0; k < INPUTS; ++k) {
                const double rise =
                    std::min(std::max(later[k] - before.inputs[k], known.lower[k]), known.upper[k]);
                for (int axis = 0; axis < AXES; ++axis) {
                    block.residual[axis] -= known.slopes[axis][back][k] * rise;
                }
            }
            later = before.inputs;
        }
    }
    for (int place = INPUT_CHANGES - 1; place > 0; --place) {
        change.before[place] = change.before[place - 1];
    }
    change.before[0] = {block.number, block.inputs};
}

}  // namespace quadpi
