# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What each sample does to the filter's memory of the last half second.

Motion capture is late: what it saw is fused where it belongs in time, and the estimates since then are
computed anew. So that the order of arrival hardly matters, and replay equals live, a measurement stamped s is
held until the first IMU sample that is stamped s + HOLD_NS or later; one that arrives after that is fused at
the next IMU sample.
"""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator import corrections
from quadpi_core.estimator.corrections import (
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
from quadpi_core.estimator.filter_memory import BUFFER_S, Clock, Memory, Source, noise_of
from quadpi_core.estimator.filter_status import status_of
from quadpi_core.estimator.imu_rate import NOTICED_NS, off_for
from quadpi_core.estimator.propagate import (
    TRANSITION,
    Noise,
    Outcome,
    Row,
    between,
    copy,
    propagate,
)
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.sample_limits import usable_imu, usable_pose, usable_velocity
from quadpi_core.signals.resample import RATE_SPAN

HOLD_NS = 10_000_000
_BUFFER_NS = round(BUFFER_S * 1e9)
# Rejections that persist for this long, and agree among themselves, are taken for the truth.
_PERSISTENCE_NS = 400_000_000
_PERSISTENCE_COUNT = 5
# So many equal values in a row never come from a sensor that has noise.
_REPEATS_MAX = 12

_HEAD, _FILLED, _CORRECTED_NS, _ACCEPTED_NS = Clock.HEAD, Clock.FILLED, Clock.CORRECTED_NS, Clock.ACCEPTED_NS
_HELD_FIRST, _HELD_COUNT, _STATUS, _JOURNALLED, _JUMPED_NS = (
    Clock.HELD_FIRST,
    Clock.HELD_COUNT,
    Clock.STATUS,
    Clock.JOURNALLED,
    Clock.JUMPED_NS,
)
_SPAN_NS, _OFF_NS = Clock.SPAN_NS, Clock.OFF_NS
_ARRIVED_NS, _SEEN_NS, _REPEATS, _CHANGES = Source.ARRIVED_NS, Source.SEEN_NS, Source.REPEATS, Source.CHANGES
_REFUSED_SINCE_NS, _REFUSED_NS, _REFUSED = Source.REFUSED_SINCE_NS, Source.REFUSED_NS, Source.REFUSED
_DELAY, _STATE_BEGIN, _WIDTH = Row.DELAY, Row.NOMINAL.start, Row.WIDTH
_USED, _TOO_LATE, _REJECTED, _FROZEN = (
    Outcome.USED.value,
    Outcome.TOO_LATE.value,
    Outcome.REJECTED.value,
    Outcome.FROZEN.value,
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
    here, the memory keeps but a stamp that jumped, and for how long the rate has been another.
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
    clock[_JUMPED_NS] = NO_STAMP
    if since <= 0:
        return Outcome.STAMP_NOT_ADVANCING.value
    length = len(stamps)
    if clock[_SPAN_NS] > 0 and clock[_FILLED] >= RATE_SPAN:
        span_ns = time_ns - stamps[(head + 1 - RATE_SPAN) % length]
        clock[_OFF_NS] = off_for(clock[_OFF_NS], span_ns, clock[_SPAN_NS], since)
        if clock[_OFF_NS] > NOTICED_NS:
            return Outcome.RESET.value
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
    return corrected_ns if corrected_ns >= memory.stamps[before] else NO_STAMP


@njit(cache=True)
def _base(memory: Memory, before: int, row: Array) -> None:
    """The last estimate in the interval that begins with `before`: the one there, or a correction's."""
    source = len(memory.stamps) if _corrected_ns(memory, before) != NO_STAMP else before
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
