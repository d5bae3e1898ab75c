# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors do to what happened, before noise: the truth turned, late or misread; (Truth) -> Truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from quadpi_core.frames import Array
from quadpi_core.simulation.truth import Truth

Sensor: TypeAlias = Callable[[Truth], Truth]


def turned_imu(angles: Array) -> Sensor:
    """Accelerometer and gyro turned in the body by a rotation vector (3,) rad."""
    to_sensor = Rotation.from_rotvec(angles).inv()

    def sensor(truth: Truth) -> Truth:
        turned = {name: to_sensor.apply(getattr(truth, name)) for name in ("rates", "angular_acceleration")}
        wrench = np.hstack((to_sensor.apply(truth.wrench[:, :3]), truth.wrench[:, 3:]))
        return replace(truth, wrench=wrench, **turned)

    return sensor


def filtered_late(delay_s: float, lag_s: float) -> Sensor:
    """Rotor speeds through a first-order filter, then a pure delay."""

    def sensor(truth: Truth) -> Truth:
        kept = np.exp(-(truth.time[1] - truth.time[0]) / lag_s)
        speeds = truth.rotor_speeds
        smooth, _ = lfilter([1.0 - kept], [1.0, -kept], speeds, axis=0, zi=kept * speeds[:1])
        late = [np.interp(truth.time - delay_s, truth.time, rotor) for rotor in smooth.T]
        return replace(truth, rotor_speeds=np.stack(late, axis=1))

    return sensor


def misread(change: float) -> Sensor:
    """Rotor speeds read too large by a share."""
    return lambda truth: replace(truth, rotor_speeds=truth.rotor_speeds * (1.0 + change))
