# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The filter's memory of the last half second, and what each sample does to it.

Motion capture is late: what it saw is fused where it belongs in time, and the estimates since then are
computed anew. So that the order of arrival hardly matters, and replay equals live, a measurement stamped s is
held until the first IMU sample that is stamped s + HOLD_NS or later; one that arrives after that is fused at
the next IMU sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.signals import ekf_corrections as corrections
from quadpi_core.signals.ekf_corrections import (
    KIND,
    LAG,
    NIS,
    POSE,
    POSE_GATE,
    SCALAR,
    VALUE,
    VALUES,
    VELOCITY_GATE,
    WIDENED,
    Count,
)
from quadpi_core.signals.ekf_kernels import (
    ACCELEROMETER_BIAS,
    TRANSITION,
    VELOCITY,
    EstimatorStatus,
    Noise,
    Outcome,
    Row,
    between,
    copy,
    covariance_of,
    propagate,
    usable_imu,
    usable_pose,
    usable_velocity,
)

HOLD_NS = 10_000_000
BUFFER_S = 0.5
_BUFFER_NS = round(BUFFER_S * 1e9)
# Measurements that wait; more than motion capture sends in the time by which it may be early.
_HELD = 256

# Without a correction for this long the state is DEGRADED, then LOST.
DEGRADED_NS = 250_000_000
LOST_NS = 2_000_000_000
_DEGRADED_REJECTIONS = 3
# Standard deviation beyond which a velocity is of no use as an input of a model.
VELOCITY_STD_MAX_M_S = 2.0
# Standard deviations beyond which the state is DEGRADED: it has not settled after its start or a jump of
# motion capture that was believed. Up to this velocity predictions are those of a settled state to half of
# the half width of their intervals; this specific force is one per cent of the weight.
SETTLED_VELOCITY_STD_M_S = 0.05
SETTLED_BIAS_STD_M_S2 = 0.1
# Rejections that persist for this long, and agree among themselves, are taken for the truth.
_PERSISTENCE_NS = 400_000_000
_PERSISTENCE_COUNT = 5
# So many equal values in a row never come from a sensor that has noise.
_REPEATS_MAX = 12

_NEVER = -(2**62)


class Clock:
    """Where the clock (a row of whole numbers) holds what."""

    HEAD = 0  # row of the newest estimate
    FILLED = 1  # rows in use
    CORRECTED_NS = 2  # instant of the last correction
    HELD_FIRST = 3
    HELD_COUNT = 4
    ACCEPTED_NS = 5  # stamp of the IMU sample at which a correction was last accepted
    STATUS = 6
    JOURNALLED = 7
    JUMPED_NS = 8  # stamp of the IMU sample before, where that was far from all before it
    WIDTH = 9


class Source:
    """Where the record of one source of corrections holds what."""

    ARRIVED_NS = 0  # stamp of the last measurement that was held
    SEEN_NS = 1  # stamp since which the same value is repeated
    REPEATS = 2
    CHANGES = 3
    REFUSED_SINCE_NS = 4
    REFUSED_NS = 5
    REFUSED = 6
    WIDTH = 7


_HEAD, _FILLED, _CORRECTED_NS, _ACCEPTED_NS = Clock.HEAD, Clock.FILLED, Clock.CORRECTED_NS, Clock.ACCEPTED_NS
_HELD_FIRST, _HELD_COUNT, _STATUS, _JOURNALLED, _JUMPED_NS = (
    Clock.HELD_FIRST,
    Clock.HELD_COUNT,
    Clock.STATUS,
    Clock.JOURNALLED,
    Clock.JUMPED_NS,
)
_ARRIVED_NS, _SEEN_NS, _REPEATS, _CHANGES = Source.ARRIVED_NS, Source.SEEN_NS, Source.REPEATS, Source.CHANGES
_REFUSED_SINCE_NS, _REFUSED_NS, _REFUSED = Source.REFUSED_SINCE_NS, Source.REFUSED_NS, Source.REFUSED
_VELOCITY, _ACCELEROMETER_BIAS = VELOCITY.start, ACCELEROMETER_BIAS.start
_DELAY, _STATE_BEGIN, _WIDTH = Row.DELAY, Row.NOMINAL.start, Row.WIDTH
_USED, _TOO_LATE, _REJECTED, _FROZEN = (
    Outcome.USED.value,
    Outcome.TOO_LATE.value,
    Outcome.REJECTED.value,
    Outcome.FROZEN.value,
)
_OUTCOMES = len(Outcome)


class Memory(NamedTuple):
    """All that the filter remembers; arrays that the kernels change in place.

    Attributes:
        clock: (9,) see :class:`Clock`.
        stamps: (N,) of the estimates in `rows`, a ring.
        rows: (N + 3, 279) estimates at the stamps of IMU samples, see :class:`Row`; then that after the last
            correction, at its own instant, and two to work on.
        held_ns, held: (H,), (H, 8) measurements that wait, with their kind in the last column; a ring.
        sources: (2, 7) of poses and velocities, see :class:`Source`.
        seen: (2, 14) value that each source measured last, and that it was last refused with.
        counts: (3, outcomes) of IMU samples, poses and velocities.
        noise: (12,) numbers of :class:`Noise`.
    """

    clock: Count
    stamps: Stamps
    rows: Array
    held_ns: Stamps
    held: Array
    sources: Count
    seen: Array
    counts: Count
    noise: Array


def allocate(rate_hz: float, noise: Noise) -> Memory:
    """An empty memory for an IMU of that rate."""
    length = int(np.ceil(BUFFER_S * rate_hz)) + 3
    memory = Memory(
        clock=np.zeros(Clock.WIDTH, dtype=np.int64),
        stamps=np.zeros(length, dtype=np.int64),
        rows=np.zeros((length + 3, Row.WIDTH)),
        held_ns=np.zeros(_HELD, dtype=np.int64),
        held=np.zeros((_HELD, VALUES + 1)),
        sources=np.zeros((2, Source.WIDTH), dtype=np.int64),
        seen=np.zeros((2, 2 * VALUES)),
        counts=np.zeros((3, _OUTCOMES), dtype=np.int64),
        noise=np.array(noise, dtype=np.float64),
    )
    forget(memory)
    return memory


def forget(memory: Memory) -> None:
    """Make the memory empty, but for the counts."""
    for array in (memory.clock, memory.rows, memory.sources, memory.seen):
        array[...] = 0
    memory.sources[:, Source.ARRIVED_NS] = _NEVER
    memory.clock[Clock.JUMPED_NS] = _NEVER


def start(memory: Memory, time_ns: int, estimate: Array, imu_ns: int) -> None:
    """Begin with an estimate (279,) at `time_ns`, whose IMU sample is stamped `imu_ns`, at or before that."""
    forget(memory)
    length = len(memory.stamps)
    memory.stamps[0] = imu_ns
    memory.rows[0] = memory.rows[length] = estimate
    memory.clock[Clock.FILLED] = 1
    memory.clock[Clock.CORRECTED_NS] = time_ns
    memory.clock[Clock.ACCEPTED_NS] = imu_ns


@njit(cache=True)
def noise_of(numbers: Array) -> Noise:
    """The noise that an array of its numbers stands for."""
    return Noise(
        numbers[0],
        numbers[1],
        numbers[2],
        numbers[3],
        numbers[4],
        numbers[5],
        numbers[6],
        numbers[7],
        numbers[8],
        numbers[9],
        numbers[10],
        numbers[11],
    )


@njit(cache=True)
def step(
    clock: Count,
    stamps: Stamps,
    rows: Array,
    held_ns: Stamps,
    held: Array,
    sources: Count,
    seen: Array,
    counts: Count,
    noise: Array,
    time_ns: int,
    sample: Array,
    journal_ns: Stamps,
    journal: Array,
) -> int:
    """:func:`predict`, then :func:`release` if the sample was used.

    For Python, which hands over the arrays of a :class:`Memory` one by one at half the cost of a tuple.
    """
    memory = Memory(clock, stamps, rows, held_ns, held, sources, seen, counts, noise)
    outcome = predict(memory, time_ns, sample)
    if outcome == Outcome.USED.value:
        release(memory, journal_ns, journal)
    return outcome


@njit(cache=True)
def predict(memory: Memory, time_ns: int, sample: Array) -> int:
    """Take one IMU sample (6,), rates rad/s and specific force m/s², and move the estimate to its stamp.

    Then :func:`release` is due. Gives the value of an :class:`Outcome`; unless USED, which alone is counted
    here, the memory keeps but a stamp that jumped.
    """
    clock, stamps, rows = memory.clock, memory.stamps, memory.rows
    if not usable_imu(sample):
        return Outcome.UNUSABLE.value
    head = clock[_HEAD]
    since = time_ns - stamps[head]
    if since > MAX_GAP_NS or since < -MAX_JUMP_BACK_NS:
        # One stamp alone may be broken; two that agree are a pause or another clock.
        if 0 < time_ns - clock[_JUMPED_NS] <= MAX_GAP_NS:
            return Outcome.RESET.value
        clock[_JUMPED_NS] = time_ns
        return Outcome.STAMP_JUMPED.value
    clock[_JUMPED_NS] = _NEVER
    if since <= 0:
        return Outcome.STAMP_NOT_ADVANCING.value
    length = len(stamps)
    following = (head + 1) % length
    stamps[following] = time_ns
    copy(sample, rows[following], 0, 6)
    work = rows[length + 1]
    _base(memory, head, work)
    _move(memory, work, head, max(stamps[head], _corrected_ns(memory, head)), time_ns, np.empty(TRANSITION))
    copy(work, rows[following], _STATE_BEGIN, _WIDTH)
    clock[_HEAD] = following
    clock[_FILLED] = min(clock[_FILLED] + 1, length)
    clock[_STATUS] = status_of(memory, time_ns)
    memory.counts[0, _USED] += 1
    return _USED


@njit(cache=True)
def hold(memory: Memory, time_ns: int, kind: int, value: Array) -> int:
    """Take a measurement (7,) of a kind; it is fused when its time has come.

    Returns:
        The value of an :class:`Outcome`: COLLECTED, or why it is refused.
    """
    source = 0 if kind == POSE else 1
    marks = memory.sources[source]
    outcome = Outcome.COLLECTED.value
    newest_ns = memory.stamps[memory.clock[_HEAD]]
    usable = usable_pose(value) if kind == POSE else usable_velocity(value)
    if not usable:
        outcome = Outcome.UNUSABLE.value
    elif time_ns > newest_ns + MAX_GAP_NS or memory.clock[_HELD_COUNT] == len(memory.held_ns):
        outcome = Outcome.TOO_EARLY.value
    elif marks[_ARRIVED_NS] - MAX_JUMP_BACK_NS <= time_ns <= marks[_ARRIVED_NS]:
        outcome = Outcome.STAMP_NOT_ADVANCING.value
    if outcome != Outcome.COLLECTED.value:
        memory.counts[1 + source, outcome] += 1
        return outcome
    marks[_ARRIVED_NS] = time_ns
    # By stamp: an odometry's two parts, and sources that overtake each other.
    place = memory.clock[_HELD_COUNT]
    size = len(memory.held_ns)
    first = memory.clock[_HELD_FIRST]
    while place > 0 and memory.held_ns[(first + place - 1) % size] > time_ns:
        memory.held_ns[(first + place) % size] = memory.held_ns[(first + place - 1) % size]
        copy(memory.held[(first + place - 1) % size], memory.held[(first + place) % size], 0, VALUES + 1)
        place -= 1
    at = (first + place) % size
    memory.held_ns[at] = time_ns
    copy(value, memory.held[at], 0, VALUES)
    memory.held[at, VALUES] = kind
    memory.clock[_HELD_COUNT] += 1
    return outcome


@njit(cache=True)
def release(memory: Memory, journal_ns: Stamps, journal: Array) -> None:
    """Fuse what is held and due: each where it belongs in time, computing the estimates since then anew.

    A measurement from before the last correction, or after the newest IMU sample, is compared with what the
    estimate at that instant was or will be by its own motion.

    Args:
        memory: after :func:`predict`.
        journal_ns: (J,) and
        journal: (J, 14) filled with the corrections as they are applied, while there is room.
    """
    clock, stamps, rows = memory.clock, memory.stamps, memory.rows
    noise = noise_of(memory.noise)
    transition, scalars, widened = np.empty(TRANSITION), np.empty((6, SCALAR)), np.empty(4)
    length = len(stamps)
    head = clock[_HEAD]
    now_ns = stamps[head]
    prior, trial = rows[length + 1], rows[length + 2]
    while clock[_HELD_COUNT] > 0 and memory.held_ns[clock[_HELD_FIRST]] + HOLD_NS <= now_ns:
        at = clock[_HELD_FIRST]
        clock[_HELD_FIRST] = (at + 1) % len(memory.held_ns)
        clock[_HELD_COUNT] -= 1
        time_ns, value, kind = memory.held_ns[at], memory.held[at], int(memory.held[at, VALUES])
        source = 0 if kind == POSE else 1
        counts = memory.counts[1 + source]
        wanted_ns = time_ns - round(1e9 * rows[head, _DELAY])
        if wanted_ns < now_ns - _BUFFER_NS:
            counts[_TOO_LATE] += 1
            continue
        oldest = (head - clock[_FILLED] + 1) % length
        instant_ns = min(max(wanted_ns, clock[_CORRECTED_NS], stamps[oldest]), now_ns)
        before = _reach(memory, instant_ns, prior, transition)
        if _frozen(memory, noise, prior, source, kind, time_ns, value):
            counts[_FROZEN] += 1
            continue

        lag = 1e-9 * (wanted_ns - instant_ns)
        for attempt in range(2):
            copy(prior, trial, 0, _WIDTH)
            if attempt == 0:
                widened[0], widened[1], widened[2], widened[3] = 0.0, 0.0, 0.0, 0.0
            else:
                corrections.widening(prior, noise, kind, value, widened)
                corrections.widen(trial, widened)
            nis = corrections.fuse(trial, noise, kind, lag, value, scalars)
            accepted = nis <= (POSE_GATE if kind == POSE else VELOCITY_GATE) or attempt == 1
            if accepted or not _persists(memory, noise, prior, source, kind, time_ns, value):
                break
        if not accepted:
            counts[_REJECTED] += 1
            continue
        counts[_USED] += 1
        memory.sources[source, _REFUSED] = 0
        clock[_ACCEPTED_NS] = now_ns
        if clock[_JOURNALLED] < len(journal_ns):
            journal_ns[clock[_JOURNALLED]] = instant_ns
            _write(journal[clock[_JOURNALLED]], kind, lag, value, widened, nis)
            clock[_JOURNALLED] += 1
        copy(trial, rows[length], 0, _WIDTH)
        clock[_CORRECTED_NS] = instant_ns
        _renew(memory, trial, before, instant_ns, transition)
    clock[_STATUS] = status_of(memory, now_ns)


@njit(cache=True)
def _reach(memory: Memory, instant_ns: int, row: Array, transition: Array) -> int:
    """Bring an instant's estimate and IMU sample into `row`; gives the estimate at or before it."""
    stamps = memory.stamps
    before: int = memory.clock[_HEAD]
    while stamps[before] > instant_ns:
        before = (before - 1) % len(stamps)
    _base(memory, before, row)
    _move(memory, row, before, max(stamps[before], _corrected_ns(memory, before)), instant_ns, transition)
    _sample_at(memory, before, instant_ns, row)
    return before


@njit(cache=True)
def _write(entry: Array, kind: int, lag: float, value: Array, widened: Array, nis: float) -> None:
    """Note a correction as it was applied."""
    entry[KIND], entry[LAG], entry[NIS] = kind, lag, nis
    for index in range(VALUES):
        entry[VALUE + index] = value[index]
    for index in range(4):
        entry[WIDENED + index] = widened[index]


@njit(cache=True)
def _renew(memory: Memory, row: Array, before: int, instant_ns: int, transition: Array) -> None:
    """Compute the estimates from an instant on anew, from that which `row` holds after its correction."""
    stamps, rows, head = memory.stamps, memory.rows, memory.clock[_HEAD]
    if stamps[before] == instant_ns:
        copy(row, rows[before], _STATE_BEGIN, _WIDTH)
    from_ns = instant_ns
    while before != head:
        following = (before + 1) % len(stamps)
        _move(memory, row, before, from_ns, stamps[following], transition)
        copy(row, rows[following], _STATE_BEGIN, _WIDTH)
        before, from_ns = following, stamps[following]


@njit(cache=True)
def _corrected_ns(memory: Memory, before: int) -> int:
    """Instant of the last correction if it is at or after the estimate `before`; else long ago."""
    corrected_ns: int = memory.clock[_CORRECTED_NS]
    return corrected_ns if corrected_ns >= memory.stamps[before] else _NEVER


@njit(cache=True)
def _base(memory: Memory, before: int, row: Array) -> None:
    """The last estimate in the interval that begins with `before`: the one there, or a correction's."""
    source = len(memory.stamps) if _corrected_ns(memory, before) != _NEVER else before
    copy(memory.rows[source], row, 0, _WIDTH)


@njit(cache=True)
def _move(memory: Memory, row: Array, before: int, from_ns: int, to_ns: int, transition: Array) -> None:
    """Propagate an estimate within the interval of IMU samples that begins with `before`.

    The IMU signal is taken as linear between its samples.
    """
    if to_ns <= from_ns:
        return
    stamps, rows = memory.stamps, memory.rows
    following = (before + 1) % len(stamps)
    begin = stamps[before]
    step_between(
        row,
        noise_of(memory.noise),
        rows[before],
        rows[following],
        from_ns - begin,
        to_ns - begin,
        stamps[following] - begin,
        transition,
    )


@njit(cache=True)
def step_between(
    row: Array,
    noise: Noise,
    first: Array,
    second: Array,
    from_ns: int,
    to_ns: int,
    interval_ns: int,
    transition: Array,
) -> None:
    """Propagate an estimate from one instant of an interval to another, both since its begin.

    `first` and `second` begin with the IMU samples (6,) at the interval's ends.
    """
    share = 0.5 * (from_ns + to_ns) / interval_ns
    propagate(
        row,
        noise,
        1e-9 * (to_ns - from_ns),
        between(first, second, 0, share),
        between(first, second, 3, share),
        transition,
    )


@njit(cache=True)
def _sample_at(memory: Memory, before: int, instant_ns: int, row: Array) -> None:
    """Put the IMU sample of an instant, between `before` and the one that follows, into an estimate."""
    stamps, rows = memory.stamps, memory.rows
    if instant_ns > stamps[before]:
        following = (before + 1) % len(stamps)
        share = (instant_ns - stamps[before]) / (stamps[following] - stamps[before])
        for index in range(6):
            row[index] = rows[before, index] + share * (rows[following, index] - rows[before, index])
    else:
        copy(rows[before], row, 0, 6)


@njit(cache=True)
def _frozen(
    memory: Memory, noise: Noise, row: Array, source: int, kind: int, time_ns: int, value: Array
) -> bool:
    """Whether a measurement only repeats the one before it although the vehicle moves, or for too long."""
    marks, seen = memory.sources[source], memory.seen[source]
    same = True
    for index in range(VALUES):
        same = same and seen[index] == value[index]
    if not same:
        copy(value, seen, 0, VALUES)
        marks[_SEEN_NS] = time_ns
        marks[_REPEATS] = 0
        marks[_CHANGES] = min(marks[_CHANGES] + 1, _REPEATS_MAX)
        return False
    marks[_REPEATS] += 1
    if marks[_REPEATS] >= _REPEATS_MAX and marks[_CHANGES] >= _REPEATS_MAX:
        return True
    return corrections.moves(row, noise, kind, 1e-9 * (time_ns - marks[_SEEN_NS]))


@njit(cache=True)
def _persists(
    memory: Memory, noise: Noise, row: Array, source: int, kind: int, time_ns: int, value: Array
) -> bool:
    """Note a rejection; True once rejections persist that agree among themselves."""
    marks, refused = memory.sources[source], memory.seen[source, VALUES:]
    elapsed = 1e-9 * (time_ns - marks[_REFUSED_NS])
    if marks[_REFUSED] == 0 or not corrections.same_motion(kind, refused, value, elapsed, row, noise):
        marks[_REFUSED] = 0
        marks[_REFUSED_SINCE_NS] = time_ns
    marks[_REFUSED] += 1
    marks[_REFUSED_NS] = time_ns
    copy(value, refused, 0, VALUES)
    persisted = time_ns - marks[_REFUSED_SINCE_NS] >= _PERSISTENCE_NS
    return bool(persisted and marks[_REFUSED] >= _PERSISTENCE_COUNT)


@njit(cache=True)
def status_of(memory: Memory, now_ns: int) -> int:
    """How far the newest estimate can be used, at its stamp: a value of :class:`EstimatorStatus`."""
    since = now_ns - memory.clock[_ACCEPTED_NS]
    covariance = covariance_of(memory.rows[memory.clock[_HEAD]])
    velocity, bias = _worst(covariance, _VELOCITY), _worst(covariance, _ACCELEROMETER_BIAS)
    if since > LOST_NS or velocity > VELOCITY_STD_MAX_M_S**2:
        return EstimatorStatus.LOST.value
    rejections = max(memory.sources[0, _REFUSED], memory.sources[1, _REFUSED])
    settled = velocity <= SETTLED_VELOCITY_STD_M_S**2 and bias <= SETTLED_BIAS_STD_M_S2**2
    if since > DEGRADED_NS or rejections >= _DEGRADED_REJECTIONS or not settled:
        return EstimatorStatus.DEGRADED.value
    return EstimatorStatus.OK.value


@njit(cache=True)
def _worst(covariance: Array, begin: int) -> float:
    """The largest of three variances."""
    worst: float = max(
        covariance[begin, begin], covariance[begin + 1, begin + 1], covariance[begin + 2, begin + 2]
    )
    return worst
