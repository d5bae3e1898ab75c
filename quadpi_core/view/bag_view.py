# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as a source of the page: judged by models as the live nodes would, or with the results in it."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import OdometryStream, Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import find_topic, unpacked_topic
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.model_description import DescribedModel
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import pairing_kernel
from quadpi_core.monitor.alarm_log import reasons_by_row
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.replay import RecordedFlight, follow, open_flight
from quadpi_core.results import AlarmEvent, Predictions, ReportedAlarms
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView

# An hour at 20 blocks a second, 50 MB with one model.
_BLOCKS = 72_000
# Parts that wait to be taken: the reader goes no further ahead than this.
_WAITING = 4
# Time that a tick may spend on what has been read, so that pages are answered meanwhile.
_TICK_S = 0.03
_RESULTS = ("prediction", "extrapolation_alarm", "alarm_log", "odometry", "rotor_speeds", "erpm")
# What is not shown without a topic of a bag of results.
_WITHOUT = {
    "extrapolation_alarm": "nobody says whether the model can be trusted",
    "odometry": "flight, speed and height are not shown",
    "rotor_speeds": "rotor speeds are not shown",
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

    def take_missing(self, topics: Sequence[tuple[str, str]]) -> None:
        """Take topics that are missing, with what is not shown for that."""


Part = Callable[[FlightTaker], None]
_Content = TypeVar("_Content")


class Source(Protocol):
    """Where a page's data come from."""

    live: bool
    title: str

    @property
    def vehicles(self) -> Mapping[str, VehicleView]:
        """Every vehicle, by name."""

    def poll(self) -> None:
        """Take what has come since the last call; called at every tick of the server."""

    def close(self) -> None:
        """Stop."""


class BagSource:
    """A flight that is read in a thread while pages look at what has been read.

    Args:
        title: what the page is about.
        name: of the flight.
        parts: what to do with the view, block by block; may raise QuadpiError.
        known: see :class:`VehicleView`.
    """

    live = False

    def __init__(
        self, title: str, name: str, parts: Iterator[Part], known: Mapping[str, DescribedModel]
    ) -> None:
        self.title = title
        view = VehicleView(name, known, BLOCK_NS, _BLOCKS)
        view.silent(("reading the bag",))
        self.vehicles = {name: view}
        self.error: QuadpiError | None = None
        self.finished = False
        self._view = view
        self._parts: queue.Queue[Part | QuadpiError | None] = queue.Queue(_WAITING)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._read, args=(parts,), name="bag reader", daemon=True)
        self._thread.start()

    def poll(self) -> None:
        """Take what has been read, for a moment."""
        deadline = time.monotonic() + _TICK_S
        while not self.finished and time.monotonic() < deadline:
            try:
                part = self._parts.get_nowait()
            except queue.Empty:
                break
            if isinstance(part, QuadpiError):
                self.error = part
                self._view.silent((f"the bag cannot be read further: {part}",))
                self._view.health.rows.append(("bag", "error", str(part)))
            elif part is not None:
                part(self._view)
            self.finished = part is None or self.error is not None

    def close(self) -> None:
        """End the reader."""
        self._stopping.set()
        self._thread.join()

    def _read(self, parts: Iterator[Part]) -> None:
        try:
            for part in parts:
                if not self._hand_over(part):
                    return
            self._hand_over(None)
        except QuadpiError as error:
            self._hand_over(error)
        finally:
            if hasattr(parts, "close"):
                parts.close()

    def _hand_over(self, part: Part | QuadpiError | None) -> bool:
        while not self._stopping.is_set():
            try:
                self._parts.put(part, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False


def open_bag(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle | None,
    confidence: float | None = None,
) -> BagSource:
    """The source of a flight.

    Args:
        bag: with sensor topics to judge by the models, or with results.
        models: the first gives the alarm; none: those whose results the bag holds.
        vehicle: of the models.
        confidence: of the intervals; each model's own unless given.

    Raises:
        QuadpiError: for a bag that cannot be read or holds no results, and models of another vehicle.
    """
    known = {model.identity: model.described() for model in models}
    parts = _started(flight_parts(bag, models, vehicle, confidence, f"quadpi view {bag}"))
    about = f"judged by {', '.join(model.name for model in models)}" if models else "results as recorded"
    return BagSource(f"{bag.name}, {about}", bag.stem, parts, known)


def flight_parts(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle | None,
    confidence: float | None,
    command: str,
) -> Iterator[Part]:
    """Parts of a flight, judged by models or with the results that the bag holds.

    Args:
        bag: see :func:`open_bag`.
        models: see there.
        vehicle: see there.
        confidence: see there.
        command: to advise `--model` for, where the bag holds no results.

    Raises:
        QuadpiError: see there.
    """
    if not models:
        return recorded(bag, command)
    assert vehicle is not None
    if len({model.name for model in models}) < len(models):
        raise QuadpiError("--model: two models have the same name, which is how they are told apart")
    return judged(bag, models, vehicle, confidence)


def _started(parts: Iterator[Part]) -> Iterator[Part]:
    """The parts with the first one made, so that what is wrong with a bag is said before a page is opened."""
    first = next(parts, None)

    def rest() -> Iterator[Part]:
        if first is not None:
            yield first
        yield from parts

    return rest()


def judged(
    bag: Path, models: Sequence[AerodynamicModel], vehicle: Vehicle, confidence: float | None
) -> Iterator[Part]:
    """Parts of a flight, judged as `quadpi replay` does."""
    monitors = [Monitor(model, vehicle, None, confidence) for model in models]
    held: list[OdometryStream] = []
    with open_flight(bag, vehicle) as flight:
        for stretch in follow(_noting_states(flight, held), vehicle):
            if stretch.begin == pairing_kernel.SET_BACK:
                for monitor in monitors:
                    monitor.reset()
            for monitor in monitors:
                monitor.retune(stretch.rate)
            states = held[:] if stretch.states is None else [stretch.states.odometry]
            held.clear()
            yield _judged_part(monitors, stretch.samples, states)


def _noting_states(flight: RecordedFlight, held: list[OdometryStream]) -> RecordedFlight:
    """The flight; what its blocks say of the state by themselves is noted, as no estimator gives it."""

    def blocks() -> Iterator[Recording]:
        for block in flight.blocks:
            if not flight.has_mocap and block.odometry is not None:
                held.append(block.odometry)
            yield block

    return replace(flight, blocks=blocks())


def _judged_part(
    monitors: Sequence[Monitor], samples: PairedSamples, states: Sequence[OdometryStream]
) -> Part:
    first, *others = monitors
    prepared = first.preparation.step(*samples)
    predictions, alarms, events = first.judge(prepared)
    further = [(other, other.predict(other.preparation.step(*samples))) for other in others]
    reported = None
    if len(alarms):
        reported = result_messages.unpack_alarms(result_messages.pack_alarms(alarms, reasons_by_row(alarms)))
    rotors = RotorSpeedStream(samples.time_ns, samples.rotor_speeds)

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
        view.take_events(events)

    return show


def recorded(bag: Path, command: str) -> Iterator[Part]:
    """Parts of the results that a bag holds; without any, `command` is advised with a model."""
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
        vehicle, lacks = _rotor_vehicle(opened, names)
        for number, block in enumerate(opened.blocks([*names.values(), *further])):
            topics = {topic: block[name] for topic, name in names.items() if len(block[name].payloads)}
            others = [block[name] for name in further if len(block[name].payloads)]
            yield _recorded_part(bag, topics, others, vehicle)
            if number == 0:
                yield lambda view: view.take_missing(lacks)


def _rotor_vehicle(opened: Bag, names: dict[str, str]) -> tuple[Vehicle | None, list[tuple[str, str]]]:
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
        if not name:
            raise LogError("the bag does not name its vehicle, whose file gives the pole pairs")
        vehicle = Vehicle.load(name)
        vehicle.rotor_speeds_from_erpm(np.empty(0))
    except QuadpiError as error:
        del names["erpm"]
        return None, [*lacks, ("erpm", f"no rotor speeds: {error}")]
    return vehicle, [row for row in lacks if row[0] != "rotor_speeds"]


def _recorded_part(
    bag: Path, topics: Mapping[str, Topic], others: Sequence[Topic], vehicle: Vehicle | None
) -> Part:
    """What to show of the topics of a block that have messages.

    Args:
        bag: for what cannot be read.
        topics: by their standard names.
        others: predictions of further models.
        vehicle: of `erpm`, where that is among the topics.
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

    def show(view: FlightTaker) -> None:
        for about, predictions in predicted:
            view.take_predictions(about.identity.partition("@")[0], predictions, *about)
        if states is not None:
            view.take_states(states)
        if rotors is not None:
            view.take_rotor_speeds(rotors)
        if alarms is not None:
            view.take_alarms(alarms)
        view.take_events(events or [])

    return show
