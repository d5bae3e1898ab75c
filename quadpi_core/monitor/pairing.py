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
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.estimator.filter_state import ImuRate, Meter
from quadpi_core.flight import NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.monitor.health import Arrived
from quadpi_core.records import ROTORS_MAX, Records, brief_repr, record_dtype
from quadpi_core.signals.chain import ATTITUDE, RATES, ROTOR_SPEEDS, SPECIFIC_FORCE, VELOCITY, WIND, channels

# The topics.
IMU, STATE, ROTORS, WIND_TOPIC, TOPICS = 0, 1, 2, 3, 4
# A state, the first signals of a sample, or many rotors have the most numbers.
_WIDEST = max(RATES.stop, ROTORS_MAX)
# How a stretch begins: where the previous one ended; with a stamp more than MAX_JUMP_BACK_NS before the
# newest; with one that far before the stamp of the previous sample, as the IMU's clock was set back.
CONTINUES, STEPS_BACK, SET_BACK = 0, 1, 2


# What a monitor says of samples: their number, the stamps of its predictions, and the number of rows of the
# alarm that were raised.
Said: TypeAlias = tuple[int, list[int], int]
# What one more sample has completed: that, where it was judged; else how many samples may be taken.
Completed: TypeAlias = Said | int
NOTHING = -1


class Arriving(NamedTuple):
    """Samples in the order in which they arrive.

    Attributes:
        kind: (E,) topic of each, :data:`IMU`, ….
        row: (E,) its row in the arrays of that topic.
        imu_ns, specific_force: (N,), (N, 3).
        state_ns, states: (S,), (S, 10) velocity, attitude and rates; see :meth:`.pairing.Pairing.add_state`.
        rotor_ns, rotor_speeds: (R,), (R, rotors).
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
    rotors: int
    timeout_ns: int
    # Of the IMU: the newest stamp since one stepped back, and that of the last sample. Of replays only.
    newest_ns: int
    last_ns: int
    rate_changes: int  # `meter.changes` at the last `compiled.take_samples`
    noted: bool  # whether the stamp at which a stretch begins has been noted
    # See pairing.PairingCounts.
    paired: int
    early: int
    dropped: int
    disordered: int


PAIRING_STATE, ENTRY = record_dtype(PairingState), record_dtype(Entry)


class Arrays(NamedTuple):
    """The memory of a pairing, which compiled code holds.

    Attributes:
        state: (1,) a :class:`PairingState`.
        rings: (TOPICS, capacity) each an :class:`Entry`.
    """

    state: Records
    rings: Records


# How long, in stamps, an IMU sample waits for its state and rotor speed; live and in replay.
TIMEOUT_S = 0.1
# Samples kept per topic.
CAPACITY = 256
# In place of a wind of 0, which stands for no reading; it changes no digit of a speed.
HEARD_M_S = 1e-150


class PairedSamples(NamedTuple):
    """K samples, one per IMU stamp, with all that a monitor needs.

    Attributes:
        time_ns: (K,) stamps.
        values: (K, 16 + rotors) channels of :mod:`quadpi_core.signals.chain`: velocity over ground m/s, body
            axes; attitude body to world; rates rad/s; specific force m/s², body axes; rotor speeds rad/s;
            wind m/s, world.
    """

    time_ns: Stamps
    values: Array

    def __repr__(self) -> str:
        return brief_repr(self)

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
        """(K, rotors) view."""
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
        begin: how it begins, one of `CONTINUES`, `STEPS_BACK` and `SET_BACK`.
        rate: of the IMU.
        samples: that were completed or given up.
        imu, states: rows of those that came.
        settled_ns: :attr:`Pairing.settled_ns` at its end.
    """

    begin: int
    rate: ImuRate
    samples: PairedSamples
    imu: slice
    states: slice
    settled_ns: int


# The monitor that judges what one more sample completes, see :meth:`.monitor.Monitors.paired`.
Judging: TypeAlias = "compiled.PairedMonitor | None"


class Pairing:
    """The bounded buffers between the topics and the monitor.

    Each sample that is added crosses once into the core. Given a monitor, the same call judges what it
    completes; else, or where the rate of the IMU has changed, :meth:`take` gives that.

    Args:
        timeout_s: how far, in stamps, the IMU may run ahead of an incomplete sample before it is given up.
        capacity: samples kept per topic; the oldest makes room.
        rate_hz: of the IMU, as the user gives it; 0 where its stamps alone count.
        rotors: of the vehicle.

    Attributes:
        rate: of the IMU, by its stamps up to the last :meth:`take`; the samples taken have it.
        completed: what the last sample has completed, which adding it gave.
        newest_ns: (TOPICS,) the newest stamp of each topic, NO_STAMP before the first.
        capacity: as given.
        compiled: what compiled code knows it by.
    """

    def __init__(
        self,
        timeout_s: float = TIMEOUT_S,
        capacity: int = CAPACITY,
        rate_hz: float = 0.0,
        rotors: int = 4,
    ) -> None:
        self._given_hz = rate_hz
        self._state = np.zeros(1, PAIRING_STATE)
        self._state["rotors"] = rotors
        self._state["timeout_ns"] = round(timeout_s * 1e9)
        self.newest_ns: Stamps = self._state["tracks"]["newest_ns"][0]
        for stamps in (self.newest_ns, self._state["newest_ns"], self._state["last_ns"]):
            stamps[:] = NO_STAMP
        self.capacity = capacity
        self._rings = np.zeros((TOPICS, capacity), ENTRY)
        self.compiled = compiled.Pairing(Arrays(self._state, self._rings))
        self._channels = channels(rotors)
        self.rate = ImuRate.from_meters(self._state["meter"], rate_hz)
        self.completed: Completed = NOTHING

    @property
    def counts(self) -> PairingCounts:
        """What became of the samples so far."""
        state = self._state[0]
        return PairingCounts(*(int(state[name]) for name in ("paired", "early", "dropped", "disordered")))

    @property
    def arrived(self) -> Arrived:
        """The newest stamp of each input, and how many samples have been judged."""
        newest = self.newest_ns.tolist()
        imu_ns, state_ns, rotors_ns, _ = (None if time_ns == NO_STAMP else time_ns for time_ns in newest)
        counts = self.counts
        return Arrived(imu_ns, state_ns, rotors_ns, 0 if self.rate.begins else counts.paired + counts.dropped)

    @property
    def settled_ns(self) -> int:
        """No sample will be taken at or before this stamp, unless the IMU's clock is set back."""
        imu = self._state["tracks"][0, IMU]
        return int(self._rings["time_ns"][IMU, imu["oldest"]]) - 1 if imu["count"] else int(imu["newest_ns"])

    def add_imu(self, time_ns: int, specific_force: Array, by: Judging = None) -> Completed:
        """Take one IMU sample: specific_force (3,) m/s², body axes."""
        self.completed = compiled.add_imu(by or self.compiled, time_ns, specific_force)
        return self.completed

    def add_state(
        self, time_ns: int, velocity: Array, attitude: Array, rates: Array, by: Judging = None
    ) -> Completed:
        """Take one state: velocity (3,) m/s and rates (3,) rad/s, body axes; attitude (4,) body to world."""
        self.completed = compiled.add_state(by or self.compiled, time_ns, velocity, attitude, rates)
        return self.completed

    def add_estimate(self, time_ns: int, motion: Array, by: Judging = None) -> Completed:
        """Take an IMU sample and the state at its stamp in one, whose `FusedSamples.motion` this is."""
        self.completed = compiled.add_estimate(by or self.compiled, time_ns, motion)
        return self.completed

    def add_rotor_speeds(self, time_ns: int, speeds: Array, by: Judging = None) -> Completed:
        """Take one sample of the rotor speeds (rotors,) rad/s."""
        self.completed = compiled.add_sample(by or self.compiled, ROTORS, time_ns, speeds)
        return self.completed

    def add_wind(self, time_ns: int, velocity: Array) -> None:
        """Take one sample of the wind (3,) m/s in the world."""
        self.completed = compiled.add_sample(self.compiled, WIND_TOPIC, time_ns, velocity + HEARD_M_S)

    def take(self) -> PairedSamples | None:
        """The IMU samples completed or given up since the last call, in order; None if there are none."""
        room, self.completed = self.completed, NOTHING
        if isinstance(room, tuple) or room == NOTHING:
            return None
        taken_ns, taken = np.empty(room, np.int64), np.empty((room, self._channels))
        count, rate_changed = compiled.take_samples(self.compiled, taken_ns, taken)
        if rate_changed:
            self.rate = ImuRate.from_meters(self._state["meter"], self._given_hz)
        if count == 0:
            return None
        return (
            PairedSamples(taken_ns, taken)
            if count == room
            else PairedSamples(taken_ns[:count], taken[:count])
        )

    def take_all(self, arriving: Arriving) -> list[Stretch]:
        """What :meth:`take` gives after each arrival, joined.

        Apart where the IMU's stamps step back, and where its rate changes.
        """
        arriving = Arriving._make(map(np.ascontiguousarray, arriving))
        room = np.count_nonzero(arriving.kind == IMU) + int(self._state["tracks"][0, IMU]["count"])
        taken_ns, taken = np.empty(room, dtype=np.int64), np.empty((room, self._channels))
        came = np.cumsum(np.stack([arriving.kind == IMU, arriving.kind == STATE]), axis=1).T.tolist()
        stretches: list[Stretch] = []
        start, begin, filled, after = 0, CONTINUES, 0, [0, 0]
        while start < arriving.kind.size or not stretches:
            stop, next_begin, count = compiled.take_stretch(
                self.compiled, arriving, start, taken_ns[filled:], taken[filled:]
            )
            if stop > start or stop == arriving.kind.size:
                rows = slice(filled, filled + count)
                before, after = after, came[stop - 1] if stop else [0, 0]
                samples = PairedSamples(taken_ns[rows], taken[rows])
                imu, states = map(slice, before, after)
                stretches.append(Stretch(begin, self.rate, samples, imu, states, self.settled_ns))
                filled = rows.stop
            start, begin = stop, next_begin
            self.rate = ImuRate.from_meters(self._state["meter"], self._given_hz)
        return stretches
