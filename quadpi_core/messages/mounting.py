# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of the samples of a rotated or displaced IMU to the body's axes and origin.

With R the rotation from the IMU's axes to the body's, r the IMU's position in the body, ω = R ω_imu and
α = dω/dt,

    f = R f_imu − α × r − ω × (ω × r).

α is the difference of consecutive gyro samples through a first-order lag of :data:`LAG_S`, so it is late by
that and half a step: the specific force errs by r times what α changes in that time, until α is steady. The
lag keeps stamps that nearly coincide from giving any α; a sample whose rates cannot be gives none either, and
the next one counts from the one before. Its noise, that of the gyro over the lag times r, averages out in
whatever integrates or filters the samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.sample_limits import RATE_MAX_RAD_S, within

LAG_S = 0.001


class Mounting:
    """Converts the samples of one IMU in their order: all at once or one by one, with the same bits.

    Args:
        rotation: (3, 3) from the IMU's axes to the body's, forward-right-down both.
        arm: (3,) m, the IMU's position in the body.
    """

    def __init__(self, rotation: Array, arm: Array) -> None:
        self.rotation = np.ascontiguousarray(rotation, dtype=np.float64)
        self.arm = np.ascontiguousarray(arm, dtype=np.float64)
        self._before_ns = np.full(1, -1, dtype=np.int64)
        self._before = np.zeros((2, 3))
        # Compiled now, not when the first sample waits for it.
        self.move(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 3)))

    def move(self, time_ns: Stamps, rates: Array, force: Array) -> None:
        """Change rates (N, 3) rad/s and specific force (N, 3) m/s² to those of the body, in place."""
        _move(self.rotation, self.arm, self._before_ns, self._before, time_ns, rates, force)

    def or_same(self, before: Mounting | None) -> Mounting:
        """The mounting before if it is the same, as it knows the sample before; else this one."""
        if before is None:
            return self
        same = np.array_equal(before.rotation, self.rotation) and np.array_equal(before.arm, self.arm)
        return before if same else self


@njit(cache=True)
def _move(rotation: Any, arm: Any, before_ns: Any, before: Any, time_ns: Any, rates: Any, force: Any) -> None:
    """See :meth:`Mounting.move`; `before` (2, 3) is the last rates and their derivative."""
    for k in range(time_ns.size):
        omega, f = _product(rotation, rates[k]), _product(rotation, force[k])
        step_ns = time_ns[k] - before_ns[0]
        alpha = before[1].copy()
        known = within(omega, RATE_MAX_RAD_S)
        if before_ns[0] < 0 or step_ns < 0 or step_ns > MAX_GAP_NS:
            alpha[:] = 0.0
        elif known:
            step_s = 1e-9 * step_ns
            alpha += (omega - before[0] - step_s * alpha) / (LAG_S + step_s)
        rates[k] = omega
        force[k] = f - _cross(alpha, arm) - _cross(omega, _cross(omega, arm))
        if known:
            before_ns[0], before[0], before[1] = time_ns[k], omega, alpha


@njit(cache=True)
def _product(matrix: Any, vector: Any) -> Any:
    result = np.empty(3)
    for row in range(3):
        result[row] = matrix[row, 0] * vector[0] + matrix[row, 1] * vector[1] + matrix[row, 2] * vector[2]
    return result


@njit(cache=True)
def _cross(a: Any, b: Any) -> Any:
    result = np.empty(3)
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]
    return result
