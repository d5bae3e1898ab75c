# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bring the live topics together: one complete sample per IMU stamp.

An IMU sample is complete once the state for its stamp and a rotor speed at or after its stamp have
arrived. Rotor speeds (and the state, where its stamps differ) are interpolated linearly to the IMU stamp;
wind, slow and optional, holds its last value. Everything is bounded: fixed-size buffers, and an IMU sample
that stays incomplete while the IMU runs ahead by the timeout is dropped and counted. The IMU's stamps also
tell its rate, which the filters behind are made for.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import CHANGES, LOST, ImuRate, Meter, follow, follow_arrays
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.monitor.health import Arrived
from quadpi_core.signals.chain import (
    ATTITUDE,
    CHANNELS,
    RATES,
    ROTOR_SPEEDS,
    SPECIFIC_FORCE,
    VELOCITY,
    WIND,
)

# How long, in stamps, an IMU sample waits for its state and rotor speed; live and in replay.
TIMEOUT_S = 0.1
# Samples kept per topic.
CAPACITY = 256

# The topics, and what is kept of each: index of the oldest sample, how many there are, the newest stamp.
IMU, STATE, ROTORS, WIND_TOPIC, _TRACKS = 0, 1, 2, 3, 4
_OLDEST, _COUNT, _NEWEST_NS = 0, 1, 2
# A state is the widest row.
_WIDEST = 10
# How a stretch begins: as the one before it ended; with a stamp that is more than MAX_JUMP_BACK_NS before the
# newest; with one that is so far before that of the last sample: the IMU's clock was set back.
CONTINUES, STEPS_BACK, SET_BACK = 0, 1, 2
# Of PairingCounts.
_PAIRED, _EARLY, _DROPPED, _DISORDERED = 0, 1, 2, 3


class PairedSamples(NamedTuple):
    """K complete samples.

    Attributes:
        time_ns: (K,) stamps.
        values: (K, 20) channels of :mod:`quadpi_core.signals.chain`: velocity over ground m/s, body axes;
            attitude body to world; rates rad/s; specific force m/s², body axes; rotor speeds rad/s; wind m/s,
            world.
    """

    time_ns: Stamps
    values: Array

    @classmethod
    def join(
        cls,
        time_ns: Stamps,
        *,
        velocity: Array,
        attitude: Array,
        rates: Array,
        specific_force: Array,
        rotor_speeds: Array,
        wind: Array,
    ) -> PairedSamples:
        """Samples of the channels one by one."""
        return cls(
            time_ns,
            np.concatenate((velocity, attitude, rates, specific_force, rotor_speeds, wind), axis=1),
        )

    @property
    def velocity(self) -> Array:
        """(K, 3) view."""
        return self.values[:, VELOCITY]

    @property
    def attitude(self) -> Array:
        """(K, 4) view."""
        return self.values[:, ATTITUDE]

    @property
    def rates(self) -> Array:
        """(K, 3) view."""
        return self.values[:, RATES]

    @property
    def specific_force(self) -> Array:
        """(K, 3) view."""
        return self.values[:, SPECIFIC_FORCE]

    @property
    def rotor_speeds(self) -> Array:
        """(K, 4) view."""
        return self.values[:, ROTOR_SPEEDS]

    @property
    def wind(self) -> Array:
        """(K, 3) view."""
        return self.values[:, WIND]


@dataclass(frozen=True)
class PairingCounts:
    """What became of the samples so far.

    Attributes:
        paired: IMU samples that were completed.
        early: IMU samples from before the first state or rotor speed; nothing could complete them.
        dropped: IMU samples given up because their state or rotor speeds did not arrive in time, or lie
            around a gap.
        disordered: samples of any topic refused because their stamp did not advance.
    """

    paired: int = 0
    early: int = 0
    dropped: int = 0
    disordered: int = 0


class Pairing:
    """The bounded buffers between the topics and the monitor.

    Args:
        timeout_s: how far, in stamps, the IMU may run ahead of an incomplete sample before it is given up.
        capacity: samples kept per topic; the oldest makes room.
        rate_hz: that a user says the IMU has; 0 where its stamps alone tell.
    """

    def __init__(self, timeout_s: float = TIMEOUT_S, capacity: int = CAPACITY, rate_hz: float = 0.0) -> None:
        self._timeout_ns = round(timeout_s * 1e9)
        self._tracks = _Tracks(
            time_ns=np.zeros((_TRACKS, capacity), dtype=np.int64),
            rows=np.zeros((_TRACKS, capacity, _WIDEST)),
            places=np.array([[0, 0, NO_STAMP]] * _TRACKS),
            counts=np.zeros(4, dtype=np.int64),
        )
        # Of the IMU: the newest stamp since one stepped back, and that of the last sample.
        self._clock = np.full(2, NO_STAMP)
        self._given_hz = rate_hz
        self._meter = Meter.empty()
        self._changes = self._meter.changes
        self._rate = self._meter.rate(rate_hz)
        self._taken_ns = np.empty(capacity, dtype=np.int64)
        self._taken = np.empty((capacity, CHANNELS))
        # Compiled now, not when the first sample waits for it.
        self.take()

    @property
    def counts(self) -> PairingCounts:
        """What became of the samples so far."""
        return PairingCounts(*self._tracks.counts.tolist())

    @property
    def arrived(self) -> Arrived:
        """How far the inputs have come."""
        newest = self._tracks.places[:, _NEWEST_NS].tolist()
        imu_ns, state_ns, rotors_ns, _ = (None if time_ns == NO_STAMP else time_ns for time_ns in newest)
        judged = 0 if self.rate.begins else self.counts.paired + self.counts.dropped
        return Arrived(imu_ns, state_ns, rotors_ns, judged)

    @property
    def rate(self) -> ImuRate:
        """What the stamps of the IMU tell of its rate; it is that of the samples taken now."""
        if self._meter.changes != self._changes:
            self._changes = self._meter.changes
            self._rate = self._meter.rate(self._given_hz)
        return self._rate

    def add_imu(self, time_ns: int, specific_force: Array) -> None:
        """Take one IMU sample: specific_force (3,) m/s², body axes."""
        follow_arrays(*self._meter, time_ns)
        _add_to(*self._tracks, IMU, time_ns, specific_force)

    def add_state(self, time_ns: int, velocity: Array, attitude: Array, rates: Array) -> None:
        """Take one state: velocity (3,) m/s and rates (3,) rad/s, body axes; attitude (4,) body to world."""
        _add_state_to(*self._tracks, time_ns, velocity, attitude, rates)

    def add_estimate(self, time_ns: int, motion: Array) -> None:
        """Take an IMU sample and the state at its stamp in one: a row of `FusedSamples.motion`."""
        follow_arrays(*self._meter, time_ns)
        _add_estimate_to(*self._tracks, time_ns, motion)

    def add_rotor_speeds(self, time_ns: int, speeds: Array) -> None:
        """Take one sample of the rotor speeds (4,) rad/s."""
        _add_to(*self._tracks, ROTORS, time_ns, speeds)

    def add_wind(self, time_ns: int, velocity: Array) -> None:
        """Take one sample of the wind (3,) m/s in the world."""
        _add_to(*self._tracks, WIND_TOPIC, time_ns, velocity)

    def begin_with_newest(self) -> None:
        """Forget the IMU samples that wait, but for the newest: see :func:`first_known`."""
        oldest, count, _ = self._tracks.places[IMU].tolist()
        if count > 1:
            self._tracks.places[IMU, _OLDEST] = (oldest + count - 1) % self._tracks.time_ns.shape[1]
            self._tracks.places[IMU, _COUNT] = 1

    def take(self) -> PairedSamples | None:
        """The IMU samples completed or given up since the last call, in order; None if there are none."""
        count = _take_from(*self._tracks, self._timeout_ns, self._taken_ns, self._taken)
        if count == 0:
            return None
        return PairedSamples(self._taken_ns[:count].copy(), self._taken[:count].copy())

    @property
    def settled_ns(self) -> int:
        """No sample will be taken at or before this stamp, unless the IMU's clock is set back."""
        oldest, count, newest_ns = self._tracks.places[IMU].tolist()
        return int(self._tracks.time_ns[IMU, oldest]) - 1 if count else int(newest_ns)

    def take_all(self, arriving: Arriving) -> list[Stretch]:
        """What :meth:`take` gives after each arrival, joined.

        Apart where the IMU's stamps step back, and where what they tell of its rate changes.
        """
        breaks = np.empty((arriving.kind.size, 3), dtype=np.int64)
        spans_ns = np.empty(arriving.kind.size)
        before = self.rate
        count = _find_breaks(
            arriving.kind, arriving.row, arriving.imu_ns, self._clock, self._meter, breaks, spans_ns
        )
        stretches = []
        known = 0
        begins = [(0, CONTINUES, before)]
        for (place, begin, lost), span_ns in zip(breaks[:count].tolist(), spans_ns.tolist(), strict=False):
            begins.append((place, begin, ImuRate.of_span(span_ns, self._given_hz, bool(lost))))
        end = (arriving.kind.size, CONTINUES, before)
        for (start, begin, rate), (stop, *_) in pairwise([*begins, end]):
            if first_known(before, rate):
                self._tracks.places[IMU, _COUNT] = 0
            before = rate
            if start == stop and len(begins) > 1:
                continue
            own = arriving._replace(kind=arriving.kind[start:stop], row=arriving.row[start:stop])
            room = int(np.count_nonzero(own.kind == IMU)) + int(self._tracks.places[IMU, _COUNT])
            taken_ns, taken = np.empty(room, dtype=np.int64), np.empty((room, CHANNELS))
            taken_count = _take_all(*self._tracks, self._timeout_ns, own, taken_ns, taken)
            samples = PairedSamples(taken_ns[:taken_count], taken[:taken_count])
            states = slice(known, known + int(np.count_nonzero(own.kind == STATE)))
            known = states.stop
            stretches.append(Stretch(begin, rate, samples, states, self.settled_ns))
        return stretches


def first_known(before: ImuRate, rate: ImuRate) -> bool:
    """Whether the rate of the IMU has just become known, for the first time.

    Samples are used from that one on. Whether those that wait were completed before depends on which topic
    arrived first, and predictions must not.
    """
    return before.begins and not rate.begins


class Stretch(NamedTuple):
    """What came while the stamps of the IMU did not step back, and told the same of its rate.

    Attributes:
        begin: how it begins, one of :data:`CONTINUES`, :data:`STEPS_BACK` and :data:`SET_BACK`.
        rate: of its samples.
        samples: that were completed or given up.
        states: rows of the states that came.
        settled_ns: :attr:`Pairing.settled_ns` at its end.
    """

    begin: int
    rate: ImuRate
    samples: PairedSamples
    states: slice
    settled_ns: int


class Arriving(NamedTuple):
    """Samples in the order in which they arrive.

    Attributes:
        kind, row: (E,) topic of each (:data:`IMU`, …), and its row in the arrays of that topic.
        imu_ns, specific_force: (N,), (N, 3).
        state_ns, states: (S,), (S, 10) velocity and attitude, rates; see :meth:`Pairing.add_state`.
        rotor_ns, rotor_speeds: (R,), (R, 4).
        wind_ns, wind: (W,), (W, 3).
    """

    kind: Stamps
    row: Stamps
    imu_ns: Stamps
    specific_force: Array
    state_ns: Stamps
    states: Array
    rotor_ns: Stamps
    rotor_speeds: Array
    wind_ns: Stamps
    wind: Array


class _Tracks(NamedTuple):
    """The last samples of each topic, in rings; stamps strictly increase within one.

    Attributes:
        time_ns: (4, capacity) stamps.
        rows: (4, capacity, 10) values, as many of a row as the topic has.
        places: (4, 3) index of the oldest sample, how many there are, and the newest stamp.
        counts: (4,) of :class:`PairingCounts`.
    """

    time_ns: Stamps
    rows: Array
    places: Stamps
    counts: Stamps


# What Python calls takes arrays one by one: a tuple of them costs twice as much to hand over.
@njit(cache=True)
def _add_to(time_ns: Any, rows: Any, places: Any, counts: Any, track: int, at_ns: int, values: Any) -> None:
    _add(_Tracks(time_ns, rows, places, counts), track, at_ns, values)


@njit(cache=True)
def _add_state_to(
    time_ns: Any, rows: Any, places: Any, counts: Any, at_ns: int, velocity: Any, attitude: Any, rates: Any
) -> None:
    _add_state(_Tracks(time_ns, rows, places, counts), at_ns, velocity, attitude, rates)


@njit(cache=True)
def _add_estimate_to(time_ns: Any, rows: Any, places: Any, counts: Any, at_ns: int, motion: Any) -> None:
    tracks = _Tracks(time_ns, rows, places, counts)
    _add(tracks, IMU, at_ns, motion[10:])
    _add_state(tracks, at_ns, motion[4:7], motion[:4], motion[7:10])


@njit(cache=True)
def _take_from(
    time_ns: Any, rows: Any, places: Any, counts: Any, timeout_ns: int, taken_ns: Any, taken: Any
) -> int:
    return _take(_Tracks(time_ns, rows, places, counts), timeout_ns, taken_ns, taken)


@njit(cache=True)
def _take_all(
    time_ns: Any,
    rows: Any,
    places: Any,
    counts: Any,
    timeout_ns: int,
    arriving: Any,
    taken_ns: Any,
    taken: Any,
) -> int:
    """Fill stamps and rows; their number."""
    tracks = _Tracks(time_ns, rows, places, counts)
    count = 0
    for event in range(arriving.kind.size):
        kind, row = arriving.kind[event], arriving.row[event]
        if kind == IMU:
            _add(tracks, IMU, arriving.imu_ns[row], arriving.specific_force[row])
        elif kind == STATE:
            state = arriving.states[row]
            _add_state(tracks, arriving.state_ns[row], state[:3], state[3:7], state[7:])
        elif kind == ROTORS:
            _add(tracks, ROTORS, arriving.rotor_ns[row], arriving.rotor_speeds[row])
        else:
            _add(tracks, WIND_TOPIC, arriving.wind_ns[row], arriving.wind[row])
        count += _take(tracks, timeout_ns, taken_ns[count:], taken[count:])
    return count


@njit(cache=True)
def _find_breaks(kind: Any, row: Any, imu_ns: Any, clock: Any, meter: Any, breaks: Any, spans_ns: Any) -> int:
    """Find where the IMU's stamps step back, or tell something else of its rate; the number of places.

    Fills (E, 3) places in `kind`, how it begins there, and whether the rate is lost; (E,) usual spans [ns].
    """
    count = 0
    for event in range(kind.size):
        if kind[event] != IMU:
            continue
        time_ns, newest_ns, last_ns = imu_ns[row[event]], clock[0], clock[1]
        begin, changes = CONTINUES, meter.numbers[CHANGES]
        if newest_ns != NO_STAMP and time_ns < newest_ns - MAX_JUMP_BACK_NS:
            begin = SET_BACK if time_ns < last_ns - MAX_JUMP_BACK_NS else STEPS_BACK
            clock[0] = time_ns
        clock[0], clock[1] = max(clock[0], time_ns), time_ns
        follow(meter, time_ns)
        if begin != CONTINUES or meter.numbers[CHANGES] != changes:
            breaks[count, 0], breaks[count, 1] = event, begin
            breaks[count, 2], spans_ns[count] = meter.numbers[LOST], meter.span[0]
            count += 1
    return count


@njit(cache=True)
def _make_room(tracks: Any, track: int, time_ns: int) -> int:
    """Where to write a sample of that stamp, which now is the newest; −1 if its stamp does not advance."""
    place, capacity = tracks.places[track], tracks.time_ns.shape[1]
    if time_ns <= place[_NEWEST_NS]:
        if place[_NEWEST_NS] - time_ns <= MAX_JUMP_BACK_NS:
            tracks.counts[_DISORDERED] += 1
            return -1
        place[_COUNT] = 0
        if track == IMU and tracks.places[STATE, _NEWEST_NS] > time_ns:
            # The states kept are of the time before, and may be ahead of those that come.
            tracks.places[STATE, _COUNT], tracks.places[STATE, _NEWEST_NS] = 0, NO_STAMP
    place[_NEWEST_NS] = time_ns
    if place[_COUNT] == capacity:
        place[_OLDEST] = (place[_OLDEST] + 1) % capacity
        place[_COUNT] -= 1
    index = (place[_OLDEST] + place[_COUNT]) % capacity
    place[_COUNT] += 1
    tracks.time_ns[track, index] = time_ns
    return int(index)


@njit(cache=True)
def _add(tracks: Any, track: int, time_ns: int, values: Any) -> None:
    index = _make_room(tracks, track, time_ns)
    if index >= 0:
        for k in range(values.size):
            tracks.rows[track, index, k] = values[k]


@njit(cache=True)
def _add_state(tracks: Any, time_ns: int, velocity: Any, attitude: Any, rates: Any) -> None:
    """Add a state whose attitude has the sign nearest to the one before: q and −q are the same."""
    place, capacity = tracks.places[STATE], tracks.time_ns.shape[1]
    sign = 1.0
    if place[_COUNT] > 0:
        newest = tracks.rows[STATE, (place[_OLDEST] + place[_COUNT] - 1) % capacity]
        projection = 0.0
        for k in range(4):
            projection += newest[3 + k] * attitude[k]
        sign = -1.0 if projection < 0.0 else 1.0
    index = _make_room(tracks, STATE, time_ns)
    if index >= 0:
        row = tracks.rows[STATE, index]
        for k in range(3):
            row[k], row[7 + k] = velocity[k], rates[k]
        for k in range(4):
            row[3 + k] = sign * attitude[k]


@njit(cache=True)
def _take(tracks: Any, timeout_ns: int, taken_ns: Any, taken: Any) -> int:
    """Fill stamps and rows (velocity, attitude, rates, specific force, rotor speeds, wind); their number."""
    imu, capacity = tracks.places[IMU], tracks.time_ns.shape[1]
    state, rotors = tracks.places[STATE], tracks.places[ROTORS]
    count = 0
    while imu[_COUNT] > 0:
        time_ns = tracks.time_ns[IMU, imu[_OLDEST]]
        too_early = _starts_after(tracks, STATE, time_ns) or _starts_after(tracks, ROTORS, time_ns)
        complete = state[_NEWEST_NS] >= time_ns and rotors[_NEWEST_NS] >= time_ns
        if not (too_early or complete):
            if imu[_COUNT] < capacity and imu[_NEWEST_NS] - time_ns <= timeout_ns:
                break
            too_early = state[_COUNT] == 0 or rotors[_COUNT] == 0
        if too_early:
            tracks.counts[_EARLY] += 1
        else:
            row = taken[count]
            tracks.counts[_PAIRED if _complete(tracks, time_ns, row) else _DROPPED] += 1
            row[SPECIFIC_FORCE] = tracks.rows[IMU, imu[_OLDEST], :3]
            taken_ns[count] = time_ns
            count += 1
        _drop_oldest(imu, capacity)
    return count


@njit(cache=True)
def _complete(tracks: Any, time_ns: int, row: Any) -> bool:
    """Fill state, rotor speeds and wind at the stamp; False if state or rotor speeds are not known there."""
    known = _interpolate(tracks, STATE, time_ns, row[: RATES.stop])
    row[ATTITUDE] /= np.sqrt(np.sum(row[ATTITUDE] * row[ATTITUDE]))
    known &= _interpolate(tracks, ROTORS, time_ns, row[ROTOR_SPEEDS])
    row[WIND] = 0.0
    held = _hold(tracks, WIND_TOPIC, time_ns)
    if held >= 0:
        row[WIND] = tracks.rows[WIND_TOPIC, held, :3]
    return bool(known)


@njit(cache=True)
def _drop_oldest(place: Any, capacity: int) -> None:
    place[_OLDEST] = (place[_OLDEST] + 1) % capacity
    place[_COUNT] -= 1


@njit(cache=True)
def _starts_after(tracks: Any, track: int, time_ns: int) -> bool:
    """Whether every sample kept is later than the stamp: nothing can be interpolated there."""
    place = tracks.places[track]
    return bool(place[_COUNT] > 0 and tracks.time_ns[track, place[_OLDEST]] > time_ns)


@njit(cache=True)
def _hold(tracks: Any, track: int, time_ns: int) -> int:
    """Index of the last sample at or before the stamp, forgetting earlier ones; −1 if there is none."""
    place, capacity = tracks.places[track], tracks.time_ns.shape[1]
    while place[_COUNT] > 1 and tracks.time_ns[track, (place[_OLDEST] + 1) % capacity] <= time_ns:
        _drop_oldest(place, capacity)
    if place[_COUNT] == 0 or tracks.time_ns[track, place[_OLDEST]] > time_ns:
        return -1
    return int(place[_OLDEST])


@njit(cache=True)
def _interpolate(tracks: Any, track: int, time_ns: int, values: Any) -> bool:
    """Fill the values at a stamp, linearly between the samples around it; NaN and False without these.

    Samples farther apart than MAX_GAP_NS are none: nothing is known of the time between.
    """
    before = _hold(tracks, track, time_ns)
    before_ns, first = tracks.time_ns[track, before], tracks.rows[track, before]
    if before_ns == time_ns:
        values[:] = first[: values.size]
        return True
    after = (before + 1) % tracks.time_ns.shape[1]
    if tracks.places[track, _COUNT] < 2 or tracks.time_ns[track, after] - before_ns > MAX_GAP_NS:
        values[:] = np.nan
        return False
    fraction = (time_ns - before_ns) / (tracks.time_ns[track, after] - before_ns)
    second = tracks.rows[track, after]
    for k in range(values.size):
        values[k] = first[k] + fraction * (second[k] - first[k])
    return True
