# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the monitor gives for a block of samples, as arrays; one row per message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array


@dataclass(frozen=True)
class Predictions:
    """One row per IMU sample; columns Fx, Fy, Fz (N), Mx, My, Mz (Nm), body forward-right-down.

    Columns of axes that the model does not hold are zero. `relative_width` is that of the
    model's own interval, also where `lower` and `upper` adapt.
    """

    time_ns: Stamps
    predicted: Array
    lower: Array
    upper: Array
    measured: Array
    relative_width: Array


@dataclass(frozen=True)
class Alarms:
    """One row per published alarm state; its evidence is the largest since the row before it.

    Attributes:
        level: (M,) 0 ok, 1 warning, 2 alarm.
        causes: (M,) bit flags, 1 extrapolation, 2 miscoverage, 4 bad data.
        leverage, width: (M, 6) evidence per axis over its alarm threshold; above 1 is beyond training.
        input_excess: (M, 19) how far each input lies outside its training range, in widths of that
            range, zero inside; columns as `quadpi_core.inputs.INPUT_NAMES`.
    """

    time_ns: Stamps
    level: npt.NDArray[np.uint8]
    causes: npt.NDArray[np.uint8]
    leverage: Array
    width: Array
    input_excess: Array
