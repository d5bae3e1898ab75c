# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""When the rotors carry the vehicle, and what a rotor that reads 0 or the same speed meanwhile means.

A rotor that stops takes its thrust along: the specific force falls short of what the other rotors' speeds
squared give by its share, and the vehicle turns. Where neither is so, its sensor fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import DiscrepancyError
from quadpi_core.findings import HELD, READS_ZERO, Finding
from quadpi_core.flight import Flight, Recording, Stamps
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import relative_to_air
from quadpi_core.reading_options import Column
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold
from quadpi_core.screening.sample_order import Mask, Rows
from quadpi_core.vehicle import Vehicle

# Share of the weight from which on the rotors carry the vehicle.
_CARRYING_SHARE = 0.5
ZERO_RAD_S = Threshold(
    "rotor speed that is none",
    1.0,
    "rad/s",
    "below the smallest step of any telemetry, 100 eRPM of 10 pole pairs; rotors idle at 50 rad/s and more",
    CONVENTION,
)
STUCK_RAD_S = Threshold(
    "extent of a stuck rotor speed",
    compiled.STUCK_RAD_S,
    "rad/s",
    "below the resolution of any sensor: a speed that changes no more is not measured",
    CONVENTION,
)
STUCK_S = Threshold(
    "duration of a stuck rotor speed in flight",
    compiled.STUCK_S,
    "s",
    "sound flights read the same for 0.11 s at most, those with a sensor that fails for 0.6 s and more",
    "91 real recordings of five vehicles and the bundled bags; four of them with such a sensor",
)
STUCK_SAMPLES = Threshold(
    "samples of a stuck rotor speed above 0",
    8,
    "1",
    "telemetry at 4 Hz reads the same three times in a row on sound flights",
    "real logs of PX4 with esc_status at 3 and 4 Hz",
)
OTHERS_STEPS = Threshold(
    "change of the other rotors' speeds while one is stuck",
    compiled.OTHERS_STEPS,
    "steps of its resolution",
    "in a calm hover all stay within a step or two",
    "bundled flights in steps of 100 eRPM",
)
LIFT_LEFT = Threshold(
    "share of a rotor's thrust from which on it is there",
    0.5,
    "1",
    "half-way between a rotor that stands and one that turns as before",
    CONVENTION,
)
STOP_TURN_RAD_S = Threshold(
    "change of roll and pitch rates within 0.3 s of a rotor's stop",
    2.0,
    "rad/s",
    "a quarter of the weight turns a body of 2 kg by 5 rad/s in that time, smaller ones by more",
    "none: rigid bodies",
)
STANDS_RAD_S = Threshold(
    "spread of the turn rate of a vehicle that stands, its vibrations averaged out",
    0.012,
    "rad/s",
    "gyros drift by less than 0.003 in a minute; the calmest flight turns by 0.058",
    "every third of 118 real recordings of six vehicles",
)
# Rotors that idle on a bench shake a vehicle faster than this.
_VIBRATION_S = 0.2
# The specific force is compared over so long before a rotor slows down and while it reads 0; its thrust is
# gone after the lag of a rotor. It slows down within _SLOWS_S, from _WHOLE_SHARE of its speed on.
_BEFORE_S, _DURING_S, _LAG_S = 0.3, 0.3, 0.05
_SLOWS_S, _WHOLE_SHARE = 1.0, 0.5


class Inertial(NamedTuple):
    """What rotors do to a body: stamps (M,), specific force upward (M,) m/s², roll and pitch rates (M, 2)."""

    time_ns: Stamps
    lift: Array
    rates: Array

    @classmethod
    def from_recording(cls, recording: Recording) -> Inertial:
        """The IMU's."""
        imu = recording.imu
        return cls(imu.time_ns, -imu.specific_force[:, 2], imu.angular_velocity[:, :2])

    def lift_at(self, time_ns: Stamps) -> Array:
        """Specific force upward at stamps (N,)."""
        start = self.time_ns[0]
        return np.interp((time_ns - start) * 1e-9, (self.time_ns - start) * 1e-9, self.lift)

    def stands(self, from_ns: int, to_ns: int) -> bool:
        """Whether the vehicle does not turn between two stamps: then the ground carries it, as on a bench."""
        rates = self.between(from_ns, to_ns).rates
        rates = rates[np.isfinite(rates).all(axis=1)]
        each = max(1, int(_VIBRATION_S * len(rates) / max((to_ns - from_ns) * 1e-9, 1e-9)))
        whole = len(rates) // each * each
        if whole < 2 * each:
            return False
        means = rates[:whole].reshape(-1, each, rates.shape[1]).mean(axis=1)
        return bool(np.std(means, axis=0).max() < STANDS_RAD_S.value)

    def between(self, from_ns: int, to_ns: int) -> Inertial:
        """The samples of a time, ends included."""
        return self.at(slice(*np.searchsorted(self.time_ns, (from_ns, to_ns + 1))))

    def at(self, rows: slice | npt.NDArray[np.bool_]) -> Inertial:
        """The samples in a range, or that a mask (M,) selects."""
        return Inertial(self.time_ns[rows], self.lift[rows], self.rates[rows])

    def finite(self) -> Inertial:
        """The samples whose numbers are finite."""
        return self.at(np.isfinite(self.lift) & np.isfinite(self.rates).all(axis=1))


def carrying(speeds: Array, lift: Array, gravity_m_s2: float) -> npt.NDArray[np.bool_]:
    """Where k Σω² exceeds half of the weight, with k fitted to the specific force of all samples.

    So neither a hover before a fast flight nor a long time on the ground shifts the threshold.

    Args:
        speeds: (N, rotors) rad/s.
        lift: (N,) specific force upward in body axes, m/s².
        gravity_m_s2: acceleration of gravity.
    """
    squares = np.square(speeds).sum(axis=1)
    thrust_m_s2 = squares * (lift @ squares) / max(squares @ squares, 1.0)
    return np.asarray(thrust_m_s2 > _CARRYING_SHARE * gravity_m_s2)


def in_flight(
    time_ns: Stamps, speeds: Array, inertial: Inertial, gravity_m_s2: float
) -> npt.NDArray[np.bool_] | None:
    """:func:`carrying` at the stamps (N,) of the speeds; None if they never do, or the vehicle stands."""
    flying = carrying(speeds, inertial.lift_at(time_ns), gravity_m_s2)
    turning_ns = time_ns[flying]
    if len(turning_ns) == 0 or inertial.stands(int(turning_ns.min()), int(turning_ns.max())):
        return None
    return flying


def resolution(speeds: Array) -> Array:
    """Smallest step (R,) between readings (N, R) of each rotor [rad/s]; infinite where there is one only."""
    # Readings that differ by the last digits of a conversion are the same.
    steps = (np.diff(np.unique(column)) for column in speeds.T)
    return np.array([np.min(one[one > STUCK_RAD_S.value], initial=np.inf) for one in steps])


def runs_of(column: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of samples that are true in a mask (N,); the end is the first that is not."""
    edges = np.flatnonzero(np.diff(column, prepend=False, append=False))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def has_stopped(time_ns: Stamps, speeds: Array, rotor: int, begin: int, inertial: Inertial) -> bool:
    """Whether a rotor that reads 0 truly stands: its thrust is gone, and the vehicle turns.

    Args:
        time_ns: (N,) of the speeds.
        speeds: (N, rotors) rad/s.
        rotor: its place.
        begin: sample from which on it reads 0; of one that does from the beginning nothing is known.
        inertial: of the flight.
    """
    if begin == 0:
        return False

    def row(stamp_ns: int, seconds: float) -> int:
        return int(np.searchsorted(time_ns, stamp_ns + round(seconds * 1e9)))

    from_ns = int(time_ns[begin])
    first = min(row(from_ns, -_SLOWS_S), begin - 1)
    # It may slow down before it reads 0; its thrust then goes from there on.
    reading = speeds[first:begin, rotor]
    whole = first + int(np.flatnonzero(reading >= _WHOLE_SHARE * np.max(reading))[-1])
    end = begin + int(np.argmax(np.append(speeds[begin:, rotor] >= ZERO_RAD_S.value, True)))
    end = min(end, row(from_ns + 1, _DURING_S))
    slows_ns, to_ns = int(time_ns[whole]), int(time_ns[end - 1])
    earlier = slice(row(slows_ns, -_BEFORE_S), whole + 1)
    before = inertial.between(int(time_ns[earlier.start]), slows_ns).lift
    during = inertial.between(min(max(slows_ns + round(_LAG_S * 1e9), from_ns), to_ns), to_ns).lift
    if len(before) == 0 or len(during) == 0:
        return False
    others = np.delete(speeds[begin:end], rotor, axis=1)
    square = float(np.mean(np.square(speeds[earlier, rotor])))
    gain = float(np.mean(before)) / max(float(np.mean(np.square(speeds[earlier]).sum(axis=1))), 1.0)
    remaining = float(np.mean(during)) / max(gain, 1e-12) - float(np.mean(np.square(others).sum(axis=1)))
    if square <= 0.0 or remaining > LIFT_LEFT.value * square:
        return False
    around = inertial.between(slows_ns, to_ns).rates
    turn = float(np.linalg.norm(around - around[:1], axis=1).max(initial=0.0))
    # All rotors that stop together turn nothing.
    return turn > STOP_TURN_RAD_S.value or not np.any(others >= ZERO_RAD_S.value)


def stuck_rotors(recording: Recording, gravity_m_s2: float) -> Iterator[Finding]:
    """Rotors that read the same speed, most often 0, for STUCK_S and longer while all carry the vehicle.

    Args:
        recording: with finite values and increasing stamps.
        gravity_m_s2: acceleration of gravity.
    """
    rotors, imu = recording.rotor_speeds, recording.imu
    if rotors is None or len(rotors) < 2 or len(imu) == 0:
        return
    time_s = (rotors.time_ns - imu.time_ns[0]) * 1e-9
    speeds, inertial = rotors.speeds, Inertial.from_recording(recording)
    flying = in_flight(rotors.time_ns, speeds, inertial, gravity_m_s2)
    if flying is None:
        return
    steps = resolution(speeds)
    same = np.abs(np.diff(speeds, axis=0)) < STUCK_RAD_S.value
    same &= (flying[1:] & flying[:-1])[:, np.newaxis]
    for rotor, column in enumerate(same.T):
        long = [
            (begin, end)
            for begin, end in runs_of(column)
            if time_s[end] - time_s[begin] >= STUCK_S.value
            and _is_stuck(speeds[begin : end + 1], rotor, steps[rotor])
        ]
        if not long:
            continue
        begin, end = max(long, key=lambda run: float(time_s[run[1]] - time_s[run[0]]))
        stops = (first for first, _ in long if has_stopped(rotors.time_ns, speeds, rotor, first, inertial))
        if speeds[begin, rotor] < ZERO_RAD_S.value and (stop := next(stops, None)) is not None:
            yield Finding(
                "stopped rotor",
                rotors.topic,
                f"rotor {rotor + 1} stopped at {time_s[stop]:.2f} s in flight: its thrust is gone, and the "
                "vehicle turns; its readings stay",
            )
            continue
        whole = sum(float(time_s[last] - time_s[first]) for first, last in long)
        yield Finding(
            "stuck rotor",
            rotors.topic,
            f"rotor {rotor + 1} reads {speeds[begin, rotor]:.4g} rad/s from "
            f"{time_s[begin]:.2f} to {time_s[end]:.2f} s in flight, without a change, "
            f"and so for {whole:.1f} s in all: its sensor fails; leave this flight out",
            leave_out=True,
        )


def _is_stuck(speeds: Array, rotor: int, step: float) -> bool:
    """Whether readings (K, rotors) that do not change cannot be those of a calm flight."""
    if speeds[0, rotor] < ZERO_RAD_S.value:
        return True
    others = float(np.median(np.ptp(np.delete(speeds, rotor, axis=1), axis=0)))
    # One that reads a single speed throughout has no resolution of its own.
    moves = others > 0.0 if np.isinf(step) else others >= OTHERS_STEPS.value * step
    return moves and len(speeds) >= STUCK_SAMPLES.value


# Their samples are left out. A rotor that truly stops keeps its samples; one that reads 0 for longer, or all
# the time, is a finding of :mod:`quadpi_core.screening.rotors_in_flight`.

RETURNS_S = Threshold(
    "time between two readings with 0 in between, in which no rotor stops and turns again",
    0.15,
    "s",
    "with a time constant of 20 ms a rotor takes 0.1 s to come below 1 % of its speed, and as long to return",
    "motor lags of seven vehicles, 20 to 60 ms",
)
TURNS_SHARE = Threshold(
    "reading before and after a drop-out over the median of the rotor in flight",
    0.4,
    "1",
    "a rotor that stops, or begins to turn, reads less first; half of the thrust of hover is 0.7",
    "14 flights that begin with a throw, their rotors standing (INDIflight)",
)
HELD_SHARE = Threshold(
    "share of readings that more than one sample holds, in a table of a slower source",
    0.75,
    "1",
    "real logs repeat up to half of their readings; a source of half its table's rate, or less, nearly all",
    "118 real recordings of six vehicles; the 17 of the nanodrone benchmark repeat most",
)
HELD_STEPS = Threshold(
    "change of a held rotor speed to the next one",
    3.0,
    "steps of its resolution",
    "readings that stay the same for want of resolution go on by one step, held ones by many",
    "bundled flights in steps of 100 eRPM, and held for 20 to 250 ms",
)


class RotorScreening:
    """Finds samples of rotor speeds that are no measurements, in a flight that comes in blocks.

    Attributes:
        samples: number of samples so far.
    """

    def __init__(self) -> None:
        self.samples = 0
        # Half of the digits do: they are kept for the whole of a long flight.
        self._columns = (Column(), Column(), Column())

    def add(self, block: Recording) -> None:
        """Examine the next block."""
        if block.rotor_speeds is None:
            return
        self.samples += len(block.rotor_speeds)
        values = (block.rotor_speeds.speeds, *Inertial.from_recording(block)[1:])
        for column, part in zip(self._columns, values, strict=True):
            column.extend(part.astype(np.float32))

    def finish(self, rotors_ns: Stamps, imu_ns: Stamps, already: Rows) -> Iterator[tuple[Rows, str]]:
        """Indices of the samples of the rotor speeds that are no measurements, and why, in words.

        Args:
            rotors_ns: (N,) stamps of the rotor speeds.
            imu_ns: (M,) stamps of the IMU.
            already: indices of samples left out for another reason, but for those in which a rotor reads 0.
        """
        if not self.samples:
            return
        speeds, lift, rates = (column.whole() for column in self._columns)
        usable = np.isfinite(speeds).all(axis=1)
        usable[already] &= np.any(speeds[already] < ZERO_RAD_S.value, axis=1)
        repeats = usable & repeated_speeds(speeds)
        if np.any(repeats):
            seconds = float(np.ptp(rotors_ns)) * 1e-9
            rate_hz = np.count_nonzero(usable & ~repeats) / max(seconds, 1e-9)
            yield np.flatnonzero(repeats), f"in which {HELD}: its source gives {rate_hz:.3g} Hz"
            usable &= ~repeats
        inertial = Inertial(imu_ns, lift, rates).finite()
        if np.any(speeds[usable] < ZERO_RAD_S.value) and len(inertial.time_ns):
            zeros = dropped_out(rotors_ns[usable], speeds[usable], inertial)
            yield np.flatnonzero(usable)[zeros], f"in which {READS_ZERO}"


def dropped_out(time_ns: Stamps, speeds: Array, inertial: Inertial) -> Mask:
    """Samples (N,) of speeds (N, R), rad/s, by 0 in flight below STUCK_S, of rotors that have not stopped."""
    dropped = np.zeros(len(speeds), dtype=np.bool_)
    standing = speeds < ZERO_RAD_S.value
    if not np.any(standing) or np.any(np.diff(time_ns) <= 0):
        return dropped
    # The last reading before, or at the start the first one after, stands for 0.
    before, after = _whole_around(~standing)
    bridged = np.where(before >= 0, before, np.minimum(after, len(speeds) - 1))
    flying = in_flight(time_ns, np.take_along_axis(speeds, bridged, axis=0), inertial, STANDARD_GRAVITY)
    if flying is None:
        return dropped
    for rotor, column in enumerate(standing.T):
        turning = speeds[flying & ~column, rotor]
        if len(turning) == 0:
            continue
        whole = speeds[:, rotor] >= TURNS_SHARE.value * float(np.median(turning))
        # The ends of a recording are no evidence of a rotor that stands before or after it.
        before, after = _whole_around(whole)
        for begin, end in runs_of(column):
            first, last = int(before[begin]), int(after[end - 1])
            if (first < 0 < begin) or (last == len(speeds) > end):
                continue
            around_s = float(time_ns[min(last, len(speeds) - 1)] - time_ns[max(first, 0)]) * 1e-9
            if around_s >= STUCK_S.value or not np.all(flying[max(first, 0) : last + 1]):
                continue
            if around_s <= RETURNS_S.value or not has_stopped(time_ns, speeds, rotor, begin, inertial):
                dropped[first + 1 : last] = True
    return dropped


def _whole_around(whole: Mask) -> tuple[Rows, Rows]:
    """The last whole sample (N, ...) up to each, and the first from each on; −1 and N without one."""
    count = len(whole)
    rows = np.arange(count).reshape(-1, *[1] * (whole.ndim - 1))
    before = np.maximum.accumulate(np.where(whole, rows, -1), axis=0)
    after = np.minimum.accumulate(np.where(whole, rows, count)[::-1], axis=0)[::-1]
    return before, after


def repeated_speeds(speeds: Array) -> Mask:
    """Samples (N,) of speeds (N, R), rad/s, that repeat the one before, of a slow source; or none."""
    turning = np.any(speeds > ZERO_RAD_S.value, axis=1)
    same = np.zeros(len(speeds), dtype=np.bool_)
    same[1:] = np.all(speeds[1:] == speeds[:-1], axis=1) & turning[1:]
    # Readings, not samples, are counted: rotors that idle at one speed for long are one reading.
    news = turning & ~same
    repeated = int(np.count_nonzero(news[:-1] & same[1:]))
    if repeated < HELD_SHARE.value * max(int(np.count_nonzero(news)), 1):
        return np.zeros_like(same)
    changes = np.abs(np.diff(speeds, axis=0))[turning[1:] & ~same[1:]] / resolution(speeds)
    changes = changes[changes > 0.0]
    return same if len(changes) and np.median(changes) >= HELD_STEPS.value else np.zeros_like(same)


_HALF_OF_GENTLE = "about half of what a gentle manoeuvre of any vehicle reaches"
FLOWN_SPEED = Threshold(
    "flown forward or sideways", 0.25, "induced velocities of hover", _HALF_OF_GENTLE, CONVENTION
)
FLOWN_CLIMB = Threshold("climbed", 0.12, "induced velocities of hover", _HALF_OF_GENTLE, CONVENTION)
FLOWN_RATE = Threshold("doublet flown", 0.6, "rad/s", _HALF_OF_GENTLE, CONVENTION)
FLOWN_HEADING = Threshold("heading turned", 0.8, "rad", _HALF_OF_GENTLE, CONVENTION)
FLOWN_LOAD = Threshold(
    "throttle step flown",
    0.15,
    "extent of the sum of squared rotor speeds over its mean",
    _HALF_OF_GENTLE,
    CONVENTION,
)
TAIL = Threshold(
    "samples beyond the largest value",
    0.01,
    "of all samples",
    "noise alone exceeds a threshold now and then",
    CONVENTION,
)


def require_excitation(flights: Sequence[Flight], vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the manoeuvres that no flight contains, in a pilot's words.

    Raises:
        DiscrepancyError: for flights of hover alone, naming what is missing; and, naming the file, for rotor
            speeds that do not change, as of a stuck sensor or a log that was filled in.
    """
    for flight in flights:
        require_changes(flight)
    flown = _flown(flights, vehicle)
    missing = tuple(name for name, there in flown.items() if not there)
    if len(missing) == len(flown):
        raise DiscrepancyError(
            f"{', '.join(flight.name for flight in flights)}: nothing but hover, in which effects look "
            f"alike; fly {', '.join(missing)}"
        )
    return missing


def require_changes(flight: Flight) -> None:
    """Refuse rotor speeds that do not change, naming the file."""
    stuck = np.flatnonzero(np.ptp(flight.rotor_speeds, axis=0) < STUCK_RAD_S.value)
    if len(stuck):
        raise DiscrepancyError(
            f"{flight.source}: topic rotor_speeds: rotor {stuck[0] + 1} has the same speed throughout, "
            f"{flight.rotor_speeds[0, stuck[0]]:.4g} rad/s; speeds as measured are needed"
        )


def _flown(flights: Sequence[Flight], vehicle: Vehicle) -> dict[str, bool]:
    """Whether any flight contains a manoeuvre, by its name."""
    induced = vehicle.hover_induced_velocity
    velocity = [relative_to_air(flight.velocity, flight.attitude, flight.wind) for flight in flights]
    speeds = np.quantile(np.abs(np.concatenate(velocity)), 1.0 - TAIL.value, axis=0) / induced
    rates = np.quantile(np.abs(np.concatenate([own.rates for own in flights])), 1.0 - TAIL.value, axis=0)
    loads = [np.square(flight.rotor_speeds).sum(axis=1) for flight in flights]
    noses = [rotation_matrix(flight.attitude)[:, :2, 0] for flight in flights]
    headings = [np.unwrap(np.arctan2(east, north)) for north, east in (nose.T for nose in noses)]
    return {
        "forward and backward flight": speeds[0] > FLOWN_SPEED.value,
        "sideways flight": speeds[1] > FLOWN_SPEED.value,
        "climb and descent": speeds[2] > FLOWN_CLIMB.value,
        "throttle steps": max(_extent(load) / float(load.mean()) for load in loads) > FLOWN_LOAD.value,
        "roll doublets": rates[0] > FLOWN_RATE.value,
        "pitch doublets": rates[1] > FLOWN_RATE.value,
        "yaw doublets": rates[2] > FLOWN_RATE.value,
        "turns of the heading": max(map(_extent, headings)) > FLOWN_HEADING.value,
    }


def _extent(values: Array) -> float:
    low, high = np.quantile(values, [TAIL.value, 1.0 - TAIL.value])
    return float(high - low)
