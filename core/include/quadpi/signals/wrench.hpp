// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The measured wrench on a vehicle, by the Newton-Euler equations of a rigid body.
#pragma once

#include "quadpi/rotations.hpp"

namespace quadpi {

constexpr int AXES = 6;  // Fx, Fy, Fz [N], Mx, My, Mz [Nm] in body axes
using Wrench = std::array<double, AXES>;

// Wrench on a rigid body, gravity not included: F = m f, M = I Ω̇ + Ω × IΩ; see signals/wrench.py.
inline Wrench newton_euler(
    const Vector3& specific_force,
    const Vector3& rate,
    const Vector3& acceleration,
    double mass_kg,
    const Matrix3& inertia
) {
    Wrench wrench;
    Vector3 momentum;
    for (int axis = 0; axis < 3; ++axis) {
        wrench[axis] = mass_kg * specific_force[axis];
        momentum[axis] = 0.0;
        wrench[3 + axis] = 0.0;
        for (int other = 0; other < 3; ++other) {
            momentum[axis] += inertia[axis][other] * rate[other];
            wrench[3 + axis] += inertia[axis][other] * acceleration[other];
        }
    }
    wrench[3] += rate[1] * momentum[2] - rate[2] * momentum[1];
    wrench[4] += rate[2] * momentum[0] - rate[0] * momentum[2];
    wrench[5] += rate[0] * momentum[1] - rate[1] * momentum[0];
    return wrench;
}

}  // namespace quadpi
