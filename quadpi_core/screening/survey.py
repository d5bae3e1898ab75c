# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A first pass over a flight that comes in blocks finds stamps and outliers; a later one takes an excerpt.

The checks of the flight as a whole use the excerpt: a whole flight with up to FEW_SAMPLES samples per topic,
or parts spread over a longer one that include those of the consistency check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quadpi_core.findings import DataQuality, UsedPart
from quadpi_core.flight import STREAM_KINDS, Recording, Stamps, Stream
from quadpi_core.reading_options import WHOLE, TimeRange
from quadpi_core.recording_blocks import Column, join_blocks, streams_by_field
from quadpi_core.screening.excerpt import needed_spans
from quadpi_core.screening.flight_runs import ASKED_FOR, used_part
from quadpi_core.screening.sample_order import (
    Judged,
    Mask,
    Rows,
    faults,
    order_of,
    order_quality,
    used_rows,
)
from quadpi_core.screening.wild_samples import FEW_SAMPLES, Beyond, Screening, left_out, usable_samples
from quadpi_core.vehicle import Vehicle

# Parts of a long flight; together they have FEW_SAMPLES samples of its fastest topic.
PARTS = 64


@dataclass(frozen=True)
class StreamSurvey(Judged):
    """Stamps and outliers of one topic.

    Attributes:
        rows: (M,) the samples used, in order; None for all as they are.
        found: samples beyond limits, of those used.
        usable: (M,) mask of the samples that are not left out; None if none is.
    """

    rows: Rows | None = None
    found: tuple[Beyond, ...] = ()
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
        name: replace(one, found=tuple(outliers[name]), usable=usable_samples(outliers[name]))
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
    """What is left out, sorted and cut off.

    Args:
        surveys: see :func:`survey`.
        part: see there.
    """
    imu = surveys["imu"]
    beyond = tuple(
        one
        for stream in surveys.values()
        for one in left_out(stream.topic, stream.found, stream.time_ns, imu.time_ns)
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
