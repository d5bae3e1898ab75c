# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags, tables and telemetry as a field log: what their readers make of them, and commands of tables.

A table needs no mapping here where a bundled one names its columns, or where their names and numbers tell
gyro and accelerometer; the page says which was taken.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.field.field_log import FieldLog, Series, Setting, series_of
from quadpi_core.flight import Recording
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.logs import decode_recording, identify_format, reading
from quadpi_core.logs.formats import ros_bags, table_files
from quadpi_core.logs.mapping import ERPM, Mapping
from quadpi_core.logs.table_columns import Columns, bare_name, mapping_draft, open_columns, stamps_of
from quadpi_core.paths import config_directory
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.rotor_order import LAYOUTS, Motor
from quadpi_core.vehicle import Vehicle

_COMMAND = re.compile(
    r"^(?!.*(rpm|thrust|curr|temp))(.*[\W_])?(motor|pwm|cmd|u|esc|m)[\W_]*m?([1-8])([\W_]*pwm)?$", re.I
)
_BATTERY = re.compile(r"(^|[\W_])(v_?bat|batt?(ery)?(_?v(olt(age)?)?)?|voltage)([\W_]?(m?v))?$", re.I)
# Lowest and highest command in flight, and rest and full throttle: µs, share, percent, DShot, 16 bits.
_SCALES = (
    ((900.0, 2300.0), (1000.0, 2000.0)),
    ((0.0, 1.001), (0.0, 1.0)),
    ((0.0, 100.5), (0.0, 100.0)),
    ((0.0, 2047.5), (48.0, 2047.0)),
    ((0.0, 65535.5), (0.0, 65535.0)),
)
_ROTORS_FEWEST, _ABSENT = 3, "not in the log"
_ELECTRICAL = "rotor speeds are electrical, by the pairs of poles faster than the motors turn (--vehicle)"


def read_other(path: Path, options: ReadingOptions, known: Vehicle | int | None) -> FieldLog:
    """What a log of a format without a stack of its own holds.

    Args:
        path: of the log.
        options: topics of a bag, or the mapping of a table.
        known: the vehicle whose file the user gave, or its pairs of poles alone, for electrical speeds.

    Raises:
        LogError: as its reader does.
    """
    log_format = identify_format(path)
    vehicle, poles = (None, known) if isinstance(known, int) else (known, None)
    notes: list[str] = []
    columns, speeds_of = None, frozenset[str]()
    if log_format is table_files.FORMAT:
        columns = open_columns(path)
        recording, said, mapping = _of_table(path, columns, options, vehicle, poles)
        speeds_of = frozenset(own.columns if (own := mapping.signals.get("rotor_speeds")) else ())
        notes += [said] if said else []
    else:
        if vehicle is None and log_format.container is not None:
            vehicle = named_vehicle(log_format.container.vehicle_name(path))
            if vehicle is not None and poles is not None:
                vehicle = replace(vehicle, pole_pairs=poles)
        # Here commands are commands: speeds that are made of them tell nothing of tachometers.
        vehicle = None if vehicle is None else replace(vehicle, motors=None)
        recording, said = _decoded(path, vehicle, poles, options)
        notes += [said] if said else []
    start_ns = int(recording.imu.time_ns[0]) if len(recording.imu) else 0
    commands, battery = (
        (None, None) if columns is None else _of_columns(path, columns, start_ns, notes, speeds_of)
    )
    if recording.commands is not None:
        notes.append(f"commands are of {recording.command_source}, in the order of the vehicle or quad X")
    log = field_log_of(recording, commands, battery)
    stack = re.split(r" \(| with |,", log_format.description)[0]
    settings = tuple(_settings(recording, log.commands, log_format.description, notes))
    # Commands and rotor speeds are in the order of a vehicle that is known.
    known = vehicle if vehicle is not None and vehicle.rotor_count == log.rotors else None
    places = None if known is None else np.column_stack([known.rotor_positions[:, :2], known.rotor_spins])
    log = replace(log, name=path.stem, source=str(path), stack=stack, places=places)
    return replace(log, settings=settings, notes=(*notes, *log.notes))


def _decoded(
    path: Path, vehicle: Vehicle | None, poles: int | None, options: ReadingOptions
) -> tuple[Recording, str]:
    """A recording, electrical rotor speeds as they are where nothing says the poles; and that."""
    try:
        return decode_recording(path, vehicle, options), ""
    except LogError:
        if vehicle is not None:
            raise
        for motors in LAYOUTS.values():
            with suppress(LogError):
                recording = decode_recording(path, _of_motors(motors, poles or 1), options)
                return recording, "" if poles else _ELECTRICAL
        raise


def _of_motors(motors: Sequence[Motor], poles: int) -> Vehicle:
    """A vehicle of which only the poles are known, whose rotors are a frame's, in its order."""
    return Vehicle(
        name="",
        mass_kg=1.0,
        inertia=np.eye(3),
        rotor_radius_m=0.1,
        rotor_positions=np.array([(motor.x, motor.y, 0.0) for motor in motors]),
        rotor_spins=np.array([motor.spin or 1.0 for motor in motors]),
        pole_pairs=poles,
    )


def named_vehicle(name: str) -> Vehicle | None:
    """The vehicle that a bag names, or None if there is no such file."""
    try:
        return Vehicle.load(name) if name else None
    except VehicleError:
        return None


def field_log_of(
    recording: Recording, commands: Series | None = None, battery: Series | None = None
) -> FieldLog:
    """A recording as a log of the field; commands and battery are its own unless given."""
    start_ns = int(recording.imu.time_ns[0]) if len(recording.imu) else 0
    if commands is None and recording.commands is not None:
        commands = series_of(recording.commands.time_ns, recording.commands.commands, start_ns)
    imu, odometry, pose, rotors = recording.imu, recording.odometry, recording.pose, recording.rotor_speeds
    attitude = velocity = position = None
    if odometry is not None and len(odometry):
        attitude = series_of(odometry.time_ns, odometry.attitude, start_ns)
        world = rotate_body_to_world(odometry.attitude, odometry.velocity)
        placed, _, moving = (odometry.deviation >= 0.0).T
        velocity = series_of(odometry.time_ns[moving], world[moving], start_ns)
        position = series_of(odometry.time_ns[placed], odometry.position[placed], start_ns)
    elif pose is not None and len(pose):
        attitude = series_of(pose.time_ns, pose.attitude, start_ns)
        position = series_of(pose.time_ns, pose.position, start_ns)
    if battery is None and recording.battery is not None:
        # Autopilots without a power module log 0 V.
        measured = recording.battery.take(recording.battery.voltage > 0.0)
        battery = series_of(measured.time_ns, measured.voltage, start_ns) if len(measured) else None
    speeds = (
        None
        if rotors is None or not np.any(rotors.speeds)
        else series_of(rotors.time_ns, rotors.speeds, start_ns)
    )
    count = next((own.values.shape[1] for own in (commands, speeds) if own is not None), None)
    inertial = series_of(imu.time_ns, np.hstack([imu.angular_velocity, imu.specific_force]), start_ns)
    lost = len(imu) - len(inertial or ())
    said = f"imu: {lost} of {len(imu)} samples left out: stale, not finite, or stamped before the last one"
    return FieldLog(
        name=recording.name,
        source=recording.source,
        stack="",
        frame="quadcopter" if count == 4 else "",
        rotors=count,
        imu=inertial,
        attitude=attitude,
        velocity=velocity,
        position=position,
        commands=commands,
        rotor_speeds=speeds,
        battery=battery,
        facts={"vehicle": recording.vehicle} if recording.vehicle else {},
        notes=(*recording.quality.sentences(), *([said] if lost else [])),
    )


def _settings(
    recording: Recording, commands: Series | None, stack: str, notes: Sequence[str]
) -> Iterator[Setting]:
    if any(_ELECTRICAL in one for one in notes):
        wanted = "give a vehicle file that has them (--vehicle)"
        yield Setting("pairs of poles", _ABSENT, wanted, "rotor speeds")
    telemetry = "record the speed controllers' telemetry, such as /fmu/out/esc_status or /mavros/esc_status"
    is_bag = stack == ros_bags.FORMAT.description
    if recording.odometry is None and recording.pose is None:
        yield Setting("odometry", _ABSENT, "record the autopilot's odometry, or a pose", "drag and wind")
    if recording.rotor_speeds is None:
        yield Setting("rotor speeds", _ABSENT, telemetry if is_bag else "log them", "measured rotor speeds")
    if commands is None and not is_bag:
        yield Setting("motor commands", _ABSENT, "log them", "hover throttle and saturation")


def _of_table(
    path: Path, columns: Columns, options: ReadingOptions, vehicle: Vehicle | None, poles: int | None
) -> tuple[Recording, str, Mapping]:
    """A table by the user's mapping, a bundled or a guessed one; which it was, and the mapping."""
    if options.mapping is not None:
        mapping = Mapping.load(options.mapping)
        if poles is not None:
            return *_by(path, mapping, None, poles), mapping
        return decode_recording(path, vehicle, options), "", mapping
    names = set(columns.names)
    for file in sorted((config_directory() / "mappings").glob("*.yaml")):
        try:
            mapping = Mapping.load(file)
        except LogError:
            continue  # the rotor order of an autopilot
        if {column for signal in mapping.signals.values() for column in signal.columns} <= names:
            read, said = _by(path, mapping, vehicle, poles)
            return read, f"its columns are those of {file.name}{said}", mapping
    draft = mapping_draft(columns)
    if "?" in draft.partition("\n")[2]:  # what could not be guessed
        raise LogError(
            f"{path}: its columns do not tell gyro and accelerometer; name them as gyro_x, acc_x, or give a "
            f"mapping (--mapping); it has {', '.join(columns.names)}"
        )
    mapping = Mapping.draft(draft, path)
    recording, electrical = _by(path, mapping, vehicle, poles)
    said = "; ".join(line for line in draft.splitlines()[1:])
    return recording, f"its columns are guessed from names and numbers: {said}{electrical}", mapping


def _by(path: Path, mapping: Mapping, vehicle: Vehicle | None, poles: int | None) -> tuple[Recording, str]:
    """A table by a mapping, electrical rotor speeds as they are where nothing says the poles; and that."""
    rotors = mapping.signals.get("rotor_speeds")
    if rotors is None or rotors.unit != ERPM or vehicle is not None:
        with reading(path):
            return table_files.read_table(path, vehicle, mapping), ""
    mapping = replace(mapping, signals=mapping.signals | {"rotor_speeds": replace(rotors, unit="rpm")})
    with reading(path):
        recording = table_files.read_table(path, None, mapping)
    if poles is None or recording.rotor_speeds is None:
        return recording, f"; {_ELECTRICAL}"
    mechanical = replace(recording.rotor_speeds, speeds=recording.rotor_speeds.speeds / poles)
    return replace(recording, rotor_speeds=mechanical), ""


def _of_columns(
    path: Path, columns: Columns, start_ns: int, notes: list[str], speeds_of: frozenset[str]
) -> tuple[Series | None, Series | None]:
    """Commands of the motors, and the battery, of a table's columns by their names."""
    found: dict[str, dict[int, int]] = {}
    numeric = columns.head()
    battery = None
    for place, name in enumerate(columns.names):
        if place not in numeric or name in speeds_of or bare_name(name) in speeds_of:
            continue
        if match := _COMMAND.match(name):
            stem = name[: match.start(4)]
            found.setdefault(stem, {})[int(match[4])] = place
        elif _BATTERY.search(name) and battery is None:
            battery = place
    motors = next((own for own in found.values() if _ROTORS_FEWEST <= len(own) == max(own)), {})
    clock = _clock(columns, numeric)
    if clock is None or not (motors or battery is not None):
        return None, None
    wanted = [motors[motor] for motor in sorted(motors)] + ([battery] if battery is not None else [])
    read = columns.read(sorted({clock, *wanted}), clock)
    time_ns = stamps_of(str(path), read[clock], None)
    commands = None
    if motors:
        values = np.stack([read[place].astype(np.float64) for place in wanted[: len(motors)]], axis=1)
        commands = _scaled(values, [columns.names[place] for place in wanted[: len(motors)]], notes)
    volts = None
    if battery is not None:
        values = read[battery].astype(np.float64)
        values = values * (1e-3 if np.nanmedian(values) > 100.0 else 1.0)
        # No cell has less: what is below was not measured.
        volts = series_of(time_ns, np.where(values > 2.0, values, np.nan), start_ns)
    return None if commands is None else series_of(time_ns, commands, start_ns), volts


def _clock(columns: Columns, numeric: Any) -> int | None:
    wanted = re.compile(r"^(t|time(stamp)?|stamp|time_?(s|ms|us|ns|boot_ms|usec))$", re.I)
    names = enumerate(name.strip("#% \t") for name in columns.names)
    return next((place for place, name in names if place in numeric and wanted.match(name)), None)


def _scaled(values: Array, names: Sequence[str], notes: list[str]) -> Array | None:
    """Commands as shares of the range that their largest value tells; values beyond all ranges are none."""
    turning = values[values > 0.0]
    if not len(turning):
        return None
    usual = np.quantile(turning, [0.01, 0.99])
    for (least, most), (low, high) in _SCALES:
        if least <= usual[0] and usual[1] <= most:
            notes.append(f"commands are {names[0]} to {names[-1]}, taken as {low:g} to {high:g}")
            kept = np.where(values <= most, values, np.nan)
            return np.clip((kept - low) / (high - low), 0.0, 1.0)
    notes.append(f"{names[0]} to {names[-1]} reach {usual[1]:g}: no scale of commands, which are left out")
    return None
