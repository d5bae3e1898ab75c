# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What battery, autopilot and link say of themselves, in a few words beside the state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple


class Told(NamedTuple):
    """Words for one thing, from a stamp on; 0 is at once."""

    time_ns: int
    name: str
    words: str


# After this long [s] without a message it is said that none comes: an autopilot sends each at 0.5 Hz or more.
TOLD_S = 5.0
NO_MESSAGE = f"no message for {TOLD_S:.0f} s"


class Report(NamedTuple):
    """Fields that are read of a message, with how many numbers each has (0: text), and the words for them."""

    name: str
    fields: dict[str, int]
    words: Callable[[Mapping[str, Any]], str]


def _battery(given: Mapping[str, Any]) -> str:
    voltage, share = float(given["voltage"]), float(given["percentage"])
    # NaN where it is not measured.
    known = [f"{voltage:.1f} V"] if math.isfinite(voltage) else []
    known += [f"{100.0 * share:.0f} %"] if 0.0 <= share <= 1.0 else []
    return ", ".join(known) or "not measured"


def _autopilot(given: Mapping[str, Any]) -> str:
    armed = "armed" if given["armed"] else "not armed"
    link = "" if given["connected"] else ", link lost"
    mode = given["mode"].decode(errors="replace") if isinstance(given["mode"], bytes) else given["mode"]
    return f"{mode or 'unknown'}, {armed}{link}"


REPORTS = {
    "sensor_msgs/msg/BatteryState": Report("battery", {"voltage": 1, "percentage": 1}, _battery),
    "mavros_msgs/msg/State": Report("flight mode", {"connected": 1, "armed": 1, "mode": 0}, _autopilot),
}
