# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What has changed of a vehicle, in plain words."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from typing import NamedTuple

from quadpi_core.results import (
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    AlarmRows,
)

# Stamps from here on [s] are those of a clock that knows the day: the year 2001.
_OF_A_CLOCK_S = 1e9


class _Words(NamedTuple):
    """A sentence about a size, one where it is negative, and a factor to its unit."""

    positive: str
    negative: str
    unit: str
    factor: float


_WORDS = {
    CHANGED_MASS: _Words(
        "{} heavier, or less thrust of all rotors", "{} lighter, or more thrust of all rotors", "g", 1e3
    ),
    CHANGED_FORCE_FORWARD: _Words("something pushes forward, {}", "something pushes backward, {}", "N", 1.0),
    CHANGED_FORCE_RIGHT: _Words(
        "something pushes to the right, {}", "something pushes to the left, {}", "N", 1.0
    ),
    CHANGED_CENTRE_FORWARD: _Words(
        "centre of gravity {} farther forward", "centre of gravity {} farther back", "mm", 1e3
    ),
    CHANGED_CENTRE_RIGHT: _Words(
        "centre of gravity {} farther right", "centre of gravity {} farther left", "mm", 1e3
    ),
    CHANGED_ROTOR: _Words(
        "rotor {rotor} gives {} less thrust than its speed says",
        "rotor {rotor} gives {} more thrust than its speed says",
        "%",
        1e2,
    ),
}


def change_words(alarms: AlarmRows, row: int) -> list[str]:
    """Such as "12.0 ± 3.0 g heavier, … since 12:41:07 UTC"; none where nothing is named."""
    words = _WORDS.get(int(alarms.changed[row]))
    if words is None:
        return []
    size = words.factor * float(alarms.change_size[row])
    half = 0.5 * words.factor * float(alarms.change_upper[row] - alarms.change_lower[row])
    said = words.positive if size >= 0.0 else words.negative
    since = _time(int(alarms.change_since_ns[row]))
    if alarms.change_from_start[row]:
        since = "this flight is judged"
    named = said.format(_size(abs(size), half, words.unit), rotor=alarms.changed_rotor[row])
    return [f"{named} since {since}"]


def _size(size: float, half: float, unit: str) -> str:
    """With two digits of what it is unsure by, at most."""
    places = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 else 2
    return f"{size:.{places}f} ± {half:.{places}f} {unit}"


def _time(time_ns: int) -> str:
    """Time of the day, or of a clock that does not know it."""
    seconds = 1e-9 * time_ns
    if seconds < _OF_A_CLOCK_S:
        return f"{seconds:.1f} s"
    return f"{datetime.fromtimestamp(time_ns // 10**9, timezone.utc):%H:%M:%S} UTC"
