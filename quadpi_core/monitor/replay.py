# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Replay: what the live nodes would have published for a recorded flight, computed block by block.

Estimator, pairing and monitor keep the same state between blocks as live between samples, and results are
written as they come. So memory does not grow with the flight, and the bytes do not depend on the blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.errors import LogError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import EkfTrace, FusedSamples, Spans, never_started, with_gyro_faults
from quadpi_core.estimator.filter_state import WITHOUT_ESTIMATE, EstimatorStatus, ImuRate
from quadpi_core.estimator.slow_states import with_slow_states, with_velocity_rate
from quadpi_core.flight import MAX_JUMP_BACK_NS, ImuStream, OdometryStream, Recording, Stamps, WindStream
from quadpi_core.flight_files import FlightFile, LeftOutFlights, bags_in, for_each_flight
from quadpi_core.frames import Array
from quadpi_core.inputs import Air
from quadpi_core.logs import blocks_of, decode_recording, identify_format, open_in_blocks
from quadpi_core.logs.bag_writer import FAST, mcap_writer
from quadpi_core.logs.bags import output_topic
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.payloads import Topic
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel
from quadpi_core.monitor import pairing
from quadpi_core.monitor.alarm import MonitorSettings, NotJudgedReason, alarm_time, not_judged
from quadpi_core.monitor.alarm_log import Explained, naming_sensors
from quadpi_core.monitor.health import MOTION_CAPTURE, Heard
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples, Pairing
from quadpi_core.monitor.unsure_states import StateDeviations
from quadpi_core.monitor.wind_state import SampleContext
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.paths import staged, whole_outputs
from quadpi_core.reading_options import (
    MappingOrOptions,
    by_arrival,
    cut_block,
    keep_freed_memory,
    reading_options,
    split_recording,
)
from quadpi_core.records import Records
from quadpi_core.results import LEVEL_ALARM, LEVEL_WARNING, Alarms, Events, Predictions
from quadpi_core.screening.flight_runs import RunningRates, in_range_of_blocks
from quadpi_core.screening.sample_order import order_of, usable_recording, without_unusable_attitudes
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__


@dataclass(frozen=True)
class ReplaySummary:
    """Counts and times of a replay.

    Attributes:
        samples_in: IMU samples in the bag.
        predictions_out: predictions written.
        dropped: IMU samples without a prediction although the state and the rotor speeds had started:
            given up by the pairing, or not plausible.
        alarm_fraction: share of the monitored time at alarm level.
        alarm_first_s: seconds from the first IMU sample to the first alarm; None without one.
        warning_first_s: the same to the first warning, or alarm without one before.
        events: how often a cause was raised.
        not_judged_fraction: share of the flight in which the model was not judged.
        not_judged_reasons: that this fraction is made of, the largest first.
    """

    samples_in: int
    predictions_out: int
    dropped: int
    alarm_fraction: float
    alarm_first_s: float | None
    warning_first_s: float | None
    events: int
    not_judged_fraction: float
    not_judged_reasons: tuple[NotJudgedReason, ...]


def replay(
    model: AerodynamicModel,
    vehicle: Vehicle,
    bag: Path | str,
    output: Path | str,
    *,
    confidence: float | None = None,
    settings: MonitorSettings | None = None,
    mapping: MappingOrOptions = None,
) -> ReplaySummary:
    """Write the topics odometry, prediction and extrapolation_alarm for a flight; the same bytes each time.

    Samples that other commands refuse (not finite, stamps that do not rise) are handled as in flight: the
    alarm reports them.

    With motion capture in the bag this is estimator and monitor in one process: the state comes from the
    causal EKF, and is written as odometry with its covariance. Without it, the state is the bag's odometry,
    as for a monitor node in a process of its own. Rotor speeds and wind are paired with the IMU samples by
    :class:`quadpi_core.monitor.pairing.Pairing`.

    Args:
        model: of this vehicle.
        vehicle: as in its vehicle file.
        bag: a bag, or any log.
        output: MCAP file to write; it appears whole or not at all.
        confidence: nominal coverage; the model's own unless given.
        settings: of the alarm, and whether intervals adapt.
        mapping: see :func:`quadpi_core.logs.read_recording`.

    Raises:
        ArgumentError: for what are no model, vehicle, paths, confidence or settings.
        LogError: naming bag, topic and sample of what cannot be used.
        ModelError: if the model belongs to another vehicle.
        SignalError: if the estimator never starts.
    """
    bag, output = array_checks.path("bag", bag), array_checks.path("output", output)
    array_checks.instance("model", model, AerodynamicModel, LOAD_MODEL)
    model.require(vehicle)
    if output.resolve() == bag.resolve():
        raise LogError(f"{bag}: the output would replace the flight; choose another file")
    keep_freed_memory()
    with open_flight(bag, vehicle, mapping) as flight:
        monitor = Monitor(model, vehicle, None, confidence, settings)
        return _write(flight, monitor, vehicle, output)


def _write(flight: RecordedFlight, monitor: Monitor, vehicle: Vehicle, output: Path) -> ReplaySummary:
    """Judge a flight, write its results and sum them up."""
    metadata = {"vehicle": vehicle.name, "model": monitor.model.identity}
    metadata |= {"source": flight.name, "version": __version__}
    tally, words = _Tally(), explained(flight)
    with mcap_writer(output, metadata, FAST) as writer:
        names = [*(["odometry"] if flight.has_mocap else []), "prediction", "extrapolation_alarm"]
        writer.announce({f"/{name}": TOPIC_TYPES[name] for name in names})
        for stretch, conditions in monitored(flight, [monitor]):
            if stretch.begin != pairing.CONTINUES:
                # Stamps repeat from here on, and must not mix with the earlier ones.
                writer.flush()
            predictions, alarms, events = monitor.step(*stretch.samples, conditions)
            for topic in _messages(stretch.states, predictions, alarms, events, monitor, words):
                writer.add(topic)
            writer.flush(stretch.settled_ns)
            tally.add(stretch, predictions, alarms, events)
    return tally.summary()


def monitored(
    flight: RecordedFlight, monitors: Sequence[Monitor]
) -> Iterator[tuple[Followed, Records | None]]:
    """Stretches of a flight with the samples that monitors of its vehicle take, and their conditions.

    The monitors are set to each as in flight; the model of the first knows of wind and unsure states.
    """
    first = monitors[0]
    context = SampleContext(first.model, first.vehicle, flight.wind_since_ns)
    for stretch in follow(flight, first.vehicle):
        if stretch.begin == pairing.SET_BACK:
            for forget in (context.reset, *(monitor.reset for monitor in monitors)):
                forget()
        for monitor in monitors:
            monitor.retune(stretch.rate)
            monitor.fly_in(stretch.density)
        context.unsure.take(stretch.deviations)
        time_ns, values, conditions = context.of(stretch.samples)
        yield stretch._replace(samples=PairedSamples(time_ns, values)), conditions


def explained(flight: RecordedFlight) -> Explained:
    """Reasons as live nodes give them, by the stamps of the flight's sensors up to what is followed."""
    return Explained(lambda reasons, time_ns: naming_sensors(reasons, flight.heard.lacks(time_ns)))


def _messages(
    states: FusedSamples | None,
    predictions: Predictions,
    alarms: Alarms,
    events: Events,
    monitor: Monitor,
    words: Explained,
) -> Iterator[Topic]:
    """The topics that the nodes publish, with their messages."""
    if states is not None:
        payloads = sensor_messages.pack_fused(states.time_ns, states.rows)
        yield output_topic("odometry", states.time_ns, payloads)
    model = monitor.model
    packed = result_messages.pack_predictions(
        predictions, model=model.identity, confidence=monitor.confidence, axes=model.axes
    )
    yield output_topic("prediction", predictions.time_ns, packed)
    if len(alarms):
        yield output_topic(
            "extrapolation_alarm", alarms.time_ns, result_messages.pack_alarms(alarms, words.rows(alarms))
        )
    if events:
        stamps = np.array([event.time_ns for event in events])
        yield output_topic("alarm_log", stamps, result_messages.pack_events(words.events(events)))


@dataclass(frozen=True)
class RecordedFlight:
    """A flight to replay, as blocks of samples.

    Attributes:
        name, source: see :class:`Recording`.
        has_mocap: whether the state comes from the EKF, corrected by motion capture or by odometry that is
            too slow to be interpolated; otherwise from the flight's odometry.
        blocks: parts of the flight in order of arrival, see :func:`quadpi_core.reading_options.by_arrival`.
        wind_since_ns: since when velocities are known to come as seldom as by GPS: then drag tells the wind.
        heard: what came of the sensors in what was followed.
    """

    name: str
    source: str
    has_mocap: bool
    blocks: Iterator[Recording]
    wind_since_ns: int | None
    heard: Heard


@contextmanager
def open_flight(
    path: Path | str, vehicle: Vehicle, mapping: MappingOrOptions = None
) -> Iterator[RecordedFlight]:
    """The flight in any log, or the part of it that was asked for; one in a bag is never held whole.

    Raises:
        LogError: naming what cannot be read or is missing.
    """
    part = reading_options(mapping).part
    if identify_format(Path(path)).container is None:
        recording = decode_recording(path, vehicle, mapping)
        if len(order_of(recording.imu.time_ns).starts) > 1:
            # What arrived when follows from the stamps, of one run of the clock.
            recording = usable_recording(recording)
        flight = recorded_flight(recording, vehicle)
        yield replace(flight, blocks=in_range_of_blocks(flight.blocks, flight.source, part))
        return
    with open_in_blocks(path, vehicle, mapping) as log:
        blocks = in_range_of_blocks(by_arrival(blocks_of(log)), log.source, part)
        yield _flight(log.name, log.source, log.streams, blocks, vehicle)


def recorded_flight(recording: Recording, vehicle: Vehicle) -> RecordedFlight:
    """The flight that a recording is, of a vehicle.

    Raises:
        LogError: naming what is missing.
    """
    for stream in recording.streams():
        stream.require_samples(recording.source)
    fields = {name for name in vars(recording) if getattr(recording, name) is not None}
    blocks = split_recording(recording)
    return _flight(recording.name, recording.source, fields, blocks, vehicle)


def _flight(
    name: str, source: str, streams: Collection[str], blocks: Iterator[Recording], vehicle: Vehicle
) -> RecordedFlight:
    has_mocap = "pose" in streams or "twist" in streams
    if not has_mocap and "odometry" not in streams:
        raise LogError(f"{source}: topics mocap/pose and odometry are missing: one is needed")
    if "rotor_speeds" not in streams:
        raise LogError(f"{source}: topic rotor_speeds (or erpm) is missing")
    blocks = map(without_unusable_attitudes, blocks)
    if has_mocap:
        blocks, wind_since_ns = with_velocity_rate(blocks)
    else:
        blocks, has_mocap, wind_since_ns = with_slow_states(blocks, vehicle)
    heard = Heard(MOTION_CAPTURE if has_mocap else "odometry")
    return RecordedFlight(name, source, has_mocap, blocks, wind_since_ns, heard)


class Followed(NamedTuple):
    """A stretch of a flight, estimated and paired, ready for the monitor; see :class:`.pairing.Stretch`.

    Attributes:
        rate: of the IMU, by its stamps.
        samples: input of the monitor; none before the rate is known.
        states: output of the estimator; None without one.
        deviations: how unsure the states are that came.
        imu_ns: (N,) stamps of the IMU samples that arrived since the previous stretch.
        settled_ns: every later sample and state has a stamp after this.
        density: of the air, kg/m³; 0 where only the vehicle file tells it.
    """

    begin: int
    rate: ImuRate
    samples: PairedSamples
    states: FusedSamples | None
    deviations: StateDeviations
    imu_ns: Stamps
    settled_ns: int
    density: float


def follow(flight: RecordedFlight, vehicle: Vehicle, ekf: Ekf | None = None) -> Iterator[Followed]:
    """Take a flight as estimator and pairing take it live.

    Args:
        flight: to follow.
        vehicle: that flew.
        ekf: fresh filter of a flight with motion capture; one is made unless given.

    Raises:
        LogError: naming what cannot be read or comes too seldom, or if IMU, rotor speeds and state share no
            time.
        SignalError: if the estimator never starts.
    """
    if ekf is None and flight.has_mocap:
        ekf = Ekf(vehicle)
    spans, started, measured = Spans(), False, False
    rates = RunningRates()
    meeting = Pairing(rotors=vehicle.rotor_count)
    for block, density in _in_its_air(flight.blocks):
        block.require_rotors(vehicle.name, vehicle.rotor_count)
        rates.add(block)
        samples_heard = flight.heard.samples(block)
        odometry, state_of, states = block.odometry, None, None
        imu = _Imu(block.imu.time_ns, with_gyro_faults(block.imu).specific_force, np.arange(len(block.imu)))
        if ekf is not None:
            trace = ekf.take(block)
            imu, states, state_of = _estimator_output(trace, block.imu)
            odometry = states.odometry
            spans, started = spans.extended(block), started or len(trace) > 0
        assert odometry is not None  # RecordedFlight says so
        new = block.imu.time_ns
        for stretch in meeting.take_all(_arriving(block, imu, odometry, state_of)):
            settled_ns = stretch.settled_ns
            if ekf is not None and ekf.settled_ns is not None:
                settled_ns = min(settled_ns, ekf.settled_ns)
            own = None if states is None else states.part(stretch.states)
            if own is not None:
                deviations = StateDeviations.of_fused(own)
            else:
                deviations = StateDeviations.of_odometry(odometry.take(stretch.states))
            for row in imu.used[stretch.imu].tolist():
                flight.heard.take_one(*samples_heard[row])
            samples = stretch.samples
            if stretch.rate.begins:
                samples = PairedSamples(samples.time_ns[:0], samples.values[:0])
            measured = measured or not stretch.rate.begins
            yield Followed(stretch.begin, stretch.rate, samples, own, deviations, new, settled_ns, density)
            new = new[:0]
    if (ekf is not None and not started) or meeting.counts.paired == 0:
        for seldom in rates.seldom():
            raise LogError(f"{flight.source}: topic {seldom}")
    if ekf is not None and not started:
        raise never_started(flight.source, spans)
    if meeting.counts.paired == 0:
        raise LogError(f"{flight.source}: topics imu, rotor_speeds and the state share no time")
    if not measured:
        raise LogError(f"{flight.source}: topic imu: its rate is measured in a second, and it is shorter")


def _in_its_air(blocks: Iterable[Recording]) -> Iterator[tuple[Recording, float]]:
    """The blocks, cut where the density of the air is another from then on, with the density of each."""
    air = Air()
    for block in blocks:
        rest, before, density = block, 0, air.density
        for count, changed in air.changes(block):
            if count > before:
                due, rest = cut_block(rest, count - before)
                yield due, density
            before, density = count, changed
        yield rest, density


def replay_all(
    model: AerodynamicModel,
    vehicle: Vehicle,
    bags: Sequence[Path],
    folder: Path,
    *,
    confidence: float | None = None,
    settings: MonitorSettings | None = None,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
) -> dict[str, ReplaySummary]:
    """Replay several flights, each into a bag of its name in a folder.

    Args:
        model: see :func:`replay`.
        vehicle: see there.
        bags: see there; `flight_files.named_files` says their names.
        folder: bags of the same names in it are replaced.
        confidence: see there.
        settings: see there.
        mapping: see there.
        workers: that replay the flights; the bags are those that :func:`replay` writes.
        left_out: the list to which flights that cannot be replayed are added; without it, the first is an
            error, and no bag is written.

    Returns:
        The summary of each, by name.

    Raises:
        LogError: see :func:`replay`; for a bag in the place of a flight.
        OutputError: if the bags cannot be written.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    bags = array_checks.paths("bags", bags)
    bags_in(folder, bags)
    with whole_outputs(folder) as staging:
        found = workers.found_by(mapping)
        replayed = partial(replay, model, vehicle, confidence=confidence, settings=settings, mapping=found)
        task = (replayed, staging.absolute())
        summaries = for_each_flight(
            _replay, bags, shared=task, task="Replaying flights", workers=workers, left_out=left_out
        )
    return {file.name: summary for file, summary in summaries}


def _replay(task: tuple[Callable[[Path, Path], ReplaySummary], Path], file: FlightFile) -> ReplaySummary:
    """Replay one flight into the staging folder."""
    replayed, staging = task
    return replayed(file.path, staged(staging, f"{file.name}.mcap"))


def _estimator_output(trace: EkfTrace, imu: ImuStream) -> tuple[_Imu, FusedSamples, Stamps]:
    """IMU samples less their biases, states, and the IMU sample (S,) of each: what the estimator hands on.

    Samples without an estimate are handed on as they are, and while the estimate is lost there are no
    states: the monitor has to report both.
    """
    specific_force = with_gyro_faults(imu).specific_force
    specific_force[trace.sample] = trace.fused.imu.specific_force
    handed_over = np.isin(trace.imu_outcomes, WITHOUT_ESTIMATE)
    handed_over[trace.sample] = True
    published = trace.status != EstimatorStatus.LOST
    states = trace.fused.where(published)
    return _Imu(imu.time_ns, specific_force, np.flatnonzero(handed_over)), states, trace.sample[published]


class _Imu(NamedTuple):
    """IMU samples as the monitor gets them: stamps (N,) and specific force (N, 3), of those `used`."""

    time_ns: Stamps
    specific_force: Array
    used: Stamps


def _arriving(
    block: Recording, imu: _Imu, odometry: OdometryStream, state_of: Stamps | None
) -> pairing.Arriving:
    """The samples of a block in the order in which they reach the pairing.

    Args:
        block: with rotor speeds.
        imu: its IMU samples as the monitor gets them.
        odometry: the states.
        state_of: (S,) IMU sample that each state follows; None where states arrive by themselves.
    """
    rotor_speeds = block.rotor_speeds
    assert rotor_speeds is not None  # RecordedFlight says so
    wind = block.wind or WindStream(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    # Three places per IMU sample: for what came since the previous one, for the sample, and for its state.
    came = {
        pairing.WIND_TOPIC: 3 * block.arrivals_of(wind),
        pairing.ROTORS: 3 * block.arrivals_of(rotor_speeds),
        pairing.IMU: 3 * imu.used + 1,
        pairing.STATE: 3 * block.arrivals_of(odometry) if state_of is None else 3 * state_of + 2,
    }
    rows = {kind: np.arange(len(places)) for kind, places in came.items()} | {pairing.IMU: imu.used}
    order = np.argsort(np.concatenate(list(came.values())), kind="stable")
    return pairing.Arriving(
        kind=np.repeat(list(came), [len(places) for places in came.values()])[order],
        row=np.concatenate([rows[kind] for kind in came])[order],
        imu_ns=imu.time_ns,
        specific_force=imu.specific_force,
        state_ns=odometry.time_ns,
        states=np.concatenate((odometry.velocity, odometry.attitude, odometry.rates), axis=1),
        rotor_ns=rotor_speeds.time_ns,
        rotor_speeds=rotor_speeds.speeds,
        wind_ns=wind.time_ns,
        wind=wind.velocity + pairing.HEARD_M_S,
    )


class _Tally:
    """Counts the results of a replay; of the alarm rows it keeps stamps and levels."""

    def __init__(self) -> None:
        self._imu_ns: tuple[int, int] | None = None
        # Stamps of the IMU after a long pause, and by how much it is longer than counts; see `held_ns`.
        self._pauses: list[tuple[int, int]] = []
        self._samples = self._monitored = self._predictions = self._events = 0
        self._alarm_ns: list[Stamps] = []
        self._levels: list[npt.NDArray[np.uint8]] = []
        self._why: list[npt.NDArray[np.int64]] = []

    def add(self, part: Followed, predictions: Predictions, alarms: Alarms, events: Events) -> None:
        """Count what came of a part of the flight."""
        if len(part.imu_ns):
            first_ns, last_ns = self._imu_ns or (int(part.imu_ns[0]),) * 2
            stamps = np.concatenate(([last_ns], part.imu_ns))
            self._pauses += [
                (int(stamps[row + 1]), int(stamps[row + 1] - stamps[row]) - MAX_JUMP_BACK_NS)
                for row in np.flatnonzero(np.diff(stamps) > MAX_JUMP_BACK_NS)
            ]
            self._imu_ns = first_ns, int(part.imu_ns[-1])
        self._samples += len(part.imu_ns)
        self._monitored += len(part.samples.time_ns)
        self._predictions += len(predictions.time_ns)
        self._events = max([self._events, *(event.number for event in events)])
        self._alarm_ns.append(alarms.time_ns.copy())
        self._levels.append(alarms.level.copy())
        self._why.append(alarms.why_not_judged.copy())

    def summary(self) -> ReplaySummary:
        """The summary; there was at least one sample."""
        start_ns, end_ns = self._imu_ns or (0, 0)
        time_ns, levels = np.concatenate(self._alarm_ns), np.concatenate(self._levels)
        alarm, warning = (
            alarm_time(time_ns, levels, end_ns, level) for level in (LEVEL_ALARM, LEVEL_WARNING)
        )
        before_ns = max(int(time_ns[0]) - start_ns, 0)
        before_ns -= sum(uncounted for after_ns, uncounted in self._pauses if after_ns <= time_ns[0])
        unjudged = not_judged(time_ns, np.concatenate(self._why), max(before_ns, 0), end_ns)
        return ReplaySummary(
            samples_in=self._samples,
            predictions_out=self._predictions,
            dropped=self._monitored - self._predictions,
            alarm_fraction=alarm.fraction,
            alarm_first_s=alarm.first_s(start_ns),
            warning_first_s=warning.first_s(start_ns),
            events=self._events,
            not_judged_fraction=float(sum(reason.fraction for reason in unjudged)),
            not_judged_reasons=unjudged,
        )
