# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether rotor speeds, motion and vehicle file agree on rotor order, spins, lag, mass and inertia.

Thrust and torque of a rotor are proportional to its speed squared. So the regression of the angular
acceleration on the squares shows the place and spin of each rotor, for any coefficients, and the ratio of
inertia to mass times arm.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.screening.excerpt import RotorExcerpt
from quadpi_core.vehicle import ROTORS, Vehicle

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
        order: rotor columns that fit the vehicle's rotors best; (0, 1, 2, 3) if none is swapped.
        spins_inverted: whether inverted spins fit best.
        order_correlation: (3,) correlation with this order and these spins.
        mean_squares: (4,) of each rotor, over the flight.
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
        self.correlation, gain = _correlation(moving, shown @ levers.T)
        self._now = sample.squares[:, margin : margin + cells]
        totals = self._now.sum(axis=2)
        thrust = float(vehicle.mass_kg * np.sum(-sample.force[..., 2] * totals) / np.sum(totals**2))
        self.ratio = gain[:2] * np.diag(vehicle.inertia)[:2] / thrust
        self.order, self.spins_inverted, self.order_correlation = _best_order(moving, shown, levers)
        self.mean_squares = self._now.reshape(-1, ROTORS).mean(axis=0)
        self.windows = len(self._now)

    @property
    def same(self) -> tuple[int, int] | None:
        """Two rotors whose speeds are one, in nearly every cell; None if there are none."""
        pairs = combinations(range(ROTORS), 2)
        now = self._now
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
        noise = _whiteness(np.concatenate((rates[..., :2], force[..., 2:]), axis=2))
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
            """Of the signals, in the median piece, that any four coefficients explain."""
            medians, shown = [], pieces(_smoothed(moved))
            for loud, weight, signal in heard:
                told = shown[loud] * weight[..., np.newaxis]
                coefficients, *_ = np.linalg.lstsq(told.reshape(-1, ROTORS), signal.ravel(), rcond=None)
                medians.append(np.median(np.mean((signal - told @ coefficients) ** 2, axis=1)))
            return 1.0 - float(np.mean(medians))

        apart, every = (round(length / step) for length in (_BUSY_SLOW_S, _APART_S))
        shifts = range(apart, squares.shape[1] - apart, every)
        chance = max(share(np.roll(squares, shift, axis=1)) for shift in shifts)
        return (share(squares) - chance) / (1.0 - chance)


def rotor_evidence(sample: RotorExcerpt, vehicle: Vehicle) -> RotorEvidence | None:
    """Compare rotor speeds and motion of an excerpt; None if the rotors never turn, or are not four."""
    if vehicle.rotor_count != ROTORS:
        return None
    inside = slice(sample.margin, sample.margin + sample.rates.shape[1])
    level = sample.squares[:, inside].sum(axis=2).mean(axis=1)
    if level.max() <= 0.0:
        return None
    flying = level > _CARRYING_SHARE * level.max()
    rates, force, squares = sample.rates[flying], sample.force[flying], sample.squares[flying]
    return RotorEvidence(replace(sample, rates=rates, force=force, squares=squares), vehicle)


def _whiteness(values: Array) -> Array:
    """Standard deviation (C,) of the white noise of values (W, K, C), from their second differences."""
    rough = np.median(np.diff(values, 2, axis=1) ** 2, axis=(0, 1))
    return np.asarray(np.sqrt(rough / _MEDIAN_SQUARE / _SECOND_DIFFERENCE))


def _best_order(moving: Array, squares: Array, levers: Array) -> tuple[tuple[int, ...], bool, Array]:
    """Order of columns and sense of the spins whose moments follow the accelerations best."""
    best = (-np.inf, tuple(range(ROTORS)), False, np.zeros(3))
    for order in permutations(range(ROTORS)):
        correlation, _ = _correlation(moving, squares[:, order] @ levers.T)
        for inverted in (False, True):
            signed = correlation * (1.0, 1.0, -1.0 if inverted else 1.0)
            score = float(np.sum(signed * np.abs(signed)))
            if score > best[0] + 1e-9:
                best = (score, order, inverted, signed)
    return best[1:]


def _correlation(of: Array, over: Array) -> tuple[Array, Array]:
    """Correlation and slope (C,) of columns (N, C) over others."""
    product, power = np.sum(of * over, axis=0), np.sum(over**2, axis=0)
    return (
        product / np.sqrt(np.maximum(np.sum(of**2, axis=0) * power, 1e-30)),
        product / np.maximum(power, 1e-30),
    )


def _explained(squares: Array, signals: Array) -> float:
    """Share of the variance of signals (N, C), each on its own scale, that the squares (N, 4) explain."""
    coefficients, *_ = np.linalg.lstsq(squares, signals, rcond=None)
    residual = np.sum((signals - squares @ coefficients) ** 2, axis=0)
    return float(np.mean(1.0 - residual / np.maximum(np.sum(signals**2, axis=0), 1e-30)))


def _shifted(squares: Array, first: int, cells: int, step: float) -> Array:
    """Squares (N, 4) from a cell on, weighted and filtered as the acceleration is."""
    return _band(_smoothed(squares[:, first : first + cells]), step).reshape(-1, ROTORS)


def _smoothed(squares: Array) -> Array:
    """Squares (W, K, 4) weighted as a central difference weights the acceleration."""
    return np.asarray(0.25 * squares[:, :-2] + 0.5 * squares[:, 1:-1] + 0.25 * squares[:, 2:])


def _band(values: Array, step: float, slow_s: float = _SLOW_S, fast_s: float = _FAST_S) -> Array:
    """Band-pass of values (W, K, C) between the two periods; shorter by the slow one."""
    slow, fast = (2 * round(0.5 * length / step) + 1 for length in (slow_s, fast_s))
    edge = (slow - fast) // 2
    return np.asarray(_mean(values, fast)[:, edge:-edge] - _mean(values, slow))


def _mean(values: Array, length: int) -> Array:
    total = np.cumsum(np.concatenate((np.zeros_like(values[:, :1]), values), axis=1), axis=1)
    return np.asarray((total[:, length:] - total[:, :-length]) / length)
