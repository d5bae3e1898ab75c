# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag with messages that other packages define."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat

from quadpi_core.errors import LogError, SampleError, VehicleError
from quadpi_core.flight import Stream
from quadpi_core.logs.bag_files import Bag
from quadpi_core.messages.adapters.adapter_definition import Adapter
from quadpi_core.messages.adapters.adapter_registry import known_adapters
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings
from quadpi_core.messages.payloads import Topic
from quadpi_core.vehicle import Vehicle

_log = logging.getLogger(__name__)


class AdaptedTopic(NamedTuple):
    """A topic of a bag, and how it is read."""

    adapter: Adapter
    connection: Connection

    @property
    def name(self) -> str:
        """Of the topic."""
        return self.connection.topic


def find_adapted(
    bag: Bag, settings: AdapterSettings | None, present: Collection[str]
) -> dict[str, AdaptedTopic]:
    """Topics that the settings configure, by kind of stream; a topic is recognised by its type.

    Logs a warning for topics that could be read if they were configured.

    Args:
        bag: open.
        settings: None where the user gave none.
        present: kinds for which the bag has a standard topic.

    Raises:
        LogError: naming bag and topic, for a kind that no topic or several topics give.
    """
    found = {}
    for kind in ("imu", "rotor_speeds", "mocap", "odometry"):
        candidates = _candidates(bag, kind)
        own = getattr(settings, kind) if settings else None
        if own is not None:
            chosen = [topic for topic in candidates if own.topic in {None, topic.name}]
            found[kind] = _only(bag, kind, chosen, own.topic)
        elif kind not in present:
            for topic in candidates:
                _log.warning(
                    "%s: topic %s: %s is not read: --mapping must say how, with the key `%s`",
                    *(bag.path, topic.name, topic.adapter.type_name, kind),
                )
    return found


def _candidates(bag: Bag, kind: str) -> list[AdaptedTopic]:
    adapters = {adapter.type_name: adapter for adapter in known_adapters().values() if adapter.kind == kind}
    topics = {
        connection.topic: AdaptedTopic(adapters[connection.msgtype], connection)
        for connection in bag.connections
        if connection.msgcount and connection.msgtype in adapters
    }
    return [topics[name] for name in sorted(topics)]


def _only(bag: Bag, kind: str, chosen: list[AdaptedTopic], asked: str | None) -> AdaptedTopic:
    if len(chosen) > 1:
        names = ", ".join(topic.name for topic in chosen)
        raise LogError(f"{bag.path}: `{kind}` could be any of {names}: the mapping must name its `topic`")
    if not chosen:
        types = ", ".join(adapter.type_name for adapter in known_adapters().values() if adapter.kind == kind)
        raise LogError(f"{bag.path}: {f'topic {asked}' if asked else f'`{kind}`'}: no messages of {types}")
    return chosen[0]


class AdaptedReading:
    """Unpacks the messages of a topic in parts, and counts the samples.

    Raises:
        LogError: naming bag and topic, if the bag holds no definition that can be used.
    """

    def __init__(
        self, bag: Path, topic: AdaptedTopic, settings: AdapterSettings, vehicle: Vehicle | None
    ) -> None:
        self.name = topic.name
        self._where = f"{bag}: topic {topic.name}"
        self._samples = 0
        definition, type_name = topic.connection.msgdef, topic.adapter.type_name
        if definition.format != MessageDefinitionFormat.MSG or not definition.data:
            raise LogError(
                f"{self._where}: the bag does not hold the definition of {type_name} as a .msg; "
                "`ros2 bag convert` to MCAP adds it, where the package is installed"
            )
        try:
            self._unpacker = topic.adapter.open(definition.data, settings, vehicle)
        except (LogError, VehicleError) as error:
            raise LogError(f"{self._where}: {error}") from error

    def unpack(self, topic: Topic, before: int) -> Stream | None:
        """The samples in messages; None without messages.

        Args:
            topic: its next messages.
            before: number of messages before them.

        Raises:
            LogError: naming bag, topic and sample, for messages that cannot be read.
        """
        if len(topic.payloads) == 0:
            return None
        try:
            stream = self._unpacker.unpack(topic.payloads)
        except SampleError as error:
            raise LogError(f"{self._where}: {error.after(before)}") from error
        except (LogError, VehicleError) as error:
            raise LogError(f"{self._where}: {error}") from error
        self._samples += len(stream)
        return stream

    def finish(self, count: int) -> None:
        """Log how many of all `count` messages were dropped, by reason.

        Raises:
            LogError: if all were dropped.
        """
        dropped = "; ".join(f"{number}: {reason}" for reason, number in self._unpacker.dropped.most_common())
        if self._samples == 0:
            raise LogError(f"{self._where}: none of {count} messages gives a sample ({dropped})")
        if dropped:
            _log.warning("%s: dropped messages of %d: %s", self._where, count, dropped)
