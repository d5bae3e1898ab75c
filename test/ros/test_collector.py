# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the live nodes publish, kept and told while it comes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction

from quadpi_core.flight import AXES, OdometryStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.results import Alarms, Predictions, ReportedAlarms
from quadpi_ros.callbacks import OUTPUT_QOS
from quadpi_ros.live_session import AlarmChange, AlarmFollower, Collector

from .rig import PATIENCE_S


def silent_alarm() -> Alarms:
    """An alarm that reports silence, at the stamp 0."""
    each, six = np.ones(len(INPUT_NAMES)), np.ones(len(AXES))
    envelope = Envelope(-each, each, each, six, six, six, six)
    return Alarm(envelope, AlarmLimits(), MonitorSettings()).without_sample(0)


def alarm_message(time_ns: int, *, of_sample: bool) -> bytes:
    """A message of an alarm by the data: of a sample, or of silence."""
    silent = silent_alarm()
    health = 0 * silent.cause_health if of_sample else silent.cause_health
    alarm = replace(silent, time_ns=np.array([time_ns]), cause_health=health)
    return bytes(result_messages.pack_alarms(alarm, [()])[0])


def test_alarm_follower_tells_changes_from_repetition() -> None:
    def alarm(time_s: float, level: int, *inputs: str) -> Any:
        return SimpleNamespace(
            time_ns=[round(time_s * 1e9)],
            level=[level],
            causes=[1 if level else 0],
            inputs_outside=[inputs],
            envelope_distance=[0.1],
        )

    follower = AlarmFollower(start_ns=0)
    rows: list[ReportedAlarms] = [
        alarm(0.0, 0),
        alarm(0.1, 1, "u"),
        alarm(0.2, 2, "u"),
        alarm(0.3, 2, "u"),
        alarm(0.4, 2, "p", "u"),
        alarm(0.5, 2, "p"),
        alarm(0.6, 0),
        alarm(0.7, 0, "u"),
    ]
    changes = [follower.follow(row) for row in rows]
    assert [change is not None for change in changes] == [False, True, True, False, True, False, True, False]
    assert changes[4].time_s == pytest.approx(0.4)
    assert changes[4].inputs_outside == ("p", "u")


@pytest.mark.parametrize(
    ("inputs", "text"),
    [
        ((), "   2.50 s  ALARM   extrapolation, bad data"),
        (("u", "p"), "   2.50 s  ALARM   extrapolation, bad data: u, p, 12% out"),
        (("u", "p", "q", "r", "w"), "   2.50 s  ALARM   extrapolation, bad data: u, p, q +2, 12% out"),
    ],
)
def test_a_change_is_one_line_that_names_three_inputs(inputs: tuple[str, ...], text: str) -> None:
    assert str(AlarmChange(2.5, 2, ("extrapolation", "bad data"), inputs, 0.12)) == text


@pytest.mark.usefixtures("ros")
def test_what_is_published_is_kept_as_it_came_and_alarms_are_told_at_once() -> None:
    sender = rclpy.create_node("sender")
    kinds = {"odometry": Odometry, "prediction": WrenchPrediction, "extrapolation_alarm": ExtrapolationAlarm}
    told: list[AlarmChange] = []
    rng = np.random.default_rng(2)
    stamp, three = np.array([2_000_000_000]), rng.normal(size=(1, 3))
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    odometry = sensor_messages.pack_odometry(OdometryStream(stamp, three, level, three, three))
    predictions = Predictions(stamp, *rng.normal(size=(5, 1, 6)))
    prediction = result_messages.pack_predictions(
        predictions, model="m", confidence=0.9, axes=AXES, frame_id="b"
    )
    with Collector(1_500_000_000, told.append) as collector:
        publishers: dict[str, Any] = {}
        for topic, kind in kinds.items():
            assert not collector.connected
            publishers[topic] = sender.create_publisher(kind, topic, OUTPUT_QOS)
            assert collector.spin_until(lambda topic=topic: collector.hears(topic), PATIENCE_S)
        assert collector.connected
        assert not collector.spin_until(lambda: False, 0.1)
        for publisher in publishers.values():
            assert collector.spin_until(lambda one=publisher: one.get_subscription_count() > 0, PATIENCE_S)

        publishers["odometry"].publish(odometry[0])
        publishers["prediction"].publish(prediction[0])
        publishers["extrapolation_alarm"].publish(alarm_message(stamp[0] - 10, of_sample=False))
        assert collector.spin_until(lambda: collector.silent_ns is not None, PATIENCE_S)
        assert told == []
        publishers["extrapolation_alarm"].publish(alarm_message(stamp[0], of_sample=True))
        assert collector.spin_until(lambda: bool(told), PATIENCE_S)
        assert collector.spin_until(lambda: len(collector.odometry()) > 0, PATIENCE_S)
        assert collector.spin_until(lambda: len(collector.arrived_ns) > 0, PATIENCE_S)
    assert (told[0].time_s, told[0].level, told[0].causes) == (0.5, 2, ("bad data",))
    assert collector.silent_ns is None
    assert list(collector.odometry()) == list(odometry)
    assert collector.alarms().time_ns.tolist() == stamp.tolist()
    np.testing.assert_array_equal(collector.predictions().measured, predictions.measured)
    sender.destroy_node()
