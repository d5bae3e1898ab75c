# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for Blackbox logs (.bbl, .bfl, .txt) of Betaflight, and of INDIflight, which logs more fields.

Betaflight's body axes are forward-left-up. `gyroADC` is in deg/s, `accSmooth` in counts (the header
`acc_1G` gives counts per g), `eRPM` (bidirectional DShot) in hundreds of electrical revolutions per minute,
time in µs. INDIflight's `omega` is in mechanical rad/s; `extPos` [mm] and `extAtt` [mrad: roll, pitch, yaw]
are poses of motion capture, forward-right-down in north-east-down, held from one to the next.
Source: Betaflight's blackbox.c, and the Blackbox log viewer. Units and axes of INDIflight's fields: checked
on flights, whose gyro, specific force and rotor speeds agree with them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    ImuStream,
    MotorCommandStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stamps,
)
from quadpi_core.frames import Array, body_flu_to_frd, quaternion_from_roll_pitch_yaw
from quadpi_core.logs.airframes import Airframe, has_rotors
from quadpi_core.logs.blackbox import BlackboxLog, decode_blackbox
from quadpi_core.logs.log_format import FlightsInFile, LogFormat
from quadpi_core.logs.reader_steps import by_frame, note, order_of_commands, require_imu
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.rotor_order import ERPM, RotorOrder
from quadpi_core.vehicle import Vehicle

_MAGIC = b"H Product:Blackbox"
_GYRO = ("gyroADC[0]", "gyroADC[1]", "gyroADC[2]")
_ACCELERATION = ("accSmooth[0]", "accSmooth[1]", "accSmooth[2]")
# Of as many motors as firmwares know.
_ERPM, _OMEGA, _MOTORS = (
    tuple(f"{name}[{motor}]" for motor in range(8)) for name in ("eRPM", "omega", "motor")
)
_POSITION = ("extPos[0]", "extPos[1]", "extPos[2]")
_ATTITUDE = ("extAtt[0]", "extAtt[1]", "extAtt[2]")
_ITERATION = "loopIteration"
# Full throttle of DShot, and of pulses in µs: the scale does not matter, as long as it is one.
_MOTOR_FULL = 2000.0
_FIELDS = (_ITERATION, "time", *_GYRO, *_ACCELERATION, *_ERPM, *_OMEGA, *_MOTORS, *_POSITION, *_ATTITUDE)
_ERPM_PER_COUNT = 100.0
_HIGH_RESOLUTION = 10.0
_NO_TELEMETRY = (
    "no telemetry: `set dshot_bidir = ON`, with speed controllers whose firmware knows bidirectional DShot"
)
# Of flights in one file, the largest; the flash of a flight controller holds fewer.
_FLIGHTS_MAX = 100


def read_betaflight(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> Recording:
    """Read the longest flight of one file: IMU, rotor speeds, motion capture; stamped by the controller.

    Args:
        path: the log.
        vehicle: as for every reader; the pole pairs make eRPM mechanical.
        order: of the rotors; by default that of Betaflight's standard quad X.

    Raises:
        LogError: if it holds no frame, or no gyro and accelerometer.
        VehicleError: if it holds eRPM and the vehicle file does not give the pole pairs.
    """
    source, flights = str(path), decoded_flights(path)
    number = max(flights, key=lambda number: len(flights[number].columns["time"]))
    if len(flights) > 1:
        note(
            source,
            f"holds {len(flights)} flights; read is the longest, number {number}: `{path.name}#1` is the "
            "first, and `quadpi import` makes a bag of each",
        )
    return _recording(source, path.stem, number, flights[number], vehicle, order)


def read_flight(path: Path, number: int, vehicle: Vehicle | None, order: RotorOrder | None) -> Recording:
    """Read one flight of a file by its number; see :func:`read_betaflight`.

    Raises:
        LogError: as there, and if no flight of that number can be read.
    """
    flights = decoded_flights(path, number)
    return _recording(f"{path}#{number}", f"{path.stem}_{number}", number, flights[number], vehicle, order)


def _recording(
    source: str,
    name: str,
    number: int,
    log: BlackboxLog,
    vehicle: Vehicle | None,
    order: RotorOrder | None,
) -> Recording:
    _note_damage(source, f"flight {number}", log)
    headers, columns = log.headers, log.columns
    its_rotors = has_rotors(source, airframe_of(log.fields), vehicle)
    imu = require_imu(source, imu_of(source, headers, columns), "gyroADC and accSmooth")
    return Recording(
        name=name,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=_rotor_speeds(source, headers, columns, vehicle, order) if its_rotors else None,
        pose=pose_of(columns),
        commands=_commands(source, columns, vehicle, order) if its_rotors else None,
        command_source="betaflight",
    )


def airframe_of(fields: Sequence[str]) -> Airframe | None:
    """What has as many motors as are logged; a log without any does not say."""
    motors = sum(name.startswith("motor[") for name in fields)
    if motors in {1, 2}:
        return Airframe(f"a log of {motors} motors", "one of no multicopter")
    return Airframe.of_rotors(f"a log of {motors} motors", motors) if motors else None


def decoded_flights(
    path: Path, wanted: int | None = None, fields: Sequence[str] = _FIELDS
) -> dict[int, BlackboxLog]:
    """The flights of a file that hold frames, by their numbers from 1; only the wanted one if given."""
    source = str(path)
    data = path.read_bytes()
    if not data.startswith(_MAGIC):
        raise LogError(f"{source}: byte 0: not a Blackbox log (it must begin with `{_MAGIC.decode()}`)")
    # Each begins with the same header line.
    first_line = data[: data.find(b"\n") + 1] or data
    flights = {number: first_line + rest for number, rest in enumerate(data.split(first_line)) if number}
    if wanted is not None and wanted not in flights:
        raise LogError(f"{source}: holds {len(flights)} flights, none of number {wanted}")
    chosen = [wanted] if wanted else sorted(flights, key=lambda number: -len(flights[number]))[:_FLIGHTS_MAX]
    found: dict[int, BlackboxLog] = {}
    for number in sorted(chosen):
        try:
            log = decode_blackbox(flights[number], fields)
        except LogError as error:
            note(source, f"flight {number}: {error}")
            continue
        if len(log.columns["time"]):
            found[number] = log
    if not found:
        raise LogError(f"{source}: no frame of {f'flight {wanted}' if wanted else 'a flight'} can be read")
    return found


def _note_damage(source: str, flight: str, log: BlackboxLog) -> None:
    if log.damaged_at is not None:
        note(
            source,
            f"{flight}: damaged from its byte {log.damaged_at} on, {log.damaged_bytes} bytes in all; frames "
            "that rest on them are left out",
        )
    if not log.ended:
        note(source, f"{flight}: it has no end: the file is cut off, or the battery was pulled")
    if lost := _lost(log.columns[_ITERATION]):
        note(source, f"{flight}: about {lost} frames are damaged or were not logged")


def _lost(iterations: Array) -> int:
    """Frames that are missing between others, by the counter that they carry."""
    steps = np.diff(iterations)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return int(np.sum(np.round(steps[steps > usual] / usual) - 1)) if usual > 0.0 else 0


def stamps_in(columns: Mapping[str, Array]) -> Stamps:
    """Stamps (N,) of the frames."""
    stamps: Stamps = np.round(columns["time"] * 1e3).astype(np.int64)
    return stamps


def _stacked(columns: Mapping[str, Array], names: Sequence[str]) -> Array:
    """Fields side by side (N, len(names))."""
    return np.stack([columns[name] for name in names], axis=1)


def imu_of(source: str, headers: Mapping[str, int], columns: Mapping[str, Array]) -> ImuStream | None:
    """Gyro and accelerometer; None where they are not logged.

    Raises:
        LogError: where nothing says how many counts are one g.
    """
    if not all(name in columns for name in (*_GYRO, *_ACCELERATION)):
        return None
    one_g = headers.get("acc_1G")
    if one_g is None or one_g <= 0:
        raise LogError(f"{source}: the header acc_1G is missing: nothing says how many counts are one g")
    gyro = _stacked(columns, _GYRO) * _gyro_scale(headers)
    acceleration = _stacked(columns, _ACCELERATION) / one_g
    return ImuStream(
        stamps_in(columns),
        body_flu_to_frd(np.radians(gyro)),
        body_flu_to_frd(acceleration * STANDARD_GRAVITY),
    )


def pose_of(columns: Mapping[str, Array]) -> PoseStream | None:
    """The poses of motion capture, each once: a frame repeats the one before until the next has come."""
    if not all(name in columns for name in (*_POSITION, *_ATTITUDE)):
        return None
    logged = 1e-3 * _stacked(columns, (*_POSITION, *_ATTITUDE))
    fresh = np.any(np.diff(logged, axis=0, prepend=0.0) != 0.0, axis=1)
    position, angles = logged[fresh, :3], logged[fresh, 3:]
    pose = PoseStream(stamps_in(columns)[fresh], position, quaternion_from_roll_pitch_yaw(angles))
    return pose if len(pose) else None


def _gyro_scale(headers: Mapping[str, int]) -> float:
    """Degrees per second of one count; the header holds the bits of a single-precision number."""
    bits = headers.get("gyro_scale", 0)
    scale = 1.0
    if 0 < bits < 2**32:
        (scale,) = struct.unpack("<f", struct.pack("<I", bits))
    return scale / (_HIGH_RESOLUTION if headers.get("blackbox_high_resolution") == 1 else 1.0)


def _commands(
    source: str, columns: Mapping[str, Array], vehicle: Vehicle | None, order: RotorOrder | None
) -> MotorCommandStream | None:
    if order is None and vehicle is None:
        order = RotorOrder(tuple(range(sum(name in columns for name in _MOTORS))))
    order = order or order_of_commands(source, vehicle, "betaflight")
    names = [] if order is None else [f"motor[{number}]" for number in order.controllers]
    if not names or not all(name in columns for name in names):
        return None
    return MotorCommandStream(stamps_in(columns), _stacked(columns, names) / _MOTOR_FULL)


def _rotor_speeds(
    source: str,
    headers: Mapping[str, int],
    columns: Mapping[str, Array],
    vehicle: Vehicle | None,
    order: RotorOrder | None,
) -> RotorSpeedStream | None:
    if "omega[0]" in columns:
        order = _order(source, "omega", columns, vehicle, order)
        speeds = np.abs(_stacked(columns, [f"omega[{number}]" for number in order.controllers]))
        return RotorSpeedStream(stamps_in(columns), speeds)
    if "eRPM[0]" not in columns:
        if headers.get("dshot_bidir") == 1:
            note(
                source,
                "topic rotor_speeds: bidirectional DShot was on, but eRPM is not among the logged fields",
            )
        return None
    order = _order(source, "eRPM", columns, vehicle, order)
    order = RotorOrder(order.controllers, order.unit or ERPM)
    pole_pairs = pole_pairs_of(source, headers, vehicle)
    if vehicle is None and pole_pairs is None:
        note(source, "topic rotor_speeds: left out, electrical speeds need the vehicle's pole pairs")
        return None
    erpm = _stacked(columns, [f"eRPM[{number}]" for number in order.controllers]) * _ERPM_PER_COUNT
    if not np.any(erpm):
        note(source, f"topic rotor_speeds: left out, every eRPM is zero: {_NO_TELEMETRY}")
        return None
    return RotorSpeedStream(stamps_in(columns), order.speeds(erpm, vehicle, pole_pairs))


def _order(
    source: str, field: str, columns: Mapping[str, Array], vehicle: Vehicle | None, order: RotorOrder | None
) -> RotorOrder:
    """The motors of the vehicle's rotors, of which all are logged; without a vehicle all that are."""
    logged = sum(name.startswith(f"{field}[") for name in columns)
    if order is None and vehicle is None:
        return RotorOrder(tuple(range(logged)))
    order = order or by_frame(source, vehicle, "betaflight")
    if max(order.controllers) >= logged:
        raise LogError(
            f"{source}: field {field}: of {logged} motors, the order of the rotors names number "
            f"{max(order.controllers) + 1}"
        )
    return order


def pole_pairs_of(source: str, headers: Mapping[str, int], vehicle: Vehicle | None) -> int | None:
    """Those that the flight controller was told; None where the log does not say."""
    poles = headers.get("motor_poles", 0)
    if poles <= 0 or poles % 2:
        return None
    known = None if vehicle is None else vehicle.pole_pairs
    if known is not None and poles != 2 * known:
        note(
            source,
            f"topic rotor_speeds: motor_poles is {poles}, the vehicle file says {2 * known}; the log counts. "
            f"If the motors have {2 * known}, `set motor_poles = {2 * known}`",
        )
    return poles // 2


FORMAT = LogFormat(
    description="Betaflight or INDIflight Blackbox log (.bbl, .bfl, .txt)",
    read=read_betaflight,
    begins=lambda head: head.startswith(_MAGIC),
    suffixes=(".bbl", ".bfl"),
    load_mapping=RotorOrder.load,
    flights=FlightsInFile(lambda path: list(decoded_flights(path)), read_flight),
    remedies={
        "imu": "`set blackbox_sample_rate = 1/1` logs every loop",
        "rotor_speeds": "`set blackbox_sample_rate = 1/1` logs every loop",
        "mocap/pose": "raise the rate at which motion capture is sent to the vehicle",
    },
)
