# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink telemetry: what the autopilot says of the vehicle, with the samples of its reader."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from quadpi_core.errors import LogError
from quadpi_core.field.field_log import FieldLog, Stack
from quadpi_core.field.other_logs import read_other
from quadpi_core.logs.formats.mavlink_tlog import FORMAT, read_records
from quadpi_core.logs.mavlink_samples import SOURCES, is_autopilot
from quadpi_core.logs.reader_steps import Airframe
from quadpi_core.reading_options import ReadingOptions


def read_telemetry_field(path: Path, _number: int | None = None, _poles: int | None = None) -> FieldLog:
    """What one log holds; see :class:`quadpi_core.field.field_log.FieldLog`.

    Raises:
        LogError: if it holds no IMU samples, or is of no multirotor.
    """
    types: dict[int, int] = {}
    imus: Counter[int] = Counter()
    for _, message in read_records(path):
        system, name = message.get_srcSystem(), message.get_type()
        if name == "HEARTBEAT" and is_autopilot(message):
            types.setdefault(system, int(message.type))
        imus[system] += name in SOURCES["imu"]
    # Of several vehicles the reader reads the one that sends the most samples.
    mav_type = types.get(max(imus, key=imus.__getitem__, default=0), 0)
    airframe = Airframe.of_mav_type(f"MAV_TYPE {mav_type}", mav_type)
    if airframe is not None and not airframe.is_multicopter:
        raise LogError(f"{path}: {airframe}; `quadpi report` is for multirotors")
    return replace(read_other(path, ReadingOptions(), None), stack="MAVLink telemetry")


STACK = Stack(FORMAT, read_telemetry_field)
