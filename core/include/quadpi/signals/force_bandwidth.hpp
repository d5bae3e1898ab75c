// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Attitudes by the rates alone, in which forces are smoothed; see signals/force_bandwidth.py.
#pragma once

#include "quadpi/signals/chain.hpp"

namespace quadpi {

// Fill the attitudes since the first sample: they hardly drift in a smoothing time.
//
// time: (N,) s.
// rates: (N,) rad/s.
inline void turn_by_rates(
    Records<const double> time, Records<const Vector3> rates, Records<Quaternion> attitudes
) {
    for (std::size_t k = 0; k < time.size; ++k) {
        if (k == 0) {
            attitudes[0] = {1.0, 0.0, 0.0, 0.0};
            continue;
        }
        const double half = 0.5 * (time[k] - time[k - 1]);
        Vector3 turn;
        for (int axis = 0; axis < 3; ++axis) {
            turn[axis] = half * (rates[k][axis] + rates[k - 1][axis]);
        }
        attitudes[k] = product(attitudes[k - 1], from_rotation_vector(turn));
        scale_to_unit(attitudes[k]);
    }
}

}  // namespace quadpi
