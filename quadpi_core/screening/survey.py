# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A first pass over a flight that comes in blocks finds stamps and outliers; a later one takes an excerpt.

The checks of the flight as a whole use the excerpt: a whole flight with up to FEW_SAMPLES samples per topic,
or parts spread over a longer one that include those of the consistency check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.findings import DataQuality, UsedPart
from quadpi_core.flight import STREAM_KINDS, Recording, Stamps, Stream
from quadpi_core.recording_blocks import Column, join_blocks, streams_by_field
from quadpi_core.screening.excerpt import needed_spans
from quadpi_core.screening.flight_runs import ASKED_FOR, used_part
from quadpi_core.screening.rotor_readings import RotorScreening
from quadpi_core.screening.sample_order import (
    Judged,
    Rows,
    SampleOrder,
    faults,
    order_of,
    order_quality,
    used_rows,
)
from quadpi_core.screening.wild_samples import (
    FEW_SAMPLES,
    Beyond,
    StreamScreening,
    left_out,
    usable_samples,
    with_readings,
)
from quadpi_core.time_range import WHOLE, TimeRange
from quadpi_core.vehicle import Vehicle

# Parts of a long flight; together they have FEW_SAMPLES samples of its fastest topic.
PARTS = 64


@dataclass(frozen=True)
class StreamSurvey:
    """Stamps and outliers of one topic.

    Attributes:
        topic: its name.
        stored_ns: (N,) stamps as stored.
        order: which of these samples are used, and in what order.
        rows: (M,) the samples used, in order; None for all as they are.
        found: samples beyond limits, of those used.
        usable: (M,) mask of the samples that are not left out; None if none is.
    """

    topic: str
    stored_ns: Stamps
    order: SampleOrder
    rows: Rows | None
    found: tuple[Beyond, ...] = ()
    usable: npt.NDArray[np.bool_] | None = None

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
    passes: dict[str, _FirstPass] = {}
    rotors = RotorScreening()
    for block in blocks():
        rotors.add(block)
        for name, stream in streams_by_field(block).items():
            if name not in passes:
                passes[name] = _FirstPass(type(stream), vehicle)
            passes[name].add(stream)
    judged = {name: passes[name].judged() for name in STREAM_KINDS if name in passes}
    rows = used_rows(judged, {})
    streams = {
        name: StreamSurvey(*topic, None if topic.order.rows is None else rows[name])
        for name, topic in judged.items()
    }
    if not part.is_whole and len(rows["imu"]):
        first_ns, last_ns = part.stamps(int(judged["imu"].time_ns[rows["imu"][0]]))
        for name, surveyed in streams.items():
            time_ns = surveyed.time_ns
            streams[name] = replace(surveyed, rows=rows[name][(time_ns >= first_ns) & (time_ns <= last_ns)])
    screening = {name: passes[name].screening for name in streams}
    again = {name for name, stream in streams.items() if stream.rows is not None}
    if again:
        screening |= {name: StreamScreening(STREAM_KINDS[name], vehicle) for name in again}
        rotors = RotorScreening()
        in_order = InOrder(streams)
        for block in map(in_order.of, blocks()):
            rotors.add(block)
            for name, stream in streams_by_field(block).items():
                if name in again:
                    screening[name].add(stream)
    for name, surveyed in streams.items():
        found = list(screening[name].finish())
        if name == "rotor_speeds":
            found = with_readings(found, rotors, surveyed.time_ns, streams["imu"].time_ns)
        streams[name] = replace(surveyed, found=tuple(found), usable=usable_samples(found))
    return streams


class _FirstPass:
    """What the first pass over a topic gathers."""

    def __init__(self, kind: type[Stream], vehicle: Vehicle | None) -> None:
        self._topic = kind.topic
        self._stamps = Column()
        self._count = 0
        self._faults: dict[str, list[Rows]] = {}
        self.screening = StreamScreening(kind, vehicle)

    def add(self, stream: Stream) -> None:
        """Take the next samples."""
        self._stamps.extend(stream.time_ns)
        self.screening.add(stream)
        for fault, which in faults(stream):
            self._faults.setdefault(fault, []).append(self._count + np.flatnonzero(which))
        self._count += len(stream)

    def judged(self) -> Judged:
        """The topic by the rule of the order of samples."""
        masks = {}
        for fault, parts in self._faults.items():
            masks[fault] = np.zeros(self._count, dtype=np.bool_)
            masks[fault][np.concatenate(parts)] = True
        time_ns = self._stamps.whole()
        return Judged(self._topic, time_ns, order_of(time_ns, masks))


def judged_streams(surveys: Mapping[str, StreamSurvey]) -> dict[str, Judged]:
    """What the rule of the order of samples says of each topic, by field."""
    return {name: Judged(one.topic, one.stored_ns, one.order) for name, one in surveys.items()}


def survey_quality(surveys: Mapping[str, StreamSurvey], part: TimeRange = WHOLE) -> DataQuality:
    """What is left out, sorted and cut off.

    Args:
        surveys: see :func:`survey`.
        part: see there.
    """
    beyond = tuple(
        one
        for stream in surveys.values()
        for one in left_out(stream.topic, stream.found, stream.time_ns, surveys["imu"].time_ns)
    )
    judged = judged_streams(surveys)
    used: tuple[UsedPart, ...] = ()
    if not part.is_whole and len(surveys["imu"].time_ns):
        whole_ns = judged["imu"].time_ns[used_rows({"imu": judged["imu"]}, {})["imu"]]
        used = (used_part(whole_ns, surveys["imu"].time_ns, ASKED_FOR),)
    return order_quality(judged).joined(DataQuality(left_out=beyond, used=used))


class InOrder:
    """Gives the samples of a flight that are used, by rising stamps, from its blocks.

    Samples wait for those that were stored later and belong before them, MAX_JUMP_BACK_NS at most.
    """

    def __init__(self, surveys: Mapping[str, StreamSurvey]) -> None:
        self._kept: dict[str, npt.NDArray[np.bool_]] = {}
        # The earliest stamp of the samples from each one stored on.
        self._coming: dict[str, Stamps] = {}
        for name, stream in surveys.items():
            if stream.rows is not None:
                kept = np.zeros(len(stream.stored_ns), dtype=np.bool_)
                kept[stream.rows] = True
                self._kept[name] = kept
                if stream.order.late is not None:
                    stamps = np.where(kept, stream.stored_ns, np.iinfo(np.int64).max)
                    self._coming[name] = np.minimum.accumulate(stamps[::-1])[::-1]
        self._before = dict.fromkeys(self._kept, 0)
        self._waiting: dict[str, Stream] = {}

    def of(self, block: Recording) -> Recording:
        """The samples in order after the next block, without arrivals."""
        taken: dict[str, Any] = {}
        for name, stream in streams_by_field(block).items():
            if name in self._kept:
                before = self._before[name]
                self._before[name] += len(stream)
                taken[name] = stream.take(self._kept[name][before : self._before[name]])
                if name in self._coming:
                    taken[name] = self._due(name, taken[name])
        return replace(block, **taken, arrivals={})

    def _due(self, name: str, stream: Stream) -> Stream:
        waiting = self._waiting.get(name)
        both = stream if waiting is None else type(stream).join((waiting, stream))
        both = both.take(np.argsort(both.time_ns, kind="stable"))
        left = self._coming[name][self._before[name] :]
        due = len(both) if len(left) == 0 else int(np.searchsorted(both.time_ns, left[0]))
        self._waiting[name] = both.take(slice(due, None))
        return both.take(slice(0, due))


class Selection:
    """Selects samples of a flight from its blocks.

    Args:
        rows: mask (N,) of each stream, by its field; None for all.
    """

    def __init__(self, rows: Mapping[str, npt.NDArray[np.bool_] | None]) -> None:
        self._rows = rows
        self._before = dict.fromkeys(rows, 0)

    def of(self, block: Recording) -> Recording:
        """The selected samples of the next block, without arrivals."""
        taken: dict[str, Any] = {}
        for name, stream in streams_by_field(block).items():
            rows, before = self._rows[name], self._before[name]
            self._before[name] += len(stream)
            taken[name] = stream if rows is None else stream.take(rows[before : self._before[name]])
        return replace(block, **taken, arrivals={})


def excerpt_rows(stamps: Mapping[str, Stamps]) -> dict[str, npt.NDArray[np.bool_] | None]:
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
    rows: dict[str, npt.NDArray[np.bool_] | None] = {}
    for name, time_ns in stamps.items():
        own = np.searchsorted(np.array(edges), time_ns, side="right") % 2 == 1
        # The ends of each stream show which time it covers.
        own[:1] = own[-1:] = True
        rows[name] = own
    return rows


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
