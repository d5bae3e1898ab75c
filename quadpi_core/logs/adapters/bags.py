# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag whose messages other packages define."""

from __future__ import annotations

import logging
from collections.abc import Collection
from typing import NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import Stream
from quadpi_core.logs.adapters.registry import ADAPTERS, Adapter
from quadpi_core.logs.adapters.settings import AdapterSettings
from quadpi_core.logs.mcap import Bag, Topic
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
    """The topics that the settings ask for, by kind of stream; topics are known by their type.

    Logs topics that could be read if the settings said how.

    Args:
        bag: open.
        settings: None where the user gave none.
        present: kinds of which the bag holds the standard topic.

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
    adapters = {adapter.type_name: adapter for adapter in ADAPTERS.values() if adapter.kind == kind}
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
        types = ", ".join(adapter.type_name for adapter in ADAPTERS.values() if adapter.kind == kind)
        raise LogError(f"{bag.path}: {f'topic {asked}' if asked else f'`{kind}`'}: no messages of {types}")
    return chosen[0]


def unpack_adapted(
    bag: Bag, adapted: AdaptedTopic, topic: Topic, settings: AdapterSettings, vehicle: Vehicle | None
) -> Stream:
    """The samples of a topic; logs how many messages gave none, and why.

    Raises:
        LogError: naming bag, topic and sample, for messages that cannot be read, or if none gives a sample.
    """
    where = f"{bag.path}: topic {topic.name}"
    definition = adapted.connection.msgdef
    if definition.format != MessageDefinitionFormat.MSG or not definition.data:
        raise LogError(
            f"{where}: the bag does not hold the definition of {topic.type_name} as a .msg; "
            "`ros2 bag convert` to MCAP adds it, where the package is installed"
        )
    try:
        unpacker = adapted.adapter.open(definition.data, settings, vehicle)
        stream = unpacker.unpack(topic.payloads)
    except (LogError, VehicleError) as error:
        raise LogError(f"{where}: {error}") from error
    dropped = "; ".join(f"{count}: {reason}" for reason, count in unpacker.dropped.most_common())
    if len(stream) == 0:
        raise LogError(f"{where}: none of {len(topic.payloads)} messages gives a sample ({dropped})")
    if dropped:
        _log.warning("%s: dropped messages of %d: %s", where, len(topic.payloads), dropped)
    return stream
