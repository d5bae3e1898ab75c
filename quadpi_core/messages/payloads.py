# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Many serialized messages in one buffer, and those of a topic with their log times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import Stamps

Bytes: TypeAlias = npt.NDArray[np.uint8]
Indices: TypeAlias = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Payloads:
    """N serialized messages: one buffer, and where in it each message starts and how long it is."""

    data: Bytes
    starts: Indices
    lengths: Indices

    @classmethod
    def join(cls, messages: Sequence[bytes]) -> Payloads:
        """Messages given one by one."""
        lengths = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
        return cls(np.frombuffer(b"".join(messages), dtype=np.uint8), _starts(lengths), lengths)

    @classmethod
    def from_rows(cls, rows: Bytes) -> Payloads:
        """Messages of one length, one per row."""
        count, length = rows.shape
        return cls(np.ascontiguousarray(rows).reshape(-1), np.arange(count) * length, np.full(count, length))

    @classmethod
    def concatenate(cls, parts: Sequence[Payloads]) -> Payloads:
        """The messages of all parts, in order."""
        if len(parts) == 1:
            return parts[0]
        sizes = [len(part.data) for part in parts]
        offsets = np.cumsum(sizes) - sizes
        return cls(
            np.concatenate([part.data for part in parts]),
            np.concatenate([part.starts + offset for part, offset in zip(parts, offsets, strict=True)]),
            np.concatenate([part.lengths for part in parts]),
        )

    @classmethod
    def merge(cls, parts: Sequence[tuple[Indices, Payloads]]) -> Payloads:
        """The messages of parts, each at its place among all of them."""
        places, payloads = zip(*parts, strict=True)
        return cls.concatenate(payloads).take(np.argsort(np.concatenate(places)))

    def __len__(self) -> int:
        return len(self.lengths)

    def __getitem__(self, index: int) -> bytes:
        start = self.starts[index]
        return self.data[start : start + self.lengths[index]].tobytes()

    def __iter__(self) -> Iterator[bytes]:
        for start, length in zip(self.starts.tolist(), self.lengths.tolist(), strict=True):
            yield self.data[start : start + length].tobytes()

    def take(self, order: npt.NDArray[Any]) -> Payloads:
        """The messages at the indices `order`, sharing the buffer."""
        return Payloads(self.data, self.starts[order], self.lengths[order])

    def cut(self, rows: slice) -> Payloads:
        """The messages in a range, sharing no more of the buffer than holds them."""
        starts, lengths = self.starts[rows], self.lengths[rows]
        if len(starts) == 0:
            return Payloads(self.data[:0], starts, lengths)
        first, stop = starts.min(), (starts + lengths).max()
        return Payloads(self.data[first:stop], starts - first, lengths)

    def compact(self, head: int | None = None) -> Payloads:
        """A copy whose buffer holds these messages alone, or the first `head` bytes of each."""
        lengths = self.lengths if head is None else np.minimum(self.lengths, head)
        starts = _starts(lengths)
        data = np.empty(int(lengths.sum()), dtype=np.uint8)
        compiled.copy_spans(self.data, self.starts, data, starts, lengths)
        return Payloads(data, starts, lengths)

    def rows(self, order: Indices, length: int) -> Bytes:
        """The first `length` bytes of the messages at `order`, (n, length)."""
        starts = self.starts[order]
        if len(starts) * length == len(self.data) and np.array_equal(starts, np.arange(len(starts)) * length):
            return self.data.reshape(len(starts), length)
        return np.lib.stride_tricks.sliding_window_view(self.data, length)[starts]


@dataclass(frozen=True)
class Topic:
    """The messages of one topic in the order of their log times."""

    name: str
    type_name: str
    log_time_ns: Stamps
    payloads: Payloads

    @classmethod
    def empty(cls, name: str, type_name: str) -> Topic:
        """A topic without messages."""
        return cls(name, type_name, np.empty(0, dtype=np.int64), Payloads.join([]))

    def rows(self, rows: slice) -> Topic:
        """A range of the messages, sharing no more of the buffer than holds them."""
        return Topic(self.name, self.type_name, self.log_time_ns[rows], self.payloads.cut(rows))

    def split(self, limit_ns: int) -> tuple[Topic, Topic]:
        """The messages logged before an instant, and the rest."""
        place = int(np.searchsorted(self.log_time_ns, limit_ns))
        return self.rows(slice(0, place)), self.rows(slice(place, None))


def join_topics(parts: Sequence[Topic]) -> Topic:
    """One topic of its parts, in log-time order; messages with equal log times in the order of the parts."""
    log_time_ns, payloads = parts[0].log_time_ns, parts[0].payloads
    if len(parts) > 1:
        log_time_ns = np.concatenate([part.log_time_ns for part in parts])
        payloads = Payloads.concatenate([part.payloads for part in parts])
    if np.any(np.diff(log_time_ns) < 0):
        order = np.argsort(log_time_ns, kind="stable")
        log_time_ns, payloads = log_time_ns[order], payloads.take(order).compact()
    return Topic(parts[0].name, parts[0].type_name, log_time_ns, payloads)


def _starts(lengths: Indices) -> Indices:
    return np.cumsum(lengths) - lengths


# A live node converts thousands of single messages a second. One call does it for all fields of a message;
# array operations field by field cost several times as much.

# How many float64 fields end nav_msgs/Odometry and quadpi/WrenchPrediction.
ODOMETRY_VALUES, PREDICTION_VALUES = compiled.ODOMETRY_VALUES, compiled.PREDICTION_VALUES
# Position and orientation among those of nav_msgs/Odometry.
POSE = slice(0, 7)
