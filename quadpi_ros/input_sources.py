# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the nodes: standard topics, or messages of other packages read by `messages.adapters`.

The layout of a message of another package is taken from the installed package, so that its version does not
matter.
"""

from __future__ import annotations

import importlib
import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import (
    MAX_JUMP_BACK_NS,
    NO_STAMP,
    BatteryStream,
    MotorCommandStream,
    RotorSpeedStream,
    Stream,
)
from quadpi_core.frames import Array
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import CommandSettings, StateSettings
from quadpi_core.messages.payloads import Payloads
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.health import SILENT_S, TachometerWatch
from quadpi_core.rotor_order import CommandedSpeeds
from quadpi_core.vehicle import Motors, Vehicle
from quadpi_ros.parameters import ParameterError, adapters_of

_PRIMITIVES = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
# `sequence<T>` or `sequence<T, 4>`, `T[4]`, or `T`, where T may be `package/Type` or `string<9>`.
_FIELD = re.compile(
    r"(?:sequence<(?P<item>[^,>]+(?:<\d+>)?)(?:, *\d+)?>|(?P<plain>[^\[]+)(?P<array>\[\d+\])?)$"
)
_RULE = f"{'=' * 80}\n"


class Source(NamedTuple):
    """A topic and how its messages become streams of one sample: the first arguments of `listen`."""

    message_type: type
    topic: str
    unpack: Callable[[bytes], Any]


class AdaptedSources:
    """Inputs in messages of other packages, configured by an adapter file.

    Args:
        node: name of the node, for errors.
        file: parameter `adapters`: a name in config/adapters or a path; empty for none.
        vehicle: of the flight.

    Raises:
        LogError: for an invalid file, and one that chooses topics of bags.
    """

    def __init__(self, node: str, file: str, vehicle: Vehicle) -> None:
        self._node = node
        self._file = file
        self._vehicle = vehicle
        self._settings = AdapterSettings.load(file) if file else AdapterSettings()
        if self._settings.topics or self._settings.namespace:
            raise LogError(
                f"{file}: `topics` and `namespace` are of bags: a node's topics have launch arguments "
                "(imu_topic:=) and remappings"
            )

    def named(self, name: str) -> Source:
        """The input that an adapter reads, by the adapter's name.

        Raises:
            ParameterError: without an adapter file.
            AdapterError: if the package of the message is not installed, or the file lacks the settings.
        """
        if not self._file:
            raise ParameterError(
                f"node {self._node}: parameter `adapters` is required for `{name}`: "
                "the file that says how its messages are read"
            )
        try:
            return adapted_source(name, self._settings, self._vehicle)
        except AdapterError:
            raise
        except QuadpiError as error:
            raise AdapterError(f"{self._file}: {error}") from error

    def self_described(self, name: str, topic: str = "") -> Source:
        """The input of an adapter that needs no settings, but takes those of the file.

        Args:
            name: of the adapter.
            topic: that it is on unless the file names it; that of its package unless given.

        Raises:
            AdapterError: see :meth:`named`.
        """
        adapter = known_adapters()[name]
        settings = getattr(self._settings, adapter.kind)
        if settings is None:
            settings = CommandSettings() if adapter.kind == "motor_commands" else StateSettings()
        if settings.topic is None and topic:
            settings = replace(settings, topic=topic)
        return adapted_source(name, replace(self._settings, **{adapter.kind: settings}), self._vehicle)

    def instead_of(self, standard: Source, kind: str) -> Source:
        """The input of the adapter of a kind if the file has settings for it, else the standard topic.

        Raises:
            AdapterError: see :meth:`named`; if the messages of several adapters are installed, or of none and
                the file names a topic, which may be of the standard type.
        """
        settings = getattr(self._settings, kind)
        if settings is None:
            return standard
        # A state that lacks its attitude is asked for by name.
        names = [name for name in adapters_of(kind) if not known_adapters()[name].without_attitude]
        installed = [name for name in names if _is_installed(name)]
        if settings.topic is not None and not installed:
            argument = f"{standard.topic.replace('/', '_')}_topic:={settings.topic}"
            raise AdapterError(
                f"{self._file}: `{kind}`: topic {settings.topic}: no package with messages for it is "
                f"installed; if it is of {standard.message_type.__name__}, leave `{kind}` "
                f"out of the file and give the launch argument {argument}, or remap {standard.topic}"
            )
        installed = installed or names[:1]
        if len(installed) > 1:
            raise AdapterError(f"{self._file}: `{kind}` could be any of {', '.join(installed)}")
        return self.named(installed[0])


class AdapterError(QuadpiError):
    """A message of another package cannot be read here."""


def adapted_source(name: str, settings: AdapterSettings, vehicle: Vehicle | None) -> Source:
    """An input in messages of another package, on the topic of the settings, else that of the package.

    Its function raises LogError for a malformed message, or with the reason why it holds no sample.

    Args:
        name: name of an adapter.
        settings: with those of the adapter's kind.
        vehicle: of the flight.

    Raises:
        AdapterError: if the package of the message is not installed.
        LogError: for missing settings, or an unsupported version of the package.
    """
    adapter = known_adapters()[name]
    message_type = message_class(adapter.type_name)
    unpacker = adapter.open(definition_of(message_type), settings, vehicle)

    def unpack(payload: bytes) -> Stream:
        before = Counter(unpacker.dropped)
        stream = unpacker.unpack(payload)
        if len(stream) == 0:
            raise LogError(", ".join(unpacker.dropped - before))
        return stream

    return Source(message_type, getattr(settings, adapter.kind).topic or adapter.topic, unpack)


def message_class(type_name: str) -> Any:
    """The Python class of a message type such as `px4_msgs/msg/EscStatus`.

    Raises:
        AdapterError: if its package is not installed, or does not have it.
    """
    package, _, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise AdapterError(
            f"{type_name}: the package {package} that defines it is not installed here"
        ) from None


def _is_installed(name: str) -> bool:
    try:
        message_class(known_adapters()[name].type_name)
    except AdapterError:
        return False
    return True


def definition_of(message_type: Any) -> str:
    """Definition of an installed message and of the messages in it, in the `ros2msg` format of bags."""
    contained: dict[str, Any] = {}
    text = _fields_of(message_type, contained)
    sections, done = [text], set[str]()
    while names := contained.keys() - done:
        for name in sorted(names):
            done.add(name)
            sections.append(f"MSG: {name}\n{_fields_of(contained[name], contained)}")
    return _RULE.join(sections)


def _fields_of(message_type: Any, contained: dict[str, Any]) -> str:
    """One line per field; adds the classes of nested messages to `contained`."""
    lines = []
    for name, kind in message_type.get_fields_and_field_types().items():
        match = _FIELD.match(kind)
        if match is None:
            raise AdapterError(f"{message_type.__name__}: field {name} is of the unknown kind {kind}")
        item = match["item"] or match["plain"]
        array = "[]" if match["item"] else match["array"] or ""
        if "/" in item:
            package, stem = item.split("/")
            contained[item] = message_class(f"{package}/msg/{stem}")
        bare = item.partition("<")[0]
        lines.append(f"{_PRIMITIVES.get(bare, bare)}{array} {name}\n")
    return "".join(lines)


# Waking an executor for every message costs more than taking it.

# Half a second at 500 Hz: what may come while the process does something else. Best effort, so that no
# publisher ever waits for whoever takes in batches.
TAKEN_QOS = QoSProfile(depth=250, reliability=ReliabilityPolicy.BEST_EFFORT)
# For those who need the newest message alone.
NEWEST_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

_Content = TypeVar("_Content")


class Inbox:
    """Messages of one topic, taken when they are asked for.

    Attributes:
        topic: its name.
        count: messages so far.
        arrived_s: when the last one was taken, on the monotonic clock.
    """

    def __init__(
        self, node: Node, message_type: type, topic: str, qos: QoSProfile = TAKEN_QOS, raw: bool = True
    ) -> None:
        self.topic = topic
        self.count = 0
        self.arrived_s = time.monotonic()
        self._type, self._raw = message_type, raw
        self._subscription: Subscription = node.create_subscription(message_type, topic, _never, qos, raw=raw)

    def take(self) -> list[Any]:
        """All that have come since the last call."""
        taken = []
        handle = self._subscription.handle
        with handle:
            while (message := handle.take_message(self._type, self._raw)) is not None:
                taken.append(message[0])
        if taken:
            self.count += len(taken)
            self.arrived_s = time.monotonic()
        return taken

    def unpacked(self, unpack: Callable[[Payloads], _Content]) -> _Content | None:
        """What has come as arrays; None where nothing has.

        Raises:
            SampleError: for bytes that are no such message.
        """
        payloads = self.take()
        return unpack(Payloads.join(payloads)) if payloads else None

    def close(self, node: Node) -> None:
        """Leave the topic."""
        node.destroy_subscription(self._subscription)


def _never(_: object) -> None:
    """Callback of a subscription that no executor serves."""


# Rotor speeds that are measured again must come for this long before they are used again.
_BACK_S = 1.0


class CommandedRotors:
    """Takes commands, battery and measured speeds, and says which speeds count.

    Args:
        motors: of the model that was identified on commands.
        fallback: the monitor that judges while rotor speeds are made of commands; None where the first one
            does, and always.

    Attributes:
        motors: as given.
        fallback: as given.
        counts: whether speeds by the commands are used now.
        watch: of the tachometers.
    """

    def __init__(self, motors: Motors, fallback: Monitor | None = None) -> None:
        self.fallback = fallback
        self.counts = fallback is None
        self.motors = motors
        self.restart()

    def restart(self) -> None:
        """Forget the past."""
        self._speeds = CommandedSpeeds(self.motors)
        self._newest: Array | None = None
        self._newest_ns = NO_STAMP
        self._follow(NO_STAMP)
        self.watch = TachometerWatch()

    def _follow(self, time_ns: int) -> None:
        """Begin to count time anew where the clock fell."""
        if time_ns == NO_STAMP or time_ns <= self._newest_ns - MAX_JUMP_BACK_NS:
            self._newest_ns = NO_STAMP
            self._measured_ns: int | None = None
            self._back_ns: int | None = None
            self._began_ns: int | None = None
        self._newest_ns = max(self._newest_ns, time_ns)

    def take_commands(self, commands: MotorCommandStream) -> RotorSpeedStream:
        """Speeds by a command."""
        speeds = self._speeds.take(commands)
        self._newest = speeds.speeds[-1]
        time_ns = int(commands.time_ns[0])
        self._follow(time_ns)
        if self._began_ns is None:
            self._began_ns = time_ns
        if self.fallback is not None and not self.counts:
            last_ns = self._began_ns if self._measured_ns is None else self._measured_ns
            self.counts = time_ns - last_ns > 1e9 * SILENT_S
        return speeds

    def take_battery(self, battery: BatteryStream) -> None:
        """Take a voltage."""
        self._speeds.hear(battery)

    def take_measured(self, rotor_speeds: RotorSpeedStream) -> bool:
        """Take measured speeds; whether they count."""
        time_ns = int(rotor_speeds.time_ns[0])
        self._follow(time_ns)
        if self._newest is not None:
            self.watch.take(time_ns, rotor_speeds.speeds[0], self._newest)
        if self.fallback is not None and self.counts:
            paused = self._measured_ns is None or time_ns - self._measured_ns > 1e9 * SILENT_S
            if paused or self._back_ns is None:
                self._back_ns = time_ns
            self.counts = time_ns - self._back_ns < 1e9 * _BACK_S
        self._measured_ns = time_ns
        return not self.counts


def command_sources(adapted: AdaptedSources, motors: Motors, topic: str) -> tuple[Source, Source]:
    """The topics of commands and battery that the motors were identified with.

    Args:
        adapted: of the node.
        motors: of a model.
        topic: adapter of the commands as the parameter says; empty for that of the motors.

    Raises:
        LogError: for commands that no message is known to hold.
        AdapterError: if the package of a message is not installed.
    """
    adapter = known_adapters().get(topic or motors.source)
    if adapter is None:
        raise LogError(
            f"the model was identified on commands of {motors.source}, which no message holds: the parameter "
            "command_topic names the adapter whose commands have the same scale"
        )
    battery, default = adapter.battery or ("battery_state", "battery")
    return adapted.self_described(adapter.name), adapted.self_described(battery, default)
