# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of a recording: those without a pause, and those that were asked for by time.

Nothing is interpolated, integrated or filtered across a pause of more than MAX_GAP_NS. Of a recording with
such pauses of the IMU or (without motion capture) the state, one part in between is used. Where the rotor
speeds pause the state is still estimated: :func:`quadpi_core.estimator.fusion.fuse` leaves out samples alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.findings import PAUSES, Break, DataQuality, UsedPart
from quadpi_core.flight import MAX_GAP_NS, STREAM_KINDS, Recording, Stamps, Stream
from quadpi_core.reading_options import WHOLE, Column, TimeRange, all_by_field, join_blocks, streams_by_field
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.screening.excerpt import needed_spans
from quadpi_core.screening.sample_order import (
    Judged,
    Mask,
    Rows,
    faults,
    order_of,
    order_quality,
    used_rows,
    with_rows,
)
from quadpi_core.screening.wild_samples import FEW_SAMPLES, Beyond, Screening, left_out, usable_samples
from quadpi_core.signals.chain import nominal_rate
from quadpi_core.vehicle import Vehicle

# So many poses within this time give a velocity by a line; of a slower source the estimator takes several.
START_POSES, START_NS = 5, 200_000_000
SELDOM = Threshold(
    name="rate below which pauses of a topic are its rate, over that at which it has none",
    value=1.2,
    unit="1",
    reason="stamps jitter by a tenth of the step and more; a topic that is faster and pauses loses samples",
    data=CONVENTION,
)
# Of what corrects the estimator, the lowest rate; of topics that are interpolated, one without a pause.
CORRECTED_HZ, BRIDGED_HZ = 0.9, SELDOM.value * 1e9 / MAX_GAP_NS
_BRIDGED = "nothing is interpolated across 0.1 s"
_CORRECTS = "in longer pauses an estimate drifts by more than a model could use"
_USES = "identification, prediction and replay"


def seldom(topic: str, rate_hz: float, needed_hz: float, reason: str, remedies: Mapping[str, str]) -> str:
    """The sentence on a topic that comes too seldom."""
    remedy = f"; {remedies[topic]}" if remedies.get(topic) else ""
    needed = f"which need {needed_hz:g} Hz or more ({reason}){remedy}"
    return f"{topic} at {rate_hz:.3g} Hz: rules out {_USES}, {needed}"


def is_slow_state(stream: Stream) -> bool:
    """Whether states come too seldom to be interpolated; those that are no slower correct the estimator."""
    return len(stream) > 1 and nominal_rate(stream.time_ns) < BRIDGED_HZ


def seldom_topics(recording: Recording) -> Iterator[str]:
    """On topics that come too seldom for a model: rotor speeds, and the state or motion capture."""
    mocap = recording.pose or recording.twist
    if mocap is not None and len(mocap) > 1:
        yield from _seldom_state(mocap, recording.remedies)
    speeds, state = recording.rotor_speeds, None if mocap is not None else recording.odometry
    if speeds is not None and np.any(np.diff(speeds.time_ns) > MAX_GAP_NS):
        rate_hz = nominal_rate(speeds.time_ns)
        if rate_hz < BRIDGED_HZ:
            yield seldom(speeds.topic, rate_hz, BRIDGED_HZ, _BRIDGED, recording.remedies)
    if state is not None and len(state) > 1:
        yield from _seldom_state(state, recording.remedies)


def _seldom_state(stream: Stream, remedies: Mapping[str, str]) -> Iterator[str]:
    rate_hz = nominal_rate(stream.time_ns)
    if rate_hz < CORRECTED_HZ:
        yield seldom(stream.topic, rate_hz, CORRECTED_HZ, _CORRECTS, remedies)


class RunningRates:
    """Mean rates of the topics of a recording in blocks, to explain why nothing came of it."""

    def __init__(self) -> None:
        self._spans: dict[str, tuple[int, int, int]] = {}
        self._remedies: Mapping[str, str] = {}

    def add(self, block: Recording) -> None:
        """Take the next block."""
        self._remedies = block.remedies
        for stream in block.streams():
            if len(stream):
                first, _, count = self._spans.get(stream.topic, (int(stream.time_ns[0]), 0, 0))
                self._spans[stream.topic] = first, int(stream.time_ns[-1]), count + len(stream)

    def seldom(self) -> Iterator[str]:
        """On topics that come too seldom, by their mean rates."""
        mocap = [topic for topic in self._spans if topic.startswith("mocap/")][:1]
        needs = dict.fromkeys([*mocap, *([] if mocap else ["odometry"])], (CORRECTED_HZ, _CORRECTS))
        needs["rotor_speeds"] = BRIDGED_HZ, _BRIDGED
        for topic, (needed_hz, reason) in needs.items():
            first_ns, last_ns, count = self._spans.get(topic, (0, 0, 0))
            if count > 1 and last_ns > first_ns:
                rate_hz = 1e9 * (count - 1) / (last_ns - first_ns)
                if rate_hz < needed_hz:
                    yield seldom(topic, rate_hz, needed_hz, reason, self._remedies)


PART_S = Threshold(
    name="shortest part of a flight that is used as a flight of its own",
    value=3.0,
    unit="s",
    reason="a second starts the estimator, and the low-pass takes half a second at either end: of a shorter "
    "part less than half is left",
    data=CONVENTION,
)

ASKED_FOR = "the part asked for"

Interval = tuple[int, int]


def cut(recording: Recording, first_ns: int, last_ns: int) -> Recording:
    """The samples stamped from the first instant to the last, both included."""
    streams = all_by_field(recording)
    within = {name: (one.time_ns >= first_ns) & (one.time_ns <= last_ns) for name, one in streams.items()}
    return with_rows(recording, within)


def in_range(recording: Recording, part: TimeRange) -> Recording:
    """The part of a recording that was asked for; its `quality` says so.

    Raises:
        LogError: if the IMU has no sample in it.
    """
    if part.is_whole or len(recording.imu) == 0:
        return recording
    imu_ns = recording.imu.time_ns
    within = cut(recording, *part.stamps(int(imu_ns[0])))
    require_imu_in(recording.source, part, len(within.imu), float(1e-9 * (imu_ns[-1] - imu_ns[0])))
    used = used_part(imu_ns, within.imu.time_ns, ASKED_FOR)
    return replace(_without_empty(within), quality=within.quality.joined(DataQuality(used=(used,))))


def _without_empty(recording: Recording) -> Recording:
    """A part without the topics that have no sample in it."""
    absent: dict[str, Any] = {n: None for n, one in all_by_field(recording).items() if len(one) == 0}
    return replace(recording, **absent)


def require_imu_in(source: str, part: TimeRange, samples: int, length_s: float) -> None:
    """Refuse a part without a sample of the IMU with a LogError that says how long the recording is."""
    if samples == 0:
        raise LogError(f"{source}: topic imu: has no sample {part}: it ends at {length_s:.3f} s")


def used_part(whole_ns: Stamps, part_ns: Stamps, reason: str) -> UsedPart:
    """What a part is of a recording, by the stamps of the IMU in both."""
    start_ns, end_ns = whole_ns[[0, -1]].tolist()
    first_s, last_s = (1e-9 * (stamp - start_ns) for stamp in part_ns[[0, -1]].tolist())
    return UsedPart(first_s, last_s, len(part_ns), 1e-9 * (end_ns - start_ns), reason)


def in_range_of_blocks(blocks: Iterable[Recording], source: str, part: TimeRange) -> Iterator[Recording]:
    """:func:`in_range` of blocks by arrival; times count from the first IMU sample that came."""
    if part.is_whole:
        yield from blocks
        return
    bounds: Interval | None = None
    samples, start_ns, last_ns = 0, 0, 0
    for block in blocks:
        imu_ns = block.imu.time_ns
        if len(imu_ns):
            last_ns = int(imu_ns[-1])
            if bounds is None:
                # The flight begins with the first stamp that is used.
                rows = order_of(imu_ns).runs()[0]
                start_ns = int(imu_ns[rows[0]] if len(rows) else imu_ns[0])
                bounds = part.stamps(start_ns)
        if bounds is not None:
            within = cut(block, *bounds)
            samples += len(within.imu)
            yield within
    require_imu_in(source, part, samples, 1e-9 * (last_ns - start_ns))


def parts_without_pause(recording: Recording) -> list[Recording]:
    """The parts of a recording between pauses, the longest first; itself where it has none, or nothing else.

    `quality` of each says where the topics pause, and what is used.
    """
    needed: list[Stream] = [recording.imu]
    state = recording.odometry
    if recording.pose is None and recording.twist is None and state is not None and not is_slow_state(state):
        needed.append(state)
    breaks = tuple(found for stream in needed if (found := pauses(stream)) is not None)
    if not breaks or any(len(stream) < 2 for stream in needed) or any(seldom_topics(recording)):
        return [recording]
    shared = _intervals(needed[0])
    for stream in needed[1:]:
        shared = list(_common(shared, _intervals(stream)))
    shared.sort(key=lambda interval: interval[0] - interval[1])
    parts = []
    for place, interval in enumerate(shared):
        part = cut(recording, *interval)
        if len(part.imu) < 2:
            continue
        rank = "the longest" if place == 0 else f"number {place + 1} by length"
        reason = f"{rank} of {len(shared)} parts without a pause"
        used = used_part(recording.imu.time_ns, part.imu.time_ns, reason)
        quality = part.quality.joined(DataQuality(breaks=breaks, used=(used,)))
        parts.append(replace(_without_empty(part), quality=quality))
    return parts or [recording]


def long_enough(parts: Sequence[Recording]) -> list[Recording]:
    """The parts that are flights of their own: those of PART_S and more, else the longest, by time."""
    flights = [one for one in parts if one.imu.time_ns[-1] - one.imu.time_ns[0] >= 1e9 * PART_S.value]
    return sorted(flights or parts[:1], key=lambda one: int(one.imu.time_ns[0]))


def pauses(stream: Stream) -> Break | None:
    """The pauses of a topic; None of one that has none."""
    late = np.flatnonzero(np.diff(stream.time_ns) > MAX_GAP_NS)
    if len(late) == 0:
        return None
    before, after = (float(1e-9 * stream.time_ns[row]) for row in (late[0], late[0] + 1))
    return Break(stream.topic, PAUSES, len(late), int(late[0]) + 1, before, after)


def _intervals(stream: Stream) -> list[Interval]:
    """First and last stamp of each part of a topic between pauses."""
    late = np.flatnonzero(np.diff(stream.time_ns) > MAX_GAP_NS) + 1
    firsts, lasts = np.r_[0, late], np.r_[late, len(stream)] - 1
    return list(zip(stream.time_ns[firsts].tolist(), stream.time_ns[lasts].tolist(), strict=True))


def _common(ones: Sequence[Interval], others: Sequence[Interval]) -> Iterator[Interval]:
    """What two series of intervals share; each rises."""
    i = j = 0
    while i < len(ones) and j < len(others):
        first, last = max(ones[i][0], others[j][0]), min(ones[i][1], others[j][1])
        if first < last:
            yield first, last
        if ones[i][1] < others[j][1]:
            i += 1
        else:
            j += 1


# The checks of the flight as a whole use the excerpt: a whole flight with up to FEW_SAMPLES samples per
# topic, or parts spread over a longer one that include those of the consistency check.

# Parts of a long flight; together they have FEW_SAMPLES samples of its fastest topic.
PARTS = 64


@dataclass(frozen=True)
class StreamSurvey(Judged):
    """Stamps and outliers of one topic.

    Attributes:
        rows: (M,) the samples used, in order; None for all as they are.
        beyond: samples beyond limits, of those used.
        usable: (M,) mask of the samples that are not left out; None if none is.
    """

    rows: Rows | None = None
    beyond: tuple[Beyond, ...] = ()
    usable: Mask | None = None

    @property
    def time_ns(self) -> Stamps:
        """(M,) stamps of the samples used."""
        return self.stored_ns if self.rows is None else self.stored_ns[self.rows]

    @property
    def usable_ns(self) -> Stamps:
        """Stamps of the samples that are not left out."""
        return self.time_ns if self.usable is None else self.time_ns[self.usable]


def survey(
    blocks: Callable[[], Iterator[Recording]], vehicle: Vehicle | None, part: TimeRange = WHOLE
) -> dict[str, StreamSurvey]:
    """Survey each stream of a flight, by its field of the recording.

    Args:
        blocks: gives those of the flight; they are read again if samples are dropped or sorted.
        vehicle: that flew; without one rotor speeds are not judged.
        part: of the flight; the samples outside are not used.
    """
    stored: dict[str, _Stored] = {}
    screening = Screening(vehicle)
    for block in blocks():
        screening.add(block)
        for name, stream in streams_by_field(block).items():
            stored.setdefault(name, _Stored()).add(stream)
    streams = {name: stored[name].judged(kind.topic) for name, kind in STREAM_KINDS.items() if name in stored}
    rows = used_rows(streams, {})
    streams = {
        name: one if one.order.rows is None else replace(one, rows=rows[name])
        for name, one in streams.items()
    }
    if not part.is_whole and len(rows["imu"]):
        first_ns, last_ns = part.stamps(int(streams["imu"].time_ns[0]))
        for name, one in streams.items():
            within = (one.time_ns >= first_ns) & (one.time_ns <= last_ns)
            streams[name] = replace(one, rows=rows[name][within])
    if any(one.rows is not None for one in streams.values()):
        screening = Screening(vehicle)
        for block in in_order(blocks(), streams):
            screening.add(block)
    outliers = screening.finish({name: one.time_ns for name, one in streams.items()})
    return {
        name: replace(one, beyond=tuple(outliers[name]), usable=usable_samples(outliers[name]))
        for name, one in streams.items()
    }


class _Stored:
    """Stamps and faults of a topic, gathered block by block."""

    def __init__(self) -> None:
        self._stamps, self._count = Column(), 0
        self._faults: dict[str, list[Rows]] = {}

    def add(self, stream: Stream) -> None:
        self._stamps.extend(stream.time_ns)
        for fault, which in faults(stream):
            self._faults.setdefault(fault, []).append(self._count + np.flatnonzero(which))
        self._count += len(stream)

    def judged(self, topic: str) -> StreamSurvey:
        masks = {fault: np.zeros(self._count, np.bool_) for fault in self._faults}
        for fault, parts in self._faults.items():
            masks[fault][np.concatenate(parts)] = True
        time_ns = self._stamps.whole()
        return StreamSurvey(topic, time_ns, order_of(time_ns, masks))


def survey_quality(surveys: Mapping[str, StreamSurvey], part: TimeRange = WHOLE) -> DataQuality:
    """What is left out, sorted and cut off."""
    imu = surveys["imu"]
    beyond = tuple(
        one
        for stream in surveys.values()
        for one in left_out(stream.topic, stream.beyond, stream.time_ns, imu.time_ns)
    )
    used: tuple[UsedPart, ...] = ()
    if not part.is_whole and len(imu.time_ns):
        used = (used_part(imu.stored_ns[used_rows({"imu": imu}, {})["imu"]], imu.time_ns, ASKED_FOR),)
    return order_quality(surveys).joined(DataQuality(left_out=beyond, used=used))


class Selection:
    """Selects samples of a flight from its blocks.

    Args:
        rows: mask (N,) of each stream, by its field; None, or none, for all.

    Attributes:
        seen: samples of each stream in the blocks so far.
    """

    def __init__(self, rows: Mapping[str, Mask | None]) -> None:
        self._rows = rows
        self.seen: dict[str, int] = {}

    def of(self, block: Recording) -> Recording:
        """The selected samples of the next block, without arrivals."""
        taken: dict[str, Any] = {}
        for name, stream in streams_by_field(block).items():
            rows, before = self._rows.get(name), self.seen.get(name, 0)
            self.seen[name] = before + len(stream)
            taken[name] = stream if rows is None else stream.take(rows[before : self.seen[name]])
        return replace(block, **taken, arrivals={})


def in_order(blocks: Iterable[Recording], surveys: Mapping[str, StreamSurvey]) -> Iterator[Recording]:
    """The samples of a flight that are used, by rising stamps, from its blocks, and without arrivals.

    Samples wait for those that were stored later and belong before them, MAX_JUMP_BACK_NS at most.
    """
    used: dict[str, Mask] = {}
    # The earliest stamp of the samples from each one stored on.
    coming: dict[str, Stamps] = {}
    for name, stream in surveys.items():
        if stream.rows is not None:
            used[name] = np.zeros(len(stream.stored_ns), dtype=np.bool_)
            used[name][stream.rows] = True
            if stream.order.late is not None:
                stamps = np.where(used[name], stream.stored_ns, np.iinfo(np.int64).max)
                coming[name] = np.minimum.accumulate(stamps[::-1])[::-1]
    selection = Selection(used)
    waiting: dict[str, Stream] = {}
    for block in map(selection.of, blocks):
        due: dict[str, Any] = {}
        for name, earliest in coming.items():
            came = getattr(block, name)
            both = type(came).join((waiting[name], came)) if name in waiting else came
            both = both.take(np.argsort(both.time_ns, kind="stable"))
            to_come = earliest[selection.seen[name] :]
            count = int(np.searchsorted(both.time_ns, to_come[0])) if len(to_come) else len(both)
            due[name], waiting[name] = both.take(slice(0, count)), both.take(slice(count, None))
        yield replace(block, **due)


class Excerpting:
    """Collects the excerpt of a flight from its blocks.

    Args:
        stamps: (N,) of each stream of the flight, by its field.
    """

    def __init__(self, stamps: Mapping[str, Stamps]) -> None:
        self._rows = excerpt_rows(stamps)
        self._selection = Selection(self._rows)
        self._parts: list[Recording] = []

    def add(self, block: Recording) -> None:
        """Take the excerpt's part of the next block."""
        self._parts.append(self._selection.of(block))

    def finish(self) -> Recording:
        """The excerpt, without arrivals.

        Raises:
            ValueError: if there was no block.
        """
        return join_blocks(self._parts)

    def without(self, excerpt: Recording, surveys: Mapping[str, StreamSurvey]) -> Recording:
        """The excerpt without outliers."""
        usable = {}
        for name, stream in surveys.items():
            rows = self._rows[name]
            usable[name] = stream.usable if rows is None or stream.usable is None else stream.usable[rows]
        return Selection(usable).of(excerpt)


def excerpt_rows(stamps: Mapping[str, Stamps]) -> dict[str, Mask | None]:
    """Mask (N,) of the samples of each stream in the excerpt; None for all."""
    most = max(map(len, stamps.values()))
    if most <= FEW_SAMPLES or len(stamps["imu"]) == 0:
        return dict.fromkeys(stamps)
    first, last = int(stamps["imu"][0]), int(stamps["imu"][-1])
    # Unchecked stamps may run backward.
    length = max(0, int((last - first) * (FEW_SAMPLES / most) / PARTS))
    starts = np.linspace(first, last - length, PARTS).astype(np.int64).tolist()
    spans = sorted([*((start, start + length) for start in starts), *needed_spans(stamps)])
    edges: list[int] = []
    for start, end in spans:
        if edges and start <= edges[-1]:
            edges[-1] = max(edges[-1], end)
        else:
            edges += (start, end)
    rows: dict[str, Mask | None] = {}
    for name, time_ns in stamps.items():
        within = np.searchsorted(np.array(edges), time_ns, side="right") % 2 == 1
        # The ends of each stream show which time it covers.
        within[:1] = within[-1:] = True
        rows[name] = within
    return rows
