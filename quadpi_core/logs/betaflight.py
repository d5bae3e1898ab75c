# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for Betaflight's Blackbox logs (.bbl, .bfl, .txt), through orangebox.

Betaflight's body axes are forward-left-up. `gyroADC` is in deg/s, `accSmooth` in counts of which the header
`acc_1G` makes one g, `eRPM` (bidirectional DShot) in hundreds of electrical revolutions per minute, time in
µs.
Source: Betaflight's blackbox.c, and the Blackbox log viewer.
"""

from __future__ import annotations

import logging
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import ImuStream, Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array, body_flu_to_frd
from quadpi_core.logs import BLACKBOX_MAGIC
from quadpi_core.logs.autopilot import begins_with, note, require_imu, usable
from quadpi_core.logs.conversion import STANDARD_GRAVITY
from quadpi_core.logs.extras import require
from quadpi_core.logs.rotor_order import ERPM, RotorOrder
from quadpi_core.vehicle import Vehicle

_GYRO = ("gyroADC[0]", "gyroADC[1]", "gyroADC[2]")
_ACCELERATION = ("accSmooth[0]", "accSmooth[1]", "accSmooth[2]")
_ERPM = ("eRPM[0]", "eRPM[1]", "eRPM[2]", "eRPM[3]")
_ITERATION = "loopIteration"
_ERPM_PER_COUNT = 100.0
_HIGH_RESOLUTION = 10.0
# Of flights in one file, the largest; the flash of a flight controller holds fewer.
_FLIGHTS_MAX = 100
# Firmwares log up to 70 fields; their header lines are shorter than 2 kB.
_FIELDS_MAX = 256
_HEADER_LINE_MAX = 8192
# Behind a damaged frame it is read again from its second byte on: so many times the whole flight.
_REWINDS_MAX = 4


def read_betaflight(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> Recording:
    """Read the longest flight of one file, stamped by the flight controller.

    Args:
        path: the log.
        vehicle: as for every reader; the pole pairs make eRPM mechanical.
        order: of the rotors; by default that of Betaflight's standard quad X.

    Raises:
        LogError: if it holds no frame, or no gyro and accelerometer.
        VehicleError: if it holds eRPM and the vehicle file does not give the pole pairs.
    """
    source = str(path)
    headers, columns = _longest(source, path)
    imu = require_imu(source, _imu(source, headers, columns), "gyroADC and accSmooth")
    return Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=_rotor_speeds(source, headers, columns, vehicle, order),
    )


def _longest(source: str, path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Headers and columns of the flight with the most frames."""
    if not begins_with(path, BLACKBOX_MAGIC):
        raise LogError(
            f"{source}: byte 0: not a Blackbox log (it must begin with `{BLACKBOX_MAGIC.decode()}`)"
        )
    require("orangebox", "logs")
    # It reports every damaged byte; what matters of that becomes a note.
    logging.getLogger("orangebox").setLevel(logging.CRITICAL)
    best: tuple[dict[str, Any], dict[str, Array]] | None = None
    flights = _flights(path.read_bytes())
    largest = set(sorted(flights, key=len, reverse=True)[:_FLIGHTS_MAX])
    for number, flight in enumerate(flights, 1):
        if flight not in largest:
            continue
        try:
            parser = _parser(flight)
        except OSError:
            raise
        except Exception as error:  # orangebox raises many kinds for a file that is damaged
            note(source, f"flight {number}: its headers are damaged: {one_line(error)}")
            continue
        found = parser.headers, _columns(source, number, parser)
        if best is None or len(found[1].get("time", ())) > len(best[1].get("time", ())):
            best = found
    if best is None or not len(best[1].get("time", ())):
        raise LogError(f"{source}: no frame of a flight can be read")
    if len(flights) > 1:
        note(source, f"holds {len(flights)} flights; read is the longest")
    return best


def _flights(data: bytes) -> list[bytes]:
    """The flights of one file: each begins with the same header line."""
    first_line = data[: data.find(b"\n") + 1] or data
    return [first_line + rest for rest in data.split(first_line)[1:]]


def _parser(flight: bytes) -> Any:
    """A parser for one flight.

    Each has its own, and a file of its own: orangebox searches a whole file for every flight in it, and
    headers of one would stay in the next.

    Raises:
        ValueError: for headers that no firmware writes, over which orangebox takes time without bound.
    """
    orangebox = require("orangebox", "logs")
    plain: Any = require("orangebox.reader", "logs").Reader

    class Reader(plain):  # type: ignore[misc]
        """Gives up on frames that it would read over and over again."""

        rewound = 0

        def seek(self, n: int) -> None:
            self.rewound += max(self.tell() - n, 0)
            if self.rewound > _REWINDS_MAX * len(self):
                raise ValueError("nearly all of it is damaged")
            super().seek(n)

    position = 0
    while flight.startswith(b"H", position):
        end = flight.find(b"\n", position) + 1 or len(flight)
        line = flight[position:end]
        if len(line) > _HEADER_LINE_MAX or (line.startswith(b"H Field") and line.count(b",") > _FIELDS_MAX):
            raise ValueError(f"byte {position}: a line of {len(line)} bytes with {line.count(b',')} commas")
        position = end
    with tempfile.NamedTemporaryFile(prefix="quadpi.", suffix=".bbl") as file:
        file.write(flight)
        file.flush()
        return orangebox.Parser(Reader(file.name, 1, allow_invalid_header=True))


def _columns(source: str, number: int, parser: Any) -> dict[str, Array]:
    """The columns (N,) of one flight; frames that orangebox cannot tell end it."""
    event_types = require("orangebox.types", "logs").EventType
    wanted = {_ITERATION, "time", *_GYRO, *_ACCELERATION, *_ERPM}
    names = [name for name in parser.field_names if name in wanted]
    places = [parser.field_names.index(name) for name in names]
    rows = []
    try:
        for frame in parser.frames():
            rows.append([frame.data[place] for place in places])
    except Exception as error:  # what it raises at a damaged byte, or at the end, depends on the byte
        if parser.reader.tell() < len(parser.reader):
            note(
                source,
                f"flight {number}: byte {parser.reader.tell()} of its frames: damaged ({one_line(error)}); "
                f"the {len(rows)} frames before are read",
            )
    table = np.array([row for row in rows if all(type(value) is int for value in row)], dtype=np.float64)
    if len(table) == 0:
        return {}
    if not any(event.type is event_types.LOG_END for event in parser.events):
        note(source, f"flight {number}: it has no end: the file is cut off, or the battery was pulled")
    columns = dict(zip(names, table.T, strict=True))
    if _ITERATION in columns and (lost := _lost(columns[_ITERATION])):
        note(source, f"flight {number}: about {lost} frames are damaged or were not logged")
    return columns


def _lost(iterations: Array) -> int:
    """Frames that are missing between others, by the counter that they carry."""
    steps = np.diff(iterations)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return int(np.sum(np.round(steps[steps > usual] / usual) - 1)) if usual > 0.0 else 0


def _time_ns(columns: dict[str, Array]) -> Stamps:
    stamps: Stamps = np.round(columns["time"] * 1e3).astype(np.int64)
    return stamps


def _imu(source: str, headers: dict[str, Any], columns: dict[str, Array]) -> ImuStream | None:
    if not all(name in columns for name in (*_GYRO, *_ACCELERATION)):
        return None
    one_g = headers.get("acc_1G")
    if not isinstance(one_g, int) or one_g <= 0:
        raise LogError(f"{source}: the header acc_1G is missing: nothing says how many counts are one g")
    gyro = np.stack([columns[name] for name in _GYRO], axis=1) * _gyro_scale(headers)
    acceleration = np.stack([columns[name] for name in _ACCELERATION], axis=1) / one_g
    stream = ImuStream(
        _time_ns(columns),
        body_flu_to_frd(np.radians(gyro)),
        body_flu_to_frd(acceleration * STANDARD_GRAVITY),
    )
    return usable(source, stream)


def _gyro_scale(headers: dict[str, Any]) -> float:
    """Degrees per second of one count; the header holds the bits of a single-precision number."""
    bits = headers.get("gyro_scale")
    scale = 1.0
    if isinstance(bits, int) and 0 < bits < 2**32:
        (scale,) = struct.unpack("<f", struct.pack("<I", bits))
    return scale / (_HIGH_RESOLUTION if headers.get("blackbox_high_resolution") == 1 else 1.0)


def _rotor_speeds(
    source: str,
    headers: dict[str, Any],
    columns: dict[str, Array],
    vehicle: Vehicle | None,
    order: RotorOrder | None,
) -> RotorSpeedStream | None:
    if not all(name in columns for name in _ERPM):
        if headers.get("dshot_bidir") == 1:
            note(
                source,
                "topic rotor_speeds: bidirectional DShot was on, but eRPM is not among the logged fields",
            )
        return None
    if order is None:
        order = RotorOrder.by_layout(vehicle, "betaflight", ERPM)
    if vehicle is None:
        note(source, "topic rotor_speeds: left out, electrical speeds need the vehicle's pole pairs")
        return None
    order = RotorOrder(order.controllers, order.unit or ERPM)
    poles = headers.get("motor_poles")
    if isinstance(poles, int) and vehicle.pole_pairs is not None and poles != 2 * vehicle.pole_pairs:
        note(
            source,
            f"topic rotor_speeds: motor_poles is {poles}, the vehicle file says {2 * vehicle.pole_pairs}; "
            "the file counts",
        )
    erpm = np.stack([columns[_ERPM[number]] for number in order.controllers], axis=1) * _ERPM_PER_COUNT
    return usable(source, RotorSpeedStream(_time_ns(columns), order.speeds(erpm, vehicle)))
