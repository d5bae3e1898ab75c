# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rules that turn errors of a model into intervals: ours, and others from the literature.

All flights go in step: arrays are (T, F, 6), NaN where a flight has ended. Of a flight a rule sees the errors
of `delay` samples ago and earlier, and whole the errors of those left out in other turns. A rule gives by how
much the centre moves, and the half width. Gains and times are the best of a few on the sets that the winner
is chosen on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from quadpi_core.frames import Array
from quadpi_core.identification.change_calibration import _left_on_axis
from quadpi_core.models.interval_rules import conformal_rank, delayed, means_of, regressed, usable
from quadpi_core.monitor.adaptive import GAIN_PER_S, MOST_STEP
from quadpi_core.monitor.change import BLOCK_S, CHANGE_BLOCK

ALPHA = 0.05
AXES = 6
# Levels of the tables that quantiles are looked up in.
_LEVELS = 4001


@dataclass(frozen=True, eq=False)
class Race:
    """Flights of a vehicle, each left out in one of K turns.

    Attributes:
        error, half: (T, F, 6) measured − centre, and half width, of the model without the flight, N and Nm.
        speed: (T, F) m/s.
        turn: (F,) in which a flight was left out.
        rate_hz: of the samples.
        delay: samples after which an error is known.
    """

    error: Array
    half: Array
    speed: Array
    turn: NDArray[np.int64]
    rate_hz: float
    delay: int

    def calibrating(self) -> list[NDArray[np.bool_]]:
        """The flights (F,) that calibrate, for each turn."""
        return [self.turn != turn for turn in range(int(self.turn.max()) + 1)]

    def pooled(self, scores: Array) -> list[Array]:
        """Scores (N, 6) of all samples of the flights that calibrate, for each turn."""
        each = [scores[:, own].reshape(-1, AXES) for own in self.calibrating()]
        return [own[np.isfinite(own).all(axis=1)] for own in each]

    def past(self) -> Array:
        """The errors (T, F, 6) that have just become known, zero before the first."""
        return delayed(self.error, self.delay)


class Said(NamedTuple):
    """Shift of the centre and half width, (T, F, 6) each."""

    centre: Array
    half: Array


Rule = Callable[[Race], Said]


def quantiles(race: Race, scores: Array) -> Array:
    """Split conformal quantiles (F, 6): of each flight's turn."""
    found = []
    for own in race.pooled(scores):
        level = min(np.ceil((len(own) + 1) * (1.0 - ALPHA)) / len(own), 1.0)
        found.append(np.quantile(own, level, axis=0, method="higher"))
    return np.array(found)[race.turn]


def by_flight(scores: Array) -> Array:
    """Factor (6,) that covers nine in ten flights of scores (T, F, 6): the rule of `HeldOutRule`."""
    factors = np.sort(np.nanquantile(scores, 1.0 - ALPHA, axis=0), axis=0)
    found: Array = factors[conformal_rank(len(factors)) - 1]
    return found


def still(race: Race, half: Array) -> Said:
    """An interval whose centre stays."""
    return Said(np.zeros_like(race.error), np.broadcast_to(half, race.error.shape))


def mondrian(race: Race) -> Said:
    """One width in each of five ranges of speed (Mondrian categories, as crepes bins them)."""
    half = np.empty_like(race.error)
    for own in race.calibrating():
        edges = np.nanquantile(race.speed[:, own], np.linspace(0.0, 1.0, 6)[1:-1])
        bins = np.digitize(race.speed, edges)
        for place in range(5):
            scores = np.abs(race.error[:, own][bins[:, own] == place])
            width = np.nanquantile(scores, 1.0 - ALPHA, axis=0, method="higher")
            half[(bins == place) & ~own] = width
    return still(race, half)


def adapted(race: Race, said: Said) -> Said:
    """Half widths times a factor whose logarithm follows the misses: see `monitor.adaptive`."""
    half, log_factor = np.empty_like(race.error), np.zeros(race.error.shape[1:])
    errors, step = np.abs(race.error - said.centre), min(GAIN_PER_S / race.rate_hz, MOST_STEP)
    for t in range(len(half)):
        if t >= race.delay:
            missed = errors[t - race.delay] > half[t - race.delay]
            log_factor += step * (missed - ALPHA)
        half[t] = said.half[t] * np.exp(log_factor)
    return Said(said.centre, half)


class Table:
    """Quantiles of the scores of flights that calibrate, and ranks among them, for each flight."""

    def __init__(self, race: Race, scores: Array) -> None:
        self._turn = race.turn
        self._pooled = [np.sort(own, axis=0) for own in race.pooled(scores)]
        levels = np.linspace(0.0, 1.0, _LEVELS)
        self._quantiles = np.stack([np.quantile(own, levels, axis=0).T for own in self._pooled])

    def at(self, level: Array) -> Array:
        """Quantiles (..., F, 6) at levels; the largest score beyond 1."""
        place = np.clip(np.ceil(level * (_LEVELS - 1)), 0, _LEVELS - 1).astype(np.int64)
        found: Array = self._quantiles[self._turn[:, np.newaxis], np.arange(AXES), place]
        return found

    def share_above(self, scores: Array) -> Array:
        """Shares (T, F, 6) of these scores that are as large or larger."""
        shares = np.empty_like(scores)
        for flight, turn in enumerate(self._turn):
            for axis in range(AXES):
                own = self._pooled[turn][:, axis]
                shares[:, flight, axis] = 1.0 - np.searchsorted(own, scores[:, flight, axis]) / len(own)
        return shares


def aci(race: Race, centre: Array | float = 0.0, gain_per_s: float = 0.3) -> Said:
    """Adaptive conformal inference (Gibbs and Candès 2021); no wider than the largest score."""
    scores = np.abs(race.error - centre)
    table = Table(race, scores)
    shares, levels = table.share_above(scores), np.empty_like(scores)
    now, gamma = np.full(shares.shape[1:], ALPHA), gain_per_s / race.rate_hz
    for t in range(len(levels)):
        if t >= race.delay:
            now = now + gamma * (ALPHA - (shares[t - race.delay] < levels[t - race.delay]))
        levels[t] = now
    return Said(np.broadcast_to(centre, scores.shape), table.at(1.0 - levels))


def bias_corrected_aci(race: Race, time_s: float = 0.3) -> Said:
    """ACI about a running mean of the errors, where that is beyond its noise (Lade et al. 2026)."""
    share = -np.expm1(-1.0 / (time_s * race.rate_hz))
    past = race.past()
    mean = lfilter([share], [1.0, share - 1.0], past, axis=0)
    square = lfilter([share], [1.0, share - 1.0], np.square(past - mean), axis=0)
    noise = np.sqrt(square * share / (2.0 - share))
    return aci(race, np.where(np.abs(mean) > 2.0 * noise, mean, 0.0))


def dtaci(race: Race, interval: float = 500.0) -> Said:
    """Dynamically tuned ACI (Gibbs and Candès 2024): eight rates, weighted by their losses."""
    table, rates = Table(race, np.abs(race.error)), 0.001 * 2.0 ** np.arange(8)
    shares = table.share_above(np.abs(race.error))
    square = (1.0 - ALPHA) ** 2 * ALPHA**3 + ALPHA**2 * (1.0 - ALPHA) ** 3
    eta = np.sqrt(3.0 / interval * (np.log(8 * interval) + 2.0) / square)
    sigma, levels = 0.5 / interval, np.empty_like(shares)
    experts = np.full((*shares.shape[1:], 8), ALPHA)
    weights = np.full_like(experts, 1.0 / 8.0)
    for t in range(len(levels)):
        if t >= race.delay:
            share = shares[t - race.delay][..., np.newaxis]
            loss = ALPHA * (share - experts) - np.minimum(share - experts, 0.0)
            weights = weights * np.exp(-eta * loss)
            weights = (1.0 - sigma) * weights / weights.sum(axis=-1, keepdims=True) + sigma / 8.0
            experts = experts + rates * (ALPHA - (experts > share))
        levels[t] = (weights * experts).sum(axis=-1) / weights.sum(axis=-1)
    return still(race, table.at(1.0 - levels))


def saocp(race: Race, lifetime: int = 8) -> Said:
    """Strongly adaptive online conformal prediction (Bhatnagar et al. 2023), from split conformal's width."""
    scores = np.abs(race.error)
    scale = np.array([own.max(axis=0) for own in race.pooled(scores)])[race.turn] * np.sqrt(3.0)
    now, half = quantiles(race, scores), np.empty_like(scores)
    per_level = lifetime // 2
    # Of each expert: its radius, the sum of its squared slopes, its gains, and these weighted.
    slots = (len(scores).bit_length() * per_level + per_level, *now.shape)
    radius, slopes, gains, wealth = np.zeros((4, *slots))
    born, dies = np.ones(slots[0]), np.zeros(slots[0])
    for t in range(len(scores)):
        if t >= race.delay:
            count, score = t - race.delay + 1, scores[t - race.delay]
            level = (count & -count).bit_length() - 1
            slot = level * per_level + (count >> (level + 1)) % per_level
            radius[slot], born[slot], dies[slot] = now, count, count + lifetime * 2**level
            slopes[slot] = gains[slot] = wealth[slot] = 0.0
            alive = dies > count
            age = (count - born)[:, np.newaxis, np.newaxis]
            weight = np.divide(gains, age, out=np.zeros(slots), where=age > 0.0) * (1.0 + wealth)
            loss = np.maximum((1.0 - ALPHA) * (score - radius), ALPHA * (radius - score))
            of_now = np.maximum((1.0 - ALPHA) * (score - now), ALPHA * (now - score))
            gain = np.clip((of_now - loss) / scale / (1.0 - ALPHA), -1.0 * (weight > 0.0), 1.0)
            gains += gain
            wealth += weight * gain
            slope = ALPHA - (score > radius)
            slopes += slope * slope
            radius = np.maximum(radius - scale / np.sqrt(3.0 * slopes) * slope, 0.0)
            prior = np.where(alive, 1.0 / (born**2 * (1.0 + np.floor(np.log2(born)))), 0.0)
            prior = (prior / prior.sum())[:, np.newaxis, np.newaxis]
            weight = gains / (age + 1.0) * (1.0 + wealth)
            shares = prior * np.maximum(weight, 0.0)
            total = shares.sum(axis=0)
            shares = np.where(total > 0.0, shares / np.where(total > 0.0, total, 1.0), prior)
            now = (shares * radius).sum(axis=0)
        half[t] = now
    return still(race, half)


def conformal_pid(race: Race, rate_per_s: float = 2.0) -> Said:
    """Quantile tracking and an integrator that saturates (Angelopoulos, Candès and Tibshirani 2023)."""
    scores, half = np.abs(race.error), np.empty_like(race.error)
    tracked = quantiles(race, scores)
    scale = largest = 1.5 * tracked
    total, keep = np.zeros_like(tracked), np.exp(-0.5 / race.rate_hz)
    for t in range(len(half)):
        if t >= race.delay:
            miss = (scores[t - race.delay] > half[t - race.delay]) - ALPHA
            total += miss
            largest = np.fmax(largest * keep, scores[t - race.delay])
            tracked = tracked + rate_per_s / race.rate_hz * largest * miss
        saturated = np.clip(total * np.log(t + 2.0) / (t + 2.0), -1.5, 1.5)
        half[t] = np.maximum(tracked + 0.1 * scale * np.tan(saturated), 0.0)
    return still(race, half)


def enbpi(race: Race, window_s: float = 3.0, batch_s: float = 0.1) -> Said:
    """The narrowest interval that holds the last errors, at first those of calibration (Xu and Xie 2021)."""
    window, batch = max(round(window_s * race.rate_hz), 60), max(round(batch_s * race.rate_hz), 1)
    first = [own[np.linspace(0, len(own) - 1, window).astype(np.int64)] for own in race.pooled(race.error)]
    series = np.concatenate((np.stack(first, axis=1)[:, race.turn], np.nan_to_num(race.error)))
    inside = int(np.ceil((1.0 - ALPHA) * (window + 1)))
    centre, half = np.empty_like(race.error), np.empty_like(race.error)
    for t in range(0, len(centre), batch):
        stop = max(t + 1 - race.delay, 0) + window
        ordered = np.sort(series[stop - window : stop], axis=0)
        place = (ordered[inside - 1 :] - ordered[: window - inside + 1]).argmin(axis=0)[np.newaxis]
        low, high = (np.take_along_axis(ordered, place + k, axis=0)[0] for k in (0, inside - 1))
        centre[t : t + batch], half[t : t + batch] = 0.5 * (high + low), 0.5 * (high - low)
    return Said(centre, half)


def spci(race: Race) -> Said:
    """Quantiles of the next error given those before (Xu and Xie 2023), here by linear regression."""
    inputs = np.concatenate((means_of(race.past(), race.rate_hz), race.half[..., np.newaxis]), axis=-1)
    lower, upper = (
        regressed_quantile(race, inputs, race.error, level) for level in (0.5 * ALPHA, 1.0 - 0.5 * ALPHA)
    )
    return Said(0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), 0.0))


def conditional(race: Race) -> Said:
    """Covers under every weight linear in speed, its square and the own half width (Gibbs et al. 2023).

    What conditionalconformal solves a linear program for at each sample: the sample itself, among thousands,
    is left out.
    """
    speed = np.broadcast_to(race.speed[..., np.newaxis], race.half.shape)
    inputs = np.stack((np.ones_like(speed), speed, np.square(speed), race.half), axis=-1)
    return still(race, np.maximum(regressed_quantile(race, inputs, np.abs(race.error), 1.0 - ALPHA), 0.0))


def regressed_quantile(race: Race, inputs: Array, target: Array, level: float, rows: int = 8000) -> Array:
    """Quantile (T, F, 6) of a target given inputs (T, F, 6, P), as flights of other turns have it."""
    found, random = np.zeros(race.error.shape), np.random.default_rng(0)
    for own in race.calibrating():
        for axis in range(AXES):
            values = target[:, own, axis].ravel()
            known = np.flatnonzero(np.isfinite(values))
            known = random.choice(known, min(rows, len(known)), replace=False)
            given = inputs[:, own, axis].reshape(len(values), -1)[known]
            slope = quantile_regression(given, values[known], level)
            found[:, ~own, axis] = inputs[:, ~own, axis] @ slope
    return found


def quantile_regression(inputs: Array, target: Array, level: float) -> Array:
    """Coefficients (P,) of inputs (N, P) for a quantile, by least squares with weights that follow."""
    scale, least = np.sqrt(np.mean(np.square(inputs), axis=0)), 1e-3 * float(np.std(target))
    scaled, found = inputs / scale, np.zeros(inputs.shape[1])
    ridge = 1e-9 * len(target) / float(np.std(target)) * np.eye(len(scale))
    for _ in range(40):
        rest = target - scaled @ found
        weights = np.where(rest > 0.0, level, 1.0 - level) / np.maximum(np.abs(rest), least)
        weighted = scaled.T * weights
        found = np.linalg.solve(weighted @ scaled + ridge, weighted @ target)
    slopes: Array = found / scale
    return slopes


def state_space(race: Race) -> Said:
    """Kalman filter of constant, walk, process and white noise, as flights showed; widths by flight.

    The noise is that of the evidence of a change (`change_calibration`), learned on blocks of 0.1 s.
    """
    parts = np.array([_noise(race, own) for own in race.calibrating()])
    first, keep, added, white = parts[..., :2], parts[..., 2:4], parts[..., 4:6], parts[..., 6]
    turns, ahead = len(parts), keep ** (race.delay - 1)
    later = (added * sum((keep ** (2 * k) for k in range(race.delay - 1)), 0.0 * keep)).sum(axis=-1)
    mean = np.zeros((turns, *race.error.shape[1:], 2))
    covariance = first[..., np.newaxis] * np.eye(2)
    centre, deviation = np.empty((2, len(race.error), turns, *race.error.shape[1:]))
    past = race.past()
    for t in range(len(past)):
        if t >= race.delay:
            summed = covariance.sum(axis=-1)
            gain = summed / (summed.sum(axis=-1) + white)[..., np.newaxis]
            error = (past[t] - mean.sum(axis=-1))[..., np.newaxis]
            mean = (mean + gain[:, np.newaxis] * error) * keep[:, np.newaxis]
            covariance = covariance - gain[..., np.newaxis] * summed[..., np.newaxis, :]
            covariance *= keep[..., np.newaxis] * keep[..., np.newaxis, :]
            covariance += added[..., np.newaxis] * np.eye(2)
        centre[t] = (mean * ahead[:, np.newaxis]).sum(axis=-1)
        variance = np.einsum("kap,kapq,kaq->ka", ahead, covariance, ahead) + later + white
        deviation[t] = np.sqrt(variance)[:, np.newaxis]
    return by_turn(race, centre.swapaxes(0, 1), deviation.swapaxes(0, 1))


def _noise(race: Race, own: NDArray[np.bool_]) -> Array:
    """Of each axis (6, 7), for one sample: first variances, shares kept, variances added, white noise."""
    size, blocks = max(round(BLOCK_S * race.rate_hz), 1), []
    for flight in np.flatnonzero(own):
        errors = race.error[np.isfinite(race.error[:, flight]).all(axis=1), flight]
        one = np.zeros(len(errors) // size, CHANGE_BLOCK)
        one["number"] = np.arange(len(one))
        one["residual"] = errors[: len(one) * size].reshape(-1, size, AXES).mean(axis=1)
        blocks.append(one)
    rows = []
    for left in (_left_on_axis(blocks, axis) for axis in range(AXES)):
        keep = left.keep ** (1.0 / size)
        added = left.walk / size, left.process * (1.0 - keep**2)
        rows.append([left.between, left.process, 1.0, keep, *added, left.white * size])
    return np.array(rows)


def by_turn(race: Race, centre: Array, spread: Array) -> Said:
    """Spreads (K, T, F, 6) times a factor that turns calibrate by flight, about centres."""
    said = Said(np.empty_like(race.error), np.empty_like(race.error))
    for turn, own in enumerate(race.calibrating()):
        scores = np.abs(race.error - centre[turn]) / spread[turn]
        said.centre[:, ~own] = centre[turn][:, ~own]
        said.half[:, ~own] = by_flight(scores[:, own]) * spread[turn][:, ~own]
    return said


def centre_moves(race: Race) -> Said:
    """The model's own spread about a centre that past errors move: see `models.interval_rules`."""
    means, known = means_of(race.past(), race.rate_hz), np.isfinite(race.error[..., 0])
    centres = np.full((len(race.calibrating()), *race.error.shape), np.nan)
    for turn, own in enumerate(race.calibrating()):
        flights = np.flatnonzero(own)
        for axis in range(AXES):
            given = means[:, :, axis, usable(race.rate_hz)]
            found, moves = regressed(
                [(race.error[known[:, k], k, axis], given[known[:, k], k]) for k in flights]
            )
            centres[turn, :, ~own, axis] = (given[:, ~own] @ found).T
            for k, by in zip(flights, moves, strict=True):
                centres[turn, known[:, k], k, axis] = by
    return by_turn(race, centres, np.broadcast_to(race.half, centres.shape))


RULES: Mapping[str, Rule] = {
    "split conformal": lambda race: still(race, quantiles(race, np.abs(race.error))),
    "split, over the own spread": lambda race: still(
        race, quantiles(race, np.abs(race.error) / race.half) * race.half
    ),
    "Mondrian by speed (crepes)": mondrian,
    "ACI": aci,
    "DtACI": dtaci,
    "SAOCP": saocp,
    "conformal PID": conformal_pid,
    "bias-corrected ACI": bias_corrected_aci,
    "EnbPI": enbpi,
    "SPCI": spci,
    "conditional conformal": conditional,
    "state space": state_space,
    "own": lambda race: still(race, race.half),
    "own, width adapts": lambda race: adapted(race, still(race, race.half)),
    "own, centre moves": centre_moves,
    "own, both": lambda race: adapted(race, centre_moves(race)),
}
