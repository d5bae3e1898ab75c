# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bring the live topics together: one complete sample per IMU stamp.

An IMU sample is complete once the state for its stamp and a rotor speed at or after its stamp have
arrived. Rotor speeds (and the state, where its stamps differ) are interpolated linearly to the IMU stamp;
wind, slow and optional, holds its last value. Everything is bounded: fixed-size buffers, and an IMU sample
that stays incomplete while the IMU runs ahead by the timeout is dropped and counted. The rate of the IMU is
measured from its stamps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import ImuRate, Meter, follow, is_known
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.monitor.health import Arrived
from quadpi_core.records import Records, record_dtype
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

# The topics.
IMU, STATE, ROTORS, WIND_TOPIC, _TOPICS = 0, 1, 2, 3, 4
# A state has the most numbers.
_WIDEST = 10
# What becomes of the oldest IMU sample.
_WAITS, _EARLY, _TAKEN = 0, 1, 2
# How a stretch begins: where the previous one ended; with a stamp more than MAX_JUMP_BACK_NS before the
# newest; with one that far before the stamp of the previous sample, as the IMU's clock was set back.
CONTINUES, STEPS_BACK, SET_BACK = 0, 1, 2


class PairedSamples(NamedTuple):
    """K samples, one per IMU stamp, with all that a monitor needs.

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
        """Samples from their channels."""
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
        early: IMU samples before the first state or rotor speed, which nothing could complete.
        dropped: IMU samples given up because their state or rotor speeds did not arrive in time, or lie
            around a gap.
        disordered: samples of any topic refused because their stamp did not advance.
    """

    paired: int = 0
    early: int = 0
    dropped: int = 0
    disordered: int = 0


class Stretch(NamedTuple):
    """Samples between which the IMU's stamps do not step back and its rate does not change.

    Attributes:
        begin: how it begins, one of :data:`CONTINUES`, :data:`STEPS_BACK` and :data:`SET_BACK`.
        rate: of the IMU.
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
        kind: (E,) topic of each, :data:`IMU`, ….
        row: (E,) its row in the arrays of that topic.
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


class _Track:
    """Where the last samples of a topic are in its ring; their stamps strictly increase."""

    oldest: int
    count: int
    newest_ns: int  # NO_STAMP before the first


class _Entry:
    """A sample of a topic: as many of the numbers as it has are used."""

    time_ns: int
    values: Annotated[Array, _WIDEST]


class _State:
    """What the pairing remembers beside the rings."""

    tracks: Annotated[Records, _Track, _TOPICS]
    meter: Meter
    timeout_ns: int
    # Of the IMU: the newest stamp since one stepped back, and that of the last sample. Of replays only.
    newest_ns: int
    last_ns: int
    rate_changes: int  # `meter.changes` at the last :func:`_take_samples`
    noted: bool  # whether the stamp at which a stretch begins has been noted
    # See PairingCounts.
    paired: int
    early: int
    dropped: int
    disordered: int


class Pairing:
    """The bounded buffers between the topics and the monitor.

    Args:
        timeout_s: how far, in stamps, the IMU may run ahead of an incomplete sample before it is given up.
        capacity: samples kept per topic; the oldest makes room.
        rate_hz: of the IMU, as the user gives it; 0 where its stamps alone count.

    Attributes:
        rate: of the IMU, by its stamps up to the last :meth:`take`; the samples taken have it.
    """

    def __init__(self, timeout_s: float = TIMEOUT_S, capacity: int = CAPACITY, rate_hz: float = 0.0) -> None:
        self._given_hz = rate_hz
        self._state = np.zeros(1, record_dtype(_State))
        self._state["timeout_ns"] = round(timeout_s * 1e9)
        for stamps in (self._state["tracks"]["newest_ns"], self._state["newest_ns"], self._state["last_ns"]):
            stamps[:] = NO_STAMP
        self._rings = np.zeros((_TOPICS, capacity), record_dtype(_Entry))
        self._taken_ns = np.empty(capacity, dtype=np.int64)
        self._taken = np.empty((capacity, CHANNELS))
        self.rate = ImuRate.of(self._state["meter"], rate_hz)
        # Whether :meth:`take` has something to do; the first call compiles its kernel.
        self._ready = True
        self.take()

    @property
    def counts(self) -> PairingCounts:
        """What became of the samples so far."""
        state = self._state[0]
        return PairingCounts(*(int(state[name]) for name in ("paired", "early", "dropped", "disordered")))

    @property
    def arrived(self) -> Arrived:
        """The newest stamp of each input, and how many samples have been judged."""
        newest = self._state["tracks"]["newest_ns"][0].tolist()
        imu_ns, state_ns, rotors_ns, _ = (None if time_ns == NO_STAMP else time_ns for time_ns in newest)
        counts = self.counts
        return Arrived(imu_ns, state_ns, rotors_ns, 0 if self.rate.begins else counts.paired + counts.dropped)

    @property
    def settled_ns(self) -> int:
        """No sample will be taken at or before this stamp, unless the IMU's clock is set back."""
        imu = self._state["tracks"][0, IMU]
        return int(self._rings["time_ns"][IMU, imu["oldest"]]) - 1 if imu["count"] else int(imu["newest_ns"])

    def add_imu(self, time_ns: int, specific_force: Array) -> None:
        """Take one IMU sample: specific_force (3,) m/s², body axes."""
        self._ready |= _add_imu_sample(self._state, self._rings, time_ns, specific_force)

    def add_state(self, time_ns: int, velocity: Array, attitude: Array, rates: Array) -> None:
        """Take one state: velocity (3,) m/s and rates (3,) rad/s, body axes; attitude (4,) body to world."""
        self._ready |= _add_state_sample(self._state, self._rings, time_ns, velocity, attitude, rates)

    def add_estimate(self, time_ns: int, motion: Array) -> None:
        """Take an IMU sample and the state at its stamp in one: a row of `FusedSamples.motion`."""
        self._ready |= _add_estimate(self._state, self._rings, time_ns, motion)

    def add_rotor_speeds(self, time_ns: int, speeds: Array) -> None:
        """Take one sample of the rotor speeds (4,) rad/s."""
        self._ready |= _add_sample(self._state, self._rings, ROTORS, time_ns, speeds)

    def add_wind(self, time_ns: int, velocity: Array) -> None:
        """Take one sample of the wind (3,) m/s in the world."""
        self._ready |= _add_sample(self._state, self._rings, WIND_TOPIC, time_ns, velocity)

    def take(self) -> PairedSamples | None:
        """The IMU samples completed or given up since the last call, in order; None if there are none."""
        if not self._ready:
            return None
        self._ready = False
        count, rate_changed = _take_samples(self._state, self._rings, self._taken_ns, self._taken)
        if rate_changed:
            self.rate = ImuRate.of(self._state["meter"], self._given_hz)
        if count == 0:
            return None
        return PairedSamples(self._taken_ns[:count].copy(), self._taken[:count].copy())

    def take_all(self, arriving: Arriving) -> list[Stretch]:
        """What :meth:`take` gives after each arrival, joined.

        Apart where the IMU's stamps step back, and where its rate changes.
        """
        room = np.count_nonzero(arriving.kind == IMU) + int(self._state["tracks"][0, IMU]["count"])
        taken_ns, taken = np.empty(room, dtype=np.int64), np.empty((room, CHANNELS))
        state_count = np.cumsum(arriving.kind == STATE)
        stretches: list[Stretch] = []
        start, begin, filled, states = 0, CONTINUES, 0, 0
        while start < arriving.kind.size or not stretches:
            stop, next_begin, count = _take_stretch(
                self._state, self._rings, arriving, start, taken_ns[filled:], taken[filled:]
            )
            if stop > start or stop == arriving.kind.size:
                rows = slice(filled, filled + count)
                before, states = states, int(state_count[stop - 1]) if stop else 0
                samples = PairedSamples(taken_ns[rows], taken[rows])
                stretches.append(Stretch(begin, self.rate, samples, slice(before, states), self.settled_ns))
                filled = rows.stop
            start, begin = stop, next_begin
            self.rate = ImuRate.of(self._state["meter"], self._given_hz)
        return stretches


@njit(cache=True)
def _add_imu_sample(states: Records, rings: Records, time_ns: int, specific_force: Array) -> bool:
    """As the other `_add_` of samples that come live: returns whether :func:`_take_samples` is due."""
    _follow_rate(states[0], time_ns)
    _add(states[0], rings, IMU, time_ns, specific_force)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def _add_state_sample(
    states: Records, rings: Records, time_ns: int, velocity: Array, attitude: Array, rates: Array
) -> bool:
    _add_state(states[0], rings, time_ns, velocity, attitude, rates)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def _add_estimate(states: Records, rings: Records, time_ns: int, motion: Array) -> bool:
    _follow_rate(states[0], time_ns)
    _add(states[0], rings, IMU, time_ns, motion[10:])
    _add_state(states[0], rings, time_ns, motion[4:7], motion[:4], motion[7:10])
    return _take_is_due(states[0], rings)


@njit(cache=True)
def _add_sample(states: Records, rings: Records, topic: int, time_ns: int, values: Array) -> bool:
    _add(states[0], rings, topic, time_ns, values)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def _take_is_due(state: _State, rings: Records) -> bool:
    """Whether the oldest IMU sample waits no longer, or the rate of the IMU has changed."""
    return bool(state.meter.changes != state.rate_changes or _fate_of_oldest(state, rings) != _WAITS)


@njit(cache=True)
def _take_samples(states: Records, rings: Records, taken_ns: Stamps, taken: Array) -> tuple[int, bool]:
    """The number of samples taken, whose rows are filled, and whether the rate has changed."""
    state = states[0]
    changed = state.meter.changes != state.rate_changes
    state.rate_changes = state.meter.changes
    return _take(state, rings, taken_ns, taken), changed


@njit(cache=True)
def _take_stretch(
    states: Records, rings: Records, arriving: Arriving, start: int, taken_ns: Stamps, taken: Array
) -> tuple[int, int, int]:
    """Take arrivals from `start` on until the IMU's stamps step back, or its rate changes.

    Returns:
        The arrival at which the next stretch begins, how it begins, and the number of samples taken, whose
        rows are filled. That arrival's stamp has been noted: the next call does not note it again.
    """
    state = states[0]
    count = 0
    for event in range(start, arriving.kind.size):
        kind, row = arriving.kind[event], arriving.row[event]
        if kind == IMU:
            time_ns = arriving.imu_ns[row]
            if not state.noted:
                begin, changes = _begin_at(state, time_ns), state.meter.changes
                _follow_rate(state, time_ns)
                if begin != CONTINUES or state.meter.changes != changes:
                    state.noted = True
                    return event, begin, count
            state.noted = False
            _add(state, rings, IMU, time_ns, arriving.specific_force[row])
        elif kind == STATE:
            values = arriving.states[row]
            _add_state(state, rings, arriving.state_ns[row], values[:3], values[3:7], values[7:])
        elif kind == ROTORS:
            _add(state, rings, ROTORS, arriving.rotor_ns[row], arriving.rotor_speeds[row])
        else:
            _add(state, rings, WIND_TOPIC, arriving.wind_ns[row], arriving.wind[row])
        count += _take(state, rings, taken_ns[count:], taken[count:])
    return arriving.kind.size, CONTINUES, count


@njit(cache=True)
def _begin_at(state: _State, time_ns: int) -> int:
    """How the stamp of an IMU sample continues those before it; it is noted."""
    begin = CONTINUES
    if state.newest_ns != NO_STAMP and time_ns < state.newest_ns - MAX_JUMP_BACK_NS:
        begin = SET_BACK if time_ns < state.last_ns - MAX_JUMP_BACK_NS else STEPS_BACK
        state.newest_ns = time_ns
    state.newest_ns, state.last_ns = max(state.newest_ns, time_ns), time_ns
    return begin


@njit(cache=True)
def _follow_rate(state: _State, time_ns: int) -> None:
    """Take the stamp of an IMU sample; if it makes the rate known, samples that wait are forgotten.

    Samples are used from that one on. Whether those that wait were completed before depends on which topic
    arrived first, and predictions must not.
    """
    was_known = is_known(state.meter)
    follow(state.meter, time_ns)
    if is_known(state.meter) and not was_known:
        state.tracks[IMU].count = 0


@njit(cache=True)
def _add(state: _State, rings: Records, topic: int, time_ns: int, values: Array) -> None:
    """Add a sample of a topic, unless its stamp does not advance."""
    index = _make_room(state, topic, time_ns, rings.shape[1])
    if index >= 0:
        entry = rings[topic, index]
        entry.time_ns = time_ns
        for k in range(values.size):
            entry.values[k] = values[k]


@njit(cache=True)
def _add_state(
    state: _State, rings: Records, time_ns: int, velocity: Array, attitude: Array, rates: Array
) -> None:
    """Add a state whose attitude has the sign nearest to the one before: q and −q are the same."""
    track, capacity = state.tracks[STATE], rings.shape[1]
    sign = 1.0
    if track.count > 0:
        newest = rings[STATE, (track.oldest + track.count - 1) % capacity]
        projection = 0.0
        for k in range(4):
            projection += newest.values[3 + k] * attitude[k]
        sign = -1.0 if projection < 0.0 else 1.0
    index = _make_room(state, STATE, time_ns, capacity)
    if index >= 0:
        entry = rings[STATE, index]
        entry.time_ns = time_ns
        for k in range(3):
            entry.values[k], entry.values[7 + k] = velocity[k], rates[k]
        for k in range(4):
            entry.values[3 + k] = sign * attitude[k]


@njit(cache=True)
def _make_room(state: _State, topic: int, time_ns: int, capacity: int) -> int:
    """Index in the ring for a sample of that stamp, which is now the newest; −1 if it does not advance."""
    track = state.tracks[topic]
    if time_ns <= track.newest_ns:
        if track.newest_ns - time_ns <= MAX_JUMP_BACK_NS:
            state.disordered += 1
            return -1
        track.count = 0
        if topic == IMU and state.tracks[STATE].newest_ns > time_ns:
            # The states kept are from before the jump back, and may be ahead of those that come.
            state.tracks[STATE].count = 0
            state.tracks[STATE].newest_ns = NO_STAMP
    track.newest_ns = time_ns
    if track.count == capacity:
        _drop_oldest(track, capacity)
    index = (track.oldest + track.count) % capacity
    track.count += 1
    return int(index)


@njit(cache=True)
def _take(state: _State, rings: Records, taken_ns: Stamps, taken: Array) -> int:
    """Fill stamps and rows of the samples that are complete or given up; returns their number."""
    imu, capacity = state.tracks[IMU], rings.shape[1]
    count = 0
    while True:
        fate = _fate_of_oldest(state, rings)
        if fate == _WAITS:
            return count
        if fate == _EARLY:
            state.early += 1
        else:
            sample, row = rings[IMU, imu.oldest], taken[count]
            if _complete(state, rings, sample.time_ns, row):
                state.paired += 1
            else:
                state.dropped += 1
            row[SPECIFIC_FORCE] = sample.values[:3]
            taken_ns[count] = sample.time_ns
            count += 1
        _drop_oldest(imu, capacity)


@njit(cache=True)
def _fate_of_oldest(state: _State, rings: Records) -> int:
    """Whether the oldest IMU sample waits, is too early for anything to complete it, or is to be taken."""
    imu, states, rotors = state.tracks[IMU], state.tracks[STATE], state.tracks[ROTORS]
    if imu.count == 0:
        return _WAITS
    time_ns = rings[IMU, imu.oldest].time_ns
    if _starts_after(states, rings[STATE], time_ns) or _starts_after(rotors, rings[ROTORS], time_ns):
        return _EARLY
    if states.newest_ns >= time_ns and rotors.newest_ns >= time_ns:
        return _TAKEN
    if imu.count < rings.shape[1] and imu.newest_ns - time_ns <= state.timeout_ns:
        return _WAITS
    return _EARLY if states.count == 0 or rotors.count == 0 else _TAKEN


@njit(cache=True)
def _complete(state: _State, rings: Records, time_ns: int, row: Array) -> bool:
    """Fill state, rotor speeds and wind at a stamp; False if state or rotor speeds are not known there."""
    known = _interpolate(state.tracks[STATE], rings[STATE], time_ns, row[: RATES.stop])
    row[ATTITUDE] /= np.sqrt(np.sum(row[ATTITUDE] * row[ATTITUDE]))
    known &= _interpolate(state.tracks[ROTORS], rings[ROTORS], time_ns, row[ROTOR_SPEEDS])
    row[WIND] = 0.0
    held = _hold(state.tracks[WIND_TOPIC], rings[WIND_TOPIC], time_ns)
    if held >= 0:
        row[WIND] = rings[WIND_TOPIC, held].values[:3]
    return bool(known)


@njit(cache=True)
def _drop_oldest(track: _Track, capacity: int) -> None:
    track.oldest = (track.oldest + 1) % capacity
    track.count -= 1


@njit(cache=True)
def _starts_after(track: _Track, ring: Records, time_ns: int) -> bool:
    """Whether every sample kept is later than the stamp: nothing can be interpolated there."""
    return bool(track.count > 0 and ring[track.oldest].time_ns > time_ns)


@njit(cache=True)
def _hold(track: _Track, ring: Records, time_ns: int) -> int:
    """Index of the last sample at or before the stamp, forgetting earlier ones; −1 if there is none."""
    while track.count > 1 and ring[(track.oldest + 1) % ring.size].time_ns <= time_ns:
        _drop_oldest(track, ring.size)
    if track.count == 0 or ring[track.oldest].time_ns > time_ns:
        return -1
    return int(track.oldest)


@njit(cache=True)
def _interpolate(track: _Track, ring: Records, time_ns: int, values: Array) -> bool:
    """Fill the values at a stamp, linearly between the samples around it; NaN and False without these.

    Between samples farther apart than MAX_GAP_NS nothing is known.
    """
    before = _hold(track, ring, time_ns)
    first = ring[before]
    if first.time_ns == time_ns:
        values[:] = first.values[: values.size]
        return True
    second = ring[(before + 1) % ring.size]
    if track.count < 2 or second.time_ns - first.time_ns > MAX_GAP_NS:
        values[:] = np.nan
        return False
    fraction = (time_ns - first.time_ns) / (second.time_ns - first.time_ns)
    for k in range(values.size):
        values[k] = first.values[k] + fraction * (second.values[k] - first.values[k])
    return True
