# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A first pass over a flight that comes in blocks finds stamps and outliers; a second one takes an excerpt.

The checks of the flight as a whole use the excerpt: a whole flight with up to FEW_SAMPLES samples per topic,
or parts spread over a longer one that include those of the consistency check.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.findings import LeftOut
from quadpi_core.flight import STREAM_KINDS, Recording, Stamps
from quadpi_core.recording_blocks import Column, join_blocks, streams_by_field
from quadpi_core.screening.excerpt import needed_spans
from quadpi_core.screening.wild_samples import (
    FEW_SAMPLES,
    Beyond,
    StreamScreening,
    left_out,
    usable_samples,
)
from quadpi_core.vehicle import Vehicle

# Parts of a long flight; together they have FEW_SAMPLES samples of its fastest topic.
PARTS = 64


@dataclass(frozen=True)
class StreamSurvey:
    """Stamps and outliers of one topic.

    Attributes:
        topic: its name.
        time_ns: (N,) stamps.
        found: samples beyond limits.
        usable: (N,) mask of the samples that are not left out; None if none is.
    """

    topic: str
    time_ns: Stamps
    found: tuple[Beyond, ...]
    usable: npt.NDArray[np.bool_] | None

    @property
    def usable_ns(self) -> Stamps:
        """Stamps of the samples that are not left out."""
        return self.time_ns if self.usable is None else self.time_ns[self.usable]


def survey(blocks: Iterable[Recording], vehicle: Vehicle | None) -> dict[str, StreamSurvey]:
    """Survey each stream of a flight, by its field of the recording.

    Args:
        blocks: of the flight.
        vehicle: that flew; without one rotor speeds are not judged.
    """
    stamps: dict[str, Column] = {}
    screening: dict[str, StreamScreening] = {}
    for block in blocks:
        for name, stream in streams_by_field(block).items():
            if name not in stamps:
                stamps[name], screening[name] = Column(), StreamScreening(type(stream), vehicle)
            stamps[name].extend(stream.time_ns)
            screening[name].add(stream)
    surveys = {}
    for name in [name for name in STREAM_KINDS if name in stamps]:
        found = tuple(screening[name].finish())
        surveys[name] = StreamSurvey(
            STREAM_KINDS[name].topic, stamps[name].whole(), found, usable_samples(found)
        )
    return surveys


def samples_left_out(surveys: Mapping[str, StreamSurvey]) -> Iterator[LeftOut]:
    """A note for each kind of outlier that is left out."""
    for stream in surveys.values():
        yield from left_out(stream.topic, stream.found, stream.time_ns, surveys["imu"].time_ns)


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
