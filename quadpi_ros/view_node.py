# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live page: a node that listens to the results of every vehicle of the domain, and publishes nothing.

Messages are taken at the ticks of the server, not one by one by an executor: at 500 Hz that costs a fraction.
Subscriptions are best effort, so that no publisher ever waits for the page.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import AlarmEvent, Erpm, ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String

from quadpi_core.errors import LogError
from quadpi_core.flight import OdometryStream
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.result_messages import unpack_description
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.results import Predictions
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.trust import NO_MESSAGE, REPORTS, SILENCE_S, TOLD_S, MotionInputs, Told
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView
from quadpi_core.view.view_server import ADDRESS, PORT, announce, serve_page
from quadpi_ros.callbacks import DESCRIPTION_QOS, LOG_QOS, type_name
from quadpi_ros.input_sources import TAKEN_QOS, AdapterError, Inbox, message_class
from quadpi_ros.runtime import run

# What is held at full resolution: a quarter of an hour, 15 MB with three models.
_BLOCKS = 18_000
# Stamps further from this computer's clock than this are of another clock.
_SAME_CLOCK_S = 5.0
# What has not come after this long is said to be missing.
_COMES_S = 3.0
PREDICTION, ALARM = type_name(WrenchPrediction), type_name(ExtrapolationAlarm)
_ODOMETRY, _ROTORS, _ERPM = type_name(Odometry), type_name(RotorSpeeds), type_name(Erpm)
_WIND, _LOG = type_name(Vector3Stamped), type_name(AlarmEvent)
_LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
# Values of a status that the page shows beside its message.
_SHOWN = ("latency_p50_ms", "latency_p99_ms", "dropped", "rate_hz")
# Types that are heard, with their quality of service.
_HEARD: dict[str, tuple[type, QoSProfile]] = {
    PREDICTION: (WrenchPrediction, TAKEN_QOS),
    _ODOMETRY: (Odometry, TAKEN_QOS),
    _ROTORS: (RotorSpeeds, TAKEN_QOS),
    _ERPM: (Erpm, TAKEN_QOS),
    _WIND: (Vector3Stamped, TAKEN_QOS),
    ALARM: (ExtrapolationAlarm, TAKEN_QOS),
    _LOG: (AlarmEvent, LOG_QOS),
}
# Those of other packages, where these are installed; they are slow.
for _report in REPORTS:
    with suppress(AdapterError):
        _HEARD[_report] = (message_class(_report), TAKEN_QOS)
DESCRIPTION = type_name(String)
DESCRIPTION_NAME = "description"


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
        # Vehicles of models, by identity.
        self._known = {identity: vehicle for identity, (_, vehicle) in known.items()}
        self._given = tuple(known)
        # Inboxes by the name of their topic: descriptions of monitors, and its other topics by type.
        self._descriptions: dict[str, Inbox] = {}
        self._inboxes: dict[str, dict[str, Inbox]] = {type_: {} for type_ in _HEARD}
        # Names of its topics before and after remapping.
        self._topics: dict[str, str] = {}
        self._motion: MotionInputs | None = None
        self._refused = 0
        self._refusal = ""
        self._statuses: dict[str, DiagnosticStatus] = {}
        # When each of battery, autopilot and link last said something.
        self._told_s: dict[str, float] = {}
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
        described = self._descriptions if self._topics else ()
        return (*described, *self._inboxes[PREDICTION], *self._inboxes[ALARM])

    def close(self) -> None:
        """Leave all topics."""
        for inboxes in (self._descriptions, *self._inboxes.values()):
            for inbox in inboxes.values():
                inbox.close(self._node)
            inboxes.clear()

    def listen(self, found: Mapping[str, Sequence[str]]) -> None:
        """Subscribe to those of the topics, with their types, that are its own and not heard yet."""
        for topic in sorted(found, key=order):
            if self._is_description(topic, found[topic]) and topic not in self._descriptions:
                self._descriptions[topic] = Inbox(self._node, String, topic, DESCRIPTION_QOS, raw=False)
            for type_ in found[topic]:
                inboxes = self._inboxes.get(type_)
                if inboxes is None or topic in inboxes or not self._is_own(topic, type_):
                    continue
                # Of predictions all are heard, of other types the first topic.
                if type_ == PREDICTION or not inboxes:
                    message_type, qos = _HEARD[type_]
                    inboxes[topic] = Inbox(self._node, message_type, topic, qos, raw=type_ not in REPORTS)

    def _is_description(self, topic: str, types: Sequence[str]) -> bool:
        namespace = self.view.name.rstrip("/")
        relative = topic.removeprefix(f"{namespace}/")
        return (
            DESCRIPTION in types
            and topic.startswith(f"{namespace}/")
            and relative.count("/") == 1
            and relative.endswith(f"/{DESCRIPTION_NAME}")
        )

    def _is_own(self, topic: str, type_: str) -> bool:
        if topic in self.claimed:
            return True
        namespace = self.view.name.rstrip("/")
        relative = topic.removeprefix(f"{namespace}/")
        if not topic.startswith(f"{namespace}/") or (self._topics and type_ in (PREDICTION, ALARM, _LOG)):
            return False
        return (
            type_ == PREDICTION
            or type_ in REPORTS
            or relative == "wind"
            or ("/" not in relative and type_ != _WIND)
        )

    def take(self) -> None:
        """Take what has come; a message that cannot be read is counted and shown."""
        self._take_reports()
        for take in (self._take_descriptions, self._take_predictions, self._take_motion, self._take_alarms):
            try:
                take()
            except LogError as error:
                self._refused += 1
                self._refusal = str(error)
        self._watch()

    def take_status(self, status: DiagnosticStatus) -> None:
        """Take a status of one of its nodes."""
        name = status.name.rpartition("/")[2]
        self._statuses[name] = status
        if name == "mavlink_bridge: link":
            self._tell("link", status.message)

    def _tell(self, name: str, words: str) -> None:
        self._told_s[name] = time.monotonic()
        self.view.take_told([Told(0, name, words)])

    def _take_reports(self) -> None:
        for type_, report in REPORTS.items():
            inbox = self._single(type_)
            for message in inbox.take()[-1:] if inbox is not None else ():
                self._tell(
                    report.name, report.words({field: getattr(message, field) for field in report.fields})
                )
        now_s = time.monotonic()
        self.view.take_told(
            [Told(0, name, NO_MESSAGE) for name, told_s in self._told_s.items() if now_s - told_s > TOLD_S]
        )

    def _take_descriptions(self) -> None:
        for inbox in self._descriptions.values():
            for message in inbox.take():
                description = unpack_description(message.data)
                self.view.learn(description.models)
                if description.vehicle is not None:
                    for identity in description.models:
                        self._known.setdefault(identity, description.vehicle)
                self._topics = {**self._topics, **description.topics}

    def _take_predictions(self) -> None:
        # The first one leads the time of the page.
        first = min(self._inboxes[PREDICTION], key=order, default="")
        for topic in sorted(self._inboxes[PREDICTION], key=order):
            payloads = self._inboxes[PREDICTION][topic].take()
            if not payloads or (topic != first and not self._predictions):
                continue
            self._predictions[topic] = self._predictions.get(topic, 0) + len(payloads)
            about = result_messages.unpack_model(payloads[-1])
            predictions = result_messages.unpack_predictions(Payloads.join(payloads))
            self.view.take_predictions(topic, predictions, *about)
            if topic == first:
                age_s = 1e-9 * (time.time_ns() - int(predictions.time_ns[-1]))
                self._age_ms = 1e3 * age_s if abs(age_s) < _SAME_CLOCK_S else None

    def _take_motion(self) -> None:
        states = self._unpacked(_ODOMETRY, sensor_messages.unpack_odometry)
        # Shown before rotor speeds are read, which may be refused.
        if states is not None:
            self.view.take_states(states)
        rotors = self._unpacked(_ROTORS, sensor_messages.unpack_rotor_speeds)
        vehicle = self._vehicle()
        if rotors is None and vehicle is not None:
            rotors = self._unpacked(_ERPM, lambda payloads: sensor_messages.unpack_erpm(payloads, vehicle))
        if rotors is not None:
            self.view.take_rotor_speeds(rotors)
        wind = self._unpacked(_WIND, sensor_messages.unpack_wind)
        if vehicle is not None:
            self._motion = self._motion or MotionInputs(vehicle)
            self.view.take_inputs(*self._motion.take(states, rotors, wind))

    def _take_alarms(self) -> None:
        alarms = self._unpacked(ALARM, result_messages.unpack_alarms)
        if alarms is not None:
            self.view.take_alarms(alarms)
        events = self._unpacked(_LOG, result_messages.unpack_events)
        if events is not None:
            self.view.take_events(events)

    def _unpacked(self, type_: str, unpack: Callable[[Payloads], Any]) -> Any:
        inbox = self._single(type_)
        return None if inbox is None else inbox.unpacked(unpack)

    def _single(self, type_: str) -> Inbox | None:
        return next(iter(self._inboxes.get(type_, {}).values()), None)

    def _vehicle(self) -> Vehicle | None:
        """That of the model that gives the alarm, where it is known here."""
        first = next(iter(self.view.models.values()), None)
        return None if first is None else self._known.get(first.identity)

    def _watch(self) -> None:
        """Say that nobody judges where no alarm message comes."""
        alarm = self._single(ALARM)
        silent_s = time.monotonic() - (self._since_s if alarm is None else alarm.arrived_s)
        if silent_s < SILENCE_S:
            return
        if alarm is None:
            reason = f"nobody publishes extrapolation_alarm in {self.view.name}"
        elif self._node.count_publishers(alarm.topic) == 0:
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
        first = min(self._inboxes[PREDICTION], key=order, default=None)
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
        if self._motion is not None and self._motion.problem:
            rows.append(("inputs", "warn", f"not shown: {self._motion.problem}"))
        if self._refused:
            rows.append(("messages", "warn", f"{self._refused} messages refused, the last: {self._refusal}"))
        for name, status in sorted(self._statuses.items()):
            values = {one.key: one.value for one in status.values if one.key in _SHOWN}
            text = ", ".join([status.message, *(f"{key} {value}" for key, value in values.items())])
            rows.append((name, _LEVELS.get(status.level, "error"), text))
        self.view.health = rows

    def _missing(self) -> list[tuple[str, str, str]]:
        """Rows of the table of health for what is not shown, as nothing says it."""
        rows = []
        reason = "of other messages, which the monitor alone reads" if self._predictions else "nothing comes"
        inbox = self._single(_ODOMETRY)
        if inbox is None or not inbox.count:
            rows.append(("odometry", "warn", f"{reason}: flight, speed and height are not shown"))
        inboxes = [one for one in (self._single(_ROTORS), self._single(_ERPM)) if one is not None]
        if not any(one.count for one in inboxes):
            if self._single(_ERPM) is not None and self._vehicle() is None:
                reason = "erpm needs the pole pairs of the vehicle: quadpi view --model MODEL"
            rows.append(("rotor speeds", "warn", f"{reason}: they are not shown"))
        return rows


def warm_up() -> None:
    """Load decoders: the first messages of a flight are not to wait for them."""
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


# The graph is looked at this often for vehicles and topics that have come.
_DISCOVER_S = 0.5
# Nodes whose statuses are shown.
_TOLD_OF = {"monitor", "estimator", "mavlink_bridge"}


class LiveSource:
    """Every vehicle of the domain, as a source of the page.

    Args:
        context: initialised.
        known: models with their vehicles, whose training ranges are shown where they fly.
    """

    live = True

    def __init__(self, context: Context, known: Mapping[str, tuple[AerodynamicModel, Vehicle]]) -> None:
        self.title = f"live, ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}"
        self._context = context
        self._node = Node("quadpi_view", context=context, start_parameter_services=False, enable_rosout=False)
        self._known = known
        self._vehicles: dict[str, LiveVehicle] = {}
        self._diagnostics = Inbox(self._node, DiagnosticArray, "/diagnostics", raw=False)
        self._discovered_s = 0.0

    @property
    def vehicles(self) -> Mapping[str, VehicleView]:
        """By namespace."""
        return {name: vehicle.view for name, vehicle in self._vehicles.items()}

    @property
    def ended(self) -> bool:
        """Whether ROS has been shut down, as on Ctrl-C."""
        return not self._context.ok()

    def poll(self) -> None:
        """Take what has come on all topics."""
        if self.ended:
            return
        now_s = time.monotonic()
        if now_s - self._discovered_s >= _DISCOVER_S:
            self._discovered_s = now_s
            self._discover()
            for array in self._diagnostics.take():
                self._take_diagnostics(array)
            for vehicle in self._vehicles.values():
                vehicle.report()
        for vehicle in self._vehicles.values():
            vehicle.take()

    def close(self) -> None:
        """Leave the domain."""
        if self._context.ok():
            self._node.destroy_node()

    def _discover(self) -> None:
        types_by_topic = dict(self._node.get_topic_names_and_types())
        claims = {topic: vehicle for vehicle in self._vehicles.values() for topic in vehicle.claimed}
        for topic, types in types_by_topic.items():
            if topic in claims:
                continue
            if ALARM in types or (PREDICTION in types and self._owner(topic) is None):
                self._add(topic.rpartition("/")[0] or "/")
            elif DESCRIPTION in types and topic.endswith(f"/monitor/{DESCRIPTION_NAME}"):
                self._add(topic.rsplit("/", 2)[0] or "/")
        # What was taken for a vehicle before the monitor said that these topics are its own.
        for name, vehicle in list(self._vehicles.items()):
            if vehicle.heard and all(claims.get(topic, vehicle) is not vehicle for topic in vehicle.heard):
                vehicle.close()
                del self._vehicles[name]
        for vehicle in self._vehicles.values():
            vehicle.listen(
                {
                    topic: types
                    for topic, types in types_by_topic.items()
                    if claims.get(topic, self._owner(topic)) is vehicle
                }
            )

    def _add(self, namespace: str) -> None:
        if namespace not in self._vehicles:
            self._vehicles[namespace] = LiveVehicle(self._node, namespace, self._known)

    def _owner(self, topic: str) -> LiveVehicle | None:
        """The vehicle whose namespace is the innermost around a topic."""
        namespace = topic
        while namespace:
            namespace = namespace.rpartition("/")[0]
            if (vehicle := self._vehicles.get(namespace or "/")) is not None:
                return vehicle
        return None

    def _take_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            node = "/" + status.name.partition(":")[0]
            vehicle = self._vehicles.get(node.rpartition("/")[0] or "/")
            if vehicle is not None and node.rpartition("/")[2] in _TOLD_OF:
                vehicle.take_status(status)


def view_live(
    models: Sequence[AerodynamicModel],
    vehicle: str | None,
    port: int,
    address: str,
    on_start: Callable[[str], None],
    context: Context | None = None,
) -> None:
    """Serve the page of the live nodes of this ROS domain until interrupted.

    Args:
        models: whose training ranges are shown where they fly.
        vehicle: of all of them; each one's own unless given.
        port: see :class:`quadpi_core.view.view_server.ViewServer`.
        address: see there.
        on_start: called with the address of the page.
        context: of ROS; one is made unless given.

    Raises:
        QuadpiError: for a model of another vehicle, or a port in use.
    """
    known = {model.identity: (model, model.load_vehicle(vehicle)) for model in models}
    is_new = context is None
    the_context = Context() if context is None else context
    if is_new:
        the_context.init(args=[])
    try:
        warm_up()
        source = LiveSource(the_context, known)
        serve_page(source, port, address, on_start, until=lambda: source.ended)
    finally:
        if is_new:
            the_context.try_shutdown()


def main() -> int:
    """Run the page in a process of its own, as launch files do."""
    return run(lambda: _serve(remove_ros_args(sys.argv)[1:]))


def _serve(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(prog="view", description="The page of the live nodes.")
    parser.add_argument("--model", action="append", default=[], help="model folder; may be repeated")
    parser.add_argument("--vehicle", help="vehicle of the models")
    parser.add_argument("--port", type=int, default=PORT, help="port of the page; 0 takes any")
    parser.add_argument("--bind", default=ADDRESS, help="address to listen on")
    parser.add_argument("--open", action=argparse.BooleanOptionalAction, help="open the page")
    options = parser.parse_args(arguments)
    models = [AerodynamicModel.load(Path(folder)) for folder in options.model]

    def say(url: str) -> None:
        announce(partial(print, flush=True), url, options.open)

    view_live(models, options.vehicle, options.port, options.bind, say, rclpy.get_default_context())


if __name__ == "__main__":
    raise SystemExit(main())
