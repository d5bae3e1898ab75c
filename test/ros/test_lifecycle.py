# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a running vehicle does to the nodes, over real DDS: one process of live nodes through all of it."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.logs import messages

pytest.importorskip("quadpi.msg", reason="the quadpi messages are not built")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from quadpi.srv import LoadModel
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from quadpi_ros.discovery import await_listeners
from quadpi_ros.processes import Child
from quadpi_ros.runtime import SENSOR_QOS

pytestmark = pytest.mark.usefixtures("ros_domain")

IMU_HZ = 500.0
STEP_NS = round(1e9 / IMU_HZ)
# Beyond the second that the estimator collects before it starts.
STARTED_S = 1.3
DEEP = QoSProfile(depth=5000)
TOPICS = {
    "prediction": WrenchPrediction,
    "prediction/other": WrenchPrediction,
    "odometry": Odometry,
    "extrapolation_alarm": ExtrapolationAlarm,
}
SENSORS = (("imu", Imu), ("rotor_speeds", RotorSpeeds), ("mocap/pose", PoseStamped))
Change = Callable[[int, dict[str, Any]], dict[str, Any]]


class Rig:
    """A vehicle that hovers as long as it is asked to, and listens to what the nodes say of it."""

    def __init__(self, hover: Recording) -> None:
        self._hover = hover
        self.now_ns = int(hover.imu.time_ns[0])
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}
        self.told: list[DiagnosticStatus] = []
        self.diagnosed_ns = 0
        self._context = Context()
        self._context.init()
        self.node = Node("rig", context=self._context)
        self._clock = self.node.create_publisher(Clock, "/clock", 10)
        self.sim_time = False
        self._start_sensors()
        for topic, kind in TOPICS.items():
            self.node.create_subscription(kind, topic, self.heard[topic].append, DEEP, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, DEEP)
        self._clients: dict[str, Any] = {}
        self._executor = EventsExecutor(context=self._context)
        self._thread: threading.Thread | None = None
        self._closing = False

    def _start_sensors(self) -> None:
        """In a participant of their own, as a driver or a player has it; wait until the nodes hear them."""
        self._sensors = Context()
        self._sensors.init()
        node = Node("sensors", context=self._sensors)
        self._publishers = {topic: node.create_publisher(kind, topic, SENSOR_QOS) for topic, kind in SENSORS}
        await_listeners(node, list(self._publishers.values()), ("estimator", "monitor"), 300.0)

    def restart_sensors(self) -> None:
        self._sensors.try_shutdown()
        self._start_sensors()

    def listen(self) -> None:
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        never = Future()
        while not self._closing:
            self._executor.spin_until_future_complete(never, timeout_sec=0.1)

    def close(self) -> None:
        self._closing = True
        if self._thread is not None:
            self._thread.join()
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()
        self._sensors.try_shutdown()

    def fly(
        self, seconds: float, change: Change = lambda _, sample: sample, imu_hz: float = IMU_HZ
    ) -> tuple[int, int]:
        """Publish for so long; gives the stamps of the first and the last IMU sample."""
        first_ns, step_ns = self.now_ns, round(1e9 / imu_hz)
        started_s = time.monotonic()
        for count in range(round(seconds * imu_hz)):
            wait_s = started_s + 1e-9 * count * step_ns - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            if self.sim_time and count % 5 == 0:
                self.tick()
            self._publish(count, change)
            self.now_ns += step_ns
        last_ns = self.now_ns - step_ns
        self._send("rotor_speeds", messages.pack_rotor_speeds(self._rotors(self.now_ns, 0)))
        return first_ns, last_ns

    def tick(self) -> None:
        sec, nanosec = divmod(self.now_ns, 10**9)
        self._clock.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _publish(self, count: int, change: Change) -> None:
        index = count % 1000
        stamp = np.array([self.now_ns])
        imu = self._hover.imu
        sample = change(
            count,
            {
                "imu": ImuStream(stamp, imu.angular_velocity[[index]], imu.specific_force[[index]]),
                "rotor_speeds": self._rotors(self.now_ns, index),
                "mocap/pose": PoseStream(stamp, self._hover.pose.position[[index % 100]], np.eye(4)[:1]),
            },
        )
        if count % 4 == 0:
            self._send("mocap/pose", messages.pack_pose(sample["mocap/pose"]))
        self._send("imu", messages.pack_imu(sample["imu"]))
        self._send("rotor_speeds", messages.pack_rotor_speeds(sample["rotor_speeds"]))

    def _rotors(self, time_ns: int, index: int) -> RotorSpeedStream:
        return RotorSpeedStream(np.array([time_ns]), self._hover.rotor_speeds.speeds[[index]])

    def _send(self, topic: str, payloads: Any) -> None:
        self._publishers[topic].publish(payloads[0])

    def stamps(self, topic: str, first_ns: int, last_ns: int) -> np.ndarray:
        # Every message begins with its header, whose stamp follows the four bytes of the encapsulation.
        parts = [struct.unpack_from("<iI", payload, 4) for payload in list(self.heard[topic])]
        stamps = [10**9 * sec + nanosec for sec, nanosec in parts]
        return np.array([stamp for stamp in stamps if first_ns <= stamp <= last_ns])

    def await_stamp(self, topic: str, time_ns: int) -> None:
        """Wait until the message of a stamp has come."""
        self.until(lambda: len(self.stamps(topic, time_ns, time_ns)) > 0)

    def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def forget(self) -> None:
        for heard in self.heard.values():
            heard.clear()
        self.told.clear()

    def latest(self, name: str) -> DiagnosticStatus | None:
        return next((status for status in reversed(list(self.told)) if status.name == name), None)

    def await_status(self, name: str, level: bytes, part: str) -> DiagnosticStatus:
        """Wait for a status of that level whose message holds `part`."""

        def found() -> list[DiagnosticStatus]:
            return [
                status
                for status in list(self.told)
                if status.name == name and status.level == level and part in status.message
            ]

        self.until(lambda: bool(found()))
        return found()[-1]

    def call(self, kind: type, name: str, request: Any, timeout_s: float = 60.0) -> Any:
        return self.call_later(kind, name, request)(timeout_s)

    def call_later(self, kind: type, name: str, request: Any) -> Callable[[float], Any]:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        assert self._clients[name].wait_for_service(20.0)
        answer = self._clients[name].call_async(request)

        def result(timeout_s: float) -> Any:
            self.until(answer.done, timeout_s)
            return answer.result()

        return result

    def change_state(self, node: str, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def set_parameter(self, name: str, value: Any, node: str = "monitor") -> Any:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def _take_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnosed_ns = 10**9 * array.header.stamp.sec + array.header.stamp.nanosec
        self.told.extend(array.status)


def arguments(models: str) -> tuple[str, ...]:
    settings = ("vehicle:=neurobem", f"monitor:model:={models}")
    return ("--ros-args", *(part for setting in settings for part in ("-p", setting)))


@pytest.fixture(scope="module")
def live(ros_domain: int, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Child]:
    del ros_domain
    models = f"[{folder / 'model'}, {folder / 'other'}]"
    with Child("quadpi_ros.live", arguments(models), tmp_path_factory.mktemp("err")) as nodes:
        yield nodes


@pytest.fixture(scope="module")
def running(live: Child, hover: Recording) -> Iterator[Rig]:
    assert not live.finished()
    rig = Rig(hover)
    rig.listen()
    yield rig
    rig.close()


@pytest.fixture
def rig(running: Rig, live: Child) -> Iterator[Rig]:
    """The vehicle in the air and predicted, whatever came before."""
    deadline = time.monotonic() + 20.0
    running.forget()
    while True:
        _, last_ns = running.fly(0.1)
        if len(running.stamps("prediction", last_ns - 50_000_000, last_ns)):
            break
        assert time.monotonic() < deadline
    # Nothing is queued any more.
    running.await_stamp("prediction", last_ns)
    running.forget()
    yield running
    assert not live.finished()


def assert_whole(rig: Rig, topic: str, first_ns: int, last_ns: int) -> None:
    rig.await_stamp(topic, last_ns)
    missing = np.setdiff1d(np.arange(first_ns, last_ns + 1, STEP_NS), rig.stamps(topic, first_ns, last_ns))
    assert not len(missing), f"{topic} lacks {1e-9 * (missing - first_ns)} s; {rig.told[-20:]}"
    assert np.all(np.diff(rig.stamps(topic, first_ns, last_ns)) > 0)


def predictions(rig: Rig, topic: str = "prediction") -> list[WrenchPrediction]:
    return [deserialize_message(payload, WrenchPrediction) for payload in list(rig.heard[topic])]


def test_every_model_publishes(rig: Rig) -> None:
    span = rig.fly(0.5)
    for topic in ("odometry", "prediction", "prediction/other"):
        assert_whole(rig, topic, *span)
    assert {message.model[:5] for message in predictions(rig)} == {"model"}
    assert {message.model[:5] for message in predictions(rig, "prediction/other")} == {"other"}


def test_a_model_is_replaced_without_missing_a_sample(rig: Rig, folder: Path) -> None:
    answers = [
        rig.call_later(LoadModel, "monitor/load_model", LoadModel.Request(path=str(folder / name)))
        for name in ("other", "no_such_model")
    ]
    span = rig.fly(3.0)
    replaced, refused = (answer(60.0) for answer in answers)
    assert replaced.success
    assert replaced.model.startswith("other")
    assert not refused.success
    assert "no_such_model" in refused.message
    assert refused.model == replaced.model
    more = rig.fly(0.5)
    assert_whole(rig, "prediction", span[0], more[1])
    flown = [message.model[:5] for message in predictions(rig)]
    assert flown[0] == "model"
    assert flown[-1] == "other"
    assert flown == sorted(flown)
    back = rig.call(
        LoadModel, "monitor/load_model", LoadModel.Request(path=str(folder / "model"), replaces="x")
    )
    assert not back.success
    assert "no model flies as `x`" in back.message
    back = rig.call(LoadModel, "monitor/load_model", LoadModel.Request(path=str(folder / "model")))
    assert back.success


@pytest.mark.filterwarnings("ignore:invalid value encountered in matmul")
def test_nan_never_comes_out(rig: Rig) -> None:
    def broken(count: int, sample: dict[str, Any]) -> dict[str, Any]:
        if count % 10 < 3:
            streams = {0: "imu", 1: "rotor_speeds", 2: "mocap/pose"}
            topic = streams[count % 10]
            stream = sample[topic]
            for name in ("angular_velocity", "specific_force", "speeds", "position", "attitude"):
                if hasattr(stream, name):
                    values = getattr(stream, name).copy()
                    values[0, 0] = (np.nan, np.inf)[count // 10 % 2]
                    object.__setattr__(stream, name, values)
        return sample

    rig.fly(1.0, broken)
    _, last_ns = rig.fly(1.2)
    rig.await_stamp("prediction", last_ns)
    for topic, kind in TOPICS.items():
        for payload in list(rig.heard[topic]):
            assert np.isfinite(numbers(deserialize_message(payload, kind))).all(), topic
    assert any(
        sum(float(v.value) for v in s.values if v.key == "refused") > 0 for s in rig.told if "imu" in s.name
    )


def numbers(message: Any) -> list[float]:
    found: list[float] = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            found += numbers(value)
        elif isinstance(value, int | float):
            found.append(float(value))
        elif isinstance(value, np.ndarray):
            found += value.astype(float).ravel().tolist()
    return found


def test_a_jump_back_in_time_starts_anew(rig: Rig) -> None:
    rig.now_ns -= 1000_000_000_000
    first_ns, last_ns = rig.fly(1.6)
    rig.await_stamp("prediction", last_ns)
    stamps = rig.stamps("prediction", first_ns, last_ns)
    assert stamps[0] - first_ns < 1.1e9
    np.testing.assert_array_equal(np.diff(stamps), STEP_NS)
    rig.now_ns += 1000_000_000_000


def test_a_subscriber_that_cannot_hear_is_named(rig: Rig) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    deaf = rig.node.create_subscription(WrenchPrediction, "prediction", print, latched)
    status = rig.await_status("monitor: prediction", DiagnosticStatus.ERROR, "durability")
    assert "/prediction" in status.message
    rig.node.destroy_subscription(deaf)
    rig.until(lambda: rig.latest("monitor: prediction") is not None)
    rig.forget()
    rig.until(lambda: rig.latest("monitor: state") is not None)
    rig.forget()
    rig.until(lambda: rig.latest("monitor: state") is not None)
    assert rig.latest("monitor: prediction") is None


def test_diagnostics_tell_rates_latency_and_states(rig: Rig) -> None:
    rig.fly(2.5)
    rig.await_status("estimator: imu", DiagnosticStatus.OK, "Hz")
    pairing = rig.latest("monitor: pairing")
    values = values_of(pairing)
    assert int(values["paired"]) > 0
    assert 0.0 < float(values["latency_p50_ms"]) <= float(values["latency_p99_ms"])
    assert rig.latest("estimator: state").message == "active"
    models = {item.value[:5] for item in rig.latest("monitor: alarm").values if item.key.startswith("model")}
    assert models == {"model", "other"}


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    return {item.key: item.value for item in status.values}


def test_latency_from_the_stamp_needs_this_computers_clock(rig: Rig) -> None:
    rig.await_status("monitor: pairing", DiagnosticStatus.OK, "complete")
    rig.fly(1.2)
    rig.until(lambda: "latency_from_stamp" in values_of(rig.latest("monitor: pairing")))
    told = values_of(rig.latest("monitor: pairing"))["latency_from_stamp"]
    assert told == "unknown: stamps are of another clock than this computer's"
    before_ns, rig.now_ns = rig.now_ns, time.time_ns()
    rig.fly(STARTED_S + 1.2)
    rig.until(lambda: "latency_from_stamp_p50_ms" in values_of(rig.latest("monitor: pairing")))
    values = values_of(rig.latest("monitor: pairing"))
    assert float(values["latency_from_stamp_p50_ms"]) < 5000.0
    assert float(values["latency_from_stamp_p50_ms"]) <= float(values["latency_from_stamp_p99_ms"])
    rig.now_ns = before_ns


def test_motion_capture_that_is_not_used_is_refused_by_reason_on_its_topic(rig: Rig) -> None:
    def elsewhere(count: int, sample: dict[str, Any]) -> dict[str, Any]:
        pose = sample["mocap/pose"]
        if count % 20 == 0:
            pose = PoseStream(pose.time_ns, pose.position + 5.0, pose.attitude)
        return sample | {"mocap/pose": pose}

    rig.fly(1.2, elsewhere)
    rig.await_status("estimator: mocap/pose", DiagnosticStatus.WARN, "samples refused")
    rig.fly(0.5)
    rig.until(lambda: rig.latest("estimator: mocap/pose") is not None)
    values = values_of(rig.latest("estimator: mocap/pose"))
    assert int(values["refused: poses rejected"]) >= 20


def test_sim_time_is_that_of_the_clock_and_does_not_stop_the_diagnostics(rig: Rig) -> None:
    rig.tick()
    for node in ("estimator", "monitor"):
        assert rig.set_parameter("use_sim_time", True, node).successful
    rig.sim_time = True
    span = rig.fly(1.5)
    assert_whole(rig, "prediction", *span)
    rig.forget()
    # The clock stands still now.
    rig.until(lambda: rig.latest("monitor: pairing") is not None)
    rig.forget()
    rig.until(lambda: rig.latest("monitor: state") is not None)
    assert rig.diagnosed_ns == pytest.approx(span[1], abs=2e7)
    rig.fly(1.2)
    rig.until(lambda: float(values_of(rig.latest("estimator: imu"))["stamp_age_s"]) < 0.5)
    rig.until(
        lambda: values_of(rig.latest("monitor: pairing")).get("latency_from_stamp") == "unknown: use_sim_time"
    )
    for node in ("estimator", "monitor"):
        assert rig.set_parameter("use_sim_time", False, node).successful
    rig.sim_time = False


def test_a_driver_that_starts_again_in_flight_is_heard_again(rig: Rig) -> None:
    rig.fly(0.5)
    rig.restart_sensors()
    # Its clock went on meanwhile.
    rig.now_ns += 2_000_000_000
    started_ns, _ = rig.fly(STARTED_S)
    span = rig.fly(0.5)
    assert_whole(rig, "prediction", *span)
    assert rig.stamps("prediction", started_ns, span[1])[0] - started_ns < 1.1e9


def test_silence_and_another_rate_are_errors(rig: Rig) -> None:
    rig.fly(3.5, imu_hz=400.0)
    rig.await_status("estimator: imu", DiagnosticStatus.ERROR, "stamps say 400 Hz, imu_rate_hz is 500")
    rig.await_status("estimator: state", DiagnosticStatus.ERROR, "nothing arrives on imu, mocap/pose")
    rig.await_status("monitor: rotor_speeds", DiagnosticStatus.ERROR, "nothing arrives")


def test_parameters_in_flight(rig: Rig) -> None:
    assert rig.set_parameter("persistence_s", 1).successful
    assert not rig.set_parameter("persistence_s", 0.0).successful
    nan = rig.set_parameter("release_s", float("nan"))
    assert not nan.successful
    assert not rig.set_parameter("confidence", 0.9).successful
    assert not rig.set_parameter("persistance_s", 0.2).successful
    assert not rig.set_parameter("alarm_rate_hz", "fast").successful
    assert rig.set_parameter("alarm_rate_hz", 50.0).successful
    request = GetParameters.Request(names=["persistence_s"])
    (value,) = rig.call(GetParameters, "monitor/get_parameters", request).values
    assert value.double_value == 1.0
    span = rig.fly(1.0)
    rig.await_stamp("prediction", span[1])
    assert len(rig.stamps("extrapolation_alarm", *span)) >= 49
    assert rig.set_parameter("alarm_rate_hz", 10).successful
    assert rig.set_parameter("persistence_s", 0.1).successful


def test_deactivated_nodes_say_nothing_and_come_back(rig: Rig) -> None:
    for name in ("estimator", "monitor"):
        assert rig.change_state(name, Transition.TRANSITION_DEACTIVATE)
        answer = rig.call(GetState, f"{name}/get_state", GetState.Request())
        assert answer.current_state.label == "inactive"
    rig.forget()
    rig.fly(0.3)
    assert not any(rig.heard.values())
    assert rig.change_state("monitor", Transition.TRANSITION_CLEANUP)
    assert rig.change_state("monitor", Transition.TRANSITION_CONFIGURE)
    for name in ("monitor", "estimator"):
        assert rig.change_state(name, Transition.TRANSITION_ACTIVATE)
    rig.fly(STARTED_S + 0.5)
    rig.until(lambda: all(rig.heard[topic] for topic in ("odometry", "prediction", "prediction/other")))


def test_the_process_can_be_restarted_in_flight(
    running: Rig, live: Child, folder: Path, tmp_path: Path
) -> None:
    live.__exit__(None, None, None)
    running.forget()
    with Child("quadpi_ros.live", arguments(str(folder / "model")), tmp_path) as nodes:
        while not running.heard["prediction"]:
            assert not nodes.finished()
            running.fly(0.5)
        span = running.fly(0.5)
        assert_whole(running, "prediction", *span)
