# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions and times in which simulation and flights disagree beyond noise and tolerances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.residual_bins import (
    SEGMENT_S,
    VARIABLES,
    Cells,
    CellTest,
    Residual,
    against_draws,
    residuals,
)
from quadpi_core.discrepancy.search import Found
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

BULK = Threshold(
    "bulk of the energy",
    0.8,
    "of the energy beyond noise and tolerances",
    "the named ranges hold most of it, in the fewest samples, without the tail that every bin has",
    CONVENTION,
)
LEAST_SHARE = Threshold(
    "energy of a range",
    0.03,
    "of the energy beyond noise and tolerances",
    "a range with less is not worth a line",
    CONVENTION,
)
LIFT = Threshold(
    "lift of a range",
    1.5,
    "share of the energy over share of the time",
    "an axis that disagrees alike in all conditions has the same share of both in every range",
    CONVENTION,
)
WORDS = {
    "speed": ("airspeed", "m/s"),
    "u": ("forward airspeed", "m/s"),
    "v": ("rightward airspeed", "m/s"),
    "w": ("downward airspeed", "m/s"),
    "height": ("height", "m"),
    "rotor_speed": ("mean rotor speed", "rad/s"),
    "rates": ("turn rate", "rad/s"),
    "heading": ("heading", "degrees"),
    "north": ("position north", "m"),
    "east": ("position east", "m"),
    "time": ("time", "s"),
}


@dataclass(frozen=True)
class Range:
    """Conditions in which an axis disagrees.

    Attributes:
        axis: name in `AXES`.
        variable: name in `residual_bins.VARIABLES`; None for an axis that disagrees in all conditions
            equally.
        low, high: bounds in the unit of the variable; None where no flight went beyond the range.
        share: share of the energy of the axis beyond noise and tolerances.
        time_share: share of all samples.
        p_value: p-value, adjusted for all bins, variables and axes.
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
        """In words."""
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
        words, unit = WORDS[self.variable]
        if self.low is None and self.high is None:
            return f"any {words}"
        if self.high is None:
            return f"{words} above {self.low:g} {unit}"
        if self.low is None:
            return f"{words} below {self.high:g} {unit}"
        return f"{words} from {self.low:g} to {self.high:g} {unit}"


@dataclass(frozen=True)
class Segment:
    """A time in which an axis of one flight disagrees.

    Attributes:
        flight: name of the flight.
        axis: name in `AXES`.
        start_s, end_s: times of the flight.
        share: share of the energy of the axis in all flights.
        p_value: p-value, adjusted for all times, flights and axes.
    """

    flight: str
    axis: str
    start_s: float
    end_s: float
    share: float
    p_value: float


@dataclass(frozen=True)
class Profile:
    """The residual of an axis over its most informative variable.

    Attributes:
        axis, variable: see :class:`Range`.
        edges: (K + 1,) edges of the bins.
        beyond, after: (K,) root mean square, N or Nm, of these of :class:`Residual`.
        allowed: (K,) root mean square that 95 % of draws without any effect stay below.
    """

    axis: str
    variable: str
    edges: Array
    beyond: Array
    after: Array
    allowed: Array


@dataclass(frozen=True)
class Where:
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
        for part in self.ranges:
            first.setdefault(part.axis, part.variable)
        return tuple(part for part in self.ranges if first[part.axis] == part.variable)


def locate(found: Found, seed: int = 0) -> Where:
    """Find where the flights of a search disagree with its simulation.

    Coefficients of the simulation are first fitted within their tolerances, together with the effects that
    were found, so that a residual that a coefficient explains is not located anywhere.
    """
    flights = residuals(found)
    cells = Cells.of(flights)
    result = against_draws(found, flights, cells, seed)
    profiles, groups = [], []
    for axis in range(len(AXES)):
        order = sorted(
            VARIABLES, key=lambda name: -_divergence(result.excess[cells.bins[name], axis], cells, name)
        )
        profiles.append(_profile(axis, order[0], flights, cells, result))
        groups.append(_of_axis(axis, order, cells, result))
    energy = result.excess[cells.bins["time"]].sum(axis=0) / found.regression.noise.sum(axis=1)
    loudest = [groups[axis] for axis in np.argsort(-energy)]
    ranges = tuple(part for rank in zip_longest(*loudest, fillvalue=()) for group in rank for part in group)
    loud = {part.axis for part in ranges}
    segments = sorted(
        (segment for segment in _segments(flights, cells, result) if segment.axis in loud),
        key=lambda segment: -segment.share,
    )
    return Where(ranges, tuple(segments), tuple(profiles), tuple(flights))


def _of_axis(axis: int, order: Sequence[str], cells: Cells, result: CellTest) -> list[tuple[Range, ...]]:
    """Ranges of an axis by variable, most informative first."""
    found = [tuple(_ranges(axis, name, cells, result)) for name in order]
    telling = [tuple(part for part in parts if part.is_informative) for parts in found]
    if any(telling) or not any(found):
        return [parts for parts in telling if parts]
    smallest = min(part.p_value for parts in found for part in parts)
    return [(Range(AXES[axis], None, None, None, 1.0, 1.0, smallest),)]


def _divergence(excess: Array, cells: Cells, name: str) -> float:
    """Divergence (Kullback–Leibler) of the energy over the bins of a variable from the time in them."""
    if not excess.any():
        return 0.0
    samples = cells.samples[cells.bins[name]]
    share, time_share = excess / excess.sum(), samples / samples.sum()
    some = share > 0.0
    return float(np.sum(share[some] * np.log(share[some] / time_share[some])))


def _ranges(axis: int, name: str, cells: Cells, result: CellTest) -> Iterator[Range]:
    own, edges = cells.bins[name], cells.edges[name]
    excess, samples, p_value = result.excess[own, axis], cells.samples[own], result.p_value[own, axis]
    last = len(excess) - 1
    for first, end in _runs(holding_bulk(excess, samples, result.stands_out[own, axis])):
        part = Range(
            axis=AXES[axis],
            variable=name,
            low=None if first == 0 else float(edges[first]),
            high=None if end > last else float(edges[end]),
            share=float(excess[first:end].sum() / excess.sum()),
            time_share=float(samples[first:end].sum() / samples.sum()),
            p_value=float(p_value[first:end].min()),
        )
        if part.is_large:
            yield part


def _segments(flights: Sequence[Residual], cells: Cells, result: CellTest) -> Iterator[Segment]:
    first = cells.seconds[0].start
    for axis, name in enumerate(AXES):
        excess, p_value = result.excess[first:, axis], result.p_value[first:, axis]
        kept = holding_bulk(excess, cells.samples[first:], result.stands_out[first:, axis])
        for flight, seconds in zip(flights, cells.seconds, strict=True):
            own = slice(seconds.start - first, seconds.stop - first)
            for start, end in _runs(kept[own]):
                part = slice(own.start + start, own.start + end)
                whole = end == own.stop - own.start
                yield Segment(
                    flight=flight.flight,
                    axis=name,
                    start_s=float(flight.time[0] + start * SEGMENT_S.value),
                    end_s=float(flight.time[-1] if whole else flight.time[0] + end * SEGMENT_S.value),
                    share=float(excess[part].sum() / excess.sum()),
                    p_value=float(p_value[part].min()),
                )


def holding_bulk(excess: Array, samples: Array, stands_out: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The cells (C,) that hold the bulk of the energy in the fewest samples, of those that stand out."""
    kept = np.zeros(len(excess), dtype=bool)
    energy, bulk = 0.0, BULK.value * excess.sum()
    for cell in np.argsort(-excess / samples):
        if energy >= bulk:
            break
        if stands_out[cell]:
            kept[cell] = True
            energy += excess[cell]
    return kept


def _runs(kept: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First cell, and the one after the last, of each run of kept cells."""
    steps = np.diff(np.concatenate(([0], kept.astype(int), [0])))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _profile(axis: int, name: str, flights: Sequence[Residual], cells: Cells, result: CellTest) -> Profile:
    own = cells.bins[name]

    def rms(energy: Array) -> Array:
        root: Array = np.sqrt(energy[own, axis] / cells.samples[own])
        return root

    return Profile(
        axis=AXES[axis],
        variable=name,
        edges=cells.edges[name],
        beyond=rms(cells.energy([flight.beyond for flight in flights])),
        after=rms(cells.energy([flight.after for flight in flights])),
        allowed=rms(result.allowed),
    )
