# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings as MCAP bags with the standard topics, and back. Stamps are header stamps, never log times."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core import flight
from quadpi_core.errors import LogError
from quadpi_core.findings import DataQuality, LeftOut
from quadpi_core.flight_files import flight_in
from quadpi_core.frames import Array
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_inputs import find_inputs, topics_of
from quadpi_core.logs.bag_topics import (
    ADAPTED_KINDS,
    AdaptedReading,
    AdaptedTopic,
    find_topic,
    unpacked_topic,
)
from quadpi_core.logs.bag_writer import BagWriter, mcap_writer
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings
from quadpi_core.messages.frame_ids import TF_TOPIC, TF_TYPE, BodyFrames, Framed, FrameRefusedError, names_of
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.result_messages import unpack_alarms, unpack_predictions
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.reading_options import join_blocks, split_by_stamp
from quadpi_core.results import Predictions, ReportedAlarms
from quadpi_core.rotor_order import CommandedSpeeds, require_source
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__

_log = logging.getLogger(__name__)

# What the messages of each topic become: fields of a recording.
_FIELDS: dict[str, tuple[str, ...]] = {
    **{kind.topic: (field,) for field, kind in flight.STREAM_KINDS.items()},
    **{"erpm": ("rotor_speeds",), "mocap/transform": ("pose",), "mocap/odometry": ("pose", "twist")},
}
_FIELDS_OF_KINDS = {kind: kind for kind in ADAPTED_KINDS} | {"mocap": "pose", "motor_commands": "commands"}
_PACKERS: dict[type[flight.Stream], Callable[[Any], Payloads]] = {
    flight.ImuStream: sensor_messages.pack_imu,
    flight.RotorSpeedStream: sensor_messages.pack_rotor_speeds,
    flight.PoseStream: sensor_messages.pack_pose,
    flight.TwistStream: sensor_messages.pack_twist,
    flight.OdometryStream: sensor_messages.pack_odometry,
    flight.WindStream: sensor_messages.pack_wind,
    flight.MotorCommandStream: sensor_messages.pack_motor_commands,
    flight.BatteryStream: sensor_messages.pack_battery,
    flight.AirStream: sensor_messages.pack_pressure,
    flight.TemperatureStream: sensor_messages.pack_temperature,
    flight.WrenchStream: lambda stream: sensor_messages.pack_body_vectors(
        stream.time_ns, stream.wrench, sensor_messages.WRENCH
    ),
}
_READ_AT_ONCE = 1 << 20
# Attitudes alone, one in so many ns: more of them hang together, and cost as much each.
_ATTITUDE_NS = 50_000_000
# Custom data of a bag: whose scale its commands have, and that a barometer's board was as warm as it says.
_COMMANDS_OF, _BOARD_AIR = "motor_commands", "board_air"
_NO_IMU = flight.ImuStream(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 3)))


def read_bag(
    path: Path | str, vehicle: Vehicle | None = None, adapters: AdapterSettings | None = None
) -> flight.Recording:
    """Read the standard topics of a bag; topics may stand in a namespace, but for `truth`: that is no sensor.

    The streams are as recorded: :meth:`Recording.check` judges them.

    Args:
        path: a .mcap, .db3 or ROS 1 .bag file, or a rosbag2 folder.
        vehicle: gives the pole pairs; needed where only `erpm` holds the rotor speeds.
        adapters: which topics are read, and how; see :func:`quadpi_core.logs.bag_inputs.find_inputs`.

    Raises:
        LogError: naming bag, topic and sample, for a bag that cannot be read, names another vehicle or has no
            `imu`, a topic of the wrong type, a name that several topics share, and `erpm` without a vehicle
            that has pole pairs.
    """
    with open_recording(path, vehicle, adapters) as recording:
        return join_blocks(recording.blocks())


@contextmanager
def open_recording(
    path: Path | str, vehicle: Vehicle | None = None, adapters: AdapterSettings | None = None
) -> Iterator[BagRecording]:
    """Open a bag to read what :func:`read_bag` does, with the same arguments, in blocks."""
    with Bag(Path(path)) as bag:
        yield BagRecording(bag, vehicle, adapters)


class BagRecording:
    """The recording that an open bag holds, to be read in blocks, as often as needed.

    Attributes:
        name, source, vehicle: see :class:`quadpi_core.flight.Recording`.
        streams: names of its fields that the bag has messages for.
    """

    def __init__(self, bag: Bag, vehicle: Vehicle | None, adapters: AdapterSettings | None) -> None:
        self._bag = bag
        self._known_vehicle = vehicle
        self._frames = _frames_of(bag)
        found = find_inputs(bag, adapters or AdapterSettings(), vehicle)
        for note in found.notes:
            _log.warning("%s: %s", bag.path, note)
        self._names, self._adapted, self._adapters = found.names, found.adapted, found.settings
        if "imu" not in self._names and "imu" not in self._adapted:
            raise LogError(f"{bag.path}: topic imu: missing; topics of the bag: {topics_of(bag)}")
        self.name, self.source, self.vehicle = bag.name, str(bag.path), _vehicle_name(bag, vehicle)
        self.streams = {field for topic in self._names for field in _FIELDS[topic]} | {
            _FIELDS_OF_KINDS[kind] for kind in self._adapted
        }
        commands, motors = self._adapted.get("motor_commands"), vehicle.motors if vehicle else None
        self._command_source = commands.adapter.name if commands else ""
        if commands is not None and commands.adapter.type_name == sensor_messages.MOTOR_COMMANDS:
            self._command_source = bag.metadata.get(_COMMANDS_OF, self._command_source)
        warmth = self._adapted.get("temperature", self._adapted.get("pressure"))
        self._board_air = bag.metadata.get(_BOARD_AIR) == "true" or (
            warmth is not None
            and (warmth.adapter.name == "px4_air" or "baro" in warmth.name.rpartition("/")[2])
        )
        self._turning = self._takes_orientation()
        if self._turning:
            self.streams.add("odometry")
        if commands is not None and motors is not None:
            require_source(str(bag.path), self._command_source, motors)
            self.streams.add("rotor_speeds")

    def _takes_orientation(self) -> bool:
        """Whether the orientation of the IMU's messages is the attitude, as no other topic tells it.

        A position whose attitude nothing tells is left out, and that is said.
        """
        states = self._adapted.get("odometry")
        if states is not None and states.adapter.without_attitude and not self._is_read(states):
            self._leave_out(states, "none of its messages gives a position")
            states = None
        bare = states is not None and states.adapter.without_attitude
        if not bare and {"pose", "twist", "odometry"} & self.streams:
            return False
        topic = self._names.get("imu")
        for block in () if topic is None else self._bag.blocks([topic]):
            assert topic is not None
            turned = unpacked_topic(self._bag.path, block[topic], sensor_messages.unpack_orientation)[1]
            names, _ = names_of(block[topic].payloads[0], 1)
            try:
                in_body = self._frames.imu(names) is None
            except FrameRefusedError as error:
                raise LogError(f"{self._bag.path}: topic {topic}: sample 0: {error}") from error
            if in_body and len(turned) > 1 and np.ptp(turned, axis=0).any():
                if states is None:
                    _log.warning(
                        "%s: topic %s: its orientation is the attitude, alone", self._bag.path, topic
                    )
                return True
            break
        if states is not None:
            lacks = f"which {topic or 'the topic imu'} lacks"
            self._leave_out(states, f"its attitude must be the orientation of an IMU in body axes, {lacks}")
        return False

    def _is_read(self, states: AdaptedTopic) -> bool:
        """Whether any message of a state gives a sample."""
        reading = AdaptedReading(self._bag.path, states, self._adapters, self._known_vehicle)
        before = 0
        for block in self._bag.blocks([states.name]):
            if reading.unpack(block[states.name], before):
                return True
            before += len(block[states.name].payloads)
        return False

    def _leave_out(self, states: AdaptedTopic, why: str) -> None:
        del self._adapted["odometry"]
        self.streams.discard("odometry")
        _log.warning("%s: topic %s: is not read: %s", self._bag.path, states.name, why)

    @property
    def _is_commanded(self) -> bool:
        """Whether rotor speeds are made of motor commands."""
        motors = self._known_vehicle.motors if self._known_vehicle else None
        return motors is not None and "motor_commands" in self._adapted

    @property
    def sources(self) -> dict[str, str]:
        """Of each field of the recording, the topic of the bag that it comes from."""
        fields = {field: name for topic, name in self._names.items() for field in _FIELDS[topic]}
        fields |= {_FIELDS_OF_KINDS[kind]: topic.name for kind, topic in self._adapted.items()}
        if self._is_commanded:
            fields["rotor_speeds"] = fields["commands"]
        return fields

    def blocks(self) -> Iterator[flight.Recording]:
        """The recording in blocks; see :mod:`quadpi_core.reading_options`.

        They follow each other in log time. What messages of other packages give is absent from a block that
        has none of them, and when it arrived is not known. What they do not give, the last block says.
        """
        unpacking = _Unpacking(
            self._bag.path, self._names, self._adapted, self._adapters, self._known_vehicle, self._frames
        )
        unpacking.orientation = _Orientation() if self._turning else None
        empty = flight.Recording(
            self.name,
            self.vehicle,
            self.source,
            _NO_IMU,
            board_air=self._board_air,
            command_source=self._command_source,
            commanded=self._is_commanded,
        )
        for topics in self._bag.blocks(unpacking.topics):
            streams, arrivals = unpacking.unpack(topics)
            yield replace(empty, **streams, arrivals=arrivals)
        if left_out := unpacking.finish():
            yield replace(empty, quality=DataQuality(left_out=left_out))


class _Unpacking:
    """What becomes of the messages of a bag as they come, and how many came."""

    def __init__(
        self,
        path: Path,
        names: Mapping[str, str],
        adapted: Mapping[str, AdaptedTopic],
        adapters: AdapterSettings,
        vehicle: Vehicle | None,
        frames: BodyFrames,
    ) -> None:
        self._path = path
        self._names = names
        mocap_odometry = partial(
            sensor_messages.unpack_logged_mocap_odometry, noise=None if vehicle is None else vehicle.noise
        )
        self._unpackers: dict[str, Callable[[Payloads], Any]] = {
            "imu": Framed(sensor_messages.unpack_imu, frames.imu),
            "rotor_speeds": partial(
                sensor_messages.unpack_rotor_speeds, rotors=None if vehicle is None else vehicle.rotor_count
            ),
            "erpm": lambda payloads: _unpack_erpm(payloads, vehicle),
            "mocap/pose": Framed(sensor_messages.POSE_SAMPLES.unpack_logged, frames.world),
            "mocap/transform": Framed(sensor_messages.TRANSFORM_SAMPLES.unpack_logged, frames.world, texts=2),
            "mocap/twist": Framed(sensor_messages.unpack_twist, frames.world),
            "mocap/odometry": Framed(mocap_odometry, frames.world, texts=2),
            "odometry": Framed(sensor_messages.ODOMETRY_SAMPLES.unpack_logged, frames.world, texts=2),
            "wind": Framed(sensor_messages.unpack_wind, frames.world),
            "simulation/wrench": lambda payloads: flight.WrenchStream(
                *sensor_messages.unpack_body_vectors(payloads, sensor_messages.WRENCH)
            ),
        }
        self._adapted = {
            kind: AdaptedReading(path, topic, adapters, vehicle) for kind, topic in adapted.items()
        }
        self._commanded: CommandedSpeeds | None = None
        if vehicle is not None and vehicle.motors is not None and "motor_commands" in adapted:
            self._commanded = CommandedSpeeds(vehicle.motors)
        self.orientation: _Orientation | None = None
        self.topics = [*names.values(), *(reading.name for reading in self._adapted.values())]
        self._read = dict.fromkeys(self.topics, 0)
        self._start_ns = 0

    def unpack(self, topics: Mapping[str, Topic]) -> tuple[dict[str, Any], dict[str, flight.Stamps]]:
        """The streams in the messages that come next, by the names of their fields, and their arrivals."""
        streams: dict[str, Any] = {}
        arrivals: dict[str, flight.Stamps] = {}
        for topic, name in self._names.items():
            content = unpacked_topic(
                self._path, topics[name], self._unpackers[topic], before=self._read[name]
            )
            parts = content if isinstance(content, tuple) else (content,)
            streams |= zip(_FIELDS[topic], parts, strict=True)
            if "imu" in self._names and topic != "imu":
                # How many IMU samples were logged before each message, or with it.
                imu_ns = topics[self._names["imu"]].log_time_ns
                arrived = np.searchsorted(imu_ns, topics[name].log_time_ns, side="right")
                arrivals |= {part.topic: arrived for part in parts}
        for kind, reading in self._adapted.items():
            stream = reading.unpack(topics[reading.name], before=self._read[reading.name])
            if stream is not None:
                streams[_FIELDS_OF_KINDS[kind]] = stream
        if self.orientation is not None:
            states = streams.pop("odometry", None)
            if len(topics[self._names["imu"]].payloads):
                self.orientation.take(topics[self._names["imu"]].payloads)
                streams["odometry"] = self.orientation.of_states(
                    states, streams["imu"], "odometry" in self._adapted
                )
        if self._commanded is not None:
            # Those that are measured stand in nowhere, not even where no command came.
            streams.pop("rotor_speeds", None)
            arrivals.pop(flight.RotorSpeedStream.topic, None)
            self._make_speeds(self._commanded, streams, topics)
        if not self._start_ns and len(streams.get("imu", ())):
            self._start_ns = int(streams["imu"].time_ns[0])
        for name, messages_of in topics.items():
            self._read[name] += len(messages_of.payloads)
        return streams, arrivals

    def _make_speeds(
        self, speeds: CommandedSpeeds, streams: dict[str, Any], topics: Mapping[str, Topic]
    ) -> None:
        """Rotor speeds of the next commands, by the voltages that were logged before each."""
        commands, battery, heard = streams.get("commands"), streams.get("battery"), None
        if battery is not None and commands is None:
            speeds.hear(battery)
        if commands is None:
            return
        if battery is not None:
            logged = [topics[self._adapted[kind].name].log_time_ns for kind in ("motor_commands", "battery")]
            if [len(logged[0]), len(logged[1])] == [len(commands), len(battery)]:
                heard = np.searchsorted(logged[0], logged[1])
        streams["rotor_speeds"] = speeds.take(commands, battery, heard)

    def finish(self) -> tuple[LeftOut, ...]:
        """What messages of other packages did not give; see :meth:`AdaptedReading.finish`."""
        return tuple(
            one
            for reading in self._adapted.values()
            for one in reading.finish(self._read[reading.name], self._start_ns)
        )


class _Orientation:
    """Attitudes of a state that has none, or alone, by the orientation of the IMU's messages."""

    def __init__(self) -> None:
        self._time_ns: flight.Stamps = np.empty(0, np.int64)
        self._attitude: Array = np.empty((0, 4))
        self._deviation: Array = np.empty(0)

    def take(self, payloads: Payloads) -> None:
        """Take the messages that come next, and keep the last one before them."""
        time_ns, attitude, deviation = sensor_messages.unpack_orientation(payloads)
        self._time_ns = np.concatenate((self._time_ns[-1:], time_ns))
        self._attitude = np.concatenate((self._attitude[-1:], attitude))
        self._deviation = np.concatenate((self._deviation[-1:], deviation))

    def of_states(
        self, states: flight.OdometryStream | None, imu: flight.ImuStream, positions: bool
    ) -> flight.OdometryStream | None:
        """The states with the attitude that was last told; of attitudes alone one in each period."""
        if positions:
            if states is None:
                return None
            at = np.searchsorted(self._time_ns, states.time_ns, side="right") - 1
            states, at = states.take(at >= 0), at[at >= 0]
        else:
            at = np.flatnonzero(np.diff(self._time_ns // _ATTITUDE_NS))
            at = at[np.isin(self._time_ns[at], imu.time_ns)]
            nothing = np.zeros((len(at), 3))
            states = flight.OdometryStream(
                self._time_ns[at], nothing, self._attitude[at], nothing.copy(), nothing.copy()
            )
            states.rates[:] = imu.angular_velocity[np.searchsorted(imu.time_ns, states.time_ns)]
            states.deviation[:] = flight.NOT_MEASURED
        states.attitude[:], states.deviation[:, 1] = self._attitude[at], self._deviation[at]
        return states


def _frames_of(bag: Bag) -> BodyFrames:
    """Frames by the static transforms of a bag."""
    frames = BodyFrames(warn=partial(_log.warning, "%s: topic imu: %s", bag.path))
    names = {
        connection.topic
        for connection in bag.connections
        if connection.msgtype == TF_TYPE and connection.topic.rpartition("/")[2] == TF_TOPIC
    }
    for topic in bag.read(names).values():
        for message in topic.payloads:
            try:
                frames.transforms.take(message)
            except LogError as error:
                raise LogError(f"{bag.path}: topic {topic.name}: {error}") from error
    return frames


def _unpack_erpm(payloads: Payloads, vehicle: Vehicle | None) -> flight.RotorSpeedStream:
    if vehicle is None:
        raise LogError("electrical speeds need the vehicle, whose file gives the pole pairs")
    return sensor_messages.unpack_erpm(payloads, vehicle)


def read_outputs(path: Path | str) -> tuple[Predictions | None, ReportedAlarms | None]:
    """Read what the monitor published of samples; None where the bag lacks the topic."""
    path = Path(path)
    with Bag(path) as bag:
        prediction, alarm = find_topic(bag, "prediction"), find_topic(bag, "extrapolation_alarm")
        topics = bag.read([connection.topic for connection in (prediction, alarm) if connection])
    alarms = unpacked_topic(path, topics[alarm.topic], unpack_alarms) if alarm else None
    return (
        unpacked_topic(path, topics[prediction.topic], unpack_predictions) if prediction else None,
        alarms.where(alarms.of_samples) if alarms is not None else None,
    )


def write_bag(
    path: Path | str,
    recording: flight.Recording,
    extra: Sequence[Topic] = (),
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a recording as an MCAP bag; equal input gives equal bytes.

    Its custom data (of rosbag2) name the vehicle, the source file with its SHA-256, and the version.

    Args:
        path: .mcap file to write; it appears whole or not at all.
        recording: with its commands, battery and air.
        extra: further topics, such as those of :func:`output_topic`.
        metadata: further entries of the custom data.

    Raises:
        LogError: if the path does not end in .mcap; for arrays of a stream that do not belong together.
    """
    streams = written_streams(recording)
    for stream in streams:
        stream.require_shapes(recording.source)
    names = [stream.topic for stream in streams]
    entries = {_COMMANDS_OF: recording.command_source} if recording.commands is not None else {}
    entries |= {_BOARD_AIR: "true"} if recording.board_air and recording.pressure is not None else {}
    with recording_writer(
        path, recording.vehicle, recording.source, names, {**entries, **(metadata or {})}
    ) as writer:
        writer.announce({topic.name: topic.type_name for topic in extra})
        for topic in extra:
            writer.add(topic)
        for part, end_ns in split_by_stamp(recording):
            for topic in recording_topics(part):
                writer.add(topic)
            writer.flush(end_ns - 1)


@contextmanager
def recording_writer(
    path: Path | str,
    vehicle: str,
    source: str,
    topics: Collection[str],
    metadata: Mapping[str, str] | None = None,
) -> Iterator[BagWriter]:
    """A bag like that of :func:`write_bag`, with these standard topics, to write as its messages come."""
    entries = {"vehicle": vehicle, "version": __version__, **_provenance(Path(source))}
    with mcap_writer(Path(path), {**entries, **(metadata or {})}) as writer:
        writer.announce({f"/{name}": TOPIC_TYPES[name] for name in topics})
        yield writer


def written_streams(recording: flight.Recording) -> list[flight.Stream]:
    """The streams that a bag of a recording has; rotor speeds by commands are made anew by who reads it."""
    air = recording.pressure
    beside: list[flight.Stream | None] = [recording.commands, recording.battery, air, recording.temperature]
    if air is not None and recording.temperature is None and np.isfinite(air.celsius).any():
        beside[-1] = flight.TemperatureStream(air.time_ns, air.pressure, air.celsius)
    return [
        *(one for one in recording.streams() if one is not recording.rotor_speeds or not recording.commanded),
        *(one for one in beside if one is not None),
    ]


def recording_topics(recording: flight.Recording) -> Iterator[Topic]:
    """The standard topics that hold a recording, or a part of one; none for a stream without samples."""
    for stream in written_streams(recording):
        if len(stream):
            yield output_topic(stream.topic, stream.time_ns, _PACKERS[type(stream)](stream))


def output_topic(name: str, time_ns: flight.Stamps, payloads: Payloads) -> Topic:
    """A standard topic to write, logged at its stamps."""
    return Topic(f"/{name}", TOPIC_TYPES[name], time_ns, payloads)


def _vehicle_name(bag: Bag, vehicle: Vehicle | None) -> str:
    named = bag.metadata.get("vehicle", "")
    if vehicle is None:
        return named
    if named not in {"", vehicle.name}:
        raise LogError(f"{bag.path}: is a flight of vehicle {named}, not of {vehicle.name}")
    return vehicle.name


def _provenance(source: Path) -> dict[str, str]:
    file, _ = flight_in(source)
    if not file.is_file():
        return {"source": source.name}
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while part := stream.read(_READ_AT_ONCE):
            digest.update(part)
    return {"source": source.name, "source_sha256": digest.hexdigest()}
