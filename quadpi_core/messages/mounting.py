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

from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import Vector3, record_dtype

LAG_S = compiled.MOUNTING_LAG_S


class _MountedImu:
    """That of core/include/quadpi/messages/mounting.hpp."""

    rotation: Annotated[Array, 3, 3]
    arm: Vector3
    before_ns: int
    rates: Vector3
    acceleration: Vector3


_MOUNTED = record_dtype(_MountedImu)


class Mounting:
    """Converts the samples of one IMU in their order: all at once or one by one, with the same bits.

    Args:
        rotation: (3, 3) from the IMU's axes to the body's, forward-right-down both.
        arm: (3,) m, the IMU's position in the body.
    """

    def __init__(self, rotation: Array, arm: Array) -> None:
        self.rotation = np.ascontiguousarray(rotation, dtype=np.float64)
        self.arm = np.ascontiguousarray(arm, dtype=np.float64)
        self._imu = np.zeros(1, _MOUNTED)
        self._imu["rotation"], self._imu["arm"], self._imu["before_ns"] = self.rotation, self.arm, -1

    def move(self, time_ns: Stamps, rates: Array, force: Array) -> None:
        """Change rates (N, 3) rad/s and specific force (N, 3) m/s² to those of the body, in place."""
        compiled.move_mounted(self._imu, time_ns, rates, force)

    def or_same(self, before: Mounting | None) -> Mounting:
        """The mounting before if it is the same, as it knows the sample before; else this one."""
        if before is None:
            return self
        same = np.array_equal(before.rotation, self.rotation) and np.array_equal(before.arm, self.arm)
        return before if same else self
