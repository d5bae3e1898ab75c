# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for the binary logs that a Crazyflie writes to its micro-SD card ("cfusdlog", versions 1 and 2).

Layout, little-endian: the byte 0xBC; version and number of event types (uint16 each); per event type its id
(uint16), name, number of variables (uint16) and the variables as "group.name(T)" with a struct type letter T
(strings end with a zero byte); then records of event id, stamp and packed values; a CRC32 of all before it.
The stamp is a uint32 in milliseconds in version 1 and a uint64 in microseconds in version 2.

The Crazyflie's body axes are forward-left-up; its world is z-up and taken as east-north-up.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core import flight, frames
from quadpi_core.errors import LogError
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.reader_steps import normalised_attitude, note
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.vehicle import Vehicle

_MAGIC = 0xBC
_CRC_BYTES = 4
_STAMP_TYPE = {1: "<u4", 2: "<u8"}
_NANOSECONDS_PER_TICK = {1: 1_000_000, 2: 1_000}
_VALUE_TYPE = {letter: f"<{np.dtype(letter).str[1:]}" for letter in "bBhHiIqQefd"}
_ID = "event id"
_STAMP = "stamp"

_GYRO = ("gyro.x", "gyro.y", "gyro.z")
_ACCELERATION = ("acc.x", "acc.y", "acc.z")
_ROTORS = ("rpm.m1", "rpm.m2", "rpm.m3", "rpm.m4")
_POSITION = ("x", "y", "z")
_ATTITUDE = ("qw", "qx", "qy", "qz")
_VELOCITY = ("vx", "vy", "vz")
_ESTIMATE = tuple(f"stateEstimate.{name}" for name in _POSITION + _ATTITUDE + _VELOCITY)
_MOCAP = tuple(f"locSrv.{name}" for name in _POSITION + _ATTITUDE)
_BATTERY_MV = "pm.vbatMV"
# hPa and °C.
_BARO = ("baro.pressure", "baro.temp")
# Commands to the motors, behind the battery's compensation first, of 16 bits.
COMMANDS = tuple(
    tuple(pattern.format(motor) for motor in range(1, 5))
    for pattern in ("pwm.m{}_pwm", "motor.m{}", "motor.m{}req")
)
COMMAND_FULL = 65535.0


@dataclass(frozen=True)
class Event:
    """The records of one event type: stamps (N,) and one array (N,) per variable, as logged."""

    time_ns: flight.Stamps
    variables: dict[str, frames.Array]

    def __contains__(self, names: tuple[str, ...]) -> bool:
        return all(name in self.variables for name in names)

    def stack(self, names: tuple[str, ...]) -> frames.Array:
        """Variables side by side (N, len(names))."""
        return np.stack([self.variables[name] for name in names], axis=1)


def read_cfusdlog(path: Path, vehicle: Vehicle | None, _mapping: None = None) -> flight.Recording:
    """Read one uSD log; the rotor order m1 to m4 is that of config/vehicles/crazyflie_rpm.yaml.

    The log needs `gyro` (deg/s) and `acc` (g); it may have `rpm`, `stateEstimate` (with its gyro in the same
    event), `locSrv` (motion capture, position and attitude), `pwm` or `motor`, and `pm.vbatMV`, in any event
    type.

    Raises:
        LogError: as :func:`decode_events`, or if the file has no gyro and accelerometer.
    """
    source = str(path)
    events = decode_events(source, path.read_bytes())
    inertial = _find(events, _GYRO + _ACCELERATION)
    if inertial is None:
        logged = sorted(name for event in events.values() for name in event.variables)
        raise LogError(f"{source}: needs gyro and acc in one event; it logs {', '.join(logged) or 'nothing'}")
    rotors = _find(events, _ROTORS)
    mocap = _find(events, _MOCAP)
    estimate = _find(events, _ESTIMATE + _GYRO)
    battery, air = _find(events, (_BATTERY_MV,)), _find(events, _BARO)
    commands = next(((names, own) for names in COMMANDS if (own := _find(events, names))), None)
    return flight.Recording(
        name=path.name,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=_imu(inertial),
        rotor_speeds=None if rotors is None else _rotor_speeds(rotors),
        pose=None if mocap is None else flight.PoseStream(mocap.time_ns, *_pose(mocap, "locSrv")),
        odometry=None if estimate is None else _odometry(estimate),
        commands=None
        if commands is None
        else flight.MotorCommandStream(commands[1].time_ns, commands[1].stack(commands[0]) / COMMAND_FULL),
        command_source="" if commands is None else f"crazyflie {commands[0][0].partition('.')[0]}",
        battery=None
        if battery is None
        else flight.BatteryStream(battery.time_ns, battery.variables[_BATTERY_MV] * 1e-3),
        pressure=None
        if air is None
        else flight.AirStream(air.time_ns, *(air.stack(_BARO).astype(np.float64) * (100.0, 1.0)).T),
        board_air=True,
    )


def _find(events: dict[str, Event], names: tuple[str, ...]) -> Event | None:
    """The first event type that has records and all of these variables."""
    return next((event for event in events.values() if names in event and len(event.time_ns)), None)


def _imu(event: Event) -> flight.ImuStream:
    specific_force = frames.body_flu_to_frd(event.stack(_ACCELERATION)) * STANDARD_GRAVITY
    return flight.ImuStream(event.time_ns, _rates(event), specific_force)


def _rates(event: Event) -> frames.Array:
    return frames.body_flu_to_frd(np.radians(event.stack(_GYRO)))


def _rotor_speeds(event: Event) -> flight.RotorSpeedStream:
    return flight.RotorSpeedStream(event.time_ns, event.stack(_ROTORS) * (2.0 * np.pi / 60.0))


def _odometry(event: Event) -> flight.OdometryStream:
    position, attitude = _pose(event, "stateEstimate")
    velocity_world = frames.world_enu_to_ned(
        event.stack(tuple(f"stateEstimate.{name}" for name in _VELOCITY))
    )
    velocity = frames.rotate_world_to_body(attitude, velocity_world)
    return flight.OdometryStream(event.time_ns, position, attitude, velocity, _rates(event))


def _pose(event: Event, group: str) -> tuple[frames.Array, frames.Array]:
    position = event.stack(tuple(f"{group}.{name}" for name in _POSITION))
    attitude = normalised_attitude(event.stack(tuple(f"{group}.{name}" for name in _ATTITUDE)))
    return frames.world_enu_to_ned(position), frames.quaternion_flu_enu_to_frd_ned(attitude)


def decode_events(source: str, data: bytes) -> dict[str, Event]:
    """All records of a log, by the name of their event type.

    Raises:
        LogError: naming the byte where its head is damaged, for a checksum that does not match, and for a
            log without one whole record. What is cut off is noted.
    """
    if len(data) < 5 or data[0] != _MAGIC:
        raise LogError(f"{source}: not a Crazyflie uSD log (it must begin with the byte 0x{_MAGIC:X})")
    version, event_count = struct.unpack_from("<HH", data, 1)
    if version not in _STAMP_TYPE:
        raise LogError(f"{source}: uSD log version {version} is not known; known: {list(_STAMP_TYPE)}")
    layouts, names, start = _decode_header(source, data, version, event_count)
    written = data.rstrip(b"\0")
    if len(data) - len(written) > max((layout.itemsize for layout in layouts.values()), default=0):
        # The card has reserved what was not written any more; no record is that many zeros.
        data = written
    offsets, stop = _record_offsets(data, start, layouts)
    _check_end(source, data, stop, layouts)
    if not any(offsets.values()):
        raise LogError(f"{source}: byte {len(data)}: the file holds no whole record")
    tick_ns = _NANOSECONDS_PER_TICK[version]
    return {
        names[event_id]: _decode_records(data, offsets[event_id], layout, tick_ns)
        for event_id, layout in layouts.items()
    }


def _check_end(source: str, data: bytes, stop: int, layouts: Collection[int]) -> None:
    """Note what follows the last whole record, up to byte `stop`; refuse a checksum that does not match."""
    rest = data[stop:]
    undefined = len(rest) >= 2 and int.from_bytes(rest[:2], "little") not in layouts
    if len(rest) == _CRC_BYTES and int.from_bytes(rest, "little") == zlib.crc32(data[:stop]):
        return
    if len(rest) == _CRC_BYTES and undefined:
        raise LogError(f"{source}: the checksum does not match: the file is damaged")
    if undefined:
        wrong = f"damaged from byte {stop} on, where no event begins"
    else:
        wrong = f"cut off in the record from byte {stop}, without a checksum"
    note(source, f"the file is {wrong}; the whole records before it are read")


def _decode_header(
    source: str, data: bytes, version: int, event_count: int
) -> tuple[dict[int, np.dtype[Any]], dict[int, str], int]:
    """Record layout and name per event id, and the byte at which the records start."""
    layouts: dict[int, np.dtype[Any]] = {}
    names: dict[int, str] = {}
    position = 5
    try:
        for _ in range(event_count):
            (event_id,) = struct.unpack_from("<H", data, position)
            names[event_id], position = _string(data, position + 2)
            (variable_count,) = struct.unpack_from("<H", data, position)
            position += 2
            columns = [(_ID, "<u2"), (_STAMP, _STAMP_TYPE[version])]
            for _ in range(variable_count):
                variable, position = _string(data, position)
                columns.append((variable[:-3], _VALUE_TYPE[variable[-2]]))
            layouts[event_id] = np.dtype(columns)
    except (struct.error, ValueError, LookupError) as error:
        raise LogError(f"{source}: byte {position}: the list of logged variables is damaged") from error
    return layouts, names, position


def _string(data: bytes, start: int) -> tuple[str, int]:
    end = data.index(0, start)
    return data[start:end].decode(), end + 1


def _record_offsets(
    data: bytes, start: int, layouts: dict[int, np.dtype[Any]]
) -> tuple[dict[int, list[int]], int]:
    """First byte of each whole record per event id, and the byte behind the last of them.

    Records of all types are interleaved, so they are walked.
    """
    sizes = {event_id: layout.itemsize for event_id, layout in layouts.items()}
    offsets: dict[int, list[int]] = {event_id: [] for event_id in layouts}
    position = start
    while position + 1 < len(data):
        event_id = data[position] | data[position + 1] << 8
        end = position + sizes.get(event_id, len(data))
        if end > len(data):
            break
        offsets[event_id].append(position)
        position = end
    return offsets, position


def _decode_records(data: bytes, offsets: list[int], layout: np.dtype[Any], tick_ns: int) -> Event:
    """Gather the records of one type as rows of bytes and view them as columns."""
    content = np.frombuffer(data, dtype=np.uint8)
    places = np.array(offsets, dtype=np.int64)
    rows = (
        np.lib.stride_tricks.sliding_window_view(content, layout.itemsize)[places]
        if offsets
        else np.empty((0, layout.itemsize), np.uint8)
    )
    records: npt.NDArray[np.void] = rows.view(layout)[:, 0]
    logged = [name for name in layout.names or () if name not in (_ID, _STAMP)]
    with np.errstate(invalid="ignore"):  # of a damaged number that is none
        values = {name: records[name].astype(np.float64) for name in logged}
    return Event(records[_STAMP].astype(np.int64) * tick_ns, values)


FORMAT = LogFormat(
    description="Crazyflie uSD log",
    read=read_cfusdlog,
    begins=lambda head: head[0] == _MAGIC,
    remedies={
        "imu": "raise the frequency of its event in config.txt on the card",
        "rotor_speeds": "raise the frequency of its event in config.txt on the card",
        "odometry": "raise the frequency of its event in config.txt on the card",
        "mocap/pose": "raise the rate at which motion capture is sent to the vehicle",
    },
)
