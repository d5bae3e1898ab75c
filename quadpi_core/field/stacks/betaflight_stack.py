# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Betaflight and INDIflight: what a Blackbox log holds, and the fields and settings by which it holds more.

Source: Betaflight's blackbox.c, and the Blackbox log viewer for the units of the battery.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from quadpi_core.field.field_log import FRAMES, FieldLog, Setting, Stack, places_of, series_of
from quadpi_core.frames import Array
from quadpi_core.logs.formats.betaflight import (
    FORMAT,
    BlackboxLog,
    decoded_flights,
    imu_of,
    pole_pairs_of,
    pose_of,
    stamps_in,
)
from quadpi_core.rotor_order import LAYOUTS

_MOTORS = tuple(f"motor[{motor}]" for motor in range(8))
_ERPM = tuple(f"eRPM[{motor}]" for motor in range(8))
# Of INDIflight; the filter of the others delays them.
_OMEGA = tuple(tuple(f"{name}[{motor}]" for motor in range(8)) for name in ("omegaUnfiltered", "omega"))
_FIELDS = (
    *("loopIteration", "time", "vbatLatest", *_MOTORS, *_ERPM, *_OMEGA[0], *_OMEGA[1]),
    *(f"{name}[{axis}]" for name in ("gyroADC", "accSmooth", "extPos", "extAtt") for axis in range(3)),
)
_ERPM_PER_COUNT = 100.0
_FACTS = {"craft": "Craft name", "poles": "motor_poles", "idle": "dshot_idle_value"}


def read_betaflight_field(path: Path, number: int | None = None, poles: int | None = None) -> FieldLog:
    """What one flight of a file holds, by its number or the longest; see :class:`.FieldLog`.

    Pairs of poles that the user knows count where the log has none.

    Raises:
        LogError: if no frame can be read.
    """
    source = str(path) if number is None else f"{path}#{number}"
    flights = decoded_flights(path, number, _FIELDS)
    chosen = max(flights, key=lambda one: len(flights[one].columns["time"]))
    log = flights[chosen]
    columns, time_ns = log.columns, stamps_in(log.columns)
    start_ns = int(time_ns[0])
    motors = sum(name in columns for name in _MOTORS)
    imu, pose = imu_of(source, log.headers, columns), pose_of(columns)
    poles = pole_pairs_of(source, log.headers, None) or poles
    texts = log.texts
    ranges = _range_of(texts)
    speeds = _speeds(columns, motors, poles)
    battery = None
    if "vbatLatest" in columns and (scale := _battery_scale(texts)):
        battery = series_of(time_ns, columns["vbatLatest"] * scale, start_ns)
    commands = None
    if motors:
        pulses = np.stack([columns[name] for name in _MOTORS[:motors]], axis=1)
        shares = np.clip((pulses - ranges[0]) / (ranges[1] - ranges[0]), 0.0, 1.0)
        commands = series_of(time_ns, shares, start_ns)
    notes = [f"holds {len(flights)} flights; read is the longest, number {chosen}"] * (len(flights) > 1)
    notes.append(f"commands are the motor fields, taken as {ranges[0]:g} to {ranges[1]:g}")
    return FieldLog(
        name=path.stem if number is None else f"{path.stem}_{number}",
        source=source,
        stack="INDIflight" if "ndiflight" in texts.get("Firmware revision", "") else "Betaflight",
        firmware=" ".join(filter(None, map(texts.get, ("Firmware revision", "Board information")))),
        frame=FRAMES.get(motors, ""),
        rotors=motors or None,
        no_multirotor=f"a log of {motors} motors is of no multicopter" if motors in {1, 2} else "",
        imu=None
        if imu is None
        else series_of(time_ns, np.hstack([imu.angular_velocity, imu.specific_force]), start_ns),
        attitude=None if pose is None else series_of(pose.time_ns, pose.attitude, start_ns),
        position=None if pose is None else series_of(pose.time_ns, pose.position, start_ns),
        commands=commands,
        rotor_speeds=None if speeds is None else series_of(time_ns, speeds, start_ns),
        battery=battery,
        places=places_of(LAYOUTS["betaflight"]) if motors == 4 else None,
        facts={key: f"{texts[name]} ({name})" for key, name in _FACTS.items() if texts.get(name)},
        parameters={name: float(value) for name, value in log.headers.items()},
        settings=tuple(_settings(log, speeds is not None, motors, battery is not None)),
        notes=tuple(notes),
    )


def _range_of(texts: Mapping[str, str]) -> tuple[float, float]:
    """Outputs for rest and full throttle."""
    for names in (("motorOutput",), ("minthrottle", "maxthrottle")):
        found = [float(word) for name in names for word in texts.get(name, "").split(",") if word.isdecimal()]
        if len(found) == 2 and found[1] > found[0]:
            return found[0], found[1]
    return 1000.0, 2000.0


def _battery_scale(texts: Mapping[str, str]) -> float | None:
    """Volts per count; None for firmwares that log what the converter reads."""
    version = re.search(
        r"(Betaflight|Indiflight|INAV) (\d+)\.(\d+)", texts.get("Firmware revision", ""), re.I
    )
    if version is None:
        return None
    number = (int(version[2]), int(version[3]))
    if version[1].lower() != "betaflight" or number >= (4, 0):
        return 0.01
    return 0.1 if number >= (3, 1) else None


def _speeds(columns: Mapping[str, Array], motors: int, pole_pairs: int | None) -> Array | None:
    """Mechanical rad/s (N, R); None where none are logged, or only electrical ones of unknown poles."""
    for names in _OMEGA:
        if motors and all(name in columns for name in names[:motors]):
            omega = np.stack([columns[name] for name in names[:motors]], axis=1)
            return np.abs(omega) if np.any(omega) else None
    if not motors or pole_pairs is None or not all(name in columns for name in _ERPM[:motors]):
        return None
    erpm = np.stack([columns[name] for name in _ERPM[:motors]], axis=1) * _ERPM_PER_COUNT
    return np.abs(erpm) * (2.0 * np.pi / 60.0 / pole_pairs) if np.any(erpm) else None


def _settings(log: BlackboxLog, has_speeds: bool, motors: int, has_battery: bool) -> Iterator[Setting]:
    disabled = f"fields_disabled_mask {log.headers.get('fields_disabled_mask', 0)}"
    off, measured = f"not logged ({disabled})", "measured rotor speeds"
    bidirectional = log.headers.get("dshot_bidir", "not in the log")
    if not has_speeds:
        if any(np.any(log.columns[name]) for name in _ERPM if name in log.columns):
            present = "not in the log, which has electrical speeds"
            yield Setting("motor_poles", present, "update the firmware: newer ones write it", measured)
        elif bidirectional == 1:
            wanted = "`set blackbox_disable_rpm = OFF`; before 4.5 update the firmware"
            yield Setting(
                "Blackbox field RPM", f"not logged (dshot_bidir is 1, {disabled})", wanted, measured
            )
        else:
            yield Setting("dshot_bidir", str(bidirectional), "`set dshot_bidir = ON`", measured)
    for is_there, field, switch, gains in (
        ("accSmooth[0]" in log.columns, "ACC", "acc", "thrust, drag and vibration"),
        (motors, "MOTOR", "motors", "commands"),
        (has_battery, "BATTERY", "bat", "motor speeds from commands"),
    ):
        if not is_there:
            yield Setting(f"Blackbox field {field}", off, f"`set blackbox_disable_{switch} = OFF`", gains)
    if "extPos[0]" not in log.columns:
        wanted = "nothing: Blackbox of this firmware has none that tell drag"
        yield Setting("attitude and velocity", "not in the log", wanted, "drag and wind")


STACK = Stack(FORMAT, read_betaflight_field)
