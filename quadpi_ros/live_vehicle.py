# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One vehicle of a ROS domain as the page shows it: what its topics say goes into its view.

Nodes of quadpi give their results in batches, see :mod:`quadpi_ros.message_batches`; what no batch carries,
as of a bag that is played or of an estimator of somebody else, is heard topic by topic.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import AlarmEvent, Erpm, ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String, UInt8MultiArray

from quadpi_core.errors import LogError
from quadpi_core.flight import OdometryStream, RotorSpeedStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.model_description import unpack_description
from quadpi_core.messages.payloads import Payloads
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.results import Predictions
from quadpi_core.vehicle import ROTORS, Vehicle
from quadpi_core.view.live_inputs import LiveInputs
from quadpi_core.view.trust import SILENCE_S
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView
from quadpi_ros.dds_profile import DESCRIPTION_QOS, LOG_QOS
from quadpi_ros.diagnostics import type_name
from quadpi_ros.inbox import TAKEN_QOS, Inbox
from quadpi_ros.message_batches import BATCH_QOS, ROWS, parts_of, unpack_rows
from quadpi_ros.result_publishers import INPUT_ROWS, ROTOR_ROWS

# What is held at full resolution: a quarter of an hour, 15 MB with three models.
_BLOCKS = 18_000
# Stamps further from this computer's clock than this are of another clock.
_SAME_CLOCK_S = 5.0
# What has not come after this long is said to be missing.
_COMES_S = 3.0
# What batches carried is not heard topic by topic; after this long without one it is.
_BATCHES_GONE_S = 2.0
PREDICTION, ALARM = type_name(WrenchPrediction), type_name(ExtrapolationAlarm)
_ODOMETRY, _ROTORS, _ERPM = type_name(Odometry), type_name(RotorSpeeds), type_name(Erpm)
_WIND, _LOG = type_name(Vector3Stamped), type_name(AlarmEvent)
_LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
# Values of a status that the page shows beside its message.
_SHOWN = ("latency_p50_ms", "latency_p99_ms", "dropped", "rate_hz")
# Topics that are heard one by one: type, quality of service, and what of a batch stands in for them.
_SINGLE: dict[str, tuple[type, QoSProfile, str]] = {
    PREDICTION: (WrenchPrediction, TAKEN_QOS, PREDICTION),
    _ODOMETRY: (Odometry, TAKEN_QOS, _ODOMETRY),
    _ROTORS: (RotorSpeeds, TAKEN_QOS, ROTOR_ROWS),
    _ERPM: (Erpm, TAKEN_QOS, ROTOR_ROWS),
    _WIND: (Vector3Stamped, TAKEN_QOS, INPUT_ROWS),
    ALARM: (ExtrapolationAlarm, TAKEN_QOS, ""),
    _LOG: (AlarmEvent, LOG_QOS, ""),
}
BATCH, DESCRIPTION = type_name(UInt8MultiArray), type_name(String)
BATCH_NAME, DESCRIPTION_NAME = "batch", "description"


def order(topic: str) -> tuple[int, str]:
    """`prediction` comes before `prediction/NAME`: the first model is the one that gives the alarm."""
    return topic.count("/"), topic


class LiveVehicle:
    """What the topics of one vehicle say, in its view.

    Args:
        node: subscribes.
        namespace: of the vehicle, such as `/` or `/uav1`.
        known: models with their vehicles, by identity.

    Attributes:
        view: what is known of it.
    """

    def __init__(
        self, node: Node, namespace: str, known: Mapping[str, tuple[AerodynamicModel, Vehicle]]
    ) -> None:
        described = {identity: model.described() for identity, (model, _) in known.items()}
        self.view = VehicleView(namespace, described, BLOCK_NS, _BLOCKS)
        self._node = node
        # Cut-off and vehicle of models, by identity.
        self._known = {identity: (model.cutoff_hz, vehicle) for identity, (model, vehicle) in known.items()}
        self._given = tuple(known)
        # Inboxes by the name of their topic: of the vehicle's own nodes, and of its other topics by type.
        self._batches: dict[str, Inbox] = {}
        self._descriptions: dict[str, Inbox] = {}
        self._singles: dict[str, dict[str, Inbox]] = {type_: {} for type_ in _SINGLE}
        # Names of its topics before and after remapping; when a batch carried which content last.
        self._topics: dict[str, str] = {}
        self._carried_s: dict[str, float] = {}
        self._inputs: tuple[str, LiveInputs] | None = None
        self._refused = 0
        self._refusal = ""
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._since_s = time.monotonic()
        self._predictions: dict[str, int] = {}
        self._counted: tuple[float, int] = (self._since_s, 0)
        self._age_ms: float | None = None

    @property
    def claimed(self) -> frozenset[str]:
        """Topics that its monitor says are its own, in whatever namespace."""
        return frozenset((*self._topics.values(), *(self._predictions if self._topics else ())))

    @property
    def heard(self) -> tuple[str, ...]:
        """Topics that make it a vehicle."""
        return (*self._batches, *self._singles[PREDICTION], *self._singles[ALARM])

    def close(self) -> None:
        """Leave all topics."""
        for inboxes in (self._batches, self._descriptions, *self._singles.values()):
            for inbox in inboxes.values():
                inbox.close(self._node)
            inboxes.clear()

    def listen(self, found: Mapping[str, Sequence[str]]) -> None:
        """Subscribe to those of the topics, with their types, that are its own and not heard yet."""
        namespace = self.view.name.rstrip("/")
        batched = False
        for topic in sorted(found, key=order):
            if not (topic.startswith(f"{namespace}/") or topic in self.claimed):
                continue
            relative, types = topic.removeprefix(f"{namespace}/"), found[topic]
            if relative.count("/") == 1 and relative.endswith(f"/{BATCH_NAME}") and BATCH in types:
                batched = True
                if topic not in self._batches:
                    self._batches[topic] = Inbox(self._node, UInt8MultiArray, topic, BATCH_QOS, raw=False)
            elif (
                relative.count("/") == 1
                and relative.endswith(f"/{DESCRIPTION_NAME}")
                and DESCRIPTION in types
                and topic not in self._descriptions
            ):
                self._descriptions[topic] = Inbox(self._node, String, topic, DESCRIPTION_QOS, raw=False)
        # Batches take a moment to come; until then nothing is subscribed to in vain.
        if batched and time.monotonic() - self._since_s < 1.0:
            found = {topic: types for topic, types in found.items() if {ALARM, _LOG} & set(types)}
        for topic in sorted(found, key=order):
            for type_ in found[topic]:
                if type_ in _SINGLE and self._is_own(topic, type_):
                    self._hear(topic, type_)
        for type_, inboxes in self._singles.items():
            if self._carried(_SINGLE[type_][2]):
                for inbox in inboxes.values():
                    inbox.close(self._node)
                inboxes.clear()

    def _is_own(self, topic: str, type_: str) -> bool:
        if topic in self.claimed:
            return True
        namespace = self.view.name.rstrip("/")
        relative = topic.removeprefix(f"{namespace}/")
        if not topic.startswith(f"{namespace}/") or (self._topics and type_ in (PREDICTION, ALARM, _LOG)):
            return False
        return type_ == PREDICTION or relative == "wind" or ("/" not in relative and type_ != _WIND)

    def _hear(self, topic: str, type_: str) -> None:
        message_type, qos, content = _SINGLE[type_]
        inboxes = self._singles[type_]
        several = type_ == PREDICTION
        if not self._carried(content) and topic not in inboxes and (several or not inboxes):
            inboxes[topic] = Inbox(self._node, message_type, topic, qos)

    def _carried(self, content: str) -> bool:
        return time.monotonic() - self._carried_s.get(content, float("-inf")) < _BATCHES_GONE_S

    def take(self) -> None:
        """Take what has come; a message that cannot be read is counted and shown."""
        parts: dict[tuple[str, str], Payloads] = {}
        self._guarded(self._take_descriptions)
        self._guarded(lambda: parts.update(self._batched()))
        self._guarded(lambda: self._take_predictions(parts))
        self._guarded(lambda: self._take_motion(parts))
        self._guarded(self._take_alarms)
        self._watch()

    def _guarded(self, take: Callable[[], None]) -> None:
        try:
            take()
        except LogError as error:
            self._refused += 1
            self._refusal = str(error)

    def take_status(self, status: DiagnosticStatus) -> None:
        """Take a status of one of its nodes."""
        self._statuses[status.name.rpartition("/")[2]] = status

    def _take_descriptions(self) -> None:
        for inbox in self._descriptions.values():
            for message in inbox.take():
                description = unpack_description(message.data)
                self.view.learn(description.models)
                for identity, model in description.models.items():
                    if description.vehicle is not None and model.cutoff_hz is not None:
                        self._known.setdefault(identity, (model.cutoff_hz, description.vehicle))
                self._topics = {**self._topics, **description.topics}

    def _batched(self) -> dict[tuple[str, str], Payloads]:
        """What has come in batches, by topic and type."""
        found: dict[tuple[str, str], list[Payloads]] = {}
        for inbox in self._batches.values():
            for batch in inbox.take():
                for topic, type_, payloads in parts_of(batch):
                    found.setdefault((topic, type_), []).append(payloads)
        now_s = time.monotonic()
        self._carried_s |= {topic if type_ == ROWS else type_: now_s for topic, type_ in found}
        return {key: Payloads.concatenate(several) for key, several in found.items()}

    def _take_predictions(self, parts: Mapping[tuple[str, str], Payloads]) -> None:
        came = {topic: payloads for (topic, type_), payloads in parts.items() if type_ == PREDICTION}
        for topic, inbox in self._singles[PREDICTION].items():
            if (taken := inbox.take()) and not self._carried(PREDICTION):
                came[topic] = Payloads.join(taken)
        # The first one leads the time of the page.
        first = min((*came, *self._predictions, *self._singles[PREDICTION]), key=order, default="")
        for topic in sorted(came, key=order):
            if topic != first and not self._predictions:
                continue
            payloads = came[topic]
            self._predictions[topic] = self._predictions.get(topic, 0) + len(payloads)
            about = result_messages.unpack_model(payloads[len(payloads) - 1])
            predictions = result_messages.unpack_predictions(payloads)
            self.view.take_predictions(topic, predictions, *about)
            if topic == first:
                age_s = 1e-9 * (time.time_ns() - int(predictions.time_ns[-1]))
                self._age_ms = 1e3 * age_s if abs(age_s) < _SAME_CLOCK_S else None

    def _take_motion(self, parts: Mapping[tuple[str, str], Payloads]) -> None:
        states = self._single_states()
        for (_, type_), payloads in parts.items():
            if type_ == _ODOMETRY:
                states = sensor_messages.unpack_odometry(payloads)
        # Shown before rotor speeds are read, which may be refused.
        if states is not None:
            self.view.take_states(states)
        rotors = self._single_rotors()
        if (ROTOR_ROWS, ROWS) in parts:
            rotors = RotorSpeedStream(*unpack_rows(parts[ROTOR_ROWS, ROWS], ROTORS))
        if rotors is not None:
            self.view.take_rotor_speeds(rotors)
        wind = self._unpacked(_WIND, sensor_messages.unpack_wind)
        if (INPUT_ROWS, ROWS) in parts:
            self.view.take_inputs(*unpack_rows(parts[INPUT_ROWS, ROWS], len(INPUT_NAMES)))
        elif not self._carried(INPUT_ROWS) and (follower := self._follower()) is not None:
            if wind is not None:
                follower.wind = wind.velocity[-1]
            self.view.take_inputs(*follower.take(states, rotors))

    def _single_states(self) -> OdometryStream | None:
        states = self._unpacked(_ODOMETRY, sensor_messages.unpack_odometry)
        return None if self._carried(_ODOMETRY) else states

    def _single_rotors(self) -> RotorSpeedStream | None:
        rotors = self._unpacked(_ROTORS, sensor_messages.unpack_any_rotor_speeds)
        flying = self._flying()
        if rotors is None and flying is not None:
            rotors = self._unpacked(_ERPM, lambda payloads: sensor_messages.unpack_erpm(payloads, flying[1]))
        return None if self._carried(ROTOR_ROWS) else rotors

    def _take_alarms(self) -> None:
        events = self._unpacked(_LOG, result_messages.unpack_events)
        if events is not None:
            self.view.take_events(events)
        alarms = self._unpacked(ALARM, result_messages.unpack_alarms)
        if alarms is not None:
            self.view.take_alarms(alarms)

    def _unpacked(self, type_: str, unpack: Callable[[Payloads], Any]) -> Any:
        inbox = self._single(type_)
        return None if inbox is None else inbox.unpacked(unpack)

    def _single(self, type_: str) -> Inbox | None:
        return next(iter(self._singles[type_].values()), None)

    def _flying(self) -> tuple[float, Vehicle] | None:
        """Cut-off and vehicle of the model that gives the alarm, where they are known here."""
        first = next(iter(self.view.models.values()), None)
        return None if first is None else self._known.get(first.identity)

    def _follower(self) -> LiveInputs | None:
        """Of the inputs of the model that flies; a new one where another model takes its place."""
        first, flying = next(iter(self.view.models.values()), None), self._flying()
        if first is None or flying is None:
            return None
        cutoff_hz, vehicle = flying
        if self._inputs is None or self._inputs[0] != first.identity:
            self._inputs = first.identity, LiveInputs(vehicle, cutoff_hz)
        return self._inputs[1]

    def _watch(self) -> None:
        """Say that nobody judges where no alarm message comes."""
        alarm = self._single(ALARM)
        silent_s = time.monotonic() - (self._since_s if alarm is None else alarm.arrived_s)
        if silent_s < SILENCE_S:
            return
        if alarm is None:
            reason = f"nobody publishes extrapolation_alarm in {self.view.name}"
        elif alarm.publishers(self._node) == 0:
            reason = f"the monitor has gone: nobody publishes {alarm.topic} any more"
        elif alarm.count == 0:
            reason = f"nothing has come on {alarm.topic}: is the monitor active?"
        else:
            reason = f"no message on {alarm.topic} for {silent_s:.0f} s"
        self.view.silent((reason,))

    def report(self) -> None:
        """Renew the table of its health."""
        now_s = time.monotonic()
        rows: list[tuple[str, str, str]] = []
        heard = (*self._predictions, *self._singles[PREDICTION])
        first = min(heard, key=order, default=None)
        if first is None:
            rows.append(("prediction", "error", f"nobody publishes prediction in {self.view.name}"))
        else:
            count = self._predictions.get(first, 0)
            (before_s, before), self._counted = self._counted, (now_s, count)
            rate_hz = (count - before) / max(1e-3, now_s - before_s)
            age = f", newest sample {self._age_ms:.0f} ms old" if self._age_ms is not None else ""
            rows.append((first, "ok" if rate_hz else "error", f"{rate_hz:.0f} Hz{age if rate_hz else ''}"))
        if now_s - self._since_s > _COMES_S:
            rows += self._missing()
        alarm = self._single(ALARM)
        doubts = []
        for topic in filter(None, (first, alarm.topic if alarm is not None else None)):
            publishers = self._node.count_publishers(topic)
            if publishers > 1:
                rows.append((topic, "error", f"{publishers} monitors publish here: their results are mixed"))
                doubts = [f"{publishers} monitors publish in {self.view.name}: their results are mixed"]
        self.view.doubts = tuple(doubts)
        flying = next(iter(self.view.models.values()), None)
        if flying is not None and self.view.training is None and self._given:
            names = ", ".join(self._given)
            rows.append(("model", "warn", f"{flying.identity} flies; training ranges are known of {names}"))
        if self._refused:
            rows.append(("messages", "warn", f"{self._refused} batches refused, the last: {self._refusal}"))
        for name, status in sorted(self._statuses.items()):
            values = {one.key: one.value for one in status.values if one.key in _SHOWN}
            text = ", ".join([status.message, *(f"{key} {value}" for key, value in values.items())])
            rows.append((name, _LEVELS.get(status.level, "error"), text))
        self.view.health.rows = rows

    def _missing(self) -> list[tuple[str, str, str]]:
        """Rows of the table of health for what is not shown, as nothing says it."""
        rows = []
        inbox = self._single(_ODOMETRY)
        if not self._carried(_ODOMETRY) and (inbox is None or not inbox.count):
            rows.append(("odometry", "warn", "nothing comes: flight, speed and height are not shown"))
        inboxes = [one for one in (self._single(_ROTORS), self._single(_ERPM)) if one is not None]
        if not self._carried(ROTOR_ROWS) and not any(one.count for one in inboxes):
            reason = "nothing comes"
            if self._single(_ERPM) is not None and self._flying() is None:
                reason = "erpm needs the pole pairs of the vehicle: quadpi view --model MODEL"
            rows.append(("rotor speeds", "warn", f"{reason}: they are not shown"))
        return rows


def warm_up() -> None:
    """Load decoders and compiled kernels: the first messages of a flight are not to wait for them."""
    row, level = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    time_ns, six = np.zeros(1, dtype=np.int64), np.zeros((1, 6))
    predictions = Predictions(time_ns, six, six, six, six, six)
    packed = result_messages.pack_predictions(predictions, model="", confidence=0.95, axes=())
    result_messages.unpack_predictions(packed)
    result_messages.unpack_model(packed[0])
    covariance = np.zeros((1, 6, 6))
    states = OdometryStream(time_ns, row, level, row, row)
    sensor_messages.unpack_odometry(sensor_messages.pack_odometry(states, covariance, covariance))
    for name in (sensor_messages.ALARM, sensor_messages.EVENT, sensor_messages.ROTOR_SPEEDS):
        codec(name)
    # What is loaded by now stays: the collector need not look at it again.
    gc.collect()
    gc.freeze()
