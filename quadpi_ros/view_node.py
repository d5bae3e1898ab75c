# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live page: a node that listens to the results of every vehicle of the domain, and publishes nothing.

Messages are taken in batches at the ticks of the server, not one by one by an executor: at 500 Hz that costs
a fraction. Subscriptions are best effort, so that no publisher ever waits for the page.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import AlarmEvent, Erpm, ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from rclpy.context import Context
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from quadpi_core.errors import LogError
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.payloads import Payloads
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.browser import announce
from quadpi_core.view.live_inputs import LiveInputs
from quadpi_core.view.trust import SILENCE_S
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView
from quadpi_core.view.view_server import ADDRESS, PORT, serve_page
from quadpi_ros.dds_profile import LOG_QOS
from quadpi_ros.diagnostics import type_name
from quadpi_ros.inbox import TAKEN_QOS, Inbox
from quadpi_ros.runtime import run

# What is held at full resolution: a quarter of an hour, 15 MB with three models.
_BLOCKS = 18_000
# The graph is looked at this often for vehicles and topics that have come.
_DISCOVER_S = 0.5
# Stamps further from this computer's clock than this are of another clock.
_SAME_CLOCK_S = 5.0
_PREDICTION, _ALARM = type_name(WrenchPrediction), type_name(ExtrapolationAlarm)
_LEVELS = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warn"}
# Values of a status that the page shows beside its message.
_SHOWN = ("latency_p50_ms", "latency_p99_ms", "dropped", "rate_hz")

_Content = TypeVar("_Content")


@dataclass
class Topics:
    """The topics of one vehicle that have been found, by what they hold."""

    predictions: dict[str, Inbox] = field(default_factory=dict)
    others: dict[str, Inbox] = field(default_factory=dict)


class LiveVehicle:
    """One vehicle: what its topics say goes into its view.

    Args:
        node: subscribes.
        namespace: of the vehicle, such as `/` or `/uav1`.
        known: models with their vehicles, by identity.
    """

    def __init__(
        self, node: Node, namespace: str, known: Mapping[str, tuple[AerodynamicModel, Vehicle]]
    ) -> None:
        models = {identity: model for identity, (model, _) in known.items()}
        self.view = VehicleView(namespace, models, BLOCK_NS, _BLOCKS)
        self._node = node
        self._known = known
        self._topics = Topics()
        self._inputs: tuple[str, LiveInputs] | None = None
        self._refused = 0
        self._refusal = ""
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._since_s = time.monotonic()
        self._counted: tuple[float, int] = (self._since_s, 0)
        self._newest_ns = 0
        self._age_ms: float | None = None

    def listen(self, found: Mapping[str, Sequence[str]]) -> None:
        """Subscribe to those of the topics of its namespace, with their types, that are not heard yet."""
        namespace = self.view.name.rstrip("/")
        # `prediction` comes before `prediction/NAME`: the first model is the one that gives the alarm.
        for topic in sorted(found, key=lambda name: (name.count("/"), name)):
            below = topic.startswith(f"{namespace}/")
            relative = topic[len(namespace) + 1 :]
            if below and _PREDICTION in found[topic] and topic not in self._topics.predictions:
                self._topics.predictions[topic] = Inbox(self._node, WrenchPrediction, topic)
            if not below or "/" in relative:
                continue
            for message_type, qos in (
                (ExtrapolationAlarm, TAKEN_QOS),
                (AlarmEvent, LOG_QOS),
                (Odometry, TAKEN_QOS),
                (RotorSpeeds, TAKEN_QOS),
                (Erpm, TAKEN_QOS),
                (Vector3Stamped, TAKEN_QOS),
            ):
                known = message_type.__name__ in self._topics.others
                named = message_type is not Vector3Stamped or relative == "wind"
                if type_name(message_type) in found[topic] and named and not known:
                    self._topics.others[message_type.__name__] = Inbox(self._node, message_type, topic, qos)

    def take(self) -> None:
        """Take what has come; a message that cannot be read is counted and shown."""
        for take in (self._take_predictions, self._take_motion, self._take_alarms):
            try:
                take()
            except LogError as error:
                self._refused += 1
                self._refusal = str(error)
        self._watch()

    def take_status(self, status: DiagnosticStatus) -> None:
        """Take a status of one of its nodes."""
        self._statuses[status.name.rpartition("/")[2]] = status

    def _take_predictions(self) -> None:
        for place, (topic, inbox) in enumerate(self._topics.predictions.items()):
            payloads = inbox.take()
            # The first one leads the time of the page.
            if not payloads or (place and next(iter(self._topics.predictions)) not in self.view.models):
                continue
            about = result_messages.unpack_model(payloads[-1])
            predictions = result_messages.unpack_predictions(Payloads.join(payloads))
            self.view.take_predictions(topic, predictions, *about)
            if place == 0:
                self._newest_ns = int(predictions.time_ns[-1])
                age_s = 1e-9 * (time.time_ns() - self._newest_ns)
                self._age_ms = 1e3 * age_s if abs(age_s) < _SAME_CLOCK_S else None

    def _take_motion(self) -> None:
        states = self._unpacked(Odometry, sensor_messages.unpack_odometry)
        if states is not None:
            self.view.take_states(states)
        rotors = self._unpacked(RotorSpeeds, sensor_messages.unpack_rotor_speeds)
        follower = self._follower()
        model = self.view.model
        if rotors is None and model is not None:
            vehicle = self._known[model.identity][1]
            rotors = self._unpacked(Erpm, lambda payloads: sensor_messages.unpack_erpm(payloads, vehicle))
        wind = self._unpacked(Vector3Stamped, sensor_messages.unpack_wind)
        if rotors is not None:
            self.view.take_rotor_speeds(rotors)
        if follower is not None:
            if wind is not None:
                follower.wind = wind.velocity[-1]
            self.view.take_inputs(*follower.take(states, rotors))

    def _take_alarms(self) -> None:
        events = self._unpacked(AlarmEvent, result_messages.unpack_events)
        if events is not None:
            self.view.take_events(events)
        alarms = self._unpacked(ExtrapolationAlarm, result_messages.unpack_alarms)
        if alarms is not None:
            self.view.take_alarms(alarms)

    def _unpacked(self, message_type: type, unpack: Callable[[Payloads], _Content]) -> _Content | None:
        inbox = self._topics.others.get(message_type.__name__)
        return None if inbox is None else inbox.unpacked(unpack)

    def _follower(self) -> LiveInputs | None:
        """Of the inputs of the model that flies; anew where another one takes its place."""
        model = self.view.model
        if model is None:
            return None
        if self._inputs is None or self._inputs[0] != model.identity:
            self._inputs = model.identity, LiveInputs(self._known[model.identity][1], model.cutoff_hz)
        return self._inputs[1]

    def _watch(self) -> None:
        """Say that nobody judges where no alarm message comes."""
        alarm = self._topics.others.get(ExtrapolationAlarm.__name__)
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
        first = next(iter(self._topics.predictions.values()), None)
        if first is None:
            rows.append(("prediction", "error", f"nobody publishes prediction in {self.view.name}"))
        else:
            (before_s, before), self._counted = self._counted, (now_s, first.count)
            rate_hz = (first.count - before) / max(1e-3, now_s - before_s)
            age = f", newest sample {self._age_ms:.0f} ms old" if self._age_ms is not None else ""
            rows.append(
                (first.topic, "ok" if rate_hz else "error", f"{rate_hz:.0f} Hz{age if rate_hz else ''}")
            )
        alarm = self._topics.others.get(ExtrapolationAlarm.__name__)
        for inbox in filter(None, (first, alarm)):
            count = inbox.publishers(self._node)
            if count > 1:
                rows.append((inbox.topic, "error", f"{count} monitors publish here: their results are mixed"))
        flying, model = next(iter(self.view.models.values()), None), self.view.model
        if flying is not None and model is None and self._known:
            names = ", ".join(self._known)
            rows.append(("model", "warn", f"{flying.identity} flies; training ranges are known of {names}"))
        if self._refused:
            rows.append(("messages", "warn", f"{self._refused} batches refused, the last: {self._refusal}"))
        for name, status in sorted(self._statuses.items()):
            values = {one.key: one.value for one in status.values if one.key in _SHOWN}
            text = ", ".join([status.message, *(f"{key} {value}" for key, value in values.items())])
            rows.append((name, _LEVELS.get(status.level, "error"), text))
        self.view.health.rows = rows


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
        found = dict(self._node.get_topic_names_and_types())
        for topic, types in found.items():
            if _ALARM in types or (_PREDICTION in types and self._owner(topic) is None):
                self._add(topic.rpartition("/")[0] or "/")
        for vehicle in self._vehicles.values():
            vehicle.listen({topic: types for topic, types in found.items() if self._owner(topic) is vehicle})

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
            if vehicle is not None and node.rpartition("/")[2] in {"monitor", "estimator"}:
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
    own = context is None
    the_context = Context() if context is None else context
    if own:
        the_context.init(args=[])
    try:
        source = LiveSource(the_context, known)
        serve_page(source, port, address, on_start, until=lambda: source.ended)
    finally:
        if own:
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
        announce(_say, url, options.open)

    view_live(models, options.vehicle, options.port, options.bind, say, rclpy.get_default_context())


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
