# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regions that hold all axes of what a model errs at once: boxes of our intervals, ellipsoids of others.

What a rule learns before the flight is of flights of other turns, as in `interval_rivals`. A region is all
errors whose size, by the rule, is at most a radius; its volume goes with the radius to the power of the axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from interval_rivals import ALPHA, RULES, Race, Said, quantile_regression, quantiles, still
from numpy.typing import NDArray

from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import delayed, means_of
from quadpi_core.monitor.adaptive import GAIN_PER_S, MOST_STEP

# Samples that the radius of MultiDimSPCI is regressed on, and ranges of speed of a local ellipsoid.
_ROWS, _SPEEDS = 8000, 5


class Sized(NamedTuple):
    """Sizes (T, F) of the errors, and logarithms (T, F) of the widths of radius 1.

    A width is the side of a cube of that volume.
    """

    size: Array
    unit: Array


class Regions(NamedTuple):
    """Sizes, radii and logarithms of the widths of radius 1, (T, F) each."""

    size: Array
    radius: Array
    unit: Array


Shape = Callable[[Race], Sized]
Rule = Callable[[Race], Regions]


def calibrating(race: Race) -> Iterator[tuple[NDArray[np.bool_], Race]]:
    """For each turn the flights (F,) that calibrate, and a race of these alone."""
    for own in race.calibrating():
        turn = np.unique(race.turn[own], return_inverse=True)[1]
        yield (
            own,
            Race(race.error[:, own], race.half[:, own], race.speed[:, own], turn, race.rate_hz, race.delay),
        )


def split(race: Race, shape: Shape) -> Regions:
    """Radii by the split conformal quantile of sizes of flights that calibrate, each by the others."""
    size, unit = shape(race)
    radius = np.empty_like(size)
    for own, others in calibrating(race):
        scores = shape(others).size
        scores = scores[np.isfinite(scores)]
        level = min(np.ceil((len(scores) + 1) * (1.0 - ALPHA)) / len(scores), 1.0)
        radius[:, ~own] = np.quantile(scores, level, method="higher")
    return Regions(size, radius, unit)


def following(
    race: Race, regions: Regions, gain_per_s: float = GAIN_PER_S, most: float = MOST_STEP
) -> Regions:
    """Radii whose logarithms follow the misses, as our intervals' widths do: see `monitor.adaptive`."""
    radius, more = regions.radius.copy(), np.zeros(regions.size.shape[1])
    step = min(gain_per_s / race.rate_hz, most)
    for t in range(len(radius)):
        if t >= race.delay:
            missed = regions.size[t - race.delay] > radius[t - race.delay]
            more += step * (missed - ALPHA)
        radius[t] *= np.exp(more)
    return regions._replace(radius=radius)


def box(said: Callable[[Race], Said]) -> Shape:
    """Intervals of all axes, widened or narrowed by one factor."""

    def sized(race: Race) -> Sized:
        centre, half = said(race)
        size = np.max(np.abs(race.error - centre) / half, axis=-1)
        return Sized(size, np.log(2.0 * half).mean(axis=-1))

    return sized


def ball_width(axes: int) -> float:
    """Logarithm of the width of the unit ball of so many dimensions."""
    return 0.5 * math.log(math.pi) - math.lgamma(0.5 * axes + 1.0) / axes


def ellipsoid(speeds: int = 1) -> Shape:
    """Ellipsoids by the covariance of errors, in each of some ranges of speed."""

    def sized(race: Race) -> Sized:
        axes = race.error.shape[-1]
        size, unit = np.full(race.speed.shape, np.nan), np.full(race.speed.shape, ball_width(axes))
        for own in race.calibrating():
            edges = np.nanquantile(race.speed[:, own], np.linspace(0.0, 1.0, speeds + 1)[1:-1])
            bins = np.digitize(race.speed, edges)
            for one in range(speeds):
                here = (bins == one) & np.isfinite(race.error[..., 0])
                learned, rows = race.error[here & own], here & ~own
                covariance = learned.T @ learned / len(learned)
                solved = np.linalg.solve(covariance, race.error[rows].T)
                size[rows] = np.sqrt(np.einsum("nk,kn->n", race.error[rows], solved))
                unit[rows] += 0.5 * np.linalg.slogdet(covariance)[1] / axes
        return Sized(size, unit)

    return sized


def multi_dim_spci(race: Race) -> Regions:
    """An ellipsoid whose radius is a quantile given the sizes before (Xu, Jiang and Xie 2024).

    By linear regression instead of forests.
    """
    shape = ellipsoid()

    def inputs_of(of: Race, size: Array) -> Array:
        past = delayed(size, of.delay)
        return np.concatenate((means_of(past, of.rate_hz), np.ones((*past.shape, 1))), axis=-1)

    size, unit = shape(race)
    inputs, radius, random = inputs_of(race, size), np.empty_like(size), np.random.default_rng(0)
    for own, others in calibrating(race):
        sizes = shape(others).size
        known = np.argwhere(np.isfinite(sizes))
        rows = tuple(known[random.choice(len(known), min(_ROWS, len(known)), replace=False)].T)
        slopes = quantile_regression(inputs_of(others, sizes)[rows], sizes[rows], 1.0 - ALPHA)
        radius[:, ~own] = np.maximum(inputs[:, ~own] @ slopes, 0.0)
    return Regions(size, radius, unit)


def _split_intervals(race: Race) -> Said:
    return still(race, quantiles(race, np.abs(race.error)))


_MOVES = RULES["own, centre moves"]
REGIONS: Mapping[str, Rule] = {
    "box of split conformal": lambda race: split(race, box(_split_intervals)),
    # Johnstone and Cox 2021; Messoudi, Destercke and Rousseau 2022 have neighbours instead of speeds.
    "conformal ellipsoid": lambda race: split(race, ellipsoid()),
    "conformal ellipsoid by speed": lambda race: split(race, ellipsoid(_SPEEDS)),
    "MultiDimSPCI": multi_dim_spci,
    "MultiDimSPCI, radius follows": lambda race: following(race, multi_dim_spci(race)),
    "box of own": lambda race: split(race, box(RULES["own"])),
    "box of own, centre moves": lambda race: split(race, box(_MOVES)),
    "box of own, both": lambda race: following(race, split(race, box(_MOVES))),
}


class RegionResult(NamedTuple):
    """Of a rule: mean width (F,) by flight, coverage (F,), and least coverage (F,) over a window."""

    width: Array
    coverage: Array
    worst: Array


def region_result(regions: Regions, window: int) -> RegionResult:
    """How good regions are."""
    found = []
    for size, radius, unit in zip(*(of.T for of in regions), strict=True):
        rows = np.isfinite(size)
        held = np.concatenate(([0.0], np.cumsum(size[rows] <= radius[rows])))
        length = min(window, len(held) - 1)
        width = float(np.mean(np.exp(unit[rows]) * radius[rows]))
        found.append((width, held[-1] / (len(held) - 1), np.min(held[length:] - held[:-length]) / length))
    return RegionResult(*np.array(found).T)
