# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings in blocks, which follow each other: a long flight then needs no more memory than a short one.

A block is a :class:`Recording` whose arrivals count from its own first IMU sample. The streams of the flight
are in each of its blocks, if need be without samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Recording, Stamps, Stream

# IMU samples in a block that is cut from a whole recording: 8 s at 500 Hz.
BLOCK_SAMPLES = 4096

_Some = TypeVar("_Some", bound=Stream)


def join_blocks(blocks: Iterable[Recording]) -> Recording:
    """The recording that the blocks are parts of.

    Raises:
        ValueError: if there is no block.
    """
    first: Recording | None = None
    parts: dict[str, list[Stream]] = {}
    arrivals: dict[str, list[Stamps]] = {}
    before = 0
    for block in blocks:
        first = first or block
        for name, stream in _streams(block).items():
            parts.setdefault(name, []).append(stream)
        for topic, counts in block.arrivals.items():
            arrivals.setdefault(topic, []).append(before + counts)
        before += len(block.imu)
    if first is None:
        raise ValueError("a recording needs a block")
    # Parts are let go stream by stream: beside the whole, no more is held than those of the largest.
    whole: dict[str, Any] = {name: _joined(parts.pop(name)) for name in list(parts)}
    return replace(
        first, **whole, arrivals={topic: np.concatenate(counts) for topic, counts in arrivals.items()}
    )


def split_recording(recording: Recording) -> Iterator[Recording]:
    """Blocks of :data:`BLOCK_SAMPLES` IMU samples, as :func:`by_arrival` gives them."""
    others = {name: stream for name, stream in _streams(recording).items() if name != "imu"}
    counts, orders = {}, {}
    for name, stream in others.items():
        arrived = recording.arrivals_of(stream)
        orders[name] = np.argsort(arrived, kind="stable")
        counts[name] = arrived[orders[name]]
    count = len(recording.imu)
    for start in [*range(0, count, BLOCK_SAMPLES), count]:
        # The last block is of what came after the last IMU sample.
        stop = min(start + BLOCK_SAMPLES, count) if start < count else count + 1
        rows = {name: slice(*np.searchsorted(counts[name], (start, stop)).tolist()) for name in others}
        streams: dict[str, Any] = {name: _take(others[name], orders[name][rows[name]]) for name in others}
        arrivals = {others[name].topic: counts[name][rows[name]] - start for name in others}
        yield replace(recording, imu=_take(recording.imu, slice(start, stop)), **streams, arrivals=arrivals)


def by_arrival(blocks: Iterable[Recording]) -> Iterator[Recording]:
    """The same flight in blocks of what had arrived when their last IMU sample did, in the order of arrival.

    What came after it is in the next block, as if it had come with that; what came after the last IMU sample
    of all is in a block of its own.
    """
    carried: Recording | None = None
    for block in blocks:
        whole = block if carried is None else join_blocks((carried, block))
        due, carried = _cut(whole)
        if len(due.imu):
            yield due
    if carried is not None:
        yield carried


def _cut(block: Recording) -> tuple[Recording, Recording]:
    """What had arrived when the last IMU sample did, and the rest."""
    count = len(block.imu)
    others = {name: stream for name, stream in _streams(block).items() if name != "imu"}
    counts = {name: block.arrivals_of(stream) for name, stream in others.items()}
    places = {name: int(np.searchsorted(counts[name], count)) for name in others}
    due: dict[str, Any] = {name: _take(others[name], slice(0, places[name])) for name in others}
    rest: dict[str, Any] = {name: _take(others[name], slice(places[name], None)) for name in others}
    return (
        replace(block, **due, arrivals={others[name].topic: counts[name][: places[name]] for name in others}),
        replace(
            block,
            imu=_take(block.imu, slice(count, None)),
            **rest,
            arrivals={others[name].topic: counts[name][places[name] :] - count for name in others},
        ),
    )


def _streams(recording: Recording) -> dict[str, Stream]:
    """By the names of their fields."""
    return {
        column.name: stream
        for column in fields(recording)
        if isinstance(stream := getattr(recording, column.name), Stream)
    }


def _joined(parts: Sequence[Stream]) -> Stream:
    if len(parts) == 1:
        return parts[0]
    return type(parts[0])(
        *(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(parts[0]))
    )


def _take(stream: _Some, rows: slice | npt.NDArray[np.int64]) -> _Some:
    return type(stream)(*(getattr(stream, column.name)[rows] for column in fields(stream)))
