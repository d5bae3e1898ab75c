# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the nodes: standard topics, or messages of other packages read by `messages.adapters`.

The layout of a message of another package is taken from the installed package, so that its version does not
matter.
"""

from __future__ import annotations

import importlib
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import Stream
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import CommandSettings, StateSettings
from quadpi_core.vehicle import Vehicle
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
        names = adapters_of(kind)
        installed = [name for name in names if _is_installed(name)]
        if settings.topic is not None and not installed:
            argument = f"{standard.topic.replace('/', '_')}_topic:={settings.topic}"
            raise AdapterError(
                f"{self._file}: `{kind}`: topic {settings.topic}: no package with messages for it is "
                f"installed; if it is of {standard.message_type.__name__}, leave `{kind}` "
                f"out of the file and give the launch argument {argument}, or remap {standard.topic}"
            )
        installed = installed or list(names[:1])
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
