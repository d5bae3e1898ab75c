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

import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, MotorCommandStream, PoseStream, Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array, body_flu_to_frd, quaternion_from_roll_pitch_yaw
from quadpi_core.logs.log_format import FlightsInFile, LogFormat
from quadpi_core.logs.reader_steps import Airframe, by_frame, has_rotors, note, order_of_commands, require_imu
from quadpi_core.logs.sandbox import require_unpackable
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import STANDARD_GRAVITY, record_dtype
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
    """Read one flight of a file by its number; see :func:`read_betaflight`."""
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
    return np.round(columns["time"] * 1e3).astype(np.int64)


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


# The header lines are read here, the frames in core/include/quadpi/logs/blackbox.hpp, which says how.
#
# Source: Betaflight's documentation, "Blackbox Internals".

# Header lines of firmwares are shorter than 2 kB.
_HEADER_LINE_MAX = 8192

# Kinds of frames: those of the main loop come first.
_KINDS, _MAIN = len(compiled.BLACKBOX_KINDS), "IP"
_NUMBER = re.compile(r"(-?[0-9]{1,10})|0x([0-9A-Fa-f]{1,8})")
_TIME = "time"


@dataclass(frozen=True)
class BlackboxLog:
    """One flight.

    Attributes:
        headers: those that are whole numbers, by name.
        texts: all of them, by name.
        fields: names of all fields of the main frames.
        columns: (N,) of the main frames, in the units of the log; `time` in µs is unwrapped beyond 32 bits.
        ended: whether the log has an end event.
        damaged_at: position in the flight of the first byte outside frames; None without one.
        damaged_bytes: number of such bytes.
    """

    headers: Mapping[str, int]
    texts: Mapping[str, str]
    fields: Sequence[str]
    columns: Mapping[str, Array]
    ended: bool
    damaged_at: int | None
    damaged_bytes: int


def decode_blackbox(flight: bytes, wanted: Sequence[str]) -> BlackboxLog:
    """Those of the wanted columns that one flight has.

    Args:
        flight: from its first header line on.
        wanted: names of fields of the main frames; `time` is always read.

    Raises:
        LogError: for headers that do not describe its frames, or more frames than may be unpacked.
    """
    texts, start = _header(flight)
    headers = {name: number for name, text in texts.items() if (number := _whole(text)) is not None}
    names = texts.get("Field I name", "").split(",")
    for name in (_TIME, _ITERATION):
        if names.count(name) != 1:
            raise LogError(f"its headers name the field {name} {names.count(name)} times, not once")
    rules = np.zeros(1, RULES)
    encoding = rules["encoding"][0]
    encoding[:] = compiled.BLACKBOX_NOTHING
    for place, kind in enumerate(compiled.BLACKBOX_KINDS):
        fields = len(names) if kind in _MAIN else len(texts.get(f"Field {kind} encoding", "").split(","))
        if kind not in _MAIN and f"Field {kind} encoding" not in texts:
            continue
        rules["sizes"][0, place] = fields
        described = _described(texts, f"Field {kind} encoding", fields, compiled.BLACKBOX_ENCODINGS)
        encoding[place, :fields] = described
        # Of the other frames only the length is needed.
        if kind in _MAIN:
            described = _described(texts, f"Field {kind} predictor", fields, compiled.BLACKBOX_PREDICTORS)
            rules["predictor"][0, place, :fields] = described
    if "Field I signed" in texts:
        rules["signed"][0, : len(names)] = _described(texts, "Field I signed", len(names), (0, 1))
    if headers.get("Data version") != 2 and np.any(encoding == compiled.BLACKBOX_TAG8_4S16):
        raise LogError(f"its header says data version {texts.get('Data version', 'unknown')}; read is 2")
    rules["time"], rules["iteration"] = names.index(_TIME), names.index(_ITERATION)
    rules["motor"] = names.index("motor[0]") if "motor[0]" in names else 0
    rules["every"], rules["numerator"], rules["denominator"] = _intervals(texts)
    rules["minthrottle"], rules["vbatref"], rules["minmotor"] = _references(texts)
    read = [_TIME, *(name for name in dict.fromkeys(wanted) if name in names and name != _TIME)]
    chosen = np.array([names.index(name) for name in read], dtype=np.int64)
    rows = compiled.decode_blackbox(flight, start, rules, chosen, np.empty(0))[0]
    table: Array = np.empty((rows, len(read)))
    require_unpackable(len(flight), table.nbytes)
    _, ended, damaged_at, damaged = compiled.decode_blackbox(flight, start, rules, chosen, table)
    columns = dict(zip(read, np.ascontiguousarray(table.T), strict=True))
    columns[_TIME] = np.unwrap(columns[_TIME], period=2.0**32)
    return BlackboxLog(headers, texts, names, columns, ended, damaged_at if damaged else None, damaged)


class _Rules:
    """Layout of the frames of a log: that of core/include/quadpi/logs/blackbox.hpp."""

    encoding: Annotated[Indices, _KINDS, compiled.BLACKBOX_FIELDS_MAX]
    predictor: Annotated[Indices, _KINDS, compiled.BLACKBOX_FIELDS_MAX]
    sizes: Annotated[Indices, _KINDS]
    signed: Annotated[Indices, compiled.BLACKBOX_FIELDS_MAX]
    time: int
    iteration: int
    motor: int
    every: int
    numerator: int
    denominator: int
    minthrottle: int
    vbatref: int
    minmotor: int


RULES = record_dtype(_Rules)


def _header(flight: bytes) -> tuple[dict[str, str], int]:
    """The header lines by name, and where the frames begin."""
    texts: dict[str, str] = {}
    position = 0
    while flight.startswith(b"H ", position):
        end = flight.find(b"\n", position, position + _HEADER_LINE_MAX)
        line = flight[position:end]
        # A frame of kind H may begin with the same bytes.
        if end < 0 or b":" not in line or not line.isascii():
            break
        name, _, text = line[2:].decode().partition(":")
        texts[name] = text.strip()
        position = end + 1
    return texts, position


def _whole(text: str) -> int | None:
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    return int(match[1]) if match[1] else int(match[2], 16)


def _described(texts: Mapping[str, str], name: str, fields: int, known: Collection[int]) -> list[int]:
    """The numbers of a header line, one for each field."""
    numbers = [_whole(text) for text in texts.get(name, "").split(",")]
    if len(numbers) != fields or fields > compiled.BLACKBOX_FIELDS_MAX:
        raise LogError(f"its header `{name}` has {len(numbers)} entries for {fields} fields")
    for number in numbers:
        if number not in known:
            raise LogError(f"its header `{name}` has an entry that is not known: {number}")
    return [number for number in numbers if number is not None]


def _intervals(texts: Mapping[str, str]) -> tuple[int, int, int]:
    """Logged iterations of the main loop: one in N as an I frame, M in K as a P frame."""
    first, _, second = texts.get("P interval", "1/1").partition("/")
    # Early firmware writes a fraction, later firmware the interval.
    share = (first, second) if second else ("1", first)
    found = [_whole(text) for text in (texts.get("I interval", "32"), *share)]
    every, numerator, denominator = (1 if number is None or number < 1 else number for number in found)
    return every, numerator, denominator


def _references(texts: Mapping[str, str]) -> tuple[int, int, int]:
    """Constants of predictors: minthrottle, vbatref, the lowest output of a motor."""
    minimum, battery, output = (
        _whole(texts.get(name, "").partition(",")[0]) or 0
        for name in ("minthrottle", "vbatref", "motorOutput")
    )
    return minimum, battery, output
