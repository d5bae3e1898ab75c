# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the results of one model, and of several, and what goes out on each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from quadpi.msg import WrenchPrediction
from quadpi.srv import LoadModel
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from quadpi_core.errors import ModelError
from quadpi_core.flight import AirStream
from quadpi_core.messages import result_messages
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.result_messages import MonitorDescription, unpack_description
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.results import BAD_DATA, LEVEL_ALARM, LEVEL_OK
from quadpi_core.vehicle import Vehicle
from quadpi_ros import callbacks
from quadpi_ros.monitor_node import MonitorNode
from quadpi_ros.result_publishers import WRENCH_TOPICS, Results, named, topic_name

from .rig import values_of_wrench

RATE_HZ = 500.0
VEHICLE = Vehicle.load("neurobem")


class Outputs:
    """A node's publishers, each a list."""

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = defaultdict(list)
        self.logged: list[str] = []

    def announce(self, _: type, topic: str, *__: Any, **___: Any) -> Callable[[bytes], None]:
        return self.sent[topic].append

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append)

    def resolve_topic_name(self, topic: str) -> str:
        return f"/uav/{topic}"


@pytest.fixture(scope="module")
def models(folder: Path) -> dict[str, AerodynamicModel]:
    return {name: AerodynamicModel.load(folder / name) for name in ("model", "other")}


def hover(count: int) -> PairedSamples:
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((3, count, 3))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return PairedSamples.join(
        2_000_000 * np.arange(1, count + 1),
        velocity=0.05 * noise[0],
        attitude=level,
        rates=0.02 * noise[1],
        specific_force=np.array([0.0, 0.0, -VEHICLE.gravity_m_s2]) + 0.3 * noise[2],
        rotor_speeds=1100.0 + 5.0 * rng.standard_normal((count, 4)),
        wind=np.zeros((count, 3)),
    )


def as_they_are(reasons: tuple[str, ...], _: int) -> tuple[str, ...]:
    return reasons


def monitor_of(model: AerodynamicModel) -> Monitor:
    return Monitor(model, VEHICLE, RATE_HZ)


@pytest.mark.parametrize(
    ("given", "topic"),
    [("hover", "hover"), ("my model-2", "my_model_2"), ("2nd", "model_2nd"), ("_x_", "x"), ("ö", "model_")],
)
def test_a_topic_is_named_after_its_model(models, given, topic):
    assert topic_name(replace(models["model"], name=given)) == topic


def test_two_models_of_one_topic_are_refused(models):
    with pytest.raises(ModelError, match="two models are named model; both would publish as that"):
        named([monitor_of(models["model"]), monitor_of(replace(models["other"], name="model"))])


def test_every_model_predicts_and_the_first_one_raises_the_alarm(models):
    outputs, samples = Outputs(), hover(300)
    results = Results(outputs, named(monitor_of(model) for model in models.values()), "body", as_they_are)
    for k in range(300):
        one = PairedSamples(samples.time_ns[k : k + 1], samples.values[k : k + 1])
        judged = results.monitors.judge(one)
        assert judged.predictions[0].time_ns == one.time_ns.tolist()
        results.publish(judged)
    topics = ("prediction", "/uav/prediction/other", "extrapolation_alarm", "alarm_log", "~/description")
    assert set(outputs.sent) == set(topics)
    for topic, model in (("prediction", models["model"]), ("/uav/prediction/other", models["other"])):
        expected, alarms, _ = monitor_of(model).step(*samples)
        packed = result_messages.pack_predictions(
            expected, model=model.identity, confidence=model.confidence, axes=model.axes, frame_id="body"
        )
        assert outputs.sent[topic] == list(packed)
    told = result_messages.unpack_alarms(Payloads.join(outputs.sent["extrapolation_alarm"]))
    np.testing.assert_array_equal(told.time_ns, alarms.time_ns)
    level, word, values = results.alarm_status()
    assert (level, word, values["level"]) == (callbacks.OK, "ok", LEVEL_OK)
    assert values["model model"] == models["model"].identity


def test_the_models_that_fly_are_described_with_their_training_ranges_and_topics(models):
    outputs = Outputs()
    results = Results(outputs, named(monitor_of(model) for model in models.values()), "body", as_they_are)

    def described() -> MonitorDescription:
        return unpack_description(deserialize_message(outputs.sent["~/description"][-1], String).data)

    assert list(described().models) == [model.identity for model in models.values()]
    first = described().models[models["model"].identity]
    np.testing.assert_array_equal(first.upper, models["model"].envelope.upper)
    assert described().topics["alarm_log"] == "/uav/alarm_log"
    replaced = replace(models["other"], identity="new@1")
    results.swap("model", monitor_of(replaced), None, LoadModel.Response())
    assert list(described().models) == ["new@1", models["other"].identity]


def test_silence_and_alarms_are_published_and_logged(models):
    outputs, samples = Outputs(), hover(1200)
    results = Results(
        outputs, named([monitor_of(models["model"])]), "body", lambda given, _: ("no motion capture", *given)
    )
    broken = PairedSamples(samples.time_ns[300:500], np.full((200, 20), np.nan))
    for part in (PairedSamples(samples.time_ns[:300], samples.values[:300]), broken):
        results.publish(results.monitors.judge(part))
    assert results.alarm_status()[:2] == (callbacks.WARN, "alarm")
    (event,) = result_messages.unpack_events(Payloads.join(outputs.sent["alarm_log"]))
    assert event.cause == BAD_DATA
    assert event.reasons[0] == "no motion capture"
    told = result_messages.unpack_alarms(Payloads.join(outputs.sent["extrapolation_alarm"]))
    for row, words in enumerate(told.reasons):
        assert ("no motion capture" in words) == bool(told.causes[row] & BAD_DATA)
    assert outputs.logged == [
        "alarm, bad data: no motion capture; state or rotor speeds missing; sample not finite"
    ]
    before = len(outputs.sent["extrapolation_alarm"])
    results.publish_silence(5_000_000_000, ("no imu for 0.3 s",))
    (silent,) = outputs.sent["extrapolation_alarm"][before:]
    alarm = result_messages.unpack_alarms(silent)
    assert (alarm.time_ns[0], alarm.level[0]) == (5_000_000_000, LEVEL_ALARM)
    assert alarm.reasons == [("no imu for 0.3 s",)]
    assert not alarm.of_samples[0]
    results.publish(results.monitors.judge(PairedSamples(samples.time_ns[500:], samples.values[500:])))
    assert len(outputs.logged) == 2
    over = outputs.logged[1]
    assert over.startswith("alarm over after 0.")
    assert over.endswith(", bad data: no motion capture; state or rotor speeds missing; sample not finite")
    *_, cleared = result_messages.unpack_events(Payloads.join(outputs.sent["alarm_log"]))
    assert cleared.end_ns
    assert cleared.reasons == event.reasons


def test_a_model_that_is_replaced_publishes_as_the_one_before(models):
    outputs, samples = Outputs(), hover(20)
    results = Results(outputs, named([monitor_of(models["model"])]), "body", as_they_are)
    response = LoadModel.Response()
    results.swap("model", monitor_of(models["other"]), None, response)
    assert (response.success, response.model) == (True, models["other"].identity)
    results.publish(results.monitors.judge(samples))
    assert set(outputs.sent) >= {"prediction"}
    assert models["other"].identity.encode() in outputs.sent["prediction"][0]
    for name, error, message in (
        ("model", "m: cannot be read", "m: cannot be read"),
        ("none", None, "no model flies as `none`"),
    ):
        refused = LoadModel.Response()
        monitor = None if error else monitor_of(models["model"])
        results.swap(name, monitor, error, refused)
        assert not refused.success
        assert message in refused.message
        assert refused.model == (models["other"].identity if name == "model" else "")


@contextmanager
def configured(domain: int, folder: Path, *given: str) -> Iterator[MonitorNode]:
    model = f"model:=[{folder / 'model'}, {folder / 'other'}]"
    arguments = ["-p", "vehicle:=neurobem", "-p", model, "-r", "__ns:=/uav", *given]
    rclpy.init(args=["--ros-args", *arguments], domain_id=domain)
    try:
        node = MonitorNode()
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        yield node
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_a_node_that_is_activated_again_knows_no_air(ros_domain: int, folder: Path) -> None:
    with configured(ros_domain, folder) as node:
        monitors = node._results.monitors
        excess = []
        for heard in (True, False):
            assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
            for monitor in map(monitors.__getitem__, monitors.names):
                # As of a model whose flights told their air.
                monitor.preparation.goes_with_air = True
            if heard:
                node._take_air(AirStream(np.array([0]), np.array([8e4]), np.array([15.0])))
            excess.append(
                [float(monitors[name].preparation.memory["density_excess"][0]) for name in monitors.names]
            )
            assert node.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
    assert max(excess[0]) < -0.2
    assert excess[1] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("remapping", "prediction"),
    [("prediction:=/lab/wrench", "/lab/wrench"), ("imu:=/lab/imu", "/uav/prediction")],
)
def test_predictions_of_all_models_go_by_the_other_name(
    remapping: str, prediction: str, ros_domain: int, folder: Path
) -> None:
    with configured(ros_domain, folder, "-r", remapping) as node:
        topics = {publisher.topic_name for publisher in node.publishers}
    assert topics >= {prediction, f"{prediction}/other"}


def test_wrenches_are_those_of_the_predictions(models) -> None:
    """Of the first model by their names, of another one below these; read as any tool reads them."""
    outputs = Outputs()
    results = Results(
        outputs, named(map(monitor_of, models.values())), "uav/base_link", as_they_are, wrenches=True
    )
    results.publish(results.monitors.judge(hover(50)))
    for prediction, below in (("prediction", ""), ("/uav/prediction/other", "other")):
        predictions = [deserialize_message(one, WrenchPrediction) for one in outputs.sent[prediction]]
        assert len(predictions) == 50
        names = {name: f"/uav/{topic}/{below}" if below else topic for name, topic in WRENCH_TOPICS.items()}
        sent = {
            name: [deserialize_message(one, WrenchStamped) for one in outputs.sent[topic]]
            for name, topic in names.items()
        }
        for k, prediction_k in enumerate(predictions):
            found = {name: values_of_wrench(messages[k].wrench) for name, messages in sent.items()}
            assert all(messages[k].header == prediction_k.header for messages in sent.values())
            np.testing.assert_array_equal(found["predicted"], values_of_wrench(prediction_k.predicted))
            np.testing.assert_array_equal(found["measured"], values_of_wrench(prediction_k.measured))
            np.testing.assert_array_equal(found["residual"], found["measured"] - found["predicted"])
        assert np.abs(found["residual"]).max() > 0.0


@pytest.mark.parametrize(
    ("given", "topics"),
    [
        ((), set()),
        (
            ("-p", "publish_wrenches:=true", "-r", "wrench/residual:=/lab/gap"),
            {
                *("/uav/wrench/predicted", "/uav/wrench/measured", "/lab/gap"),
                *("/uav/wrench/predicted/other", "/uav/wrench/measured/other", "/lab/gap/other"),
            },
        ),
    ],
)
def test_wrenches_are_published_where_the_parameter_says_so(
    ros_domain: int, folder: Path, given: tuple[str, ...], topics: set[str]
) -> None:
    with configured(ros_domain, folder, *given) as node:
        found = {one.topic_name for one in node.publishers if one.msg_type is WrenchStamped}
    assert found == topics
