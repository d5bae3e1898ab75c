# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A number that decides something, with its unit, the reason for its value, and the data that it was set on.

A test finds every :class:`Threshold` of the package and fails when the value is changed or decides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

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
