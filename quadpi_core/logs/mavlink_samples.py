# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of MAVLink messages into samples of the core, for both the live bridge and .tlog files.

MAVLink's body axes are forward-right-down and its world is north-east-down unless a message names other
frames. Stamps count from the boot of the sender or from 1970; some messages have no stamp.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpi_core import flight, frames
from quadpi_core.findings import REASONS, UnusableReports, Verdict
from quadpi_core.messages.adapters.rotor_messages import shares_of_outputs
from quadpi_core.records import NORM_TOLERANCE, STANDARD_GRAVITY
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

ARDUPILOT, PX4 = 3, 12
AUTOPILOT_INVALID = 8
GROUND_STATION, ONBOARD_CONTROLLER = 6, 18

# Message names per topic, the best first.
SOURCES = {
    "imu": ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    "rotor_speeds": ("ESC_STATUS", "ESC_TELEMETRY", "RAW_RPM"),
    "mocap/pose": ("ATT_POS_MOCAP", "VISION_POSITION_ESTIMATE", "ODOMETRY pose"),
    "odometry": ("ODOMETRY", "LOCAL_POSITION_NED"),
}

# The same of what a log tells beside them: commands, battery and air.
BESIDE = {
    "motor_commands": ("ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW"),
    "battery": ("BATTERY_STATUS", "SYS_STATUS"),
    "pressure": ("SCALED_PRESSURE",),
}
# Streams of numbers by topic, and of vectors, with the columns of a row at which one follows another.
_SCALARS: dict[str, Callable[..., flight.Stream]] = {
    "battery": flight.BatteryStream,
    "pressure": flight.AirStream,
}
_VECTORS: dict[str, tuple[Callable[..., flight.Stream], list[int]]] = {
    **{
        "imu": (flight.ImuStream, [3]),
        "mocap/pose": (flight.PoseStream, [3]),
        "odometry": (flight.OdometryStream, [3, 7, 10]),
    },
    **{"rotor_speeds": (flight.RotorSpeedStream, []), "motor_commands": (flight.MotorCommandStream, [])},
}
_EPOCH_US = 10**15
# Later stamps, after the year 2090, are invalid.
LATEST_US = 4 * 10**15
_MILLI_G = STANDARD_GRAVITY * 1e-3
_ACCELEROMETER_AND_GYRO = 0x3F
_ESCS_PER_MESSAGE = 4
_FIRST_CONTROLLERS = 0xF
# Largest difference in time between the speeds of the rotors in one sample.
_ROTOR_SPREAD_S = 0.05
# Longest extrapolation of an attitude by its rates.
_ATTITUDE_AGE_S = 0.2
# frame_id of ODOMETRY: local NED, ENU, forward-right-down, forward-left-up. child_frame_id: body FRD, FLU.
_LOCAL_NED, _LOCAL_ENU, _LOCAL_FRD, _LOCAL_FLU = 1, 4, 20, 21
_BODY_NED, _BODY_FRD, _BODY_FLU = 8, 12, 13


class Sample(NamedTuple):
    """One sample of a topic.

    Attributes:
        topic: of its stream.
        source: name of the message.
        clock_us: stamp by the clock of the sender; None for a message without one.
        values: row in the order of the stream's fields.
    """

    topic: str
    source: str
    clock_us: int | None
    values: frames.Array


def stream_of(topic: str, time_ns: flight.Stamps, rows: frames.Array) -> flight.Stream:
    """Stream of one topic from the rows (N, width) of its samples."""
    if topic in _SCALARS:
        return _SCALARS[topic](time_ns, *rows.T)
    kind, ends = _VECTORS[topic]
    return kind(time_ns, *np.hsplit(rows, ends))


class _RefusedError(Exception):
    """Why a message gives no sample."""


def is_epoch(clock_us: int) -> bool:
    """Whether a stamp counts from 1970 instead of from the boot of the sender (MAVLink leaves both open)."""
    return clock_us > _EPOCH_US


def is_autopilot(heartbeat: Any) -> bool:
    """Whether a heartbeat comes from the autopilot of a vehicle, not from a companion or ground station."""
    is_vehicle = heartbeat.type not in (GROUND_STATION, ONBOARD_CONTROLLER)
    return is_vehicle and heartbeat.autopilot != AUTOPILOT_INVALID


class MavlinkSamples:
    """Decodes the messages of one vehicle into samples, one at a time, and counts refused messages by reason.

    No payload raises an exception.

    Args:
        vehicle: its pole pairs are needed for electrical speeds only; may be None otherwise.
        order: speed controller of each rotor, and the unit: rpm unless it is erpm.

    Attributes:
        refused: number of refused messages by "NAME: reason".
        unusable: those among the messages with the speed of a rotor; stamps are their arrivals.
        autopilot, vehicle_type: MAV_AUTOPILOT and MAV_TYPE of the last heartbeat, or None.
    """

    def __init__(self, vehicle: Vehicle | None, order: RotorOrder) -> None:
        self.refused: Counter[str] = Counter()
        self.unusable = UnusableReports()
        self.autopilot: int | None = None
        self.vehicle_type: int | None = None
        self._vehicle = vehicle
        self._order = order
        self._speeds = np.zeros(len(order.controllers))
        self._speed_time = [-math.inf] * len(self._speeds)
        self._speed_count: dict[int, int] = {}
        self._online = -1
        self._attitude: tuple[float, frames.Array, frames.Array] | None = None
        self._decoders: dict[str, Callable[[Any, float], Sample | None]] = {
            "HEARTBEAT": self._heartbeat,
            "HIGHRES_IMU": self._highres_imu,
            "RAW_IMU": self._raw_imu,
            "SCALED_IMU": self._scaled_imu,
            "SCALED_IMU2": self._scaled_imu,
            "SCALED_IMU3": self._scaled_imu,
            "ATTITUDE": self._take_angles,
            "ATTITUDE_QUATERNION": self._take_quaternion,
            "LOCAL_POSITION_NED": self._local_position,
            "ODOMETRY": self._odometry,
            "ATT_POS_MOCAP": self._mocap,
            "VISION_POSITION_ESTIMATE": self._vision,
            "ESC_INFO": self._esc_info,
            "ESC_STATUS": self._esc_status,
            "ESC_TELEMETRY_1_TO_4": self._esc_telemetry,
            "ESC_TELEMETRY_5_TO_8": self._esc_telemetry,
            "ESC_TELEMETRY_9_TO_12": self._esc_telemetry,
            "RAW_RPM": self._raw_rpm,
            "ACTUATOR_OUTPUT_STATUS": self._outputs,
            "SERVO_OUTPUT_RAW": self._servos,
            "BATTERY_STATUS": self._battery,
            "SYS_STATUS": self._system,
            "SCALED_PRESSURE": self._pressure,
        }

    @property
    def names(self) -> frozenset[str]:
        """Messages that are decoded."""
        return frozenset(self._decoders)

    def decode(self, message: Any, arrival_s: float) -> Sample | None:
        """The sample that a message completes; None if it does not complete one or is refused.

        Args:
            message: of pymavlink.
            arrival_s: time of its arrival by any steady clock.
        """
        name = message.get_type()
        decoder = self._decoders.get(name)
        if decoder is None:
            return None
        # Checked before decoding: decoders keep stamps for later samples.
        try:
            if getattr(message, "time_usec", 0) > LATEST_US or getattr(message, "usec", 0) > LATEST_US:
                raise _RefusedError("an impossible stamp")
            sample = decoder(message, arrival_s)
            if sample is not None:
                _finite(sample.values)
        except _RefusedError as refusal:
            self.refused[f"{name}: {refusal}"] += 1
            return None
        return sample

    def _heartbeat(self, message: Any, _: float) -> None:
        if is_autopilot(message):
            self.autopilot, self.vehicle_type = message.autopilot, message.type

    def _highres_imu(self, m: Any, _: float) -> Sample | None:
        if m.id != 0:
            return None
        if m.fields_updated & _ACCELEROMETER_AND_GYRO != _ACCELEROMETER_AND_GYRO:
            raise _RefusedError("no new accelerometer and gyro values in it")
        row = np.array((m.xgyro, m.ygyro, m.zgyro, m.xacc, m.yacc, m.zacc))
        return Sample("imu", "HIGHRES_IMU", m.time_usec, row)

    def _raw_imu(self, m: Any, _: float) -> Sample | None:
        if m.id != 0:
            return None
        if self.autopilot != ARDUPILOT:
            raise _RefusedError("in a unit that only ArduPilot keeps to (mg, mrad/s)")
        return Sample("imu", "RAW_IMU", m.time_usec, _milli_units(m))

    def _scaled_imu(self, m: Any, _: float) -> Sample | None:
        return Sample("imu", m.get_type(), m.time_boot_ms * 1000, _milli_units(m))

    def _take_quaternion(self, m: Any, _: float) -> None:
        attitude = _unit((m.q1, m.q2, m.q3, m.q4))
        rates = _finite((m.rollspeed, m.pitchspeed, m.yawspeed))
        self._attitude = (m.time_boot_ms * 1e-3, attitude, rates)

    def _take_angles(self, m: Any, _: float) -> None:
        angles = _finite((m.roll, m.pitch, m.yaw))
        rates = _finite((m.rollspeed, m.pitchspeed, m.yawspeed))
        self._attitude = (m.time_boot_ms * 1e-3, frames.quaternion_from_roll_pitch_yaw(angles), rates)

    def _local_position(self, m: Any, _: float) -> Sample | None:
        if self._attitude is None:
            raise _RefusedError("no attitude yet")
        time_s, attitude, rates = self._attitude
        ahead_s = m.time_boot_ms * 1e-3 - time_s
        if abs(ahead_s) > _ATTITUDE_AGE_S:
            raise _RefusedError(f"no attitude within {_ATTITUDE_AGE_S} s")
        velocity = _finite((m.vx, m.vy, m.vz))
        attitude = np.array(frames.product(attitude, frames.from_rotation_vector(ahead_s * rates)))
        velocity = frames.rotate_world_to_body(attitude, velocity)
        row = np.concatenate(((m.x, m.y, m.z), attitude, velocity, rates))
        return Sample("odometry", "LOCAL_POSITION_NED", m.time_boot_ms * 1000, row)

    def _odometry(self, m: Any, _: float) -> Sample | None:
        """Velocity and rates are in the child frame (mavlink.io, ODOMETRY)."""
        attitude = _unit(m.q)
        position = np.array((m.x, m.y, m.z))
        velocity = np.array((m.vx, m.vy, m.vz))
        rates = np.array((m.rollspeed, m.pitchspeed, m.yawspeed))
        if m.child_frame_id == _BODY_FLU:
            attitude = frames.quaternion_body_flu_to_frd(attitude)
            velocity, rates = frames.body_flu_to_frd(velocity), frames.body_flu_to_frd(rates)
        elif m.child_frame_id not in {_BODY_FRD, _BODY_NED}:
            raise _RefusedError(f"child_frame_id {m.child_frame_id} is not known")
        if m.frame_id == _LOCAL_ENU:
            position, attitude = (
                frames.world_enu_to_ned(position),
                frames.quaternion_world_enu_to_ned(attitude),
            )
        elif m.frame_id == _LOCAL_FLU:
            # By half a turn about x: (0, 1, 0, 0) * q.
            w, x, y, z = attitude
            position, attitude = frames.body_flu_to_frd(position), np.array((-x, w, -z, y))
        elif m.frame_id not in {_LOCAL_NED, _LOCAL_FRD}:
            raise _RefusedError(f"frame_id {m.frame_id} is not known")
        if np.isnan(np.concatenate((velocity, rates))).any():
            # ODOMETRY from motion capture has no velocity.
            return Sample("mocap/pose", "ODOMETRY pose", m.time_usec, np.concatenate((position, attitude)))
        row = np.concatenate((position, attitude, velocity, rates))
        return Sample("odometry", "ODOMETRY", m.time_usec, row)

    def _mocap(self, m: Any, _: float) -> Sample | None:
        row = np.concatenate(((m.x, m.y, m.z), _unit(m.q)))
        return Sample("mocap/pose", "ATT_POS_MOCAP", m.time_usec, row)

    def _vision(self, m: Any, _: float) -> Sample | None:
        angles = _finite((m.roll, m.pitch, m.yaw))
        row = np.concatenate(((m.x, m.y, m.z), frames.quaternion_from_roll_pitch_yaw(angles)))
        return Sample("mocap/pose", "VISION_POSITION_ESTIMATE", m.usec, row)

    def _esc_info(self, m: Any, _: float) -> None:
        """Store which of the first four controllers are online; for later ones senders differ in the bits."""
        if m.index == 0:
            self._online = m.info | ~_FIRST_CONTROLLERS

    def _esc_status(self, m: Any, arrival_s: float) -> Sample | None:
        """Mechanical rpm; negative for a rotor that turns backward."""
        return self._rotors("ESC_STATUS", m.index, m.rpm, m.time_usec, arrival_s)

    def _esc_telemetry(self, m: Any, arrival_s: float) -> Sample | None:
        """Mechanical rpm; `count` increases for controllers that have reported since the last message."""
        name = m.get_type()
        first = int(name.split("_")[2]) - 1
        fresh = [self._speed_count.get(first + k) != count for k, count in enumerate(m.count)]
        self._speed_count.update((first + k, count) for k, count in enumerate(m.count))
        mapped = [k for k in range(_ESCS_PER_MESSAGE) if first + k in self._order.controllers]
        if mapped and not any(fresh[k] for k in mapped):
            return self._report("ESC_TELEMETRY", Verdict.REPEATED, arrival_s)
        return self._rotors("ESC_TELEMETRY", first, m.rpm, None, arrival_s)

    def _raw_rpm(self, m: Any, arrival_s: float) -> Sample | None:
        """Revolutions per minute of one sensor."""
        return self._rotors("RAW_RPM", m.index, (m.frequency,), None, arrival_s)

    def _outputs(self, m: Any, _: float) -> Sample | None:
        """PX4's outputs, as its log has them."""
        return self._commands("ACTUATOR_OUTPUT_STATUS", m.time_usec, m.actuator)

    def _servos(self, m: Any, _: float) -> Sample | None:
        """Pulses of the first port, the motors'; its stamp has 32 bits and begins again each 72 minutes."""
        if m.port != 0:
            return None
        return self._commands(
            "SERVO_OUTPUT_RAW", None, [getattr(m, f"servo{number}_raw") for number in range(1, 17)]
        )

    def _commands(self, name: str, clock_us: int | None, outputs: Sequence[float]) -> Sample | None:
        own = np.array([outputs[controller] for controller in self._order.controllers], dtype=np.float64)
        if self.autopilot == ARDUPILOT:
            # Pulses of 1000 to 2000 µs; 0 is no pulse.
            return Sample("motor_commands", name, clock_us, np.clip(1e-3 * (own - 1000.0), 0.0, 1.0))
        return Sample("motor_commands", name, clock_us, shares_of_outputs(np.nan_to_num(own)[np.newaxis])[0])

    def _battery(self, m: Any, _: float) -> Sample | None:
        """Of the first battery the sum of its cells, in mV; 65535 is of a cell that is not there."""
        cells = [volts for volts in m.voltages if volts not in {0, 0xFFFF}]
        if m.id != 0 or not cells:
            return None
        return Sample("battery", "BATTERY_STATUS", None, np.array([1e-3 * sum(cells)]))

    def _system(self, m: Any, _: float) -> Sample | None:
        if m.voltage_battery in {0, 0xFFFF}:
            return None
        return Sample("battery", "SYS_STATUS", None, np.array([1e-3 * m.voltage_battery]))

    def _pressure(self, m: Any, _: float) -> Sample | None:
        """hPa, and hundredths of °C of the barometer's board."""
        row = np.array([100.0 * m.press_abs, 0.01 * m.temperature])
        return Sample("pressure", "SCALED_PRESSURE", m.time_boot_ms * 1000, row)

    def _rotors(
        self, source: str, first: int, rpm: Sequence[float], clock_us: int | None, arrival_s: float
    ) -> Sample | None:
        """Store these speeds; a sample once every rotor has reported since the last one."""
        now_s = arrival_s if clock_us is None else clock_us * 1e-6
        own = [(k, c) for k, c in enumerate(self._order.controllers) if first <= c < first + len(rpm)]
        if not own:
            return None
        for _, controller in own:
            if source == "ESC_STATUS" and not self._online >> controller & 1:
                return self._report(source, Verdict.OFFLINE, arrival_s, f": controller {controller + 1}")
        self._report(source, Verdict.SAMPLE, arrival_s)
        for rotor, controller in own:
            self._speeds[rotor] = rpm[controller - first]
            self._speed_time[rotor] = now_s
        if not all(now_s - _ROTOR_SPREAD_S <= then <= now_s for then in self._speed_time):
            return None
        self._speed_time = [-math.inf] * len(self._speeds)
        speeds = self._order.speeds(self._speeds[np.newaxis], self._vehicle)[0]
        return Sample("rotor_speeds", source, clock_us, speeds)

    def _report(self, source: str, verdict: Verdict, arrival_s: float, more: str = "") -> Sample | None:
        """Count a message with the speed of a rotor; returns the sample that a refused one does not give."""
        self.unusable.add(np.array([round(1e9 * arrival_s)]), np.array([verdict], np.uint8))
        if verdict != Verdict.SAMPLE:
            self.refused[f"{source}: {REASONS[verdict]}{more}"] += 1
        return None


def _finite(values: Sequence[float] | frames.Array) -> frames.Array:
    """The values as an array; the message is refused if one is not finite."""
    finite = np.array(values, dtype=np.float64)
    if not np.isfinite(finite).all():
        raise _RefusedError("values that are not finite")
    return finite


def _unit(quaternion: Sequence[float]) -> frames.Array:
    attitude = np.array(quaternion, dtype=np.float64)
    norm = float(np.sqrt(np.sum(attitude * attitude)))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        raise _RefusedError("the attitude is no unit quaternion")
    return attitude / norm


def _milli_units(m: Any) -> frames.Array:
    rates = np.array((m.xgyro, m.ygyro, m.zgyro)) * 1e-3
    return np.concatenate((rates, np.array((m.xacc, m.yacc, m.zacc)) * _MILLI_G))
