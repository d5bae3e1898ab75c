# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle as its monitor describes it, and what is said of topics that do not come."""

from __future__ import annotations

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
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.trust import State
from quadpi_ros import view_node
from quadpi_ros.callbacks import DESCRIPTION_QOS, OUTPUT_QOS
from quadpi_ros.view_node import LiveSource

from .rig import wait_until
from .test_view_node import Publishing, alarms, flying, predictions

LOWER, UPPER = np.full(len(INPUT_NAMES), -2.0), np.full(len(INPUT_NAMES), 2.0)
ROTOR_RAD_S = 850.0


@pytest.fixture
def source(ros: None) -> Iterator[LiveSource]:
    """It knows no model."""
    del ros
    source = LiveSource(rclpy.get_default_context(), {})
    yield source
    source.close()


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("plain")
    yield node
    node.destroy_node()


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
    assert rows()["odometry"] == "nothing comes: flight, speed and height are not shown"
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
