# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for PX4's logs (.ulg, ULog), through pyulog.

PX4's body axes are forward-right-down, its world is north-east-down, its quaternions turn body into world,
and everything is in SI; stamps are µs since boot. Source: PX4's message definitions, releases 1.11 to 1.16.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core import flight
from quadpi_core.errors import LogError, require_library
from quadpi_core.findings import DataQuality, Verdict
from quadpi_core.frames import Array
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.reader_steps import (
    Airframe,
    attitude_alone,
    by_frame,
    finite_parameters,
    has_attitude,
    has_rotors,
    normalised_attitude,
    note,
    odometry_of,
    order_of_commands,
    require_imu,
    rising,
    unit_attitudes,
    without,
)
from quadpi_core.logs.sandbox import read_apart
from quadpi_core.messages.adapters.rotor_messages import EscReports, RotorReader
from quadpi_core.records import ROTORS_MAX
from quadpi_core.rotor_order import RPM, Motor, RotorOrder, usual_layout
from quadpi_core.vehicle import ROTORS, Vehicle

# The columns (N,) of one topic, by the names that pyulog gives them, such as "q[0]".
Columns: TypeAlias = dict[str, Any]

# Of the file; in front of each message, its length and kind.
_HEADER_BYTES, _PREFIX_BYTES = 16, 3
_MAGIC = b"ULog\x01\x12\x35"
_TOPICS = (
    "sensor_combined",
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_visual_odometry",
    "vehicle_mocap_odometry",
    "esc_status",
    "actuator_motors",
    "battery_status",
    "vehicle_air_data",
    "sensor_baro",
)
# What shows that an instance of a topic measures, by the ends of the names of its fields.
_TELLING = MappingProxyType({"esc_status": ("esc_rpm",), "battery_status": ("voltage_v",)})
NO_TELEMETRY = (
    "no telemetry: set DSHOT_TEL_CFG to the port of the telemetry wire, or DSHOT_BIDIR_EN 1 where the speed "
    "controllers know bidirectional DShot, or UAVCAN_ENABLE 3 with those on DroneCAN"
)
# What CA_AIRFRAME names, other than a multirotor of CA_ROTOR_COUNT rotors.
_AIRFRAMES = MappingProxyType(
    {
        **{1: "a fixed-wing aircraft", 2: "a standard VTOL", 3: "a tiltrotor VTOL", 4: "a tailsitter VTOL"},
        **{5: "a rover", 6: "a rover", 7: "a vehicle of motors in six directions", 8: "a tilting multirotor"},
        **{10: "a helicopter", 11: "a helicopter", 12: "a helicopter", 13: "a rover"},
    }
)
_GYRO = ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]")
_ACCELERATION = ("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]")
_QUATERNION = ("q[0]", "q[1]", "q[2]", "q[3]")
_LOCAL_POSITION, _LOCAL_VELOCITY = ("x", "y", "z"), ("vx", "vy", "vz")
_MOCAP_POSITION = ("position[0]", "position[1]", "position[2]")
_VALID = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")
# Local NED and local forward-right-down; the names of the field and its numbers changed in 1.14.
_POSE_FRAMES = MappingProxyType({"local_frame": {0, 1}, "pose_frame": {1, 2}})
_FIRST_MOTOR, _MOTOR = 101, ("PX", "PY", "KM")
# The adapter of px4_msgs/ActuatorMotors, of the same scale.
PX4_MOTORS = "px4_motors"
_US = 1_000
# Pressures below are in hPa: of air it is a tenth of the least in Pa.
_HPA_MAX = 2000.0


def read_px4(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> flight.Recording:
    """Read one log, stamped since the boot of the autopilot.

    Args:
        path: the log.
        vehicle: as for every reader.
        order: of the rotors; by default actuator_function and the rotor positions in the log tell it.

    Raises:
        LogError: if it is no ULog, or holds no IMU samples.
    """
    source = str(path)
    log = load_ulog(source, path)
    # A log that is damaged may hold bytes in the place of a number.
    parameters = finite_parameters(log.parameters)
    its_rotors = has_rotors(source, airframe_of(parameters), vehicle)
    topics = live_topics(source, log.instances)
    imu = require_imu(source, _imu(topics.get("sensor_combined")), "sensor_combined")
    status = topics.get("esc_status") if its_rotors else None
    rotors = _rotor_speeds(source, status, parameters, vehicle, order)
    rotor_speeds, left_out = (None, ()) if rotors is None else without(*rotors, imu)
    air, is_board = _air(topics)
    commands = _commands(
        source, topics.get("actuator_motors") if its_rotors else None, parameters, vehicle, order
    )
    return flight.Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=rotor_speeds,
        pose=_pose(source, topics),
        odometry=_odometry(source, topics, imu),
        commands=commands,
        command_source="" if commands is None else PX4_MOTORS,
        battery=_battery(topics.get("battery_status")),
        pressure=air,
        board_air=is_board,
        quality=DataQuality(left_out=left_out),
    )


def airframe_of(parameters: Mapping[str, float]) -> Airframe | None:
    """What the airframe, its number of rotors or else the type that PX4 announces says of the vehicle."""
    airframe = int(parameters.get("CA_AIRFRAME", 0))
    if airframe in _AIRFRAMES:
        return Airframe(f"CA_AIRFRAME {airframe}", _AIRFRAMES[airframe])
    rotors = int(parameters.get("CA_ROTOR_COUNT", 0))
    if rotors > 0:
        return Airframe.of_rotors(f"CA_ROTOR_COUNT {rotors}", rotors)
    mav_type = int(parameters.get("MAV_TYPE", 0))
    return Airframe.of_mav_type(f"MAV_TYPE {mav_type}", mav_type)


def live_topics(source: str, instances: Sequence[tuple[str, int, Columns]]) -> dict[str, Columns]:
    """Of each topic the first instance that measures: drivers publish empty ones beside it."""
    topics: dict[str, Columns] = {}
    measured: set[str] = set()
    for name, number, columns in sorted(instances, key=itemgetter(1)):
        telling = _TELLING.get(name, ())
        values = [own for field, own in columns.items() if field.endswith(telling)]
        measures = not values or any(map(np.any, values))
        if name in measured or (name in topics and not measures):
            continue
        topics[name] = columns
        if measures:
            measured.add(name)
            if number:
                note(source, f"{name}: instance {number} is read, those before it are empty")
    return topics


class UlogContent(NamedTuple):
    """What pyulog makes of a file.

    Attributes:
        instances: name, number and columns of each instance of a topic.
        parameters: their first values, of any type.
        information: what the file says of firmware and hardware, by name.
        damage: what pyulog printed of it; empty where it found none.
        drop_outs_s: how long each was.
    """

    instances: list[tuple[str, int, Columns]]
    parameters: dict[str, Any]
    information: dict[str, Any]
    damage: str
    drop_outs_s: list[float]


def load_ulog(source: str, path: Path, wanted: Sequence[str] = _TOPICS) -> UlogContent:
    """The content of a file, of the wanted topics; a note says what is wrong with it.

    Raises:
        LogError: if pyulog makes nothing of it.
    """
    require_library("pyulog", "logs")
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise LogError(f"{source}: byte 0: not a ULog file")
    try:
        log: UlogContent = next(read_apart(path.stat().st_size, _decoded, path, wanted))
    except LogError as error:
        raise LogError(f"{source}: {error}") from error
    if log.damage:
        note(source, f"the file is damaged; what can be read is: {log.damage}")
    elif (end := _end_of_messages(path)) is not None:
        note(source, f"byte {end}: the file is cut off in this message; all before it is read")
    if (lost_s := sum(log.drop_outs_s)) > 0.0:
        note(source, f"the autopilot lost {lost_s:.2f} s of the log in {len(log.drop_outs_s)} drop-outs")
    return log


def _decoded(path: Path, wanted: Sequence[str]) -> Iterator[UlogContent]:
    with contextlib.redirect_stdout(io.StringIO()) as said:
        log = require_library("pyulog", "logs").ULog(str(path), list(wanted))
    damage = " ".join(said.getvalue().split())
    if log.file_corruption:
        damage = damage or "pyulog found damaged messages"
    yield UlogContent(
        [(data.name, int(data.multi_id), data.data) for data in log.data_list],
        log.initial_parameters,
        log.msg_info_dict,
        damage,
        [1e-3 * dropout.duration for dropout in log.dropouts],
    )


def _end_of_messages(path: Path) -> int | None:
    """Where the last message begins of a file that ends within it, which pyulog does not say; else None."""
    data = path.read_bytes()
    begin = position = _HEADER_BYTES
    while position < len(data):
        begin = position
        position += _PREFIX_BYTES + int.from_bytes(data[begin : begin + 2], "little")
    return None if position == len(data) else begin


def _stamps(columns: Columns, name: str = "timestamp") -> flight.Stamps:
    ticks = np.minimum(columns[name], np.uint64(2**62 // _US)).astype(np.int64)
    return ticks * _US


def _stack(columns: Columns, *names: str) -> Array:
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def _holds(columns: Columns | None, *names: str) -> bool:
    """Whether a topic is there with these fields; a damaged log may name them otherwise."""
    return columns is not None and all(name in columns for name in ("timestamp", *names))


def _imu(columns: Columns | None) -> flight.ImuStream | None:
    if columns is None or not _holds(columns, *_GYRO, *_ACCELERATION):
        return None
    return flight.ImuStream(_stamps(columns), _stack(columns, *_GYRO), _stack(columns, *_ACCELERATION))


def _battery(columns: Columns | None) -> flight.BatteryStream | None:
    if columns is None or not _holds(columns, "voltage_v"):
        return None
    time_ns, (volts,) = rising(_stamps(columns), columns["voltage_v"].astype(np.float64))
    return flight.BatteryStream(time_ns, volts) if len(time_ns) else None


def _air(topics: Mapping[str, Columns]) -> tuple[flight.AirStream | None, bool]:
    """Pressure and temperature of the air, and whether the latter is that of the barometer's board.

    Since 1.16 `ambient_temperature` is that of an outer sensor, or 15 °C where there is none.
    """
    air, sensor = topics.get("vehicle_air_data"), topics.get("sensor_baro")
    for columns, pressure, celsius in (
        (air, "baro_pressure_pa", "ambient_temperature"),
        (air, "baro_pressure_pa", "baro_temp_celcius"),
        (sensor, "pressure", "temperature"),
    ):
        if columns is None or not _holds(columns, pressure, celsius):
            continue
        is_board = celsius != "ambient_temperature"
        if not is_board and not np.any(columns.get("temperature_source", 0)):
            continue
        time_ns, (pascal, degrees) = rising(
            _stamps(columns), columns[pressure].astype(np.float64), columns[celsius].astype(np.float64)
        )
        if len(time_ns):
            # The messages of a barometer were in hPa up to 1.13.
            pascal = pascal * (100.0 if np.nanmedian(pascal) < _HPA_MAX else 1.0)
            return flight.AirStream(time_ns, pascal, degrees), is_board
    return None, False


def _commands(
    source: str,
    columns: Columns | None,
    parameters: dict[str, float],
    vehicle: Vehicle | None,
    order: RotorOrder | None,
) -> flight.MotorCommandStream | None:
    """Commands from 0 to 1 by motor, since 1.13; one that is not a number is of a motor that stands."""
    if columns is None:
        return None
    order = order or _motors_of(parameters, vehicle)
    order = order or order_of_commands(source, vehicle, rotors=_rotors_of(parameters, vehicle))
    names = [] if order is None else [f"control[{number}]" for number in order.controllers]
    if not names or not _holds(columns, *names):
        return None
    values = np.nan_to_num(_stack(columns, *names), nan=0.0)
    return flight.MotorCommandStream(_sampled(columns), np.clip(values, 0.0, 1.0))


def _odometry(source: str, topics: dict[str, Columns], imu: flight.ImuStream) -> flight.OdometryStream | None:
    local, turned = topics.get("vehicle_local_position"), topics.get("vehicle_attitude")
    if turned is None or not _holds(turned, *_QUATERNION):
        return None
    attitude = unit_attitudes(
        source, flight.OdometryStream.topic, _sampled(turned), _stack(turned, *_QUATERNION)
    )
    if local is None or not _holds(local, *_LOCAL_POSITION, *_LOCAL_VELOCITY, *_VALID):
        return attitude_alone(attitude, imu)
    valid = np.all([local[name].astype(bool) for name in _VALID], axis=0)
    if not np.all(valid):
        note(source, f"topic odometry: {np.count_nonzero(~valid)} of {len(valid)} positions are not valid")
    if not np.any(valid):
        return attitude_alone(attitude, imu)
    time_ns, (position, velocity) = rising(
        _sampled(local)[valid], _stack(local, *_LOCAL_POSITION)[valid], _stack(local, *_LOCAL_VELOCITY)[valid]
    )
    return odometry_of(time_ns, position, velocity, attitude, imu)


def _sampled(columns: Columns) -> flight.Stamps:
    """When a topic was measured; older releases say only when it was published."""
    name = "timestamp_sample"
    return _stamps(columns, name if name in columns and np.all(columns[name] > 0) else "timestamp")


def _pose(source: str, topics: dict[str, Columns]) -> flight.PoseStream | None:
    """Motion capture, under either of its names."""
    for name in ("vehicle_mocap_odometry", "vehicle_visual_odometry"):
        columns = topics.get(name)
        if columns is None:
            continue
        names = _MOCAP_POSITION if "position[0]" in columns else _LOCAL_POSITION
        if not _holds(columns, *names, *_QUATERNION):
            continue
        frame = next((key for key in _POSE_FRAMES if key in columns), None)
        if frame is not None:
            known = np.isin(columns[frame], list(_POSE_FRAMES[frame]))
            if not known.all():
                share = f" {np.count_nonzero(~known)} of {len(known)}" if known.any() else ""
                said = f"left out{share}, {name} is in a frame that is neither NED nor FRD"
                note(source, f"topic mocap/pose: {said}")
            columns = {key: values[known] for key, values in columns.items()}
        quaternion = _stack(columns, *_QUATERNION)
        is_unit = has_attitude(source, flight.PoseStream.topic, quaternion)
        position, attitude = _stack(columns, *names)[is_unit], normalised_attitude(quaternion[is_unit])
        stream = flight.PoseStream(_sampled(columns)[is_unit], position, attitude)
        if len(stream):
            return stream
    return None


def _rotor_speeds(
    source: str,
    columns: Columns | None,
    parameters: dict[str, float],
    vehicle: Vehicle | None,
    order: RotorOrder | None,
) -> tuple[flight.RotorSpeedStream, npt.NDArray[np.uint8]] | None:
    """Speeds of all messages, and which form a sample, as those of px4_msgs/EscStatus do.

    `esc_status` holds 8 reports, 12 since 1.17; which motor each is says actuator_function, since 1.12.
    """
    if columns is None or not _holds(columns):
        return None
    if order is None:
        order = _order(source, columns, parameters, vehicle)
    names = [f"esc[{number}].esc_rpm" for number in order.controllers]
    if not all(name in columns for name in names):
        note(source, "topic rotor_speeds: left out, esc_status has fewer reports than the mapping names")
        return None
    rpm = _stack(columns, *names)
    if not np.any(rpm):
        note(source, f"topic rotor_speeds: left out, every rpm of esc_status is zero: {NO_TELEMETRY}")
        return None
    return RotorReader(order, vehicle).judged(_reports(columns, rpm, order))


def _reports(columns: Columns, rpm: Array, order: RotorOrder) -> EscReports:
    """What the messages say of the rotors' controllers; older releases, and some drivers, leave parts out."""
    numbers = np.array(order.controllers)
    count = len(rpm)
    stamps = [columns.get(f"esc[{number}].timestamp", np.zeros(count)).astype(np.int64) for number in numbers]
    told = np.stack(stamps, axis=1)
    marks = np.where(np.any(told > 0, axis=0), told, np.arange(1, count + 1)[:, np.newaxis])
    flags = columns.get("esc_online_flags", np.zeros(count)).astype(np.int64)
    online = flags[:, np.newaxis] >> numbers & 1 == 1
    # A bit that is never set says nothing: drivers leave it out. One that never answers reads 0 all flight.
    online |= ~np.any(online, axis=0)
    verdict = np.full(count, Verdict.SAMPLE, dtype=np.uint8)
    verdict[np.any(marks == 0, axis=1)] = Verdict.NEVER_REPORTED
    verdict[~np.all(online, axis=1)] = Verdict.OFFLINE
    return EscReports(_stamps(columns), rpm, marks, verdict)


def _order(
    source: str, columns: Columns, parameters: dict[str, float], vehicle: Vehicle | None
) -> RotorOrder:
    """Report of each rotor: from motor to report by actuator_function, from rotor to motor by position."""
    motors = _motors_of(parameters, vehicle)
    if motors is None:
        motors = by_frame(source, vehicle, unit=RPM, rotors=_rotors_of(parameters, vehicle))
        layout = usual_layout(vehicle, len(motors.controllers))
        note(source, f"topic rotor_speeds: no rotor positions in the log; its motors are taken as {layout}")
    reports = {}
    for report in range(len([name for name in columns if name.endswith("].esc_rpm")])):
        functions = columns.get(f"esc[{report}].actuator_function")
        if functions is not None and functions[-1] >= _FIRST_MOTOR:
            reports[int(functions[-1]) - _FIRST_MOTOR] = report
    if not all(motor in reports for motor in motors.controllers):
        return motors
    return RotorOrder(tuple(reports[motor] for motor in motors.controllers), RPM)


def motors_of(parameters: Mapping[str, float], rotors: int) -> list[Motor]:
    """The motors where the parameters have them; at the centre where they do not."""
    numbers = [[parameters.get(f"CA_ROTOR{motor}_{key}", 0.0) for key in _MOTOR] for motor in range(rotors)]
    # A positive moment coefficient is that of a rotor that turns counterclockwise.
    return [Motor(x, y, -moment) for x, y, moment in numbers]


def _motors_of(parameters: dict[str, float], vehicle: Vehicle | None) -> RotorOrder | None:
    """Motor of each rotor by its position; None where the log does not say it."""
    return RotorOrder.by_place(vehicle, motors_of(parameters, _rotors_of(parameters, vehicle)), RPM)


def _rotors_of(parameters: dict[str, float], vehicle: Vehicle | None) -> int:
    """The number of rotors of the vehicle, else that which the log says, else four."""
    if vehicle is not None:
        return vehicle.rotor_count
    said = int(parameters.get("CA_ROTOR_COUNT", 0))
    return said if 0 < said <= ROTORS_MAX else ROTORS


FORMAT = LogFormat(
    description="PX4 log (.ulg)",
    read=read_px4,
    begins=lambda head: head.startswith(_MAGIC),
    suffixes=(".ulg",),
    load_mapping=RotorOrder.load,
    remedies={
        "imu": "SDLOG_PROFILE 25 logs it at its own rate",
        "rotor_speeds": "DSHOT_TEL_CFG (or DroneCAN) makes ESCs report, SDLOG_PROFILE 25 logs all reports",
        "odometry": "SDLOG_PROFILE 25 logs it at its own rate",
        "mocap/pose": "SDLOG_PROFILE 153 (25 and computer vision) logs it as it comes",
    },
)
