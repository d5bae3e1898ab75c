# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether streams tell of one motion: the offset of their clocks, and the order and spins of the rotors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, permutations
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from quadpi_core.errors import SignalError
from quadpi_core.findings import Finding
from quadpi_core.flight import ImuStream, Recording, RotorSpeedStream
from quadpi_core.frames import Array
from quadpi_core.records import Threshold
from quadpi_core.screening.excerpt import (
    Excerpt,
    Pose,
    RotorExcerpt,
    cost,
    excerpt,
    innovation,
    rotor_excerpt,
)
from quadpi_core.signals.alignment import Alignment, rotor_offset, span_of, turn_offset
from quadpi_core.vehicle import Vehicle

# Thrust and torque of a rotor are proportional to its speed squared. So the regression of the angular
# acceleration on the squares shows the place and spin of each rotor, for any coefficients, and the ratio of
# inertia to mass times arm.

# Periods of the band in which angular acceleration and squares are compared: aerodynamic damping dominates
# below it, noise above it.
_SLOW_S, _FAST_S = 0.25, 0.05
# Faster than manoeuvres, which flights of one programme share, and pieces of such motion: louder than the
# noise of the sensors by a factor, they count alike, so that no take-off or throw decides alone.
_BUSY_SLOW_S, _BUSY_FAST_S, _PIECE_S = 0.12, 0.03, 0.25
_LOUD, _FEWEST_PIECES = 3.0, 4
# The same speeds moved in time, in these steps, explain by chance what those of another flight do.
_APART_S = 0.15
# Median of the square of a normal deviate, and variance of the second difference of white noise.
_MEDIAN_SQUARE, _SECOND_DIFFERENCE = 0.4549, 6.0
# Thrust is compared with Σω² over this time and longer, in windows in which they correlate so much.
_THRUST_S, _THRUST_FOLLOWS = 0.1, 0.6
# Share of equal cells from which on two rotors are one.
_SAME_SHARE = 0.9
# Largest lag of the rotor speeds that is tried.
_LAGS_S = 0.3
# Windows in which the rotors' mean square is below this share of the fastest window's are on the ground.
_CARRYING_SHARE = 0.4
# Fewer rotors than that carry no multirotor; of so many all 120 orders are tried.
_FEWEST_ROTORS, _ALL_ORDERS_OF = 3, 5
# Score of an order, the order, and whether spins are inverted.
_Best: TypeAlias = tuple[float, tuple[int, ...], bool]
# By how much of the score inverted spins count less (a tie-break), and within which the simplest order wins:
# of 24 simulated hexa- and octocopter flights one beat the right order by 0.033, 19 of 20 wrong ones by 0.39.
_INVERTED, _ALIKE = 1e-6, 0.05
_NONE: _Best = (-np.inf, (), False)


class RotorEvidence:
    """Agreement of rotor speeds with the motion of a vehicle; what is costly is found when it is asked for.

    Attributes:
        lag_s: delay of the rotor speeds.
        explained: share of the angular acceleration about roll and pitch, and of the thrust, that the squares
            explain together at that lag, 0 to 1.
        explained_now: the same without a lag.
        correlation: (3,) of the roll, pitch and yaw accelerations with the moments that the vehicle's rotor
            places and spins give.
        ratio: (2,) inertia times acceleration over arm times thrust, about roll and pitch; near 1.
        order: rotor columns that fit the vehicle's rotors best; 0, 1, 2, … if none is swapped.
        spins_inverted: whether inverted spins fit best.
        order_correlation: (3,) correlation with this order and these spins.
        mean_squares: (rotors,) of each rotor, over the flight.
        windows: how many windows of flight all of this is of.
    """

    def __init__(self, sample: RotorExcerpt, vehicle: Vehicle) -> None:
        step, cells, margin = sample.step_s, sample.rates.shape[1], sample.margin
        self._sample = sample
        self._acceleration = np.zeros_like(sample.rates)
        self._acceleration[:, 1:-1] = (sample.rates[:, 2:] - sample.rates[:, :-2]) / (2.0 * step)
        # Damping is proportional to the rates. The first and the last cell have no central difference.
        basis, _ = np.linalg.qr(_band(sample.rates[:, 1:-1], step).reshape(-1, 3))

        def undamped(values: Array) -> Array:
            return np.asarray(values - basis @ (basis.T @ values))

        moving = undamped(_band(self._acceleration[:, 1:-1], step).reshape(-1, 3))
        lifting = _band(-sample.force[:, 1:-1, 2:], step).reshape(-1, 1)
        signals = np.concatenate((moving[:, :2], lifting), axis=1)
        lags = range(-round(_LAGS_S / step), round(_LAGS_S / step) + 1)
        explained = [_explained(_shifted(sample.squares, margin + lag, cells, step), signals) for lag in lags]
        best = int(np.argmax(explained))
        self.lag_s = float(lags[best] * step)
        self.explained, self.explained_now = explained[best], explained[len(lags) // 2]
        self._first = margin + lags[best]
        shown = undamped(_shifted(sample.squares, self._first, cells, step))
        places = vehicle.rotor_positions
        levers = np.stack((-places[:, 1], places[:, 0], -vehicle.rotor_spins))
        self.correlation, gain = correlation_of(moving, shown @ levers.T)
        self._now = sample.squares[:, margin : margin + cells]
        totals = self._now.sum(axis=2)
        thrust = float(vehicle.mass_kg * np.sum(-sample.force[..., 2] * totals) / np.sum(totals**2))
        self.ratio = gain[:2] * np.diag(vehicle.inertia)[:2] / thrust
        self.order, self.spins_inverted, self.order_correlation = best_order(moving, shown, levers)
        self.mean_squares = self._now.reshape(-1, self._now.shape[2]).mean(axis=0)
        self.windows = len(self._now)

    @property
    def same(self) -> tuple[int, int] | None:
        """Two rotors whose speeds are one, in nearly every cell; None if there are none."""
        now = self._now
        pairs = combinations(range(now.shape[2]), 2)
        return next((p for p in pairs if np.mean(now[..., p[0]] == now[..., p[1]]) > _SAME_SHARE), None)

    @property
    def growth(self) -> float | None:
        """Relative change of the thrust over that of the sum of squares, in the median window.

        Near 1, and None where they do not correlate.
        """
        length = 2 * round(0.5 * _THRUST_S / self._sample.step_s) + 1
        ratios = []
        for thrust, total in zip(
            _mean(-self._sample.force[..., 2:], length)[..., 0],
            _mean(self._now.sum(axis=2, keepdims=True), length)[..., 0],
            strict=True,
        ):
            turning = (total > 0.5 * np.median(total)) & (thrust > 0.0)
            if np.sum(turning) < length:
                continue
            risen, more = (np.log(one[turning]) - np.log(one[turning]).mean() for one in (thrust, total))
            power = float(np.sqrt(np.sum(risen**2) * np.sum(more**2)))
            if risen @ more >= _THRUST_FOLLOWS * power > 0.0:
                ratios.append(float(np.sqrt(np.sum(risen**2) / np.sum(more**2))))
        return float(np.median(ratios)) if ratios else None

    @property
    def followed(self) -> float | None:
        """Share of the fast motion that the squares explain beyond chance, of what chance leaves.

        Of the accelerations about roll and pitch and the changes of thrust, in the median of the pieces
        louder than noise; chance is what the squares explain when moved in time. None if such are few.
        """
        rates, force, step = self._sample.rates, self._sample.force, self._sample.step_s
        signals = np.concatenate((self._acceleration[:, 1:-1, :2], -force[:, 1:-1, 2:]), axis=2)
        # Standard deviations of white noise, from the second differences.
        rough = np.diff(np.concatenate((rates[..., :2], force[..., 2:]), axis=2), 2, axis=1) ** 2
        noise = np.sqrt(np.median(rough, axis=(0, 1)) / _MEDIAN_SQUARE / _SECOND_DIFFERENCE)
        squares = self._sample.squares[:, self._first :][:, : rates.shape[1]]
        piece = round(_PIECE_S / step)

        def pieces(values: Array) -> Array:
            busy = _band(values, step, _BUSY_SLOW_S, _BUSY_FAST_S)
            count = busy.shape[1] // piece
            return np.asarray(busy[:, : count * piece].reshape(-1, piece, values.shape[2]))

        impulse = np.zeros((1, 2 * signals.shape[1] + 1, 2))
        impulse[0, signals.shape[1], 0] = 1.0
        impulse[0, signals.shape[1] + np.array([-1, 1]), 1] = np.array([-0.5, 0.5]) / step
        direct, derived = np.linalg.norm(_band(impulse, step, _BUSY_SLOW_S, _BUSY_FAST_S)[0], axis=0)
        heard = []
        for signal, floor in zip(
            np.moveaxis(pieces(signals), 2, 0), noise * (derived, derived, direct), strict=True
        ):
            size = np.sqrt(np.mean(signal**2, axis=1, keepdims=True))
            loud = size[:, 0] > _LOUD * floor
            if np.sum(loud) >= _FEWEST_PIECES:
                heard.append((loud, 1.0 / size[loud], signal[loud] / size[loud]))
        if len(heard) < 2:
            return None

        def share(moved: Array) -> float:
            """Of the signals, in the median piece, that any coefficients of the rotors explain."""
            medians, shown = [], pieces(_smoothed(moved))
            for loud, weight, signal in heard:
                told = shown[loud] * weight[..., np.newaxis]
                coefficients, *_ = np.linalg.lstsq(
                    told.reshape(-1, told.shape[2]), signal.ravel(), rcond=None
                )
                medians.append(np.median(np.mean((signal - told @ coefficients) ** 2, axis=1)))
            return 1.0 - float(np.mean(medians))

        apart, every = (round(length / step) for length in (_BUSY_SLOW_S, _APART_S))
        shifts = range(apart, squares.shape[1] - apart, every)
        chance = max(share(np.roll(squares, shift, axis=1)) for shift in shifts)
        return (share(squares) - chance) / (1.0 - chance)


def rotor_evidence(sample: RotorExcerpt, vehicle: Vehicle) -> RotorEvidence | None:
    """Compare rotor speeds and motion of an excerpt; None if the rotors never turn, or are below three."""
    if vehicle.rotor_count < _FEWEST_ROTORS:
        return None
    inside = slice(sample.margin, sample.margin + sample.rates.shape[1])
    level = sample.squares[:, inside].sum(axis=2).mean(axis=1)
    if level.max() <= 0.0:
        return None
    flying = level > _CARRYING_SHARE * level.max()
    rates, force, squares = sample.rates[flying], sample.force[flying], sample.squares[flying]
    return RotorEvidence(replace(sample, rates=rates, force=force, squares=squares), vehicle)


def best_order(moving: Array, squares: Array, levers: Array) -> tuple[tuple[int, ...], bool, Array]:
    """Order of squares (N, R) and spins whose moments, by levers (3, R), follow accelerations (N, 3) best."""
    count = len(levers.T)
    # Sums of products are taken once: (3, rotors) with the motion, and of squares.
    told, gram, power = moving.T @ squares, squares.T @ squares, np.sum(moving**2, axis=0)
    # Where the squares of the rotors cancel but for rounding, nothing correlates.
    least = 1e-9 * np.trace(gram) * np.sum(levers**2, axis=1)

    def best_of(orders: Iterable[Sequence[int]], best: _Best = _NONE) -> _Best:
        for order in orders:
            own = list(order)
            spread = np.einsum("ar,rs,as->a", levers, gram[np.ix_(own, own)], levers)
            noticed = np.sqrt(np.maximum(power * np.maximum(spread, least), 1e-30))
            correlation = np.sum(told[:, own] * levers, axis=1) / noticed
            for inverted in (False, True):
                signed = correlation * (1.0, 1.0, -1.0 if inverted else 1.0)
                score = float(np.sum(signed * np.abs(signed)))
                # Two on one arm that change places are as spins inverted: the order is the likelier mistake.
                score -= _INVERTED * inverted * (count > _ALL_ORDERS_OF)
                if score > best[0] + 1e-9:
                    best = (score, tuple(own), inverted)
        return best

    if count <= _ALL_ORDERS_OF:
        _, order, inverted = best_of(permutations(range(count)))
    else:
        # From each turn of the numbers, either way round, one swap after another as long as it gains.
        best = best_of([range(count)])
        rings = [np.roll(np.arange(count), turned) for turned in range(count)]
        for start in [*rings, *(ring[::-1] for ring in rings)]:
            now, before = best_of([start.tolist()]), -np.inf
            while now[0] > before + 1e-9:
                before, now = now[0], best_of(_swapped(now[1]), now)
            best = now if now[0] > best[0] + 1e-9 else best
        # Commands of many rotors move four ways alone: of orders that do alike the simplest counts.
        simple = best_of([range(count), *_swapped(range(count))])
        _, order, inverted = simple if simple[0] > best[0] - _ALIKE else best
    correlation, _ = correlation_of(moving, squares[:, order] @ levers.T)
    return order, inverted, correlation * (1.0, 1.0, -1.0 if inverted else 1.0)


def _swapped(order: Sequence[int]) -> Iterator[list[int]]:
    for one, other in combinations(range(len(order)), 2):
        swapped = list(order)
        swapped[one], swapped[other] = swapped[other], swapped[one]
        yield swapped


def correlation_of(of: Array, over: Array) -> tuple[Array, Array]:
    """Correlation and slope (C,) of columns (N, C) over others."""
    product, power = np.sum(of * over, axis=0), np.sum(over**2, axis=0)
    return (
        product / np.sqrt(np.maximum(np.sum(of**2, axis=0) * power, 1e-30)),
        product / np.maximum(power, 1e-30),
    )


def _explained(squares: Array, signals: Array) -> float:
    """Share of the variance of signals (N, C), each on its own scale, that squares (N, rotors) explain."""
    coefficients, *_ = np.linalg.lstsq(squares, signals, rcond=None)
    residual = np.sum((signals - squares @ coefficients) ** 2, axis=0)
    return float(np.mean(1.0 - residual / np.maximum(np.sum(signals**2, axis=0), 1e-30)))


def _shifted(squares: Array, first: int, cells: int, step: float) -> Array:
    """Squares (N, rotors) from a cell on, weighted and filtered as the acceleration is."""
    return _band(_smoothed(squares[:, first : first + cells]), step).reshape(-1, squares.shape[2])


def _smoothed(squares: Array) -> Array:
    """Squares (W, K, rotors) weighted as a central difference weights the acceleration."""
    return np.asarray(0.25 * squares[:, :-2] + 0.5 * squares[:, 1:-1] + 0.25 * squares[:, 2:])


def _band(values: Array, step: float, slow_s: float = _SLOW_S, fast_s: float = _FAST_S) -> Array:
    """Band-pass of values (W, K, C) between the two periods; shorter by the slow one."""
    slow, fast = (2 * round(0.5 * length / step) + 1 for length in (slow_s, fast_s))
    edge = (slow - fast) // 2
    return np.asarray(_mean(values, fast)[:, edge:-edge] - _mean(values, slow))


def _mean(values: Array, length: int) -> Array:
    total = np.cumsum(np.concatenate((np.zeros_like(values[:, :1]), values), axis=1), axis=1)
    return np.asarray((total[:, length:] - total[:, :-length]) / length)


SHARED_S = Threshold(
    "time that streams share",
    1.0,
    "s",
    "the shortest window that the consistency check can use; the estimator needs a second to start",
    "none: what the estimator needs",
)
LEAST_OFFSET_S = Threshold(
    "offset of clocks",
    0.05,
    "s",
    "the estimator finds smaller delays by itself, from its usual prior of 0.05 s",
    "none: the default of noise.mocap_delay_std_s",
)
EXPLAINED = Threshold(
    "accelerations that rotor speeds explain",
    0.25,
    "of their variance",
    "sound flights have 0.5 and more at the right offset, wrong ones 0.11",
    "bundled bags; real flights of imrc_brushless and neurobem",
)
NEAR_S = Threshold(
    "offset of clocks that are set",
    1.0,
    "s",
    "clocks of a network agree to less; a motion repeats after longer",
    "none: a convention",
)
EXPLAINS = Threshold(
    "cost of the innovations at an offset",
    0.5,
    "of that without it",
    "as for every other mistake",
    "bundled bags and real flights, moved by 0.3 to 40 s",
)


class ClockMistake(NamedTuple):
    """A finding on clocks, and the cost of the innovations at the offset that it names; 0 without windows."""

    finding: Finding
    cost: float


def clock_mistake(recording: Recording, state: Pose, sample: Excerpt | None) -> ClockMistake | None:
    """The mistake that a state was stamped by another clock than the IMU's; None if it does not look so.

    Args:
        recording: with finite values and increasing stamps.
        state: of it.
        sample: the windows in which both have samples; None if there are none.
    """
    imu = recording.imu
    if sample is None and (len(state) < 2 or shared_s(imu, state) >= SHARED_S.value):
        return None
    alignment = None
    with suppress(SignalError):
        alignment = turn_offset(imu, state, state.topic)
    if sample is None:
        apart = _apart(imu, state, alignment, "turns")
        return None if apart is None else ClockMistake(apart, 0.0)
    if alignment is None or abs(alignment.offset_s) < LEAST_OFFSET_S.value:
        return None
    moved = excerpt(recording, replace(state, time_ns=state.time_ns + alignment.offset_ns))
    if moved is None:
        return None
    before, after = innovation(sample), innovation(moved)
    price = cost(after, before.motion)
    if price >= EXPLAINS.value * cost(before, before.motion):
        return None
    text = (
        f"gyro and attitude disagree: {_said(alignment)}; that lowers the innovation of the attitude from "
        f"{before.turn_rad_s:.2g} to {after.turn_rad_s:.2g} rad/s"
    )
    return ClockMistake(Finding("clock offset", state.topic, text, leave_out=True), price)


def rotor_clock_finding(recording: Recording, vehicle: Vehicle | None) -> Finding | None:
    """The finding that rotor speeds share no time with the IMU; None if they do.

    Without a vehicle no offset is looked for, as the places of the rotors are not known.
    """
    imu, rotors = recording.imu, recording.rotor_speeds
    if rotors is None or len(rotors) < 2 or len(imu) < 2 or shared_s(imu, rotors) >= SHARED_S.value:
        return None
    alignment = None
    if vehicle is not None:
        with suppress(SignalError):
            alignment = rotor_alignment(recording, rotors, vehicle)
    return _apart(imu, rotors, alignment, "lift and moments")


def rotor_alignment(recording: Recording, rotors: RotorSpeedStream, vehicle: Vehicle) -> Alignment:
    """The offset at which rotor speeds explain the motion.

    Raises:
        SignalError: if there is none.
    """
    what = f"{recording.source}: imu and {rotors.topic}"
    alignment = rotor_offset(recording.imu, rotors, vehicle, what)
    there = replace(rotors, time_ns=rotors.time_ns + alignment.offset_ns)
    sample = rotor_excerpt(replace(recording, rotor_speeds=there))
    evidence = None if sample is None else rotor_evidence(sample, vehicle)
    if evidence is None or evidence.explained < EXPLAINED.value:
        raise SignalError(f"{what}: no offset at which the rotor speeds explain the motion")
    return alignment


def aligned(recording: Recording, vehicle: Vehicle) -> tuple[Recording, dict[str, Alignment]]:
    """The recording with the stamps of its streams moved to the clock of the IMU, and by how much, by topic.

    Poses are moved so that their turns match the gyro's, velocities of the same motion capture with them; a
    fused state and rotor speeds only where they were stamped by another clock.

    Raises:
        SignalError: naming file and topic, if there is neither pose nor odometry, and for an offset that is
            not found or ambiguous; one below NEAR_S is taken for the right one.
    """
    imu, moved, delays = recording.imu, recording, {}
    if recording.pose is None and recording.odometry is None:
        raise SignalError(f"{recording.source}: topic mocap/pose is missing: nothing to align")
    for name in ("pose", "odometry", "rotor_speeds"):
        stream = getattr(recording, name)
        if stream is None:
            continue
        what = f"{recording.source}: imu and {stream.topic}"
        if isinstance(stream, RotorSpeedStream):
            if rotor_clock_finding(recording, vehicle) is None:
                continue
            alignment = rotor_alignment(recording, stream, vehicle)
        elif name == "odometry" and clock_mistake(recording, stream, excerpt(recording, stream)) is None:
            continue
        else:
            alignment = turn_offset(imu, stream, what)
        if alignment.rival_s is not None and abs(alignment.offset_s) > NEAR_S.value:
            raise SignalError(
                f"{what}: offsets of {alignment.offset_s:+.3f} s and {alignment.rival_s:+.3f} s fit nearly "
                "alike, as the motion repeats: align the clocks otherwise"
            )
        delays[stream.topic] = alignment
        moving = {name: stream, "twist": recording.twist if name == "pose" else None}
        shifted: dict[str, Any] = {
            field: replace(one, time_ns=one.time_ns + alignment.offset_ns)
            for field, one in moving.items()
            if one is not None
        }
        moved = replace(moved, **shifted)
    return moved, delays


def shared_s(imu: ImuStream, other: Pose | RotorSpeedStream) -> float:
    """Time that a stream shares with the IMU [s]; negative if there is a gap between them."""
    first, last = (max(imu.time_ns[0], other.time_ns[0]), min(imu.time_ns[-1], other.time_ns[-1]))
    return 1e-9 * float(last - first)


def _apart(
    imu: ImuStream, other: Pose | RotorSpeedStream, found: Alignment | None, what: str
) -> Finding | None:
    """The finding on streams that share no time; None where one is too short to."""
    if min(np.ptp(imu.time_ns), np.ptp(other.time_ns)) < 1e9 * SHARED_S.value:
        return None
    share = max(0.0, shared_s(imu, other))
    text = (
        f"spans {span_of(other.time_ns)}, imu {span_of(imu.time_ns)}: they share "
        f"{f'{share:.3f} s' if share else 'no time'}; "
        f"{f'no offset makes their {what} alike' if found is None else _said(found)}"
    )
    return Finding("clocks apart" if found is None else "clock offset", other.topic, text, leave_out=True)


def _said(found: Alignment) -> str:
    """The offset of the stamps, in words."""
    late, alike = -found.offset_s, f"correlation {found.correlation:.2f} over {found.overlap_s:.1f} s"
    if found.rival_s is None:
        return f"the stamps look {late:+.3f} s off, which `import --align` corrects ({alike})"
    return (
        f"the stamps look {late:+.3f} s or {-found.rival_s:+.3f} s off, which is ambiguous as the motion "
        f"repeats ({alike})"
    )
