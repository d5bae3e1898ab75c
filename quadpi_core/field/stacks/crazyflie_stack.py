# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Crazyflie: what a log of its micro-SD card holds, and the variables by which it holds more.

Commands are `pwm` (what the motors get, after battery compensation) rather than `motor` (what the controller
asks for). Source: crazyflie-firmware, log groups of the release 2025.12.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from quadpi_core.field.field_log import FieldLog, Series, Setting, Stack, places_of, series_of
from quadpi_core.frames import body_flu_to_frd, quaternion_flu_enu_to_frd_ned, world_enu_to_ned
from quadpi_core.inputs import density_of
from quadpi_core.logs.formats.cfusdlog import FORMAT, Event, decode_events
from quadpi_core.logs.reader_steps import normalised_attitude
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.rotor_order import LAYOUTS

_FULL = 65535.0
_COMMANDS = tuple(
    tuple(pattern.format(motor) for motor in range(1, 5))
    for pattern in ("pwm.m{}_pwm", "motor.m{}", "motor.m{}req")
)
_SPEEDS = tuple(f"rpm.m{motor}" for motor in range(1, 5))
_ATTITUDE = tuple(f"stateEstimate.q{axis}" for axis in "wxyz")


def read_crazyflie_field(path: Path, _number: int | None = None, _poles: int | None = None) -> FieldLog:
    """What one log holds; see :class:`quadpi_core.field.field_log.FieldLog`.

    Raises:
        LogError: if it is damaged beyond reading.
    """
    source = str(path)
    events = decode_events(source, path.read_bytes())
    start_ns = min(int(event.time_ns[0]) for event in events.values() if len(event.time_ns))

    def read(*names: str) -> Series | None:
        for event in events.values():
            if names in event and len(event.time_ns):
                return series_of(event.time_ns, event.stack(names), start_ns)
        return None

    gyro, force = read("gyro.x", "gyro.y", "gyro.z"), read("acc.x", "acc.y", "acc.z")
    imu = read("gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z")
    if imu is not None:
        rates = body_flu_to_frd(np.radians(imu.values[:, :3]))
        imu = Series(imu.time, np.hstack([rates, body_flu_to_frd(imu.values[:, 3:]) * STANDARD_GRAVITY]))
    attitude = read(*_ATTITUDE)
    if attitude is not None:
        unit = normalised_attitude(attitude.values)
        attitude = Series(attitude.time, quaternion_flu_enu_to_frd_ned(unit))
    state = {
        name: own and Series(own.time, world_enu_to_ned(own.values))
        for name, prefix in (("position", ""), ("velocity", "v"))
        for own in [read(*(f"stateEstimate.{prefix}{axis}" for axis in "xyz"))]
    }
    named, commands = next(((names, own) for names in _COMMANDS if (own := read(*names))), (("",), None))
    speeds, battery = read(*_SPEEDS), read("pm.vbatMV") or read("pm.vbat")
    speeds = speeds if speeds and np.any(speeds.values) else None
    air = read("baro.pressure", "baro.temp")
    return FieldLog(
        name=path.name,
        source=source,
        stack="Crazyflie",
        frame="quadcopter X",
        rotors=4,
        imu=imu,
        attitude=attitude,
        velocity=state["velocity"],
        position=state["position"],
        commands=commands and Series(commands.time, np.clip(commands.values / _FULL, 0.0, 1.0)),
        rotor_speeds=speeds and Series(speeds.time, np.abs(speeds.values) * (2.0 * np.pi / 60.0)),
        # In V or mV.
        battery=battery
        and Series(battery.time, battery.values / (1e3 if np.median(battery.values) > 100.0 else 1.0)),
        # In hPa and °C.
        density=air and Series(air.time, density_of(100.0 * air.values[:, :1], air.values[:, 1:])),
        places=places_of(LAYOUTS["crazyflie"]),
        facts={"commands": f"{named[0].partition('.')[0]}, of {_FULL:g}"} if commands else {},
        settings=tuple(_settings(events, {"pwm": named[0].startswith("pwm"), "rpm": speeds is not None})),
        notes=("gyro and acc are in different events; log them in one",)
        if imu is None and gyro and force
        else (),
    )


def _settings(events: Mapping[str, Event], has: Mapping[str, bool]) -> Iterator[Setting]:
    logged = {name for event in events.values() if len(event.time_ns) for name in event.variables}

    def lacking(names: Sequence[str], gains: str) -> Iterator[Setting]:
        missing = [name for name in names if name not in logged]
        if missing:
            present = "not among the variables of the log"
            yield Setting(", ".join(missing), present, "add to config.txt on the card", gains)

    yield from lacking(
        ("gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"),
        "thrust, drag and vibration (500 Hz, one event)",
    )
    yield from lacking(_ATTITUDE, "drag and wind")
    yield from lacking(tuple(f"stateEstimate.v{axis}" for axis in "xyz"), "drag and wind")
    if not has["pwm"]:
        yield from lacking(_COMMANDS[0], "commands behind battery compensation")
    yield from lacking(("pm.vbatMV",), "motor speeds from commands")
    if not has["rpm"]:
        yield from lacking(_SPEEDS, "measured rotor speeds (brushless, or the RPM deck)")


STACK = Stack(FORMAT, read_crazyflie_field)
