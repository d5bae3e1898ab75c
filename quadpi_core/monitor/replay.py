# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the live nodes would have published for a recorded flight, computed on whole arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from quadpi_core import __version__
from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, Recording, Stamps, WindStream
from quadpi_core.frames import Array
from quadpi_core.logs import decode_recording, messages, result_messages
from quadpi_core.logs.bags import output_topic
from quadpi_core.logs.mcap import Topic
from quadpi_core.logs.mcap_writer import write_mcap
from quadpi_core.monitor import pairing
from quadpi_core.monitor.alarm import LEVEL_ALARM, LEVEL_WARNING, MonitorSettings, alarm_time
from quadpi_core.monitor.events import Events
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.output import Alarms, Predictions
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.parallel import map_files
from quadpi_core.paths import staged, whole_outputs
from quadpi_core.signals import ekf_kernels
from quadpi_core.signals.ekf import Ekf, EkfTrace
from quadpi_core.signals.odometry import FusedSamples, with_gyro_faults
from quadpi_core.signals.resample import nominal_rate
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.models.aerodynamic import AerodynamicModel

_Rows = TypeVar("_Rows", Predictions, Alarms)


@dataclass(frozen=True)
class ReplaySummary:
    """What came of a replay.

    Attributes:
        samples_in: IMU samples in the bag.
        predictions_out: predictions written.
        dropped: IMU samples without a prediction although the state and the rotor speeds had started:
            given up by the pairing, or not plausible.
        alarm_fraction: share of the monitored time at alarm level.
        alarm_first_s: seconds from the first IMU sample to the first alarm; None without one.
        warning_first_s: the same to the first warning, or alarm without one before.
        events: how often a cause was raised.
    """

    samples_in: int
    predictions_out: int
    dropped: int
    alarm_fraction: float
    alarm_first_s: float | None
    warning_first_s: float | None
    events: int


def replay(
    model: AerodynamicModel,
    vehicle: Vehicle,
    bag: Path | str,
    output: Path | str,
    *,
    confidence: float | None = None,
    settings: MonitorSettings | None = None,
) -> ReplaySummary:
    """Write the topics odometry, prediction and extrapolation_alarm for a flight; the same bytes each time.

    Samples that other commands refuse (not finite, stamps that do not rise) are followed as in flight: the
    alarm reports them.

    With motion capture in the bag this is estimator and monitor in one process: the state comes from the
    causal EKF, and is written as odometry with its covariance. Else it is the monitor alone, fed with the
    bag's odometry. Rotor speeds and wind meet the IMU samples as in
    :class:`quadpi_core.monitor.pairing.Pairing`.

    Args:
        model: of this vehicle.
        vehicle: as in its vehicle file.
        bag: a bag, or any log that needs no mapping.
        output: MCAP file to write; it appears whole or not at all.
        confidence: nominal coverage; the model's own unless given.
        settings: of the alarm, and whether intervals adapt.

    Raises:
        LogError: naming bag, topic and sample of what cannot be used.
        ModelError: if the model belongs to another vehicle.
        SignalError: if the estimator never starts.
    """
    if Path(output).resolve() == Path(bag).resolve():
        raise LogError(f"{bag}: the output would replace the flight; choose another file")
    recording = decode_recording(bag, vehicle)
    for stream in recording.streams():
        stream.require_samples(recording.source)
    if len(recording.imu) < 2:
        raise LogError(f"{recording.source}: topic imu: one sample is too few")
    rate_hz = nominal_rate(recording.imu.time_ns)
    monitor = Monitor(model, vehicle, rate_hz, confidence, settings)
    samples, topics = _published(recording, vehicle, rate_hz)
    predictions, alarms, events = _watch(monitor, samples)

    topics.append(
        output_topic(
            "prediction",
            predictions.time_ns,
            result_messages.pack_predictions(
                predictions, model=model.identity, confidence=monitor.confidence, axes=model.axes
            ),
        )
    )
    topics.append(output_topic("extrapolation_alarm", alarms.time_ns, result_messages.pack_alarms(alarms)))
    if events:
        stamps = np.array([event.time_ns for event in events])
        topics.append(output_topic("alarm_log", stamps, result_messages.pack_events(events)))
    write_mcap(
        Path(output),
        topics,
        {"vehicle": vehicle.name, "model": model.identity, "source": recording.name, "version": __version__},
    )
    monitored = sum(len(part.time_ns) for part in samples)
    return _summarise(recording, monitored, len(predictions.time_ns), alarms, events)


def _published(
    recording: Recording, vehicle: Vehicle, rate_hz: float
) -> tuple[list[PairedSamples], list[Topic]]:
    """What the monitor gets, and the odometry that an estimator publishes.

    All else of a long flight is let go here.
    """
    samples, fused = monitored(recording, vehicle, rate_hz)
    if fused is None:
        return samples, []
    payloads = messages.pack_odometry(fused.odometry, fused.pose_covariance, fused.twist_covariance)
    return samples, [output_topic("odometry", fused.time_ns, payloads)]


def monitored(
    recording: Recording, vehicle: Vehicle, rate_hz: float
) -> tuple[list[PairedSamples], FusedSamples | None]:
    """What the monitor gets of a recording, and the states of the estimator; None without motion capture.

    Raises:
        LogError: naming what is missing.
        SignalError: if the estimator never starts.
    """
    imu = _Imu(
        recording.imu.time_ns,
        with_gyro_faults(recording.imu).specific_force,
        np.arange(len(recording.imu)),
    )
    odometry, state_of, fused = recording.odometry, None, None
    if recording.pose is not None or recording.twist is not None:
        imu, fused, state_of = _estimator_output(Ekf(vehicle, rate_hz).run(recording), recording.imu)
        odometry = fused.odometry
    if odometry is None:
        raise LogError(f"{recording.source}: topics mocap/pose and odometry are missing: one is needed")
    return _pair(recording, imu, odometry, state_of), fused


def _watch(monitor: Monitor, samples: Sequence[PairedSamples]) -> tuple[Predictions, Alarms, Events]:
    """What the monitor says; it starts anew with each part of the samples."""
    outputs = []
    for part in samples:
        monitor.reset()
        outputs.append(monitor.step(*part))
    if len(outputs) == 1:
        return outputs[0]
    predictions, alarms, events = zip(*outputs, strict=True)
    return _joined(predictions), _joined(alarms), [event for part in events for event in part]


def _joined(parts: Sequence[_Rows]) -> _Rows:
    """The rows of all parts."""
    return type(parts[0])(
        **{
            column.name: np.concatenate([getattr(part, column.name) for part in parts])
            for column in fields(parts[0])
        }
    )


def replay_all(
    model: AerodynamicModel,
    vehicle: Vehicle,
    bags: Sequence[Path],
    folder: Path,
    *,
    confidence: float | None = None,
    settings: MonitorSettings | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, ReplaySummary]:
    """Replay several flights, each into a bag of its name in a folder: all of them, or none.

    Args:
        model: see :func:`replay`.
        vehicle: see there.
        bags: of different names.
        folder: bags of the same names in it are replaced.
        confidence: see there.
        settings: see there.
        workers: see :func:`quadpi_core.parallel.map_files`; the bags are those that :func:`replay` writes.
        scheduler: see there.
        progress: see there.

    Returns:
        What came of each, by name.

    Raises:
        LogError: see :func:`replay`; for two bags of the same name.
        OutputError: if the bags cannot be written.
        ParallelError: see :func:`quadpi_core.parallel.map_tasks`.
    """
    outputs = replay_outputs(bags, folder)
    with whole_outputs(folder) as staging:
        task = _Replay(model, vehicle, confidence, settings, staging.absolute())
        summaries = map_files(
            _replay, bags, shared=task, workers=workers, scheduler=scheduler, progress=progress
        )
    return {output.stem: summary for output, summary in zip(outputs, summaries, strict=True)}


def replay_outputs(bags: Sequence[Path], folder: Path) -> list[Path]:
    """The bags that :func:`replay_all` writes.

    Raises:
        LogError: for two flights of the same name, and a bag in the place of its flight.
    """
    taken: dict[Path, Path] = {}
    for bag in bags:
        output = folder / f"{bag.stem}.mcap"
        if output in taken:
            raise LogError(f"{bag}: would be replayed to the same bag as {taken[output]}")
        if output.resolve() == bag.resolve():
            raise LogError(f"{bag}: the output would replace the flight; choose another folder")
        taken[output] = bag
    return list(taken)


@dataclass(frozen=True)
class _Replay:
    """What the replay of each flight needs."""

    model: AerodynamicModel
    vehicle: Vehicle
    confidence: float | None
    settings: MonitorSettings | None
    staging: Path


def _replay(task: _Replay, bag: Path) -> ReplaySummary:
    output = staged(task.staging, f"{bag.stem}.mcap")
    return replay(task.model, task.vehicle, bag, output, confidence=task.confidence, settings=task.settings)


def _estimator_output(trace: EkfTrace, imu: ImuStream) -> tuple[_Imu, FusedSamples, Stamps]:
    """What the estimator hands to the monitor in its process: IMU samples less their biases, and states.

    Samples without an estimate come as they are, and while it is lost there are no states: the monitor has to
    report both. The last are the IMU samples that the states belong to.
    """
    specific_force = with_gyro_faults(imu).specific_force
    specific_force[trace.sample] = trace.fused.imu.specific_force
    handed_over = np.isin(trace.imu_outcomes, ekf_kernels.WITHOUT_ESTIMATE)
    handed_over[trace.sample] = True
    published = trace.status != ekf_kernels.EstimatorStatus.LOST
    states = trace.fused.where(published)
    return _Imu(imu.time_ns, specific_force, np.flatnonzero(handed_over)), states, trace.sample[published]


class _Imu(NamedTuple):
    """IMU samples as the monitor gets them: stamps (N,) and specific force (N, 3), of those `used`."""

    time_ns: Stamps
    specific_force: Array
    used: Stamps


def _pair(
    recording: Recording, imu: _Imu, odometry: OdometryStream, state_of: Stamps | None
) -> list[PairedSamples]:
    """What live pairing gives, apart where the clock of the IMU was set back.

    Args:
        recording: with rotor speeds.
        imu: what the monitor gets of it.
        odometry: the states.
        state_of: (S,) IMU sample that each state comes right after; None where it came by itself.
    """
    rotor_speeds = recording.rotor_speeds
    if rotor_speeds is None:
        raise LogError(f"{recording.source}: topic rotor_speeds (or erpm) is missing")
    wind = recording.wind or WindStream(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    # Of what belongs to one IMU sample: what came since the one before, the sample, its state.
    came = {
        pairing.WIND_TOPIC: 3 * recording.arrivals_of(wind),
        pairing.ROTORS: 3 * recording.arrivals_of(rotor_speeds),
        pairing.IMU: 3 * imu.used + 1,
        pairing.STATE: 3 * recording.arrivals_of(odometry) if state_of is None else 3 * state_of + 2,
    }
    rows = {kind: np.arange(len(places)) for kind, places in came.items()} | {pairing.IMU: imu.used}
    order = np.argsort(np.concatenate(list(came.values())), kind="stable")
    states = np.concatenate((odometry.velocity, odometry.attitude, odometry.rates), axis=1)
    arriving = pairing.Arriving(
        kind=np.repeat(list(came), [len(places) for places in came.values()])[order],
        row=np.concatenate([rows[kind] for kind in came])[order],
        imu_ns=imu.time_ns,
        specific_force=imu.specific_force,
        state_ns=odometry.time_ns,
        states=states,
        rotor_ns=rotor_speeds.time_ns,
        rotor_speeds=rotor_speeds.speeds,
        wind_ns=wind.time_ns,
        wind=wind.velocity,
    )
    samples, complete = pairing.Pairing().take_all(arriving)
    if complete == 0:
        raise LogError(f"{recording.source}: topics imu, rotor_speeds and the state share no time")
    return samples


def _summarise(
    recording: Recording, monitored: int, predictions: int, alarms: Alarms, events: Events
) -> ReplaySummary:
    stamps = recording.imu.time_ns
    alarm, warning = (
        alarm_time(alarms.time_ns, alarms.level, int(stamps[-1]), level)
        for level in (LEVEL_ALARM, LEVEL_WARNING)
    )
    return ReplaySummary(
        samples_in=len(stamps),
        predictions_out=predictions,
        dropped=monitored - predictions,
        alarm_fraction=alarm.fraction,
        alarm_first_s=alarm.first_s(int(stamps[0])),
        warning_first_s=warning.first_s(int(stamps[0])),
        events=max((event.number for event in events), default=0),
    )
