# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights read, fused and filtered for identification or evaluation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError, LogError, ModelError, QuadpiError, named_in
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import Segment
from quadpi_core.estimator.fusion import fuse_airborne, require_streams
from quadpi_core.estimator.slow_states import has_slow_velocity, with_slow_state
from quadpi_core.findings import NOTHING_TO_SAY, DataQuality
from quadpi_core.flight import AXES, MAX_GAP_NS, Flight, Recording, Stamps
from quadpi_core.flight_files import (
    FlightFile,
    LeftOutFlights,
    for_each_flight,
    leave_out,
    once_each,
    require_flights_left,
)
from quadpi_core.frames import Array
from quadpi_core.inputs import (
    ASSUMED,
    DERIVATIVES,
    INPUT_NAMES,
    MEASURED,
    Derivatives,
    derivatives_like,
    flight_derivatives,
    flight_inputs,
    flown_in,
)
from quadpi_core.logs import read_recording
from quadpi_core.logs.readers import recording_hash
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.monitor.pairing import SET_BACK
from quadpi_core.monitor.preparation import Preparation
from quadpi_core.monitor.replay import Followed, follow, recorded_flight
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.reading_options import MappingOrOptions, ReadingOptions
from quadpi_core.records import Records, brief_repr, record_dtype
from quadpi_core.screening.consistency import checked
from quadpi_core.screening.flight_runs import long_enough, parts_without_pause
from quadpi_core.signals.chain import interpolate, nominal_rate
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import LOAD_VEHICLE, Motors, Vehicle

# What to call for flights, in refusals of anything else.
PREPARE_FLIGHTS = "prepare_flights(paths, vehicle) gives them"
# Vehicle, cut-off, how to read, and motors of single flights.
_Task = tuple[Vehicle, float, ReadingOptions, Mapping[str, Motors]]
# Where inputs, derivatives and wrench of a live sample end in a row that is interpolated.
_COLUMNS = np.cumsum([len(INPUT_NAMES), DERIVATIVES.itemsize // 8, len(AXES)])


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False)
class PreparedFlight:
    """A flight ready for identification or evaluation.

    Attributes:
        name: file stem, with the folders above where a stem repeats.
        sha256: hash of the sensor streams, the same for every copy of the flight.
        time: (N,) s.
        inputs: (N, 19) input vectors X.
        derivatives: (N,) what the motion has beside them, see `inputs.Derivatives`.
        wrench: (N, 6) measured wrench.
        height: (N,) m above the origin of the world.
        live: the samples as a monitor would have had them, on which the alarm is calibrated; None where the
            states were given instead of estimated, and a monitor would have had the same.
        quality: remarks on the data.
        file: name that the flight would have whole, where it is one of several parts.
        air: what tells the density of the air, see :mod:`quadpi_core.inputs`.
        flight: what it was made of, that simulations are compared with; None where it was made of arrays.
        recording: that a monitor follows in an evaluation as in a replay; None where states were given.
        state: how unsure a monitor's state was, the median of deviations of velocity m/s and attitude rad.
        state_noise: of a slow state that does not say it, position m, attitude rad and velocity m/s.
        wind_unknown: whether the state is that of a vehicle in the open, and nothing measures the wind.
    """

    __repr__ = brief_repr

    name: str
    sha256: str
    time: Array
    inputs: Array
    derivatives: Records
    wrench: Array
    height: Array
    live: LiveSamples | None = None
    quality: DataQuality = NOTHING_TO_SAY
    file: str = ""
    air: str = ASSUMED
    flight: Flight | None = None
    recording: Recording | None = None
    state: tuple[float, float] = (0.0, 0.0)
    state_noise: tuple[float, float, float] | None = None
    wind_unknown: bool = False

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together, in the words of `quadpi_core.array_checks`."""
        with named_in(f"flight {self.name}"):
            time = array_checks.floats("time", self.time, finite=False)
            object.__setattr__(self, "time", time)
            object.__setattr__(self, "height", _like(time, "height", self.height))
            for name, checked in _checked(time, self.inputs, self.derivatives, self.wrench).items():
                object.__setattr__(self, name, checked)
            if self.live is not None:
                inputs, derivatives, wrench, known = array_checks.instance("live", self.live, LiveSamples)
                known = array_checks.flags("live.known", known, rows=len(time), of="time")
                live = LiveSamples(**_checked(time, inputs, derivatives, wrench, "live."), known=known)
                object.__setattr__(self, "live", live)

    def require_finite(self) -> None:
        """Refuse samples that no model can be fitted to or judged on.

        Raises:
            ModelError: naming the flight and the first of them.
        """
        # By field: what lies between the fields means nothing.
        moving = [self.derivatives[name] for name in self.derivatives.dtype.names or ()]
        samples = np.column_stack((self.time, self.inputs, *moving, self.wrench))
        finite = np.asarray(np.isfinite(samples).all(axis=1))
        if not finite.all():
            raise ModelError(
                f"{self.name}: {np.sum(~finite)} of {len(finite)} samples are not finite, "
                f"the first is sample {np.argmin(finite)}"
            )

    def unfit(self, shortest_s: float, *, keep_flawed: bool) -> str | None:
        """Why no model should learn from it, as one that lasts less than `shortest_s`; None if one may."""
        aloft_s = float(self.time[-1] - self.time[0])
        if self.quality.flaw is not None and not keep_flawed:
            return str(self.quality.flaw)
        if aloft_s < shortest_s:
            return f"{aloft_s:.2g} s in the air, of {shortest_s:g} s that this kind of model needs"
        return None

    @property
    def states(self) -> Flight:
        """The states; ArgumentError for a flight that was made of input vectors."""
        if self.flight is None:
            raise ArgumentError(f"flight {self.name}: was made of input vectors and has no states")
        return self.flight

    @classmethod
    def from_flight(
        cls, flight: Flight, vehicle: Vehicle, sha256: str, live: LiveSamples | None = None
    ) -> PreparedFlight:
        """Prepare a flight whose signals have passed the low-pass of its model."""
        return cls(
            name=flight.name,
            sha256=sha256,
            time=flight.time,
            inputs=flight_inputs(flight, vehicle),
            derivatives=flight_derivatives(flight),
            wrench=measured_wrench(flight, vehicle),
            height=-flight.position[:, 2],
            live=live,
            quality=flight.quality,
            flight=flight,
        )

    def in_air(self, density: float, vehicle: Vehicle, told_by: str = MEASURED) -> PreparedFlight:
        """The flight in air of a density [kg/m³], other than the vehicle file says."""

        def moved(derivatives: Records) -> Records:
            derivatives = derivatives.copy()
            derivatives["density_excess"] = density / vehicle.air_density_kg_m3 - 1.0
            return derivatives

        live = None if self.live is None else self.live._replace(derivatives=moved(self.live.derivatives))
        ratio = density / vehicle.air_density_kg_m3
        flight = None if self.flight is None else replace(self.flight, air_ratio=ratio)
        return replace(self, derivatives=moved(self.derivatives), live=live, air=told_by, flight=flight)

    @property
    def judged(self) -> LiveSamples:
        """Samples on which the alarm is calibrated."""
        if self.live is not None:
            return self.live
        known = np.ones(len(self.time), dtype=np.bool_)
        return LiveSamples(self.inputs, self.derivatives, self.wrench, known)


def _like(time: Array, name: str, values: Any, *columns: int) -> Array:
    return array_checks.floats(name, values, *columns, rows=len(time), of="time", finite=False)


def _checked(time: Array, inputs: Any, derivatives: Any, wrench: Any, where: str = "") -> dict[str, Any]:
    """The arrays that a flight and its live samples have, by name."""
    name = f"{where}derivatives"
    return {
        "inputs": _like(time, f"{where}inputs", inputs, len(INPUT_NAMES)),
        "derivatives": array_checks.records(
            name, derivatives, derivatives_like(derivatives), rows=len(time), of="time", finite=False
        ),
        "wrench": _like(time, f"{where}wrench", wrench, len(AXES)),
    }


def prepare_flights(
    paths: Path | str | Iterable[Path | str],
    vehicle: Vehicle,
    cutoff_hz: float = CUTOFF_HZ["default"],
    *,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
    keep_flawed: bool = True,
    shortest_s: float = 0.0,
    motors: Mapping[str, Motors] | None = None,
) -> list[PreparedFlight]:
    """Read, fuse and filter bags; only the part in the air is kept.

    Of a flight that pauses, see :mod:`quadpi_core.screening.flight_runs`, the longest part is used, or each
    that is long enough as a flight of its own, NAME_part1 and so on.

    Args:
        paths: bags or logs; one alone is a list of one.
        vehicle: that flew.
        cutoff_hz: of the low-pass over all signals.
        mapping: see :func:`quadpi_core.logs.read_recording`.
        workers: that read the files; the flights do not depend on them.
        left_out: the list to which flights that cannot be used are added; without it, the first is an error.
        keep_flawed: keep flights with a finding for which no model should learn from them.
        shortest_s: least time in the air of a flight.
        motors: that make the rotor speeds of a flight of its commands, by its path; else the vehicle's.

    Raises:
        ArgumentError: for what are no paths, vehicle, frequency or workers.
        LogError: for what cannot be read or used, and a flight present twice, naming the files.
        SignalError: naming the file, where the signals cannot be fused.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    array_checks.instance("vehicle", vehicle, Vehicle, LOAD_VEHICLE)
    cutoff_hz = array_checks.number("cutoff_hz", cutoff_hz, above=0.0)
    array_checks.instance("workers", workers, Workers)
    read = for_each_flight(
        _prepare,
        paths,
        shared=(vehicle, cutoff_hz, workers.found_by(mapping), motors or {}),
        task="Reading flights",
        workers=workers,
        left_out=left_out,
    )
    flights, each = [], []
    for file, found in read:
        for name, flight in found:
            part = replace(file, name=name)
            if isinstance(flight, QuadpiError):
                leave_out(part, flight, left_out)
            else:
                each.append((part, flight))
    for file, flight in once_each(each, attrgetter("sha256"), left_out):
        if (why := flight.unfit(shortest_s, keep_flawed=keep_flawed)) is None:
            flights.append(flight)
        else:
            leave_out(file, LogError(f"{file.path}: {why}"), left_out)
    require_flights_left(len(flights), left_out)
    return flights


def _prepare(task: _Task, file: FlightFile) -> list[tuple[str, PreparedFlight | QuadpiError]]:
    """The flight of a file, or each of its parts with the reason where one cannot be used, by name."""
    vehicle, cutoff_hz, mapping, motors = task
    if str(file.path) in motors:
        vehicle = replace(vehicle, motors=motors[str(file.path)])
        task = (vehicle, cutoff_hz, mapping, motors)
    parts = parts_without_pause(read_recording(file.path, vehicle, mapping))
    used = long_enough(parts) if mapping.all_parts else parts[:1]
    if len(used) == 1:
        return [(file.name, _prepared(used[0], file.name, file, task))]
    found: list[tuple[str, PreparedFlight | QuadpiError]] = []
    for number, recording in enumerate(used, 1):
        name = f"{file.name}_part{number}"
        try:
            found.append((name, _prepared(recording, name, file, task)))
        except QuadpiError as error:
            found.append((name, error))
    return found


def _prepared(recording: Recording, name: str, file: FlightFile, task: _Task) -> PreparedFlight:
    vehicle, cutoff_hz, *_ = task
    return replace(prepare_recording(replace(recording, name=name), vehicle, cutoff_hz), file=file.name)


def prepare_recording(recording: Recording, vehicle: Vehicle, cutoff_hz: float) -> PreparedFlight:
    """Check, fuse and filter a recording; only the part in the air is kept.

    Args:
        recording: streams as a log gives them.
        vehicle: that flew.
        cutoff_hz: of the low-pass over all signals.

    Raises:
        LogError: for what cannot be used, naming source and topic.
        SignalError: naming the source, where the signals cannot be fused.
    """
    given = checked(recording, vehicle)
    recording = with_slow_state(given, vehicle)
    require_streams(recording)
    causal = CausalPass.over(recording, vehicle)
    flight = fuse_airborne(recording, vehicle, cutoff_hz, causal.segments)
    live = causal.samples(vehicle, cutoff_hz, flight.stamps_ns)
    prepared = PreparedFlight.from_flight(flight, vehicle, recording_hash(recording), live)
    if (air := flown_in(recording)) is not None:
        prepared = prepared.in_air(air[0], vehicle, air[1])
    return replace(
        prepared,
        file=recording.name,
        recording=given,
        state=causal.deviation(),
        state_noise=_learned_noise(given, recording),
        wind_unknown=_wind_unknown(given, vehicle),
    )


def _wind_unknown(given: Recording, vehicle: Vehicle) -> bool:
    """Whether a flight by a slow state with velocities may have been in a wind that nothing measures."""
    return given.wind is None and vehicle.noise.wind_m_s != 0.0 and has_slow_velocity(given)


def _learned_noise(given: Recording, corrected: Recording) -> tuple[float, float, float] | None:
    """Noise of a slow state that the flight told, as its messages do not: of position, attitude, velocity."""
    if corrected is given or given.odometry is None or np.any(given.odometry.stated):
        return None
    if corrected.pose is None or corrected.twist is None:
        return None
    position, attitude = corrected.pose.deviation[0].tolist()
    return position, attitude, float(corrected.twist.deviation[0])


def read_flight(path: Path, vehicle: Vehicle, cutoff_hz: float, mapping: MappingOrOptions = None) -> Flight:
    """A flight read, fused and filtered, the part in the air; of one that pauses the longest part.

    Args:
        path: bag or log.
        vehicle: that flew.
        cutoff_hz: of the low-pass over all signals.
        mapping: see :func:`quadpi_core.logs.read_recording`.

    Raises:
        LogError: for what cannot be read or used, naming the file.
        SignalError: naming the file, where the signals cannot be fused.
    """
    recording = checked(parts_without_pause(read_recording(path, vehicle, mapping))[0], vehicle)
    recording = with_slow_state(recording, vehicle)
    air = flown_in(recording)
    return replace(
        fuse_airborne(recording, vehicle, cutoff_hz),
        sha256=recording_hash(recording),
        air_ratio=1.0 if air is None else air[0] / vehicle.air_density_kg_m3,
    )


def flight_hash(path: Path, vehicle: Vehicle, mapping: MappingOrOptions = None) -> str:
    """The hash by which a model knows a flight that it was identified on.

    Args:
        path: bag or log.
        vehicle: that flew.
        mapping: see :func:`quadpi_core.logs.read_recording`.

    Raises:
        LogError: for what cannot be read, naming the file.
    """
    return recording_hash(parts_without_pause(read_recording(path, vehicle, mapping))[0])


class LiveSamples(NamedTuple):
    """Samples as a monitor has them, on the time grid of a flight.

    Attributes:
        inputs: (N, 19) input vectors.
        derivatives: (N,) see `inputs.Derivatives`.
        wrench: (N, 6) measured, N and Nm, body axes.
        known: (N,) False where a monitor has no sample or its state has not settled; other columns are void
            there.
    """

    inputs: Array
    derivatives: Records
    wrench: Array
    known: npt.NDArray[np.bool_]

    def __repr__(self) -> str:
        return brief_repr(self)


@dataclass(frozen=True)
class CausalPass:
    """One pass of the causal filter over a recording, shared by the live samples and the smoother.

    Attributes:
        source: of the recording.
        parts: samples that estimator and pairing give the monitor.
        segments: log of the filter, where the smoother's would be the same bit by bit; else None.
    """

    source: str
    parts: Sequence[Followed]
    segments: Sequence[Segment] | None

    @classmethod
    def over(cls, recording: Recording, vehicle: Vehicle) -> CausalPass:
        """Run estimator and pairing over a recording, as a replay does.

        Raises:
            LogError: naming what is missing.
            SignalError: if the estimator never starts.
        """
        flight = recorded_flight(recording, vehicle)
        ekf = None
        if flight.has_mocap:
            ekf = Ekf(vehicle)
            ekf.log_segments(recording)
        parts = [part._replace(states=None) for part in follow(flight, vehicle, ekf)]
        segments = None if ekf is None else ekf.logged_segments()
        return cls(recording.source, parts, cls._shared(segments, recording))

    @staticmethod
    def _shared(segments: Sequence[Segment] | None, recording: Recording) -> Sequence[Segment] | None:
        """The segments, if the filter ran as the smoother's does: once, at the IMU rate of the recording.

        In flight the rate is that of the second before the start, and a change of it restarts the filter.
        """
        if segments is None or len(segments) != 1:
            return None
        return segments if segments[0].rate_hz == nominal_rate(recording.imu.time_ns) else None

    def deviation(self) -> tuple[float, float]:
        """Median deviations of the states' velocity, m/s, and attitude, rad."""
        velocity, attitude = (
            float(np.median(np.concatenate([getattr(part.deviations, name) for part in self.parts])))
            for name in ("velocity", "attitude")
        )
        return velocity, attitude

    def samples(self, vehicle: Vehicle, cutoff_hz: float, at_ns: Stamps) -> LiveSamples:
        """Live samples at the stamps (N,) of a flight, low-passed as in a replay.

        Raises:
            LogError: if no sample could be judged.
            SignalError: if the cut-off is impossible.
        """
        preparation = Preparation(vehicle, None, cutoff_hz)
        stamps, rows = [np.empty(0, dtype=np.int64)], [np.empty((0, _COLUMNS[-1] + 1))]
        for part in self.parts:
            if part.begin == SET_BACK:
                preparation.reset()
            preparation.retune(part.rate)
            preparation.fly_in(part.density)
            prepared = preparation.step(*part.samples)
            stamps.append(prepared.usable_ns)
            derivatives = prepared.derivatives.view(np.float64).reshape(-1, DERIVATIVES.itemsize // 8)
            rows.append(np.column_stack((prepared.inputs, derivatives, prepared.measured, prepared.settled)))
        time_ns, values = np.concatenate(stamps), np.concatenate(rows)
        if len(time_ns) == 0:
            raise LogError(f"{self.source}: no sample that a monitor could judge")
        values, known = interpolate(time_ns, values, at_ns, MAX_GAP_NS)
        inputs, derivatives, wrench, settled = map(np.ascontiguousarray, np.split(values, _COLUMNS, axis=1))
        known &= settled[:, 0] == 1.0
        return LiveSamples(
            inputs, derivatives.view(record_dtype(Derivatives, vehicle.rotor_count))[:, 0], wrench, known
        )
