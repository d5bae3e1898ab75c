# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether prediction intervals hold: what tables mark and headlines say of a coverage, decided here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from quadpi_core.evaluation.evaluation_result import AxisMetrics
from quadpi_core.report.style import percent

# Intervals that cover 93 % instead of 95 % serve the same decisions; below that, nobody would say "hold".
TOLERANCE = 0.02
# A coverage known to less than 10 points tells a 95 % interval from a 90 % one; a wider one does not.
WIDEST = 0.10


class Holding(Enum):
    """What a measured coverage says of an interval; the value is what a sentence says."""

    HOLDS = "hold"
    NOT_SHOWN = "are not shown to hold"
    FAILS = "do not hold"


@dataclass(frozen=True)
class Coverage:
    """A share of measurements inside their interval.

    Attributes:
        what: it is of, as a sentence names it: an axis, for example.
        estimate: the share.
        interval: its 95 % confidence interval (low, high); None where nothing tells it.
    """

    what: str
    estimate: float
    interval: tuple[float, float] | None

    def holding(self, confidence: float) -> Holding:
        """Decide for intervals of a nominal coverage.

        They hold where the estimate is at most :data:`TOLERANCE` below it and the confidence interval is
        narrower than :data:`WIDEST`. Else they do not where the whole confidence interval lies below the
        nominal coverage, and what is left is not shown.
        """
        if self.interval is None:
            return Holding.NOT_SHOWN
        low, high = self.interval
        if self.estimate >= confidence - TOLERANCE and high - low < WIDEST:
            return Holding.HOLDS
        return Holding.FAILS if high < confidence else Holding.NOT_SHOWN

    def sentence(self) -> str:
        """Its numbers, as in "Fx 83.4 %, 61.9 % to 95.5 %"."""
        if self.interval is None:
            return f"{self.what} {percent(self.estimate)}, its precision unknown"
        low, high = self.interval
        return f"{self.what} {percent(self.estimate)}, {percent(low)} to {percent(high)}"


def of_axes(axes: Mapping[str, AxisMetrics]) -> list[Coverage]:
    """The coverages of the axes of a group or flight, as `evaluate_flights` gives them."""
    return [Coverage(axis, found.picp, _pair(found.picp_ci)) for axis, found in axes.items()]


def _pair(interval: Sequence[float]) -> tuple[float, float]:
    low, high = interval
    return low, high


def joint(coverages: Sequence[Coverage], confidence: float) -> tuple[Holding, list[Coverage]]:
    """What holds of all of several: the worst of them, and those that it is true of, the lowest first."""
    for verdict in (Holding.FAILS, Holding.NOT_SHOWN, Holding.HOLDS):
        found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
        if found:
            return verdict, sorted(found, key=lambda coverage: coverage.estimate)
    raise ValueError("no coverage to judge")


def listed(parts: Sequence[str]) -> str:
    """Names as a sentence lists them: "a, b and c"."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


def in_cells(cells: Mapping[str, Sequence[Coverage]], confidence: float) -> str:
    """In how many of the coverages of each group intervals hold, and where that is not so, in words.

    Of those that are not shown to hold, and of those that do not, the lowest is named with its numbers.
    """
    clauses = []
    for verdict in Holding:
        parts = []
        for group, coverages in cells.items():
            found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
            if verdict is Holding.HOLDS:
                parts.append(f"{len(found)} of {len(coverages)} on {group}")
            elif found:
                lowest = min(found, key=lambda coverage: coverage.estimate)
                parts.append(f"{len(found)} on {group} ({lowest.sentence()})")
        if parts:
            clauses.append(f"{verdict.value} in {listed(parts)}")
    return "; ".join(clauses)
