# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions and times in which simulation and flights disagree beyond noise and tolerances.

Coefficients are first fitted within their tolerances, together with the effects that were found, so that a
residual that a coefficient explains is not located anywhere. The remaining energy in a cell, a bin of a
variable or a second of a flight, is compared with that of draws without any effect, treated in the same way.
P-values are adjusted for all cells by the smallest p-value of each draw (Westfall and Young), as cells share
samples and noise is correlated over several cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse import csc_array
from scipy.special import rel_entr
from scipy.stats import gamma, norm

from quadpi_core.discrepancy.closure import SearchResult
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.whitening import Indices, Part, rows_of
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array, roll_pitch_yaw_from_quaternion
from quadpi_core.records import CONVENTION, Threshold

FALSE_RANGE = Threshold(
    "chance of a range in sound flights",
    0.05,
    "half each for coefficients and noise",
    "usual level",
    CONVENTION,
)
EFFECT_SIZE = Threshold(
    "energy that matters",
    4.0,
    "mean energy of a cell in the draws",
    "twice their root mean square: noise grows with speed and load, and a coefficient has a form",
    "none: a convention; 20 sets of flights without a discrepancy stay below it (test_by_condition.py)",
)
BULK = Threshold(
    "bulk of the energy", 0.8, "of that beyond noise", "named ranges leave the tail of every bin", CONVENTION
)
LEAST_SHARE = Threshold(
    "energy of a range", 0.03, "of that beyond noise", "a range with less is not worth a line", CONVENTION
)
LIFT = Threshold(
    "lift of a range", 1.5, "energy over time, as shares", "it is 1 where an axis disagrees alike", CONVENTION
)
FEWEST_SAMPLES = Threshold(
    "samples of a bin", 0.01, "of all samples", "with fewer it says nothing, and joins another", CONVENTION
)
SEGMENT_S = Threshold(
    "length of a cell in time", 1.0, "s", "a manoeuvre lasts one to a few seconds", CONVENTION
)
MOST_BINS = 12
# Edges of the bins of the height [m]: the air near the ground changes with powers of the height.
_HEIGHTS_M = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
# Draws without any effect: five of them lie beyond the p-value of a cell that stands out. Figures show as
# allowed what one bin of twenty exceeds by chance.
_DRAWS, _ALLOWED = 200, 0.95


class Variable(NamedTuple):
    """What a residual may depend on: in words, its unit, and its values (M,) along a flight."""

    words: str
    unit: str
    along: Callable[[Compared], Array]


def _angles(own: Compared) -> Array:
    return roll_pitch_yaw_from_quaternion(own.states["attitude"])


VARIABLES = {
    "speed": Variable("airspeed", "m/s", lambda own: np.linalg.norm(own.states["velocity_air"], axis=1)),
    "u": Variable("forward airspeed", "m/s", lambda own: own.states["velocity_air"][:, 0]),
    "v": Variable("rightward airspeed", "m/s", lambda own: own.states["velocity_air"][:, 1]),
    "w": Variable("downward airspeed", "m/s", lambda own: own.states["velocity_air"][:, 2]),
    "height": Variable("height", "m", lambda own: -own.states["position"][:, 2]),
    "rotor_speed": Variable("mean rotor speed", "rad/s", lambda own: own.states["rotor_speeds"].mean(axis=1)),
    "rates": Variable("turn rate", "rad/s", lambda own: np.linalg.norm(own.states["rates"], axis=1)),
    "heading": Variable("heading", "degrees", lambda own: np.degrees(_angles(own)[:, 2])),
    "north": Variable("position north", "m", lambda own: own.states["position"][:, 0]),
    "east": Variable("position east", "m", lambda own: own.states["position"][:, 1]),
    "time": Variable("time", "s", lambda own: own.thinned.time - own.thinned.time[0]),
}


class Residual(NamedTuple):
    """Measured less simulated wrench (B, 6) [N, Nm] of a flight over time [s], up to the band's end.

    Attributes:
        variables: (B,) each, by names of `VARIABLES`.
        before: residual of the simulation as it is.
        beyond: residual with coefficients fitted within their tolerances, together with the effects.
        after: residual with effects and coefficients as fitted on all other flights.
    """

    flight: str
    time: Array
    variables: dict[str, Array]
    before: Array
    beyond: Array
    after: Array


@dataclass(frozen=True)
class Range:
    """Conditions in which an axis disagrees.

    Attributes:
        variable: name in `VARIABLES`; None for an axis that disagrees in all conditions equally.
        low, high: bounds in the unit of the variable; None where no flight went beyond the range.
        share, time_share: shares of the energy of the axis beyond noise and tolerances, and of all samples.
        p_value: adjusted for all bins, variables and axes.
    """

    axis: str
    variable: str | None
    low: float | None
    high: float | None
    share: float
    time_share: float
    p_value: float

    @property
    def is_large(self) -> bool:
        """Whether it holds enough energy to be named."""
        return self.share >= LEAST_SHARE.value

    @property
    def is_informative(self) -> bool:
        """Whether it holds more of the energy than of the time."""
        return self.share > LIFT.value * self.time_share

    @property
    def text(self) -> str:
        """In words, with its shares."""
        if self.variable is None:
            return f"{self.axis} {self.conditions}"
        return (
            f"{self.axis} at {self.conditions}: {100.0 * self.share:.0f} % of the residual energy "
            f"in {100.0 * self.time_share:.0f} % of the time"
        )

    @property
    def conditions(self) -> str:
        """The range in words."""
        if self.variable is None:
            return "everywhere alike"
        words, unit, _ = VARIABLES[self.variable]
        if self.low is None and self.high is None:
            return f"any {words}"
        if self.high is None:
            return f"{words} above {self.low:g} {unit}"
        if self.low is None:
            return f"{words} below {self.high:g} {unit}"
        return f"{words} from {self.low:g} to {self.high:g} {unit}"


@dataclass(frozen=True)
class Segment:
    """A time of one flight in which an axis disagrees; share and p-value as those of a :class:`Range`."""

    flight: str
    axis: str
    start_s: float
    end_s: float
    share: float
    p_value: float


class Profile(NamedTuple):
    """An axis over its most informative variable: root mean square [N, Nm] in K bins, of K + 1 edges.

    It is that of these of :class:`Residual`, and what 95 % of draws without any effect stay below.
    """

    axis: str
    variable: str
    edges: Array
    beyond: Array
    after: Array
    allowed: Array


class Where(NamedTuple):
    """Where simulation and flights disagree.

    Attributes:
        ranges: ranges with more energy than their share of the time: of each axis those of the most
            informative variable, then those of the next; axes furthest above their noise come first.
        segments: segments of axes that have ranges, most energy first.
        profiles: one of each axis.
        residuals: one of each flight, in their order.
    """

    ranges: tuple[Range, ...]
    segments: tuple[Segment, ...]
    profiles: tuple[Profile, ...]
    residuals: tuple[Residual, ...]

    @property
    def telling(self) -> tuple[Range, ...]:
        """Of each axis the ranges of its most informative variable."""
        first: dict[str, str | None] = {}
        return tuple(own for own in self.ranges if first.setdefault(own.axis, own.variable) == own.variable)


def locate(found: SearchResult, seed: int = 0) -> Where:
    """Find where the flights of a search disagree with its simulation."""
    flights = residuals(found)
    cells = judged_cells(found, flights, seed)
    ranges, segments, profiles = [], [], []
    for axis, name in enumerate(AXES):
        order = sorted(VARIABLES, key=lambda variable: -_divergence(cells, variable, axis))
        own = cells.families[order[0]]
        energies = (cells.beyond, cells.after, cells.allowed)
        rms = (np.sqrt(energy[own, axis] / cells.samples[own]) for energy in energies)
        profiles.append(Profile(name, order[0], cells.edges[order[0]], *rms))
        ranges.append(_ranges(cells, order, axis))
        if any(ranges[axis]):
            for start, end, share, _, p_value in _runs(cells, "second", axis):
                flight, start_s, _ = cells.seconds[start]
                end_s = cells.seconds[end - 1][2]
                segments.append(Segment(flights[flight].flight, name, start_s, end_s, share, p_value))
    energy = cells.excess[cells.families["time"]].sum(axis=0) / found.regression.noise.variance.sum(
        axis=(0, 2)
    )
    loudest = [ranges[axis] for axis in np.argsort(-energy)]
    return Where(
        tuple(part for rank in zip_longest(*loudest, fillvalue=()) for group in rank for part in group),
        tuple(sorted(segments, key=lambda segment: -segment.share)),
        tuple(profiles),
        tuple(flights),
    )


def _divergence(cells: Cells, variable: str, axis: int) -> float:
    """Divergence (Kullback and Leibler) of the energy over the bins of a variable from the time in them."""
    own = cells.families[variable]
    energy, time = cells.excess[own, axis], cells.samples[own]
    return float(rel_entr(energy / max(energy.sum(), np.finfo(float).tiny), time / time.sum()).sum())


def _ranges(cells: Cells, order: Sequence[str], axis: int) -> list[list[Range]]:
    """Ranges of an axis by variable, most informative first."""
    found = []
    for name in order:
        edges = [None, *cells.edges[name][1:-1].tolist(), None]
        runs = _runs(cells, name, axis)
        parts = (Range(AXES[axis], name, edges[start], edges[end], *shares) for start, end, *shares in runs)
        found.append([part for part in parts if part.is_large])
    telling = [[part for part in parts if part.is_informative] for parts in found]
    if any(found) and not any(telling):
        smallest = min(part.p_value for parts in found for part in parts)
        return [[Range(AXES[axis], None, None, None, 1.0, 1.0, smallest)]]
    return [parts for parts in telling if parts]


def _runs(cells: Cells, family: str, axis: int) -> Iterator[tuple[int, int, float, float, float]]:
    """Runs of cells that stand out: first, one after the last, shares of energy and time, p-value."""
    own = cells.families[family]
    samples, p_value, excess = cells.samples[own], cells.p_value[own, axis], cells.excess[own, axis]
    kept = standing_out(cells.beyond[own, axis], cells.mean[own, axis], p_value, samples)
    # A run of seconds ends with its flight.
    marks = np.where(kept, [flight for flight, *_ in cells.seconds] if family == "second" else 0, -1)
    for start, end in pairwise(np.flatnonzero(np.diff(marks, prepend=-2, append=-2)).tolist()):
        if marks[start] >= 0:
            share, time_share = (float(each[start:end].sum() / each.sum()) for each in (excess, samples))
            yield start, end, share, time_share, float(p_value[start:end].min())


def standing_out(energy: Array, mean: Array, p_value: Array, samples: Array) -> npt.NDArray[np.bool_]:
    """The cells (C,) that hold the bulk of the energy beyond the mean of the draws in the fewest samples.

    They are of those with significantly more than that mean, and enough to matter.
    """
    excess = np.maximum(energy - mean, 0.0)
    order = np.argsort(-excess / samples)
    order = order[((p_value <= 0.5 * FALSE_RANGE.value) & (energy >= EFFECT_SIZE.value * mean))[order]]
    denser = np.cumsum(excess[order]) - excess[order]
    kept = np.zeros(len(excess), dtype=bool)
    kept[order[denser < BULK.value * excess.sum()]] = True
    return kept


def residuals(found: SearchResult) -> list[Residual]:
    """Residuals of the flights of a search, in their order."""
    regression = found.regression
    tolerances, before = regression.base[1:], [Part(regression.residual, np.ones(1))]
    # Together with the effects that were found: alone, coefficients would take their place.
    effects = found.fit.residual(without=tolerances)
    gram = regression.noise.grams(tolerances, tolerances).sum(axis=0)
    projected = regression.noise.grams(tolerances, [part.columns for part in effects]).sum(axis=0)
    weights = np.concatenate([part.weights for part in effects])
    fitted = within_tolerance(gram, (projected @ weights)[:, None])[:, 0]
    beyond = [*before, *regression.of_tolerances(-fitted)]
    result = []
    for place, (flight, held_out) in enumerate(zip(regression.flights, found.closing.left_out, strict=True)):
        rows = [rows_of(parts, place) for parts in (before, beyond, held_out.residual())]
        at, series = over_time(np.stack(rows, axis=2), len(flight.thinned))
        variables = {name: variable.along(flight)[at] for name, variable in VARIABLES.items()}
        thinned = flight.thinned
        result.append(Residual(thinned.name, thinned.time[at], variables, *np.moveaxis(series, 2, 0)))
    return result


def over_time(rows: Array, samples: int) -> tuple[Indices, Array]:
    """Indices (B,) of samples, and series (B, 6, C) there, of rows (6, B, C) of a :func:`spectrum`."""
    count = rows.shape[1]
    transformed = np.empty((len(rows), (count + 1) // 2, rows.shape[2]), dtype=complex)
    transformed[:, 0] = rows[:, 0]
    transformed[:, 1:] = (rows[:, 1::2] + 1j * rows[:, 2::2]) / np.sqrt(2.0)
    series = np.fft.irfft(transformed, n=count, axis=1, norm="ortho") * np.sqrt(count / samples)
    at = np.minimum(np.rint(np.arange(count) * (samples / count)).astype(np.intp), samples - 1)
    return at, np.ascontiguousarray(np.moveaxis(series, 0, 1))


def largest_deviation(count: int) -> float:
    """Multiple of its tolerance that the furthest of `count` coefficients may reach."""
    return float(norm.isf(0.25 * FALSE_RANGE.value / count))


def within_tolerance(gram: Array, projected: Array) -> Array:
    """Best-fitting coefficients (K, D), none further off than :func:`largest_deviation`, of D residuals.

    They are fitted by the Gram matrix (K, K) of the whitened columns and projections (K, D) on these.
    """
    upper, most = cholesky(gram + np.eye(len(gram))), largest_deviation(len(gram))
    goal = solve_triangular(upper, projected, trans="T")
    best: Array = solve_triangular(upper, goal)
    for far in np.flatnonzero((np.abs(best) > most).any(axis=0)):
        best[:, far] = lsq_linear(upper, goal[:, far], (-most, most), method="bvls").x
    return best


class Cells(NamedTuple):
    """The C cells of all flights: the bins of each variable, then the seconds of each flight.

    Attributes:
        edges: edges of the bins of each variable.
        seconds: flight, start and end [s] of each second.
        families: cells of each variable, and of all seconds as "second".
        samples: (C,) number in each.
        beyond, after: (C, 6) energy of these of :class:`Residual`.
        mean, allowed: (C, 6) mean energy of draws without any effect, and what most of them stay below.
        excess: (C, 6) energy beyond that mean; 0 where there is less.
        p_value: (C, 6) of the energy, adjusted for all bins, or for all seconds.
    """

    edges: dict[str, Array]
    seconds: list[tuple[int, float, float]]
    families: dict[str, slice]
    samples: Array
    beyond: Array
    after: Array
    mean: Array
    allowed: Array
    excess: Array
    p_value: Array


def judged_cells(found: SearchResult, flights: Sequence[Residual], seed: int) -> Cells:
    """The cells of flights, with the energy beyond tolerances tested against draws without any effect."""
    values = {name: np.concatenate([flight.variables[name] for flight in flights]) for name in VARIABLES}
    edges = {name: bin_edges(name, own) for name, own in values.items()}
    seconds: list[tuple[int, float, float]] = []
    within = []
    for place, flight in enumerate(flights):
        borders = second_borders(flight.time)
        own = [np.digitize(flight.variables[name], edges[name][1:-1]) for name in VARIABLES]
        within.append(np.stack([*own, len(seconds) + np.digitize(flight.time, borders[1:-1])], axis=1))
        seconds += [(place, *both) for both in pairwise(borders.tolist())]
    ends = np.cumsum([*(len(own) - 1 for own in edges.values()), len(seconds)])
    starts = np.append(0, ends[:-1])
    # Per flight (C, B): 1 where a sample lies in a cell.
    members = []
    for cell in within:
        first, ones = np.arange(0, cell.size + 1, len(starts)), np.ones(cell.size)
        members.append(csc_array((ones, (cell + starts).ravel(), first), shape=(ends[-1], len(cell))))

    def energy(series: Iterable[Array]) -> Array:
        """Sums of squares (C, …) of series (B, …) of each flight."""
        return sum(
            (own @ np.square(values).reshape(len(values), -1)).reshape(-1, *values.shape[1:])
            for own, values in zip(members, series, strict=True)
        )

    beyond, drawn = energy(flight.beyond for flight in flights), energy(_drawn(found, seed))
    mean, variance = drawn.mean(axis=2), drawn.var(axis=2)
    # Energies of draws are sums of squares: close to a gamma distribution of their mean and variance.
    shape, scale = (np.square(mean) / variance)[:, :, None], (variance / mean)[:, :, None]
    chance, chance_drawn = (gamma.sf(own, shape, scale=scale) for own in (beyond[:, :, None], drawn))
    p_value = np.empty_like(beyond)
    for family in (slice(0, starts[-1]), slice(starts[-1], None)):
        smallest = np.sort(chance_drawn[family].min(axis=(0, 1)))
        below = np.searchsorted(smallest, chance[family, :, 0], side="right")
        p_value[family] = (1.0 + below) / (1.0 + len(smallest))
    return Cells(
        edges,
        seconds,
        dict(zip((*VARIABLES, "second"), map(slice, starts.tolist(), ends.tolist()), strict=True)),
        samples=sum(own.sum(axis=1) for own in members),
        beyond=beyond,
        after=energy(flight.after for flight in flights),
        mean=mean,
        allowed=np.quantile(drawn, _ALLOWED, axis=2),
        excess=np.maximum(beyond - mean, 0.0),
        p_value=p_value,
    )


def second_borders(time: Array) -> Array:
    """Borders (S + 1,) of the seconds of a flight; an incomplete one at its end belongs to the one before."""
    whole = max(int((time[-1] - time[0]) / SEGMENT_S.value), 1)
    return np.append(time[0] + SEGMENT_S.value * np.arange(whole), time[-1])


def bin_edges(name: str, values: Array) -> Array:
    """Edges (K + 1,), round numbers, of the bins of a variable with these values (N,); the ends are open."""
    if name == "height":
        within = (values.min() < _HEIGHTS_M) & (values.max() > _HEIGHTS_M)
        edges = np.concatenate(([min(values.min(), 0.0)], _HEIGHTS_M[within], [values.max()]))
    else:
        edges = round_edges(values, MOST_BINS)
    while len(edges) > 2:
        counts = np.bincount(np.digitize(values, edges[1:-1]), minlength=len(edges) - 1)
        small = int(np.argmin(counts))
        if counts[small] >= FEWEST_SAMPLES.value * len(values):
            break
        # Into the neighbour that holds fewer.
        left = small > 0 and (small == len(counts) - 1 or counts[small - 1] <= counts[small + 1])
        edges = np.delete(edges, small if left else small + 1)
    return edges


def _drawn(found: SearchResult, seed: int) -> Iterator[Array]:
    """Of each flight D residuals (B, 6, D) without any effect, after the same fit of coefficients."""
    regression, draws = found.regression, _DRAWS
    # Without what flights have of their own, as draws are.
    noise = replace(regression.noise, own=())
    tolerances, spectra = regression.base[1:], regression.residual.spectra
    gram = noise.grams(tolerances, tolerances).sum(axis=0)
    most = largest_deviation(len(gram))
    off = np.random.default_rng(seed).standard_normal((len(gram), draws)).clip(-most, most)
    # What generic functions predict is not noise, even where no effect explains it.
    spectrum = np.minimum(noise.variance, found.left.noise)[..., None]

    def noisy(place: int) -> Array:
        rng, band = np.random.default_rng((seed, place)), spectra[place].band
        # Noise differs from flight to flight: its variance is known as well as its squares in a band allow.
        count = np.maximum(np.bincount(band, minlength=spectrum.shape[2]), 1)[:, None]
        share = rng.chisquare(count, (len(AXES), len(count), draws)) / count
        size: Array = np.sqrt(spectrum[place] / share)[:, band]
        return size * rng.standard_normal((len(AXES), len(band), draws))

    # Noise is made twice rather than kept: it is by far the largest of all arrays.
    projected = gram @ off
    allowed = [
        np.dstack([own.spectra[place].rows for own in tolerances]) for place in range(len(regression.flights))
    ]
    for place, rows in enumerate(allowed):
        weighted = rows * noise.precision[place][:, spectra[place].band][:, :, None]
        projected += np.einsum("abk,abd->kd", weighted, noisy(place), optimize=True)
    left = off - within_tolerance(gram, projected)
    for place, rows in enumerate(allowed):
        yield over_time(rows @ left + noisy(place), len(regression.flights[place].thinned))[1]
