# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A number that decides something, with its unit, the reason for its value, and the data that it was set on.

A test finds every :class:`Threshold` of the package and fails when the value is changed or decides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from quadpi_core.core import compiled

Number = TypeVar("Number", float, int, tuple[float, ...])

# Data that many thresholds were set on: flights of the simulated Bebop 2 with hidden effects, whose seeds no
# published figure uses.
DEVELOPMENT = "development cases of the blind benchmark (experiments/discovery.py --development)"
CONVENTION = "none: a convention"


@dataclass(frozen=True)
class Threshold(Generic[Number]):
    """A number that decides.

    Attributes:
        name: in words.
        value: in its unit; several where they form a scale.
        unit: of the value.
        reason: for this value and no other.
        data: that it was set on.
    """

    name: str
    value: Number
    unit: str
    reason: str
    data: str


RATE_MAX_RAD_S = compiled.RATE_MAX_RAD_S
STANDARD_GRAVITY = compiled.STANDARD_GRAVITY
SPECIFIC_FORCE_MAX_M_S2 = compiled.SPECIFIC_FORCE_MAX_M_S2
AIRSPEED_MAX_M_S = compiled.AIRSPEED_MAX_M_S
POSITION_MAX_M = compiled.POSITION_MAX_M
MEASURED_SPEED_MAX_M_S = compiled.MEASURED_SPEED_MAX_M_S
# Of a state. What an estimator is given may be off by any scale: it is normalised.
QUATERNION_NORM_TOLERANCE = compiled.QUATERNION_NORM_TOLERANCE
# Of an attitude in a log or message.
NORM_TOLERANCE = compiled.NORM_TOLERANCE
