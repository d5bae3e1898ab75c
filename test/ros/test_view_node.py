# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page's node: what it makes of topics of several vehicles, and of topics that are missing or mixed."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from quadpi.msg import Erpm, ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String

from quadpi_core.flight import AXES, OdometryStream, RotorSpeedStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.result_messages import DescribedModel, pack_description
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.results import Alarms, Predictions
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.trust import SILENCE_S, State
from quadpi_ros import view_node
from quadpi_ros.callbacks import DESCRIPTION_QOS, OUTPUT_QOS, SENSOR_QOS
from quadpi_ros.view_node import LiveSource

from .rig import wait_until
from .test_launching import GOLDEN_MODEL

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def model() -> AerodynamicModel:
    return AerodynamicModel.load(GOLDEN_MODEL)


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("vehicle")
    yield node
    node.destroy_node()


@pytest.fixture
def source(ros: None, model: AerodynamicModel) -> Iterator[LiveSource]:
    del ros
    source = LiveSource(rclpy.get_default_context(), {model.identity: (model, model.load_vehicle())})
    yield source
    source.close()


def predictions(first: int, count: int = 25) -> Predictions:
    time_ns = START_NS + (first + np.arange(count)) * 2_000_000
    zero = np.zeros((count, 6))
    return Predictions(time_ns, zero, zero - 1.0, zero + 1.0, zero + 0.5, zero + 1.0)


def alarms(time_ns: int, level: int) -> Alarms:
    scores, inputs = np.zeros((1, 6)), np.zeros((1, 19))
    inputs[0, 0] = 0.5 * (level > 0)
    return Alarms(
        time_ns=np.array([time_ns]),
        level=np.array([level], dtype=np.uint8),
        causes=np.array([int(level > 0)], dtype=np.uint8),
        cause_level=np.array([[level, 0, 0, 0]], dtype=np.uint8),
        cause_health=np.zeros((1, 4), dtype=np.uint8),
        cause_evidence=np.zeros((1, 4)),
        leverage=scores,
        width=scores,
        miscoverage=scores,
        miss_share=scores,
        **found_columns(nothing_found(1), None),
        leverage_ratio=scores,
        width_ratio=scores,
        input_score=inputs,
        input_excess=inputs,
        faults=np.zeros(1, dtype=np.int64),
        more_faults=np.zeros((1, 2), dtype=np.int64),
        stopped=np.zeros(1, dtype=np.int64),
        why_not_judged=np.zeros(1, dtype=np.int64),
        not_judged_share=np.zeros(1),
    )


class Publishing:
    """Publishes what live nodes would, in a namespace."""

    def __init__(self, node: Node, namespace: str, model: str, further: tuple[str, ...] = ()) -> None:
        topics = [f"{namespace}/prediction", *(f"{namespace}/prediction/{name}" for name in further)]
        self._models = (model, *(f"{name}@1" for name in further))
        self._predictions = [node.create_publisher(WrenchPrediction, topic, OUTPUT_QOS) for topic in topics]
        self._alarm = node.create_publisher(
            ExtrapolationAlarm, f"{namespace}/extrapolation_alarm", OUTPUT_QOS
        )
        self._sent = 0
        self.level = 0

    def fly(self) -> None:
        """50 ms of predictions, and the alarm."""
        given = predictions(self._sent)
        self._sent += len(given.time_ns)
        for publisher, model in zip(self._predictions, self._models, strict=True):
            for payload in result_messages.pack_predictions(given, model=model, confidence=0.95, axes=AXES):
                publisher.publish(payload)
        said = alarms(int(given.time_ns[-1]), self.level)
        reasons = ("forward or backward speed 2.0 x the training range",) if self.level else ()
        (payload,) = result_messages.pack_alarms(said, [reasons])
        self._alarm.publish(payload)


def flying(source: LiveSource, *vehicles: Publishing) -> Callable[[], None]:
    """A turn of a test: everyone flies, the page listens."""

    def turn() -> None:
        for vehicle in vehicles:
            vehicle.fly()
        time.sleep(0.02)
        source.poll()

    return turn


def test_vehicles_are_found_by_namespace_with_their_models_and_states(node, source, model):
    one = Publishing(node, "/uav1", model.identity, further=("second", "another"))
    other = Publishing(node, "", "unknown@1")
    other.level = 2
    turn = flying(source, one, other)
    wait_until(
        lambda: (
            all(view.blocks.newest > 20 for view in source.vehicles.values())
            and set(source.vehicles) == {"/uav1", "/"}
            and len(source.vehicles["/uav1"].models) == 3
        ),
        turn,
        lambda: {name: view.summary() for name, view in source.vehicles.items()},
    )
    first, second = source.vehicles["/uav1"], source.vehicles["/"]
    assert [one["identity"] for one in first.describe()["models"]] == [
        model.identity,
        "another@1",
        "second@1",
    ]
    assert first.training.identity == model.identity
    assert second.training is None
    wait_until(lambda: (first.state, second.state) == (State.TRUSTED, State.ALARM), turn)
    assert second.reasons == ("forward or backward speed 2.0 x the training range",)
    assert first.describe()["inputs"][0]["upper"] == model.envelope.upper[0]


def test_an_alarm_that_stops_is_no_data(node, source, model):
    one = Publishing(node, "", model.identity)
    wait_until(
        lambda: "/" in source.vehicles and source.vehicles["/"].state == State.TRUSTED, flying(source, one)
    )
    view = source.vehicles["/"]
    begun_s = time.monotonic()
    wait_until(lambda: view.state == State.NO_DATA, source.poll)
    assert time.monotonic() - begun_s >= 0.9 * SILENCE_S
    assert "no message on /extrapolation_alarm for" in view.reasons[0]
    wait_until(lambda: view.state == State.TRUSTED, flying(source, one))


def test_nobody_who_judges_is_said(node, source):
    publisher = node.create_publisher(WrenchPrediction, "/uav/prediction", OUTPUT_QOS)
    (payload,) = result_messages.pack_predictions(predictions(0, 1), model="m@1", confidence=0.95, axes=AXES)

    def turn() -> None:
        publisher.publish(payload)
        time.sleep(0.02)
        source.poll()

    wait_until(lambda: "/uav" in source.vehicles and source.vehicles["/uav"].blocks.newest >= 0, turn)
    view = source.vehicles["/uav"]
    wait_until(lambda: view.reasons == ("nobody publishes extrapolation_alarm in /uav",), turn)
    assert view.state == State.NO_DATA


def test_two_monitors_in_one_namespace_are_told(node, source, model):
    both = Publishing(node, "", model.identity), Publishing(node, "", model.identity)
    wait_until(
        lambda: any(
            "2 monitors publish here" in text
            for view in source.vehicles.values()
            for _, _, text in view.health
        ),
        flying(source, *both),
    )
    said = source.vehicles["/"].summary()
    assert said["reasons"][0] == "2 monitors publish in /: their results are mixed"
    assert said["state"] != State.TRUSTED


def test_another_model_than_those_known_is_told(node, source):
    wait_until(
        lambda: any(
            text.startswith("other@1 flies; training ranges are known of model@")
            for view in source.vehicles.values()
            for _, _, text in view.health
        ),
        flying(source, Publishing(node, "", "other@1")),
    )


def test_inputs_follow_from_odometry_and_rotor_speeds(node, source, model):
    states_out = node.create_publisher(Odometry, "odometry", OUTPUT_QOS)
    rotors_out = node.create_publisher(RotorSpeeds, "rotor_speeds", SENSOR_QOS)
    one = Publishing(node, "", model.identity)
    sent = 0

    def turn() -> None:
        nonlocal sent
        time_ns = START_NS + (sent + np.arange(25)) * 2_000_000
        sent += 25
        level = np.tile([1.0, 0.0, 0.0, 0.0], (25, 1))
        moving = np.tile([3.0, 0.0, 0.0], (25, 1))
        covariance = np.zeros((25, 6, 6))
        states = OdometryStream(time_ns, moving, level, moving, 0 * moving)
        for payload in sensor_messages.pack_odometry(states, covariance, covariance):
            states_out.publish(payload)
        for payload in sensor_messages.pack_rotor_speeds(RotorSpeedStream(time_ns, np.full((25, 4), 800.0))):
            rotors_out.publish(payload)
        flying(source, one)()

    def newest(name: str) -> float:
        view = source.vehicles.get("/")
        numbers = range(max(0, view.blocks.newest - 20), view.blocks.newest + 1) if view else ()
        values = [float(view.blocks.value(number, name)[0]) for number in numbers]
        return max((value for value in values if np.isfinite(value)), default=float("nan"))

    wait_until(lambda: newest("inputs") == pytest.approx(3.0, abs=1e-3), turn)
    assert newest("speed") == pytest.approx(3.0)
    assert newest("rotors") == pytest.approx(800.0)


def test_six_rotors_are_shown(node, source, model):
    rotors_out = node.create_publisher(RotorSpeeds, "rotor_speeds", SENSOR_QOS)
    one = Publishing(node, "", model.identity)
    sent = 0

    def turn() -> None:
        nonlocal sent
        time_ns = START_NS + (sent + np.arange(25)) * 2_000_000
        sent += 25
        speeds = np.tile(700.0 + np.arange(6.0), (25, 1))
        for payload in sensor_messages.pack_rotor_speeds(RotorSpeedStream(time_ns, speeds)):
            rotors_out.publish(payload)
        flying(source, one)()

    def shown() -> bool:
        view = source.vehicles.get("/")
        return view is not None and any(
            view.blocks.value(number, "rotors").tolist() == [700.0 + k for k in range(6)]
            for number in range(view.blocks.newest)
        )

    wait_until(shown, turn)


def test_a_message_that_cannot_be_read_is_counted_and_shown(node, source, model):
    states_out = node.create_publisher(Odometry, "odometry", OUTPUT_QOS)
    one = Publishing(node, "", model.identity)
    turn = flying(source, one)

    bad = Odometry()
    bad.pose.pose.orientation.w = 0.0

    def with_bad_state() -> None:
        states_out.publish(bad)
        turn()

    def told() -> bool:
        rows = [row for view in source.vehicles.values() for row in view.health]
        return any(about == "messages" and "messages refused" in text for about, _, text in rows)

    wait_until(told, with_bad_state)
    assert source.vehicles["/"].state == State.TRUSTED


def test_statuses_of_its_nodes_are_shown(node, source, model):
    out = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    statuses = [
        DiagnosticStatus(
            name="uav/monitor: pairing", level=DiagnosticStatus.WARN, message="3 IMU samples without"
        ),
        DiagnosticStatus(name="elsewhere/monitor: pairing", level=DiagnosticStatus.OK, message="of another"),
        DiagnosticStatus(name="uav/camera: state", level=DiagnosticStatus.OK, message="not ours"),
    ]
    one = Publishing(node, "/uav", model.identity)
    turn = flying(source, one)

    def with_status() -> None:
        out.publish(DiagnosticArray(status=statuses))
        turn()

    def shown() -> list[tuple[str, str, str]]:
        return [row for view in source.vehicles.values() for row in view.health if ": " in row[0]]

    wait_until(shown, with_status)
    assert shown() == [("monitor: pairing", "warn", "3 IMU samples without")]


def test_a_port_in_use_and_a_model_of_another_vehicle_are_one_line(run_main):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, said = run_main("view_node", "--port", str(port), "--no-open")
    assert status == 2
    assert f"quadpi: port {port} is in use by process" in said
    status, said = run_main("view_node", "--model", str(GOLDEN_MODEL), "--vehicle", "neurobem", "--port", "0")
    assert status == 2
    assert "is of vehicle bebop2, not neurobem" in said


# A vehicle as its monitor describes it, and what is said of topics that do not come.


LOWER, UPPER = np.full(len(INPUT_NAMES), -2.0), np.full(len(INPUT_NAMES), 2.0)
ROTOR_RAD_S = 850.0


@pytest.fixture
def monitor(ros: None) -> Iterator[Node]:
    del ros
    node = Node("monitor", namespace="/uav")
    yield node
    node.destroy_node()


class Described:
    """What a monitor and its estimator publish, the results on topics that may be in another namespace."""

    def __init__(self, node: Node, results: str = "/uav") -> None:
        prediction, alarm = f"{results}/prediction", f"{results}/extrapolation_alarm"
        self._predictions = node.create_publisher(WrenchPrediction, prediction, OUTPUT_QOS)
        self._alarm = node.create_publisher(ExtrapolationAlarm, alarm, OUTPUT_QOS)
        self._states = node.create_publisher(Odometry, "/uav/odometry", OUTPUT_QOS)
        self._rotors = node.create_publisher(RotorSpeeds, "/uav/rotor_speeds", OUTPUT_QOS)
        self._description = node.create_publisher(String, "~/description", DESCRIPTION_QOS)
        topics = {"prediction": prediction, "extrapolation_alarm": alarm}
        model = DescribedModel("flies@1", "bebop2", LOWER, UPPER)
        described = pack_description([model], topics, Vehicle.load("bebop2"))
        self._description.publish(String(data=described))
        self._sent = 0

    def fly(self) -> None:
        """50 ms, one metre a second to the north."""
        given = predictions(self._sent)
        count = len(given.time_ns)
        self._sent += count
        for payload in result_messages.pack_predictions(given, model="flies@1", confidence=0.9, axes=AXES):
            self._predictions.publish(payload)
        (payload,) = result_messages.pack_alarms(alarms(int(given.time_ns[-1]), 0), [()])
        self._alarm.publish(payload)
        level, north = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.tile([1.0, 0.0, 0.0], (count, 1))
        states, covariance = (
            OdometryStream(given.time_ns, north, level, north, 0.0 * north),
            np.zeros((count, 6, 6)),
        )
        for payload in sensor_messages.pack_odometry(states, covariance, covariance):
            self._states.publish(payload)
        rotors = RotorSpeedStream(given.time_ns, np.full((count, 4), ROTOR_RAD_S))
        for payload in sensor_messages.pack_rotor_speeds(rotors):
            self._rotors.publish(payload)


def newest(source: LiveSource, name: str, vehicle: str = "/uav") -> float:
    """The last value of a quantity that has one."""
    view = source.vehicles.get(vehicle)
    if view is None:
        return float("nan")
    values = [float(view.blocks.value(number, name)[0]) for number in range(view.blocks.newest + 1)]
    return next((value for value in reversed(values) if np.isfinite(value)), float("nan"))


def shown(source: LiveSource) -> Callable[[], bool]:
    return lambda: all(
        np.isfinite(newest(source, name)) for name in ("0.upper", "speed", "inputs", "rotors", "state")
    )


def test_all_that_a_vehicle_publishes_is_shown(monitor, source):
    wait_until(shown(source), flying(source, Described(monitor)))
    assert newest(source, "speed") == pytest.approx(1.0)
    assert newest(source, "rotors") == ROTOR_RAD_S
    # The first input is the forward speed.
    assert newest(source, "inputs") == pytest.approx(1.0)
    assert source.vehicles["/uav"].describe()["models"][0]["confidence"] == 0.9


def test_training_ranges_come_from_the_monitor(monitor, source):
    turn = flying(source, Described(monitor))
    wait_until(lambda: shown(source)() and source.vehicles["/uav"].training is not None, turn)
    view = source.vehicles["/uav"]
    assert [one["upper"] for one in view.describe()["inputs"]] == UPPER.tolist()
    assert view.training is not None
    assert view.training.vehicle == "bebop2"


def test_results_in_another_namespace_belong_to_the_vehicle_of_the_monitor(monitor, source):
    turn = flying(source, Described(monitor, results="/elsewhere"))
    wait_until(lambda: shown(source)() and set(source.vehicles) == {"/uav"}, turn)
    assert source.vehicles["/uav"].state == State.TRUSTED


def test_what_does_not_come_is_named(node, source):
    vehicle = Publishing(node, "/plain", "unknown@1")
    node.create_publisher(Erpm, "/plain/erpm", OUTPUT_QOS)

    def rows() -> dict[str, str]:
        return {about: text for view in source.vehicles.values() for about, _, text in view.health}

    wait_until(lambda: "rotor speeds" in rows(), flying(source, vehicle), rows)
    assert rows()["odometry"] == (
        "of other messages, which the monitor alone reads: flight, speed and height are not shown"
    )
    assert rows()["rotor speeds"].startswith("erpm needs the pole pairs of the vehicle")


def test_battery_and_link_are_told_beside_the_state_while_they_come(node, source, monkeypatch):
    vehicle = Publishing(node, "/plain", "unknown@1")
    battery = node.create_publisher(BatteryState, "/plain/mavros/battery", OUTPUT_QOS)
    told = node.create_publisher(DiagnosticArray, "/diagnostics", OUTPUT_QOS)
    fly = flying(source, vehicle)

    def turn() -> None:
        battery.publish(BatteryState(voltage=15.2, percentage=0.5))
        told.publish(
            DiagnosticArray(status=[DiagnosticStatus(name="plain/mavlink_bridge: link", message="heard")])
        )
        fly()

    def words() -> dict[str, str]:
        return {name: text for view in source.vehicles.values() for name, text in view.told.items()}

    wait_until(lambda: words() == {"battery": "15.2 V, 50 %", "link": "heard"}, turn, words)
    monkeypatch.setattr(view_node, "TOLD_S", 0.2)
    wait_until(lambda: set(words().values()) == {"no message for 5 s"}, fly, words)


def test_a_description_of_somebody_else_is_no_vehicle(node, source):
    node.create_publisher(String, "/camera/net/description", DESCRIPTION_QOS)
    vehicle = Publishing(node, "/quad", "m@1")
    wait_until(lambda: "/quad" in source.vehicles, flying(source, vehicle))
    assert set(source.vehicles) == {"/quad"}


def test_a_description_that_is_none_is_counted_and_shown(monitor, source):
    vehicle = Described(monitor)
    bad = monitor.create_publisher(String, "~/description", DESCRIPTION_QOS)
    bad.publish(String(data="{}"))
    turn = flying(source, vehicle)

    def told() -> bool:
        rows = [row for view in source.vehicles.values() for row in view.health]
        return any(
            about == "messages" and "not the description of a monitor" in text for about, _, text in rows
        )

    wait_until(told, turn)
    assert source.vehicles["/uav"].state == State.TRUSTED
