# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""px4_msgs of motors and battery, and VehicleOdometry and SensorCombined: FRD body, NED or FRD world, SI.

An FRD world is NED with another heading; nothing in the core depends on where north is, so both are accepted.
Stamps count microseconds: of the companion's clock if the uXRCE-DDS agent synchronises (its default), else
since the autopilot started.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import SampleError
from quadpi_core.flight import NOT_MEASURED, AirStream, ImuStream, OdometryStream, Stamps, Stream
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.inputs import celsius_of
from quadpi_core.messages.adapters.adapter_definition import Adapter, Reading, of_items
from quadpi_core.messages.adapters.rotor_messages import (
    MOTORS,
    EscReports,
    reports_of_motors,
    shares_of_outputs,
    start_of_battery,
    start_of_commands,
    start_of_rotors,
)
from quadpi_core.messages.cdr import Columns, microsecond_stamps
from quadpi_core.messages.definitions import Items
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import NORM_TOLERANCE
from quadpi_core.vehicle import Vehicle

_NED, _FRD, _BODY = 1, 2, 3
_VARIANCES = ("position_variance", "orientation_variance", "velocity_variance")


def _read_odometry(columns: Columns, dropped: Counter[str]) -> OdometryStream:
    """The states that N px4_msgs/VehicleOdometry hold, 1.14 and later; NaN says that something is not known.

    Raises:
        SampleError: naming the sample whose frames are not known, or whose velocity is in another world
            frame than its pose.
    """
    measured_us = np.where(columns["timestamp_sample"] > 0, columns["timestamp_sample"], columns["timestamp"])
    time_ns = microsecond_stamps(measured_us)
    position, attitude, velocity, rates = (
        columns[name].astype(np.float64) for name in ("position", "q", "velocity", "angular_velocity")
    )
    norm = np.linalg.norm(attitude, axis=1)
    usable = np.ones(len(norm), dtype=bool)
    for name, known in (
        ("attitude is", np.abs(norm - 1.0) <= NORM_TOLERANCE),
        ("position is", np.isfinite(position).all(axis=1)),
        ("velocity is", np.isfinite(velocity).all(axis=1)),
        ("rates are", np.isfinite(rates).all(axis=1)),
    ):
        if missing := int(np.sum(usable & ~known)):
            dropped[f"the {name} not known"] += missing
        usable &= known
    pose_frame, velocity_frame = columns["pose_frame"], columns["velocity_frame"]
    in_body = velocity_frame == _BODY
    in_world = (pose_frame == _NED) | (pose_frame == _FRD)
    wrong = usable & ~(in_world & (in_body | (velocity_frame == pose_frame)))
    if wrong.any():
        sample = int(np.argmax(wrong))
        raise SampleError(
            sample,
            f"pose_frame {pose_frame[sample]}, velocity_frame {velocity_frame[sample]}: "
            "they must name the same world, or the latter the body",
        )
    attitude = attitude[usable] / norm[usable, np.newaxis]
    turned = rotate_world_to_body(attitude, velocity[usable])
    return OdometryStream(
        time_ns=time_ns[usable],
        position=position[usable],
        attitude=attitude,
        velocity=np.where(in_body[usable, np.newaxis], velocity[usable], turned),
        rates=rates[usable],
        deviation=np.stack([_deviation(columns[name])[usable] for name in _VARIANCES], axis=1),
    )


def _deviation(variances: Array) -> Array:
    """Root mean square (N,) of deviations by their variances (N, 3); 0 where NaN says that none is known.

    One that is larger than any estimator knows says that the part was not measured, as in other messages.
    """
    mean = np.mean(variances.astype(np.float64), axis=1)
    known = np.sqrt(np.where(mean > 0.0, mean, 0.0))
    return np.where(mean >= compiled.UNKNOWN_VARIANCE, NOT_MEASURED, known)


def _read_imu(columns: Columns) -> ImuStream:
    """px4_msgs/SensorCombined; its stamps are those of the gyro."""
    gyro, force = (columns[name].astype(np.float64) for name in ("gyro_rad", "accelerometer_m_s2"))
    return ImuStream(_stamps(columns), gyro, force)


def _status(columns: Columns, items: dict[str, Items], order: Indices) -> EscReports:
    """Reports of px4_msgs/EscStatus: `actuator_function` names the motor, in any place of the array."""
    array = items["esc"]
    return reports_of_motors(
        array.columns["actuator_function"].astype(np.int64),
        array.columns["esc_rpm"].astype(np.float64),
        array.columns["timestamp"].astype(np.int64),
        columns["esc_online_flags"].astype(np.int64),
        order + MOTORS[0],
        _stamps(columns),
    )


def _odometry(_settings: object, _vehicle: Vehicle | None) -> Reading:
    dropped: Counter[str] = Counter()
    return Reading(lambda columns, _: _read_odometry(columns, dropped), lambda: dropped)


def _each(read: Callable[[Columns], Stream]) -> Callable[[object, Vehicle | None], Reading]:
    """`Adapter.start` of messages that each hold a sample."""
    return lambda _settings, _vehicle: Reading(lambda columns, _items: read(columns), Counter)


def _read_air(columns: Columns) -> AirStream:
    """px4_msgs/VehicleAirData, with the temperature by which PX4 made its density."""
    pascal, density = columns["baro_pressure_pa"].astype(np.float64), columns["rho"].astype(np.float64)
    known = (pascal > 0.0) & (density > 0.0)
    celsius = celsius_of(np.where(known, pascal, np.nan), np.where(known, density, 1.0))
    return AirStream(_stamps(columns), np.where(known, pascal, np.nan), celsius)


def _stamps(columns: Columns) -> Stamps:
    return microsecond_stamps(columns["timestamp"])


COMMANDS = Adapter(
    name="px4_motors",
    type_name="px4_msgs/msg/ActuatorMotors",
    topic="fmu/out/actuator_motors",
    kind="motor_commands",
    columns={"timestamp": 1, "control": 12},
    start=start_of_commands("control", _stamps, lambda shares: np.clip(shares, 0.0, 1.0)),
    battery=("px4_battery", "fmu/out/battery_status"),
)
OUTPUTS = Adapter(
    name="px4_outputs",
    type_name="px4_msgs/msg/ActuatorOutputs",
    topic="fmu/out/actuator_outputs",
    kind="motor_commands",
    columns={"timestamp": 1, "output": 16},
    start=start_of_commands("output", _stamps, shares_of_outputs),
    battery=("px4_battery", "fmu/out/battery_status"),
)
BATTERY = Adapter(
    name="px4_battery",
    type_name="px4_msgs/msg/BatteryStatus",
    topic="fmu/out/battery_status",
    kind="battery",
    columns={"timestamp": 1, "voltage_v": 1},
    start=start_of_battery("voltage_v", _stamps),
)
AIR = Adapter(
    name="px4_air",
    type_name="px4_msgs/msg/VehicleAirData",
    topic="fmu/out/vehicle_air_data",
    kind="pressure",
    # The temperature has another name since 1.16.
    columns={"timestamp": 1, "baro_pressure_pa": 1, "rho": 1},
    start=_each(_read_air),
)
STATUS = Adapter(
    name="px4_status",
    type_name="px4_msgs/msg/EscStatus",
    topic="fmu/out/esc_status",
    kind="rotor_speeds",
    columns={"timestamp": 1, "esc_online_flags": 1}
    | of_items("esc", timestamp=1, esc_rpm=1, actuator_function=1),
    start=start_of_rotors(_status),
)
ODOMETRY = Adapter(
    name="px4_odometry",
    type_name="px4_msgs/msg/VehicleOdometry",
    topic="fmu/out/vehicle_odometry",
    kind="odometry",
    columns={
        **{"timestamp": 1, "timestamp_sample": 1, "pose_frame": 1, "velocity_frame": 1},
        **{"position": 3, "q": 4, "velocity": 3, "angular_velocity": 3},
        **dict.fromkeys(_VARIANCES, 3),
    },
    start=_odometry,
)
IMU = Adapter(
    name="px4_imu",
    type_name="px4_msgs/msg/SensorCombined",
    topic="fmu/out/sensor_combined",
    kind="imu",
    columns={"timestamp": 1, "gyro_rad": 3, "accelerometer_m_s2": 3},
    start=_each(_read_imu),
)
