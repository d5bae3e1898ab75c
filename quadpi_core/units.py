# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that log readers share: stamps from a clock, attitudes of unit length."""

from __future__ import annotations

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

STANDARD_GRAVITY = 9.80665
NORM_TOLERANCE = 0.05


def stamps_ns(source: str, time: Array, seconds_per_unit: float = 1.0) -> Stamps:
    """Integer nanosecond stamps (N,) of a clock (N,) that counts in units of `seconds_per_unit`.

    Raises:
        LogError: if a time is not finite, or too large to be held as nanoseconds.
    """
    seconds = time * seconds_per_unit
    usable = np.isfinite(seconds) & (np.abs(seconds) < np.iinfo(np.int64).max / 1e9)
    if not np.all(usable):
        index = int(np.argmin(usable))
        raise LogError(f"{source}: sample {index}: the time is not a usable number ({time[index]})")
    return np.round(seconds * 1e9).astype(np.int64)


def unit_attitude(source: str, topic: str, attitude: Array) -> Array:
    """Attitude quaternions (N, 4) scaled to unit length; logs store them rounded.

    Samples that are not finite pass as they are: they are judged with the rest of their stream.

    Raises:
        LogError: naming the sample whose norm is not near 1, for then it is not an attitude.
    """
    norm = np.linalg.norm(attitude, axis=1)
    wrong = np.abs(norm - 1.0) > NORM_TOLERANCE
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise LogError(
            f"{source}: topic {topic}: sample {index}: the attitude quaternion has norm {norm[index]:.3g}, "
            "expected 1; are the columns or their order right?"
        )
    unit: Array = attitude / norm[:, np.newaxis]
    return unit
