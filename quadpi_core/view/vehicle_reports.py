# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What battery, autopilot and link say of themselves, in a few words beside the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple


class Told(NamedTuple):
    """Words for one thing, from a stamp on; 0 is at once."""

    time_ns: int
    name: str
    words: str


class Report(NamedTuple):
    """Fields that are read of a message, with how many numbers each has (0: text), and the words for them."""

    fields: dict[str, int]
    words: Callable[[Mapping[str, Any]], dict[str, str]]


def _battery(given: Mapping[str, Any]) -> dict[str, str]:
    share = float(given["percentage"])
    # NaN where it is not measured.
    known = f", {100.0 * share:.0f} %" if 0.0 <= share <= 1.0 else ""
    return {"battery": f"{given['voltage']:.1f} V{known}"}


def _autopilot(given: Mapping[str, Any]) -> dict[str, str]:
    armed = "armed" if given["armed"] else "not armed"
    link = "connected" if given["connected"] else "lost"
    mode = given["mode"].decode(errors="replace") if isinstance(given["mode"], bytes) else given["mode"]
    return {"flight mode": f"{mode or 'unknown'}, {armed}", "link": link}


REPORTS = {
    "sensor_msgs/msg/BatteryState": Report({"voltage": 1, "percentage": 1}, _battery),
    "mavros_msgs/msg/State": Report({"connected": 1, "armed": 1, "mode": 0}, _autopilot),
}
