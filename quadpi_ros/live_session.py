# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Play a bag through the live nodes over real DDS and collect what they publish."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from quadpi_core.errors import QuadpiError
from quadpi_core.estimator.initialise import COLLECT_NS
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.messages import result_messages
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.sensor_messages import unpack_stamps
from quadpi_core.monitor.alarm import alarm_time
from quadpi_core.monitor.health import SILENT_S
from quadpi_core.paths import scratch_folder
from quadpi_core.results import CAUSE_NAMES, LEVEL_ALARM, LEVEL_OK, LEVEL_WARNING, Predictions, ReportedAlarms
from quadpi_ros.parameters import START_TIMEOUT_S
from quadpi_ros.playlist import SENSOR_TYPES, Playlist, live_inputs

_LEVEL_NAMES = ("ok", "warning", "ALARM")
# Deep enough to lose nothing while the caller, in the same process, is busy.
_DEEP_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
_POLL_S = 0.05
# Inputs outside the envelope that are shown, so that a change fits one line of a terminal.
_NAMES_SHOWN = 3


@dataclass(frozen=True)
class AlarmChange:
    """A change of the alarm: another level, other causes, or a further input outside the envelope.

    Attributes:
        time_s: stamp, in seconds since the start of the flight.
        level: 0 ok, 1 warning, 2 alarm.
        causes: names of the causes.
        inputs_outside: names of the inputs outside the envelope, the farthest first.
        envelope_distance: distance of the farthest from its training range, in widths of that range.
    """

    time_s: float
    level: int
    causes: tuple[str, ...]
    inputs_outside: tuple[str, ...]
    envelope_distance: float

    def __str__(self) -> str:
        text = f"{self.time_s:7.2f} s  {_LEVEL_NAMES[self.level]:8}{', '.join(self.causes)}"
        if self.inputs_outside:
            more = len(self.inputs_outside) - _NAMES_SHOWN
            text += f": {', '.join(self.inputs_outside[:_NAMES_SHOWN])}"
            text += f" +{more}" if more > 0 else ""
            text += f", {self.envelope_distance:.0%} out"
        return text


class AlarmFollower:
    """Finds the changes in a sequence of alarm messages, which repeat at a steady rate."""

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._state = (LEVEL_OK, 0)
        self._named: set[str] = set()

    def follow(self, alarms: ReportedAlarms) -> AlarmChange | None:
        """The change in the next alarm message; None if nothing changed."""
        level, causes = int(alarms.level[0]), int(alarms.causes[0])
        inputs = alarms.inputs_outside[0] if level != LEVEL_OK else ()
        changed = (level, causes) != self._state or not self._named.issuperset(inputs)
        self._state = (level, causes)
        self._named = self._named.union(inputs) if level != LEVEL_OK else set()
        if not changed:
            return None
        return AlarmChange(
            time_s=1e-9 * (int(alarms.time_ns[0]) - self._start_ns),
            level=level,
            causes=tuple(name for bit, name in CAUSE_NAMES.items() if causes & bit),
            inputs_outside=inputs,
            envelope_distance=float(alarms.envelope_distance[0]),
        )


Entered = TypeVar("Entered", bound="Listener")


class Listener:
    """A node in the caller's process that receives serialized messages; a context manager.

    Args:
        name: of the node.
        topics: message type, name, and callback of each topic.
    """

    def __init__(self, name: str, topics: Sequence[tuple[type, str, Callable[[bytes], None]]]) -> None:
        self._context = Context()
        self._context.init()
        self._node = Node(name, context=self._context, start_parameter_services=False)
        self._subscriptions = {
            topic: self._node.create_subscription(message_type, topic, take, _DEEP_QOS, raw=True)
            for message_type, topic, take in topics
        }
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def __enter__(self: Entered) -> Entered:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    @property
    def connected(self) -> bool:
        """Whether every topic has a publisher."""
        return all(map(self.hears, self._subscriptions))

    def hears(self, topic: str) -> bool:
        """Whether that topic has a publisher."""
        return bool(self._subscriptions[topic].get_publisher_count() > 0)

    def spin(self, seconds: float) -> None:
        """Receive messages for a time."""
        self._executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = float("inf")) -> bool:
        """Receive messages until the condition holds; False on timeout."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin(_POLL_S)
        return True


class Collector(Listener):
    """Keeps every message that the live nodes publish.

    Args:
        start_ns: stamp from which the seconds of an alarm change count.
        on_alarm: called at once for every change of the alarm.

    Attributes:
        silent_ns: stamp of the newest alarm that reports silence; None if a sample was judged since.
    """

    def __init__(self, start_ns: int, on_alarm: Callable[[AlarmChange], None] | None = None) -> None:
        self.silent_ns: int | None = None
        self._follower = AlarmFollower(start_ns)
        self._on_alarm = on_alarm
        self._odometry: list[bytes] = []
        self._predictions: list[bytes] = []
        self._alarms: list[bytes] = []
        self._arrived_ns: list[int] = []
        super().__init__(
            "collector",
            (
                (Odometry, "odometry", self._odometry.append),
                (WrenchPrediction, "prediction", self._take_prediction),
                (ExtrapolationAlarm, "extrapolation_alarm", self._take_alarm),
            ),
        )

    @property
    def arrived_ns(self) -> Stamps:
        """(P,) arrival of each prediction, monotonic clock."""
        return np.array(self._arrived_ns, dtype=np.int64)

    def odometry(self) -> Payloads:
        """Messages of all states so far."""
        return Payloads.join(self._odometry)

    def predictions(self) -> Predictions:
        """All predictions so far."""
        return result_messages.unpack_predictions(Payloads.join(self._predictions))

    def alarms(self) -> ReportedAlarms:
        """All alarms so far that follow from samples, without those that report silence around a flight."""
        return result_messages.unpack_alarms(Payloads.join(self._alarms))

    def _take_prediction(self, payload: bytes) -> None:
        self._arrived_ns.append(time.monotonic_ns())
        self._predictions.append(payload)
        self.silent_ns = None

    def _take_alarm(self, payload: bytes) -> None:
        alarm = result_messages.unpack_alarms(payload)
        if not alarm.of_samples.all():
            self.silent_ns = int(alarm.time_ns[0])
            return
        self.silent_ns = None
        self._alarms.append(payload)
        change = self._follower.follow(alarm)
        if change is not None and self._on_alarm is not None:
            self._on_alarm(change)


_STOP_TIMEOUT_S = 5.0
# The domains that ROS's `domain_coordinator` gives to tests, and the port that reserves the domain before the
# first: who holds port _DOMAIN_PORT + n owns domain n. The DDS ports of domains above 101 are ephemeral ones.
_DOMAINS = range(1, 101)
_DOMAIN_PORT = 32768


class ChildError(QuadpiError):
    """A child process failed."""


class Child:
    """A Python module run as a child process; a context manager that ends it.

    Args:
        module: run as `python -m`.
        arguments: of its command line.
        folder: for a file with its stderr.

    Attributes:
        errors: that file.
        pid: of the process.
    """

    def __init__(self, module: str, arguments: Sequence[str], folder: Path) -> None:
        self._name = module.rpartition(".")[2]
        self.errors = folder / f"{module}.err"
        with self.errors.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments], stdout=subprocess.DEVNULL, stderr=errors
            )
        self.pid = self._process.pid

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def finished(self) -> bool:
        """Whether it has ended with status 0.

        Raises:
            ChildError: if it has failed, with the last line of its stderr.
        """
        status = self._process.poll()
        if status:
            lines = self.errors.read_text(errors="replace").splitlines() or [f"exit status {status}"]
            raise ChildError(f"{self._name}: {lines[-1].removeprefix('quadpi: ')}")
        return status is not None


@contextmanager
def isolated_domain() -> Iterator[Path]:
    """Reserve a ROS domain for this process and its children; gives a scratch folder."""
    before = dict(os.environ)
    with scratch_folder() as folder, _reserved_domain() as domain:
        os.environ |= {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder),
            # For one sample at a time, threads of the linear algebra cost more than they save.
            "OMP_NUM_THREADS": "1",
        }
        try:
            yield folder
        finally:
            os.environ.clear()
            os.environ.update(before)


@contextmanager
def _reserved_domain() -> Iterator[int]:
    """A ROS domain that no other process on this machine has reserved in the same way.

    Raises:
        ChildError: if none is free.
    """
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket() as reservation:
            try:
                reservation.bind(("", _DOMAIN_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise ChildError("every ROS domain of this machine is taken")


# A busy machine may hold the nodes up for seconds; one that needs longer to judge what it has loses samples.
REST_TIMEOUT_S = 60.0


class SessionError(QuadpiError):
    """The live nodes do not run, publish nothing or do not come to rest."""


@dataclass(frozen=True)
class SessionResult:
    """Inputs and outputs of a live session.

    Attributes:
        imu_stamps_ns: (N,) stamps of the IMU samples played.
        rotor_stamps_ns: (R,) stamps of the rotor speeds played.
        latency_ms: (P,) from publication of an IMU sample to arrival of its prediction.
        odometry: messages as published.
        predictions, alarms: decoded.
    """

    imu_stamps_ns: Stamps
    rotor_stamps_ns: Stamps
    latency_ms: Array
    odometry: Payloads
    predictions: Predictions
    alarms: ReportedAlarms

    @property
    def dropped(self) -> int:
        """IMU samples without a prediction, from the estimator's start to the last rotor speed."""
        first = max(self.imu_stamps_ns[0] + COLLECT_NS, self.rotor_stamps_ns[0])
        last = self.rotor_stamps_ns[-1]
        expected = np.sum((self.imu_stamps_ns >= first) & (self.imu_stamps_ns <= last))
        return int(expected) - len(self.predictions.time_ns)

    def summary(self) -> dict[str, float | int | None]:
        """Statistics for JSON; seconds count from the first IMU sample."""
        start_ns, end_ns = int(self.imu_stamps_ns[0]), int(self.imu_stamps_ns[-1])
        alarm, warning = (
            alarm_time(self.alarms.time_ns, self.alarms.level, end_ns, level)
            for level in (LEVEL_ALARM, LEVEL_WARNING)
        )
        return {
            "samples_in": len(self.imu_stamps_ns),
            "predictions_out": len(self.predictions.time_ns),
            "dropped": self.dropped,
            "alarm_fraction": alarm.fraction,
            "alarm_first_s": alarm.first_s(start_ns),
            "warning_first_s": warning.first_s(start_ns),
            "latency_ms_p50": float(np.percentile(self.latency_ms, 50)),
            "latency_ms_p99": float(np.percentile(self.latency_ms, 99)),
        }


def run_session(
    bag: Path,
    model: Path,
    *,
    vehicle: str,
    rate: float = 1.0,
    parameters: Mapping[str, object] | None = None,
    on_alarm: Callable[[AlarmChange], None] | None = None,
    page: Sequence[str] | None = None,
) -> SessionResult:
    """Start the live nodes, play the bag through them and collect their output until all of it is judged.

    Nodes and player are child processes in a reserved ROS domain on this machine; they end with the call.

    Args:
        bag: with the standard topics imu, motion capture and rotor speeds.
        model: folder of a model of the vehicle.
        vehicle: name of the vehicle file, or a path.
        rate: speed of the replay; 1 is real time.
        parameters: of the nodes, in addition to those that follow from bag and model.
        on_alarm: called at once for every change of the alarm.
        page: arguments of :mod:`quadpi_ros.view_node`, to serve a page meanwhile; without it, none is.

    Raises:
        PlayerError: if the bag lacks a topic.
        SessionError: if no prediction comes, or the nodes do not come to rest.
        ChildError: if a process fails.
        LogError: if the bag cannot be read.
    """
    inputs = live_inputs(bag, [name for name in Playlist.read(bag).topics if name in SENSOR_TYPES])
    recorded = Playlist.read(bag, inputs.topics).topics
    stamps = {name: unpack_stamps(topic.payloads) for name, topic in recorded.items()}
    all_parameters = {
        "vehicle": vehicle,
        "model": str(model),
        "rotor_topic": inputs.rotor_topic,
        "mocap_topic": inputs.mocap_topic,
        **(parameters or {}),
    }
    with isolated_domain() as folder, Collector(int(stamps["imu"][0]), on_alarm) as collector:
        parameter_file = folder / "parameters.yaml"
        parameter_file.write_text(yaml.safe_dump({"/**": {"ros__parameters": all_parameters}}))
        with ExitStack() as children:
            if page is not None:
                children.enter_context(Child("quadpi_ros.view_node", page, folder))
            live = children.enter_context(
                Child("quadpi_ros.live_process", ("--ros-args", "--params-file", str(parameter_file)), folder)
            )
            await_start(live, collector)
            sent = play(bag, inputs.topics, rate, folder, live, collector)
            await_rest(live, collector, int(sent[-1, 0]))
        return _result(bag, collector, sent, stamps[inputs.rotor_topic])


def await_start(nodes: Child, collector: Collector) -> None:
    """Wait until the nodes have publishers for every topic of the collector.

    Raises:
        SessionError: if they do not start.
        ChildError: if they fail.
    """
    collector.spin_until(lambda: nodes.finished() or collector.connected, START_TIMEOUT_S)
    if not collector.connected:
        raise SessionError(f"the live nodes did not start within {START_TIMEOUT_S:g} s")


def play(
    bag: Path,
    topics: Sequence[str],
    rate: float,
    folder: Path,
    nodes: Child,
    collector: Collector,
    managed: Sequence[str] = ("estimator", "monitor"),
) -> Stamps:
    """Play topics of a bag through running nodes, and collect what they publish meanwhile.

    The player waits until the `managed` nodes are active.

    Returns:
        Of each message of the topic `imu`, (N, 2) nanoseconds: its stamp, and its publication on the
        monotonic clock.

    Raises:
        SessionError: if the nodes end before the bag does.
        ChildError: if nodes or player fail.
    """
    sent_file = folder / "sent.npy"
    arguments = [str(bag), "--rate", str(rate), "--sent", str(sent_file), "--wait", str(START_TIMEOUT_S)]
    arguments += ["--topics", *topics, *(["--nodes", *managed] if managed else [])]
    with Child("quadpi_ros.player", arguments, folder) as player:
        collector.spin_until(lambda: nodes.finished() or player.finished())
    _require_running(nodes)
    return np.load(sent_file)


def await_rest(nodes: Child, collector: Collector, last_ns: int) -> None:
    """Collect what nodes publish until nothing is under way, after the end of a flight.

    The monitor says so: its clock goes on while nothing comes, and stamps an alarm :data:`SILENT_S` after the
    newest sample that it has judged.

    Args:
        nodes: with a monitor.
        collector: of their output.
        last_ns: stamp of the last IMU sample that was sent.

    Raises:
        SessionError: if they end, or do not come to rest within :data:`REST_TIMEOUT_S`.
        ChildError: if they fail.
    """
    rest_ns = last_ns + round(1e9 * SILENT_S)

    def at_rest() -> bool:
        return collector.silent_ns is not None and collector.silent_ns >= rest_ns

    collector.spin_until(lambda: nodes.finished() or at_rest(), REST_TIMEOUT_S)
    _require_running(nodes)
    if not at_rest():
        raise SessionError(f"the live nodes did not come to rest within {REST_TIMEOUT_S:g} s")


def _require_running(nodes: Child) -> None:
    if nodes.finished():
        raise SessionError("the live nodes ended before the flight did")


def _result(bag: Path, collector: Collector, imu_sent: Stamps, rotor_stamps_ns: Stamps) -> SessionResult:
    stamps_ns, sent_ns = imu_sent.T
    predictions = collector.predictions()
    if len(predictions.time_ns) == 0:
        raise SessionError(f"{bag}: no prediction came; the estimator needs a second of imu and mocap/pose")
    published_ns = sent_ns[np.searchsorted(stamps_ns, predictions.time_ns)]
    return SessionResult(
        imu_stamps_ns=stamps_ns,
        rotor_stamps_ns=rotor_stamps_ns,
        latency_ms=1e-6 * (collector.arrived_ns - published_ns),
        odometry=collector.odometry(),
        predictions=predictions,
        alarms=collector.alarms(),
    )
