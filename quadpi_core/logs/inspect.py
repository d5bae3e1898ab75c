# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Contents of a recording and what looks wrong with it; the recording need not have passed any check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from quadpi_core import flight
from quadpi_core.errors import LogError
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.reading_options import StreamParts, streams_by_field
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.screening.consistency import contradictions
from quadpi_core.screening.flight_runs import (
    Excerpting,
    Selection,
    StreamSurvey,
    in_order,
    survey,
    survey_quality,
)
from quadpi_core.screening.plausibility import (
    THRUST_COEFFICIENT_POSSIBLE,
    THRUST_COEFFICIENT_USUAL,
    finite_rows,
    implausibilities,
    missing_topics,
    thrust_coefficient,
)
from quadpi_core.screening.rotors_in_flight import Inertial, in_flight
from quadpi_core.screening.wild_samples import EvenRows
from quadpi_core.vehicle import Vehicle


@dataclass(frozen=True)
class Range:
    """Smallest, median and largest value of a quantity over the recording."""

    quantity: str
    unit: str
    lowest: float
    median: float
    highest: float


class LongestRun:
    """Longest run of equal rows that are added in parts; the first of equally long ones."""

    def __init__(self) -> None:
        self._count = 0
        self._start = 0
        self._longest = (0, 0)
        self._last: Array | None = None

    def add(self, rows: Array) -> None:
        """Add the next rows (N, C)."""
        if len(rows) == 0:
            return
        joined = rows if self._last is None else np.concatenate((self._last, rows))
        # Index of the second of two rows that are side by side, counted from the first of all.
        second = self._count + len(rows) - len(joined) + 1
        borders = second + np.flatnonzero(np.any(joined[1:] != joined[:-1], axis=1))
        if len(borders):
            lengths = np.diff(borders, prepend=self._start)
            longest = int(np.argmax(lengths))
            self._compare(int(borders[longest] - lengths[longest]), int(borders[longest]))
            self._start = int(borders[-1])
        self._count += len(rows)
        self._last = rows[-1:].copy()

    def longest(self) -> tuple[int, int]:
        """Index of its first row, and of its last one."""
        self._compare(self._start, self._count)
        return self._longest[0], self._longest[1] - 1

    def _compare(self, first: int, end: int) -> None:
        if end - first > self._longest[1] - self._longest[0]:
            self._longest = first, end


class RunningRange:
    """Range of a quantity that is added in parts; the median of a long flight is that of some samples."""

    def __init__(self, quantity: str, unit: str) -> None:
        self._quantity, self._unit = quantity, unit
        self._lowest, self._highest = np.inf, -np.inf
        self._known = EvenRows()

    def add(self, values: Array) -> None:
        """Add the next values (N,); those that are not finite are skipped."""
        known = values[np.isfinite(values)]
        self._known.add(known)
        self._lowest = min(self._lowest, float(known.min(initial=np.inf)))
        self._highest = max(self._highest, float(known.max(initial=-np.inf)))

    def ranges(self) -> Iterator[Range]:
        """The range; none without a value."""
        if len(self._known.rows()):
            median = float(np.median(self._known.rows()))
            yield Range(self._quantity, self._unit, self._lowest, median, self._highest)


GAP_INTERVALS = 5.0
FROZEN_S = 0.25

_JITTER_SHARE = 0.5
_FACTOR_OF_TWO_OCTAVES = 0.15
# The fastest rotors change their speed by less than a factor of two in this time.
_JUMP_NS = 20_000_000


@dataclass(frozen=True)
class TopicReport:
    """Timing of one topic, from its stamps.

    Attributes:
        jitter_ms: spread of the intervals, half the range between their 5 and 95 % quantiles.
        gaps: intervals longer than GAP_INTERVALS median ones.
        repeated, backward: stamps equal to the one before, or before it.
        not_finite: samples with a value that is not finite.
    """

    topic: str
    count: int
    duration_s: float
    rate_hz: float
    jitter_ms: float
    gaps: int
    longest_gap_s: float
    repeated: int
    backward: int
    not_finite: int


@dataclass(frozen=True)
class Inspection:
    """What a recording holds; `findings` are what looks wrong, in plain words."""

    name: str
    vehicle: str
    source: str
    topics: tuple[TopicReport, ...]
    envelope: tuple[Range, ...]
    findings: tuple[str, ...]


def inspect_recording(recording: flight.Recording, vehicle: Vehicle | None = None) -> Inspection:
    """Describe a recording; without a vehicle, what depends on its limits is not judged."""
    return inspect_blocks(lambda: iter((recording,)), vehicle)


def inspect_blocks(
    blocks: Callable[[], Iterator[flight.Recording]], vehicle: Vehicle | None = None
) -> Inspection:
    """Describe a recording that comes in at least one block.

    Args:
        blocks: gives them from the first on; they are read twice.
        vehicle: that flew; without one what depends on its limits is not judged.
    """
    # Unchecked numbers may overflow, which shows as a finding.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _inspect(blocks, vehicle)


def _inspect(blocks: Callable[[], Iterator[flight.Recording]], vehicle: Vehicle | None) -> Inspection:
    streams = survey(blocks, vehicle)
    timings = {name: _timing(stream.topic, stream.stored_ns) for name, stream in streams.items()}
    excerpting = Excerpting({name: stream.time_ns for name, stream in streams.items()})
    summaries = {name: _Summary() for name in streams}
    usable = Selection({name: stream.usable for name, stream in streams.items()})
    values = {name: flight.ValueCheck(stream.topic) for name, stream in streams.items()}

    battery = StreamParts(flight.BatteryStream)

    def summarised() -> Iterator[flight.Recording]:
        for block in blocks():
            if block.battery is not None:
                battery.extend(block.battery)
            for name, stream in streams_by_field(block).items():
                summaries[name].add(stream)
            yield block

    for used in in_order(summarised(), streams):
        excerpting.add(used)
        for name, stream in streams_by_field(usable.of(used)).items():
            values[name].add(stream)
    recording = excerpting.finish()
    if recording.battery is not None:
        recording = replace(recording, battery=cast("flight.BatteryStream", battery.whole()))
    topics = tuple(replace(timings[name], not_finite=summaries[name].not_finite) for name in streams)
    start_ns = int(streams["imu"].stored_ns[0]) if len(streams["imu"].stored_ns) else 0
    findings = (
        *(finding for topic in topics for finding in _timing_findings(topic)),
        *implausibilities(recording, vehicle, {stream.topic: stream.beyond for stream in streams.values()}),
        *(f"topic {one.topic}: {said}" for one in streams.values() if (said := one.order.problem())),
        *map(str, (*recording.quality.breaks, *recording.quality.used, *recording.quality.left_out)),
        *(f"{said}; `import` and `identify` do" for said in survey_quality(streams).sentences()),
        *(
            finding
            for name in streams
            for finding in _frozen_findings(streams[name], summaries[name], start_ns)
        ),
        *_rotor_findings(recording, vehicle),
        *_inconsistencies(excerpting.without(recording, streams), vehicle, streams, values),
        *_battery_findings(recording),
        *missing_topics(recording),
    )
    return Inspection(
        name=recording.name,
        vehicle=recording.vehicle,
        source=recording.source,
        topics=topics,
        envelope=tuple(_envelope(summaries, recording)),
        findings=findings,
    )


def with_names_of_bag(inspection: Inspection, names: Mapping[str, str]) -> Inspection:
    """Name topics as in the bag, instead of by the streams that their messages become.

    Args:
        inspection: of a recording that was read from a bag.
        names: topics of the bag by those of the streams; one may become several streams.
    """
    topics: dict[str, TopicReport] = {}
    for report in inspection.topics:
        name = names.get(report.topic, report.topic)
        first = topics.get(name)
        not_finite = report.not_finite + (first.not_finite if first else 0)
        topics[name] = replace(first or report, topic=name, not_finite=not_finite)

    def renamed(finding: str) -> str:
        about, colon, rest = finding.partition(":")
        stream = about.removeprefix("topic ")
        return f"topic {names[stream]}{colon}{rest}" if stream != about and stream in names else finding

    findings = tuple(dict.fromkeys(map(renamed, inspection.findings)))
    return replace(inspection, topics=tuple(topics.values()), findings=findings)


def _inconsistencies(
    excerpt: flight.Recording,
    vehicle: Vehicle | None,
    streams: Mapping[str, StreamSurvey],
    values: Mapping[str, flight.ValueCheck],
) -> Iterator[str]:
    """Findings of the consistency check, on the recording as `import` would convert it."""
    try:
        for name, stream in streams.items():
            flight.check_stamps(stream.topic, stream.usable_ns)
            values[name].finish()
    except LogError:
        return
    yield from map(str, contradictions(excerpt, vehicle))


def inspect_topics(path: Path, stamps: Mapping[str, flight.Stamps]) -> Inspection:
    """Describe the timing of the topics of a log without `imu`, such as a bag that `quadpi replay` wrote."""
    return Inspection(
        name=path.stem,
        vehicle="",
        source=str(path),
        topics=tuple(_timing(topic, stamps_ns) for topic, stamps_ns in stamps.items()),
        envelope=(),
        findings=("no topic imu: rules out identification, prediction and replay",),
    )


def _timing(topic: str, time_ns: flight.Stamps) -> TopicReport:
    """Of values that are not finite nothing is known here."""
    steps = np.diff(time_ns) * 1e-9
    forward = steps[steps > 0.0]
    median = float(np.median(forward)) if len(forward) else 0.0
    gaps = forward[forward > GAP_INTERVALS * median]
    quantiles = np.percentile(forward, [5.0, 95.0]) if len(forward) else np.zeros(2)
    duration = float(np.ptp(time_ns) * 1e-9) if len(time_ns) else 0.0
    return TopicReport(
        topic=topic,
        count=len(time_ns),
        duration_s=duration,
        rate_hz=(len(time_ns) - 1) / duration if duration > 0.0 else 0.0,
        jitter_ms=float(0.5e3 * np.diff(quantiles)[0]),
        gaps=len(gaps),
        longest_gap_s=float(forward.max(initial=0.0)),
        repeated=int(np.sum(steps == 0.0)),
        backward=int(np.sum(steps < 0.0)),
        not_finite=0,
    )


class _Summary:
    """Running summary of the values of a topic that is added in parts.

    Attributes:
        count: of samples.
        not_finite: number of samples with a value that is not finite.
        runs: by the name of a quantity, how long it stays the same.
        ranges: of quantities that show what was flown.
    """

    def __init__(self) -> None:
        self.count = self.not_finite = 0
        self.runs: dict[str, LongestRun] = {}
        self.ranges: dict[str, RunningRange] = {}

    def add(self, stream: flight.Stream) -> None:
        """Add the next samples."""
        columns = _columns(stream)
        self.count += len(stream)
        if len(stream):
            self.not_finite += int(np.sum(~finite_rows(*columns.values())))
        if isinstance(stream, flight.RotorSpeedStream):
            columns = {}  # rotors may stand; those that read the same in flight are judged with the IMU
        lacking = _not_measured(stream)
        for name, values in columns.items():
            if name not in lacking:
                self.runs.setdefault(name, LongestRun()).add(values)
        for quantity, unit, values in _quantities(stream):
            self.ranges.setdefault(quantity, RunningRange(quantity, unit)).add(values)


def _columns(stream: flight.Stream) -> dict[str, Array]:
    """Measured columns (N, C) by field name, without stamps, masks of axes and stated noise."""
    names = [column.name for column in fields(stream) if column.name != "deviation"]
    columns = {name: getattr(stream, name) for name in names}
    return {name: values for name, values in columns.items() if values.dtype.kind == "f"}


def _not_measured(stream: flight.Stream) -> set[str]:
    """Parts of a state that have no values in any sample."""
    if not isinstance(stream, flight.OdometryStream | flight.PoseStream):
        return set()
    parts = ("position", "attitude", "velocity")[: stream.deviation.shape[1]]
    lacking = np.all(stream.deviation < 0.0, axis=0) & (len(stream) > 0)
    return {part for part, absent in zip(parts, lacking, strict=True) if absent}


def _timing_findings(topic: TopicReport) -> Iterator[str]:
    where = f"topic {topic.topic}:"
    if topic.count == 0:
        yield f"{where} holds no samples"
    if topic.repeated:
        yield f"{where} {topic.repeated} stamps repeat"
    if topic.backward:
        yield f"{where} {topic.backward} stamps run backward"
    if topic.not_finite:
        yield f"{where} {topic.not_finite} samples hold a value that is not finite"
    if topic.gaps:
        yield f"{where} gaps: {topic.gaps}, the longest {topic.longest_gap_s * 1e3:.0f} ms"
    if topic.rate_hz > 0.0 and topic.jitter_ms * 1e-3 > _JITTER_SHARE / topic.rate_hz:
        yield f"{where} stamps jitter by ±{topic.jitter_ms:.1f} ms: times of arrival, not of measurement?"


def _frozen_findings(stream: StreamSurvey, summary: _Summary, start_ns: int) -> Iterator[str]:
    """Findings on quantities that stay the same for longer than FROZEN_S, by the time since `start_ns`."""
    if len(stream.stored_ns) == 0:
        return
    for name, run in summary.runs.items():
        first, last = run.longest()
        since, seconds = (
            float(ns) * 1e-9 for ns in np.diff(stream.stored_ns[[first, last]], prepend=start_ns)
        )
        if seconds > FROZEN_S:
            yield (
                f"topic {stream.topic}: sample {first}: {name} stays the same for {seconds:.2f} s, "
                f"from {since:.2f} s on: frozen?"
            )


def _rotor_findings(recording: flight.Recording, vehicle: Vehicle | None) -> Iterator[str]:
    if recording.rotor_speeds is None:
        return
    yield from _half_reading_findings(recording.rotor_speeds, recording)
    coefficient = thrust_coefficient(recording, vehicle) if vehicle is not None else None
    (low, high), (least, most) = THRUST_COEFFICIENT_USUAL, THRUST_COEFFICIENT_POSSIBLE
    if coefficient is not None and (least < coefficient <= low or high <= coefficient < most):
        yield (
            f"topic rotor_speeds: thrust over Σω² gives C_T = {coefficient:.2g}, usual are {low} to {high}: "
            f"speeds {'too low' if coefficient > high else 'too high'} by a constant factor, or wrong mass?"
        )


def _half_reading_findings(rotors: flight.RotorSpeedStream, recording: flight.Recording) -> Iterator[str]:
    """A rotor that reads half of the others, or whose reading halves and doubles between samples, in flight.

    A rotor cannot change its speed by a factor of two within one short interval; a sensor that misses every
    other pulse does.
    """
    inertial = Inertial.from_recording(recording)
    known = finite_rows(rotors.speeds) & np.all(rotors.speeds > 0.0, axis=1)
    inertial = inertial.at(np.isfinite(inertial.lift))
    if not np.any(known) or not len(inertial.time_ns):
        return
    time_ns, speeds = rotors.time_ns[known], rotors.speeds[known]
    flying = in_flight(time_ns, speeds, inertial, STANDARD_GRAVITY)
    if flying is None or np.count_nonzero(flying) < 2:
        return
    steps = np.diff(time_ns)
    soon = flying[1:] & flying[:-1] & (steps > 0) & (steps <= _JUMP_NS)
    jumps = _factor_of_two(speeds[1:][soon] / speeds[:-1][soon]).sum(axis=0)
    for index, column in enumerate(speeds[flying].T):
        where = f"topic rotor_speeds: rotor {index + 1}"
        others = np.median(np.delete(speeds[flying], index, axis=1), axis=1)
        ratio = np.median(column / others)
        if _factor_of_two(ratio):
            kind = "half" if ratio < 1.0 else "double"
            yield f"{where} reads {ratio:.2f} times the others: {kind}-reading sensor?"
        elif jumps[index]:
            yield f"{where} halves or doubles within one interval, {jumps[index]} times: half-reading sensor?"


def _factor_of_two(ratio: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether ratios are near a half or near two."""
    return np.abs(np.abs(np.log2(ratio)) - 1.0) < _FACTOR_OF_TWO_OCTAVES


def _battery_findings(recording: flight.Recording) -> Iterator[str]:
    if recording.battery is not None and len(recording.battery) > 1:
        volts = recording.battery.voltage
        if np.all(volts == volts[0]):
            yield f"battery: the voltage is constant at {volts[0]:.3g} V: not measured?"


def _envelope(summaries: Mapping[str, _Summary], recording: flight.Recording) -> Iterator[Range]:
    shown: dict[str, RunningRange] = {}
    for name in ("odometry", "pose", "imu", "rotor_speeds"):
        for quantity, running in summaries[name].ranges.items() if name in summaries else ():
            # Of motion capture beside a state, what the state lacks.
            if summaries[name].count:
                shown.setdefault(quantity, running)
    for running in shown.values():
        yield from running.ranges()
    if recording.battery is not None:
        battery = RunningRange("battery", "V")
        battery.add(recording.battery.voltage)
        yield from battery.ranges()


def _quantities(stream: flight.Stream) -> Iterator[tuple[str, str, Array]]:
    """Name, unit and values (N,) of the quantities that describe the flown envelope."""
    lacking = _not_measured(stream)
    if isinstance(stream, flight.OdometryStream) and "velocity" not in lacking:
        yield "speed", "m/s", np.linalg.norm(stream.velocity, axis=1)
    if isinstance(stream, flight.OdometryStream | flight.PoseStream):
        if "position" not in lacking:
            yield "altitude", "m", -stream.position[:, 2]
        if "attitude" not in lacking:
            tilt = np.degrees(np.arccos(np.clip(rotation_matrix(stream.attitude)[:, 2, 2], -1.0, 1.0)))
            yield "tilt", "deg", tilt
    elif isinstance(stream, flight.ImuStream):
        for axis, name in enumerate("pqr"):
            yield f"rate {name}", "rad/s", stream.angular_velocity[:, axis]
        yield "specific force", "m/s²", np.linalg.norm(stream.specific_force, axis=1)
    elif isinstance(stream, flight.RotorSpeedStream):
        for index, column in enumerate(stream.speeds.T):
            yield f"rotor {index + 1}", "rad/s", column
