# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording holds and what looks wrong with it; takes recordings that no check has passed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from quadpi_core.consistency.check import findings as inconsistencies
from quadpi_core.errors import LogError
from quadpi_core.flight import Recording, RotorSpeedStream, Stamps, Stream
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.logs.bags import bag_topics
from quadpi_core.logs.missing import missing
from quadpi_core.logs.plausibility import (
    THRUST_COEFFICIENT_POSSIBLE,
    THRUST_COEFFICIENT_USUAL,
    finite_rows,
    implausibilities,
    thrust_coefficient,
)
from quadpi_core.logs.screening import left_out, screened
from quadpi_core.vehicle import Vehicle

GAP_INTERVALS = 5.0
FROZEN_S = 0.25

_JITTER_SHARE = 0.5
_FACTOR_OF_TWO_OCTAVES = 0.15


@dataclass(frozen=True)
class TopicReport:
    """Timing of one topic, from its stamps.

    Attributes:
        jitter_ms: spread of the intervals, half the range between their 5 and 95 % quantiles.
        gaps: intervals longer than GAP_INTERVALS median ones.
        repeated, backward: stamps equal to the one before, or before it.
        not_finite: samples with a value that is no number.
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
class Range:
    """Smallest, median and largest value of a quantity over the recording."""

    quantity: str
    unit: str
    lowest: float
    median: float
    highest: float


@dataclass(frozen=True)
class Inspection:
    """What a recording holds; `findings` are what looks wrong, in plain words."""

    name: str
    vehicle: str
    source: str
    topics: tuple[TopicReport, ...]
    envelope: tuple[Range, ...]
    findings: tuple[str, ...]


def inspect_recording(recording: Recording, vehicle: Vehicle | None = None) -> Inspection:
    """Describe a recording; without a vehicle, what depends on its limits is not judged."""
    # Of numbers without bound: what overflows shows as such.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _inspect(recording, vehicle)


def _inspect(recording: Recording, vehicle: Vehicle | None) -> Inspection:
    topics = tuple(_describe(stream) for stream in recording.streams())
    findings = (
        *(finding for topic in topics for finding in _timing_findings(topic)),
        *implausibilities(recording, vehicle),
        *(f"{samples}; `import` and `identify` do" for samples in left_out(recording, vehicle)),
        *(finding for stream in recording.streams() for finding in _frozen_findings(stream)),
        *_rotor_findings(recording, vehicle),
        *_inconsistencies(recording, vehicle),
        *_battery_findings(recording),
        *missing(recording),
    )
    return Inspection(
        name=recording.name,
        vehicle=recording.vehicle,
        source=recording.source,
        topics=topics,
        envelope=tuple(_envelope(recording)),
        findings=findings,
    )


def with_names_of_bag(inspection: Inspection, names: Mapping[str, str]) -> Inspection:
    """Call topics what they are called in the bag, instead of the streams that their messages become.

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


def _inconsistencies(recording: Recording, vehicle: Vehicle | None) -> Iterator[str]:
    """What the consistency check says; it takes what `import` would have made of the recording."""
    used = screened(recording, vehicle)
    try:
        used.check()
    except LogError:
        return
    yield from map(str, inconsistencies(used, vehicle))


def inspect_topics(bag: Path) -> Inspection:
    """Describe the timing of every topic of a bag without `imu`, such as one that `quadpi replay` wrote.

    Raises:
        LogError: for a bag that cannot be read.
    """
    return Inspection(
        name=bag.stem,
        vehicle="",
        source=str(bag),
        topics=tuple(_timing(topic.name, topic.stamps_ns) for topic in bag_topics(bag)),
        envelope=(),
        findings=("no topic imu: rules out identification, prediction and replay",),
    )


def _describe(stream: Stream) -> TopicReport:
    not_finite = int(np.sum(~finite_rows(*_columns(stream).values()))) if len(stream) else 0
    return _timing(stream.topic, stream.time_ns, not_finite)


def _timing(topic: str, time_ns: Stamps, not_finite: int = 0) -> TopicReport:
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
        not_finite=not_finite,
    )


def _columns(stream: Stream) -> dict[str, Array]:
    """What was measured (N, C), by the name of the field; neither stamps nor the axes that a sample is in."""
    columns = {column.name: getattr(stream, column.name) for column in fields(stream)}
    return {name: values for name, values in columns.items() if values.dtype.kind == "f"}


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


def _frozen_findings(stream: Stream) -> Iterator[str]:
    """Quantities that stay the same for longer than FROZEN_S; each rotor is a sensor of its own."""
    if len(stream) == 0:
        return
    quantities = _columns(stream)
    if isinstance(stream, RotorSpeedStream):
        quantities = {f"rotor {i + 1}": column[:, np.newaxis] for i, column in enumerate(stream.speeds.T)}
    for name, values in quantities.items():
        first, last = _longest_run(values)
        seconds = float(stream.time_ns[last] - stream.time_ns[first]) * 1e-9
        if seconds > FROZEN_S:
            yield f"topic {stream.topic}: sample {first}: {name} stays the same for {seconds:.2f} s: frozen?"


def _longest_run(values: Array) -> tuple[int, int]:
    """First and last index of the longest run of equal rows of `values` (N, C)."""
    borders = np.flatnonzero(np.r_[True, np.any(values[1:] != values[:-1], axis=1), True])
    longest = int(np.argmax(np.diff(borders)))
    return int(borders[longest]), int(borders[longest + 1]) - 1


def _rotor_findings(recording: Recording, vehicle: Vehicle | None) -> Iterator[str]:
    rotors = recording.rotor_speeds
    if rotors is None:
        return
    yield from _half_reading_findings(rotors)
    coefficient = thrust_coefficient(recording, vehicle) if vehicle is not None else None
    (low, high), (least, most) = THRUST_COEFFICIENT_USUAL, THRUST_COEFFICIENT_POSSIBLE
    if coefficient is not None and (least < coefficient <= low or high <= coefficient < most):
        yield (
            f"topic rotor_speeds: thrust over Σω² gives C_T = {coefficient:.2g}, usual are {low} to {high}: "
            f"speeds {'too low' if coefficient > high else 'too high'} by a constant factor, or wrong mass?"
        )


def _half_reading_findings(rotors: RotorSpeedStream) -> Iterator[str]:
    """A rotor that reads half of the others, or whose reading halves and doubles between samples.

    A rotor cannot change its speed by a factor of two within one interval; a sensor that misses every
    other pulse does.
    """
    speeds = rotors.speeds[finite_rows(rotors.speeds)]
    speeds = speeds[np.all(speeds > 0.0, axis=1)]
    if len(speeds) < 2:
        return
    for index, column in enumerate(speeds.T):
        where = f"topic rotor_speeds: rotor {index + 1}"
        others = np.median(np.delete(speeds, index, axis=1), axis=1)
        ratio = np.median(column / others)
        jumps = _factor_of_two(column[1:] / column[:-1]).sum()
        if _factor_of_two(ratio):
            kind = "half" if ratio < 1.0 else "double"
            yield f"{where} reads {ratio:.2f} times the others: {kind}-reading sensor?"
        elif jumps:
            yield f"{where} halves or doubles within one interval, {jumps} times: half-reading sensor?"


def _factor_of_two(ratio: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Whether ratios are near a half or near two."""
    return np.abs(np.abs(np.log2(ratio)) - 1.0) < _FACTOR_OF_TWO_OCTAVES


def _battery_findings(recording: Recording) -> Iterator[str]:
    if recording.battery_v is not None and len(recording.battery_v[1]) > 1:
        volts = recording.battery_v[1]
        if np.all(volts == volts[0]):
            yield f"battery: the voltage is constant at {volts[0]:.3g} V: not measured?"


def _envelope(recording: Recording) -> Iterator[Range]:
    imu, rotors = recording.imu, recording.rotor_speeds
    state = recording.odometry or recording.pose
    if recording.odometry is not None:
        yield from _range("speed", "m/s", np.linalg.norm(recording.odometry.velocity, axis=1))
    if state is not None:
        yield from _range("altitude", "m", -state.position[:, 2])
        tilt = np.degrees(np.arccos(np.clip(rotation_matrix(state.attitude)[:, 2, 2], -1.0, 1.0)))
        yield from _range("tilt", "deg", tilt)
    for axis, name in enumerate("pqr"):
        yield from _range(f"rate {name}", "rad/s", imu.angular_velocity[:, axis])
    yield from _range("specific force", "m/s²", np.linalg.norm(imu.specific_force, axis=1))
    if rotors is not None:
        for index, column in enumerate(rotors.speeds.T):
            yield from _range(f"rotor {index + 1}", "rad/s", column)
    if recording.battery_v is not None:
        yield from _range("battery", "V", recording.battery_v[1])


def _range(quantity: str, unit: str, values: Array) -> Iterator[Range]:
    known = values[np.isfinite(values)]
    if len(known):
        yield Range(quantity, unit, float(known.min()), float(np.median(known)), float(known.max()))
