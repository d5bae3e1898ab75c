# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bridge node: MAVLink of an autopilot in, standard sensor topics out; the alarm of the monitor goes back.

A thread reads the link and publishes, so that samples wait for nothing; the executor serves only parameters
and diagnostics.
"""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, MotorCommands, RotorSpeeds
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import BatteryState, Imu

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.logs.mavlink_frames import signing_key
from quadpi_core.logs.mavlink_samples import stream_of
from quadpi_core.logs.mavlink_session import MavlinkSession, SessionReport, SessionSettings
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle
from quadpi_ros import callbacks
from quadpi_ros.callbacks import OUTPUT_QOS, SENSOR_QOS, DiscoveryError, GuardedNode, await_subscribers
from quadpi_ros.mavlink_link import AlarmTold, Chunk, Link, Text, check_connection, is_replay, open_link
from quadpi_ros.parameters import STANDARD_ORDER, BridgeParameters, ParameterError, read_parameters
from quadpi_ros.runtime import run, spin

_READ_TIMEOUT_S = 0.02
# First and longest wait before a broken link is opened again.
_BACK_OFF_S = (0.5, 8.0)
# An autopilot that sends nothing for longer is reported.
_SILENT_S = 2.0
_STOP_TIMEOUT_S = 5.0
# A log waits this long for a subscriber of imu.
_SUBSCRIBER_WAIT_S = 10.0
# Time for the last messages to be sent before the participant closes.
_FLUSH_S = 0.2
# Ignored systems that the diagnostics name: those that send most, as a sender can claim any number of ids.
_OTHERS_NAMED = 8
# What keeps the sensors from coming is logged when this many diagnostics in a row say so.
_LOGGED_AT = 2
_SECONDS = re.compile(r" for \d+ s$")


class _Reported(NamedTuple):
    """Time and counts of the last diagnostics."""

    at_s: float
    samples: dict[str, int]
    rivals: dict[str, int]


class MavlinkBridge(GuardedNode):
    """Publishes what the autopilot sends of `imu`, `rotor_speeds`, `mocap/pose`, `mocap/odometry`.

    And of `motor_commands`, shares of their range in the vehicle's rotor order, and `battery`.

    Args:
        node: keyword arguments of rclpy's Node.

    Attributes:
        connections: number of times that the link was opened.

    Raises:
        ParameterError: for wrong parameters.
        LogError: if pymavlink is not installed, or a telemetry log has no packets.
        LinkError: for an invalid connection string.
    """

    def __init__(self, **node: Any) -> None:
        super().__init__("mavlink_bridge", **node)
        self._given = read_parameters(self, BridgeParameters)
        check_connection(self._given.connection)
        vehicle = Vehicle.load(self._given.vehicle)
        self._session = MavlinkSession(vehicle, _order(self._given, vehicle), _settings(self._given))
        # A link is opened again after a failure; a log that cannot be read is an error at once.
        self._link: Link | None = open_link(self._given.connection) if self._is_replay else None
        self._imu_publisher = self.create_publisher(Imu, "imu", SENSOR_QOS)
        self._publish: dict[str, Callable[[Any], None]] = {
            "imu": self._imu_publisher.publish,
            "rotor_speeds": self.create_publisher(RotorSpeeds, "rotor_speeds", SENSOR_QOS).publish,
            "mocap/pose": self.create_publisher(PoseStamped, "mocap/pose", SENSOR_QOS).publish,
            "odometry": self.create_publisher(Odometry, "mocap/odometry", SENSOR_QOS).publish,
            "motor_commands": self.create_publisher(MotorCommands, "motor_commands", SENSOR_QOS).publish,
            "battery": self.create_publisher(BatteryState, "battery", SENSOR_QOS).publish,
        }
        self._told = AlarmTold()
        self.create_subscription(ExtrapolationAlarm, "extrapolation_alarm", self._tell, OUTPUT_QOS, raw=True)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._problem: str | None = "not connected yet"
        self.connections = 0
        self._reported = _Reported(time.monotonic(), {}, {})
        # Other autopilots that have been logged.
        self._rivals: set[str] = set()
        # What keeps the sensors from coming, in how many diagnostics in a row it was found, and whether
        # "active" is to be logged once it ends, as at the start.
        self._unusable: tuple[str | None, int] = (None, 0)
        self._logs_active = True
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._thread = threading.Thread(target=self._serve, name="mavlink", daemon=True)
        self._thread.start()

    @property
    def _is_replay(self) -> bool:
        return is_replay(self._given.connection)

    def destroy_node(self) -> None:
        """End the thread as well."""
        self._stop.set()
        self._thread.join(_STOP_TIMEOUT_S)
        super().destroy_node()

    def _packed(self, topic: str, time_ns: int, values: Any) -> bytes:
        stream: Any = stream_of(topic, np.array([time_ns], dtype=np.int64), values[np.newaxis])
        world, body = self._given.world_frame, self._given.body_frame
        if topic == "imu":
            return sensor_messages.pack_imu(stream, body)[0]
        if topic == "rotor_speeds":
            return sensor_messages.pack_rotor_speeds(stream, body)[0]
        if topic == "motor_commands":
            return sensor_messages.pack_motor_commands(stream, body)[0]
        if topic == "battery":
            return sensor_messages.pack_battery(stream, body)[0]
        if topic == "mocap/pose":
            return sensor_messages.pack_pose(stream, world)[0]
        return sensor_messages.pack_odometry(stream, frame_id=world, child_frame_id=body)[0]

    def _serve(self) -> None:
        """Keep a link open until the node ends, waiting longer after each failure."""
        wait_s, longest_s = _BACK_OFF_S
        while not self._stop.is_set():
            heard = False
            try:
                link = self._link or open_link(self._given.connection)
                self._link = None
                self.connections += 1
                self._problem = None
                if self._is_replay:
                    self._await_subscriber()
                with closing(link):
                    while not self._stop.is_set():
                        heard = self._exchange(link) or heard
            except EOFError:
                self.get_logger().info(f"{self._given.connection}: played to its end")
                self._stop.wait(_FLUSH_S)
                self._problem = "the log is played"
                rclpy.try_shutdown(context=self.context)
                return
            except (QuadpiError, OSError) as error:
                self._problem = str(error)
                self.get_logger().warning(f"{self._problem}; next attempt in {wait_s:g} s")
            except Exception as error:  # the thread must go on: without it, the autopilot would seem silent
                self._problem = f"error in the program: {one_line(error)}"
                self.exceptions.take("link", error)
            if heard:
                wait_s = _BACK_OFF_S[0]
            self._stop.wait(wait_s)
            wait_s = min(2.0 * wait_s, longest_s)

    def _await_subscriber(self) -> None:
        """Wait for a subscriber before a log is played from its start."""
        self._problem = "nobody subscribes to imu yet: the log waits"
        try:
            await_subscribers(self, [self._imu_publisher], _SUBSCRIBER_WAIT_S)
        except DiscoveryError as error:
            self.get_logger().warning(f"{error}: the log is played all the same")
        self._problem = None

    def _exchange(self, link: Link) -> bool:
        """Read the link once and process the data; returns whether any came.

        An error in processing loses that data only; an error in reading closes the link.
        """
        chunk = link.read(_READ_TIMEOUT_S)
        try:
            self._answer(link, chunk)
        except (QuadpiError, OSError):
            raise
        except Exception as error:
            self.exceptions.take("link", error)
        return chunk is not None

    def _answer(self, link: Link, chunk: Chunk | None) -> None:
        """Publish the samples received and send the packets that are due."""
        with self._lock:
            received = []
            if chunk is not None:
                received = self._session.take(
                    chunk.data, chunk.arrival_ns, complete=chunk.complete, address=chunk.address
                )
            packets, address = self._session.due(time.time_ns()), self._session.address
        for sample in received:
            self._publish[sample.topic](self._packed(sample.topic, sample.time_ns, sample.values))
        for packet in packets:
            link.write(packet, address)

    def _tell(self, payload: bytes) -> None:
        """Tell the autopilot, and whom it forwards to, what is new in the alarm."""
        now_ns = time.time_ns()
        with self._lock:
            # What nobody hears is not told: an alarm that stands is new to an autopilot that is met.
            if not self._session.is_met:
                return
            for one in self._told.take(result_messages.unpack_alarms(payload), now_ns):
                name = "STATUSTEXT" if isinstance(one, Text) else "NAMED_VALUE_FLOAT"
                self._session.tell(name, one, now_ns)

    def _diagnose(self) -> None:
        now_s = time.monotonic()
        with self._lock:
            report = self._session.report(time.time_ns())
        before, self._reported = self._reported, _Reported(now_s, report.samples, report.rivals)
        rates = {
            f"{topic}_hz": (count - before.samples.get(topic, 0)) / (now_s - before.at_s)
            for topic, count in report.samples.items()
        }
        rivals = [name for name, count in report.rivals.items() if count > before.rivals.get(name, 0)]
        level, text = self._judged(report, rates, rivals)
        self._log(level, text)
        for name in sorted(set(rivals) - self._rivals):
            self.get_logger().warning(_rival(name, report.system))
        self._rivals |= set(rivals)
        values: dict[str, Any] = {
            "connection": self._given.connection,
            "connections": self.connections,
            "system": report.system,
            **rates,
            **{f"{topic}_from": source for topic, source in report.sources.items()},
            **asdict(report.frames),
            **{
                f"not used: {name}": count
                for name, count in Counter(report.others).most_common(_OTHERS_NAMED)
            },
            **_clock_values(report),
            **{f"refused: {reason}": count for reason, count in report.refused.items()},
        }
        statuses = [callbacks.status(callbacks.full_name(self, "link"), level, text, values)]
        statuses += self.exceptions.statuses()
        self._diagnostics.publish(callbacks.array(self, statuses))

    def _log(self, level: bytes, text: str) -> None:
        """Log what keeps the sensors from coming once it lasts, and that they come at the start and again."""
        if level != callbacks.ERROR:
            if self._logs_active:
                self.get_logger().info(f"active: {text}")
            self._unusable, self._logs_active = (None, 0), False
            return
        # A text that counts seconds stays the same.
        kind = _SECONDS.sub("", text)
        before, seen = self._unusable
        self._unusable = kind, seen + 1 if kind == before else 1
        if self._unusable[1] == _LOGGED_AT:
            self._logs_active = True
            # Of the link itself the thread has told.
            if self._problem is None:
                self.get_logger().warning(text)

    def _judged(self, report: SessionReport, rates: dict[str, float], rivals: list[str]) -> tuple[bytes, str]:
        if self._problem is not None:
            return callbacks.ERROR, self._problem
        if report.system is None:
            others = f", but packets of {', '.join(sorted(report.others))}" if report.others else ""
            return callbacks.ERROR, f"connected, but no heartbeat of an autopilot is heard{others}"
        if report.silent_s > _SILENT_S and not self._is_replay:
            return callbacks.ERROR, f"nothing heard of system {report.system} for {report.silent_s:.0f} s"
        if report.other_airframe:
            return callbacks.ERROR, f"system {report.system}: {report.other_airframe}"
        by_commands = rates["rotor_speeds_hz"] == 0.0 and rates["motor_commands_hz"] > 0.0
        needed = ("imu", "motor_commands" if by_commands else "rotor_speeds")
        lacking = [topic for topic in needed if rates[f"{topic}_hz"] == 0.0]
        if rates["mocap/pose_hz"] + rates["odometry_hz"] == 0.0:
            lacking.append("pose or velocity")
        if lacking:
            return callbacks.ERROR, f"the autopilot sends no {', no '.join(lacking)}"
        if rivals:
            return callbacks.WARN, _rival(", ".join(sorted(rivals)), report.system)
        if report.clock is None or not report.clock.exchanged:
            return callbacks.WARN, "the autopilot answers no TIMESYNC: stamps are late by the link's delay"
        if by_commands:
            return callbacks.WARN, "the autopilot sends no rotor_speeds, but motor_commands"
        return callbacks.OK, f"system {report.system}: imu at {rates['imu_hz']:.0f} Hz"


def _rival(names: str, system: int | None) -> str:
    return f"{names} sends heartbeats of an autopilot too; system {system} is used, as it came first"


def _clock_values(report: SessionReport) -> dict[str, Any]:
    if report.clock is None:
        return {"clock_offset_ms": None, "clock_restarts": report.clock_restarts}
    bound = report.clock.uncertainty_ns
    return {
        "clock_offset_ms": f"{report.clock.offset_ns * 1e-6:.3f}",
        "clock_offset_from": "TIMESYNC" if report.clock.exchanged else "earliest arrivals",
        "clock_uncertainty_ms": None if bound is None else bound * 1e-6,
        "clock_restarts": report.clock_restarts,
    }


def _order(parameters: BridgeParameters, vehicle: Vehicle) -> RotorOrder:
    if parameters.rotor_order == STANDARD_ORDER:
        return RotorOrder.by_layout(vehicle, unit=parameters.rotor_unit)
    return RotorOrder.parse(parameters.rotor_order, parameters.rotor_unit).of(vehicle)


def _settings(parameters: BridgeParameters) -> SessionSettings:
    return SessionSettings(
        system=parameters.system,
        rates_hz={
            "imu": parameters.imu_rate_hz,
            "rotor_speeds": parameters.rotor_rate_hz,
            "odometry": parameters.state_rate_hz,
        },
        imu_source=parameters.imu_source,
        key=_key(Path(parameters.key_file)) if parameters.key_file else None,
        passive=parameters.passive or is_replay(parameters.connection),
    )


def _key(path: Path) -> bytes:
    try:
        passphrase = path.read_text().strip()
    except (OSError, ValueError) as error:
        raise ParameterError(f"{path}: the passphrase cannot be read: {error}") from error
    if not passphrase:
        raise ParameterError(f"{path}: the passphrase is empty")
    return signing_key(passphrase)


def main() -> int:
    """Run the node in its own process."""
    return run(_work)


def _work() -> None:
    node = MavlinkBridge()
    try:
        spin([node])
    finally:
        node.destroy_node()


if __name__ == "__main__":
    raise SystemExit(main())
