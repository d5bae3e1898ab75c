# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a running vehicle does to the nodes, over real DDS: one process of live nodes through all of it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction
from quadpi.srv import LoadModel
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message

from quadpi_core.flight import PoseStream, RotorSpeedStream
from quadpi_ros.live_session import Child

from .aggregation import groups_of
from .rig import STARTED_S, STEP_NS, TOPICS, Rig, arguments, assert_alive, assert_whole, values_of

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=rpm"],
            "must be one of rotor_speeds, erpm, mavros_status, mavros_telemetry, px4_status, found `rpm`",
        ),
        (["vehicle:=neurobem", "model:=m", "rotor_topic:=erpm"], "electrical rotor speeds need `pole_pairs`"),
        (
            ["vehicle:=neurobem", "model:=m", "world_frame:=map", "monitor:mode:=x"],
            "unknown parameter `mode`",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=px4_status"],
            "node monitor: parameter `adapters` is required for `px4_status`",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "mocap_topic:=mocap4r2", "adapters:=px4"],
            "px4_msgs/msg/SensorCombined: the package px4_msgs that defines it is not installed here",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=mavros_status", "adapters:=mavros"],
            "mavros_msgs/msg/ESCStatus: the package mavros_msgs that defines it is not installed here",
        ),
        (["vehicle:=neurobem", "model:=m", "adapters:=no_such"], "no such adapter file"),
    ],
)
def test_live_process_refuses_wrong_parameters(
    run_main: Callable[..., tuple[int, str]], overrides: list[str], message: str
) -> None:
    arguments = [part for override in overrides for part in ("-p", override)]
    status, errors = run_main("live_process", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert message in line


@pytest.fixture(scope="module")
def live(ros_domain: int, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Child]:
    del ros_domain
    models = f"[{folder / 'model'}, {folder / 'other'}]"
    with Child("quadpi_ros.live_process", arguments(models), tmp_path_factory.mktemp("err")) as nodes:
        yield nodes


@pytest.fixture
def rig(running: Rig) -> Iterator[Rig]:
    """The vehicle in the air and predicted, whatever came before; nothing is queued any more."""
    running.forget()
    running.fly_until_heard("odometry", "prediction", "prediction/other")
    running.forget()
    yield running
    assert_alive(running.nodes)


def predictions(rig: Rig, topic: str = "prediction") -> list[WrenchPrediction]:
    return [deserialize_message(payload, WrenchPrediction) for payload in list(rig.heard[topic])]


def test_every_model_publishes(rig: Rig) -> None:
    span = rig.fly(0.5)
    for topic in ("odometry", "prediction", "prediction/other"):
        assert_whole(rig, topic, *span)
    assert {message.model[:5] for message in predictions(rig)} == {"model"}
    assert {message.model[:5] for message in predictions(rig, "prediction/other")} == {"other"}


def test_a_model_is_replaced_without_missing_a_sample(rig: Rig, folder: Path) -> None:
    answers = []

    def ask(count: int, sample: dict[str, Any]) -> dict[str, Any]:
        if count in {50, 51}:
            request = LoadModel.Request(path=str(folder / ("other", "no_such_model")[count - 50]))
            answers.append(rig.call_later(LoadModel, "monitor/load_model", request))
        return sample

    rig.client(LoadModel, "monitor/load_model")
    span = rig.fly(3.0, ask)
    replaced, refused = (answer() for answer in answers)
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
    # Relative to the folder of models, wherever the process was started.
    back = rig.call(LoadModel, "monitor/load_model", LoadModel.Request(path="model"))
    assert back.success, back.message


def test_no_model_is_loaded_from_another_folder(rig: Rig, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "other", tmp_path / "planted")
    (folder / "link").symlink_to(tmp_path / "planted")
    for path in (tmp_path / "planted", folder / ".." / tmp_path.name / "planted", folder / "link"):
        answer = rig.call(LoadModel, "monitor/load_model", LoadModel.Request(path=str(path)))
        assert not answer.success
        assert f"{path}: lies outside of {folder}: models are loaded from there" in answer.message
        assert answer.model.startswith("model")


@pytest.mark.filterwarnings("error::RuntimeWarning")
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


def test_another_number_of_rotors_is_refused_by_name_until_it_is_right(rig: Rig) -> None:
    def six(_: int, sample: dict[str, Any]) -> dict[str, Any]:
        rotors = sample["rotor_speeds"]
        return sample | {"rotor_speeds": RotorSpeedStream(rotors.time_ns, np.full((1, 6), 800.0))}

    rig.fly(2.5, six)
    reason = "sample 0: `rotor_speeds` holds 6 values, expected 4"
    every = f"every message is refused on rotor_speeds: {reason}"
    rig.await_status("monitor: state", DiagnosticStatus.ERROR, every)
    status = rig.await_status("monitor: rotor_speeds", DiagnosticStatus.WARN, "samples refused")
    assert float(values_of(status)[f"refused: {reason}"]) > 100
    assert rig.nodes.errors.read_text().count(f"topic rotor_speeds: message refused: {reason}") == 1
    _, last_ns = rig.fly(1.5)
    rig.await_stamp("prediction", last_ns)
    rig.await_status("monitor: state", DiagnosticStatus.OK, "active")


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


def test_who_uses_a_topic_with_another_message_type_is_named(rig: Rig) -> None:
    silent = rig.node.create_publisher(Odometry, "wind", 1)
    deaf = rig.node.create_subscription(Odometry, "alarm_log", print, 1)
    status = rig.await_status("monitor: wind", DiagnosticStatus.ERROR, "topic /wind: ")
    assert "/rig publishes nav_msgs/msg/Odometry, not geometry_msgs/msg/Vector3Stamped" in status.message
    expects = "/rig expects nav_msgs/msg/Odometry, not quadpi/msg/AlarmEvent"
    rig.await_status("monitor: alarm_log", DiagnosticStatus.ERROR, expects)
    rig.node.destroy_publisher(silent)
    rig.node.destroy_subscription(deaf)
    rig.await_status("monitor: wind", DiagnosticStatus.OK, "nothing arrives")


def test_every_status_is_in_one_group_of_the_aggregator(rig: Rig) -> None:
    """In any namespace; those of other packages are in none."""
    rig.fly(1.5)
    rig.await_status("monitor: alarm", DiagnosticStatus.OK, "")
    rig.await_status("estimator: filter", DiagnosticStatus.OK, "")
    names = {status.name for status in rig.told}
    assert names >= {"monitor: state", "monitor: pairing", "estimator: mocap/pose", "estimator: consistency"}
    for name in names:
        node, _, task = name.partition(": ")
        expected = "Alarm" if name == "monitor: alarm" else node.capitalize()
        assert task
        for given in (name, f"uav1/{name}", f"fleet/uav2/{name}"):
            assert groups_of(given) == [expected]
        for other in (f"pose_{name}", name.replace(":", "_2:")):
            assert groups_of(other) == []


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
    payloads = rig.heard["extrapolation_alarm"]
    paused = [deserialize_message(payload, ExtrapolationAlarm) for payload in list(payloads)][-1]
    assert paused.reasons[-1] == "/clock stands still"
    assert rig.stamps("extrapolation_alarm", 0, 2**62).max() == pytest.approx(span[1], abs=2e7)
    rig.fly(1.2)
    rig.until(lambda: float(values_of(rig.latest("estimator: imu"))["stamp_age_s"]) < 0.5)
    rig.until(
        lambda: values_of(rig.latest("monitor: pairing")).get("latency_from_stamp") == "unknown: use_sim_time"
    )
    for node in ("estimator", "monitor"):
        assert rig.set_parameter("use_sim_time", False, node).successful
    rig.sim_time = False


def test_another_rate_is_followed(rig: Rig) -> None:
    rig.fly(1.6, imu_hz=400.0)
    rig.forget()
    first_ns, last_ns = rig.fly(1.0, imu_hz=400.0)
    rig.await_stamp("prediction", last_ns)
    np.testing.assert_array_equal(np.diff(rig.stamps("prediction", first_ns, last_ns)), 2_500_000)
    rig.fly(1.6)


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
    with Child("quadpi_ros.live_process", arguments(str(folder / "model")), tmp_path) as running.nodes:
        running.fly_until_heard("prediction")
        span = running.fly(0.5)
        assert_whole(running, "prediction", *span)
