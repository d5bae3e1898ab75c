# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to published predictions, alarms and events."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from geometry_msgs.msg import WrenchStamped
from quadpi.msg import AlarmEvent, ExtrapolationAlarm, WrenchPrediction
from quadpi.srv import LoadModel
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from quadpi_core.errors import ModelError
from quadpi_core.messages import result_messages
from quadpi_core.messages.one_by_one import OutgoingMessage
from quadpi_core.messages.result_messages import pack_description
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.alarm_log import Explain, Explained
from quadpi_core.monitor.monitor import Judged, Monitors
from quadpi_core.results import CAUSE_NAMES, LEVEL_OK, Predictions
from quadpi_ros import callbacks
from quadpi_ros.callbacks import DESCRIPTION_QOS, LOG_QOS
from quadpi_ros.sensor_node import SensorNode

_NOT_IN_A_TOPIC = re.compile(r"[^A-Za-z0-9]+")
_LEVELS = ("ok", "warning", "alarm")
WRENCH_TOPICS = {name: f"wrench/{name}" for name in ("predicted", "measured", "residual")}
# Latched: the models, their training ranges and the topics below, whatever they are remapped to.
DESCRIPTION_TOPIC = "~/description"
DESCRIBED_TOPICS = ("prediction", "extrapolation_alarm", "alarm_log")


def topic_name(model: AerodynamicModel) -> str:
    """The model's name as a part of a topic."""
    name = _NOT_IN_A_TOPIC.sub("_", model.name).strip("_")
    return name if name[:1].isalpha() else f"model_{name}"


def named(monitors: Iterable[Monitor]) -> dict[str, Monitor]:
    """Monitors by the name of their model's topic.

    Raises:
        ModelError: if two would share it.
    """
    by_name: dict[str, Monitor] = {}
    for monitor in monitors:
        name = topic_name(monitor.model)
        if name in by_name:
            raise ModelError(f"parameter `model`: two models are named {name}; both would publish as that")
        by_name[name] = monitor
    return by_name


class WrenchPublisher:
    """Predictions as geometry_msgs/WrenchStamped, for tools that know the standard types alone.

    What one model predicts, what was measured, and the measured less the predicted.

    Args:
        node: to publish from.
        frame_id: body frame.
        below: name of the model, a part of its topics; none for the first.
    """

    def __init__(self, node: SensorNode[Any], frame_id: str, below: str = "") -> None:
        self._message = result_messages.wrench_message(frame_id)
        self._publish = {}
        for name, topic in WRENCH_TOPICS.items():
            # Below the resolved topic of the first: a remapping does not cover topics below the one it names.
            whole = f"{node.resolve_topic_name(topic)}/{below}" if below else topic
            self._publish[name] = node.announce(WrenchStamped, whole)

    def publish(self, predictions: Predictions) -> None:
        """Publish the wrenches of predictions."""
        for name, wrenches in result_messages.wrenches_of(predictions).items():
            for time_ns, wrench in zip(predictions.time_ns.tolist(), wrenches, strict=True):
                self._message.values[:] = wrench
                self._publish[name](self._message.stamped(time_ns))


class Results:
    """The monitors with the topics of their results: predictions of all, the alarm of the first.

    Args:
        node: to publish from.
        monitors: by name.
        frame_id: body frame.
        explained: reasons of bad data, at a stamp, with what the node knows of its sensors.
        wrenches: whether the predictions are published as wrenches, too.
    """

    def __init__(
        self,
        node: SensorNode[Any],
        monitors: dict[str, Monitor],
        frame_id: str,
        explained: Explain,
        wrenches: bool = False,
    ) -> None:
        self.monitors = Monitors(monitors)
        self._log, self._words = node.get_logger(), Explained(explained)
        self._frame_id = frame_id
        self._messages = {name: _message(monitor, frame_id) for name, monitor in monitors.items()}
        self._first, *others = monitors
        self._publish_first = node.announce(WrenchPrediction, "prediction")
        # Below the resolved topic of the first, as a remapping does not cover topics below the one it names.
        below = node.resolve_topic_name("prediction")
        self._publish_others = [(name, node.announce(WrenchPrediction, f"{below}/{name}")) for name in others]
        self._publish_alarm = node.announce(ExtrapolationAlarm, "extrapolation_alarm")
        self._publish_log = node.announce(AlarmEvent, "alarm_log", LOG_QOS)
        self._topics = {name: node.resolve_topic_name(name) for name in DESCRIBED_TOPICS}
        self._publish_description = node.announce(String, DESCRIPTION_TOPIC, DESCRIPTION_QOS)
        self._describe()
        self._wrenches = []
        if wrenches:
            self._wrenches = [WrenchPublisher(node, frame_id, name) for name in ("", *others)]
        self._alarm = (LEVEL_OK, 0)

    def publish(self, judged: Judged) -> None:
        """Publish what the monitors said of samples."""
        first, *others = judged.predictions
        for payload in result_messages.write_predictions(first, self._messages[self._first]):
            self._publish_first(payload)
        alarms, events = judged.alarms, judged.events
        if len(alarms):
            self._alarm = (int(alarms.level[-1]), int(alarms.causes[-1]))
            for payload in result_messages.pack_alarms(alarms, self._words.rows(alarms), self._frame_id):
                self._publish_alarm(payload)
        if events:
            told = self._words.events(events)
            for event in told:
                said = f"{CAUSE_NAMES[event.cause]}: {'; '.join(event.reasons)}"
                if event.end_ns:
                    lasted_s = 1e-9 * (event.end_ns - event.start_ns)
                    self._log.info(f"alarm over after {lasted_s:.1f} s, {said}")
                else:
                    self._log.warning(f"alarm, {said}")
            for payload in result_messages.pack_events(told, self._frame_id):
                self._publish_log(payload)
        for (name, publish), other in zip(self._publish_others, others, strict=True):
            for payload in result_messages.write_predictions(other, self._messages[name]):
                publish(payload)
        if self._wrenches:
            for publisher, rows in zip(self._wrenches, judged.predictions, strict=True):
                publisher.publish(rows.predictions)

    def publish_silence(self, time_ns: int, reasons: tuple[str, ...]) -> None:
        """Publish an alarm at an instant without a sample."""
        alarms = self.monitors[self._first].alarm_without_sample(time_ns)
        for payload in result_messages.pack_alarms(alarms, [reasons], self._frame_id):
            self._publish_alarm(payload)

    def swap(
        self, name: str, monitor: Monitor | None, error: str | None, response: LoadModel.Response
    ) -> None:
        """Replace the monitor of a name, if the new one could be loaded, and fill the response."""
        try:
            if monitor is None:
                raise ModelError(error)
            self.replace(name, monitor)
            response.success = True
            response.message = f"{monitor.model.identity} flies as {name}"
        except ModelError as refused:
            response.message = str(refused)
        if name in self.monitors.names:
            response.model = self.monitors[name].model.identity

    def replace(self, name: str, monitor: Monitor) -> None:
        """Put a monitor in the place of the one of a name.

        Raises:
            ModelError: see :meth:`Monitors.replace`.
        """
        self.monitors.replace(name, monitor)
        self._messages[name] = _message(monitor, self._frame_id)
        self._describe()

    def _describe(self) -> None:
        described = [self.monitors[name].model.described() for name in self.monitors.names]
        vehicle = self.monitors[self._first].vehicle
        description = pack_description(described, self._topics, vehicle)
        self._publish_description(serialize_message(String(data=description)))

    def alarm_status(self) -> tuple[bytes, str, dict[str, Any]]:
        """Level, message and values of the status of the alarm."""
        level, causes = self._alarm
        models = {f"model {name}": self.monitors[name].model.identity for name in self.monitors.names}
        severity = callbacks.OK if level == LEVEL_OK else callbacks.WARN
        return severity, _LEVELS[level], {"level": level, "causes": causes} | models


def _message(monitor: Monitor, frame_id: str) -> OutgoingMessage:
    model = monitor.model
    return result_messages.prediction_message(model.identity, monitor.confidence, model.axes, frame_id)
