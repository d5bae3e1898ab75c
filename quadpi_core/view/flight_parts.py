# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A flight in parts, as the page and recordings take it: judged by models, or with the results in a bag."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import OdometryStream, Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import flight_hash
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_inputs import holds_imu
from quadpi_core.logs.bag_topics import find_topic, has_topic, unpacked_topic
from quadpi_core.logs.mcap_files import Connection, is_cut_off, whole_part
from quadpi_core.logs.readers import identify_format
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec, foreign_codec
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.result_messages import DescribedModel, MonitorDescription, unpack_description
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.alarm_log import Explained
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.replay import RecordedFlight, explained, monitored, open_flight
from quadpi_core.reading_options import MappingOrOptions, reading_options
from quadpi_core.records import Records
from quadpi_core.results import AlarmEvent, Predictions, ReportedAlarms
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.trust import NO_MESSAGE, REPORTS, TOLD_S, MotionInputs, Told

CUT_OFF = "the file is cut off, what comes before is shown; `mcap recover` rebuilds the file"
_RESULTS = ("prediction", "extrapolation_alarm", "alarm_log", "odometry", "rotor_speeds", "erpm", "wind")
_STAMP = {"header.stamp.sec": 1, "header.stamp.nanosec": 1}
_STRING, _DESCRIPTION = "std_msgs/msg/String", "description"
# What is not shown without a topic of a bag of results.
_WITHOUT = {
    "extrapolation_alarm": "nobody says whether the model can be trusted",
    "odometry": "flight, speed and height are not shown",
    "rotor_speeds": "rotor speeds, and inputs of the models, are not shown",
}


class FlightTaker(Protocol):
    """Takes what comes of a flight, part by part; see :class:`VehicleView`."""

    def take_predictions(
        self, model: str, predictions: Predictions, identity: str, confidence: float, axes: Sequence[str]
    ) -> None:
        """Take predictions of a model, the first one's before those of others."""

    def take_inputs(self, time_ns: Stamps, inputs: Array) -> None:
        """Take inputs (K, 19) of the models."""

    def take_states(self, states: OdometryStream) -> None:
        """Take positions, attitudes and velocities."""

    def take_rotor_speeds(self, rotors: RotorSpeedStream) -> None:
        """Take rotor speeds."""

    def take_alarms(self, alarms: ReportedAlarms) -> None:
        """Take what the monitor says."""

    def take_events(self, events: Sequence[AlarmEvent]) -> None:
        """Take alarms that were raised or cleared."""

    def take_told(self, told: Sequence[Told]) -> None:
        """Take what battery, autopilot and link say, in the order of time."""

    def take_missing(self, topics: Sequence[tuple[str, str]]) -> None:
        """Take topics that something is missing of or to be said of, with the words for it."""

    def learn(self, models: Mapping[str, DescribedModel]) -> None:
        """Take the training ranges of models, by identity."""


Part = Callable[[FlightTaker], None]
Parts = Generator[Part, None, None]
_Content = TypeVar("_Content")


def flight_parts(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle | None,
    confidence: float | None,
    command: str,
    mapping: MappingOrOptions = None,
) -> Parts:
    """Parts of a flight, judged by models or with the results that the bag holds.

    Args:
        bag: see :func:`open_bag`.
        models: see there.
        vehicle: see there.
        confidence: see there.
        command: to advise `--model` for, where the bag holds no results.
        mapping: of a flight that models judge, see :func:`quadpi_core.logs.read_recording`.

    Raises:
        QuadpiError: see there.
    """
    if len({model.name for model in models}) < len(models):
        raise QuadpiError("--model: two models have the same name, which is how they are told apart")
    with whole_part(bag) as readable:
        if models and not holds_only_results(readable):
            assert vehicle is not None
            parts = judged(readable, models, vehicle, confidence, mapping)
        elif models and confidence is not None:
            raise QuadpiError(f"--confidence: {bag} holds results, whose intervals have theirs")
        elif not reading_options(mapping).part.is_whole:
            raise QuadpiError(f"{bag}: --from and --to cut flights that --model judges, not recorded results")
        else:
            parts = recorded(readable, command, models)
        is_bag = identify_format(readable).container is not None
        told, unread = _told_in(readable) if is_bag else ([], [])
        for number, part in enumerate(parts):
            if number == 0 and told:
                yield lambda view: view.take_told(told)
            yield part
            if number == 0 and unread:
                yield lambda view: view.take_missing(unread)
            if number == 0 and is_cut_off(bag):
                yield lambda view: view.take_missing([("bag", CUT_OFF)])
        if vehicle is not None and not holds_only_results(readable):
            known = _identified_on(readable, models, vehicle, mapping)
            yield lambda view: view.take_missing([("bag", text) for text in known])


def _told_in(bag: Path) -> tuple[list[Told], list[tuple[str, str]]]:
    """What battery and autopilot say, in the order of time, and topics that cannot be read, with why."""
    told: list[Told] = []
    lacks = []
    with Bag(bag) as opened:
        found: dict[str, Connection] = {}
        # Of each type the first topic, as live.
        for one in sorted(opened.connections, key=lambda one: (one.topic.count("/"), one.topic)):
            if one.msgtype in REPORTS and one.msgcount:
                found.setdefault(one.msgtype, one)
        topics = opened.read([one.topic for one in found.values()]) if found else {}
        for type_name, one in found.items():
            report, topic = REPORTS[type_name], topics[one.topic]
            wanted = tuple((report.fields | _STAMP).items())
            try:
                columns, _ = foreign_codec(type_name, one.definition, wanted).decode(topic.payloads)
            except LogError as error:
                lacks.append((one.topic, f"not shown: {error}"))
                continue
            said, until_ns = "", 0
            for row, logged_ns in enumerate(topic.log_time_ns.tolist()):
                sec, nanosec = (int(columns[field][row]) for field in _STAMP)
                time_ns = 10**9 * sec + nanosec or logged_ns
                if said and time_ns > until_ns:
                    told.append(Told(until_ns, report.name, NO_MESSAGE))
                words = report.words({field: columns[field][row] for field in report.fields})
                if words != said or time_ns > until_ns:
                    told.append(Told(time_ns, report.name, words))
                said, until_ns = words, time_ns + round(1e9 * TOLD_S)
            told.append(Told(until_ns, report.name, NO_MESSAGE))
    return sorted(told), lacks


def _identified_on(
    bag: Path, models: Sequence[AerodynamicModel], vehicle: Vehicle, mapping: MappingOrOptions
) -> list[str]:
    """Which models were identified on this flight, by its hash; of a flight that `identify` refuses, none."""
    try:
        sha256 = flight_hash(bag, vehicle, mapping)
    except QuadpiError:
        return []
    return [
        f"in sample: {model.name} was identified on this flight"
        for model in models
        if model.learned_from(sha256)
    ]


def holds_only_results(bag: Path) -> bool:
    """Whether a bag holds predictions and no IMU that a model could judge, as those of `quadpi replay`."""
    if identify_format(bag).container is None:
        return False
    return has_topic(bag, "prediction") and not holds_imu(bag)


def judged(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle,
    confidence: float | None,
    mapping: MappingOrOptions = None,
) -> Iterator[Part]:
    """Parts of a flight, judged as `quadpi replay` does."""
    monitors = [Monitor(model, vehicle, None, confidence) for model in models]
    held: list[OdometryStream] = []
    with open_flight(bag, vehicle, mapping) as flight:
        words = explained(flight)
        for stretch, conditions in monitored(_noting(flight, held), monitors):
            states = held[:] if stretch.states is None else [stretch.states.odometry]
            held.clear()
            yield _judged_part(monitors, stretch.samples, conditions, states, words)


def _noting(flight: RecordedFlight, held: list[OdometryStream]) -> RecordedFlight:
    """The flight; what its blocks say of the state by themselves is noted, as no estimator gives it."""

    def blocks() -> Iterator[Recording]:
        for block in flight.blocks:
            if not flight.has_mocap and block.odometry is not None:
                held.append(block.odometry)
            yield block

    return replace(flight, blocks=blocks())


def _judged_part(
    monitors: Sequence[Monitor],
    samples: PairedSamples,
    conditions: Records | None,
    states: Sequence[OdometryStream],
    words: Explained,
) -> Part:
    first, *others = monitors
    prepared = first.preparation.step(*samples, conditions)
    predictions, alarms, events = first.judge(prepared)
    further = [(other, other.predict(other.preparation.step(*samples, conditions))) for other in others]
    reported = None
    if len(alarms):
        reported = result_messages.unpack_alarms(result_messages.pack_alarms(alarms, words.rows(alarms)))
    rotors = RotorSpeedStream(samples.time_ns, samples.rotor_speeds)
    told = words.events(events)

    def show(view: FlightTaker) -> None:
        for monitor, given in ((first, predictions), *further):
            model = monitor.model
            view.take_predictions(model.name, given, model.identity, monitor.confidence, model.axes)
        view.take_inputs(prepared.usable_ns, prepared.inputs)
        for stream in states:
            view.take_states(stream)
        view.take_rotor_speeds(rotors)
        if reported is not None:
            view.take_alarms(reported)
        view.take_events(told)

    return show


def recorded(bag: Path, command: str, models: Sequence[AerodynamicModel] = ()) -> Iterator[Part]:
    """Parts of the results that a bag holds; without any, `command` is advised with a model.

    Args:
        bag: with predictions.
        command: see :func:`flight_parts`.
        models: whose training ranges are shown.

    Raises:
        QuadpiError: for a bag without predictions, and a model that made none of them.
    """
    with Bag(bag) as opened:
        names = {}
        for topic in _RESULTS:
            connection = find_topic(opened, topic)
            if connection is not None:
                names[topic] = connection.topic
        if "prediction" not in names:
            found = ", ".join(sorted({connection.topic for connection in opened.connections})) or "none"
            raise LogError(
                f"{bag}: holds no predictions; judge it by a model: {command} --model MODEL "
                f"(topics of the bag: {found})"
            )
        # Predictions of further models are below the topic of the first.
        further = sorted(
            {
                connection.topic
                for connection in opened.connections
                if connection.topic.startswith(f"{names['prediction']}/")
                and connection.msgtype == sensor_messages.PREDICTION
            }
        )
        made_by = _made_by(opened, [names["prediction"], *further])
        for model in models:
            if model.identity not in made_by:
                held = ", ".join(sorted(made_by))
                raise QuadpiError(f"--model: {bag} holds predictions of {held}, none of {model.identity}")
        description, lacks = _description(opened)
        learned = {**description.models, **{model.identity: model.described() for model in models}}
        vehicle, without = _rotor_vehicle(opened, names, description.vehicle)
        inputs = None if description.vehicle is None else MotionInputs(description.vehicle)
        for number, block in enumerate(opened.blocks([*names.values(), *further])):
            topics = {topic: block[name] for topic, name in names.items() if len(block[name].payloads)}
            others = [block[name] for name in further if len(block[name].payloads)]
            part = _recorded_part(bag, topics, others, vehicle, inputs)
            yield _after_learning(learned, part) if number == 0 else part
            if number == 0:
                if inputs is not None and inputs.problem:
                    without.append(("inputs", f"not shown: {inputs.problem}"))
                yield lambda view: view.take_missing([*lacks, *without])


def _made_by(opened: Bag, topics: Sequence[str]) -> set[str]:
    """Identities of the models whose predictions a bag begins with."""
    block = next(iter(opened.blocks(topics)), {})
    return {
        unpacked_topic(
            opened.path, topic, lambda payloads: result_messages.unpack_model(payloads[0])
        ).identity
        for topic in block.values()
        if len(topic.payloads)
    }


def _after_learning(models: Mapping[str, DescribedModel], part: Part) -> Part:
    def show(view: FlightTaker) -> None:
        view.learn(models)
        part(view)

    return show


def _description(opened: Bag) -> tuple[MonitorDescription, list[tuple[str, str]]]:
    """What the monitors of a bag say of their models, and topics of that name that no monitor wrote."""
    names = {
        one.topic
        for one in opened.connections
        if one.msgtype == _STRING and one.topic.rpartition("/")[2] == _DESCRIPTION and one.msgcount
    }
    models: dict[str, DescribedModel] = {}
    vehicle, lacks = None, []
    for topic in opened.read(names).values() if names else ():
        for payload in topic.payloads:
            try:
                text = codec(_STRING).decode(payload)["data"][0].decode(errors="replace")
                described = unpack_description(text)
            except LogError as error:
                lacks.append((topic.name, f"gives no training ranges: {error}"))
                break
            models |= described.models
            vehicle = described.vehicle or vehicle
    return MonitorDescription(models, {}, vehicle), lacks


def _rotor_vehicle(
    opened: Bag, names: dict[str, str], described: Vehicle | None
) -> tuple[Vehicle | None, list[tuple[str, str]]]:
    """The vehicle, if `erpm` alone gives rotor speeds; and topics that are missing, with what that hides."""
    lacks = [
        (topic, f"the bag has no topic {topic}: {without}")
        for topic, without in _WITHOUT.items()
        if topic not in names
    ]
    if "rotor_speeds" in names or "erpm" not in names:
        names.pop("erpm", None)
        return None, lacks
    name = opened.metadata.get("vehicle", "")
    try:
        if not name and described is None:
            raise LogError("the bag does not name its vehicle, whose file gives the pole pairs")
        vehicle = described or Vehicle.load(name)
        vehicle.rotor_speeds_from_erpm(np.zeros(vehicle.rotor_count))
    except QuadpiError as error:
        del names["erpm"]
        return None, [*lacks, ("erpm", f"no rotor speeds: {error}")]
    return vehicle, [row for row in lacks if row[0] != "rotor_speeds"]


def _recorded_part(
    bag: Path,
    topics: Mapping[str, Topic],
    others: Sequence[Topic],
    vehicle: Vehicle | None,
    inputs: MotionInputs | None,
) -> Part:
    """What to show of the topics of a block that have messages.

    Args:
        bag: for what cannot be read.
        topics: by their standard names.
        others: predictions of further models.
        vehicle: of `erpm`, where that is among the topics.
        inputs: of the models, where their vehicle is known.
    """

    def unpacked(name: str, unpack: Callable[[Payloads], _Content]) -> _Content | None:
        return unpacked_topic(bag, topics[name], unpack) if name in topics else None

    predicted = [
        (
            unpacked_topic(bag, topic, lambda payloads: result_messages.unpack_model(payloads[-1])),
            unpacked_topic(bag, topic, result_messages.unpack_predictions),
        )
        for topic in ([topics["prediction"]] if "prediction" in topics else []) + list(others)
    ]
    states = unpacked("odometry", sensor_messages.unpack_odometry)
    rotors = unpacked("rotor_speeds", sensor_messages.unpack_rotor_speeds)
    if vehicle is not None:
        rotors = unpacked("erpm", lambda payloads: sensor_messages.unpack_erpm(payloads, vehicle))
    alarms = unpacked("extrapolation_alarm", result_messages.unpack_alarms)
    events = unpacked("alarm_log", result_messages.unpack_events)
    wind = unpacked("wind", sensor_messages.unpack_wind)
    followed = None if inputs is None else inputs.take(states, rotors, wind)

    def show(view: FlightTaker) -> None:
        for about, predictions in predicted:
            view.take_predictions(about.identity.partition("@")[0], predictions, *about)
        if followed is not None:
            view.take_inputs(*followed)
        if states is not None:
            view.take_states(states)
        if rotors is not None:
            view.take_rotor_speeds(rotors)
        if alarms is not None:
            view.take_alarms(alarms)
        view.take_events(events or [])

    return show
