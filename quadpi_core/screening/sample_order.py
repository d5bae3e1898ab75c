# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which samples of a topic are used, and in what order: one rule for bags, tables and logs of every format.

Sensors, drivers and recorders store a few samples that no later step can use. One of them must not cost a
flight, and none may pass for a measurement:

- A sample that is not finite, or whose quaternion has no length (trackers send zeros while the body is
  hidden) or one far from 1, holds no measurement. It is dropped.
- Of samples with one stamp the first is used: drivers publish a message twice, and autopilots that stamp in
  milliseconds log faster than that.
- A sample stored after later ones, where its stamp fits a hole between them, was delivered late: it is sorted
  in, if it is late by at most MAX_JUMP_BACK_NS. Where there is no hole, its stamp is wrong: it is dropped.
- A stamp far from those on both sides is wrong alone, and dropped, and so is one that is no number. Two that
  agree are another clock.
- Where the clock falls, as an autopilot's does that starts again, or jumps by days, another run begins. The
  samples of two runs never come into one flight: the longest run is used.

All that is dropped or sorted is counted, with the place of the first. Where more than :data:`SHARE_MAX` of a
topic would be dropped, the source is refused.

The nodes follow the same rule as far as it can be known before the next sample: a late IMU sample is
dropped, and the filter starts again where two stamps agree that the clock fell by MAX_JUMP_BACK_NS or more.
Replay does what the nodes do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.findings import CLOCK_FALLS, CLOCK_JUMPS, Break, DataQuality, LeftOut, Reordered, UsedPart
from quadpi_core.flight import (
    FLIGHT_MAX_NS,
    MAX_JUMP_BACK_NS,
    STAMP_MAX_NS,
    Recording,
    Stamps,
    Stream,
)
from quadpi_core.reading_options import all_by_field, streams_by_field
from quadpi_core.records import CONVENTION, NORM_TOLERANCE, Threshold

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

SHARE_MAX = Threshold(
    name="largest share of a topic's samples that is dropped as unusable",
    value=0.5,
    unit="1",
    reason="messages that are all stored twice, or 2 kHz stamped in ms, are half repeats, and a body may be "
    "hidden for half a flight; where most samples are wrong, nothing says that the others are right",
    data=CONVENTION,
)
HOLE_STEPS = Threshold(
    name="least distance between the samples around one that was delivered late",
    value=1.5,
    unit="usual steps",
    reason="one lost sample leaves a hole of two steps, none leaves one; between them with room for jitter",
    data=CONVENTION,
)

REPEATS, BACKWARD = "stamp repeats", "stamp runs backward"
ALONE, OUTSIDE = "stamp is far from those around it", "stamp is no number from 1970 to 2038"
NO_ROTATION = "attitude is no unit quaternion"


class FaultySamples(NamedTuple):
    """Samples with one fault.

    Attributes:
        fault: in words that follow "the" or "whose".
        first: index of the first of them in the topic as stored.
        samples: how many.
    """

    fault: str
    first: int
    samples: int


@dataclass(frozen=True)
class SampleOrder:
    """The samples of a topic that are used.

    Attributes:
        of: number of samples stored.
        rows: (M,) their indices, run by run, by rising stamps within each; None for all as they are.
        dropped: the others, by fault; a sample counts once.
        late: samples that are used and stored out of order.
        starts: (K,) first place in `rows` of each run of the clock.
    """

    of: int
    rows: Rows | None = None
    dropped: tuple[FaultySamples, ...] = ()
    late: FaultySamples | None = None
    starts: tuple[int, ...] = (0,)

    def runs(self) -> list[Rows]:
        """The rows of each run."""
        rows = np.arange(self.of) if self.rows is None else self.rows
        return np.split(rows, self.starts[1:])

    def problem(self) -> str | None:
        """Why the topic cannot be used, beginning with the sample; None if it can."""
        count = sum(fault.samples for fault in self.dropped)
        if count <= SHARE_MAX.value * self.of:
            return None
        worst = max(self.dropped, key=lambda found: found.samples)
        hint = "; are its columns, or their order, right?" if worst.fault == NO_ROTATION else ""
        if worst.fault == REPEATS and worst.samples == self.of - 1:
            hint = ": all have the same stamp; does the publisher set the stamp of the header?"
        return (
            f"sample {worst.first}: the {worst.fault}, and {count} of {self.of} samples cannot be used; at "
            f"most {SHARE_MAX.value:.0%} may be left out{hint}"
        )


def faults(stream: Stream) -> Iterator[tuple[str, Mask]]:
    """Masks (N,) of the samples that hold no measurement, by fault; they may overlap."""
    for column in fields(stream) if len(stream) else ():
        values = getattr(stream, column.name)
        if values.dtype.kind != "f":
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            if not finite.all():
                yield f"{column.name} is not finite", ~finite
            if column.name == "attitude":
                off = np.abs(np.linalg.norm(values, axis=1) - 1.0) > NORM_TOLERANCE
                if off.any():
                    yield NO_ROTATION, off


def without_unusable_attitudes(block: Recording) -> Recording:
    """A block without the states and poses whose attitude no node takes from a message: see NO_ROTATION."""
    masks = {name: dict(faults(stream)) for name, stream in streams_by_field(block).items()}
    usable = {name: ~faulty[NO_ROTATION] for name, faulty in masks.items() if NO_ROTATION in faulty}
    return with_rows(block, usable) if usable else block


def with_rows(recording: Recording, rows: Mapping[str, Rows | Mask]) -> Recording:
    """The recording with some samples of streams alone, by field; arrivals count the IMU samples left."""
    used = np.ones(len(recording.imu), np.bool_)
    if "imu" in rows:
        used[:] = False
        used[rows["imu"]] = True
    before = np.concatenate(([0], np.cumsum(used)))
    taken: dict[str, Any] = {}
    arrivals = {}
    for name, stream in all_by_field(recording).items():
        chosen = rows.get(name, slice(None))
        taken[name] = stream.take(chosen)
        came = recording.arrivals.get(stream.topic)
        if came is not None and len(came) == len(stream):
            arrivals[stream.topic] = before[came][chosen]
    return replace(recording, **taken, arrivals=arrivals)


def order_of(time_ns: Stamps, faults: Mapping[str, Mask] | None = None) -> SampleOrder:
    """Judge the samples of a topic.

    Args:
        time_ns: (N,) stamps, as stored.
        faults: see :func:`faults`; the first one of a sample counts.
    """
    count = len(time_ns)
    dropped: list[FaultySamples] = []
    usable = np.ones(count, dtype=np.bool_)

    def drop(fault: str, which: Mask) -> None:
        which = which & usable
        if which.any():
            dropped.append(FaultySamples(fault, int(np.argmax(which)), int(np.count_nonzero(which))))
            usable[which] = False

    for fault, which in (faults or {}).items():
        drop(fault, which)
    drop(OUTSIDE, (time_ns < 0) | (time_ns > STAMP_MAX_NS))
    if not dropped and np.all(np.diff(time_ns) > 0) and (count < 2 or np.ptp(time_ns) <= FLIGHT_MAX_NS):
        return SampleOrder(count)
    rows = np.flatnonzero(usable)
    stamps = time_ns[rows]
    kinds, run_of = np.zeros(len(rows), np.int8), np.zeros(len(rows), np.int64)
    steps = np.abs(np.diff(stamps))
    # The lower quartile: of samples stored in pairs that are swapped, half the steps are of three.
    usual_ns = float(np.percentile(steps[steps > 0], 25.0)) if steps.any() else 0.0
    compiled.scan_order(stamps, HOLE_STEPS.value * usual_ns, np.empty_like(stamps), kinds, run_of)
    late = np.flatnonzero(kinds == compiled.LATE)
    repeats, fits = _late_ones(stamps, kinds, run_of, HOLE_STEPS.value * usual_ns)
    for fault, places in (
        (REPEATS, late[repeats]),
        (BACKWARD, late[~repeats & ~fits]),
        (ALONE, np.flatnonzero(kinds == compiled.ALONE)),
    ):
        drop(fault, np.isin(np.arange(count), rows[places]))
    used = usable[rows]
    sorted_in = rows[late[fits]]
    rows, run_of, stamps = rows[used], run_of[used], stamps[used]
    if len(sorted_in):
        order = np.lexsort((stamps, run_of))
        rows, run_of = rows[order], run_of[order]
    return SampleOrder(
        of=count,
        rows=rows,
        dropped=tuple(sorted(dropped, key=lambda found: found.first)),
        late=FaultySamples("", int(sorted_in[0]), len(sorted_in)) if len(sorted_in) else None,
        starts=(0, *(np.flatnonzero(np.diff(run_of)) + 1).tolist()),
    )


def _late_ones(
    stamps: Stamps, kinds: npt.NDArray[np.int8], run_of: Rows, hole_ns: float
) -> tuple[Mask, Mask]:
    """Of the samples that came late: masks of those that repeat a stamp, and of those that fit a hole."""
    late = np.flatnonzero(kinds == compiled.LATE)
    repeats, fits = np.zeros(len(late), np.bool_), np.zeros(len(late), np.bool_)
    for run in np.unique(run_of[late]).tolist():
        in_order = np.flatnonzero((kinds == compiled.RISES) & (run_of == run))
        rows = np.flatnonzero(run_of[late] == run)
        rising, came = stamps[in_order], stamps[late[rows]]
        again = np.ones(len(came), np.bool_)
        again[np.unique(came, return_index=True)[1]] = False
        place = np.searchsorted(rising, came)
        before, after = rising[np.maximum(place - 1, 0)], rising[np.minimum(place, len(rising) - 1)]
        repeats[rows] = again | (after == came)
        newest = rising[np.searchsorted(in_order, late[rows]) - 1]
        fits[rows] = (
            ~repeats[rows]
            & ((place == 0) | (after - before >= hole_ns))
            & (newest - came <= MAX_JUMP_BACK_NS)
        )
    return repeats, fits


def usable_recording(recording: Recording) -> Recording:
    """The samples of a recording that can be used; its `quality` says what was dropped, sorted or cut off.

    Where its clock falls or jumps, the longest run of the IMU is taken, and other topics' samples in it.

    Raises:
        LogError: naming source, topic and sample, where more than :data:`SHARE_MAX` of a topic is unusable.
    """
    streams = streams_by_field(recording)
    judged = {
        name: Judged(stream.topic, stream.time_ns, order_of(stream.time_ns, dict(faults(stream))))
        for name, stream in streams.items()
    }
    require_usable(recording.source, judged)
    if all(topic.order.rows is None for topic in judged.values()):
        return recording
    arrived = {
        name: recording.arrivals[stream.topic]
        for name, stream in streams.items()
        if len(recording.arrivals.get(stream.topic, ())) == len(stream)
    }
    rows = used_rows(judged, arrived)
    absent: dict[str, Any] = {name: None for name in rows if len(rows[name]) == 0 and name != "imu"}
    quality = recording.quality.joined(order_quality(judged))
    return replace(with_rows(recording, rows), **absent, quality=quality)


@dataclass(frozen=True)
class Judged:
    """A topic of a recording: its stamps (N,) as stored, and which of its samples are used."""

    topic: str
    stored_ns: Stamps
    order: SampleOrder


def require_usable(source: str, judged: Mapping[str, Judged]) -> None:
    """Refuse a source of which too much is unusable with a LogError: source, topic and sample."""
    for one in judged.values():
        if problem := one.order.problem():
            raise LogError(f"{source}: topic {one.topic}: {problem}")


def used_rows(judged: Mapping[str, Judged], arrived: Mapping[str, Stamps]) -> dict[str, Rows]:
    """The rows (M,) of each topic that are used, by its field: those of the longest run of the IMU.

    Args:
        judged: the topics, by field.
        arrived: number of IMU samples that arrived before each sample (N,), of fields of which it is known.
    """
    imu = judged["imu"]
    runs = imu.order.runs()
    chosen = longest(imu.stored_ns, runs)
    mine = runs[chosen]
    rows = {"imu": mine}
    for name, one in judged.items():
        its_runs = one.order.runs()
        if name == "imu":
            continue
        if len(runs) > 1 and name in arrived:
            came = arrived[name]
            its_runs = [run[(came[run] >= mine.min()) & (came[run] <= mine.max() + 1)] for run in its_runs]
        elif len(its_runs) == len(runs):
            rows[name] = its_runs[chosen]
            continue
        # Of clocks that fell another time, what has the stamps of this run.
        shared = its_runs
        if len(mine):
            first, last = imu.stored_ns[mine[[0, -1]]]
            shared = [run[(one.stored_ns[run] >= first) & (one.stored_ns[run] <= last)] for run in its_runs]
        best = int(np.argmax([len(run) for run in shared]))
        rows[name] = shared[best] if len(runs) > 1 and name not in arrived else its_runs[best]
    return rows


def order_quality(judged: Mapping[str, Judged]) -> DataQuality:
    """What is dropped, sorted and cut off of the topics, by field."""
    imu_ns, runs = judged["imu"].stored_ns, judged["imu"].order.runs()
    chosen = longest(imu_ns, runs)
    start_ns = int(imu_ns[runs[chosen][0]]) if len(runs[chosen]) else 0
    dropped, late = [], []
    for one in judged.values():
        for fault, first, count in one.order.dropped:
            after_s = (int(one.stored_ns[first]) - start_ns) * 1e-9
            dropped.append(LeftOut(one.topic, f"whose {fault}", count, one.order.of, first, after_s))
        if one.order.late is not None:
            _, first, count = one.order.late
            after_s = (int(one.stored_ns[first]) - start_ns) * 1e-9
            late.append(Reordered(one.topic, count, one.order.of, first, after_s))
    return DataQuality(
        left_out=tuple(dropped),
        reordered=tuple(late),
        breaks=tuple(jump for one in judged.values() for jump in breaks(one.topic, one.stored_ns, one.order)),
        used=(used_run(imu_ns, runs, chosen),) if len(runs) > 1 else (),
    )


def longest(time_ns: Stamps, runs: list[Rows]) -> int:
    """Which of the runs of a clock lasts longest; the first of equals."""
    return int(np.argmax([_length(time_ns[run]) for run in runs]))


def _length(time_ns: Stamps) -> int:
    return int(time_ns[-1] - time_ns[0]) if len(time_ns) else 0


def breaks(topic: str, time_ns: Stamps, order: SampleOrder) -> Iterator[Break]:
    """Where the clock of a topic falls or jumps."""
    ends = [(run[-1], following[0]) for run, following in pairwise(order.runs())]
    for kind, sign in ((CLOCK_FALLS, -1), (CLOCK_JUMPS, 1)):
        steps = [(last, first) for last, first in ends if sign * int(time_ns[first] - time_ns[last]) > 0]
        if steps:
            last, first = steps[0]
            seconds = (float(1e-9 * time_ns[row]) for row in (last, first))
            yield Break(topic, kind, len(steps), int(first), *seconds)


def used_run(imu_ns: Stamps, runs: list[Rows], chosen: int) -> UsedPart:
    """The chosen run of the IMU, in seconds since its own first sample."""
    of_s = 1e-9 * sum(_length(imu_ns[run]) for run in runs)
    length_s = 1e-9 * _length(imu_ns[runs[chosen]])
    return UsedPart(0.0, length_s, len(runs[chosen]), of_s, f"the longest of {len(runs)} runs")
