# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled part of the pairing: rings of samples by topic, and what completes an IMU sample."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import Meter, follow, is_known
from quadpi_core.estimator.output import (
    MOTION_ATTITUDE,
    MOTION_FORCE,
    MOTION_RATES,
    MOTION_VELOCITY,
)
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.records import Records, record_dtype
from quadpi_core.signals.chain import (
    ATTITUDE,
    RATES,
    ROTOR_SPEEDS,
    SPECIFIC_FORCE,
    VELOCITY,
    WIND,
)

# The topics.
IMU, STATE, ROTORS, WIND_TOPIC, TOPICS = 0, 1, 2, 3, 4
# A state has the most numbers: the first signals of a sample.
_WIDEST = RATES.stop
# What becomes of the oldest IMU sample.
_WAITS, _EARLY, _TAKEN = 0, 1, 2
# How a stretch begins: where the previous one ended; with a stamp more than MAX_JUMP_BACK_NS before the
# newest; with one that far before the stamp of the previous sample, as the IMU's clock was set back.
CONTINUES, STEPS_BACK, SET_BACK = 0, 1, 2


class Arriving(NamedTuple):
    """Samples in the order in which they arrive.

    Attributes:
        kind: (E,) topic of each, :data:`IMU`, ….
        row: (E,) its row in the arrays of that topic.
        imu_ns, specific_force: (N,), (N, 3).
        state_ns, states: (S,), (S, 10) velocity, attitude and rates; see :meth:`.pairing.Pairing.add_state`.
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


class Track:
    """Where the last samples of a topic are in its ring; their stamps strictly increase."""

    oldest: int
    count: int
    newest_ns: int  # NO_STAMP before the first


class Entry:
    """A sample of a topic: as many of the numbers as it has are used."""

    time_ns: int
    values: Annotated[Array, _WIDEST]


class PairingState:
    """What the pairing remembers beside the rings."""

    tracks: Annotated[Records, Track, TOPICS]
    meter: Meter
    timeout_ns: int
    # Of the IMU: the newest stamp since one stepped back, and that of the last sample. Of replays only.
    newest_ns: int
    last_ns: int
    rate_changes: int  # `meter.changes` at the last :func:`take_samples`
    noted: bool  # whether the stamp at which a stretch begins has been noted
    # See pairing.PairingCounts.
    paired: int
    early: int
    dropped: int
    disordered: int


PAIRING_STATE, ENTRY = record_dtype(PairingState), record_dtype(Entry)


@njit(cache=True)
def add_imu_sample(states: Records, rings: Records, time_ns: int, specific_force: Array) -> bool:
    """Add an IMU sample that came live; returns whether :func:`take_samples` is due."""
    _follow_rate(states[0], time_ns)
    _add(states[0], rings, IMU, time_ns, specific_force)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def add_state_sample(
    states: Records, rings: Records, time_ns: int, velocity: Array, attitude: Array, rates: Array
) -> bool:
    """Add a state that came live; returns whether :func:`take_samples` is due."""
    _add_state(states[0], rings, time_ns, velocity, attitude, rates)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def add_estimate(states: Records, rings: Records, time_ns: int, motion: Array) -> bool:
    """Add an IMU sample with its state, a row of `FusedSamples.motion`; see :func:`add_imu_sample`."""
    _follow_rate(states[0], time_ns)
    _add(states[0], rings, IMU, time_ns, motion[MOTION_FORCE])
    _add_state(
        states[0], rings, time_ns, motion[MOTION_VELOCITY], motion[MOTION_ATTITUDE], motion[MOTION_RATES]
    )
    return _take_is_due(states[0], rings)


@njit(cache=True)
def add_sample(states: Records, rings: Records, topic: int, time_ns: int, values: Array) -> bool:
    """Add rotor speeds or a wind that came live; returns whether :func:`take_samples` is due."""
    _add(states[0], rings, topic, time_ns, values)
    return _take_is_due(states[0], rings)


@njit(cache=True)
def _take_is_due(state: PairingState, rings: Records) -> bool:
    """Whether the oldest IMU sample waits no longer, or the rate of the IMU has changed."""
    return bool(state.meter.changes != state.rate_changes or _fate_of_oldest(state, rings) != _WAITS)


@njit(cache=True)
def take_samples(states: Records, rings: Records, taken_ns: Stamps, taken: Array) -> tuple[int, bool]:
    """The number of samples taken, whose rows are filled, and whether the rate has changed."""
    state = states[0]
    changed = state.meter.changes != state.rate_changes
    state.rate_changes = state.meter.changes
    return _take(state, rings, taken_ns, taken), changed


@njit(cache=True)
def take_stretch(
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
            time_ns = arriving.state_ns[row]
            _add_state(state, rings, time_ns, values[VELOCITY], values[ATTITUDE], values[RATES])
        elif kind == ROTORS:
            _add(state, rings, ROTORS, arriving.rotor_ns[row], arriving.rotor_speeds[row])
        else:
            _add(state, rings, WIND_TOPIC, arriving.wind_ns[row], arriving.wind[row])
        count += _take(state, rings, taken_ns[count:], taken[count:])
    return arriving.kind.size, CONTINUES, count


@njit(cache=True)
def _begin_at(state: PairingState, time_ns: int) -> int:
    """How the stamp of an IMU sample continues those before it; it is noted."""
    begin = CONTINUES
    if state.newest_ns != NO_STAMP and time_ns < state.newest_ns - MAX_JUMP_BACK_NS:
        begin = SET_BACK if time_ns < state.last_ns - MAX_JUMP_BACK_NS else STEPS_BACK
        state.newest_ns = time_ns
    state.newest_ns, state.last_ns = max(state.newest_ns, time_ns), time_ns
    return begin


@njit(cache=True)
def _follow_rate(state: PairingState, time_ns: int) -> None:
    """Take the stamp of an IMU sample; if it makes the rate known, samples that wait are forgotten.

    Samples are used from that one on. Whether those that wait were completed before depends on which topic
    arrived first, and predictions must not.
    """
    was_known = is_known(state.meter)
    follow(state.meter, time_ns)
    if is_known(state.meter) and not was_known:
        state.tracks[IMU].count = 0


@njit(cache=True)
def _add(state: PairingState, rings: Records, topic: int, time_ns: int, values: Array) -> None:
    """Add a sample of a topic, unless its stamp does not advance."""
    index = _make_room(state, topic, time_ns, rings.shape[1])
    if index >= 0:
        entry = rings[topic, index]
        entry.time_ns = time_ns
        for k in range(values.size):
            entry.values[k] = values[k]


@njit(cache=True)
def _add_state(
    state: PairingState, rings: Records, time_ns: int, velocity: Array, attitude: Array, rates: Array
) -> None:
    """Add a state whose attitude has the sign nearest to the one before: q and −q are the same."""
    track, capacity = state.tracks[STATE], rings.shape[1]
    sign = 1.0
    if track.count > 0:
        newest = rings[STATE, (track.oldest + track.count - 1) % capacity]
        projection = 0.0
        for k in range(4):
            projection += newest.values[ATTITUDE][k] * attitude[k]
        sign = -1.0 if projection < 0.0 else 1.0
    index = _make_room(state, STATE, time_ns, capacity)
    if index >= 0:
        entry = rings[STATE, index]
        entry.time_ns = time_ns
        entry.values[VELOCITY], entry.values[RATES] = velocity, rates
        for k in range(4):
            entry.values[ATTITUDE][k] = sign * attitude[k]


@njit(cache=True)
def _make_room(state: PairingState, topic: int, time_ns: int, capacity: int) -> int:
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
def _take(state: PairingState, rings: Records, taken_ns: Stamps, taken: Array) -> int:
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
def _fate_of_oldest(state: PairingState, rings: Records) -> int:
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
def _complete(state: PairingState, rings: Records, time_ns: int, row: Array) -> bool:
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
def _drop_oldest(track: Track, capacity: int) -> None:
    track.oldest = (track.oldest + 1) % capacity
    track.count -= 1


@njit(cache=True)
def _starts_after(track: Track, ring: Records, time_ns: int) -> bool:
    """Whether every sample kept is later than the stamp: nothing can be interpolated there."""
    return bool(track.count > 0 and ring[track.oldest].time_ns > time_ns)


@njit(cache=True)
def _hold(track: Track, ring: Records, time_ns: int) -> int:
    """Index of the last sample at or before the stamp, forgetting earlier ones; −1 if there is none."""
    while track.count > 1 and ring[(track.oldest + 1) % ring.size].time_ns <= time_ns:
        _drop_oldest(track, ring.size)
    if track.count == 0 or ring[track.oldest].time_ns > time_ns:
        return -1
    return int(track.oldest)


@njit(cache=True)
def _interpolate(track: Track, ring: Records, time_ns: int, values: Array) -> bool:
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
