# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag are the sensors': those that are named, else by their standard names, else by type.

A standard name in a namespace does not count before a type in another: that may be of another vehicle.

By type, an IMU, rotor speeds and motion capture are found, and a fused state where there is no motion
capture. Topics in one place (`/mavros/imu/data`, `/mavros/imu/data_raw`) are one sensor: the fastest is read,
of equally fast ones `data`, which is calibrated where `data_raw` may not be. Topics in different places may
belong to different vehicles: the user has to choose. Velocities and wind are not looked for by type: what has
that type may be a command or another vector.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import (
    BESIDE_INPUTS,
    MOTOR_INPUTS,
    AdaptedReading,
    AdaptedTopic,
    adapter_of,
    find_adapted,
    is_named,
    is_truth,
    require_type,
    topic_stamps,
    unnamed,
    unread,
)
from quadpi_core.logs.mcap_files import Connection
from quadpi_core.messages.adapters.adapter_registry import known_adapters
from quadpi_core.messages.adapters.adapter_settings import (
    FLU_ENU,
    AdapterSettings,
    BodySettings,
    CommandSettings,
    StateSettings,
)
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TOPIC, TF_TYPE, plain_name
from quadpi_core.messages.topics import SENSOR_KINDS, TOPIC_TYPES
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

AS_FAST = Threshold(
    "as fast",
    0.8,
    "of the most messages of a topic",
    "topics of one sensor that only lost messages are equally fast; the next slower rate is half",
    CONVENTION,
)
# What is read of a kind by its type alone, in the order in which it counts.
_BY_TYPE = {
    "imu": ("imu",),
    "rotor_speeds": ("rotor_speeds", "erpm"),
    "mocap": ("mocap/pose", "mocap/transform"),
    "odometry": ("odometry",),
}
_PREFERRED = ("data", "data_raw")
# A pose is no motion capture if its name says that it is wished for, or that an autopilot estimates it.
_NO_MOCAP = re.compile(
    r"setpoint|goal|target|reference|desired|command|cmd|local_position|global_position|vision_pose"
)
# What names and types of topics say that may hold what is lacking, in messages that are not understood.
_COULD_BE = {
    "imu": re.compile(r"imu|gyro|accel"),
    "rotor_speeds": re.compile(r"esc|rotor|motor|actuator|joint|rpm|logdata"),
    "mocap": re.compile(r"pose|transform|odom|mocap|rigid|vicon|vrpn"),
    "odometry": re.compile(r"(?!)"),
}


class BagInputs(NamedTuple):
    """The sensors of a bag.

    Attributes:
        names: topics of the bag by standard names.
        adapted: topics with messages of other packages, by kind of stream.
        settings: that those are read with.
        notes: what was chosen that the user may want otherwise.
    """

    names: dict[str, str]
    adapted: dict[str, AdaptedTopic]
    settings: AdapterSettings
    notes: tuple[str, ...]


def find_inputs(bag: Bag, settings: AdapterSettings, vehicle: Vehicle | None = None) -> BagInputs:
    """Find the sensor topics of a bag; commands that are not named must be of the motors of the vehicle.

    Raises:
        LogError: naming bag and topic, for a name that is not in the bag, has a type that is not understood
            or would not be used, and with the options to give, for topics of which several could be meant.
    """
    search = _Search(bag, settings, vehicle)
    search.take_all()
    return search.finish()


def named_inputs(bag: Bag, topics: Mapping[str, str]) -> dict[str, str]:
    """Topics of a bag that are named, by the standard names of what they hold; see :func:`find_inputs`."""
    search = _Search(bag, AdapterSettings(topics=topics))
    search.take_named()
    return search.names


def holds_imu(path: Path) -> bool:
    """Whether a bag holds messages of an IMU, under whatever name."""
    types = {TOPIC_TYPES["imu"], *(one.type_name for one in known_adapters().values() if one.kind == "imu")}
    with Bag(path) as bag:
        return any(
            one.msgcount and one.msgtype in types and not is_truth(one.topic) for one in bag.connections
        )


def stamps_without_imu(path: Path) -> dict[str, Stamps] | None:
    """:func:`topic_stamps` of a bag such as one of results; None for one with messages of an IMU."""
    return None if holds_imu(path) else topic_stamps(path)


def topics_of(bag: Bag) -> str:
    """Names of all topics, for messages."""
    return ", ".join(sorted({connection.topic for connection in bag.connections})) or "none"


class _Several(NamedTuple):
    """A standard name, and topics of the bag of which any could be meant by it."""

    word: str
    topics: Sequence[str]


class _Search:
    def __init__(self, bag: Bag, settings: AdapterSettings, vehicle: Vehicle | None = None) -> None:
        self._bag = bag
        self._vehicle = vehicle
        self._settings = settings
        self.names: dict[str, str] = {}
        self._adapted: dict[str, AdaptedTopic] = {}
        self._notes: list[str] = []
        self._several: list[_Several] = []
        self._with_messages = [one for one in bag.connections if one.msgcount]
        self._counts: Counter[str] = Counter()
        for connection in self._with_messages:
            self._counts[connection.topic] += connection.msgcount
        levels = _levels(settings.namespace)
        self._within = {one.topic for one in self._with_messages if _holds(_levels(one.topic), levels)}
        if levels and not self._within:
            raise LogError(
                f"{bag.path}: namespace {settings.namespace}: no topic of it; topics of the bag: "
                f"{topics_of(bag)}"
            )

    @property
    def _found(self) -> set[str]:
        """Kinds of streams that have a topic, or several to choose from."""
        names = (*self.names, *(one.word for one in self._several))
        return {SENSOR_KINDS[name] for name in names} | set(self._adapted)

    def take_all(self) -> None:
        """The topics that are named, then those that are found."""
        self.take_named()
        self._take_by_name()
        self._take_by_type()
        self._take_self_described()
        self._take_transform()

    # Topics that are named.

    def take_named(self) -> None:
        """The topics that the settings name, and those that they say how to read."""
        own = {kind: getattr(self._settings, kind) for kind in _BY_TYPE}
        named = dict(self._settings.topics)
        for kind, one in own.items():
            connection = self._connection(one.topic) if one is not None and one.topic else None
            word = next(
                (w for w in _words(kind) if connection and TOPIC_TYPES[w] == connection.msgtype), None
            )
            if connection is None or word is None:
                continue
            if unused := [key for key, value in vars(one).items() if key != "topic" and value is not None]:
                raise LogError(
                    f"{self._bag.path}: topic {one.topic}: `{unused[0]}` is given but not used: "
                    f"a {connection.msgtype} is read without it"
                )
            if other := next((w for w in named if SENSOR_KINDS[w] == kind), None):
                raise self._unused(other, named[other], f"the mapping's {kind} of topic {one.topic}")
            named[word] = one.topic
            self._settings = self._with(kind, None)
        by_kind: dict[str, str] = {}
        for word, text in named.items():
            first = by_kind.setdefault(SENSOR_KINDS[word], word)
            if first != word:
                raise self._unused(word, text, first)
            self._take_named(word, text)
        # What is named stands in for what the settings would find.
        taken: dict[str, Any] = dict.fromkeys(self._adapted)
        self._adapted |= find_adapted(self._bag, replace(self._settings, **taken), self._within)

    def _take_named(self, word: str, text: str) -> None:
        topic, _, frame = text.partition(":")
        connection, kind = self._connection(topic), SENSOR_KINDS[word]
        if connection is None:
            raise LogError(
                f"{self._bag.path}: topic {topic}: named for {word}, but the bag holds no such messages; "
                f"topics of the bag: {topics_of(self._bag)}"
            )
        types = {one.msgtype for one in self._with_messages if one.topic == connection.topic}
        known = {TOPIC_TYPES[other]: other for other in reversed(_words(kind))}
        adapter = adapter_of(kind, connection.msgtype)
        if len(types) > 1 or (connection.msgtype not in known and adapter is None):
            raise LogError(
                f"{self._bag.path}: topic {topic}: named for {word}, but is of type "
                f"{', '.join(sorted(types))}; understood: {', '.join(known)}"
            )
        if (connection.msgtype == TF_TYPE) != bool(frame):
            if frame:
                raise LogError(f"{self._bag.path}: topic {text}: only a {TF_TYPE} is read by a child frame")
            raise self._choose_frame(word, connection)
        if adapter is None:
            self.names[known[connection.msgtype]] = connection.topic
            return
        self._adapted[kind] = AdaptedTopic(adapter, connection)
        own = getattr(self._settings, kind)
        if frame and own is not None:
            raise self._unused(f"the mapping's {kind}", own.topic or "", f"{word}={text}")
        if frame:
            own = BodySettings(body=frame, frames=FLU_ENU, topic=connection.topic)
        elif own is None and kind in {"imu", "odometry"}:
            own = StateSettings()
        elif own is not None and own.topic not in {None, connection.topic}:
            raise self._unused(f"the mapping's {kind}", own.topic, f"{word}={text}")
        self._settings = self._with(kind, own)

    def _with(self, kind: str, own: object) -> AdapterSettings:
        """The settings with others of one kind."""
        changes: dict[str, Any] = {kind: own}
        return replace(self._settings, **changes)

    def _unused(self, word: str, topic: str, first: str) -> LogError:
        return LogError(f"{self._bag.path}: {word}={topic}: is given but not used: {first} is")

    def _connection(self, topic: str) -> Connection | None:
        """The topic of that name, with or without a leading slash, that has messages."""
        wanted = _levels(topic)
        return next((one for one in self._with_messages if _levels(one.topic) == wanted), None)

    # Topics that are found.

    def _take_by_name(self) -> None:
        """Topics of standard names, in any namespace."""
        for kind in dict.fromkeys(SENSOR_KINDS.values()):
            if kind in self._found:
                continue
            for word in _words(kind):
                topics = sorted(topic for topic in self._within if is_named(topic, word))
                for topic in topics:
                    require_type(self._bag, topic, word)
                if len(topics) == 1:
                    self.names[word] = topics[0]
                    self._compare_with_types(kind, word, topics[0])
                elif topics:
                    self._several.append(_Several(word, topics))
                if topics:
                    break

    def _compare_with_types(self, kind: str, word: str, topic: str) -> None:
        """Say what a standard name is read before; refuse to choose between it and a topic in another place.

        A name without a namespace is that of the only vehicle; one with may be of a camera, or of another
        vehicle.
        """
        others = sorted(self._word_of(kind))
        place = _levels(topic)[: -len(_levels(word))]
        elsewhere = [other for other in others if place and _levels(other)[: len(place)] != place]
        if elsewhere and kind != "odometry":
            del self.names[word]
            self._several.append(_Several(word, [topic, *elsewhere]))
        elif others:
            self._notes.append(f"topic {word}: {topic} is read by its name, before {', '.join(others)}")

    def _word_of(self, kind: str) -> dict[str, str]:
        """Topics of other names that have a type of a kind, with the standard names of the types."""
        words = _BY_TYPE.get(kind, ())
        return {topic: word for word in words for topic in self._of_type(TOPIC_TYPES[word], kind == "mocap")}

    def _take_by_type(self) -> None:
        """Topics of other names, of kinds that have none of a standard name."""
        for kind, words in _BY_TYPE.items():
            if kind in self._found or (kind == "odometry" and "mocap" in self._found):
                continue
            word_of = self._word_of(kind)
            places = {_levels(topic)[:-1] for topic in word_of}
            if len(places) > 1:
                self._several.append(_Several(words[0], sorted(word_of)))
            elif word_of:
                self._take_first(word_of)

    def _of_type(self, type_name: str, mocap: bool) -> list[str]:
        named = {one.topic for one in self._with_messages if one.msgtype == type_name}
        return [
            topic
            for topic in named & self._within
            if not is_truth(topic)
            and not any(is_named(topic, word) for word in SENSOR_KINDS)
            and not (mocap and _NO_MOCAP.search(topic.lower()))
        ]

    def _take_first(self, word_of: dict[str, str]) -> None:
        most = max(self._counts[topic] for topic in word_of)
        fast = [topic for topic in word_of if self._counts[topic] >= AS_FAST.value * most]
        last_of = {topic: _levels(topic)[-1] for topic in fast}
        ranks = {topic: (*_PREFERRED, last_of[topic]).index(last_of[topic]) for topic in fast}
        chosen = min(fast, key=lambda topic: (ranks[topic], topic))
        self.names[word_of[chosen]] = chosen
        others = ", ".join(sorted(set(word_of) - {chosen}))
        said = f", before {others}: the fastest, of equally fast ones `data`" if others else ""
        self._notes.append(f"topic {word_of[chosen]}: none has this name; {chosen} is read by its type{said}")

    def _take_transform(self) -> None:
        """The only child frame on /tf, of the namespace, where nothing else says where the vehicle is."""
        if {"mocap", "odometry"} & self._found:
            return
        word = "mocap/transform"
        for connection in self._with_messages:
            if connection.msgtype != TF_TYPE or connection.topic.rpartition("/")[2] == TF_TOPIC:
                continue
            frames = self._child_frames(connection.topic)
            if connection.topic not in self._within:
                # All vehicles share /tf: their frames have the namespaces.
                levels = _levels(self._settings.namespace)
                frames = [frame for frame in frames if _holds(_levels(frame), levels)]
            if len(frames) > 1 and self._several:
                self._several.append(_Several(word, [f"{connection.topic}:{frame}" for frame in frames]))
                return
            if len(frames) != 1:
                self._notes.append(str(self._choose_frame(word, connection, named=False)))
                continue
            self._take_named(word, f"{connection.topic}:{frames[0]}")
            self._notes.append(
                f"topic {word}: none has this name; {connection.topic} is read for its child frame "
                f"{frames[0]}"
            )
            return

    def _take_self_described(self) -> None:
        """Messages of other packages that say all of themselves; of IMU and state, where there are no others.

        Motor commands and battery, which only flights without rotor speeds need, and the air are read where
        they can be.
        """
        for kind in ("imu", "odometry", *BESIDE_INPUTS):
            known = {*self._found, *({"odometry"} if "mocap" in self._found else ())}
            motors = self._vehicle.motors if self._vehicle and kind == "motor_commands" else None
            source = motors.source if motors else ""
            topics = [] if kind in known else unnamed(self._bag, kind, self._within, source)
            settings = CommandSettings() if kind == "motor_commands" else StateSettings()
            quiet = kind in MOTOR_INPUTS and "rotor_speeds" in self._found
            chosen = self._with(kind, settings)
            if len(topics) == 1:
                try:
                    AdaptedReading(self._bag.path, topics[0], chosen, self._vehicle)
                except LogError as error:
                    self._notes += [] if quiet else [str(error).removeprefix(f"{self._bag.path}: ")]
                    continue
                self._adapted[kind], self._settings = topics[0], chosen
                if not quiet:
                    self._notes.append(f"topic {kind}: {topics[0].name} is read by its type")
            elif topics and kind != "imu" and not quiet:
                names = ", ".join(one.name for one in topics)
                how = f"--mapping must name one, as in `{kind}: {{topic: {topics[0].name}}}`"
                self._notes.append(f"topic {kind}: could be any of {names}: {how}")

    def _child_frames(self, topic: str) -> list[str]:
        """Child frames in the first messages of a topic."""
        frames: set[str] = set()
        for block in self._bag.blocks([topic]):
            for message in block[topic].payloads:
                try:
                    decoded = typestore().deserialize_cdr(message, TF_TYPE)
                except Exception:  # rosbags raises many kinds; who reads the topic says which message it is
                    continue
                frames |= {plain_name(one.child_frame_id) for one in decoded.transforms}  # type: ignore[attr-defined]
            break
        return sorted(frames)

    def _choose_frame(self, word: str, connection: Connection, *, named: bool = True) -> LogError:
        frames = self._child_frames(connection.topic)
        where = f"{self._bag.path}: " if named else ""
        lines = ", ".join(f"`--topics {word}={connection.topic}:{frame}`" for frame in frames[:8])
        return LogError(
            f"{where}topic {connection.topic}: is read for one child frame, and which is not said: "
            f"{lines or 'it has none'}"
        )

    def finish(self) -> BagInputs:
        """What was found; see :func:`find_inputs`."""
        if self._several:
            said = "; ".join(
                f"topic {one.word}: ambiguous between {', '.join(one.topics)}" for one in self._several
            )
            raise LogError(f"{self._bag.path}: {said}; choose with {self._advice()}")
        notes = (
            *self._notes,
            *unread(self._bag, {*self._found, *BESIDE_INPUTS}),
            *self._passed_over(),
        )
        return BagInputs(self.names, self._adapted, self._settings, notes)

    def _passed_over(self) -> Iterator[str]:
        """A note for each kind without a topic of what in the bag could be it."""
        for kind in _BY_TYPE:
            lacks_place = not {"mocap", "odometry"} & self._found
            if not (lacks_place if kind in {"mocap", "odometry"} else kind not in self._found):
                continue
            types = {TOPIC_TYPES[word]: word for word in reversed(_words(kind)) if word != "mocap/odometry"}
            for one in sorted(self._with_messages, key=lambda one: one.topic):
                if is_truth(one.topic) or one.topic in self.names.values():
                    continue
                if word := types.get(one.msgtype):
                    yield f"topic {word}: not found; `--topics {word}={one.topic}` reads {one.topic} as it"
                elif _COULD_BE[kind].search(f"{one.topic} {one.msgtype}".lower()) and not any(
                    adapter.type_name == one.msgtype for adapter in known_adapters().values()
                ):
                    yield f"topic {one.topic}: {one.msgtype} is not understood, and not read"

    def _advice(self) -> str:
        """The options that choose, ready to be pasted; a namespace only where it finds as much."""
        # Levels that single out one topic of each: the namespaces of vehicles, the outermost first.
        levels_of = [[_levels(topic.replace(":", "/")) for topic in one.topics] for one in self._several]
        choices = [Counter(level for levels in topics for level in set(levels)) for topics in levels_of]
        place = {level: levels.index(level) for levels in levels_of[0] for level in levels}
        spaces = [level for level in choices[0] if all(counts[level] == 1 for counts in choices)]
        spaces = [level for level in spaces if not any(level in _levels(one.word) for one in self._several)]
        spaces.sort(key=lambda level: (place[level], level))
        named = {
            one.word: next(
                (topic for topic, levels in zip(one.topics, of, strict=True) if {*spaces[:1]} & {*levels}),
                one.topics[0],
            )
            for one, of in zip(self._several, levels_of, strict=True)
        }
        topics = "`--topics " + " ".join(f"{word}={topic}" for word, topic in named.items()) + "`"
        kinds = self._found_with(topics={**self._settings.topics, **named})
        fit = [space for space in spaces if kinds and self._found_with(namespace=f"/{space}") == kinds]
        return f"`--namespace /{fit[0]}` or {topics}" if fit else topics

    def _found_with(self, **settings: Any) -> set[str] | None:
        """Kinds of streams that other settings find; None where they are refused."""
        try:
            search = _Search(self._bag, replace(self._settings, **settings))
            search.take_all()
        except LogError:
            return None
        return None if search._several else search._found


def _words(kind: str) -> list[str]:
    """Standard names of a kind, the first of them that is there counts."""
    return [word for word, own in SENSOR_KINDS.items() if own == kind]


def _levels(topic: str) -> tuple[str, ...]:
    return tuple(level for level in topic.split("/") if level)


def _holds(levels: Sequence[str], part: Sequence[str]) -> bool:
    """Whether levels of a name include others, one behind the other."""
    return any(tuple(levels[at : at + len(part)]) == tuple(part) for at in range(len(levels) - len(part) + 1))
